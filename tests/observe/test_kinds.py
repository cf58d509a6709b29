"""Everything that the observers and listeners of OpenRTM have a kind for is told here, and none of it is empty."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, ClassVar

import pytest

from aiorts import (
    Component,
    EventPort,
    ExternalContext,
    InPort,
    Kernel,
    OutPort,
    Param,
    PeriodicContext,
    SimulatedClock,
    StateMachineComponent,
    WouldBlock,
)
from aiorts.events import (
    ComponentAdded,
    ComponentBeat,
    ComponentRemoved,
    ConfigurationSetActivated,
    ConfigurationSetAdded,
    ConfigurationSetChanged,
    ConfigurationSetRemoved,
    Connected,
    ConnectorChanged,
    ConnectorEvent,
    ConnectorEventKind,
    ContextBeat,
    ContextStarted,
    ContextStopped,
    Disconnected,
    Event,
    MachineAfter,
    MachineBefore,
    MachineChanged,
    MemberAdded,
    MemberRemoved,
    ParameterAdded,
    ParameterChanged,
    ParameterRemoved,
    ParametersChanged,
    PortAdded,
    PortRemoved,
    RateChanged,
    StateChanged,
)
from aiorts.statechart import Chart, On, State
from aiorts.testing import simulated
from aiorts.types import TimedBoolean, TimedDouble

if TYPE_CHECKING:
    from collections.abc import Callable


class Door(StateMachineComponent):
    button = EventPort(TimedBoolean)
    pace = Param(1.0)
    configurations: ClassVar = {"slow": {"pace": 0.5}}
    fails = False
    chart = Chart(
        State("closed", On("button", to="open", action="moves"), On("again"), initial=True, do="rests", exit="leaves"),
        State("open", entry="enters"),
        init="begins",
    )

    def moves(self) -> None: ...
    def rests(self) -> None:
        if self.fails:
            raise ValueError("told to")

    def leaves(self) -> None: ...
    def enters(self) -> None: ...
    def begins(self) -> None: ...


class Source(Component):
    out = OutPort(TimedBoolean)


KINDS: dict[str, tuple[type[Event], ...]] = {
    "COMPONENT_PROFILE": (ComponentAdded, ComponentRemoved, ParameterAdded, ParameterRemoved),
    "RTC_STATUS": (StateChanged, ComponentRemoved),
    "EC_STATUS": (ContextStarted, ContextStopped, MemberAdded, MemberRemoved, RateChanged),
    "PORT_PROFILE": (PortAdded, PortRemoved, Connected, ConnectorChanged, Disconnected),
    "CONFIGURATION": (
        ConfigurationSetAdded,
        ConfigurationSetChanged,
        ConfigurationSetRemoved,
        ConfigurationSetActivated,
        ParametersChanged,
        ParameterChanged,
    ),
    "RTC_HEARTBEAT": (ComponentBeat,),
    "EC_HEARTBEAT": (ContextBeat,),
    "FSM_PROFILE": (PortAdded, PortRemoved),
    "FSM_STATUS": (MachineBefore, MachineAfter, MachineChanged),
    "FSM_STRUCTURE": (ComponentAdded,),
}
"""OpenRTM's kinds of status; COMPONENT_PROFILE, FSM_PROFILE and FSM_STATUS are never told there."""


@pytest.mark.row(105)
@simulated
async def test_all_ten_kinds_of_status_are_told_with_what_they_are_about(simulated_clock: SimulatedClock) -> None:
    heard: list[Any] = []
    async with Kernel() as kernel:
        for kind in {kind for kinds in KINDS.values() for kind in kinds}:
            kernel.bus.subscribe(kind, heard.append)
        kernel.heartbeat(1.0)
        door, source = await kernel.add(Door("door")), await kernel.add(Source("source"))
        assert door.machine.structure.states  # FSM_STRUCTURE: the table that runs can be had once it is told of
        context = await kernel.start(PeriodicContext(100.0))
        await context.add(door)
        await context.activate(door)
        wire = await kernel.connect(source.out, door.button)
        wire.change(length=3)
        door.add_event_port("again", EventPort(TimedBoolean))  # FSM_PROFILE: an event is bound, and set free
        door.remove_port("again")
        source.out.write_nowait(TimedBoolean(0, True))
        await simulated_clock.advance(1.1)
        await context.set_rate(50.0)
        await door.configure(pace=2.0)
        await door.configuration.add("fast", {"pace": 4.0})
        await door.configuration.change("fast", {"pace": 5.0})
        await door.configuration.activate("fast")
        await door.configuration.remove("slow")
        await door.add_param("speed", Param(1.0))
        await door.remove_param("speed")
        await context.deactivate(door)
        door.fails = True
        await context.activate(door)
        await simulated_clock.advance(0.1)
        await kernel.disconnect(wire)
        await context.remove(door)
        await context.stop()
        await kernel.remove(door)
        told = {kind: [event for event in heard if type(event) is kind] for kind in {type(e) for e in heard}}
    for name, kinds in KINDS.items():
        for kind in kinds:
            assert told.get(kind), f"{name}: no {kind.__name__}"
    states = [(event.old.value, event.new.value) for event in told[StateChanged]]
    assert ("inactive", "active") in states
    assert ("active", "inactive") in states
    assert ("active", "error") in states
    moments = ["init", "entry", "do", "exit", "transition", "state_change"]
    for kind in (MachineBefore, MachineAfter):
        assert {event.what for event in told[kind]} == set(moments)
    assert [event.error for event in told[MachineAfter] if event.error is not None] == [door.last_error]
    assert {"again", "button"} <= {event.port.name for event in told[PortAdded]}
    assert (told[ContextBeat][0].context, told[ContextBeat][0].progressed) == (context.name, True)
    assert {event.component for event in told[ComponentBeat]} == {"door", "source"}


class Writer(Component):
    out = OutPort(TimedDouble)


class Reader(Component):
    into = InPort(TimedDouble)


@pytest.mark.row(47)
@simulated
async def test_each_kind_of_connector_listeners_fires(
    simulated_clock: SimulatedClock,
) -> None:
    """In OpenRTM ON_BUFFER_OVERWRITE and most kinds of pull connections never fire (OpenRTM-aist#645)."""
    heard: list[ConnectorEvent] = []
    sample = TimedDouble(0, 1.0)
    async with Kernel() as kernel:
        kernel.bus.subscribe(ConnectorEvent, heard.append)
        writer, reader = await kernel.add(Writer("writer")), await kernel.add(Reader("reader"))
        context = await kernel.start(ExternalContext(), reader, activate=True)

        async def connected(use: Callable[[], Any], **options: Any) -> None:
            wire = await kernel.connect(writer.out, reader.into, **options)
            result = use()
            if result is not None:
                with pytest.raises(TimeoutError):
                    await result
            await asyncio.sleep(0)
            await kernel.disconnect(wire)

        def twice() -> None:
            for _ in range(2):
                writer.out.write_nowait(sample)
            reader.into.drain()

        async def in_vain() -> None:
            writer.out.write_nowait(sample)
            await writer.out.write(sample)

        async def asks() -> None:
            with pytest.raises(WouldBlock):
                reader.into.read_nowait()
            async with asyncio.timeout(0.1):
                await reader.into.read()

        await connected(twice, length=1)
        await connected(twice, subscription="new", push="skip", skip=1)
        await connected(twice, subscription="new", push="new")
        await connected(in_vain, length=1, full="block", timeout=0.1)
        await connected(asks)
        await connected(asks, dataflow="pull")

        async def too_late() -> None:
            writer.out.write_nowait(sample)
            await asyncio.sleep(0.2)
            await asks()

        await connected(too_late, lifespan=0.1)
        await connected(twice, convert=lambda sample: None)
        wire = await kernel.connect(writer.out, reader.into)
        await context.deactivate(reader)
        writer.out.write_nowait(sample)
        await kernel.disconnect(wire)
        wire = await kernel.connect(writer.out, reader.into, dataflow="pull")
        run = await kernel.start(ExternalContext(), writer, activate=True)
        await run.stop()
        with pytest.raises(WouldBlock):
            reader.into.read_nowait()
        await kernel.disconnect(wire)
        await asyncio.sleep(0)
        assert {event.kind for event in heard} == set(ConnectorEventKind)
        assert (
            len(ConnectorEventKind) == 17 + 4
        )  # OpenRTM's, and our own for what is left out, not converted or too old
