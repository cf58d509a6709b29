"""A kernel in a process of its own that may stand still at one step of finding, greeting, offering or answering.

`python held_program.py SETTINGS`, which say: `role` (a method of `Roles`), `zenoh` (settings of the service, where
there are any), `step` (a method of `BaseTransport`), `call` (which call of it), `seconds` (for how long a hook blocks
there; 0: the process stops itself). It tells what it does and reads in lines of JSON on its standard output, with the
time.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from aiorts import Component, Composite, EventContext, InPort, Kernel, LifecycleState, OutPort, PeriodicContext
from aiorts.errors import AiortsError, WiringError
from aiorts.links import BaseTransport
from aiorts.supervision import Supervision
from aiorts.types import TimedLong
from isolation.isolated_parts import Scale
from remote_gripper import Gripper

EVERY = 0.02


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong, length=10_000)


def tell(what: str, **more: Any) -> None:
    print(json.dumps({"what": what, "t": time.monotonic(), **more}), flush=True)


def hold_at(step: str, call: int, seconds: float) -> None:
    """Have this process stand still at a call of a method of all transports."""
    original: Callable[..., Any] = getattr(BaseTransport, step)
    calls = 0

    def held(*args: Any, **kwargs: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == call:
            tell("held", step=step, blocks=bool(seconds))
            if seconds:
                time.sleep(seconds)
                tell("free")
            else:
                os.kill(os.getpid(), signal.SIGSTOP)
        return original(*args, **kwargs)

    setattr(BaseTransport, step, held)


async def write(out: Any) -> None:
    """Write who writes, for ever."""
    while True:
        out.write_nowait(TimedLong(0, os.getpid()))
        await asyncio.sleep(EVERY)


async def read(sink: Any) -> None:
    """Tell who has written, for ever."""
    while True:
        sample = await sink.inp.read(timeout=None)
        sink.inp.drain()
        tell("read", of=sample.data)
        await asyncio.sleep(EVERY)


class Roles:
    """What the programs do."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self.services = {"links": {}, **({"zenoh": settings["zenoh"]} if settings.get("zenoh") else {})}

    @asynccontextmanager
    async def kernel(self, name: str, **services: Any) -> AsyncIterator[Kernel]:
        async with Kernel(name, services={**self.services, **services}) as kernel:
            yield kernel

    async def reader(self) -> None:
        """A sink that others connect."""
        async with self.kernel("rd") as kernel:
            sink = await kernel.add(Sink("snk"))
            tell("ready")
            await read(sink)

    async def writer(self) -> None:
        """A source that connects itself with the sink."""
        async with self.kernel("wr") as kernel:
            source = await kernel.add(Source("src"))
            tell("ready")
            await kernel.connect(source.out, "rd/snk.inp")
            await write(source.out)

    async def isolating(self) -> None:
        """A source and a sink with an isolated component between them, which is restarted when it is killed."""
        async with self.kernel("whole") as kernel:
            source, sink = await kernel.add(Source("src")), await kernel.add(Sink("snk"))
            part = await kernel.create_isolated(Scale, "part", factor=1)
            await kernel.connect(source.out, "part.inp")
            await kernel.connect("part.out", sink.inp)
            await kernel.start(EventContext(name="apart"), part, activate=True)
            kernel.supervise(part, Supervision("reset", backoff=0.05, backoff_max=0.05, budget=100, window=1_000.0))
            tasks = [asyncio.ensure_future(one) for one in (write(source.out), read(sink))]
            before = None
            while not any(task.done() for task in tasks):
                pid: Any = part
                if part.state is LifecycleState.ACTIVE and pid.pid != before:
                    before = pid.pid
                    tell("ready", part=before)
                await asyncio.sleep(0.01)

    async def holding(self) -> None:
        """A composite with a member elsewhere, which is reset where it is lost."""
        async with self.kernel("right") as kernel:
            source, sink = await kernel.add(Source("src")), await kernel.add(Sink("snk"))
            while True:
                try:
                    arm = await kernel.add(Composite("arm", "left/gripper", exported=["gripper.*"]))
                    break
                except AiortsError:
                    await asyncio.sleep(0.1)
            for ends in ((source.out, arm.ports["inp"]), (arm.ports["force"], sink.inp)):
                with suppress(WiringError):  # it was offered already, as the kernel before had asked
                    await kernel.connect(*ends)
            tasks = [asyncio.ensure_future(one) for one in (write(source.out), read(sink))]
            await kernel.start(PeriodicContext(50.0), arm)
            tell("ready")
            while not any(task.done() for task in tasks):
                try:
                    if arm.state is LifecycleState.ERROR:
                        await arm.reset()
                    if arm.state is LifecycleState.INACTIVE:
                        await arm.activate()
                except AiortsError:
                    pass  # it is not back yet
                await asyncio.sleep(0.05)

    async def member(self) -> None:
        """The kernel of that member."""
        async with self.kernel("left", control={"name": "left"}) as kernel:
            gripper = await kernel.create(Gripper, "gripper", factor=1)
            await kernel.start(PeriodicContext(100.0), gripper)
            tell("ready")
            await asyncio.Event().wait()


if __name__ == "__main__":
    given = json.loads(sys.argv[1])
    if given.get("step"):
        hold_at(given["step"], given["call"], given["seconds"])
    asyncio.run(getattr(Roles(given), given["role"])())
