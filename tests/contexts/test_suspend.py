"""A process that is stopped and continued: one overrun, no burst."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from campaign import CAMPAIGN

CHILD = """
import asyncio, json, sys
from aiorts import Component, Kernel, PeriodicContext
from aiorts.kernel.loop.bus import Overrun

class Ticker(Component):
    def __init__(self, name):
        super().__init__(name)
        self.begun = []
    def on_execute(self):
        self.begun.append(self.clock.monotonic_ns())

async def main():
    overruns = []
    async with Kernel() as kernel:
        kernel.bus.subscribe(Overrun, lambda event: overruns.append([event.skipped, kernel.clock.monotonic_ns()]))
        ticker = await kernel.add(Ticker("ticker"))
        await kernel.start(PeriodicContext(20.0), ticker, activate=True)
        print("ready", flush=True)
        await asyncio.to_thread(sys.stdin.readline)
        await asyncio.sleep(0.5)
    print(json.dumps([ticker.begun, overruns]), flush=True)

asyncio.run(main())
"""

STOPPED = 10.0 if CAMPAIGN else 2.0


@pytest.mark.slow(
    kept_by="contexts/test_schedule.py::test_a_tick_that_begins_when_newer_ones_are_due_gives_way_to_the_newest"
)
@pytest.mark.fault("C05")
@pytest.mark.row(32)
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs SIGSTOP")
def test_a_process_that_was_suspended_goes_on_with_one_overrun_and_no_burst() -> None:
    root = Path(__file__).parents[2]
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(root), os.environ.get("PYTHONPATH")]))},
    )
    with child:
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            assert child.stdout.readline() == "ready\n"
            time.sleep(0.5)
            child.send_signal(signal.SIGSTOP)
            time.sleep(STOPPED)
            continued = time.monotonic_ns()
            child.send_signal(signal.SIGCONT)
            time.sleep(0.3)
            child.stdin.write("\n")
            child.stdin.flush()
            begun, overruns = json.loads(child.stdout.readline())
        finally:
            child.kill()
    period = 50_000_000
    gap = max(later - earlier for earlier, later in itertools.pairwise(begun))
    assert gap >= (STOPPED - 0.3) * 1e9
    first = next(moment for moment in begun if moment >= continued)
    assert sum(first <= moment < first + period for moment in begun) <= 2
    great = [skipped for skipped, _ in overruns if skipped > 5]
    assert len(great) == 1
    assert abs(great[0] - STOPPED * 20) <= 5
