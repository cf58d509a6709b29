"""Cases of `aiorts bench log`: the lateness that a recorder adds to a context, and the opening of a large recording.

A component in a periodic context of 100 Hz runs with and without a recorder that it gives samples to; its lateness
should be the same. The large recording has a million samples; each round opens it in a new process, so that its memory
can be measured.
"""

from __future__ import annotations

import asyncio
import importlib
import itertools
import json
from functools import partial
from pathlib import Path
from time import monotonic_ns
from typing import Any, Final

import numpy as np

from aiorts import Component, Kernel, PeriodicContext
from aiorts.types import TimedDouble, TimedOctetSeq
from aiorts_bench.harness import child
from aiorts_bench.harness.case import Aim, Case, Measure, Reading, Sense, tails

_HZ: Final = 100
_WARM: Final = 10
"""Ticks at the beginning that do not count: loop and recorder are starting."""
(_P99, _MAX) = tails("lateness", 99.0, 100.0, unit="ms", digits=2)
_LOADS: Final[tuple[tuple[str, Any, int], ...]] = (
    ("10,000 floats/s", TimedDouble(1, 1.5), 100),
    ("100 MB/s", TimedOctetSeq(1, np.arange(1_000_000, dtype=np.uint8).copy()), 1),
)
"""Name, record, and number of records in each tick."""
_BEYOND: Final = 5.0
"""Milliseconds that a recorder may add to the 99th percentile."""
_INFO: Final = Measure("info", "ms", digits=1)
_SEEK: Final = Measure("seek", "ms", digits=1)
_MEMORY: Final = Measure("memory", "MiB", digits=1)
LARGE: Final = 1_000_000
_RECORD: Final = """
import sys, time
from aiorts.types import TimedDouble
from aiorts_log import RecordingOptions, RecordingWriter
path, count = sys.argv[1], int(sys.argv[2])
with RecordingWriter(path, RecordingOptions(min_free=0, existing="overwrite")) as writer:
    ports = [writer.add_port(f"port{i}", TimedDouble) for i in range(4)]
    for i in range(count):
        while not writer.write(ports[i % 4], TimedDouble(i, i), i * 100_000):
            time.sleep(0.01)
if sys.argv[3] != "closed":
    with open(path, "rb+") as file:
        file.truncate(file.seek(0, 2) - 20)
"""
_LOOK: Final = """
import json, sys
from time import process_time as clock
from aiorts_log import RecordingReader, info_of
def peak():
    try:
        with open("/proc/self/status") as file:
            return next(int(line.split()[1]) / 1024 for line in file if line.startswith("VmHWM"))
    except OSError:
        return 0.0
before, began = peak(), clock()
with RecordingReader(sys.argv[1]) as reader:
    count = info_of(reader).count
    info = clock() - began
    seek = 0.0
    for i in range(1, 20):
        began = clock()
        samples = reader.samples(start=reader.start + (reader.end - reader.start) * i // 20)
        next(samples)
        seek = max(seek, clock() - began)
    read = sum(1 for _ in reader.samples())
print(json.dumps({"info": info * 1e3, "seek": seek * 1e3, "memory": peak() - before, "count": count, "read": read}))
"""


class _Source(Component):
    """Records when it ran and, with a recorder, offers samples to it in each tick."""

    def __init__(self, record: Any, each: int, writer: Any, ticks: int) -> None:
        super().__init__("source")
        self.ran: list[int] = []
        self.done = asyncio.Event()
        self._ticks = ticks
        self._record = record
        self._each = each
        self._writer = writer
        self._port = -1 if writer is None else writer.add_port("source.out", type(record))
        self._count = 0

    async def on_execute(self) -> None:
        if len(self.ran) == self._ticks:
            self.done.set()
            return
        self.ran.append(monotonic_ns())
        for _ in range(self._each):
            self._count += 1
            if self._writer is not None:
                self._writer.write(self._port, self._record, self._count)


async def _ticks(record: Any, each: int, writer: Any, count: int) -> list[int]:
    source = _Source(record, each, writer, count + _WARM)
    async with Kernel() as kernel:
        await kernel.add(source)
        await kernel.start(PeriodicContext(rate=float(_HZ)), source, activate=True)
        await source.done.wait()
    return source.ran[_WARM:]


def _live(folder: Path, record: Any, each: int, is_recorded: bool, count: int) -> Reading:
    recordings: Any = importlib.import_module("aiorts_log")
    path, writer = folder / "live.mcap", None
    if is_recorded:
        writer = recordings.RecordingWriter(path, recordings.RecordingOptions(min_free=0))
    try:
        ran = asyncio.run(_ticks(record, each, writer, count))
    finally:
        if writer is not None:
            writer.close()
            path.unlink()
    period = 1_000_000_000 // _HZ
    # Lateness is the time from run to run beyond the period: a tick late by more than a period skips others.
    late = [max(0, after - before - period) for before, after in itertools.pairwise(ran)]
    faults: tuple[str, ...] = ()
    if writer is not None and (dropped := sum(writer.statistics.dropped.values())):
        faults = (f"{dropped} of {writer.statistics.offered} samples were dropped",)
    return Reading({}, count, pools={"lateness": late}, faults=faults)


def live_cases(folder: Path) -> tuple[Case, ...]:
    """The cases of a context of 100 Hz with and without a recorder in its process."""
    made = []
    for name, record, each in _LOADS:
        for is_recorded in (False, True):
            aims = (Aim(f"not recorded, {name}", Sense.AT_MOST, factor=1.0, extra=_BEYOND),) if is_recorded else ()
            title = f"{'recorded' if is_recorded else 'not recorded'}, {name}"
            what = "a context of 100 Hz beside the recorder" if is_recorded else "the same context without a recorder"
            run = partial(_live, folder, record, each, is_recorded)
            made.append(Case(title, what, _P99, run, 100, aims, columns=(_MAX,)))
    return tuple(made)


def _large(folder: Path, state: str, count: int) -> Reading:
    path = folder / f"large-{state}.mcap"
    if not path.exists():
        child.run(["-c", _RECORD, str(path), str(LARGE), state], timeout=120.0)
    found = json.loads(child.run(["-c", _LOOK, str(path)], timeout=120.0))
    faults: tuple[str, ...] = ()
    if not found["count"] == found["read"] == LARGE:
        faults = (f"{LARGE} samples were written, {found['count']} counted, {found['read']} read",)
    return Reading({name: found[name] for name in ("info", "seek", "memory")}, count, faults=faults)


def large_cases(folder: Path) -> tuple[Case, ...]:
    """The cases of opening a recording of a million samples, closed and unclosed."""
    aims = (
        Aim("", Sense.AT_MOST, factor=500.0, measure=_INFO),
        Aim("", Sense.AT_MOST, factor=100.0, measure=_SEEK),
        Aim("", Sense.AT_MOST, factor=64.0, measure=_MEMORY),
    )
    return tuple(
        Case(
            f"a million samples, {state}",
            "opened and described; the slowest of 19 seeks; memory of all that" if state == "closed" else "no index",
            _INFO,
            partial(_large, folder, state),
            1,
            aims,
            columns=(_SEEK, _MEMORY),
            warm=False,
        )
        for state in ("closed", "unclosed")
    )
