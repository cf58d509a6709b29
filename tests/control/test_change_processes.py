"""A system of another process is changed by commands that are processes of their own, killed ones too."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from control_parts import WAIT, running, until

SYSTEM = """
schema = 1
[components.source0]
type = "parts_of_change.py:Source"
[components.server0]
type = "parts_of_change.py:Server"
[contexts.loop]
kind = "{kind}"
rate = 200.0
members = ["source0"]
"""
PARTS = """
import asyncio
from typing import Protocol

from aiorts import Component, Goal, InPort, OutPort, Param, Provided
from aiorts.types import TimedLong


class Serving(Protocol):
    async def hang(self) -> None: ...
    async def work(self) -> Goal[int, None]: ...
    async def counts(self) -> dict[str, int]: ...


class Source(Component):
    out = OutPort(TimedLong)
    step: int = Param(1, ge=1, le=100)
    count = 0

    def on_execute(self):
        self.count += self.step


class Server(Component):
    in_ = InPort(TimedLong, name="in")
    serving = Provided[Serving](concurrent=True, cancel_timeout=0.2)
    begun = cancelled = 0
    goals: list = []

    async def hang(self):
        self.begun += 1
        try:
            await asyncio.sleep(60)
        finally:
            self.cancelled += 1

    async def work(self):
        goal = Goal()
        self.goals.append(goal)
        goal.feedback(1)
        return goal

    async def counts(self):
        ended = sum(goal.state != "running" for goal in self.goals)
        return {"begun": self.begun, "cancelled": self.cancelled, "goals": len(self.goals), "ended": ended}
"""


def system(folder: Path, kind: str = "periodic") -> str:
    (folder / "parts_of_change.py").write_text(PARTS)
    file = folder / "system.toml"
    file.write_text(SYSTEM.format(kind=kind))
    return str(file)


def aiorts(*words: str, status: int = 0) -> str:
    """What a command prints; on a machine that is too busy to answer within its second it is asked again."""

    def asked() -> subprocess.CompletedProcess[str] | None:
        done = subprocess.run(
            [sys.executable, "-m", "aiorts", *words], capture_output=True, text=True, timeout=WAIT, check=False
        )
        return None if "E-NO-ANSWER" in done.stderr else done

    done: subprocess.CompletedProcess[str] = until(asked)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def counts() -> dict[str, int]:
    found: dict[str, int] = json.loads(aiorts("call", "server0.serving.counts"))
    return found


@pytest.mark.slow(kept_by="control/test_change.py::test_connectors_are_made_with_options_and_ended")
def test_a_run_is_changed_by_commands(tmp_path: Path) -> None:
    with running("plant", system(tmp_path)) as process:
        aiorts("conf", "source0", "step=5")
        assert json.loads(aiorts("conf", "source0", "--json"))["parameters"][0]["value"] == 5
        assert "must be <= 100; 5 kept" in aiorts("conf", "source0", "step=101", status=2)
        aiorts("con", "source0.out", "server0.in", "length=2")
        aiorts("exit", "server0")
        assert aiorts("con", "plant/source0").splitlines() == ["plant/"]
        aiorts("stop", "plant")
        assert process.wait(WAIT) == 0


@pytest.mark.slow(kept_by="control/test_change.py::test_parameters_are_in_force_when_conf_returns_read_by_their_types")
def test_a_member_of_a_thread_is_changed_too(tmp_path: Path) -> None:
    with running("plant", system(tmp_path, "thread")):
        aiorts("conf", "source0", "--add", "fast", "fast.step=9", "--activate", "fast")
        assert json.loads(aiorts("conf", "source0", "--json"))["active"] == "fast"
        aiorts("ctx", "rate", "loop", "100")
        assert json.loads(aiorts("ctx", "--json"))["kernels"][0]["contexts"][0]["rate"] == 100.0


@pytest.mark.slow(kept_by="control/test_calls.py::test_the_end_of_the_session_cancels_a_call")
def test_calls_and_goals_of_clients_that_are_killed_end(tmp_path: Path) -> None:
    with running("plant", system(tmp_path)):
        for words in (("call", "server0.serving.hang", "--timeout", "50"), ("goal", "server0.serving.work")):
            client = subprocess.Popen([sys.executable, "-m", "aiorts", *words], stdout=subprocess.PIPE, text=True)
            begun = "begun" if words[0] == "call" else "goals"
            until(lambda begun=begun: counts()[begun])
            client.kill()
            client.communicate(timeout=WAIT)
        found = until(lambda: (one := counts())["cancelled"] and one["ended"] and one)
        assert found == {"begun": 1, "cancelled": 1, "goals": 1, "ended": 1}
