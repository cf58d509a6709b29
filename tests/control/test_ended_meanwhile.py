"""Commands that are short compared with what they ask for: none says done before it is, also where the kernel ends."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from control_parts import WAIT, running, until

PARTS = """
import asyncio
from typing import Protocol

from aiorts import Component, Goal, InPort, OutPort, Provided
from aiorts.types import TimedLong


class Does(Protocol):
    async def say(self, count: int, seconds: float) -> int: ...


class Works(Protocol):
    async def work(self, count: int) -> Goal[int, int]: ...


class Teller(Component):
    out = OutPort(TimedLong)
    does = Provided[Does](concurrent=True)
    works = Provided[Works]()
    goal, left = None, 0

    async def say(self, count: int, seconds: float) -> int:
        for number in range(count):
            self.out.write_nowait(TimedLong(0, number))
        await asyncio.sleep(seconds)
        return count

    def work(self, count: int) -> Goal[int, int]:
        self.goal, self.left = Goal(), count
        return self.goal

    def on_execute(self) -> None:
        self.out.write_nowait(TimedLong(0, -1))
        if self.goal is not None and self.goal.state == "running":
            self.goal.feedback(self.left)
            self.left -= 1
            if self.left <= 0:
                self.goal.succeed(7)


class Slow(Component):
    inp = InPort(TimedLong, length=1000)

    def on_execute(self) -> None:
        for sample in self.inp.drain():
            print("got", sample.data, flush=True)
"""
SYSTEM = """
schema = 1
[components.teller]
type = "parts.py:Teller"
[components.slow]
type = "parts.py:Slow"
[[connections]]
from = "teller.out"
to = "slow.inp"
length = 1000
[contexts.fast]
kind = "periodic"
rate = 50.0
members = ["teller"]
[contexts.slow]
kind = "periodic"
rate = {rate}
members = ["slow"]
"""


def begin(*words: str) -> subprocess.Popen[str]:
    """A command, in a process of its own."""
    command = [sys.executable, "-m", "aiorts", *words]
    return subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """The status of a command, and what it has printed."""
    out, err = process.communicate(timeout=WAIT)
    return process.returncode, out, err


@contextmanager
def told(system: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """The run of a system whose teller answers."""
    with running("meanwhile", str(system), *words) as run:
        until(lambda: ended(begin("call", "meanwhile/teller.does.say", "0", "0"))[0] == 0)
        yield run


@pytest.fixture
def system(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    return tmp_path / "s.toml"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "ends"),
    [
        (("call", "meanwhile/teller.does.say", "3", "60", "--timeout", "60"), {6: "call: its kernel has ended"}),
        (("goal", "meanwhile/teller.works.work", "100000"), {1: "its kernel closes"}),
        (
            ("inject", "meanwhile/slow.inp", "5", "--timeout", "60"),  # it may hear of the drop before the end
            {1: "1 of 1 samples were dropped (inactive)", 6: "inject: its kernel has ended"},
        ),
    ],
)
def test_what_is_under_way_when_its_kernel_ends_is_not_done(
    system: Path, words: tuple[str, ...], ends: dict[int, str]
) -> None:
    system.write_text(SYSTEM.format(rate=0.01))
    with told(system) as run:
        doing = begin(*words)
        with pytest.raises(subprocess.TimeoutExpired):
            doing.wait(1.5)  # it is under way
        assert ended(begin("stop", "meanwhile"))[0] == 0
        status, _, err = ended(doing)
        assert status in ends, err
        assert ends[status] in err
        assert run.wait(WAIT) == 0


@pytest.mark.slow
def test_a_call_and_a_goal_that_are_done_are_so_although_the_kernel_ends_next(system: Path) -> None:
    """What they wrote is with a periodic reader, whose next cycle has it."""
    system.write_text(SYSTEM.format(rate=2.0))
    with told(system) as run:
        assert ended(begin("call", "meanwhile/teller.does.say", "9", "0"))[:2] == (0, "9\n")
        assert ended(begin("goal", "meanwhile/teller.works.work", "3"))[:2] == (0, "3\n2\n1\n7\n")
        time.sleep(0.6)  # a cycle of the reader
        assert ended(begin("stop", "meanwhile"))[0] == 0
        out = run.communicate(timeout=WAIT)[0]
        assert [f"got {number}" in out.split("\n") for number in range(9)] == [True] * 9
        assert run.returncode == 0


@pytest.mark.parametrize("how", ["stop", "remove"])
def test_a_filter_that_takes_what_runs_has_all_to_the_last(system: Path, how: str) -> None:
    system.write_text(SYSTEM.format(rate=100.0))
    with told(system, "--record", str(system.parent / "run.mcap")) as run:
        taking = begin(*["flexifilter", "-i", "TimedLong", "-o", "TimedLong", "--connect", "meanwhile/teller.out"])
        assert taking.stdout is not None
        first = taking.stdout.readline()
        assert ended(begin("call", "meanwhile/teller.does.say", "200", "0"))[0] == 0
        # Without the teller there is nothing left to do, and the run ends by itself.
        assert ended(begin(*(("stop", "meanwhile") if how == "stop" else ("exit", "meanwhile/teller"))))[0] == 0
        status, out, err = ended(taking)
        assert (status, err) == (0, "")
        assert run.wait(WAIT) == 0
    lines = [json.loads(line)["data"] for line in (first + out).splitlines()]
    recorded = ended(begin("log", "cat", str(system.parent / "run.mcap"), "--port", "teller.out"))[1]
    written = [json.loads(line)["data"] for line in recorded.splitlines()]
    assert lines == written[-len(lines) :]
    assert set(range(200)) <= set(lines)


@pytest.mark.slow
def test_a_simulated_run_is_alone_whatever_its_links_lead_to(system: Path) -> None:
    system.write_text(SYSTEM.format(rate=50.0))
    alone = system.with_name("alone.toml")
    alone.write_text(
        """schema = 1
[components.teller]
type = "parts.py:Teller"
[contexts.fast]
kind = "periodic"
rate = 50.0
members = ["teller"]
[[connections]]
from = "teller.out"
to = "meanwhile/slow.inp"
"""
    )
    with told(system):
        status, _, said = ended(begin("run", str(alone), "--simulate", "--for", "3600", "--lenient"))
    assert status == 0, said
    assert "W-LINK: on a simulated clock no kernel of another process is reached" in said
