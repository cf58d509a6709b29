"""Ticks of execution contexts: components that note when they ran, and the workloads that collect what they noted."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from itertools import repeat
from time import monotonic_ns, perf_counter_ns, process_time_ns
from typing import Any, Final, TypeAlias

from aiorts import Component, Context, EventContext, ExternalContext, InPort, Kernel, OutPort, PeriodicContext
from aiorts.bench.bare_clock import Marks
from aiorts.bench.case import Ledger, Measure, Reading
from aiorts.bench.manipulator import Cell, ForceSensor, assemble
from aiorts.bench.pacing import Ticks, Timing
from aiorts.types import TimedLongLong

__all__ = (
    "COMPONENTS",
    "FEWEST",
    "PERIOD_NS",
    "bare_awaits",
    "beside_busy",
    "cycles",
    "event_paced",
    "external",
    "in_context",
    "manipulator",
    "reading_of",
)

PERIOD_NS: Final = 2_000_000
"""2 ms, as in the paper."""
FEWEST: Final = 12
"""Ticks of a round at least: figures of fewer mean nothing."""
COMPONENTS: Final = 1000
"""Empty components of the cycle whose cost is measured."""
_FIRST: Final = 5
"""Ticks that are not noted: the first ones load code and fill caches."""
_HOLD_NS: Final = 5_000_000
"""How long a busy loop's callbacks run without giving the loop a turn."""
_SETTLED_S: Final = 0.55
"""Seconds after which the arm has met the wall and rests."""
_NEAR: Final = {"wall": 0.376}
"""Metres: so near that the arm meets the wall in the shortest round."""

MakeContext: TypeAlias = Callable[[float], Context]
"""Makes a context of a rate in Hz."""


class Stamper:
    """Notes when the first hook of a context ran and when that was due; counts what the context counted meanwhile."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.due = [0] * count
        self.ran = [0] * count
        self.number = -_FIRST
        self.done = asyncio.get_running_loop().create_future()
        self.before: tuple[Any, int] = (None, 0)
        self.after: tuple[Any, int] = (None, 0)
        self._loop = asyncio.get_running_loop()

    def stamp(self, component: Component, due_ns: int | None = None) -> None:
        """The hook of `component` runs now, for the tick that was due at `due_ns`; None asks its context."""
        now = component.clock.monotonic_ns()
        number = self.number
        self.number = number + 1
        if not 0 <= number < self.count:
            return
        context: Any = component.context
        self.ran[number] = now
        self.due[number] = context.due_ns if due_ns is None else due_ns
        if number == 0:
            self.before = (context.statistics, process_time_ns())
        if number == self.count - 1:
            self.after = (context.statistics, process_time_ns())
            self._loop.call_soon_threadsafe(self._finish)

    def _finish(self) -> None:
        if not self.done.done():
            self.done.set_result(None)

    async def ticks(self, period_ns: int) -> Ticks:
        """What there is when all ticks have been noted; TimeoutError when they do not come."""
        async with asyncio.timeout(30.0 + 10 * self.count * period_ns / 1e9):
            await self.done
        (before, began), (after, ended) = self.before, self.after
        return Ticks(
            period_ns,
            self.due,
            self.ran,
            after.skipped - before.skipped,
            after.overruns - before.overruns,
            ended - began,
            after.cycles - before.cycles + 1,
        )


class Empty(Component):
    """A member that does nothing, as a coroutine."""

    async def on_execute(self) -> None:
        pass


class Plain(Component):
    """A member that does nothing, as a plain function."""

    def on_execute(self) -> None:
        pass


class Stamped(Component):
    """The first member: notes when it runs."""

    def __init__(self, name: str, stamper: Stamper) -> None:
        super().__init__(name)
        self.stamper = stamper

    def on_execute(self) -> None:
        self.stamper.stamp(self)


class StampedSensor(ForceSensor):
    """The first member of the paper's four: notes when it runs, and senses."""

    def __init__(self, name: str, stamper: Stamper) -> None:
        super().__init__(name)
        self.stamper = stamper

    def on_execute(self) -> None:
        self.stamper.stamp(self)
        super().on_execute()


class Pacer(Component):
    """Writes in each of its ticks when that tick was due."""

    out = OutPort(TimedLongLong)

    def on_execute(self) -> None:
        context: Any = self.context
        self.out.write_nowait(TimedLongLong(0, context.due_ns))


class Paced(Component):
    """Runs when a `Pacer` wrote."""

    inp = InPort(TimedLongLong)

    def __init__(self, name: str, stamper: Stamper) -> None:
        super().__init__(name)
        self.stamper = stamper
        self.received = 0

    def on_execute(self) -> None:
        self.stamper.stamp(self, self.inp.read_nowait().data)
        self.received += 1


class Ticked(Component):
    """Runs when somebody ticks its context."""

    def __init__(self, name: str, marks: Marks) -> None:
        super().__init__(name)
        self.marks = marks

    def on_execute(self) -> None:
        self.marks.ran_now(monotonic_ns())


def reading_of(ticks: Ticks, ledger: Ledger | None = None, faults: Iterable[str] = ()) -> Reading:
    """The figures of a series of ticks, by the names of the measures in `context.py` and `paper.py`."""
    timing = Timing.of(ticks)
    told = list(faults)
    if not ticks.complete:
        due = ticks.numbers[-1] + 1
        told.append(f"{len(ticks.due_ns)} ticks run + {ticks.skipped} skipped, but {due} were due")
    if ticks.counted is not None and ticks.counted != len(ticks.due_ns):
        told.append(f"{len(ticks.due_ns)} ticks ran and the context counted {ticks.counted}")
    values = {
        "deviation 99 %": timing.period_deviation_best / 1e3,
        "deviation": timing.period_deviation / 1e3,
        "period mean": timing.period_mean / 1e6,
        "rate error": abs(timing.rate_error) * 1e6,
        "skipped": float(timing.skipped),
        "overruns": float(timing.overruns),
        "cpu": timing.cpu_share * 100,
        "executed": timing.executed,
    }
    pools = {"lateness": ticks.lateness_ns, "period": ticks.periods_ns or ticks.intervals_ns}
    pools["interval"] = ticks.intervals_ns
    return Reading(values, len(ticks.due_ns), pools, ledger, tuple(told))


DEVIATION_BEST: Final = Measure("deviation 99 %", "us", digits=1)
"""Standard deviation of the 99 % of the periods that are nearest to the nominal one."""


async def in_context(
    make: MakeContext, others: int, count: int, *, plain: bool = False, period_ns: int = PERIOD_NS
) -> Reading:
    """One member that notes when it runs, and `others` empty ones behind it, their hooks plain `def` or coroutines."""
    kind = Plain if plain else Empty
    count = max(FEWEST, count)
    stamper = Stamper(count)
    async with Kernel() as kernel:
        members: list[Component] = [await kernel.add(Stamped("stamped", stamper))]
        members += [await kernel.add(kind(f"empty{n}")) for n in range(others)]
        await kernel.start(make(1e9 / period_ns), *members, activate=True)
        return reading_of(await stamper.ticks(period_ns))


async def manipulator(make: MakeContext, count: int) -> Reading:
    """The paper's four components in one context; the ledgers balance, and the arm rests at the wall in the end."""
    count = max(FEWEST, count)
    stamper = Stamper(count)
    async with Kernel() as kernel:
        cell = await assemble(kernel, StampedSensor("force_sensor", stamper), begin=0.0, **_NEAR)
        context = await kernel.start(make(1e9 / PERIOD_NS), *cell.members, activate=True)
        ticks = await stamper.ticks(PERIOD_NS)
        await kernel.stop(context)
        return reading_of(ticks, faults=_faults(cell, ticks))


def _faults(cell: Cell, ticks: Ticks) -> list[str]:
    told = [f"{one.name}: {one.last_error}" for one in cell.members if one.last_error is not None]
    told += [
        f"{one.profile.name}: the ledger does not balance" for one in cell.connectors if not one.statistics.balanced
    ]
    written = min(one.statistics.written for one in cell.connectors)
    if written < len(ticks.ran_ns):
        told.append(f"{written} samples were written in {len(ticks.ran_ns)} cycles")
    if len(ticks.ran_ns) * ticks.period_ns >= _SETTLED_S * 1e9 and not cell.settled:
        told.append(f"the wall answers {cell.damper.force_x:.2f} N to a push of {cell.damper.push_x:.2f} N")
    return told


async def event_paced(count: int) -> Reading:
    """An event context whose member runs when one of a periodic context wrote; late since the tick of the writer."""
    count = max(FEWEST, count)
    stamper = Stamper(count)
    async with Kernel() as kernel:
        pacer = await kernel.add(Pacer("pacer"))
        paced = await kernel.add(Paced("paced", stamper))
        connector = await kernel.connect(pacer.out, paced.inp)
        await kernel.start(EventContext(), paced, activate=True)
        context = await kernel.start(PeriodicContext(1e9 / PERIOD_NS), pacer, activate=True)
        plan = context.statistics
        ticks = await stamper.ticks(PERIOD_NS)
        skipped = context.statistics.skipped - plan.skipped
        await kernel.stop(context)
        await asyncio.sleep(0)
        found = Ticks(PERIOD_NS, ticks.due_ns, ticks.ran_ns, _left_out(ticks), 0, ticks.cpu_ns, ticks.counted)
        told = [] if found.skipped <= skipped else [f"{found.skipped} ticks are missing, the pacer skipped {skipped}"]
        return reading_of(found, Ledger.of(connector, paced.received), told)


def _left_out(ticks: Ticks) -> int:
    """Ticks that are missing between the first and the last."""
    return ticks.numbers[-1] + 1 - len(ticks.due_ns)


async def external(count: int) -> Reading:
    """An external context, ticked at absolute deadlines that `kernel.sleep` waits for."""
    count = max(FEWEST, count)
    async with Kernel() as kernel:
        context = ExternalContext()
        marks = Marks(PERIOD_NS, count + _FIRST)
        member = await kernel.add(Ticked("ticked", marks))
        await kernel.start(context, member, activate=True)
        while marks.number < marks.count:
            await kernel.sleep((marks.next_ns - monotonic_ns()) / 1e9)
            await context.tick()
        every = marks.ticks()
        due, ran = every.due_ns[_FIRST:], every.ran_ns[_FIRST:]
        ticks = Ticks(PERIOD_NS, due, ran, 0, every.overruns, every.cpu_ns, context.statistics.cycles - _FIRST)
        return reading_of(Ticks(PERIOD_NS, due, ran, _left_out(ticks), every.overruns, every.cpu_ns, ticks.counted))


@asynccontextmanager
async def beside_busy() -> AsyncIterator[None]:
    """A loop that is hardly ever free: one callback after the other runs for 5 ms."""

    async def work() -> None:
        while True:
            until = perf_counter_ns() + _HOLD_NS
            while perf_counter_ns() < until:
                pass
            await asyncio.sleep(0)

    task = asyncio.create_task(work())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait([task])


class _Bare:
    async def on_execute(self) -> None:
        pass


async def bare_awaits(count: int) -> Reading:
    """1,000 coroutines awaited one after the other, `count` times."""
    members = [_Bare() for _ in repeat(None, COMPONENTS)]
    began = perf_counter_ns()
    for _ in repeat(None, count):
        for member in members:
            await member.on_execute()
    return Reading.timed(count * COMPONENTS, perf_counter_ns() - began)


async def cycles(count: int) -> Reading:
    """One context with 1,000 empty components, bulkhead and the timing of hooks on, ticked `count` times."""
    async with Kernel() as kernel:
        members = [await kernel.add(Empty(f"empty{n}")) for n in range(COMPONENTS)]
        context = ExternalContext()
        await kernel.start(context, *members, activate=True)
        await context.tick()
        began = perf_counter_ns()
        await context.tick(count)
        reading = Reading.timed(count * COMPONENTS, perf_counter_ns() - began)
        told = _untimed(context, count + 1)
        return Reading(reading.values, reading.messages, faults=told)


def _untimed(context: ExternalContext, cycles: int) -> tuple[str, ...]:
    """What is wrong with the counts of the hooks: each ran once a cycle and was timed."""
    hooks = context.statistics.hooks
    timed = [times.count for hook, times in hooks.items() if hook.endswith(".on_execute")]
    if timed == [cycles] * COMPONENTS:
        return ()
    return (f"{len(timed)} hooks of {COMPONENTS} were timed, {sum(timed)} runs of {cycles * COMPONENTS}",)
