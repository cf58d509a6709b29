"""A whole system under a simulated clock does the same every time, and takes no real time."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from aiorts import Component, InPort, Kernel, OutPort, PeriodicContext, SimulatedClock
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from conftest import HAS_UVLOOP

HERE = Path(__file__).parent


def run_system(loop: str, seed: str) -> bytes:
    path = os.pathsep.join(filter(None, [str(HERE.parents[1]), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-W", "error", str(HERE / "whole_system.py"), loop],
        env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": path},
        capture_output=True,
        timeout=30,
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(128)
@pytest.mark.parametrize("each", [False, True], ids=["one on each loop", "two on each"])
def test_two_processes_on_two_loops_each_give_the_same_bytes(each: bool) -> None:
    loops = ["simulated", "uvloop"] if HAS_UVLOOP else ["simulated", "asyncio"]
    seeds = ["1", "4711"]
    runs = [(loop, seed) for loop in loops for seed in seeds] if each else list(zip(loops, seeds, strict=True))
    with ThreadPoolExecutor(2) as pool:
        outputs = list(pool.map(lambda run: run_system(*run), runs))
    reference = outputs[0].decode().splitlines()
    assert len(reference) > 5_000
    for what in ("StateChanged", "Overrun", "HookFailed", "RateChanged", "Disconnected", "superseded", "skipped="):
        assert any(what in line for line in reference), what
    for run, output in zip(runs, outputs, strict=True):
        lines = output.decode().splitlines()
        first = next((number for number, pair in enumerate(zip(reference, lines)) if pair[0] != pair[1]), None)  # noqa: B905
        assert first is None, f"{run}, line {first}: {lines[first]!r}, expected {reference[first]!r}"
        assert output == outputs[0], run


class Source(Component):
    output = OutPort(TimedLong)
    value: int = 0

    async def on_execute(self) -> None:
        self.value += 1
        await self.output.write(TimedLong(self.clock.time_ns(), self.value))


class Sink(Component):
    input = InPort(TimedLong)
    total: int = 0

    async def on_execute(self) -> None:
        sample = self.input.read_nowait()
        self.total += sample.data


@pytest.mark.slow(kept_by="contexts/test_ten_hours.py::test_ticks_counted_one_by_one_neither_drift_nor_get_lost")
@pytest.mark.row(29, 128)
def test_an_hour_at_a_hundred_hertz_takes_seconds() -> None:
    async def main(clock: SimulatedClock) -> tuple[int, int, int]:
        async with Kernel() as kernel:
            source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
            await kernel.connect(source.output, sink.input)
            context = await kernel.start(PeriodicContext(100.0), source, sink, activate=True)
            await asyncio.sleep(3600.0 - 0.005)
            return context.statistics.cycles, context.statistics.lateness_max_ns, sink.total

    began = time.monotonic()
    cycles, late, total = simulate(main)
    assert time.monotonic() - began < 40.0
    assert (cycles, late) == (360_000, 0)
    assert total == 360_000 * 360_001 // 2
