"""What keeps the event loop from turning is named while it does, in one line; a debugger or a stop is not."""

from __future__ import annotations

import asyncio
import inspect
import io
import logging
import os
import pdb
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, EventContext, Kernel, PeriodicContext
from aiorts.diagnostics.loop_monitor import LoopMonitor
from aiorts.errors import ClosedError, ConfigurationError
from aiorts.events import LoopStall
from aiorts.testing import simulated
from run_parts import limited

pytestmark = pytest.mark.anyio

TESTS = Path(__file__).parents[1]


class Sleeper(Component):
    """Blocks the loop in one execution."""

    def __init__(self, name: str = "", how: str = "sleep", seconds: float = 0.5) -> None:
        super().__init__(name)
        self.how, self.seconds = how, seconds
        self.begun: float = 0.0

    async def on_execute(self) -> None:
        if self.begun:
            return
        self.begun = time.time()
        if self.how == "sleep":
            time.sleep(self.seconds)
        elif self.how == "deep":
            self._deeper(self.seconds)
        else:
            until = time.monotonic() + self.seconds
            while time.monotonic() < until:
                pass

    def _deeper(self, seconds: float) -> None:
        time.sleep(seconds)


def line_of(function: Any, text: str) -> int:
    lines, first = inspect.getsourcelines(function)
    return first + next(number for number, line in enumerate(lines) if text in line)


async def stalled(how: str, caplog: pytest.LogCaptureFixture) -> tuple[float, logging.LogRecord]:
    """When the one line came after the block began, and the line."""
    caplog.set_level(logging.WARNING)
    caplog.clear()
    stalls: list[LoopStall] = []
    async with Kernel() as kernel:
        assert kernel.watch_loop()
        kernel.bus.subscribe(LoopStall, stalls.append)
        one = await kernel.add(Sleeper("one", how))
        await kernel.start(PeriodicContext(50.0), one, activate=True)
        await asyncio.sleep(0.7)
        metric = kernel.loop_stalls
    records = [record for record in caplog.records if "loop" in record.getMessage()]
    assert len(records) == 1
    assert metric.count == len(stalls) == 1
    assert metric.max_ns == metric.total_ns == stalls[0].duration_ns
    assert metric.max_ns >= 0.4e9
    assert metric.last == stalls[0].blame
    assert (stalls[0].blame.component, stalls[0].blame.hook) == ("one", "on_execute")
    return records[0].created - one.begun, records[0]


@pytest.mark.slow
@pytest.mark.fault("A09")
@pytest.mark.row(16)
@pytest.mark.parametrize(
    ("how", "text"), [("sleep", "time.sleep"), ("deep", "time.sleep"), ("spin", "while time.monotonic")]
)
async def test_what_blocks_the_loop_is_named_within_a_quarter_of_a_second(
    how: str, text: str, caplog: pytest.LogCaptureFixture
) -> None:
    best = 9.0
    for _ in range(4):  # a loaded machine may wake the watcher late
        took, record = await stalled(how, caplog)
        message = record.getMessage()
        assert "\n" not in message
        line = line_of(Sleeper._deeper if how == "deep" else Sleeper.on_execute, text)
        lines = [line, line + 1] if how == "spin" else [line]
        assert any(f"{__file__}:{number}" in message for number in lines), message
        assert "one.on_execute" in message
        best = min(best, took)
        if best <= 0.25:
            break
    assert best <= 0.25


@pytest.mark.slow
async def test_a_task_and_the_application_are_named_too(caplog: pytest.LogCaptureFixture) -> None:
    class Parent(Component):
        async def on_activated(self) -> None:
            self.task = asyncio.create_task(self.work())

        async def work(self) -> None:
            await asyncio.sleep(0.1)
            time.sleep(0.5)

    async with Kernel() as kernel:
        kernel.watch_loop()
        await kernel.start(EventContext(), await kernel.create(Parent, "parent"), activate=True)
        await asyncio.sleep(0.7)
        assert "parent" in caplog.text
        assert f"{__file__}:{line_of(Parent, 'time.sleep(0.5)')}" in caplog.text
        caplog.clear()
        time.sleep(0.5)
        await asyncio.sleep(0.05)
        assert caplog.text.count("does not turn") == 1
        assert "test_a_task_and_the_application" in caplog.text


@pytest.mark.slow(kept_by="test_simulated_time_has_no_stalls")
async def test_an_idle_loop_and_a_busy_one_are_no_stall(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        kernel.watch_loop()
        await asyncio.sleep(0.6)
        until = time.monotonic() + 0.6
        while time.monotonic() < until:
            await asyncio.sleep(0)
            time.sleep(0.01)
        assert kernel.loop_stalls.count == 0
    assert "does not turn" not in caplog.text


@pytest.mark.slow(kept_by="test_simulated_time_has_no_stalls")
async def test_woken_late_while_the_loop_waits_for_nothing_it_names_nobody(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        kernel.watch_loop()
        monitor: Any = kernel.attached(LoopMonitor)
        watch = monitor._loop_timer

        def look() -> None:
            time.sleep(0.02)  # the loop has gone to sleep
            now = time.monotonic_ns()
            watch._beat_ns, watch._due = now - 1_000_000_000, (now, time.process_time_ns())
            watch.ring(watch._timer)

        await asyncio.to_thread(look)
        await asyncio.sleep(0.3)
        assert kernel.loop_stalls.count == 0
    assert "does not turn" not in caplog.text


class SlowTyping(io.StringIO):
    """Somebody at the debugger's prompt, who thinks before going on."""

    def readline(self, *_args: Any) -> str:
        time.sleep(0.8)
        return "c\n"


@pytest.mark.slow(kept_by="test_simulated_time_has_no_stalls")
async def test_at_the_prompt_of_a_debugger_it_is_quiet(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        kernel.watch_loop(limit=0.3)
        await asyncio.sleep(0.05)
        before = sys.gettrace()
        try:
            pdb.Pdb(stdin=SlowTyping(), stdout=io.StringIO(), nosigint=True, readrc=False).set_trace()
            await asyncio.sleep(0.05)
        finally:
            sys.settrace(before)
        assert "turn" not in caplog.text
        assert kernel.loop_stalls.count == 0
        await asyncio.sleep(0.05)
        time.sleep(0.5)
        await asyncio.sleep(0.05)
        assert kernel.loop_stalls.count == 1


CHILD = """
import asyncio, logging, sys, time
from aiorts import Component, Kernel, PeriodicContext
logging.basicConfig(format="%(message)s")

class Held(Component):
    async def on_execute(self):
        if sys.argv[1] == "busy":  # a processor's time: it does not pass while the process is stopped
            until = time.process_time() + 0.03
            while time.process_time() < until: pass
        if sys.argv[1] == "spin":
            while True: pass
        if sys.argv[1] == "sleep":
            time.sleep(30)
        if sys.argv[1] == "logging":
            logging.getLogger().handlers[0].acquire()
            time.sleep(30)

async def main():
    async with Kernel() as kernel:
        assert kernel.watch_loop(limit=float(sys.argv[2]), policy=sys.argv[3])
        await kernel.start(PeriodicContext(20.0), await kernel.create(Held, "held"), activate=True)
        await asyncio.sleep(0.3)  # what the start imports may hold the loop up
        before = kernel.loop_stalls.count
        print("running", flush=True)
        await asyncio.sleep(3.5)
        print("stalls", kernel.loop_stalls.count - before, flush=True)
        time.sleep(float(sys.argv[2]) + 0.3)
        await asyncio.sleep(0.05)
        print("stalls", kernel.loop_stalls.count, flush=True)

asyncio.run(main())
"""


def child(tmp_path: Path, *args: str) -> subprocess.Popen[str]:
    script = tmp_path / "held.py"
    script.write_text(textwrap.dedent(CHILD))
    return subprocess.Popen(
        [sys.executable, str(script), *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=TESTS
    )


@pytest.mark.slow
@pytest.mark.fault("A09")
@pytest.mark.row(17)
@pytest.mark.parametrize("how", ["spin", "sleep", "logging"])
def test_after_the_limit_the_process_ends_with_70_for_who_restarts_it(how: str, tmp_path: Path) -> None:
    began = time.monotonic()
    with child(tmp_path, how, "0.8", "exit") as process, limited(process):
        _, said = process.communicate(timeout=30)
    assert process.returncode == 70
    assert time.monotonic() - began < 15
    last = said.strip().splitlines()[-1]
    assert "held.on_execute" in last
    assert "held.py:" in last
    assert "status 70" in last
    told = [line for line in said.strip().splitlines() if "held.on_execute" in line]  # imports may hold it up, too
    assert len(told) == (1 if how == "logging" else 2)


@pytest.mark.slow(kept_by="test_simulated_time_has_no_stalls")
def test_a_process_that_was_stopped_is_no_stall_and_is_watched_afterwards(tmp_path: Path) -> None:
    with (
        child(tmp_path, "idle", "0.8", "exit") as idle,
        child(tmp_path, "busy", "0.8", "exit") as busy,
        limited(idle, busy),
    ):
        both = {"idle": idle, "busy": busy}
        for process in both.values():
            assert process.stdout is not None
            assert process.stdout.readline() == "running\n"
        time.sleep(0.3)
        for process in both.values():
            os.kill(process.pid, signal.SIGSTOP)
        time.sleep(1.4)
        for process in both.values():
            os.kill(process.pid, signal.SIGCONT)
        ended = {how: process.communicate(timeout=30) for how, process in both.items()}
    for how, (out, said) in ended.items():
        # Its own stall at the end is over the limit: it was watched, and the stop before it was not held against it.
        assert both[how].returncode == 70, said
        assert out.startswith("stalls ")
        assert out.count("\n") == 1
        assert how == "busy" or out == "stalls 0\n"
        assert "has not turned" in said


async def test_wrong_limits_are_refused_and_a_closed_kernel_watches_nothing() -> None:
    async with Kernel() as kernel:
        for limit in (0.0, -1.0, float("inf"), float("nan"), True):
            with pytest.raises(ConfigurationError):
                kernel.watch_loop(limit)
        with pytest.raises(ConfigurationError):
            kernel.watch_loop(policy="panic")
        assert kernel.watch_loop(1.0)
        assert kernel.watch_loop(2.0, "exit")
        assert kernel.watch_loop(2.0, "warn")
    with pytest.raises(ClosedError):
        kernel.watch_loop()


@simulated
async def test_simulated_time_has_no_stalls() -> None:
    async with Kernel() as kernel:
        assert not kernel.watch_loop()
        assert kernel.loop_stalls.count == 0


async def test_what_holds_the_loop_again_and_again_is_said_once_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        kernel.watch_loop(limit=60.0)
        await asyncio.sleep(0.05)
        for _ in range(4):
            time.sleep(0.35)
            await asyncio.sleep(0.02)
        assert kernel.loop_stalls.count == 4
        assert len([line for line in caplog.messages if "does not turn" in line]) == 1
