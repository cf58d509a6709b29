"""Run a system under a simulated clock and print everything that happened. Usage: whole_system.py simulated|uvloop

Three periodic contexts of unequal rates, an event context, edges of every subscription, fan-in, a component that fails
and is reset, parameters, rates, members and connections that change on the way.
"""

from __future__ import annotations

import asyncio
import sys
from typing import Any

from aiorts import (
    Component,
    EventContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    Param,
    PeriodicContext,
    SimulatedClock,
)
from aiorts.kernel.loop.bus import Event, HookAfter, HookBefore, HookFailed
from aiorts.testing.simulation import simulate
from aiorts.types import TimedDouble, TimedLong

LOG: list[str] = []


class Counter(Component):
    """Counts."""

    count = OutPort(TimedLong, stamp="write")
    step = Param(1)
    value: int = 0

    async def on_execute(self) -> None:
        self.value += self.step
        await self.count.write(TimedLong(0, self.value))


class Mean(Component):
    """Sends the mean of what came in; fails now and then; takes its time."""

    input = InPort(TimedLong)
    mean = OutPort(TimedDouble, stamp="write")
    hurried = Param(False)
    runs: int = 0

    async def on_execute(self) -> None:
        self.runs += 1
        if self.runs % 97 == 0:
            raise ValueError(f"run {self.runs} failed")
        if self.runs % 5 == 0 and not self.hurried:
            await self.sleep(0.0413)
        taken = [sample.data for sample in self.input.drain()]
        if taken:
            await self.mean.write(TimedDouble(0, sum(taken) / len(taken)))

    async def on_reset(self) -> None:
        await self.sleep(0.003)


class Log(Component):
    """Writes down what it reads, from where and when."""

    longs = InPort(TimedLong)
    doubles = InPort(TimedDouble)

    async def on_execute(self) -> None:
        now = self.clock.time_ns()
        for port in (self.longs, self.doubles):
            while port.is_new:
                sample: Any = port.read_nowait()
                source = port.last_source
                LOG.append(f"{now} {self.name} {sample.tm} {sample.data!r} {source.name if source else None}")
        await asyncio.sleep(0)


def write_down(kernel: Kernel, event: Event) -> None:
    LOG.append(f"{kernel.clock.time_ns()} {event!r}")


async def system(clock: SimulatedClock) -> None:
    kernel = Kernel(clock=clock)
    kernel.bus.subscribe(Event, lambda event: write_down(kernel, event))
    kernel.bus.subscribe(HookBefore, lambda event: write_down(kernel, event))
    kernel.bus.subscribe(HookAfter, lambda event: write_down(kernel, event))
    async with kernel:
        fast, slow = await kernel.add(Counter("fast")), await kernel.add(Counter("slow"), step=100)
        mean, echo, log = await kernel.add(Mean("mean")), await kernel.add(Mean("echo")), await kernel.add(Log("log"))
        connectors = [
            await kernel.connect(fast.count, mean.input, subscription="new"),
            await kernel.connect(slow.count, mean.input, subscription="flush", length=3),
            await kernel.connect(
                fast.count, log.longs, subscription="periodic", push_rate=13.0, push="skip", skip=2, out_length=50
            ),
            await kernel.connect(slow.count, log.longs, subscription="flush", length=4, full="reject"),
            await kernel.connect(mean.mean, log.doubles, subscription="new", push="all", length=16),
            await kernel.connect(fast.count, echo.input, subscription="flush", length=2),
            await kernel.connect(echo.mean, log.doubles, subscription="periodic", push_rate=3.7),
        ]
        first = await kernel.start(PeriodicContext(100.0, name="first"), fast, activate=True)
        second = await kernel.start(PeriodicContext(33.3, overrun="catch_up", name="second"), slow, mean, activate=True)
        third = await kernel.start(PeriodicContext(7.0, name="third"), log, fast, activate=True)
        events = await kernel.start(EventContext(name="events"), echo, activate=True)
        contexts = (first, second, third, events)

        def heal(event: HookFailed) -> None:
            if event.hook == "on_execute":
                tasks.append(asyncio.ensure_future(reset(event.component)))

        async def reset(name: str) -> None:
            component = kernel.components[name]
            await kernel.sleep(0.25)
            context = component.context
            if context.state(component) is LifecycleState.ERROR:
                await context.reset(component)
                await context.activate(component)

        tasks: list[asyncio.Future[None]] = []
        kernel.bus.subscribe(HookFailed, heal)
        await clock.advance(4.0)
        # Not awaited: a hook may be waiting for time, and on a loop of its own only `advance` lets it pass.
        tasks.append(asyncio.ensure_future(first.set_rate(250.0)))
        tasks.append(asyncio.ensure_future(slow.configure(step=7)))
        await clock.advance(3.3)
        tasks.append(asyncio.ensure_future(third.remove(fast)))
        await kernel.disconnect(connectors[1])
        await clock.advance(4.7)
        # A hook that waits for time when the kernel closes would get it on the simulated loop only.
        tasks += [asyncio.ensure_future(component.configure(hurried=True)) for component in (mean, echo)]
        await clock.advance(0.1)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        LOG.extend(f"{connector!r} {connector.statistics!r}" for connector in connectors)
        LOG.extend(f"{context!r} {context.profile!r} {context.statistics!r}" for context in contexts)
        LOG.append(repr([*kernel.components.values(), kernel]))


def main(loop: str) -> None:
    clock = SimulatedClock(1_700_000_000_000_000_000)
    if loop == "simulated":
        simulate(system, clock=clock)
    elif loop == "uvloop":
        import uvloop

        uvloop.run(system(clock))
    else:
        asyncio.run(system(clock))
    for line in LOG:  # one by one: an unbuffered standard output forgets what a pipe did not take at once
        sys.stdout.write(f"{line}\n")


if __name__ == "__main__":
    main(sys.argv[1])
