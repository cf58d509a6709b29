"""Listeners of connectors: every kind fires, nobody else pays for it, and none can do harm."""

from __future__ import annotations

import asyncio
import logging
import warnings
from typing import Any

import pytest
from anyio import WouldBlock
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, ExternalContext, InPort, Kernel, OutPort, RealtimeContext, SimulatedClock, ThreadContext
from aiorts.errors import ReadTimeout, StateError, WriteTimeout
from aiorts.events import StateChanged
from aiorts.kernel.backlog import PeriodicConnector
from aiorts.kernel.connector import Connector as PlainConnector
from aiorts.kernel.listening import ConnectorEvent, Happening
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
        ({"subscription": "new"}, [("buffer_overwrite", 1.0), ("send", 2.0)]),
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
                "buffer_write_timeout",
                "receiver_timeout",
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
        kernel.listen(wire, heard, Happening.BUFFER_READ_TIMEOUT)
        await kernel.start(ThreadContext(), sink, activate=True)
        async with asyncio.timeout(20):
            while not heard.events:
                await asyncio.sleep(0.01)
        assert {event.kind for event in heard.events} == {Happening.BUFFER_READ_TIMEOUT}


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
            assert type(old) is type(new) is PlainConnector
            source.out.write_nowait(value(2.0))
            heard.events.clear()
            await told()
            assert heard.events == []
            assert [s.data for s in sink.into.drain()] == [1.0, 1.0, 2.0, 2.0]

    simulate(main)


@pytest.mark.parametrize("options", [{}, {"subscription": "periodic", "push_rate": 10.0}])
def test_who_is_not_listened_to_runs_the_very_code_it_ran_before(options: dict[str, Any]) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
            wire = await kernel.connect(source.out, sink.into, **options)
            kernel.bus.subscribe(StateChanged, lambda event: None)
            source.out.write_nowait(value(1.0))
            kind, path = type(wire), (type(sink.into), source.out._fast is wire._queue, sink.into._fast is wire._queue)
            assert kind is (PeriodicConnector if options else PlainConnector)
            assert path == (InPort, not options, True)
            stop = kernel.listen(wire, lambda event: None)
            source.out.write_nowait(value(1.0))
            assert not source.out._fast
            assert type(wire) is not kind
            stop()
            source.out.write_nowait(value(1.0))
            assert type(wire) is kind
            assert (type(sink.into), source.out._fast is wire._queue, sink.into._fast is wire._queue) == path
            stop = kernel.listen(wire, lambda event: None)
            await kernel.disconnect(wire)
            assert type(sink.into) is InPort
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
