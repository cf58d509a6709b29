"""Workloads on the ticks of execution contexts: components record when they ran, and a reading is made of that."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import replace
from itertools import repeat
from time import monotonic_ns, perf_counter_ns, process_time_ns
from typing import Any, Final, TypeAlias

from aiorts import Component, Context, EventContext, ExternalContext, InPort, Kernel, OutPort, PeriodicContext
from aiorts.types import TimedLongLong
from aiorts_bench.harness.case import Ledger, Measure, Reading
from aiorts_bench.punctuality.bare_clock import Marks
from aiorts_bench.punctuality.manipulator import Cell, ForceSensor, assemble
from aiorts_bench.punctuality.pacing import Ticks, Timing

PERIOD_NS: Final = 2_000_000
"""2 ms, as in the paper."""
FEWEST: Final = 12
"""The fewest ticks of a round: figures of fewer mean nothing."""
COMPONENTS: Final = 1000
"""Empty components of the cycle whose cost is measured."""
_FIRST: Final = 5
"""Ticks that are not recorded: the first ones load code and fill caches."""
_HOLD_NS: Final = 5_000_000
"""Nanoseconds that each callback of a busy loop runs."""
_SETTLED_S: Final = 0.55
"""Seconds after which the arm rests at the wall."""
_NEAR: Final = {"wall": 0.376}
"""The wall's place in metres: so near that the arm meets it in the shortest round."""
LATENESS: Final = Measure("lateness p50", "us", digits=1, pool="lateness", percent=50)
RATE_ERROR: Final = Measure("rate error", "ppm", digits=1)
"""Error of (ticks run + skipped) / elapsed, as `pacing.py` defines it; 100 ppm are 0.01 %."""
EXECUTED: Final = Measure("executed", "Hz", "more", digits=2)
INTERVAL: Final = Measure("interval p99", "ms", digits=3, pool="interval", percent=99)

MakeContext: TypeAlias = Callable[[float], Context]
"""Makes a context of a rate in Hz."""


class Stamper:
    """Records when the first hook of a context ran and when it was due, with the context's counts before and after."""

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
        """Record that the hook of `component` runs now, for the tick due at `due_ns`; None: due as its context says."""
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
        """Wait until all ticks are recorded, and return them; TimeoutError when some do not come."""
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
    """A member whose hook is an empty coroutine."""

    async def on_execute(self) -> None:
        pass


class Plain(Component):
    """A member whose hook is an empty plain function."""

    def on_execute(self) -> None:
        pass


class Stamped(Component):
    """The first member: records when it runs."""

    def __init__(self, name: str, stamper: Stamper) -> None:
        super().__init__(name)
        self.stamper = stamper

    def on_execute(self) -> None:
        self.stamper.stamp(self)


class StampedSensor(Stamped, ForceSensor):
    """The first member of the paper's four: records when it runs, and senses."""

    def on_execute(self) -> None:
        self.stamper.stamp(self)
        ForceSensor.on_execute(self)


class Pacer(Component):
    """Writes, in each tick, the time at which the tick was due."""

    out = OutPort(TimedLongLong)

    def on_execute(self) -> None:
        context: Any = self.context
        self.out.write_nowait(TimedLongLong(0, context.due_ns))


class Paced(Stamped):
    """A reader that runs after each write of a `Pacer`."""

    inp = InPort(TimedLongLong)
    received = 0

    def on_execute(self) -> None:
        self.stamper.stamp(self, self.inp.read_nowait().data)
        self.received += 1


class Ticked(Component):
    """The member of an external context; records when it runs."""

    def __init__(self, name: str, marks: Marks) -> None:
        super().__init__(name)
        self.marks = marks

    def on_execute(self) -> None:
        self.marks.ran_now(monotonic_ns())


def reading_of(ticks: Ticks, ledger: Ledger | None = None, faults: Iterable[str] = ()) -> Reading:
    """The figures of a series of ticks, by the names of the measures in `context.py` and `paper.py`."""
    timing = Timing.of(ticks)
    found = list(faults)
    if not ticks.complete:
        due = ticks.numbers[-1] + 1
        found.append(f"{len(ticks.due_ns)} ticks run + {ticks.skipped} skipped, but {due} were due")
    if ticks.counted is not None and ticks.counted != len(ticks.due_ns):
        found.append(f"{len(ticks.due_ns)} ticks ran and the context counted {ticks.counted}")
    values = {
        "deviation 99 %": timing.period_deviation_best / 1e3,
        "deviation": timing.period_deviation / 1e3,
        "period mean": timing.period_mean / 1e6,
        "rate error": abs(timing.rate_error) * 1e6,
        "skipped": float(ticks.skipped),
        "overruns": float(ticks.overruns),
        "cpu": timing.cpu_share * 100,
        "executed": timing.executed,
    }
    pools = {"lateness": ticks.lateness_ns, "period": ticks.periods_ns or ticks.intervals_ns}
    pools["interval"] = ticks.intervals_ns
    return Reading(values, len(ticks.due_ns), pools, ledger, tuple(found))


async def bare(run: Callable[[int, int], Awaitable[Ticks]], count: int) -> Reading:
    """Run a bare loop and give its figures."""
    return reading_of(await run(PERIOD_NS, max(FEWEST, count)))


DEVIATION_BEST: Final = Measure("deviation 99 %", "us", digits=1)
"""Standard deviation of the 99 % of the periods that are nearest to the nominal one."""


async def in_context(
    make: MakeContext, others: int, count: int, *, plain: bool = False, period_ns: int = PERIOD_NS
) -> Reading:
    """Run one member that records when it runs, and after it `others` empty ones with coroutines or `plain` hooks."""
    kind = Plain if plain else Empty
    count = max(FEWEST, count)
    stamper = Stamper(count)
    async with Kernel() as kernel:
        members: list[Component] = [await kernel.add(Stamped("stamped", stamper))]
        members += [await kernel.add(kind(f"empty{n}")) for n in range(others)]
        await kernel.start(make(1e9 / period_ns), *members, activate=True)
        return reading_of(await stamper.ticks(period_ns))


async def manipulator(make: MakeContext, count: int) -> Reading:
    """Run the paper's four components in one context; faults: a ledger out of balance, an arm that still moves."""
    count = max(FEWEST, count)
    stamper = Stamper(count)
    async with Kernel() as kernel:
        cell = await assemble(kernel, StampedSensor("force_sensor", stamper), begin=0.0, **_NEAR)
        context = await kernel.start(make(1e9 / PERIOD_NS), *cell.members, activate=True)
        ticks = await stamper.ticks(PERIOD_NS)
        await kernel.stop(context)
        return reading_of(ticks, faults=_faults(cell, ticks))


def _faults(cell: Cell, ticks: Ticks) -> list[str]:
    faults = [f"{one.name}: {one.last_error}" for one in cell.members if one.last_error is not None]
    faults += [
        f"{one.profile.name}: the ledger does not balance" for one in cell.connectors if not one.statistics.balanced
    ]
    written = min(one.statistics.written for one in cell.connectors)
    if written < len(ticks.ran_ns):
        faults.append(f"{written} samples were written in {len(ticks.ran_ns)} cycles")
    if len(ticks.ran_ns) * ticks.period_ns >= _SETTLED_S * 1e9 and not cell.settled:
        faults.append(f"the wall answers {cell.damper.force_x:.2f} N to a push of {cell.damper.push_x:.2f} N")
    return faults


async def event_paced(count: int) -> Reading:
    """Run an event context by the writes of a periodic one; lateness is from when the writer's tick was due."""
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
        found = replace(ticks, skipped=_left_out(ticks), overruns=0)
        faults = [] if found.skipped <= skipped else [f"{found.skipped} ticks are missing, the pacer skipped {skipped}"]
        return reading_of(found, Ledger.of(connector, paced.received), faults)


def _left_out(ticks: Ticks) -> int:
    """The number of ticks missing between the first and the last."""
    return ticks.numbers[-1] + 1 - len(ticks.due_ns)


async def external(count: int) -> Reading:
    """Tick an external context at absolute deadlines that `kernel.sleep` waits for."""
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
        counted = context.statistics.cycles - _FIRST
        ticks = replace(every, due_ns=every.due_ns[_FIRST:], ran_ns=every.ran_ns[_FIRST:], counted=counted)
        return reading_of(replace(ticks, skipped=_left_out(ticks)))


@asynccontextmanager
async def beside_busy() -> AsyncIterator[None]:
    """Keep the loop busy: one callback after the other runs for 5 ms."""

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
    """Await 1,000 coroutines one after the other, `count` times."""
    members = [_Bare() for _ in repeat(None, COMPONENTS)]
    began = perf_counter_ns()
    for _ in repeat(None, count):
        for member in members:
            await member.on_execute()
    return Reading.timed(count * COMPONENTS, perf_counter_ns() - began)


async def cycles(count: int) -> Reading:
    """Tick a context of 1,000 empty components `count` times, their failures contained and their hooks timed."""
    async with Kernel() as kernel:
        members = [await kernel.add(Empty(f"empty{n}")) for n in range(COMPONENTS)]
        context = ExternalContext()
        await kernel.start(context, *members, activate=True)
        await context.tick()
        began = perf_counter_ns()
        await context.tick(count)
        reading = Reading.timed(count * COMPONENTS, perf_counter_ns() - began)
        return replace(reading, faults=_untimed(context, count + 1))


def _untimed(context: ExternalContext, cycles: int) -> tuple[str, ...]:
    """The fault where hooks did not run once in each cycle, or were not timed."""
    hooks = context.statistics.hooks
    timed = [times.count for hook, times in hooks.items() if hook.endswith(".on_execute")]
    if timed == [cycles] * COMPONENTS:
        return ()
    return (f"{len(timed)} hooks of {COMPONENTS} were timed, {sum(timed)} runs of {cycles * COMPONENTS}",)
