"""`convert`: each sample is converted once, in the write; what a converter fails on is counted, and harms nobody."""

from __future__ import annotations

import asyncio
import functools
import logging
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from aiorts import (
    Component,
    Connector,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    OutPort,
    RealtimeContext,
    SimulatedClock,
    Supervision,
    ThreadContext,
    WouldBlock,
)
from aiorts.errors import StateError, WiringError, WriteTimeout
from aiorts.events import ConnectorEvent, ConversionFailed, WriterSilent
from aiorts.testing import simulated
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedLong
from reload_files import Source as CodeFile


class Metres(Component):
    out = OutPort(TimedDouble, unit="m")


class Millimetres(Component):
    inp = InPort(TimedLong, unit="mm")


class Same(Component):
    inp = InPort(TimedDouble)


class Three(Component):
    inp = InPort(TimedDoubleSeq, shape=(3,))


@dataclass
class Reading:
    """As an SDK gives it."""

    values: list[float]
    name: str


class Device(Component):
    out = OutPort(Reading)


def to_mm(sample: TimedDouble) -> TimedLong:
    return TimedLong(sample.tm, round(sample.data * 1000))


def fails(sample: Any) -> Any:
    raise ValueError(f"not {sample.data}")


class Counted:
    """Counts its calls; does what the number says: 13 raises, 14 gives None, 15 another type."""

    def __init__(self) -> None:
        self.calls: list[float] = []

    def __call__(self, sample: TimedDouble) -> Any:
        self.calls.append(sample.data)
        if sample.data == 13:
            raise LookupError("thirteen")
        return {14: None, 15: sample}.get(int(sample.data), to_mm(sample))


def m(value: float) -> TimedDouble:
    return TimedDouble(0, value)


def counts(connector: Connector) -> tuple[int, int, int, dict[str, int]]:
    """Written, delivered, buffered, dropped."""
    ledger = connector.statistics
    assert ledger.balanced
    return ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)


def data(samples: list[Any]) -> list[Any]:
    return [sample.data for sample in samples]


def lines(caplog: pytest.LogCaptureFixture) -> list[str]:
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    caplog.clear()
    return said


async def connected(kernel: Kernel, convert: Any = to_mm, **options: Any) -> tuple[Metres, Millimetres, Connector]:
    source, sink = await kernel.add(Metres("source")), await kernel.add(Millimetres("sink"))
    return source, sink, await kernel.connect(source.out, sink.inp, convert=convert, **options)


@simulated
async def test_ports_of_two_types_and_units_are_connected_and_the_profile_names_the_function() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        assert source.out.write_nowait(TimedDouble(5, 1.5))
        assert sink.inp.read_nowait() == TimedLong(5, 1500)
        assert wire.profile.convert == "to_mm"
        assert '"convert": "to_mm"' in kernel.profile().to_json().replace('":"', '": "')
        assert counts(wire) == (1, 1, 0, {})


def _doubles(sample: TimedDouble, by: float = 1000.0) -> TimedLong:
    return TimedLong(sample.tm, round(sample.data * by))


class _Doubler:
    def __call__(self, sample: TimedDouble) -> TimedLong:
        return to_mm(sample)

    def method(self, sample: TimedDouble) -> TimedLong:
        return to_mm(sample)


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (to_mm, "to_mm"),
        (_doubles, "_doubles"),
        (functools.partial(_doubles, by=1000.0), "_doubles"),
        (_Doubler(), "_Doubler"),
        (_Doubler().method, "_Doubler.method"),
        (lambda sample: to_mm(sample), "<lambda>"),
    ],
    ids=["function", "default", "partial", "object", "method", "lambda"],
)
@simulated
async def test_whatever_is_called_with_one_sample_is_a_converter(function: Any, name: str) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, function)
        source.out.write_nowait(m(0.25))
        assert data(sink.inp.drain()) == [250]
        assert wire.profile.convert == name


async def _later(sample: TimedDouble) -> TimedLong:
    return to_mm(sample)


class _LaterObject:
    async def __call__(self, sample: TimedDouble) -> TimedLong:
        return to_mm(sample)


def _several(sample: TimedDouble) -> Any:
    yield sample


def _two(sample: TimedDouble, other: TimedDouble) -> TimedLong:
    return to_mm(sample)


def _none(sample: TimedDouble) -> None:
    return None


def _of_long(sample: TimedLong) -> TimedLong:
    return sample


def _to_double(sample: TimedDouble) -> TimedDouble:
    return sample


class _Needs:
    def __init__(self, one: int, two: int) -> None: ...


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (3, "convert = int: expected a function or a text, got int; give a plain function of one sample"),
        (_later, "convert = _later: is a coroutine function, .* take the await out of it"),
        (functools.partial(_later), "is a coroutine function"),
        (_LaterObject(), "convert = _LaterObject: is a coroutine function"),
        (_several, "is a generator function, .* give a plain function of one sample"),
        (_two, "cannot be called with one sample alone: missing a required argument: 'other'; give a plain function"),
        (lambda: None, "cannot be called with one sample alone: too many positional arguments; give a plain function"),
        (_Needs, "this class cannot be called with one sample alone"),
        (TimedDouble, "makes TimedDouble, the in-port takes TimedLong"),
        (_none, "returns nothing as it says, the in-port takes TimedLong"),
        (_to_double, "returns TimedDouble as it says, the in-port takes TimedLong"),
        (_of_long, "takes TimedLong as it says, the out-port sends TimedDouble"),
        ("", "expected a text that names a converter"),
    ],
)
@simulated
async def test_what_cannot_be_a_converter_is_refused_with_the_remedy(function: Any, message: str) -> None:
    async with Kernel() as kernel:
        with pytest.raises(WiringError, match=message):
            await connected(kernel, function)
        assert not kernel.connectors


@simulated
async def test_without_convert_two_types_are_refused_and_the_error_names_it() -> None:
    async with Kernel() as kernel:
        with pytest.raises(WiringError, match=r"types differ: .* or give convert = a function"):
            await connected(kernel, None)


@simulated
async def test_none_is_no_converter() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Metres("source")), await kernel.add(Same("sink"))
        wire = await kernel.connect(source.out, sink.inp, convert=None)
        assert wire.profile.convert is None


# -- what fails --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("subscription", ["flush", "new", "periodic"])
@simulated
async def test_what_it_fails_on_is_counted_and_others_have_the_sample(subscription: str) -> None:
    options = {"push": "all"} if subscription == "flush" else {"push": "all", "push_rate": 10.0}
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, Counted(), subscription=subscription, **options)
        plain = await kernel.add(Same("plain"))
        await kernel.connect(source.out, plain.inp)
        assert [source.out.write_nowait(m(number)) for number in (12, 13, 14, 15, 16)] == [True] * 5
        await kernel.sleep(0.11)
        assert data(sink.inp.drain()) == [12000, 16000]
        assert data(plain.inp.drain()) == [12, 13, 14, 15, 16]
        assert counts(wire) == (5, 2, 0, {"unconverted": 3})


class _Exits:
    """Raises at each call another exception that a plain `except Exception` lets through."""

    def __init__(self) -> None:
        self.left: list[BaseException] = [SystemExit(3), asyncio.CancelledError(), GeneratorExit()]

    def __call__(self, sample: Any) -> Any:
        raise self.left.pop()


@simulated
async def test_what_ends_programs_and_tasks_ends_neither() -> None:
    async with Kernel() as kernel:
        source, _, wire = await connected(kernel, _Exits())
        for _ in range(3):
            assert await source.out.write(m(1))
        assert counts(wire) == (3, 0, 0, {"unconverted": 3})


class _Hostile(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no text")


class _Odd:
    def __repr__(self) -> str:
        raise RuntimeError("no text")

    @property
    def __class__(self) -> Any:  # type: ignore[override]
        raise RuntimeError("no class")


@pytest.mark.parametrize("what", [lambda _: _Odd(), lambda _: operator.truediv(1, 0), lambda s: fails(_Odd())])
@simulated
async def test_objects_that_cannot_be_looked_at_harm_nobody(what: Callable[[Any], Any]) -> None:
    async with Kernel() as kernel:
        source, _, wire = await connected(kernel, what)
        assert source.out.write_nowait(m(1))
        await kernel.sleep(0)
        assert counts(wire) == (1, 0, 0, {"unconverted": 1})


@simulated
async def test_an_error_without_a_text_is_reported() -> None:
    def hostile(sample: Any) -> Any:
        raise _Hostile

    async with Kernel() as kernel:
        heard: list[ConversionFailed] = []
        kernel.bus.subscribe(ConversionFailed, heard.append)
        source, _, wire = await connected(kernel, hostile)
        assert source.out.write_nowait(m(1))
        await kernel.sleep(0)
        assert counts(wire) == (1, 0, 0, {"unconverted": 1})
        assert "_Hostile" in heard[0].error


@simulated
async def test_a_coroutine_that_a_function_makes_is_a_wrong_type_and_is_closed() -> None:
    async with Kernel() as kernel:  # that it was never awaited would be a warning, which is an error here
        source, _, wire = await connected(kernel, lambda sample: _later(sample))
        assert source.out.write_nowait(m(1))
        assert counts(wire) == (1, 0, 0, {"unconverted": 1})


@simulated
async def test_a_thousand_failures_are_one_event_and_few_lines_with_place_and_count(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with Kernel() as kernel:
        heard: list[ConversionFailed] = []
        kernel.bus.subscribe(ConversionFailed, heard.append)
        source, _, wire = await connected(kernel, fails)
        for number in range(1000):
            assert source.out.write_nowait(m(number))
            await asyncio.sleep(0.02)
        (event,) = heard
        assert event.connector == wire.name
        assert event.error.startswith("ValueError: not 0.0 (")
        assert f"test_conversion.py:{fails.__code__.co_firstlineno + 1})" in event.error
        first, *more = lines(caplog)
        assert first.startswith(
            "source.out -> sink.inp: 1 sample dropped so far: unconverted, convert = fails: ValueError: not 0.0 ("
        )
        assert first.endswith("further losses are summarised here, all are counted in connector.statistics")
        assert more == ["source.out -> sink.inp: 499 samples more dropped"]
        await kernel.disconnect(wire)
        assert lines(caplog) == ["source.out -> sink.inp: 500 samples more dropped"]
        assert counts(wire) == (1000, 0, 0, {"unconverted": 1000})


@simulated
async def test_after_it_has_worked_for_a_while_a_failure_is_the_first_again(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        heard: list[ConversionFailed] = []
        kernel.bus.subscribe(ConversionFailed, heard.append)
        source, sink, _ = await connected(kernel, Counted())
        source.out.write_nowait(m(13))
        await kernel.sleep(10.0)
        source.out.write_nowait(m(12))
        await kernel.sleep(30.0)
        source.out.write_nowait(m(14))
        await kernel.sleep(0)
        assert [event.error.partition(" (")[0] for event in heard] == [
            "LookupError: thirteen",
            "PortTypeError: expected a TimedLong, got None; end the function with return",
        ]
        assert ["so far" in line for line in lines(caplog)] == [True, True]
        assert data(sink.inp.drain()) == [12000]


@simulated
async def test_the_shape_of_the_in_port_is_checked_after_it_and_not_before() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Metres("source")), await kernel.add(Three("sink"))

        def repeated(sample: TimedDouble) -> TimedDoubleSeq:
            return TimedDoubleSeq(sample.tm, [sample.data] * int(sample.data))

        wire = await kernel.connect(source.out, sink.inp, convert=repeated)
        for length in (2, 3, 4):
            assert source.out.write_nowait(m(length))
        assert [list(sample.data) for sample in sink.inp.drain()] == [[3.0] * 3]
        assert counts(wire) == (3, 1, 0, {"unconverted": 2})


@simulated
async def test_a_dataclass_of_an_sdk_becomes_a_record_and_what_can_change_travels_as_a_copy() -> None:
    kept = Reading([0.0], "kept")

    class Display(Component):
        inp = InPort(Reading)

    async with Kernel() as kernel:
        device, seq = await kernel.add(Device("device")), await kernel.add(Same("seq"))
        display = await kernel.add(Display("display"))
        await kernel.connect(device.out, seq.inp, convert=lambda reading: TimedDouble(0, reading.values[0]))
        await kernel.connect(device.out, display.inp, convert=lambda reading: kept)
        device.out.write_nowait(Reading([4.5, 5.5], "a"))
        kept.name = "changed"
        assert data(seq.inp.drain()) == [4.5]
        assert display.inp.read_nowait().name == "kept"


# -- with the other options --------------------------------------------------------------------------------------------


@simulated
async def test_what_the_push_policy_leaves_out_is_not_converted() -> None:
    async with Kernel() as kernel:
        counted = Counted()
        source, sink, wire = await connected(kernel, counted, subscription="new", push="skip", skip=2, length=8)
        for number in range(1, 10):
            source.out.write_nowait(m(number))
        assert counted.calls == [3, 6, 9]
        assert data(sink.inp.drain()) == [3000, 6000, 9000]
        assert counts(wire) == (9, 3, 0, {"skipped": 6})


@simulated
async def test_what_comes_to_an_inactive_reader_is_not_converted() -> None:
    async with Kernel() as kernel:
        counted = Counted()
        source, sink, wire = await connected(kernel, counted)
        await kernel.start(EventContext(), sink)
        source.out.write_nowait(m(1))
        assert not counted.calls
        assert counts(wire) == (1, 0, 0, {"inactive": 1})


@simulated
async def test_what_it_fails_on_takes_nobodys_place() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, Counted(), length=1)
        source.out.write_nowait(m(1))
        source.out.write_nowait(m(13))
        assert data(sink.inp.drain()) == [1000]
        assert counts(wire) == (2, 1, 0, {"unconverted": 1})


@simulated
async def test_a_write_that_waits_for_room_is_converted_once_and_one_that_fails_does_not_wait() -> None:
    async with Kernel() as kernel:
        counted = Counted()
        source, sink, wire = await connected(kernel, counted, full="block", length=1, timeout=1.0)
        assert await source.out.write(m(1))
        with pytest.raises(WouldBlock):
            source.out.write_nowait(m(2))
        waiting = asyncio.ensure_future(source.out.write(m(3)))
        await asyncio.sleep(0)
        assert await source.out.write(m(13))  # nothing to make room for
        await asyncio.sleep(0.5)
        assert data([sink.inp.read_nowait()]) == [1000]
        assert await waiting
        with pytest.raises(WriteTimeout):
            await source.out.write(m(4))
        assert counted.calls == [1, 3, 13, 4]
        assert data(sink.inp.drain()) == [3000]
        assert counts(wire) == (4, 2, 0, {"unconverted": 1, "timeout": 1})


@simulated
async def test_stamps_are_those_of_the_readers_samples() -> None:
    async with Kernel() as kernel:
        device, sink = await kernel.add(Device("device")), await kernel.add(Millimetres("sink"))

        def length_of(reading: Reading) -> TimedLong:
            return TimedLong(0, len(reading.values))

        await kernel.connect(device.out, sink.inp, convert=length_of, stamp="send")
        device.out.write_nowait(Reading([1.0], "a"))
        assert sink.inp.read_nowait() == TimedLong(kernel.time_ns(), 1)

        class Plain(Component):
            inp = InPort(float)

        plain = await kernel.add(Plain("plain"))
        source = await kernel.add(Metres("source"))
        with pytest.raises(WiringError, match="stamp = send: float has no field tm to put it in"):
            await kernel.connect(source.out, plain.inp, convert=lambda sample: sample.data, stamp="send")


@simulated
async def test_functions_in_c_convert_to_plain_values() -> None:
    class Plain(Component):
        out = OutPort(float)
        inp = InPort(float)

    async with Kernel() as kernel:
        plain = await kernel.add(Plain("plain"))
        await kernel.connect(plain.out, plain.inp, convert=math.sqrt)
        plain.out.write_nowait(9.0)
        assert plain.inp.read_nowait() == 3.0


@simulated
async def test_a_pulled_sample_is_converted_when_it_is_written() -> None:
    async with Kernel() as kernel:
        counted = Counted()
        source, sink, wire = await connected(kernel, counted, dataflow="pull")
        source.out.write_nowait(m(1))
        source.out.write_nowait(m(13))
        assert counted.calls == [1, 13]
        assert data(sink.inp.drain()) == [1000]
        assert counts(wire) == (2, 1, 0, {"unconverted": 1})


@pytest.mark.parametrize("options", [{}, {"subscription": "periodic", "push": "all", "push_rate": 10.0}])
@simulated
async def test_listeners_hear_of_what_the_reader_gets_and_of_what_is_unconverted(options: dict[str, Any]) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, Counted(), **options)
        heard: list[tuple[str, float]] = []
        kernel.listen(wire, lambda event: heard.append((event.kind, event.sample.data)), "received", "unconverted")
        source.out.write_nowait(m(1))
        source.out.write_nowait(m(13))
        await kernel.sleep(0.11)
        assert sorted(heard) == [("received", 1000), ("unconverted", 13)]
        assert data(sink.inp.drain()) == [1000]


@simulated
async def test_a_lifespan_goes_with_it() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, Counted(), lifespan=1.0)
        for number in (1, 13):
            source.out.write_nowait(m(number))
        await kernel.sleep(0.5)
        source.out.write_nowait(m(2))
        await kernel.sleep(0.6)
        assert data(sink.inp.drain()) == [2000]
        assert counts(wire) == (3, 1, 0, {"unconverted": 1, "expired": 1})


@simulated
async def test_each_connector_converts_by_itself_once() -> None:
    async with Kernel() as kernel:
        source = await kernel.add(Metres("source"))
        sinks = [await kernel.add(Millimetres(f"sink{number}")) for number in range(3)]
        counted = Counted()
        await kernel.connect(source.out, *(sink.inp for sink in sinks), convert=counted)
        source.out.write_nowait(m(1))
        assert counted.calls == [1, 1, 1]
        assert [data(sink.inp.drain()) for sink in sinks] == [[1000]] * 3


@simulated
async def test_several_connectors_of_one_reader_keep_the_order_of_arrival() -> None:
    async with Kernel() as kernel:
        source, sink, _ = await connected(kernel, Counted())

        class Longs(Component):
            out = OutPort(TimedLong, unit="mm")

        other = await kernel.add(Longs("other"))
        await kernel.connect(other.out, sink.inp)
        for number in (1, 13, 2):
            source.out.write_nowait(m(number))
            other.out.write_nowait(TimedLong(0, number))
        assert data(sink.inp.drain()) == [1000, 1, 13, 2000, 2]


@simulated
async def test_a_converter_that_ends_its_own_connector_leaves_an_exact_ledger() -> None:
    wires: list[Connector] = []

    def closing(sample: TimedDouble) -> TimedLong:
        wires[0].close()
        return to_mm(sample)

    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, closing)
        wires.append(wire)
        assert source.out.write_nowait(m(1))
        assert counts(wire) == (1, 0, 0, {"disconnected": 1})
        assert not sink.inp.is_new


@simulated
async def test_a_converter_that_has_its_connector_listened_to_leaves_an_exact_ledger() -> None:
    async with Kernel() as kernel:

        def listening(sample: TimedDouble) -> TimedLong:
            kernel.listen(wire, lambda _: None)
            return to_mm(sample)

        source, sink, wire = await connected(kernel, listening)
        assert source.out.write_nowait(m(1))
        assert counts(wire) == (1, 0, 1, {})
        assert data(sink.inp.drain()) == [1000]


# -- threads -----------------------------------------------------------------------------------------------------------


class Worker(Component):
    """Writes in its own thread until it has written as many as it is told."""

    out = OutPort(TimedDouble)

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.numbers = [float(number) for number in range(10, 20)]
        self.done = asyncio.Event()

    def on_execute(self) -> None:
        if self.numbers:
            self.out.write_nowait(m(self.numbers.pop(0)))


@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_in_a_thread_it_runs_in_the_writers_thread(anyio_backend: str) -> None:
    import threading

    threads: set[str] = set()

    def noting(sample: TimedDouble) -> TimedLong:
        threads.add(threading.current_thread().name)
        if sample.data == 13:
            raise LookupError("thirteen")
        return to_mm(sample)

    async with Kernel() as kernel:
        worker, sink = await kernel.add(Worker("worker")), await kernel.add(Millimetres("sink"))
        heard: list[ConversionFailed] = []
        kernel.bus.subscribe(ConversionFailed, heard.append)
        wire = await kernel.connect(worker.out, sink.inp, convert=noting, length=32)
        await kernel.start(ThreadContext(200.0), worker, activate=True)
        async with asyncio.timeout(20.0):
            while wire.statistics.written < 10 or not heard:
                await asyncio.sleep(0.01)
        assert threading.current_thread().name not in threads
        assert len(threads) == 1
        assert data(sink.inp.drain()) == [number * 1000 for number in range(10, 20) if number != 13]
        assert counts(wire) == (10, 9, 0, {"unconverted": 1})


@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_what_an_sdks_thread_writes_is_converted_on_the_loop(anyio_backend: str) -> None:
    import threading

    threads: set[str] = set()

    def noting(sample: TimedDouble) -> TimedLong:
        threads.add(threading.current_thread().name)
        return to_mm(sample)

    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, noting)
        thread = threading.Thread(target=lambda: source.out.write_from_thread(m(1.0)))
        thread.start()
        thread.join()
        async with asyncio.timeout(20.0):
            assert (await sink.inp.read()).data == 1000
        assert threads == {threading.current_thread().name}
        assert source.out.thread_writes.written == 1
        assert counts(wire) == (1, 1, 0, {})


@pytest.mark.parametrize("end", ["source", "sink"])
@simulated
async def test_real_time_ends_refuse_it_with_the_remedy(end: str) -> None:
    async with Kernel() as kernel:
        source, sink, _ = await connected(kernel)
        with pytest.raises(StateError, match=r"has convert, and no real-time thread has such a connector .* connect"):
            await kernel.start(RealtimeContext(100.0), kernel.components[end])
        source.out.write_nowait(m(1))
        assert data(sink.inp.drain()) == [1000]


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_a_component_of_a_real_time_context_is_not_connected_with_it(anyio_backend: str) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Metres("source")), await kernel.add(Millimetres("sink"))
        await kernel.start(RealtimeContext(100.0), source)
        with pytest.raises(WiringError, match="has convert, and source runs in a real-time thread"):
            await kernel.connect(source.out, sink.inp, convert=to_mm)


# -- components that come again ----------------------------------------------------------------------------------------


class Failing(Component):
    """Fails once it has written a sample below zero."""

    out = OutPort(TimedDouble, unit="m")

    def on_execute(self) -> None:
        raise RuntimeError("broken")


@simulated
async def test_a_restart_keeps_the_converter() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Failing("source")), await kernel.add(Millimetres("sink"))
        await kernel.connect(source.out, sink.inp, convert=to_mm)
        kernel.supervise(source, Supervision("restart", backoff=0.1), factory=Failing)
        context = ExternalContext()
        await kernel.start(context, source, activate=True)
        await context.tick()
        await kernel.sleep(1.0)
        new = kernel.components["source"]
        assert new is not source
        assert isinstance(new, Failing)
        new.out.write_nowait(m(2))
        assert data(sink.inp.drain()) == [2000]


@pytest.mark.slow(kept_by="test_a_restart_keeps_the_converter")
@pytest.mark.parametrize("end", ["Writer", "Reader"])
@simulated
async def test_a_reloaded_end_keeps_the_converter_and_what_is_unread(end: str, tmp_path: Path) -> None:
    file = CodeFile(
        tmp_path,
        """
        class Writer(Component):
            out = OutPort(TimedDouble, unit="m")
        class Reader(Component):
            inp = InPort(TimedLong, unit="mm")
        """,
    )
    async with Kernel() as kernel:
        await kernel.create(file.get("Writer"), "writer"), await kernel.create(file.get("Reader"), "reader")
        find: Any = kernel.find
        wire = await kernel.connect(find("writer.out"), find("reader.inp"), convert=to_mm)
        find("writer.out").write_nowait(m(1))
        file.replace('unit="m"', 'unit="inch"')
        before = kernel.components[end.lower()]
        await kernel.reload(file.get(end))
        assert kernel.components[end.lower()] is not before
        find("writer.out").write_nowait(m(2))
        assert data(find("reader.inp").drain()) == [1000, 2000]
        assert wire.profile.convert == "to_mm"
        file.forget()


@simulated
async def test_in_debug_mode_what_travels_is_a_copy(simulated_clock: SimulatedClock) -> None:
    made = TimedDoubleSeq(0, [1.0])

    class Seq(Component):
        inp = InPort(TimedDoubleSeq)

    async with Kernel(debug=True) as kernel:
        source, sink = await kernel.add(Metres("source")), await kernel.add(Seq("sink"))
        await kernel.connect(source.out, sink.inp, convert=lambda _: made)
        source.out.write_nowait(m(1))
        got = sink.inp.read_nowait()
        assert got == made
        assert got is not made


@simulated
async def test_events_of_all_connectors_are_heard_of_it() -> None:
    async with Kernel() as kernel:
        heard: list[str] = []
        kernel.bus.subscribe(ConnectorEvent, lambda event: heard.append(event.kind))
        source, _, _ = await connected(kernel, fails)
        source.out.write_nowait(m(1))
        await kernel.sleep(0)
        assert heard == ["connect", "unconverted"]


# -- options that are changed, and kept promises -----------------------------------------------------------------------


@simulated
async def test_a_change_keeps_it_and_converts_nothing_again() -> None:
    async with Kernel() as kernel:
        counted = Counted()
        source, sink, wire = await connected(kernel, counted, full="block", length=1, timeout=None)
        writes = [asyncio.ensure_future(source.out.write(m(number))) for number in (1, 2, 3)]
        await asyncio.sleep(0)
        wire.change(length=4)
        assert await asyncio.gather(*writes) == [True] * 3
        wire.change(full="overwrite", length=2)
        source.out.write_nowait(m(13))
        assert counted.calls == [1, 2, 3, 13]
        assert data(sink.inp.drain()) == [1000, 2000, 3000]
        assert wire.profile.convert == "Counted"
        assert counts(wire) == (4, 3, 0, {"unconverted": 1})


@simulated
async def test_a_rendezvous_gives_what_was_converted_and_waits_for_nothing_that_failed() -> None:
    async with Kernel() as kernel:
        counted = Counted()
        source, sink, wire = await connected(kernel, counted, length=0)
        read = asyncio.ensure_future(sink.inp.read())
        await asyncio.sleep(0)
        assert source.out.write_nowait(m(13))  # the read goes on waiting
        assert source.out.write_nowait(m(1))
        assert (await read).data == 1000
        assert await source.out.write(m(14))
        write = asyncio.ensure_future(source.out.write(m(2)))
        await asyncio.sleep(0)
        assert data(sink.inp.drain()) == [2000]
        assert await write
        assert counted.calls == [13, 1, 14, 2]
        assert counts(wire) == (4, 2, 0, {"unconverted": 2})


@simulated
async def test_a_writer_whose_samples_fail_is_not_silent() -> None:
    async with Kernel() as kernel:
        heard: list[object] = []
        kernel.bus.subscribe(WriterSilent, heard.append)
        source, sink, _ = await connected(kernel, fails, max_gap=1.0)
        await kernel.start(EventContext(), source, sink, activate=True)
        for _ in range(8):
            source.out.write_nowait(m(1))
            await kernel.sleep(0.5)
        assert not heard
        await kernel.sleep(3.0)
        assert len(heard) == 1
