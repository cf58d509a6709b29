"""Measures how exactly a recording is replayed: errors of the times between samples, next to a bare timer loop.

Replay and bare loop keep the same intervals in turn on one event loop, so that other load affects both.
"""

from __future__ import annotations

import asyncio
import importlib
import tempfile
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from aiorts import Component, EventContext, InPort, Kernel
from aiorts.system import wait_finished
from aiorts.types import TimedDouble

_MS: Final = 1e6
_BEGIN: Final = 1_700_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class Errors:
    """Percentiles, in ms, of the difference between an interval from sample to sample and that interval as recorded."""

    p50: float
    p99: float
    worst: float

    @classmethod
    def of(cls, rounds: list[list[int]], step: int) -> Errors:
        """The errors of the moments (ns) of each round, which should be `step` ns apart."""
        found = sorted(abs(after - before - step) for moments in rounds for before, after in pairwise(moments))
        return cls(*(found[min(len(found) - 1, int(len(found) * part))] / _MS for part in (0.5, 0.99, 1.0)))


@dataclass(frozen=True, slots=True)
class ReplayTiming:
    """The errors of a replay, and of the bare loop of the same run."""

    replay: Errors
    bare: Errors


class _Taker(Component):
    data = InPort(TimedDouble)

    def on_activated(self) -> None:
        self.moments: list[int] = []

    def on_execute(self) -> None:
        now = time.monotonic_ns()
        self.moments += [now] * len(self.data.drain())


async def measure_replay(*, rate: float = 200.0, count: int = 200, rounds: int = 5) -> ReplayTiming:
    """Play `count` samples recorded at `rate` Hz, `rounds` times, on the running loop."""
    step = round(1e9 / rate)
    replayed, bare = [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "timing.mcap")
        _record(path, count, step)
        for _ in range(rounds):
            bare.append(await _bare(count, step))
            replayed.append(await _replay(path))
    return ReplayTiming(Errors.of(replayed, step), Errors.of(bare, step))


def _record(path: Path, count: int, step: int) -> None:
    recordings: Any = importlib.import_module("aiorts_log")
    with recordings.RecordingWriter(path, recordings.RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("data", TimedDouble)
        for number in range(count):
            writer.write(port, TimedDouble(_BEGIN + number * step, float(number)), _BEGIN + number * step)


async def _replay(path: Path) -> list[int]:
    logger_class: Any = importlib.import_module("aiorts_flexi.recordings.logger").FlexiLogger
    async with Kernel() as kernel:
        logger = await kernel.create(logger_class, mode="replay", logfile=str(path))
        taker = await kernel.create(_Taker)
        await kernel.connect(logger.ports["data"], taker.data, length=1000)
        await kernel.start(EventContext(), taker, activate=True)
        await kernel.start(EventContext(), logger, activate=True)
        await wait_finished(kernel)
        return taker.moments


async def _bare(count: int, step: int) -> list[int]:
    began, moments = time.monotonic_ns(), []
    for number in range(count):
        await asyncio.sleep(max(0, began + number * step - time.monotonic_ns()) / 1e9)
        moments.append(time.monotonic_ns())
    return moments
