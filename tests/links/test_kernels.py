"""Connectors whose ends are in two kernels, over the sockets of this host."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Any, ClassVar

import pytest
from anyio import WouldBlock, fail_after, sleep

from aiorts import Component, EventContext, InPort, Kernel, LifecycleState, OutPort
from aiorts.errors import InvalidNameError, LinkError, StateError, WiringError, WriteTimeout
from aiorts.links import Links
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedLong, record

pytestmark = pytest.mark.anyio


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


class Metres(Component):
    out = OutPort(TimedLong, unit="m")


class Seconds(Component):
    inp = InPort(TimedLong, unit="s")


class Three(Component):
    inp = InPort(TimedDoubleSeq, shape=(3,))


class Any3(Component):
    out = OutPort(TimedDoubleSeq)


class Reals(Component):
    inp = InPort(TimedDouble)


@record
class Level:
    """A number with a rule of its own."""

    value: int
    lowest: ClassVar[int] = -10

    def __post_init__(self) -> None:
        if self.value < self.lowest:
            raise ValueError("too low")


class Guarded(Component):
    out = OutPort(Level)
    inp = InPort(Level)


def long(value: int) -> TimedLong:
    return TimedLong(tm=0, data=value)


def reachable(name: str) -> Kernel:
    return Kernel(name, services={"links": {}})


async def until(holds: Callable[[], object], seconds: float = 10.0) -> None:
    with fail_after(seconds):
        while not holds():
            await sleep(0.002)


def data(port: Any) -> list[int]:
    return [sample.data for sample in port.drain()]


async def test_what_is_written_in_one_kernel_is_read_in_the_other_in_order_and_accounted_for() -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", full="block", timeout=None)
        assert connector.in_.path == "two/sink0.inp"
        assert (connector.profile.subscription, connector.profile.push) == ("new", "all")
        seen: list[int] = []
        task = asyncio.ensure_future(_write(source, 3_000))
        with fail_after(20):
            while len(seen) < 3_000:
                seen.append((await sink.inp.read()).data)
        await task
        assert seen == list(range(3_000))
        await until(lambda: connector.statistics.acknowledged == 3_000)
        ledger = connector.statistics
        assert (ledger.written, ledger.delivered, ledger.in_flight, ledger.balanced) == (3_000, None, 0, True)
        (far,) = two.connectors.values()
        assert far.out.path == "one/source0.out"
        assert (far.statistics.written, far.statistics.delivered) == (3_000, 3_000)


async def _write(source: Source, count: int) -> None:
    for value in range(count):
        await source.out.write(long(value))


@pytest.mark.slow
async def test_a_slow_reader_stops_the_writer_whose_buffer_then_decides() -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", length=4, full="reject")
        done = []
        for value in range(600):
            done.append(source.out.write_nowait(long(value)))
            if value % 20 == 0:
                await sleep(0)
        await sleep(0.2)
        ledger = connector.statistics
        assert ledger.balanced
        assert ledger.dropped["rejected"] == done.count(False) > 0
        seen = []
        with fail_after(10):
            while len(seen) < done.count(True):
                seen.append((await sink.inp.read()).data)
        assert seen == [value for value, taken in enumerate(done) if taken]  # inside the window nothing is lost


async def test_a_flush_returns_when_the_sample_is_in_the_readers_buffer() -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", subscription="flush", full="reject", length=2)
        for value in range(2):
            assert await source.out.write(long(value))
            assert sink.inp.is_new
            assert connector.statistics.acknowledged == value + 1
        assert not await source.out.write(long(2))  # no room: the reader's end says so
        assert connector.statistics.dropped == {"rejected": 1}
        assert source.out.write_nowait(long(3))  # never waits
        await until(lambda: not connector.statistics.in_flight)
        assert connector.statistics.dropped == {"rejected": 2}
        assert data(sink.inp) == [0, 1]
        assert connector.statistics.balanced


@pytest.mark.slow
async def test_a_flush_without_an_answer_in_time_names_the_link_and_the_sample_stays_in_flight() -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(
            source.out, "two/sink0.inp", subscription="flush", full="block", length=1, timeout=0.1
        )
        assert await source.out.write(long(0))
        with pytest.raises(WriteTimeout, match=r"two/sink0\.inp \(0\.1 s\)"):
            await source.out.write(long(1))
        assert (connector.statistics.in_flight, connector.statistics.dropped) == (1, {})
        task = asyncio.ensure_future(source.out.write(long(2)))
        await sleep(0.02)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        ledger = connector.statistics
        assert (ledger.in_flight, ledger.written, ledger.balanced) == (2, 3, True)  # it was sent
        seen = []
        with fail_after(10):
            while len(seen) < 3:
                seen.append((await sink.inp.read()).data)
        assert seen == [0, 1, 2]
        await until(lambda: connector.statistics.acknowledged == 3)


async def test_a_flush_to_a_kernel_that_is_not_there_writes_nothing_when_it_times_out() -> None:
    async with Kernel("one") as one:
        source = await one.add(Source())
        connector = await one.connect(source.out, "two/sink0.inp", subscription="flush", timeout=0.05, full="block")
        with pytest.raises(WriteTimeout):
            await source.out.write(long(0))
        assert connector.statistics.dropped == {"timeout": 1}
        for value in range(8):
            source.out.write_nowait(long(value))
        with pytest.raises(WouldBlock):
            source.out.write_nowait(long(8))
        assert (connector.statistics.buffered, connector.statistics.balanced) == (8, True)


@pytest.mark.parametrize(
    ("writer", "port", "said"),
    [
        (Source, "two/reals0.inp", r"the writer sends 'TimedLong', the reader takes TimedDouble"),
        (Metres, "two/seconds0.inp", r"units differ: .* sends 'm', .* takes 's'"),
        (Source, "two/sink0.imp", r"sink0 has no port 'imp'; did you mean 'inp'"),
    ],
)
async def test_ports_that_do_not_fit_are_refused_at_both_ends(writer: Any, port: str, said: str) -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source = await one.add(writer())
        for kind in (Sink, Seconds, Reals):
            await two.add(kind())
        with pytest.raises(WiringError, match=said):
            await one.connect(source.out, port)
        assert not one.connectors
        assert not two.connectors


async def test_ports_that_do_not_fit_are_refused_also_where_the_readers_kernel_connects() -> None:
    async with reachable("one") as one, Kernel("two") as two:
        await one.add(Source())
        reals = await two.add(Reals())
        with fail_after(10):
            with pytest.raises(WiringError, match=r"the writer sends 'TimedLong', the reader takes TimedDouble"):
                await two.connect("one/source0.out", reals.inp)
            await until(lambda: not one.connectors)
        assert not two.connectors


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"length": 0}, "length = 0: the reader is in another kernel"),
        ({"convert": lambda sample: sample}, "convert: the reader is in another kernel"),
        ({"dataflow": "pull", "max_gap": 1.0}, "max_gap does not go with dataflow = pull to another kernel"),
        ({"on_link_lost": "wiat"}, "on_link_lost"),
    ],
)
async def test_options_that_a_link_does_not_have_are_refused(options: dict[str, Any], said: str) -> None:
    async with Kernel("one") as one:
        source = await one.add(Source())
        with pytest.raises(WiringError, match=said):
            await one.connect(source.out, "two/sink0.inp", **options)


@pytest.mark.parametrize(
    "options",
    [
        {"subscription": "periodic", "push_rate": 10.0},
        {"subscription": "new", "push": "skip", "skip": 1},
        {"stamp": "send"},
    ],
)
async def test_what_the_writers_end_does_is_chosen_there(options: dict[str, Any]) -> None:
    async with Kernel("two") as two:
        sink = await two.add(Sink())
        with pytest.raises(WiringError, match="the writer is in another kernel; connect them there"):
            await two.connect("one/source0.out", sink.inp, **options)


async def test_on_link_lost_needs_a_link() -> None:
    async with Kernel("one") as one:
        source, sink = await one.add(Source()), await one.add(Sink())
        with pytest.raises(WiringError, match="both ports are in this kernel"):
            await one.connect(source.out, sink.inp, on_link_lost="error")


async def test_a_kernel_of_another_spelling_is_proposed(caplog: pytest.LogCaptureFixture) -> None:
    async with reachable("station"), reachable("one") as one:
        source = await one.add(Source())
        with caplog.at_level(logging.WARNING):
            connector = await one.connect(source.out, "statoin/sink0.inp")
        assert caplog.text.count("waits: there is no kernel 'statoin' yet; did you mean 'station'?") == 1
        one.connections.end(connector)
        caplog.clear()
        async with Kernel("other") as other:
            writer, links = await other.add(Source()), other.service(Links)
            with caplog.at_level(logging.WARNING):
                (made,) = other.connections.make((writer.out, "lab/sink0.inp"), {})  # while the transport opens
                await until(lambda: "there are" in caplog.text)
            assert re.search("waits: there is no kernel 'lab' yet; there are (station, one|one, station)", caplog.text)
            assert "'lab' yet; there are" in links.report()[made.name]


async def test_what_is_not_there_yet_is_waited_for(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel("one") as one:
        source = await one.add(Source())
        with caplog.at_level(logging.WARNING):
            connector = await one.connect(source.out, "two/sink0.inp")
        assert "waits: there is no kernel 'two' yet" in caplog.text
        source.out.write_nowait(long(1))
        assert connector.statistics.buffered == 1
        async with reachable("two") as two:
            with caplog.at_level(logging.WARNING):
                await until(lambda: "no component 'sink0'" in caplog.text)
            sink = await two.add(Sink())
            await until(lambda: sink.inp.is_new)
            assert data(sink.inp) == [1]


@pytest.mark.row(56)
@pytest.mark.fault("E01")
async def test_a_kernel_that_is_started_anew_goes_on_with_the_loss_counted() -> None:
    async with Kernel("one") as one:
        source = await one.add(Source())
        async with reachable("two") as two:
            sink = await two.add(Sink())
            connector = await one.connect(source.out, "two/sink0.inp", length=2, full="block")
            for value in range(5):
                source.out.write_nowait(long(value))
                await sleep(0)
            await until(lambda: connector.statistics.acknowledged == 2)  # two wait at the reader's end for room
            await until(lambda: connector.statistics.in_flight == 3)
        assert not connector.closed
        async with reachable("two") as two:
            sink = await two.add(Sink())
            source.out.write_nowait(long(5))
            await until(lambda: sink.inp.is_new)
            assert data(sink.inp) == [5]
            await until(lambda: not connector.statistics.in_flight)
            ledger = connector.statistics
            assert ledger.dropped == {"unknown_fate": 3}
            assert (ledger.written, ledger.acknowledged, ledger.balanced) == (6, 3, True)


async def test_the_kernel_of_the_reader_may_connect_too() -> None:
    async with reachable("one") as one, Kernel("two") as two:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await two.connect("one/source0.out", sink.inp, length=3)
        await until(lambda: bool(source.out.connectors))
        source.out.write_nowait(long(7))
        await until(lambda: sink.inp.is_new)
        assert data(sink.inp) == [7]
        assert connector.out.path == "one/source0.out"
        await two.disconnect(connector)
        await until(lambda: not one.connectors)


@pytest.mark.parametrize("end", ["one", "two"])
async def test_the_end_of_a_connector_at_one_end_is_its_end_at_the_other(end: str) -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, _ = await one.add(Source()), await two.add(Sink())
        await one.connect(source.out, "two/sink0.inp")
        kernel = one if end == "one" else two
        await kernel.disconnect(next(iter(kernel.connectors.values())))
        await until(lambda: not one.connectors and not two.connectors)


@pytest.mark.slow
async def test_what_has_come_can_be_read_after_the_writer_has_ended() -> None:
    async with reachable("two") as two:
        sink = await two.add(Sink())
        async with Kernel("one") as one:
            source = await one.add(Source())
            await one.connect(source.out, "two/sink0.inp", length=4, full="block", timeout=None)
            for value in range(8):
                await source.out.write(long(value))
        await sleep(0.2)
        seen = []
        with fail_after(10):
            while len(seen) < 8:
                seen.append((await sink.inp.read()).data)
        assert seen == list(range(8))
        await until(lambda: not two.connectors)


async def test_two_connectors_of_the_same_ports_need_to_be_allowed() -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        await one.connect(source.out, "two/sink0.inp")
        with pytest.raises(WiringError, match="connected already"):
            await one.connect(source.out, "two/sink0.inp")
        with pytest.raises(
            WiringError, match="connected already, here or from the other kernel, and one of the two is"
        ):
            await two.connect(sink.inp, "one/source0.out")
        await one.connect(source.out, "two/sink0.inp", allow_duplicate=True)
        source.out.write_nowait(long(1))
        assert len(two.connectors) == 2
        await until(lambda: sum(one.statistics.written for one in two.connectors.values()) == 2)
        assert data(sink.inp) == [1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["wait", "error", "disconnect"])
async def test_what_happens_when_the_link_is_lost_is_an_option(policy: Any) -> None:
    async with Kernel("one") as one:
        source = await one.add(Source())
        context = await one.start(EventContext(), source, activate=True)
        async with reachable("two") as two:
            await two.add(Sink())
            connector = await one.connect(source.out, "two/sink0.inp", on_link_lost=policy)
        if policy == "disconnect":
            await until(lambda: connector.closed)
        elif policy == "error":
            await until(lambda: source.states[context.name] is LifecycleState.ERROR)
            assert isinstance(source.last_error, LinkError)
        else:
            await sleep(0.1)
            assert not connector.closed
            assert source.states[context.name] is LifecycleState.ACTIVE


@pytest.mark.fault("E09")
async def test_two_kernels_of_one_name_are_refused() -> None:
    async with reachable("two") as two:
        await two.service(Links).opened()
        async with Kernel("two") as other:
            source = await other.add(Source())
            with pytest.raises(LinkError, match="a kernel named 'two' runs already"):
                await other.connect(source.out, "one/sink0.inp")


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("E09")
async def test_a_kernel_whose_name_is_taken_is_reached_when_the_other_one_has_ended(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with Kernel("one") as one, AsyncExitStack() as stack:
        source, old, new = await one.add(Source()), reachable("two"), reachable("two")
        with caplog.at_level(logging.WARNING):
            async with old:
                await old.service(Links).opened()
                connector = await one.connect(source.out, "two/sink0.inp")
                sink = await (await stack.enter_async_context(new)).add(Sink())
                for _ in range(2):
                    with pytest.raises(LinkError, match="a kernel named 'two' runs already"):
                        await new.service(Links).opened()
                    await sleep(0.25)
                assert len(one.service(Links).peers) == 1
            source.out.write_nowait(long(3))
            with fail_after(5):
                assert (await sink.inp.read()).data == 3
            await new.service(Links).opened()
        assert caplog.text.count("it is tried again while this one runs") == 1
        assert caplog.text.count("links: other kernels can be reached now") == 1
        assert connector.statistics.balanced


async def test_a_name_that_no_other_kernel_would_take_is_refused() -> None:
    with pytest.raises(InvalidNameError, match=r"\[links\]: kernel name 'a/b': '/' not allowed"):
        async with Kernel("one", services={"links": {"name": "a/b"}}):
            pass


async def test_a_kernel_that_ends_tries_no_more(caplog: pytest.LogCaptureFixture) -> None:
    async with reachable("two") as old:
        await old.service(Links).opened()
        async with reachable("two") as new:
            with pytest.raises(LinkError, match="runs already"):
                await new.service(Links).opened()
    await sleep(0.02)
    assert not any("links" in task.get_name() for task in asyncio.all_tasks())
    assert "can be reached now" not in caplog.text


@pytest.mark.slow
async def test_a_sample_of_another_shape_than_the_reader_takes_is_dropped_and_said_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with reachable("two") as two, Kernel("one") as one:
        writer, reader = await one.add(Any3()), await two.add(Three())
        connector = await one.connect(writer.out, "two/three0.inp", length=2, full="block", timeout=None)
        for length in (3, 2, 3, 4, 3):
            await writer.out.write(TimedDoubleSeq(data=[1.0] * length))
        seen = []
        with fail_after(10):
            while len(seen) < 3:
                seen.append(len((await reader.inp.read()).data))
        await until(lambda: not connector.statistics.in_flight)
        assert seen == [3, 3, 3]
        assert connector.statistics.dropped == {"undecodable": 2}
        assert caplog.text.count("dropped what cannot be decoded") == 1


@pytest.mark.slow
async def test_a_sample_that_its_class_refuses_at_the_reader_is_dropped_and_the_next_ones_come(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Guarded()), await two.add(Guarded("sink0"))
        connector = await one.connect(source.out, "two/sink0.inp")
        source.out.write_nowait(Level(-1))
        monkeypatch.setattr(Level, "lowest", 0)  # as in a kernel that runs another version of the class
        source.out.write_nowait(Level(2))
        with fail_after(10):
            assert (await sink.inp.read()).value == 2
        await until(lambda: connector.statistics.acknowledged == 1)
        assert dict(connector.statistics.dropped) == {"undecodable": 1}
        assert caplog.text.count("dropped what cannot be decoded: ValueError: too low") == 1


@pytest.mark.parametrize(
    "options", [{"subscription": "new", "push": "new"}, {"subscription": "periodic", "push_rate": 200.0, "push": "all"}]
)
async def test_new_new_has_the_newest_and_periodic_all_of_them(options: Any) -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", out_length=500, **options)
        for value in range(100):
            source.out.write_nowait(long(value))
        seen: list[int] = []
        with fail_after(10):
            while not seen or seen[-1] != 99:
                seen.append((await sink.inp.read()).data)
        await until(lambda: not connector.statistics.in_flight)
        assert seen == (sorted(seen) if options["push"] == "new" else list(range(100)))
        assert connector.statistics.balanced


@pytest.mark.slow
@pytest.mark.row(37)
async def test_a_reader_may_pull() -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", dataflow="pull")
        for value in range(3):
            source.out.write_nowait(long(value))
        with fail_after(10):
            assert await sink.inp.read() == long(2)
            reading = asyncio.ensure_future(sink.inp.read())
            await sleep(0.05)
            source.out.write_nowait(long(3))
            assert await reading == long(3)
        await until(lambda: connector.statistics.acknowledged == 2)
        assert connector.statistics.dropped == {"superseded": 2}


@pytest.mark.slow
async def test_options_of_a_link_are_not_replaced_in_place() -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, _ = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp")
        with pytest.raises(StateError, match="its other end is in another kernel"):
            one.connections.replace_options(connector, {"length": 3})
        connector.change(length=3)
        assert connector.profile.length == 3
        assert source.out.write_nowait(long(1))
        await until(lambda: connector.statistics.acknowledged == 1)


async def test_arrays_travel_whole() -> None:
    import numpy as np

    class Many(Component):
        out = OutPort(TimedDoubleSeq)
        inp = InPort(TimedDoubleSeq)

    async with reachable("two") as two, Kernel("one") as one:
        many, other = await one.add(Many()), await two.add(Many())
        await one.connect(many.out, "two/many0.inp", subscription="flush")
        values = np.arange(300_000, dtype=float)
        assert await many.out.write(TimedDoubleSeq(data=values))
        assert (other.inp.read_nowait().data == values).all()


async def test_one_write_after_the_other_uses_the_window_before_it_would_have_to_wait() -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", full="block", length=256)
        taken = 0
        with pytest.raises(WouldBlock):  # noqa: PT012 - each but the last one is taken
            while True:
                source.out.write_nowait(long(taken))
                taken += 1
        assert taken == 2 * 256
        seen: list[int] = []
        with fail_after(10):
            while len(seen) < taken:
                seen.append((await sink.inp.read()).data)
            await until(lambda: not connector.statistics.in_flight)
        assert seen == list(range(taken))
        assert (connector.statistics.acknowledged, connector.statistics.dropped) == (taken, {})


async def test_of_samples_that_come_together_one_that_its_class_refuses_is_dropped_alone(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Guarded()), await two.add(Guarded("sink0"))
        connector = await one.connect(source.out, "two/sink0.inp", length=100, full="block")
        for value in range(100):
            source.out.write_nowait(Level(-1 if value % 10 == 7 else value))
        monkeypatch.setattr(Level, "lowest", 0)  # as in a kernel that runs another version of the class
        wanted = [value for value in range(100) if value % 10 != 7]
        with fail_after(10):
            assert [(await sink.inp.read()).value for _ in wanted] == wanted
            await until(lambda: not connector.statistics.in_flight)
        assert dict(connector.statistics.dropped) == {"undecodable": 10}
        assert caplog.text.count("dropped what cannot be decoded: ValueError: too low") == 1


async def test_a_burst_inside_the_window_loses_nothing_whatever_the_length() -> None:
    async with reachable("two") as two, Kernel("one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", length=4)
        for value in range(200):
            source.out.write_nowait(long(value))
        assert connector.statistics.dropped == {}
        seen: list[int] = []
        with fail_after(10):
            while len(seen) < 200:
                seen.append((await sink.inp.read()).data)
        assert seen == list(range(200))
