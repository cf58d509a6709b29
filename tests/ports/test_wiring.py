"""Connecting and disconnecting: what is refused and why, all or none, and that nothing is left of what ended."""

from __future__ import annotations

import asyncio
import gc
import tracemalloc
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.errors import InvalidNameError, ThreadError, WiringError
from aiorts.kernel.loop.bus import Connected, Disconnected, Event
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedLong, TimedString, record
from campaign import cases
from ports.parts import Both, Sink, Source, data, long

pytestmark = pytest.mark.anyio


class Text(Component):
    inp = InPort(TimedString)
    out = OutPort(TimedString)


@pytest.mark.row(55)
@pytest.mark.fault("B01")
async def test_ports_of_different_types_are_refused_before_any_data(anyio_backend: Any) -> None:
    """OpenRTM connects them; the first sample fails to decode."""
    async with Kernel() as kernel:
        source, text = await kernel.add(Source("source")), await kernel.add(Text("text"))
        with pytest.raises(WiringError) as caught:
            await kernel.connect(source.out, text.inp)
        for part in ("source.out", "TimedLong", "text.inp", "TimedString", "FlexiFilter"):
            assert part in str(caught.value)
        assert source.out.connectors == text.inp.connectors == ()
        assert not kernel.connectors


@record
class Special(TimedLong):
    extra: str = ""


@pytest.mark.row(55)
async def test_an_in_port_takes_subclasses_of_its_type_and_not_the_other_way(anyio_backend: Any) -> None:
    class SpecialOut(Component):
        out = OutPort(Special)

    class SpecialIn(Component):
        inp = InPort(Special)

    async with Kernel() as kernel:
        special, narrow = await kernel.add(SpecialOut()), await kernel.add(SpecialIn())
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        await kernel.connect(special.out, sink.inp)
        with pytest.raises(
            WiringError, match=r"types differ: .*connect ports of one type, or put a FlexiFilter between"
        ):
            await kernel.connect(source.out, narrow.inp)


async def test_unequal_units_and_shapes_are_refused(anyio_backend: Any) -> None:
    class Physical(Component):
        metres = OutPort(TimedDouble, unit="m")
        feet = InPort(TimedDouble, unit="ft")
        plain = InPort(TimedDouble)
        three = OutPort(TimedDoubleSeq, shape=(3,))
        four = InPort(TimedDoubleSeq, shape=(4,))
        some = InPort(TimedDoubleSeq, shape=(-1,))

    async with Kernel() as kernel:
        c = await kernel.add(Physical())
        with pytest.raises(WiringError, match=r"units differ: .*metres sends 'm', .*feet takes 'ft'; declare one unit"):
            await kernel.connect(c.metres, c.feet)
        with pytest.raises(WiringError, match=r"shapes differ: .*three sends \(3,\), .*four takes \(4,\)"):
            await kernel.connect(c.three, c.four)
        await kernel.connect(c.metres, c.plain)
        await kernel.connect(c.three, c.some)


@pytest.mark.fault("B12")
async def test_a_component_may_be_connected_to_itself(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        both = await kernel.add(Both())
        await kernel.connect(both.out, both.inp)
        both.out.write_nowait(long(1))
        assert both.inp.read_nowait().data == 1


@pytest.mark.row(58)
@pytest.mark.fault("B12")
async def test_a_duplicate_is_refused_unless_it_is_asked_for(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        first = await kernel.connect(source.out, sink.inp)
        with pytest.raises(WiringError, match="connected already; the option allow_duplicate lets"):
            await kernel.connect(source.out, sink.inp)
        with pytest.raises(WiringError, match="connected already"):
            await kernel.connect(source.out, sink.inp, allow_dup_connection="NO")
        second = await kernel.connect(source.out, sink.inp, allow_duplicate=True)
        third = await kernel.connect(source.out, sink.inp, allow_dup_connection="YES")
        assert len({first.name, second.name, third.name}) == 3
        source.out.write_nowait(long(1))
        assert data(sink.inp.drain()) == [1, 1, 1]


@pytest.mark.fault("B12")
async def test_the_same_ports_twice_in_one_connect_are_a_duplicate_too(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        with pytest.raises(WiringError, match="connected already"):
            await kernel.connect(source.out, sink.inp, sink.inp)
        assert not kernel.connectors
        assert source.out.connectors == ()
        made = await kernel.connect(source.out, sink.inp, sink.inp, allow_duplicate=True)
        assert len(made) == 2


@pytest.mark.fault("B12")
async def test_ports_that_are_not_there_are_refused_and_named(anyio_backend: Any) -> None:
    async with Kernel() as kernel, Kernel("other") as other:
        source, sink, foreign = await kernel.add(Source()), await kernel.add(Sink()), await other.add(Sink("foreign"))
        outsider = Sink("outsider")
        with pytest.raises(WiringError, match=r"no port 'nothing'; it has inp"):
            kernel.find("sink0.nothing")
        with pytest.raises(WiringError, match=r"no component 'nobody'; there are source0, sink0"):
            kernel.find("nobody.inp")
        with pytest.raises(WiringError, match=r"foreign\.inp: belongs to another kernel"):
            await kernel.connect(source.out, foreign.inp)
        with pytest.raises(WiringError, match=r"outsider\.inp: belongs to another kernel, or to none yet"):
            await kernel.connect(source.out, outsider.inp)
        with pytest.raises(WiringError, match="is a declaration"):
            await kernel.connect(source.out, InPort(TimedLong, name="bare"))
        with pytest.raises(WiringError, match="at least one out-port and one in-port"):
            await kernel.connect(source.out, source.out)
        with pytest.raises(WiringError, match="at least one out-port and one in-port"):
            await kernel.connect(source.out, sink.inp, sink)  # type: ignore[arg-type]
        removed = sink.inp
        sink.remove_port("inp")
        with pytest.raises(WiringError, match=r"sink0\.inp: this port or its component was removed"):
            await kernel.connect(source.out, removed)
        await kernel.remove(source)
        live = sink.add_port("inp", InPort(TimedLong))
        with pytest.raises(WiringError, match=r"source0\.out: this port or its component was removed"):
            await kernel.connect(source.out, live)
        assert not kernel.connectors
        assert not other.connectors


@pytest.mark.row(57)
async def test_more_than_two_ports_are_connected_every_out_to_every_in(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        sources = [await kernel.add(Source()) for _ in range(2)]
        sinks = [await kernel.add(Sink()) for _ in range(3)]
        made = await kernel.connect(
            sources[0].out, sources[1].out, *(sink.inp for sink in sinks), subscription="new", push="all", name="bundle"
        )
        assert [(connector.out, connector.in_) for connector in made] == [
            (source.out, sink.inp) for source in sources for sink in sinks
        ]
        names = [connector.name for connector in made]
        assert len(set(names)) == 6
        assert list(kernel.connectors) == names
        assert {connector.profile.push for connector in made} == {"all"}
        sources[0].out.write_nowait(long(1))
        sources[1].out.write_nowait(long(2))
        assert [data(sink.inp.drain()) for sink in sinks] == [[1, 2]] * 3


@pytest.mark.row(57)
@pytest.mark.parametrize("wrong", ["type", "limit", "duplicate", "option"])
async def test_when_one_pair_does_not_fit_nothing_is_connected(wrong: str, anyio_backend: Any) -> None:
    class Limited(Component):
        inp = InPort(TimedLong, max_connectors=0)

    async with Kernel() as kernel:
        source, sink, other = await kernel.add(Source()), await kernel.add(Sink()), await kernel.add(Sink())
        before: tuple[object, ...] = ()
        last: Any = other.inp
        options: dict[str, Any] = {}
        if wrong == "type":
            last = (await kernel.add(Text())).inp
        elif wrong == "limit":
            last = (await kernel.add(Limited())).inp
        elif wrong == "duplicate":
            before = (await kernel.connect(source.out, other.inp),)
        else:
            options = {"lenght": 3}
        seen: list[object] = []
        kernel.bus.subscribe(Event, seen.append)
        with pytest.raises(WiringError):
            await kernel.connect(source.out, sink.inp, last, **options)
        assert source.out.connectors == before
        assert sink.inp.connectors == ()
        assert tuple(kernel.connectors.values()) == before
        assert seen == []


async def test_a_name_that_is_taken_is_refused_and_changes_nothing(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink, other = await kernel.add(Source()), await kernel.add(Sink()), await kernel.add(Sink())
        await kernel.connect(source.out, sink.inp, name="wire")
        with pytest.raises((WiringError, InvalidNameError), match="wire"):
            await kernel.connect(source.out, other.inp, name="wire")
        assert other.inp.connectors == ()
        assert len(source.out.connectors) == 1


@pytest.mark.row(58)
@pytest.mark.parametrize(
    ("declared", "options"),
    [
        ({"max_connectors": 2}, {}),
        ({}, {"fan_out": 2, "fan_in": 2}),
        ({}, {"dataport.fan_out": "2", "dataport.fan_in": "2"}),
        ({}, {"connection_limit": "2"}),
        ({"max_connectors": 5}, {"connection_limit": 2}),
    ],
)
async def test_limits_hold_at_both_ends(declared: dict[str, Any], options: dict[str, Any], anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        one, many = await kernel.add(Component("one")), await kernel.add(Component("many"))
        out, inp = (
            one.add_port("out", OutPort(TimedLong, **declared)),
            one.add_port("inp", InPort(TimedLong, **declared)),
        )
        ins = [many.add_port(f"in{i}", InPort(TimedLong)) for i in range(3)]
        outs = [many.add_port(f"out{i}", OutPort(TimedLong)) for i in range(3)]
        for number in range(2):
            await kernel.connect(out, ins[number], **options)
            await kernel.connect(outs[number], inp, **options)
        with pytest.raises(WiringError, match=r"one\.out: takes 2 connectors at the most, has 2, 1 more"):
            await kernel.connect(out, ins[2], **options)
        with pytest.raises(WiringError, match=r"one\.inp: takes 2"):
            await kernel.connect(outs[2], inp, **options)
        await kernel.disconnect(out.connectors[0])
        await kernel.connect(out, ins[2], **options)
        with pytest.raises(WiringError, match=r"one\.out: takes 2"):
            await kernel.connect(out, ins[0], **options)


async def test_connection_limit_minus_one_is_unlimited(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source = await kernel.add(Source())
        for _ in range(20):
            await kernel.connect(source.out, (await kernel.add(Sink())).inp, connection_limit=-1)
        assert len(source.out.connectors) == 20


@pytest.mark.slow(kept_by="test_closing_a_connector_is_disconnecting_it")
@pytest.mark.fault("B09")
async def test_reconnecting_in_flight_brings_no_old_data_and_no_duplicate(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        connector = await kernel.connect(source.out, sink.inp, full="block", length=3, timeout=None)
        written = 0
        done: set[int] = set()
        old: set[int] = set()
        stale: set[int] = set()
        connectors = [connector]

        async def read() -> None:
            nonlocal stale
            async for sample in sink.inp:
                stale |= {sample.data} & old

        async def write() -> None:
            nonlocal written
            while True:
                written += 1
                number = written
                await source.out.write(long(number))
                done.add(number)

        tasks = [asyncio.create_task(read()), asyncio.create_task(write()), asyncio.create_task(write())]
        for round_ in range(1_000):
            for _ in range(round_ % 5):
                await asyncio.sleep(0)
            await kernel.disconnect(connector)
            assert kernel.connectors == {}
            assert not sink.inp.is_new
            if round_ % 2:
                await asyncio.sleep(0)
            old |= done  # what was written while the old connector was there, or none
            connector = await kernel.connect(source.out, sink.inp, full="block", length=3, timeout=None)
            connectors.append(connector)
            assert source.out.connectors == sink.inp.connectors == (connector,)
            assert len(kernel.connectors) == 1
            assert connector.statistics.written == 0
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        assert stale == set()
        assert all(connector.statistics.balanced for connector in connectors)


@pytest.mark.fault("B10")
async def test_what_is_queued_for_a_removed_component_is_dropped_exactly(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        connector = await kernel.connect(source.out, sink.inp, length=10)
        for number in range(7):
            source.out.write_nowait(long(number))
        sink.inp.read_nowait()
        await kernel.remove(sink)
        ledger = connector.statistics
        assert dict(ledger.dropped) == {"disconnected": 6}
        assert (ledger.written, ledger.delivered) == (7, 1)
        assert connector.closed
        assert source.out.connectors == ()
        assert not kernel.connectors
        assert source.out.write_nowait(long(9)) is True


@pytest.mark.parametrize("what", ["a.out-b.inp", None, 3])
async def test_what_is_no_connector_is_not_disconnected(anyio_backend: Any, what: Any) -> None:
    async with Kernel() as kernel:
        with pytest.raises(WiringError, match=r"expected a connector or a Connection, .*connectors has the connectors"):
            await kernel.disconnect(what)


async def test_connections_are_announced_and_disconnecting_twice_is_harmless(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        seen: list[Any] = []
        kernel.bus.subscribe(Event, seen.append)
        connector = await kernel.connect(source.out, sink.inp)
        await kernel.disconnect(connector)
        await kernel.disconnect(connector)
        assert [(type(event), event.connector.name) for event in seen] == [
            (Connected, connector.name),
            (Disconnected, connector.name),
        ]
        assert connector.profile.ports == ("source0.out", "sink0.inp")


@pytest.mark.fault("B09")
@pytest.mark.parametrize(
    "options",
    [{}, {"subscription": "periodic", "push_rate": 1000.0, "push": "all"}, {"full": "block", "length": 1}],
    ids=["flush", "periodic", "block"],
)
async def test_closing_a_connector_is_disconnecting_it(options: dict[str, Any], anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        seen: list[Any] = []
        connector = await kernel.connect(source.out, sink.inp, name="wire", **options)
        kernel.bus.subscribe(Disconnected, seen.append)
        source.out.write_nowait(long(1))
        with pytest.raises(ThreadError, match="wire"):
            await asyncio.to_thread(connector.close)
        assert kernel.connectors["wire"] is connector
        connector.close()
        connector.close()
        await kernel.disconnect(connector)
        assert connector.closed
        assert dict(connector.statistics.dropped) == {"disconnected": 1}
        assert not kernel.connectors
        assert (source.out.connectors, sink.inp.connectors) == ((), ())
        assert [event.connector.name for event in seen] == ["wire"]
        again = await kernel.connect(source.out, sink.inp, name="wire")
        source.out.write_nowait(long(2))
        assert again.statistics.written == 1
    again.close()  # has ended with its kernel


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"dataflow": "pull", "length": 5}, "length chooses nothing where the reader pulls"),
        ({"dataflow": "pull", "push": "all"}, "push chooses nothing where the reader pulls"),
        ({"subscription": "new", "full": "block"}, "full chooses nothing where a newer sample takes the place"),
        ({"push": "new"}, "push chooses nothing where every sample is sent: push takes subscription new or periodic"),
    ],
)
async def test_an_option_that_chooses_nothing_is_warned_of_once(
    options: dict[str, Any], said: str, anyio_backend: Any, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        sink = await kernel.add(Sink("sink"))
        for number in range(3):
            await kernel.connect((await kernel.add(Source(f"source{number}"))).out, sink.inp, **options)
        await kernel.connect((await kernel.add(Source("other"))).out, sink.inp)
        assert [record.getMessage() for record in caplog.records if "W-OPTION" in record.getMessage()] == [
            message for message in caplog.messages if message.startswith(f"W-OPTION: source0.out-sink.inp: {said}")
        ]
        assert len(caplog.messages) == 1


@pytest.mark.row(60)
async def test_the_ledger_balances_at_every_moment_it_is_read(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        connector = await kernel.connect(source.out, sink.inp, length=4)
        for number in range(500):
            source.out.write_nowait(long(number))
            assert connector.statistics.balanced
            if number % 3 == 0:
                sink.inp.read_nowait()
            ledger = connector.statistics
            assert ledger.balanced
            assert min(ledger.written, ledger.delivered, ledger.buffered) >= 0
            assert ledger.delivered == number // 3 + 1


@pytest.mark.slow
@pytest.mark.fault("B16")
@pytest.mark.campaign
async def test_connecting_and_disconnecting_leaves_nothing_in_memory(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())

        async def rounds(count: int) -> None:
            for number in range(count):
                options: dict[str, Any] = {"subscription": "periodic", "push_rate": 1000.0} if number % 2 else {}
                connector = await kernel.connect(source.out, sink.inp, **options)
                source.out.write_nowait(long(number))
                await kernel.disconnect(connector)

        await rounds(500)
        gc.collect()
        tracemalloc.start()
        try:
            await rounds(cases(100_000))
            gc.collect()
            left, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert left < 100_000


@pytest.mark.row(41)
async def test_what_openrtm_says_of_the_backlog_leaves_the_readers_buffer_alone(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        options: dict[str, Any] = {
            "dataport.outport.buffer.write.full_policy": "block",
            "dataport.outport.buffer.write.timeout": "0.01",
            "dataport.outport.buffer.length": "3",
        }
        connector = await kernel.connect(source.out, sink.inp, **options)
        for number in range(10):
            await source.out.write(long(number))
        assert data(sink.inp.drain()) == list(range(2, 10))
        assert connector.statistics.dropped["overwritten"] == 2


async def test_keys_of_openrtm_travel_in_a_mapping_or_as_they_are(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        keys = {"dataport.subscription_type": "new", "dataport.inport.buffer.length": "3", "port.tool.color": "red"}
        with pytest.raises(WiringError, match=r"push_rate are one option with two values"):
            await kernel.connect(source.out, sink.inp, push_rate=5.0, openrtm={"dataport.push_rate": 6})
        assert not kernel.connectors
        one = await kernel.connect(source.out, sink.inp, push="all", openrtm=keys)
        assert (one.profile.subscription, one.profile.length, one.profile.push) == ("new", 3, "all")
        await kernel.disconnect(one)
        plain: Any = keys
        assert (await kernel.connect(source.out, sink.inp, push="all", **plain)).profile == one.profile


async def test_a_port_is_given_itself_or_by_its_path(anyio_backend: Any) -> None:
    async with Kernel("robot") as kernel:
        source, sink, other = await kernel.add(Source()), await kernel.add(Sink()), await kernel.add(Sink())
        for one, two in (
            ("source0.out", "sink0.inp"),
            (source.out, "sink0.inp"),
            ("robot/source0.out", sink.inp),
            ("sink0.inp", "source0.out"),
        ):
            connector = await kernel.connect(one, two, length=3)
            assert (connector.out, connector.in_, connector.profile.length) == (source.out, sink.inp, 3)
            assert set(connector.profile.ports) == {"source0.out", "sink0.inp"}
            await kernel.disconnect(connector)
        await kernel.connect("source0.out", sink.inp, "sink1.inp")
        source.out.write_nowait(long(7))
        assert (sink.inp.read_nowait().data, other.inp.read_nowait().data) == (7, 7)


@pytest.mark.parametrize(
    ("path", "error", "said"),
    [
        ("sink0.imp", WiringError, r"sink0\.imp: sink0 has no port 'imp'; did you mean 'inp'\?"),
        ("sink0.x", WiringError, r"sink0 has no port 'x'; it has inp"),
        ("snik0.inp", WiringError, r"snik0\.inp: no component 'snik0'; did you mean 'sink0'\?"),
        ("nobody.inp", WiringError, r"no component 'nobody'; there are source0, sink0"),
        ("sink0", WiringError, r"sink0: is a component; give one of its ports: sink0\.inp$"),
        ("sink0.inp.more", InvalidNameError, r"'\.' not allowed"),
        ("", InvalidNameError, "is empty"),
    ],
)
async def test_a_path_of_no_port_is_refused_and_nothing_connected(
    path: str, error: type[Exception], said: str, anyio_backend: Any
) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        for ports in ((source.out, path), (path, sink.inp), (source.out, sink.inp, path)):
            with pytest.raises(error, match=said):
                await kernel.connect(*ports)
        assert not kernel.connectors
        assert source.out.connectors == sink.inp.connectors == ()
