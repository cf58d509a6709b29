"""Ports that exist while parameters say so: they come and go together with the values; what stays loses nothing."""

from __future__ import annotations

import asyncio
import random
import threading
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import (
    Component,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    OutPort,
    Param,
    PeriodicContext,
    RealtimeContext,
    ThreadContext,
)
from aiorts.errors import ClosedError, ConfigurationError, DeclarationError
from aiorts.events import Connected, Disconnected, ParameterChanged, ParametersChanged, PortAdded, PortRemoved
from aiorts.testing import simulate, simulated
from aiorts.types import TimedDouble, TimedLong
from config_parts import Many, Source, hear

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aiorts import Context


@pytest.mark.row(124)
@simulated
async def test_a_running_components_interface_changes_and_everyone_sees_it() -> None:
    """OpenRTM's Flexi components take their interface from the command line and keep it; tools see a copy."""
    async with Kernel() as kernel:
        many, source = await kernel.add(Many("many")), await kernel.add(Source("source"))
        assert list(many.ports) == ["out", "in0"]
        context = await kernel.start(ExternalContext(), many, activate=True)
        stays = many.ports["in0"]
        connector = await kernel.connect(source.out, stays)
        source.out.write_nowait(TimedLong(0, 1))
        heard = hear(kernel)
        await many.configure(inputs=3)
        assert list(many.ports) == ["out", "in0", "in1", "in2"]
        assert many.ports["in0"] is stays
        assert connector.statistics.buffered == 1
        assert kernel.find("many.in2") is many.ports["in2"]
        assert [port.name for port in many.profile.ports] == ["out", "in0", "in1", "in2"]
        assert [type(event) for event in heard] == [
            PortAdded,
            PortAdded,
            *[type(event) for event in heard[2:]],
        ]
        assert heard[:2] == [PortAdded("many", many.ports[name].profile) for name in ("in1", "in2")]
        await kernel.connect(source.out, many.ports["in2"])
        source.out.write_nowait(TimedLong(0, 2))
        await context.tick()
        assert many.got == {"in0": [1, 2], "in1": [], "in2": [2]}


@pytest.mark.row(124)
@simulated
async def test_a_port_that_goes_is_disconnected_and_its_samples_are_counted() -> None:
    async with Kernel() as kernel:
        many, source = await kernel.add(Many("many"), inputs=2), await kernel.add(Source("source"))
        await kernel.start(ExternalContext(), many, activate=True)
        stays = await kernel.connect(source.out, many.ports["in0"])
        goes = await kernel.connect(source.out, many.ports["in1"])
        gone = many.ports["in1"]
        source.out.write_nowait(TimedLong(0, 1))
        heard = hear(kernel, PortRemoved, Disconnected, ParameterChanged, ParametersChanged)
        await many.configure(inputs=1)
        assert list(many.ports) == ["out", "in0"]
        assert (goes.closed, stays.closed) == (True, False)
        assert dict(goes.statistics.dropped) == {"disconnected": 1}
        assert (goes.statistics.balanced, stays.statistics.buffered) == (True, 1)
        assert list(kernel.connectors) == [stays.name]
        assert [type(event).__name__ for event in heard] == [
            "Disconnected",
            "PortRemoved",
            "ParameterChanged",
            "ParametersChanged",
        ]
        assert isinstance(gone, InPort)
        with pytest.raises(ClosedError):
            await gone.read()
        source.out.write_nowait(TimedLong(0, 2))
        assert stays.statistics.buffered == 2


@simulated
async def test_a_port_with_another_declaration_is_another_port() -> None:
    async with Kernel() as kernel:
        many, source = await kernel.add(Many("many"), inputs=2), await kernel.add(Source("source"))
        old = many.ports["in0"]
        connector = await kernel.connect(source.out, old)
        await many.configure(unit="mm")
        assert many.ports["in0"] is not old
        assert (many.ports["in0"].unit, connector.closed) == ("mm", True)
        assert len(many.ports) == 3


@simulated
async def test_words_about_a_port_change_and_the_port_stays() -> None:
    class Told(Component):
        words = Param("first")

        def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any]]:
            return {"input": InPort(TimedLong, doc=values["words"], max_connectors=len(values["words"]))}

    async with Kernel() as kernel:
        told, source = await kernel.add(Told("told")), await kernel.add(Source("source"))
        connector = await kernel.connect(source.out, told.ports["input"])
        await told.configure(words="second")
        assert (told.ports["input"].doc, told.ports["input"].max_connectors) == ("second", 6)
        assert not connector.closed


class Faulty(Component):
    """Asks for ports that cannot be, if told to."""

    fault = Param("none")
    keep = InPort(TimedLong)

    def ports_for(self, values: Mapping[str, Any]) -> Any:
        good = {"first": InPort(TimedLong), values["fault"] + "1": InPort(TimedLong)}
        match values["fault"]:
            case "raises":
                raise RuntimeError("no ports today")
            case "name":
                return {**good, "a b": InPort(TimedLong)}
            case "taken":
                return {**good, "keep": InPort(TimedLong)}
            case "type":
                return {**good, "more": OutPort(int, stamp="write")}
            case "thing":
                return {**good, "more": 5}
            case "bound":
                return {**good, "more": self.keep}
            case "list":
                return [InPort(TimedLong)]
        return good

    def check_configuration(self, values: Mapping[str, Any]) -> Any:
        def use() -> None:
            if values["fault"] == "use":
                assert "use1" in self.ports
                raise RuntimeError("cannot be used")

        return use


@pytest.mark.fault("B22")
@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("raises", "ports_for: raised RuntimeError: no ports today"),
        ("name", "the port cannot be made: port name 'a b'"),
        ("taken", "there is a port of that name already"),
        ("type", "has no field tm"),
        ("thing", "expected a new InPort"),
        ("bound", "expected a new InPort"),
        ("list", "ports_for: expected ports by name, got list"),
        ("use", "raised RuntimeError: cannot be used"),
    ],
)
@simulated
async def test_when_a_port_cannot_be_made_nothing_was_changed(fault: str, why: str) -> None:
    async with Kernel() as kernel:
        faulty, source = await kernel.add(Faulty("faulty")), await kernel.add(Source("source"))
        context = await kernel.start(EventContext(), faulty, activate=True)
        connectors = [await kernel.connect(source.out, faulty.ports[name]) for name in ("first", "none1")]
        source.out.write_nowait(TimedLong(0, 1))
        before = dict(faulty.ports)
        heard = hear(kernel)
        with pytest.raises(ConfigurationError, match=why):
            await faulty.configure(fault=fault)
        assert (dict(faulty.ports), faulty.fault, heard) == (before, "none", [])
        assert list(faulty.ports) == list(before)
        assert [connector.statistics.buffered for connector in connectors] == [1, 1]
        assert [member.in_ports for member in context.runner.members] == [list(before.values())]
        assert context._listening == 3  # type: ignore[attr-defined]


@simulated
async def test_ports_that_cannot_be_keep_a_component_out() -> None:
    async with Kernel() as kernel:
        with pytest.raises(ConfigurationError, match="no ports today"):
            await kernel.add(Faulty("faulty"), fault="raises")
        assert list(kernel.components) == []

    with pytest.raises(DeclarationError, match="plain `def`"):

        class Waits(Component):
            async def ports_for(self, values: Mapping[str, Any]) -> Any:  # type: ignore[override]
                return {}


@simulated
async def test_a_port_that_comes_wakes_an_event_context() -> None:
    async with Kernel() as kernel:
        many, source = await kernel.add(Many("many"), inputs=0), await kernel.add(Source("source"))
        await kernel.start(EventContext(), many, activate=True)
        await many.configure(inputs=2)
        await kernel.connect(source.out, many.ports["in1"])
        await source.out.write(TimedLong(0, 7))
        await asyncio.sleep(0.01)
        assert many.got == {"in0": [], "in1": [7]}


@simulated
async def test_a_hook_that_opens_a_port_has_it_in_the_next_cycle() -> None:
    """What `examples/adaptive` shows: a component opens a port when its state asks for it."""

    class Adaptive(Many):
        ticks = 0

        async def on_execute(self) -> None:  # type: ignore[override]
            self.ticks += 1
            if self.ticks == 2:
                await self.configure(inputs=2)
                assert len(self.ports) == 2

    async with Kernel() as kernel:
        adaptive = await kernel.add(Adaptive("adaptive"))
        heard = hear(kernel, PortAdded)
        context = await kernel.start(ExternalContext(), adaptive, activate=True)
        counts = []
        for _ in range(3):
            await context.tick()
            counts.append((len(adaptive.ports), len(heard)))
        assert counts == [(2, 0), (3, 1), (3, 1)]
        assert adaptive.last_error is None


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(124)
@pytest.mark.anyio
@pytest.mark.parametrize("kind", ["thread", "real-time"])
async def test_ports_of_a_component_in_a_thread_change_while_the_thread_stands_still(kind: str) -> None:
    async with Kernel() as kernel:
        many, source = await kernel.add(Many("many")), await kernel.add(Source("source"))
        context = ThreadContext(500.0) if kind == "thread" else RealtimeContext(500.0, priority=None, lock_memory=False)
        await kernel.start(context, many, activate=True)
        kept = await kernel.connect(source.out, many.ports["in0"], length=1000)
        threads: set[int] = set()
        kernel.bus.subscribe(PortAdded, lambda event: threads.add(threading.get_ident()))
        kernel.bus.subscribe(PortRemoved, lambda event: threads.add(threading.get_ident()))
        sent = 0
        for number in range(30):
            await many.configure(inputs=1 + number % 4)
            assert len(many.ports) == 2 + number % 4
            for name in list(many.ports)[2:]:
                if many.ports[name].connectors:
                    continue
                await kernel.connect(source.out, many.ports[name])
            for _ in range(3):
                await source.out.write(TimedLong(0, sent))
                sent += 1
        while kept.statistics.buffered:
            await asyncio.sleep(0.002)
        await asyncio.sleep(0.01)
        await context.stop()
        assert many.got["in0"] == list(range(sent))
        assert (many.state, many.last_error) == (None, None)
        assert threads == {threading.get_ident()}
        assert all(connector.statistics.balanced for connector in kernel.connectors.values())


def _context(name: str) -> Context:
    return {"periodic": lambda: PeriodicContext(100.0), "event": EventContext}[name]()


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(124)
@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(("periodic", "event")),
    st.lists(st.tuples(st.integers(0, 4), st.sampled_from(("m", None)), st.integers(0, 5)), min_size=1, max_size=12),
    st.integers(0, 2**30),
)
def test_no_sample_is_lost_on_a_connector_that_stays(
    kind: str, steps: list[tuple[int, str | None, int]], seed: int
) -> None:
    """Writers go on while the interface changes; every connector's ledger balances, and a port that stays got all."""

    async def main(clock: object) -> None:
        async with Kernel() as kernel:
            many = await kernel.add(Many("many"), inputs=2)
            sources = [await kernel.add(Source(f"source{number}")) for number in range(3)]
            await kernel.start(_context(kind), many, activate=True)
            rest = random.Random(seed)
            written = 0
            stayed: dict[Any, list[int]] = {}

            async def write() -> None:
                nonlocal written
                while True:
                    await asyncio.sleep(rest.choice((0.001, 0.004)))
                    for source in sources:
                        await source.out.write(TimedLong(0, written))
                    for connector, values in stayed.items():
                        if not connector.closed:
                            values.append(written)
                    written += 1

            every = []
            writer = asyncio.create_task(write())
            try:
                for inputs, unit, connect in steps:
                    await many.configure(inputs=inputs, unit=unit or "m")
                    names = list(many.ports)[1:]
                    for name in names[:connect]:
                        port = many.ports[name]
                        if not port.connectors:
                            many.got[name] = []
                            connector = await kernel.connect(sources[len(name) % 3].out, port, length=1000)
                            stayed[connector] = []
                            every.append((name, connector))
                    await asyncio.sleep(rest.choice((0.0, 0.003, 0.02)))
            finally:
                writer.cancel()
            await asyncio.sleep(0.05)
            for name, connector in every:
                statistics = connector.statistics
                assert statistics.balanced
                if not connector.closed:
                    assert many.got[name] == stayed[connector]
                    assert (statistics.delivered, statistics.buffered) == (statistics.written, 0)
                else:
                    assert set(statistics.dropped) <= {"disconnected"}

    simulate(main)


@simulated
async def test_taps_of_a_rig_and_bus_see_ports_that_come_when_all_is_in_force() -> None:
    async with Kernel() as kernel:
        many = await kernel.add(Many("many"))
        seen: list[tuple[int, int]] = []
        kernel.bus.subscribe(PortAdded, lambda event: seen.append((many.inputs, len(many.ports))))
        heard = hear(kernel, Connected)
        await many.configure(inputs=3)
        assert (seen, heard) == ([(3, 4), (3, 4)], [])


@simulated
async def test_declared_and_added_ports_are_not_of_the_group() -> None:
    async with Kernel() as kernel:
        many = await kernel.add(Many("many"))
        added = many.add_port("extra", InPort(TimedDouble))
        await many.configure(inputs=2)
        assert list(many.ports) == ["out", "extra", "in0", "in1"]
        assert many.ports["extra"] is added
        gone = many.ports["in1"]
        many.remove_port("in1")
        await many.configure(inputs=3)
        assert many.ports["in1"] is not gone
        assert list(many.ports) == ["out", "extra", "in0", "in1", "in2"]
