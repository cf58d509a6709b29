"""`aiorts run` and hooks that take too long: what hangs is told of and not waited for, what blocks is told of too."""

from __future__ import annotations

from pathlib import Path

import pytest

from run_parts import aiorts

PARTS = """
import asyncio, time
from aiorts import Component

class Made(Component):
    async def on_initialize(self):
        await asyncio.Event().wait()

class Begun(Component):
    async def on_activated(self):
        await asyncio.Event().wait()

class Blocks(Component):
    def on_execute(self):
        time.sleep(0.5)
"""


def system(folder: Path, kind: str, context: str, more: str = "") -> Path:
    """A system file of one component."""
    (folder / "parts.py").write_text(PARTS)
    path = folder / "system.toml"
    path.write_text(
        f'schema = 1\n[components.it]\ntype = "parts.py:{kind}"\n{more}\n[contexts.loop]\n{context}\nmembers = ["it"]\n'
    )
    return path


@pytest.mark.slow(
    kept_by="supervision/test_blocking_hooks.py::test_an_initialization_that_hangs_is_ended_in_time_and_leaves_nothing"
)
@pytest.mark.parametrize("how", [("--simulate",), ("--speed", "100")])
@pytest.mark.parametrize("alone", [False, True])
def test_a_component_that_is_never_initialised_is_told_of(tmp_path: Path, alone: bool, how: tuple[str, ...]) -> None:
    path = system(tmp_path, "Made", 'kind = "event"')
    done = aiorts(tmp_path, "run", "parts.py:Made" if alone else path.name, *how)
    name = "made" if alone else "it"
    assert f"{name}.on_initialize: did not return within 30 s; it was cancelled" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == 1


@pytest.mark.slow(kept_by="supervision/test_readiness.py::test_who_is_missing_is_named_with_the_reason")
@pytest.mark.parametrize("alone", [False, True])
def test_a_component_that_is_never_active_is_told_of(tmp_path: Path, alone: bool) -> None:
    path = system(tmp_path, "Begun", 'kind = "event"')
    done = aiorts(tmp_path, "run", "parts.py:Begun" if alone else path.name, "--simulate")
    assert "did not take effect within 5.0 s" in done.stderr
    assert done.returncode == 1


@pytest.mark.slow(
    kept_by="supervision/test_blocking_hooks.py::test_a_hook_that_hangs_already_is_held_to_a_deadline_that_comes_later"
)
@pytest.mark.parametrize(
    ("context", "more"),
    [
        ('kind = "periodic"\nrate = 20.0\ndeadline = 0.1', ""),
        ('kind = "thread"\nrate = 20.0\ndeadline = 0.1', ""),
        ('kind = "periodic"\nrate = 20.0', "supervision.deadline = 0.1"),
        ('kind = "thread"\nrate = 20.0', "supervision.deadlines = { on_execute = 0.1 }"),
        ('kind = "realtime"\nrate = 20.0', "supervision.deadline = 0.1"),
    ],
)
def test_a_deadline_of_the_file_holds_for_a_hook_that_blocks(tmp_path: Path, context: str, more: str) -> None:
    path = system(tmp_path, "Blocks", context, more)
    assert aiorts(tmp_path, "check", path.name).returncode == 0
    done = aiorts(tmp_path, "run", path.name, "--for", "1.5")
    told = "it.on_execute: returned after 0."
    assert done.stderr.count(told) == 1  # and it has not run again
    assert "its deadline is 0.1 s" in done.stderr
