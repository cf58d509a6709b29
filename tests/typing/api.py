"""The public interface as a type checker sees it: not run, but checked by mypy and pyright (`test_typing.py`)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from typing import Annotated, Any, ClassVar, Protocol, Unpack, assert_type

from aiorts import (
    Component,
    Configuration,
    Connection,
    ConnectOptions,
    Connector,
    Goal,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    Param,
    PeriodicContext,
    Provided,
    Required,
    ServiceConnector,
    ServicePort,
    component,
)
from aiorts.events import ParameterChanged
from aiorts.observe import Samples
from aiorts.testing import Rig
from aiorts.types import TimedDouble, TimedLong


class Pid(Component):
    measured = InPort(TimedDouble, unit="m")
    command = OutPort(TimedDouble)
    gain = Param(1.0, ge=0.0)
    label = Param("fast")

    async def on_execute(self) -> None:
        sample = await self.measured.read()
        assert_type(sample, TimedDouble)
        assert_type(self.measured.latest, TimedDouble | None)
        assert_type(self.measured.read_nowait(), TimedDouble)
        assert_type(self.measured.drain(), list[TimedDouble])
        assert_type(self.gain, float)
        assert_type(self.label, str)
        assert_type(await self.command.write(TimedDouble(0, sample.data)), bool)
        await self.command.write(TimedLong(0, 1))  # error: not the port's type
        async for one in self.measured:
            assert_type(one, TimedDouble)


class Brake(Protocol):
    async def stop(self, force: float = 1.0) -> float: ...

    def held(self) -> bool: ...


class Arm(Component):
    brake = Required[Brake]()

    async def on_execute(self) -> None:
        assert_type(self.brake, Required[Brake])
        assert_type(self.brake.proxy, Brake)
        assert_type(await self.brake.proxy.stop(2.0), float)
        assert_type(await self.brake.within(0.1).stop(force=2.0), float)
        assert_type(self.brake.proxy.held(), bool)
        assert_type(self.brake.proxies, tuple[Brake, ...])
        await self.brake.proxy.stop("hard")  # error: not a float
        await self.brake.proxy.release()  # error: no such method
        await self.brake.wait_bound()


class BrakeRtc(Component):
    service = Provided[Brake](concurrent=True)

    def stop(self, force: float = 1.0) -> float:
        return force

    def held(self) -> bool:
        return True

    def on_execute(self) -> None:
        assert_type(self.add_port("more", Required[Brake]()), Required[Brake])
        assert_type(self.add_port("mine", Provided[Brake](self)), Provided[Brake])


class Moving(Protocol):
    async def move(self, metres: float) -> Goal[float, str]: ...


class Axis(Component):
    service = Provided[Moving](cancel_timeout=0.5)
    goal: Goal[float, str] | None = None

    def move(self, metres: float) -> Goal[float, str]:
        self.goal = Goal()
        return self.goal

    def on_execute(self) -> None:
        if self.goal is not None and not self.goal.cancel_requested:
            assert_type(self.goal.feedback(1.0), bool)
            self.goal.feedback("far")  # error: not the type of feedback
            self.goal.succeed(1.0)  # error: not the type of the result
            self.goal.fail(OSError())
            self.goal.fail("no power")
            self.goal.cancelled()


class Mover(Component):
    axis = Required[Moving]()

    async def on_execute(self) -> None:
        goal = await self.axis.proxy.move(1.0)
        assert_type(goal, Goal[float, str])
        async for feedback in goal:
            assert_type(feedback, float)
        assert_type(await goal.result(timeout=1.0), str)
        assert_type(goal.state == "running", bool)
        goal.cancel()


def blocking(arm: Arm) -> None:
    assert_type(arm.brake.call_blocking(lambda brake: brake.stop(1.0)), float)


async def services(kernel: Kernel, arm: Arm, brake: BrakeRtc, port: ServicePort) -> None:
    assert_type(await kernel.connect(arm.brake, brake.service), ServiceConnector)
    assert_type(await kernel.connect(arm.brake, brake.service, mapping={"brake": "service"}), ServiceConnector)
    assert_type(await kernel.connect(arm.brake, arm.brake, brake.service), Connection[ServiceConnector])
    assert_type(await kernel.connect("arm0.brake", arm.brake, "brake0.service"), Connection[ServiceConnector])
    assert_type(await kernel.connect("arm0.brake", brake.service), ServiceConnector)
    assert_type(await kernel.connect(arm.brake, "brake0.service", strict=False), ServiceConnector)
    assert_type(await kernel.connect("arm0.brake", "arm1.brake", brake.service), Connection[ServiceConnector])
    assert_type(await kernel.connect(port, "brake0.service"), ServiceConnector)
    assert_type(await kernel.connect("arm0.brake", port, port), Connection[ServiceConnector])
    await kernel.connect(arm.brake, arm)  # error: a component is no port
    await kernel.connect(arm.brake, brake.service, arm)  # error: a component is no port
    await kernel.connect(arm.brake, brake.service, stric=False)  # error: no such option


def even(value: int) -> None:
    """Refuses an odd number."""


class Tuned(Component):
    count = Param(4, constraint="x>=0", validator=even)
    inputs = Param(1)
    word = Param("a", validator=even)  # error: a validator of another type
    configurations: ClassVar = {"many": {"count": 40}}

    def check_configuration(self, values: Mapping[str, Any]) -> None:
        assert_type(self.count, int)

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[TimedLong]]:
        return {"in0": InPort(TimedLong)}

    def on_execute(self) -> None:
        self.configuration.activate_soon("many")


class Plain(Component):
    def on_execute(self) -> None:
        port = self.add_port("more", InPort(TimedLong))
        assert_type(port, InPort[TimedLong])

    def on_error(self, error: BaseException) -> None:
        assert_type(self.last_error, BaseException | None)


def add(a: float, b: float = 0.0) -> float:
    return a + b


@component
def scale(a: float, *, gain: float = Param(2.0, ge=0.0)) -> float:
    return a * gain


@component(when="all", output=("smaller", "larger"))
def ordered(a: Annotated[float, InPort(TimedDouble, unit="m")], b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)


@component
async def source() -> AsyncIterator[float]:
    yield 1.0


component(add, when="always")  # error: not one of the choices
component(7)  # error: not a function


async def functions(kernel: Kernel) -> None:
    made = await kernel.create(component(add), "adder0")
    await kernel.connect(made.output, (await kernel.create(scale)).a, full="block")
    await kernel.add(ordered("ordered0"), source("source0"))  # error: one at a time
    await made.configure(gain=2.0)
    assert_type(made.name, str)


async def link(kernel: Kernel, pid: Pid, **options: Unpack[ConnectOptions]) -> None:
    assert_type(await kernel.connect(pid.command, pid.measured, **options), Connector)


async def options(kernel: Kernel, pid: Pid, rig: Rig) -> None:
    every: ConnectOptions = {"full": "block", "length": 4, "timeout": None}
    await link(kernel, pid, **every)
    await link(kernel, pid, subscription="periodic", push="fifo", push_rate=10, openrtm={"dataport.io_mode": "new"})
    await kernel.connect(pid.command, pid.measured, dataflow="pull", stamp="read", name="wire", allow_duplicate=True)
    assert_type(rig.connect("pid0.command", pid.measured, full="reject"), Connector)
    assert_type(await kernel.connect("pid0.command", "pid1.measured", full="block"), Connector)
    assert_type(await kernel.connect(pid.command, "pid1.measured"), Connector)
    assert_type(await kernel.connect(pid.command, pid.measured, convert=add), Connector)
    assert_type(await kernel.connect(pid.command, "pid1.measured", "pid2.measured"), Connection[Connector])
    assert_type(await kernel.connect("pid0.command", "pid1.measured", "pid2.measured"), Connection[Connector])
    assert_type(asyncio.create_task(kernel.connect(pid.command, pid.measured)), asyncio.Task[Connector])
    await kernel.connect("pid0.command", pid, full="block")  # error: a component is no port
    await kernel.activate("pid0", context="main")
    await kernel.reset(pid, context=PeriodicContext(rate=1.0), timeout=None)
    await kernel.deactivate(pid.command)  # error: a port is no component
    await kernel.connect(pid.command, pid.measured, full="drop")  # error: no such word
    await kernel.connect(pid.command, pid.measured, convert=4)  # error: not a function
    await kernel.connect(pid.command, pid.measured, lenght=4)  # error: no such option
    await kernel.connect(pid.command, pid.measured, pid.measured, lenght=4)  # error: no such option
    await kernel.connect(pid.command, pid.measured, length="4")  # error: not a number
    await link(kernel, pid, strict="no")  # error: not a bool
    wire = await kernel.connect(pid.command, pid.measured)
    wire.change(push_rate=5, length=3, full="block")
    wire.change(full="drop")  # error: no such word
    wire.change(skip=2)  # error: cannot be changed
    (await kernel.connect(pid.command, pid.measured, pid.measured)).close()
    rig.connect("pid0.command", pid.measured, subscription="always")  # error: no such word


async def samples(kernel: Kernel, pid: Pid) -> None:
    assert_type(kernel.samples(pid.command), Samples[TimedDouble])
    assert_type(kernel.samples("pid.command", keep_last=True), Samples[Any])
    async for sample in kernel.samples(pid.command, length=1):
        assert_type(sample, TimedDouble)
    kernel.samples(pid.measured)  # error: an in-port


async def main() -> None:
    async with Kernel() as kernel:
        assert_type(kernel, Kernel)
        pid = await kernel.add(Pid("pid0"))
        assert_type(pid, Pid)
        assert_type(await kernel.create(Pid), Pid)
        assert_type(await kernel.create("Pid"), Component)
        assert_type(await kernel.connect(pid.command, pid.measured, subscription="new"), Connector)
        assert_type(await kernel.connect(pid.command, pid.command, pid.measured), Connection[Connector])
        context = await kernel.start(PeriodicContext(rate=500.0), pid)
        assert_type(context, PeriodicContext)
        assert_type(context.state(pid), LifecycleState)
        assert_type(kernel.components, Mapping[str, Component])
        await context.activate(pid.measured)  # error: not a component
        value: Any = pid.params["gain"].value
        pid.gain = "fast"  # error: not a float
        del value
        tuned = await kernel.create(Tuned)
        assert_type(tuned.configuration, Configuration)
        assert_type(tuned.configuration.active, str)
        assert_type(tuned.configuration.sets, Mapping[str, Mapping[str, Any]])
        await tuned.configuration.change("many", {"count": 5})
        await tuned.configuration.activate(5)  # error: not a name
        await tuned.add_param("mass", Param(1.0, unit="kg"))
        kernel.bus.subscribe(ParameterChanged, lambda event: print(event.old, event.new, event.set))
        await kernel.save_configuration("conf.toml", tuned)
        for difference in await kernel.diff_configuration("conf.toml"):
            assert_type(difference.kind, str)
