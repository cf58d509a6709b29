"""`aiorts run` when a component raises what raises itself, ends its task by SystemExit, or aiorts is at fault."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from run_parts import here

if TYPE_CHECKING:
    from pathlib import Path

COMPONENTS = """
import asyncio, sys
from dataclasses import dataclass
from aiorts import Component, Param

@dataclass(frozen=True)
class Refused(Exception):
    code: int = 1

class Unseen(Exception):
    def __str__(self):
        raise RuntimeError("no text")
    __class__ = property(__str__)

class Good(Component):
    n = 0
    def on_execute(self):
        self.n += 1
    def on_deactivated(self):
        print("good", self.n, flush=True)

class Bad(Component):
    how = Param("")
    def on_initialize(self):
        if self.how == "unmade":
            raise Unseen
    async def on_execute(self):
        if self.how == "refused":
            raise Refused(7)
        if self.how == "unseen":
            raise Unseen
        if self.how == "task" and not hasattr(self, "task"):
            self.task = asyncio.create_task(self.leave())
        if self.how == "exit":
            raise KeyboardInterrupt
        if self.how == "forget":
            vars(self).clear()
        if self.how == "fault" and not hasattr(self, "mistaken"):
            type(self.context)._end_cycle, self.end = self.mistake, type(self.context)._end_cycle
    async def leave(self):
        sys.exit(7)
    def mistake(self, members):
        type(self.context)._end_cycle = self.end
        self.mistaken = True
        raise RuntimeError("a mistake of aiorts")
"""
SYSTEM = """
schema = 1
[components.good]
type = "parts.py:Good"
[components.bad]
type = "parts.py:Bad"
params.how = "{how}"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["good", "bad"]
"""


@pytest.mark.row(13)
@pytest.mark.parametrize(
    ("how", "status", "said"),
    [
        ("refused", 3, "Refused: 7"),
        ("unseen", 3, "Unseen: (its text cannot be had)"),
        ("task", 3, "SystemExit: 7"),
        ("exit", 3, "KeyboardInterrupt"),
        ("forget", 0, ""),
        ("fault", 1, "a fault of aiorts itself"),
        ("unmade", 1, "Unseen: (its text cannot be had)"),
    ],
)
def test_the_others_run_to_the_end_and_the_status_says_whose_fault_it_was(
    tmp_path: Path, how: str, status: int, said: str
) -> None:
    (tmp_path / "parts.py").write_text(COMPONENTS)
    (tmp_path / "system.toml").write_text(SYSTEM.format(how=how))
    done = here(tmp_path, "run", "system.toml", "--simulate", "--for", "2")
    assert done.returncode == status, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    if how != "unmade":
        assert done.stdout.startswith("good ")
        assert int(done.stdout.split()[1]) >= 199
