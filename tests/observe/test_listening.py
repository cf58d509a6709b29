"""Listeners of connectors: every kind fires, nobody else pays for it, and none can do harm."""

from __future__ import annotations

import asyncio
import logging
import warnings
from contextlib import suppress
from typing import Any

import pytest
from anyio import WouldBlock
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import (
    Component,
    ExternalContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    RealtimeContext,
    SimulatedClock,
    Supervision,
    ThreadContext,
)
from aiorts.errors import ReadTimeout, StateError, WriteTimeout
from aiorts.events import StateChanged
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.periodic_transport import PeriodicTransport
from aiorts.kernel.ports.receiver import Receiver
from aiorts.kernel.ports.transport import Transport
from aiorts.observe.listening import ConnectorEvent, ConnectorEventKind
from aiorts.testing import simulate
from aiorts.types import TimedDouble

pytestmark = pytest.mark.row(47)


class Source(Component):
    out = OutPort(TimedDouble)


class Sink(Component):
    into = InPort(TimedDouble)


def value(data: float) -> TimedDouble:
    return TimedDouble(0, data)


async def told() -> None:
    for _ in range(3):
        await asyncio.sleep(0)


class Heard:
    """What a listener was told: kinds with the data where there is a sample."""

    def __init__(self) -> None:
        self.events: list[ConnectorEvent] = []

    def __call__(self, event: ConnectorEvent) -> None:
        self.events.append(event)

    def take(self) -> list[Any]:
        """As (kind, data) or kind."""
        taken, self.events = self.events, []
        return [(str(e.kind), e.sample.data) if e.sample is not None else str(e.kind) for e in taken]


async def pair(kernel: Kernel, heard: Heard, **options: Any) -> tuple[Source, Sink, Any]:
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    wire = await kernel.connect(source.out, sink.into, name="wire", **options)
    kernel.listen(wire, heard)
    return source, sink, wire


IN = [("send", 1.0), ("buffer_write", 1.0), ("received", 1.0)]


def test_a_sample_on_its_way() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink, wire = await pair(kernel, heard)
            source.out.write_nowait(value(1.0))
            await told()
            assert heard.take() == IN
            assert sink.into.read_nowait() == value(1.0)
            await told()
            assert heard.take() == [("buffer_read", 1.0)]
            source.out.write_nowait(value(2.0))
            assert sink.into.latest == value(2.0)
            await told()
            assert heard.take()[-1] == ("buffer_read", 2.0)
            await kernel.disconnect(wire)
            await told()
            assert heard.take() == ["disconnect"]

    simulate(main)


@pytest.mark.parametrize(
    ("options", "kinds"),
    [
        (
            {"length": 1},
            [("buffer_full", 2.0), ("receiver_full", 2.0), ("buffer_overwrite", 1.0), ("send", 2.0)],
        ),
        ({"length": 1, "full": "reject"}, [("buffer_full", 2.0), ("receiver_full", 2.0)]),
        ({"subscription": "new"}, [("buffer_overwrite", 1.0), ("superseded", 1.0), ("send", 2.0)]),
    ],
)
def test_overwriting_fires_and_names_the_sample_that_went(options: dict[str, Any], kinds: list[Any]) -> None:
    """OpenRTM's ON_BUFFER_OVERWRITE never fires for its ring buffer (OpenRTM-aist#645)."""

    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, _, wire = await pair(kernel, heard, **options)
            source.out.write_nowait(value(1.0))
            await told()
            heard.take()
            source.out.write_nowait(value(2.0))
            await told()
            assert heard.take()[: len(kinds)] == kinds
            assert wire.statistics.balanced

    simulate(main)


def test_a_writer_that_waits_and_gives_up_or_goes_on() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink, wire = await pair(kernel, heard, length=1, full="block", timeout=0.5)
            await source.out.write(value(1.0))
            with pytest.raises(WriteTimeout):
                await source.out.write(value(2.0))
            await told()
            assert heard.take()[3:] == [
                ("buffer_full", 2.0),
                ("receiver_full", 2.0),
                ("buffer_write_timeout", 2.0),
                ("receiver_timeout", 2.0),
                "sender_timeout",
            ]
            waiting = asyncio.create_task(source.out.write(value(3.0)))
            await told()
            heard.take()
            assert sink.into.read_nowait() == value(1.0)
            assert await waiting
            await told()
            assert sorted(map(str, heard.take())) == sorted(
                map(str, [("buffer_read", 1.0), ("send", 3.0), ("buffer_write", 3.0), ("received", 3.0)])
            )
            assert sink.into.read_nowait() == value(3.0)
            assert wire.statistics.balanced
            assert wire.statistics.delivered == 2

    simulate(main)


async def test_a_blocking_write_that_gives_up_names_the_sample(anyio_backend: Any) -> None:
    class Thread(Component):
        out = OutPort(TimedDouble)
        gave_up = False

        def on_execute(self) -> None:
            try:
                self.out.write_blocking(value(2.0), timeout=0.01)
            except WriteTimeout:
                self.gave_up = True
                self.finish()

    async with Kernel() as kernel:
        heard = Heard()
        writer, sink = await kernel.add(Thread()), await kernel.add(Sink())
        wire = await kernel.connect(writer.out, sink.into, length=1, full="block")
        writer.out.write_nowait(value(1.0))
        kernel.listen(wire, heard, "buffer_write_timeout", "receiver_timeout")
        await kernel.start(ThreadContext(), writer, activate=True)
        async with asyncio.timeout(10.0):
            while len(heard.events) < 2 or not writer.gave_up:
                await asyncio.sleep(0.001)
        assert heard.take() == [("buffer_write_timeout", 2.0), ("receiver_timeout", 2.0)]


def test_what_the_push_policy_leaves_out_and_what_a_newer_sample_takes_the_place_of_is_told() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink, wire = await pair(kernel, heard, subscription="new", push="skip", skip=2, length=2)
            for number in range(1, 7):
                source.out.write_nowait(value(number))
            await told()
            assert [one for one in heard.take() if one[0] == "skipped"] == [
                ("skipped", n) for n in (1.0, 2.0, 4.0, 5.0)
            ]
            assert sink.into.latest == value(6.0)
            await told()
            assert heard.take() == [("superseded", 3.0), ("buffer_read", 6.0)]
            assert dict(wire.statistics.dropped) == {"skipped": 4, "superseded": 1}

    simulate(main)


@pytest.mark.parametrize(
    ("push", "out"),
    [("skip", [("skipped", 1.0), ("skipped", 3.0)]), ("new", [("superseded", n) for n in (1.0, 2.0, 3.0)])],
)
def test_so_is_what_the_end_of_a_period_leaves_out(push: str, out: list[Any]) -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            options: dict[str, Any] = {"skip": 1} if push == "skip" else {}
            source, _, _ = await pair(kernel, heard, subscription="periodic", push=push, push_rate=10.0, **options)
            for number in range(1, 5):
                source.out.write_nowait(value(number))
            await clock.advance(0.2)
            await told()
            assert [one for one in heard.take() if one[0] in ("skipped", "superseded")] == out

    simulate(main)


def test_a_reader_that_finds_nothing_waits_and_gives_up() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink, _ = await pair(kernel, heard)
            assert sink.into.latest is None
            await told()
            assert heard.take() == ["buffer_empty"]
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.1):
                    await sink.into.read()
            await told()
            assert heard.take() == ["buffer_empty", "buffer_read_timeout"]
            reading = asyncio.create_task(sink.into.read())
            await told()
            source.out.write_nowait(value(1.0))
            assert await reading == value(1.0)
            await told()
            assert heard.take() == ["buffer_empty", *IN, ("buffer_read", 1.0)]

    simulate(main)


def test_pull_tells_of_its_writer() -> None:
    """Pull connections of OpenRTM fire almost nothing on the out side (OpenRTM-aist#645)."""

    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink, _ = await pair(kernel, heard, dataflow="pull")
            assert sink.into.latest is None
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.1):
                    await sink.into.read()
            await told()
            assert heard.take() == [
                "buffer_empty",
                "sender_empty",
                "buffer_empty",
                "sender_empty",
                "buffer_read_timeout",
                "sender_timeout",
            ]
            source.out.write_nowait(value(1.0))
            assert sink.into.latest == value(1.0)
            await told()
            assert heard.take() == [*IN, ("buffer_read", 1.0)]

    simulate(main)


def test_a_reader_that_is_not_active_and_a_writer_nobody_runs() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink, _ = await pair(kernel, heard)
            context = await kernel.start(ExternalContext(), sink, activate=True)
            await context.deactivate(sink)
            source.out.write_nowait(value(1.0))
            await told()
            assert heard.take() == [("receiver_error", 1.0)]
        heard = Heard()
        async with Kernel() as kernel:
            source, sink, _ = await pair(kernel, heard, dataflow="pull")
            context = await kernel.start(ExternalContext(), source, activate=True)
            await context.stop()
            assert sink.into.latest is None
            await told()
            assert heard.take() == ["buffer_empty", "sender_error"]

    simulate(main)


def test_a_periodic_connector_tells_of_its_backlog() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink, wire = await pair(
                kernel, heard, subscription="periodic", push="all", push_rate=10.0, out_length=2
            )
            for number in (1.0, 2.0, 3.0):
                source.out.write_nowait(value(number))
            await told()
            assert heard.take() == [
                ("buffer_write", 1.0),
                ("buffer_write", 2.0),
                ("buffer_full", 3.0),
                ("buffer_overwrite", 1.0),
                ("buffer_write", 3.0),
            ]
            await clock.advance(0.2)
            await told()
            assert heard.take() == [
                *[(kind, 2.0) for kind in ("send", "buffer_write", "received")],
                *[(kind, 3.0) for kind in ("send", "buffer_write", "received")],
            ]
            assert [sample.data for sample in sink.into.drain()] == [2.0, 3.0]
            assert wire.statistics.balanced

    simulate(main)


async def test_a_blocking_read_that_gives_up(anyio_backend: Any) -> None:
    class Thread(Component):
        into = InPort(TimedDouble)
        gave_up = 0

        def on_execute(self) -> None:
            try:
                self.into.read_blocking(0.01)
            except ReadTimeout:
                self.gave_up += 1

    heard = Heard()
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Thread())
        wire = await kernel.connect(source.out, sink.into)
        kernel.listen(wire, heard, ConnectorEventKind.BUFFER_READ_TIMEOUT)
        await kernel.start(ThreadContext(), sink, activate=True)
        async with asyncio.timeout(20):
            while not heard.events:
                await asyncio.sleep(0.01)
        assert {event.kind for event in heard.events} == {ConnectorEventKind.BUFFER_READ_TIMEOUT}


def test_the_bus_hears_of_all_connectors_and_of_new_ones() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
            old = await kernel.connect(source.out, sink.into, name="old")
            stop = kernel.bus.subscribe(ConnectorEvent, heard)
            new = await kernel.connect(source.out, sink.into, name="new", allow_duplicate=True)
            source.out.write_nowait(value(1.0))
            await told()
            assert [(e.connector, str(e.kind)) for e in heard.events] == [
                ("new", "connect"),
                *[(name, kind) for name in ("old", "new") for kind in ("send", "buffer_write", "received")],
            ]
            assert [e.sequence for e in heard.events] == sorted({e.sequence for e in heard.events})
            stop()
            assert type(transport_of(old)) is type(transport_of(new)) is Transport
            source.out.write_nowait(value(2.0))
            heard.events.clear()
            await told()
            assert heard.events == []
            assert [s.data for s in sink.into.drain()] == [1.0, 1.0, 2.0, 2.0]

    simulate(main)


def test_the_bus_hears_of_a_connector_that_a_restart_made_anew() -> None:
    class Fails(Source):
        made = 0

        def on_initialize(self) -> None:
            type(self).made += 1

        def on_execute(self) -> None:
            if self.made == 1:
                raise ValueError("this one only")

    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink = await kernel.add(Fails("source")), await kernel.add(Sink("sink"))
            await kernel.connect(source.out, sink.into, name="wire")
            kernel.supervise(source, Supervision("restart"))
            kernel.bus.subscribe(ConnectorEvent, heard)
            await kernel.start(PeriodicContext(100.0), source, activate=True)
            await kernel.sleep(5.0)
            new: Any = kernel.components["source"]
            assert new is not source
            new.out.write_nowait(value(1.0))
            await told()
            assert [str(e.kind) for e in heard.events] == ["disconnect", "connect", "send", "buffer_write", "received"]

    simulate(main)


@pytest.mark.parametrize("options", [{}, {"subscription": "periodic", "push_rate": 10.0}])
def test_who_is_not_listened_to_runs_the_very_code_it_ran_before(options: dict[str, Any]) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
            wire = await kernel.connect(source.out, sink.into, **options)
            kernel.bus.subscribe(StateChanged, lambda event: None)
            source.out.write_nowait(value(1.0))

            def ways() -> tuple[type, type, bool, bool]:
                transport = transport_of(wire)
                fast = source.out._fast is transport.queue, sink.into._fast is transport.queue
                return type(transport), type(receiver_of(sink.into)), *fast

            before = ways()
            assert before == (PeriodicTransport if options else Transport, Receiver, not options, True)
            stop = kernel.listen(wire, lambda event: None)
            source.out.write_nowait(value(1.0))
            assert not source.out._fast
            assert ways()[0] is not before[0]
            stop()
            source.out.write_nowait(value(1.0))
            assert ways() == before
            stop = kernel.listen(wire, lambda event: None)
            await kernel.disconnect(wire)
            assert type(receiver_of(sink.into)) is Receiver
            assert wire.statistics.written == 3
            assert wire.statistics.balanced

    simulate(main)


@pytest.mark.fault("B15")
def test_a_listener_that_raises_is_counted_and_harms_nobody(caplog: pytest.LogCaptureFixture) -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()

        def bad(event: ConnectorEvent) -> None:
            raise RuntimeError("listener")

        class Reader(Component):
            into = InPort(TimedDouble)

            def on_execute(self) -> None:
                got.extend(self.into.drain())

        got: list[TimedDouble] = []
        async with Kernel() as kernel:
            source, reader = await kernel.add(Source("source")), await kernel.add(Reader("reader"))
            wire = await kernel.connect(source.out, reader.into)
            kernel.listen(wire, bad)
            kernel.listen(wire, heard)
            kernel.bus.subscribe(ConnectorEvent, bad)
            context = await kernel.start(ExternalContext(name="loop"), reader, activate=True)
            for number in range(5):
                assert source.out.write_nowait(value(number))
                await context.tick()
            await told()
            assert [sample.data for sample in got] == [0.0, 1.0, 2.0, 3.0, 4.0]
            assert str(reader.states["loop"]) == "active"
            assert [e.sample.data for e in heard.events if e.kind == "buffer_read"] == [0.0, 1.0, 2.0, 3.0, 4.0]
            (statistics,) = kernel.bus.observers
            assert statistics.errors == statistics.calls >= 20
            assert wire.statistics.delivered == 5

    with caplog.at_level(logging.ERROR, "aiorts"):
        simulate(main)
    assert 1 <= len([r for r in caplog.records if "observer" in r.getMessage()]) <= 4


@pytest.mark.slow
def test_notes_are_bounded() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, _, wire = await pair(kernel, heard)
            for number in range(5000):
                source.out.write_nowait(value(number))
            await told()
            assert len(heard.events) == 10_000
            assert kernel.listening.missed > 0
            assert wire.statistics.written == 5000

    simulate(main)


def test_who_cannot_be_listened_to_is_told() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            source, sink = await kernel.add(Source()), await kernel.add(Sink())
            wire = await kernel.connect(source.out, sink.into)
            with pytest.raises(ValueError, match="nonsense"):
                kernel.listen(wire, lambda event: None, "nonsense")
            await kernel.disconnect(wire)
            with pytest.raises(StateError, match="is not a connector"):
                kernel.listen(wire, lambda event: None)

    simulate(main)


@pytest.mark.slow(kept_by="test_the_bus_hears_of_all_connectors_and_of_new_ones")
@pytest.mark.parametrize("options", [{}, {"subscription": "periodic", "push_rate": 100.0}])
async def test_who_listens_hears_again_when_a_real_time_thread_has_gone(
    options: dict[str, Any], anyio_backend: Any
) -> None:
    class Reader(Sink):
        def on_execute(self) -> None:
            self.into.drain()

    heard = Heard()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a machine without the privilege says so
        async with Kernel() as kernel:
            source, reader = await kernel.add(Source()), await kernel.add(Reader())
            wire = await kernel.connect(source.out, reader.into, **options)
            kernel.listen(wire, heard)
            context = await kernel.start(RealtimeContext(50.0), reader, activate=True)
            with pytest.raises(StateError, match="real-time"):
                kernel.listen(wire, heard)
            source.out.write_nowait(value(1.0))
            await context.stop()
            await told()
            assert heard.take() == []
            source.out.write_nowait(value(2.0))
            await told()
            assert ("buffer_write", 2.0) in heard.take()
            assert wire.statistics.balanced


OPERATIONS = st.lists(
    st.sampled_from(("write", "write", "write", "read", "latest", "drain", "peek", "wait", "toggle", "advance")),
    max_size=30,
)
OPTIONS = st.sampled_from(
    (
        {},
        {"length": 2},
        {"length": 2, "full": "reject"},
        {"length": 1, "full": "block", "timeout": 0.1},
        {"subscription": "new"},
        {"push": "skip", "skip": 1, "subscription": "new"},
        {"dataflow": "pull"},
        {"subscription": "periodic", "push": "all", "push_rate": 10.0, "length": 3},
        {"subscription": "periodic", "push": "fifo", "push_rate": 10.0, "full": "block", "length": 2},
    )
)


@pytest.mark.slow(kept_by="test_what_the_push_policy_leaves_out_and_what_a_newer_sample_takes_the_place_of_is_told")
@settings(max_examples=100)
@given(OPERATIONS, OPTIONS, st.booleans())
def test_each_sample_that_the_ledger_calls_skipped_or_superseded_is_told_once(
    operations: list[str], options: dict[str, Any], several: bool
) -> None:
    async def main(clock: SimulatedClock) -> None:
        heard = Heard()
        async with Kernel() as kernel:
            source, sink, wire = await pair(kernel, heard, **options)
            if several:
                await kernel.connect(source.out, sink.into, allow_duplicate=True)
            for number, operation in enumerate(operations):
                with suppress(WriteTimeout, WouldBlock, TimeoutError):
                    if operation == "write":
                        await source.out.write(value(number))
                    elif operation == "read":
                        sink.into.read_nowait()
                    elif operation == "latest":
                        _ = sink.into.latest
                    elif operation == "advance":
                        await asyncio.sleep(0.15)
            await told()
            dropped = wire.statistics.dropped
            for kind in ("skipped", "superseded"):
                gone = [event.sample.data for event in heard.events if event.kind == kind]
                assert len(gone) == len(set(gone)) == dropped.get(kind, 0)

    simulate(main)


@pytest.mark.slow(kept_by="test_who_is_not_listened_to_runs_the_very_code_it_ran_before")
@settings(max_examples=150)
@given(OPERATIONS, OPTIONS, st.booleans())
def test_listening_changes_nothing_for_the_ports(operations: list[str], options: dict[str, Any], several: bool) -> None:
    async def system(listened: bool) -> list[Any]:
        seen: list[Any] = []
        async with Kernel() as kernel:
            source, sink = await kernel.add(Source()), await kernel.add(Sink())
            wires = [await kernel.connect(source.out, sink.into, **options)]
            if several:
                wires.append(await kernel.connect(source.out, sink.into, allow_duplicate=True))
            stop: Any = None
            number = 0.0
            for operation in operations:
                if operation == "write":
                    number += 1.0
                    try:
                        seen.append(await source.out.write(value(number)))
                    except WriteTimeout as error:
                        seen.append(str(error))
                elif operation == "read":
                    try:
                        seen.append(sink.into.read_nowait())
                    except WouldBlock:
                        seen.append("none")
                elif operation == "latest":
                    seen.append(sink.into.latest)
                elif operation == "drain":
                    seen.append(sink.into.drain())
                elif operation == "peek":
                    seen.append((sink.into.peek(), sink.into.is_new))
                elif operation == "wait":
                    try:
                        async with asyncio.timeout(0.01):
                            seen.append(await sink.into.read())
                    except TimeoutError:
                        seen.append("waited")
                elif operation == "advance":
                    await asyncio.sleep(0.15)
                elif listened and stop is None:
                    stop = kernel.listen(wires[0], lambda event: None)
                elif listened:
                    stop()
                    stop = None
                seen.append([(w.statistics.written, w.statistics.delivered, dict(w.statistics.dropped)) for w in wires])
                assert all(wire.statistics.balanced for wire in wires)
        return seen

    async def main(clock: SimulatedClock) -> None:
        assert await system(True) == await system(False)

    simulate(main)


@pytest.mark.slow
async def test_a_port_that_a_thread_opens_while_a_listener_comes_is_open(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        connector = await kernel.connect(source.out, sink.into, length=8)
        context = ThreadContext(100.0)
        await kernel.start(context, sink)
        before = receiver_of(sink.into)
        with before.guard():  # the context's thread waits for it, while the loop puts another receiver in its place
            activation = asyncio.ensure_future(context.activate(sink))
            await asyncio.sleep(0.1)
            end = kernel.listen(connector, lambda _event: None)
        await asyncio.wait_for(activation, 10.0)
        assert receiver_of(sink.into) is not before
        source.out.write_nowait(value(1.0))
        assert connector.statistics.dropped == {}
        end()
