"""What the hot paths execute, counted exactly: bytecodes and Python calls of a sample and of a cycle.

A time is noise of a few per cent; a count is the same in every run, on any machine, beside anything. The bounds are
counts of each CPython, since its compiler decides what a line becomes. A change may lower them, and then lowers the
figure here; one that makes them larger slows down every system there is and needs another way.
"""

from __future__ import annotations

import asyncio
import gc
import selectors
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

import aiorts.testing
from aiorts import Component, Context, EventContext, InPort, Kernel, OutPort, PeriodicContext, SimulatedClock
from aiorts.testing.simulation import simulate
from aiorts.types import TimedDouble

CYCLES = 16
"""Counted one by one. The lower quartile is taken: what a late cycle does, or one longer than all before it, is no
part of what every cycle costs."""
FIRST = 3
"""Cycles that are not counted: CPython 3.13 learns in them that bytecodes are wanted."""

NOT_OURS = (
    *(str(Path(file).parent) for file in (asyncio.__file__, aiorts.testing.__file__)),
    selectors.__file__,
    __file__,
)
"""The event loop, simulated or not, and the hooks here: none of them is what is counted."""

VERSION = sys.version_info[:2]
BOUNDS: dict[str, dict[tuple[int, int], tuple[int, int]]] = {
    "write_nowait + read_nowait": {(3, 11): (48, 2), (3, 12): (44, 2), (3, 13): (44, 2)},
    "write_nowait to four readers": {(3, 11): (216, 7), (3, 12): (202, 7), (3, 13): (197, 7)},
    "write that waits for room": {(3, 11): (885, 42), (3, 12): (822, 42), (3, 13): (840, 42)},
    "event cycle": {(3, 11): (446, 12), (3, 12): (418, 12), (3, 13): (444, 12)},
    "event cycle, async": {(3, 11): (450, 12), (3, 12): (423, 12), (3, 13): (449, 12)},
    "event cycle, 3 members": {(3, 11): (1212, 32), (3, 12): (1139, 32), (3, 13): (1189, 32)},
    # In real time some comparison comes out otherwise in every other cycle: up to three bytecodes.
    "periodic cycle": {(3, 11): (898, 34), (3, 12): (843, 34), (3, 13): (816, 34)},
    "periodic cycle, simulated": {(3, 11): (765, 37), (3, 12): (717, 37), (3, 13): (715, 37)},
}
"""Path: CPython: bytecodes, and calls with the times that a suspended frame goes on."""


class Source(Component):
    """One out-port."""

    out = OutPort(TimedDouble)


class Sink(Component):
    """Reads what came."""

    inp = InPort(TimedDouble)

    def on_execute(self) -> None:
        self.inp.read_nowait()


class AsyncSink(Component):
    """Reads what came, as a coroutine."""

    inp = InPort(TimedDouble)

    async def on_execute(self) -> None:
        self.inp.read_nowait()


class Tick(Component):
    """Marks the cycles."""

    def __init__(self, name: str, count: Count) -> None:
        super().__init__(name)
        self.count = count
        self.enough = asyncio.Event()

    def on_execute(self) -> None:
        self.count.mark()
        if len(self.count.counts) >= FIRST + CYCLES:
            self.enough.set()


class Count:
    """Counts the bytecodes and the Python calls of this thread between two marks, while it is entered."""

    def __init__(self) -> None:
        self.counts: list[tuple[int, int]] = []
        """Of each cycle between two marks."""
        self._codes = self._calls = 0
        self._marked: tuple[int, int] | None = None
        self._ours: dict[CodeType, bool] = {}

    def __enter__(self) -> Count:
        self._before = sys.gettrace()
        self._collects = gc.isenabled()
        gc.disable()  # a collection calls back when it likes
        sys._getframe().f_trace_opcodes = True  # CPython 3.12 asks once, as tracing begins, whether anybody wants them
        sys.settrace(self._called)
        return self

    def __exit__(self, *_error: object) -> None:
        sys.settrace(self._before)
        if self._collects:
            gc.enable()

    def _called(self, frame: FrameType, _event: str, _argument: object) -> Any:
        code = frame.f_code
        ours = self._ours.get(code)
        if ours is None:
            ours = self._ours[code] = not code.co_filename.startswith(NOT_OURS)
        if not ours:
            return None
        self._calls += 1
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        return self._traced

    def _traced(self, _frame: FrameType, event: str, _argument: object) -> Any:
        self._codes += event == "opcode"
        return self._traced

    def mark(self) -> None:
        """One cycle is over and the next begins."""
        now = self._codes, self._calls
        if self._marked is not None:
            self.counts.append((now[0] - self._marked[0], now[1] - self._marked[1]))
        self._marked = now

    @property
    def cycle(self) -> tuple[int, int]:
        """Bytecodes and calls of one cycle."""
        codes, calls = (sorted(column)[CYCLES // 4] for column in zip(*self.counts[FIRST:], strict=True))
        return codes, calls


async def sample() -> Count:
    """One `write_nowait` and one `read_nowait`, connected with defaults."""
    async with Kernel() as kernel:
        source, sink = await kernel.create(Source), await kernel.create(Sink)
        await kernel.connect(source.out, sink.inp)
        write, read, value = source.out.write_nowait, sink.inp.read_nowait, TimedDouble(0, 1.0)
        for _ in range(300):
            write(value)
            read()
        with Count() as count:
            count.mark()
            for _ in range(FIRST + CYCLES):
                write(value)
                read()
                count.mark()
        return count


async def fanned() -> Count:
    """One `write_nowait` to four readers, which read it."""
    async with Kernel() as kernel:
        source = await kernel.create(Source)
        sinks = [await kernel.create(Sink) for _ in range(4)]
        for sink in sinks:
            await kernel.connect(source.out, sink.inp)
        write, value = source.out.write_nowait, TimedDouble(0, 1.0)
        with Count() as count:
            for _ in range(FIRST + CYCLES + 1):
                write(value)
                for sink in sinks:
                    sink.inp.read_nowait()
                count.mark()
        return count


async def blocked() -> Count:
    """One awaited `write` to a full buffer, whose reader reads one sample."""
    async with Kernel() as kernel:
        source, sink = await kernel.create(Source), await kernel.create(Sink)
        await kernel.connect(source.out, sink.inp, full="block", length=1)
        value = TimedDouble(0, 1.0)
        source.out.write_nowait(value)
        with Count() as count:
            for _ in range(FIRST + CYCLES + 1):
                writing = asyncio.ensure_future(source.out.write(value))
                await asyncio.sleep(0)
                sink.inp.read_nowait()
                await writing
                count.mark()
        return count


def event(kind: type[Sink | AsyncSink], members: int) -> Callable[[], Awaitable[Count]]:
    """A sample for each member wakes an event context that was asleep, and each reads its own."""

    async def main() -> Count:
        async with Kernel() as kernel:
            source = await kernel.create(Source)
            sinks = [await kernel.create(kind) for _ in range(members)]
            for sink in sinks:
                await kernel.connect(source.out, sink.inp)
            context: Context = await kernel.start(EventContext(), *sinks, activate=True)
            value = TimedDouble(0, 1.0)

            async def cycle() -> None:
                ticks = context.ticks
                source.out.write_nowait(value)
                for _ in range(8):  # it runs, gives the others a turn and sleeps again
                    await asyncio.sleep(0)
                assert context.ticks == ticks + 1

            for _ in range(300):
                await cycle()
            with Count() as count:
                count.mark()
                for _ in range(FIRST + CYCLES):
                    await cycle()
                    count.mark()
            return count

    return main


async def periodic(clock: SimulatedClock | None = None) -> Count:
    """A cycle of one member, from the beginning of its hook to the next."""
    async with Kernel() if clock is None else Kernel(clock=clock) as kernel:
        count = Count()
        tick = await kernel.add(Tick("tick0", count))
        # The timer of a start that may take 5 s lies in the queue for so long: it is no part of a cycle.
        await kernel.start(PeriodicContext(50.0), tick, activate=True, timeout=None)
        with count:
            await asyncio.wait_for(tick.enough.wait(), 30.0)
        return count


PATHS: dict[str, Callable[[], Count]] = {
    "write_nowait + read_nowait": lambda: asyncio.run(sample()),
    "write_nowait to four readers": lambda: asyncio.run(fanned()),
    "write that waits for room": lambda: asyncio.run(blocked()),
    "event cycle": lambda: asyncio.run(event(Sink, 1)()),  # type: ignore[arg-type]
    "event cycle, async": lambda: asyncio.run(event(AsyncSink, 1)()),  # type: ignore[arg-type]
    "event cycle, 3 members": lambda: asyncio.run(event(AsyncSink, 3)()),  # type: ignore[arg-type]
    "periodic cycle": lambda: asyncio.run(periodic()),
    "periodic cycle, simulated": lambda: simulate(periodic),
}


@pytest.mark.skipif(
    sys.implementation.name != "cpython" or VERSION > (3, 13), reason="nobody has counted the bytecodes of this Python"
)
@pytest.mark.parametrize("path", PATHS)
def test_a_hot_path_executes_no_more_than_it_did(path: str) -> None:
    count = PATHS[path]()
    codes, calls = count.cycle
    most_codes, most_calls = BOUNDS[path][VERSION]
    assert 0 < codes <= most_codes, f"bytecodes of a {path}, cycle by cycle: {count.counts}"
    assert 0 < calls <= most_calls, f"calls in a {path}, cycle by cycle: {count.counts}"
