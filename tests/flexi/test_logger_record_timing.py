"""What recording costs its neighbours: a 100 Hz context in the same kernel, with and without a recorder, by turns."""

from __future__ import annotations

import asyncio
import gc
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from aiorts import Component, Kernel, OutPort, PeriodicContext
from aiorts.types import TimedDoubleSeq
from aiorts_flexi.recordings.logger import FlexiLogger
from campaign import CAMPAIGN
from logger_parts import active, feeders, recorder

ROUNDS, SECONDS = (5, 4.0) if CAMPAIGN else (1, 0.6)
HZ = 10_000
MOST = 0.005 if CAMPAIGN else 0.05
"""Seconds of lateness that recording may add; generous where others use the machine, too."""


class Ticker(Component):
    """Notes how late it is."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.at: list[float] = []

    def on_execute(self) -> None:
        self.at.append(time.perf_counter())

    @property
    def late(self) -> float:
        """The 99th percentile of how far its periods are from 10 ms."""
        off = sorted(abs(after - before - 0.01) for before, after in zip(self.at, self.at[1:], strict=False))
        return off[len(off) * 99 // 100]


@pytest.fixture
def frozen() -> Iterator[None]:
    """The garbage collector has nothing to do with what exists already, as in every run of a system."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


async def lateness(path: Path | None) -> float:
    """Of a context at 100 Hz beside 10,000 samples a second, which are recorded if there is a path."""
    async with Kernel() as kernel:
        ticker = await kernel.create(Ticker)
        logger: FlexiLogger | None = None
        out: OutPort[TimedDoubleSeq] = (await kernel.create(Component)).add_port("out", OutPort(TimedDoubleSeq))
        if path is not None:
            logger = await recorder(kernel, path, "TimedDoubleSeq")
            out = (await feeders(kernel, logger))["input0"]
            await active(kernel, logger)
        await kernel.start(PeriodicContext(rate=100.0), ticker, activate=True)
        begin, number = time.perf_counter(), 0
        while (now := time.perf_counter() - begin) < SECONDS:
            while number < now * HZ:
                out.write_nowait(TimedDoubleSeq(number, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
                number += 1
            await asyncio.sleep(0.002)
        if logger is not None:
            assert logger.last_error is None
    return ticker.late


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.usefixtures("frozen")
@pytest.mark.anyio
async def test_recording_does_not_delay_a_context_beside_it(tmp_path: Path) -> None:
    pairs = [(await lateness(None), await lateness(tmp_path / f"{number}.mcap")) for number in range(ROUNDS)]
    added = statistics.median(recording - bare for bare, recording in pairs)
    print([f"{bare * 1e3:.2f} ms bare, {recording * 1e3:.2f} ms beside a recorder" for bare, recording in pairs])
    assert added < MOST
