"""Writing: what is checked, who gets it, who waits, and what is left when a wait ends early."""

from __future__ import annotations

import asyncio
import random
from dataclasses import FrozenInstanceError, dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, ExternalContext, InPort, Kernel, OutPort, SimulatedClock, WouldBlock
from aiorts.errors import DeclarationError, PortTypeError, RecordError, RecordTypeError, WiringError, WriteTimeout
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.out_port import write_all
from aiorts.testing.simulation import simulate
from aiorts.types import TimedBoolean, TimedDouble, TimedDoubleSeq, TimedLong, TimedString, record, u8
from aiorts.wire import MsgpackCodec
from campaign import cases
from ports.parts import Both, Sink, Source, data, long

pytestmark = pytest.mark.anyio


async def fan(kernel: Kernel, *options: dict[str, Any]) -> tuple[Source, list[Sink]]:
    """A source connected to one sink for each set of options."""
    source = await kernel.add(Source())
    sinks = [await kernel.add(Sink()) for _ in options]
    for sink, chosen in zip(sinks, options, strict=True):
        await kernel.connect(source.out, sink.inp, **chosen)
    return source, sinks


BLOCK: dict[str, Any] = {"full": "block", "length": 2}


# -- several at once -------------------------------------------------------------------------------------------------


async def test_several_samples_at_once_are_written_as_far_as_there_is_room_and_notify_once(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, (sink,) = await fan(kernel, BLOCK | {"length": 4})
        told: list[int] = []
        receiver_of(sink.inp).add_callback(lambda port: told.append(len(data(port.drain()))))
        assert write_all(source.out, [long(value) for value in range(3)]) == 3
        assert told == [1]  # with the first; the others are there when the loop turns
        assert write_all(source.out, [long(value) for value in range(9)]) == 2
        assert write_all(source.out, [long(9)]) == 0
        assert data(sink.inp.drain()) == [1, 2, 0, 1]
        statistics = sink.inp.connectors[0].statistics
        assert (statistics.written, statistics.delivered, statistics.dropped) == (5, 5, {})


async def test_who_hears_of_each_sample_hears_of_each_of_several(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, (sink,) = await fan(kernel, BLOCK | {"length": 4})
        receiver_of(sink.inp).add_callback(lambda _: True)
        assert write_all(source.out, [long(1), long(2)]) == 1


@pytest.mark.parametrize(
    "options", [({}, {}), ({"stamp": "send"},), ({"subscription": "new", "push": "skip", "skip": 1},)]
)
async def test_samples_that_somebody_looks_at_are_not_written_at_once(options: Any, anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, _ = await fan(kernel, *options)
        assert write_all(source.out, [long(1), long(2)]) == 0
        assert write_all(source.out, []) == 0


# -- what is checked ------------------------------------------------------------------------------------------------


@pytest.mark.fault("B02")
@pytest.mark.parametrize("wrong", [1, "1", None, TimedString(0, "1"), TimedDouble(0, 1.0), TimedLong], ids=repr)
async def test_a_value_of_another_type_is_refused_at_the_writer(wrong: Any, anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, [sink] = await fan(kernel, {})
        with pytest.raises(TypeError, match=r"source0\.out: expected a TimedLong, got"):
            source.out.write_nowait(wrong)
        with pytest.raises(PortTypeError, match="nothing was sent"):
            await source.out.write(wrong)
        assert sink.inp.connectors[0].statistics.written == 0
        assert not sink.inp.is_new


class Shaped(Component):
    out = OutPort(TimedDoubleSeq, shape=(3,))


class Unshaped(Component):
    out = OutPort(TimedDoubleSeq)
    inp = InPort(TimedDoubleSeq)


class ShapedSink(Component):
    inp = InPort(TimedDoubleSeq, shape=(3,))


@pytest.mark.fault("B03")
async def test_a_shape_is_checked_at_write_with_expected_and_got(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        shaped, free, sink = await kernel.add(Shaped()), await kernel.add(Unshaped()), await kernel.add(ShapedSink())
        await kernel.connect(shaped.out, free.inp)
        await kernel.connect(free.out, sink.inp)
        for out, inp, named in ((shaped.out, free.inp, r"shaped0\.out"), (free.out, sink.inp, r"shapedsink0\.inp")):
            for wrong in ([], [1.0] * 4, [1.0]):
                with pytest.raises(PortTypeError, match=rf"(?s){named}.*") as caught:
                    out.write_nowait(TimedDoubleSeq(0, wrong))
                assert "(3,)" in str(caught.value)
                assert f"({len(wrong)},)" in str(caught.value)
            assert inp.connectors[0].statistics.written == 0
            for right in ([1.0, 2.0, 3.0], np.array([1.0, 2.0, 3.0], ">f8"), np.arange(6.0)[::2]):
                out.write_nowait(TimedDoubleSeq(0, right))
                assert inp.read_nowait().data.tolist() == np.asarray(right).tolist()


@pytest.mark.slow
@pytest.mark.fault("B03")
async def test_of_1000_arrays_exactly_those_of_the_shape_pass_and_arrive_unchanged() -> None:
    chance = np.random.default_rng(3)
    async with Kernel() as kernel:
        shaped, free = await kernel.add(Shaped()), await kernel.add(Unshaped())
        await kernel.connect(shaped.out, free.inp)
        for _ in range(1_000):
            length = int(chance.integers(0, 6))
            array = chance.normal(size=length * 2).astype(chance.choice(["<f8", ">f8"]))
            array = array[:: int(chance.choice([-2, 2]))] if chance.random() < 0.5 else array[:length]
            expected = array.tolist()
            if length == 3:
                shaped.out.write_nowait(TimedDoubleSeq(0, array))
                array[:] = 0.0
                assert free.inp.read_nowait().data.tolist() == expected
            else:
                with pytest.raises(PortTypeError):
                    shaped.out.write_nowait(TimedDoubleSeq(0, array))
        assert free.inp.connectors[0].statistics.buffered == 0


@pytest.mark.fault("B03")
def test_a_ragged_or_wrongly_typed_array_is_refused_where_the_record_is_made() -> None:
    for wrong in ([[1.0], [1.0, 2.0]], np.zeros((2, 2)), np.array(1.0), np.array(["a"])):
        with pytest.raises(RecordError):
            TimedDoubleSeq(0, wrong)


@pytest.mark.row(36, 50)
@pytest.mark.parametrize("value", [0, False, "", 0.0, b""], ids=repr)
async def test_a_value_that_is_false_is_sent_like_any_other(value: Any, anyio_backend: Any) -> None:
    class Falsy(Component):
        out = OutPort(type(value))
        inp = InPort(type(value))

    async with Kernel() as kernel:
        falsy = await kernel.add(Falsy())
        await kernel.connect(falsy.out, falsy.inp)
        assert falsy.out.write_nowait(value) is True
        assert falsy.inp.is_new
        assert falsy.inp.peek() == value
        assert falsy.inp.read_nowait() is value
        falsy.out.write_nowait(value)
        assert falsy.inp.latest is value
        assert falsy.inp.latest is value
        await falsy.out.write(value)
        assert await falsy.inp.read() is value


@pytest.mark.row(36)
async def test_records_of_zero_false_and_nothing_are_sent(anyio_backend: Any) -> None:
    class Empty(Component):
        long_out, long_in = OutPort(TimedLong), InPort(TimedLong)
        bool_out, bool_in = OutPort(TimedBoolean), InPort(TimedBoolean)
        seq_out, seq_in = OutPort(TimedDoubleSeq), InPort(TimedDoubleSeq)

    async with Kernel() as kernel:
        empty = await kernel.add(Empty())
        for kind, value in (
            ("long", TimedLong(0, 0)),
            ("bool", TimedBoolean(0, False)),
            ("seq", TimedDoubleSeq(0, [])),
        ):
            out: Any = empty.ports[f"{kind}_out"]
            inp: Any = empty.ports[f"{kind}_in"]
            await kernel.connect(out, inp)
            out.write_nowait(value)
            assert inp.is_new
            assert inp.read_nowait() is value


class Gear(IntEnum):
    FIRST = 1


async def test_a_subclass_of_a_plain_type_travels_as_the_plain_value(anyio_backend: Any) -> None:
    class Plain(Component):
        float_out, float_in = OutPort(float), InPort(float)
        int_out, int_in = OutPort(int), InPort(int)

    async with Kernel() as kernel:
        plain = await kernel.add(Plain())
        await kernel.connect(plain.float_out, plain.float_in)
        await kernel.connect(plain.int_out, plain.int_in)
        plain.float_out.write_nowait(np.float64(1.5))
        plain.int_out.write_nowait(Gear.FIRST)
        first, second = plain.float_in.read_nowait(), plain.int_in.read_nowait()
        assert (first, type(first)) == (1.5, float)
        assert (second, type(second)) == (1, int)


@record
class Marked(TimedLong):
    mark: str = ""


async def test_a_port_carries_subclasses_of_its_type(anyio_backend: Any) -> None:
    class Derived(Component):
        out = OutPort(Marked)

    async with Kernel() as kernel:
        source, [sink] = await fan(kernel, {})
        derived = await kernel.add(Derived())
        await kernel.connect(derived.out, sink.inp)
        source.out.write_nowait(Marked(0, 1, "a"))
        derived.out.write_nowait(Marked(0, 2, "b"))
        assert [(type(sample), sample.data) for sample in sink.inp.drain()] == [(Marked, 1), (Marked, 2)]
        with pytest.raises(PortTypeError, match="expected a Marked, got TimedLong"):
            derived.out.write_nowait(long(3))  # type: ignore[arg-type]


@dataclass
class Pose:
    name: str
    values: list[float]


@pytest.mark.row(50)
async def test_no_reader_sees_what_a_writer_changes_afterwards(anyio_backend: Any) -> None:
    """OpenRTM-aist in Python hands the very object to every reader; the writer's next change shows in all of them."""

    class Poses(Component):
        out = OutPort(Pose)
        one, two = InPort(Pose), InPort(Pose)

    async with Kernel() as kernel:
        poses, arrays = await kernel.add(Poses()), await kernel.add(Unshaped())
        await kernel.connect(poses.out, poses.one)
        await kernel.connect(poses.out, poses.two)
        await kernel.connect(arrays.out, arrays.inp)
        sample = Pose("a", [1.0])
        poses.out.write_nowait(sample)
        sample.name, sample.values[0] = "b", 2.0
        sample.values.append(3.0)
        one, two = poses.one.read_nowait(), poses.two.read_nowait()
        assert one is two
        assert (one.name, list(one.values)) == ("a", [1.0])
        with pytest.raises(FrozenInstanceError):
            one.name = "c"
        buffer = np.array([1.0, 2.0])
        arrays.out.write_nowait(TimedDoubleSeq(0, buffer[:]))
        buffer[0] = 9.0
        assert arrays.inp.read_nowait().data.tolist() == [1.0, 2.0]


@dataclass(frozen=True)
class Reading:
    """A user's frozen dataclass: Python checks nothing of it."""

    x: float = 0.0
    n: u8 = 0
    text: str = ""
    values: tuple[float, ...] = ()
    pair: tuple[int, str] = (0, "")


class Readings(Component):
    out, inp = OutPort(Reading), InPort(Reading)


@pytest.mark.row(50)
@pytest.mark.fault("A20", "B02")
@pytest.mark.parametrize("options", [{}, {"length": 1}, {"stamp": None, "subscription": "new", "push": "all"}])
async def test_a_frozen_dataclass_is_checked_when_it_is_written_and_copied_where_it_can_change(
    options: dict[str, Any], anyio_backend: Any
) -> None:
    async with Kernel() as kernel:
        user = await kernel.add(Readings("user"))
        connector = await kernel.connect(user.out, user.inp, **options)
        kept = [1.0]
        user.out.write_nowait(Reading(values=kept))  # type: ignore[arg-type]
        kept.append(2.0)
        assert user.inp.read_nowait() == Reading(values=(1.0,))
        whole = Reading(1.0, 255, "x", (1.0,), (1, "a"))
        user.out.write_nowait(whole)
        assert user.inp.read_nowait() is whole  # nothing in it can change: no copy
        await user.out.write(Reading(7))
        assert type(user.inp.read_nowait().x) is float
        written = connector.statistics.written
        for wrong, error in (
            (Reading([1]), RecordTypeError),  # type: ignore[arg-type]
            (Reading(n=300), RecordError),
            (Reading(values=(1.0, "x")), RecordTypeError),  # type: ignore[arg-type]
        ):
            with pytest.raises(error, match=r"user\.out: Reading\.\w+.*expected .*; nothing was sent"):
                user.out.write_nowait(wrong)
            with pytest.raises(error):
                await user.out.write(wrong)
        assert connector.statistics.written == written


@pytest.mark.fault("B05")
async def test_a_plain_value_that_the_wire_cannot_carry_is_refused_when_it_is_written(anyio_backend: Any) -> None:
    class Plain(Component):
        number, text = OutPort(int), OutPort(str)
        numbers, texts = InPort(int), InPort(str)

    async with Kernel() as kernel:
        plain = await kernel.add(Plain("plain"))
        await kernel.connect(plain.number, plain.numbers)
        await kernel.connect(plain.text, plain.texts)
        for number in (-(2**63), 2**63 - 1):
            plain.number.write_nowait(number)
            assert plain.numbers.read_nowait() == number
        for number in (-(2**63) - 1, 2**63):
            with pytest.raises(RecordError, match=r"plain\.number: int: expected an integer .*; nothing was sent"):
                plain.number.write_nowait(number)
        with pytest.raises(RecordError, match=r"plain\.text: .*lone surrogates"):
            plain.text.write_nowait("\ud800")
        assert not plain.numbers.is_new
        assert not plain.texts.is_new


ANYTHING: st.SearchStrategy[Any] = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**65), 2**65),
    st.integers(-1, 300),
    st.floats(),
    st.text(max_size=2),
    st.just("\ud800"),
    st.binary(max_size=2),
    st.lists(st.one_of(st.integers(-5, 5), st.floats(), st.text(max_size=1)), max_size=3),
    st.tuples(st.integers(), st.text(max_size=1)),
    st.builds(np.float32, st.floats(width=32)),
    st.builds(lambda: np.arange(3)),
)


@pytest.mark.slow(kept_by="test_a_frozen_dataclass_is_checked_when_it_is_written_and_copied_where_it_can_change")
@pytest.mark.fault("B05")
@pytest.mark.campaign
def test_a_port_takes_of_a_dataclass_what_the_wire_takes_and_delivers_what_it_would() -> None:
    codec = MsgpackCodec()

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            user = await kernel.add(Readings())
            await kernel.connect(user.out, user.inp)

            @settings(max_examples=cases(20_000), deadline=None)
            @given(st.builds(Reading, *[st.one_of(st.just(default), ANYTHING) for default in DEFAULTS]))
            def compare(sample: Reading) -> None:
                try:
                    sent = codec.encode(sample)
                except RecordError as refused:
                    with pytest.raises(type(refused)):
                        user.out.write_nowait(sample)
                    return
                user.out.write_nowait(sample)
                assert codec.encode(user.inp.read_nowait()) == sent

            compare()

    simulate(main)


DEFAULTS = (0.0, 0, "", (), (0, ""))


# -- full buffers ---------------------------------------------------------------------------------------------------


@pytest.mark.row(41, 44)
async def test_a_rejected_write_returns_false_and_the_others_have_the_sample(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sinks = await fan(kernel, {"full": "reject", "length": 1}, {})
        assert source.out.write_nowait(long(0)) is True
        assert source.out.write_nowait(long(1)) is False
        assert await source.out.write(long(2)) is False
        assert [connector.statistics.dropped for connector in source.out.connectors] == [{"rejected": 2}, {}]
        assert [data(sink.inp.drain()) for sink in sinks] == [[0], [0, 1, 2]]


@pytest.mark.row(41, 44)
async def test_block_wakes_the_writer_when_there_is_room(anyio_backend: Any) -> None:
    """In OpenRTM the writer waits on the condition of an empty buffer: nobody wakes it, it ends by its time-out."""
    async with Kernel() as kernel:
        source, [sink] = await fan(kernel, BLOCK | {"timeout": None})
        done = []

        async def write() -> None:
            for number in range(100):
                assert await source.out.write(long(number)) is True
                done.append(number)

        writing = asyncio.create_task(write())
        await asyncio.sleep(0.01)
        assert done == [0, 1]
        read = [(await sink.inp.read()).data for _ in range(100)]
        await writing
        assert read == list(range(100))
        assert sink.inp.connectors[0].statistics.dropped == {}


@pytest.mark.row(44)
async def test_write_nowait_writes_to_nobody_when_a_blocking_reader_is_full(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sinks = await fan(kernel, {}, BLOCK, {"full": "reject"})
        source.out.write_nowait(long(0))
        source.out.write_nowait(long(1))
        with pytest.raises(WouldBlock, match=r"sink1\.inp has no room"):
            source.out.write_nowait(long(2))
        assert [data(sink.inp.drain()) for sink in sinks] == [[0, 1]] * 3
        assert [connector.statistics.written for connector in source.out.connectors] == [2, 2, 2]


@pytest.mark.row(44)
@pytest.mark.fault("B07", "B21")
def test_a_write_waits_for_all_full_readers_together_and_one_error_names_them() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            source, sinks = await fan(
                kernel, BLOCK | {"timeout": 1.0}, {}, BLOCK | {"timeout": 2.0}, BLOCK | {"timeout": 1.5}
            )
            for number in range(2):
                source.out.write_nowait(long(number))
            start = clock.monotonic_ns()
            writing = asyncio.create_task(source.out.write(long(2)))
            await asyncio.sleep(0.5)
            assert data(sinks[1].inp.drain()) == [0, 1, 2]  # who had room has it at once
            sinks[3].inp.read_nowait()
            with pytest.raises(WriteTimeout) as caught:
                await writing
            assert clock.monotonic_ns() - start == 2_000_000_000
            text = str(caught.value)
            assert "sink0.inp (1 s)" in text
            assert "sink2.inp (2 s)" in text
            assert "sink1" not in text
            assert "sink3" not in text
            ledgers = [connector.statistics for connector in source.out.connectors]
            assert [dict(ledger.dropped) for ledger in ledgers] == [{"timeout": 1}, {}, {"timeout": 1}, {}]
            assert all(ledger.balanced and ledger.written == 3 for ledger in ledgers)
            assert data(sinks[3].inp.drain()) == [1, 2]

    simulate(main)


@pytest.mark.slow
@pytest.mark.fault("B07")
async def test_a_blocked_write_ends_at_its_deadline_on_the_real_clock(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, _ = await fan(kernel, {"full": "block", "length": 1, "timeout": 0.1})
        await source.out.write(long(0))
        start = kernel.clock.monotonic_ns()
        with pytest.raises(WriteTimeout):
            await source.out.write(long(1))
        assert 100_000_000 <= kernel.clock.monotonic_ns() - start < 5_000_000_000


async def test_several_blocked_writers_get_in_in_the_order_they_came(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, [sink] = await fan(kernel, {"full": "block", "length": 1, "timeout": None})
        writing = [asyncio.create_task(source.out.write(long(number))) for number in range(6)]
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        writing[3].cancel()
        await asyncio.sleep(0)
        assert [(await sink.inp.read()).data for _ in range(5)] == [0, 1, 2, 4, 5]
        await asyncio.wait(writing)
        assert writing[3].cancelled()
        assert all(task.result() for task in writing if task is not writing[3])


async def test_skip_counts_samples_as_they_come_in_not_as_they_queue_up(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        options = {"subscription": "new", "push": "skip", "skip": 1, "length": 1, "full": "block", "timeout": None}
        source, [sink] = await fan(kernel, options)
        writing = []
        for number in range(1, 9):
            writing.append(asyncio.create_task(source.out.write(long(number))))
            await asyncio.sleep(0)
        assert [(await sink.inp.read()).data for _ in range(4)] == [2, 4, 6, 8]
        await asyncio.gather(*writing)
        assert sink.inp.connectors[0].statistics.dropped == {"skipped": 4}


@pytest.mark.row(48)
async def test_a_sample_that_waited_for_room_is_stamped_like_the_others(anyio_backend: Any) -> None:
    async with Kernel(clock=SimulatedClock(start_ns=5)) as kernel:
        source, [sink] = await fan(kernel, {"full": "block", "length": 1, "timeout": None, "stamp": "send"})
        await source.out.write(long(0))
        writing = asyncio.create_task(source.out.write(long(1)))
        await asyncio.sleep(0)
        assert [(await sink.inp.read()).tm, (await sink.inp.read()).tm] == [5, 5]
        await writing


@pytest.mark.fault("B08", "B10")
@pytest.mark.parametrize("how", ["disconnect", "deactivate", "remove component", "remove port", "close"])
async def test_a_blocked_write_ends_when_its_reader_goes(how: str, anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, [sink] = await fan(kernel, BLOCK | {"timeout": None})
        context = await kernel.start(ExternalContext(), sink, activate=True)
        connector = source.out.connectors[0]
        await source.out.write(long(0))
        await source.out.write(long(1))
        writing = asyncio.create_task(source.out.write(long(2)))
        await asyncio.sleep(0)
        if how == "disconnect":
            await kernel.disconnect(connector)
        elif how == "deactivate":
            await context.deactivate()
        elif how == "remove component":
            await kernel.remove(sink)
        elif how == "remove port":
            sink.remove_port("inp")
        else:
            await kernel.aclose()
        assert await asyncio.wait_for(writing, 1.0) is True
        ledger = connector.statistics
        reason = "inactive" if how in ("deactivate", "remove component", "close") else "disconnected"
        assert (ledger.written, dict(ledger.dropped), ledger.buffered) == (3, {reason: 3}, 0)


@pytest.mark.slow(kept_by="test_a_blocked_write_ends_when_its_reader_goes")
@pytest.mark.fault("B08")
async def test_disconnecting_at_any_moment_of_a_write_leaves_no_half_sample(anyio_backend: Any) -> None:
    """Both a disconnection and a cancellation, after any number of turns of three writers and a reader."""
    chance = random.Random(8)
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        for round_ in range(1_000):
            connector = await kernel.connect(source.out, sink.inp, full="block", length=2, timeout=None)
            written: list[int] = []
            read: list[int] = []

            async def write(first: int, written: list[int] = written) -> None:
                for number in range(first, first + 10):
                    await source.out.write(long(number))
                    written.append(number)

            async def consume(read: list[int] = read) -> None:
                while True:
                    read.append((await sink.inp.read()).data)

            writers = [asyncio.create_task(write(first)) for first in (100, 200, 300)]
            reader = asyncio.create_task(consume())
            for _ in range(round_ % 40):
                await asyncio.sleep(0)
            if chance.random() < 0.5:
                chance.choice(writers).cancel()
            for _ in range(chance.randrange(3)):
                await asyncio.sleep(0)
            await kernel.disconnect(connector)
            reader.cancel()
            await asyncio.wait([*writers, reader], timeout=1.0)
            assert all(task.done() for task in writers)
            ledger = connector.statistics
            dropped = sum(ledger.dropped.values())
            assert ledger.delivered == len(read) == len(set(read))
            assert ledger.buffered == 0
            assert ledger.written == len(read) + dropped
            for first in (100, 200, 300):
                own = [number for number in read if first <= number < first + 100]
                assert own == list(range(first, first + len(own)))
            assert source.out.connectors == ()
            assert not sink.inp.is_new


@pytest.mark.row(44)
@pytest.mark.fault("B19")
@pytest.mark.campaign
async def test_a_cancelled_blocked_write_wrote_nothing_to_whom_it_waited_for(anyio_backend: Any) -> None:
    chance = random.Random(19)
    async with Kernel() as kernel:
        source, [slow, free] = await fan(kernel, {"full": "block", "length": 1, "timeout": None}, {"length": 1_000_000})
        read: list[int] = []
        completed: set[int] = set()
        for number in range(cases(10_000)):
            task = asyncio.create_task(source.out.write(long(number)))
            for _ in range(chance.randrange(3)):
                await asyncio.sleep(0)
            if chance.random() < 0.4 and slow.inp.is_new:
                read.append(slow.inp.read_nowait().data)
            for _ in range(chance.randrange(2)):
                await asyncio.sleep(0)
            task.cancel()
            await asyncio.wait([task])
            if not task.cancelled():
                completed.add(number)
        read += data(slow.inp.drain())
        everywhere = data(free.inp.drain())
        assert completed <= set(read) <= set(everywhere)
        assert read == sorted(set(read))
        assert everywhere == sorted(set(everywhere))
        for connector in source.out.connectors:
            assert connector.statistics.dropped == {}
            assert connector.statistics.written == connector.statistics.delivered


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("B17")
@pytest.mark.parametrize("options", [{"length": 100_000}, {}, {"full": "reject"}, {"full": "block", "timeout": None}])
async def test_of_a_burst_of_100000_none_is_unexplained(options: dict[str, Any], anyio_backend: Any) -> None:
    count = 100_000
    async with Kernel() as kernel:
        source, [sink] = await fan(kernel, options)
        read = 0

        async def drain() -> None:
            nonlocal read
            while True:
                await sink.inp.read()
                read += 1

        draining = asyncio.create_task(drain())
        await asyncio.sleep(0)
        if options.get("full") == "block":
            for number in range(count // 10):
                await source.out.write(long(number))
        else:
            for number in range(count):
                source.out.write_nowait(long(number))
        connector = source.out.connectors[0]
        while connector.statistics.buffered:
            assert connector.statistics.balanced
            await asyncio.sleep(0)
        draining.cancel()
        await asyncio.wait([draining])
        ledger = connector.statistics
        assert ledger.written == read + sum(ledger.dropped.values())
        assert ledger.delivered == read
        if options.get("length") == count or options.get("full") == "block":
            assert ledger.dropped == {}


@pytest.mark.fault("B21")
async def test_a_reader_that_raises_or_sleeps_takes_nothing_from_another(anyio_backend: Any) -> None:
    held = asyncio.Event()

    class Raising(Component):
        inp = InPort(TimedLong)

        async def on_execute(self) -> None:
            self.inp.read_nowait()
            raise RuntimeError("broken reader")

    class Slow(Component):
        inp = InPort(TimedLong)

        async def on_execute(self) -> None:
            self.inp.read_nowait()
            await held.wait()

    class Good(Component):
        inp = InPort(TimedLong)

        def __init__(self) -> None:
            super().__init__("good")
            self.seen: list[int] = []

        async def on_execute(self) -> None:
            self.seen += data(self.inp.drain())

    async with Kernel() as kernel:
        source, good = await kernel.add(Source()), await kernel.add(Good())
        for reader in (await kernel.add(Raising()), await kernel.add(Slow()), good):
            await kernel.connect(source.out, reader.ports["inp"])
            await kernel.start(EventContext(deadline=5.0), reader, activate=True)
        for number in range(50):
            assert await source.out.write(long(number)) is True
            await asyncio.sleep(0.001)
        held.set()
        assert good.seen == list(range(50))
        raising, slow, fine = (connector.statistics for connector in source.out.connectors)
        assert raising.balanced
        assert raising.dropped["inactive"] > 0
        assert slow.balanced
        assert slow.dropped["overwritten"] > 0
        assert fine.delivered == 50


# -- stamps ---------------------------------------------------------------------------------------------------------


@pytest.mark.row(48)
@pytest.mark.fault("B18")
def test_each_stamp_is_the_clock_at_its_moment_and_none_is_made_unasked() -> None:
    class Stamped(Component):
        out = OutPort(TimedLong, stamp="write")

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            both, stamped = await kernel.add(Both()), await kernel.add(Stamped())
            second = 1_000_000_000

            async def tm_of(out: OutPort[TimedLong], reads: str = "read", **options: Any) -> tuple[int, int]:
                connector = await kernel.connect(out, both.inp, **options)
                start = clock.time_ns()
                out.write_nowait(TimedLong(7, 1))
                await kernel.sleep(3.0)
                if reads == "latest":
                    assert both.inp.latest is not None
                    tm = both.inp.latest.tm
                else:
                    tm = both.inp.read_nowait().tm
                await kernel.disconnect(connector)
                return tm, start

            tm, _ = await tm_of(both.out)
            assert tm == 7
            tm, start = await tm_of(stamped.out)
            assert tm == start
            tm, start = await tm_of(both.out, stamp="send")
            assert tm == start
            tm, start = await tm_of(both.out, stamp="received")
            assert tm == start
            tm, start = await tm_of(both.out, stamp="read")
            assert tm == start + 3 * second
            tm, start = await tm_of(both.out, "latest", stamp="read")
            assert tm == start + 3 * second
            tm, start = await tm_of(both.out, stamp="send", subscription="periodic", push_rate=1.0)
            assert tm == start + second
            tm, start = await tm_of(both.out, timestamp_policy="on_read")
            assert tm == start + 3 * second

    simulate(main)


@pytest.mark.row(48)
async def test_a_stamp_is_refused_for_a_type_without_tm(anyio_backend: Any) -> None:
    class Bare(Component):
        out, inp = OutPort(Pose), InPort(Pose)

    async with Kernel() as kernel:
        bare = await kernel.add(Bare())
        with pytest.raises(WiringError, match="Pose has no field tm"):
            await kernel.connect(bare.out, bare.inp, stamp="send")
        with pytest.raises(DeclarationError, match="float has no field tm"):
            bare.add_port("extra", OutPort(float, stamp="write"))
        with pytest.raises(DeclarationError, match="stamp"):
            OutPort(TimedLong, stamp="read")


@pytest.mark.fault("B18")
async def test_a_backward_time_is_kept_as_written(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, [sink] = await fan(kernel, {})
        times = [5, 3, 0, 4_294_967_295_999_999_999, 1]
        for tm in times:
            source.out.write_nowait(TimedLong(tm, 0))
        assert [sample.tm for sample in sink.inp.drain()] == times
