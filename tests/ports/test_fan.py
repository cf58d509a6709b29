"""Several connectors at one port: order, fairness, the source of a sample, and queues that are nobody else's."""

from __future__ import annotations

import asyncio
import random
import sys
from collections import deque
from types import FrameType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Connector, ExternalContext, InPort, Kernel, SimulatedClock
from aiorts.kernel.ports.connector import transport_of, unread_of
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases
from ports.parts import Model, ModelConnector, Sink, Source, data, long
from ports.test_connector import COMBINATIONS

pytestmark = pytest.mark.anyio


async def fan_in(kernel: Kernel, *options: dict[str, Any]) -> tuple[list[Source], InPort[TimedLong]]:
    sink = await kernel.add(Sink())
    sources = [await kernel.add(Source()) for _ in options]
    for source, chosen in zip(sources, options, strict=True):
        await kernel.connect(source.out, sink.inp, **chosen)
    return sources, sink.inp


@pytest.mark.row(43)
async def test_samples_are_read_in_order_of_arrival_and_each_tells_its_source(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        sources, inp = await fan_in(kernel, {"length": 100}, {"length": 100}, {"length": 100})
        chance = random.Random(3)
        written = []
        for number in range(100):
            source = chance.choice(sources)
            source.out.write_nowait(long(number))
            written.append((number, source.out.connectors[0]))
        read = []
        while inp.is_new:
            sample = await inp.read()
            assert inp.last_source is not None
            read.append((sample.data, inp.last_source))
        assert read == written


@pytest.mark.row(43)
@pytest.mark.parametrize("others", [0, 2])
async def test_a_drain_tells_the_source_of_each_sample(anyio_backend: Any, others: int) -> None:
    async with Kernel() as kernel:
        sources, inp = await fan_in(kernel, *({"length": 100},) * (1 + others))
        assert inp.drain(sources=True) == []
        chance, written = random.Random(5), []
        for number in range(30):
            source = chance.choice(sources)
            source.out.write_nowait(long(number))
            written.append((source.out.connectors[0], number))
        assert [(connector, sample.data) for connector, sample in inp.drain(sources=True)] == written
        assert (inp.last_source, data(inp.drain())) == (written[-1][0], [])
        assert inp.latest == long(29)
        sources[0].out.write_nowait(long(30))
        assert data(inp.drain(sources=False)) == [30]


@pytest.mark.row(43)
async def test_the_last_source_is_right_while_connectors_come_and_go(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        [first, second], inp = await fan_in(kernel, {}, {})
        one, two = inp.connectors
        assert inp.last_source is None
        await kernel.disconnect(two)
        assert inp.last_source is None
        first.out.write_nowait(long(1))
        inp.read_nowait()
        assert inp.last_source is one
        two = await kernel.connect(second.out, inp)
        assert inp.last_source is one  # the fast path read it
        second.out.write_nowait(long(2))
        inp.read_nowait()
        assert inp.last_source is two
        await kernel.disconnect(one)
        assert inp.last_source is two
        await kernel.disconnect(two)
        three = await kernel.connect(first.out, inp)
        assert inp.last_source is two  # nothing was read from the new one
        first.out.write_nowait(long(3))
        assert inp.last_source is two
        assert inp.latest is not None
        assert inp.last_source is three


@pytest.mark.row(42)
@pytest.mark.parametrize("depth", [1, 3, 8])
async def test_a_flooder_delays_a_quiet_writer_by_at_most_its_depth(depth: int, anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        [flooder, quiet], inp = await fan_in(kernel, {"length": depth}, {})
        for number in range(1_000):
            flooder.out.write_nowait(long(-1))
            if number % 100 == 50:
                quiet.out.write_nowait(long(number))
                reads = 1
                while inp.read_nowait().data != number:
                    reads += 1
                    flooder.out.write_nowait(long(-1))
                assert reads <= depth + 1


@pytest.mark.row(42)
async def test_a_connection_never_changes_the_queue_of_another(anyio_backend: Any) -> None:
    """In OpenRTM all connectors of an in-port share one ring, which every new connection sets up again and empties."""
    async with Kernel() as kernel:
        sink, first, second = await kernel.add(Sink()), await kernel.add(Source()), await kernel.add(Source())
        one = await kernel.connect(first.out, sink.inp, length=4, full="reject")
        for number in range(3):
            first.out.write_nowait(long(number))
        two = await kernel.connect(second.out, sink.inp, **{"dataport.inport.buffer.length": "1"})
        assert one.statistics.buffered == 3
        assert one.profile.length == 4
        for number in (10, 11, 12):
            second.out.write_nowait(long(number))
        assert first.out.write_nowait(long(3)) is True
        assert first.out.write_nowait(long(4)) is False
        await kernel.disconnect(two)
        assert data(sink.inp.drain()) == [0, 1, 2, 3]
        assert dict(one.statistics.dropped) == {"rejected": 1}
        assert dict(two.statistics.dropped) == {"overwritten": 2, "disconnected": 1}


@pytest.mark.row(46)
async def test_what_is_unread_can_be_asked_for_by_connector(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        sources, inp = await fan_in(kernel, {}, {}, {"dataflow": "pull"})
        assert [unread_of(connector) for connector in inp.connectors] == [0, 0, 0]
        assert not inp.is_new
        sources[1].out.write_nowait(long(1))
        sources[1].out.write_nowait(long(2))
        assert [unread_of(connector) for connector in inp.connectors] == [0, 2, 0]
        assert inp.is_new
        sources[2].out.write_nowait(long(3))
        assert [unread_of(connector) for connector in inp.connectors] == [0, 2, 1]
        inp.drain()
        assert [unread_of(connector) for connector in inp.connectors] == [0, 0, 0]


async def test_the_newest_of_several_connectors_is_the_one_that_arrived_last(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        new = {"subscription": "new"}
        [one, two, three], inp = await fan_in(kernel, new, new, {})
        one.out.write_nowait(long(1))
        two.out.write_nowait(long(2))
        three.out.write_nowait(long(3))
        two.out.write_nowait(long(4))
        one.out.write_nowait(long(5))
        assert inp.read_nowait().data == 3  # 1 and 2 were replaced, by what came after it
        newest = inp.latest
        assert newest is not None
        assert newest.data == 5
        assert not inp.is_new
        assert [dict(connector.statistics.dropped) for connector in inp.connectors] == [
            {"superseded": 1},
            {"superseded": 2},
            {},
        ]


@pytest.mark.row(43)
@pytest.mark.parametrize("options", [{"subscription": "new"}, {"length": 1}, {"length": 1, "stamp": "send"}])
async def test_what_overwrites_is_read_when_it_arrived_and_not_in_the_place_of_the_old_one(
    options: dict[str, Any], anyio_backend: Any
) -> None:
    async with Kernel() as kernel:
        [one, two], inp = await fan_in(kernel, options, options)
        one.out.write_nowait(long(1))
        two.out.write_nowait(long(2))
        one.out.write_nowait(long(3))
        oldest = inp.peek()
        assert oldest is not None
        assert oldest.data == 2
        assert data(inp.drain()) == [2, 3]


STEPS = ("write",) * 12 + ("read",) * 6 + ("latest", "drain", "disconnect", "connect", "activate")


@pytest.mark.slow(kept_by="test_what_overwrites_is_read_when_it_arrived_and_not_in_the_place_of_the_old_one")
@pytest.mark.row(43)
@pytest.mark.campaign
@settings(max_examples=cases(5_000), deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([c for c in COMBINATIONS if c[0] != "periodic" and c[2] != "block"]), st.integers(1, 4)
        ),
        min_size=1,
        max_size=5,
    ),
    st.lists(st.tuples(st.sampled_from(STEPS), st.integers(0, 4)), max_size=150),
)
def test_whatever_is_overwritten_samples_are_read_in_the_one_sequence_in_which_they_came(
    kinds: list[tuple[tuple[str, str, str], int]], steps: list[tuple[str, int]]
) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            sink = await kernel.add(Sink())
            context = await kernel.start(ExternalContext(), sink, activate=True)
            sources = [await kernel.add(Source()) for _ in kinds]
            model, inp = Model(), sink.inp
            live: dict[int, tuple[Connector, ModelConnector]] = {}

            async def connect(which: int) -> None:
                (subscription, push, full), length = kinds[which]
                options: dict[str, Any] = {"subscription": subscription, "push": push, "full": full, "length": length}
                if push == "skip":
                    options["skip"] = 1
                one = ModelConnector(options, 0)
                model.connectors.append(one)
                live[which] = await kernel.connect(sources[which].out, inp, **options), one

            for which in range(len(kinds)):
                await connect(which)
            for number, (step, chosen) in enumerate(steps):
                which = chosen % len(kinds)
                if step == "write" and which in live:
                    assert sources[which].out.write_nowait(long(number)) is model.write(live[which][1], number)
                elif step == "read":
                    got = inp.read_nowait().data if inp.is_new else None
                    assert got == model.read()
                elif step == "latest":
                    newest = inp.latest
                    assert (None if newest is None else newest.data) == model.latest()
                elif step == "drain":
                    assert data(inp.drain()) == model.drain()
                elif step == "disconnect" and which in live:
                    await kernel.disconnect(live[which][0])
                    model.disconnect(live.pop(which)[1])
                elif step == "connect" and which not in live:
                    await connect(which)
                elif step == "activate":
                    await (context.deactivate(sink) if model.is_open else context.activate(sink))
                    model.set_open(not model.is_open)
                assert inp.is_new == bool(model.order)
                check_tokens(inp)
            assert data(inp.drain()) == model.drain()

    simulate(main)


def check_tokens(inp: InPort[Any]) -> None:
    """One for each unread sample, and for what was overwritten no more than a connector can have samples."""
    tokens = receiver_of(inp).tokens
    for connector in inp.connectors:
        assert connector.statistics.balanced
        if tokens is not None:
            dead = transport_of(connector).dead
            assert tokens.count(transport_of(connector)) == unread_of(connector) + dead
            assert dead <= connector.profile.length


@pytest.mark.slow
@pytest.mark.row(43)
@pytest.mark.parametrize("quiet", [False, True], ids=["all write in turn", "one writes, the others are full"])
async def test_overwriting_costs_the_same_beside_any_number_of_connectors(quiet: bool, anyio_backend: Any) -> None:
    async def cost(connectors: int) -> float:
        """Steps of the interpreter for one write that overwrites and, where all write, for reading it."""
        async with Kernel() as kernel:
            sources, inp = await fan_in(kernel, *({"length": 2} for _ in range(connectors)))
            for source in sources * 2:
                source.out.write_nowait(long(0))
            writing = sources[:1] * 1_000 if quiet else sources * 5
            steps = 0

            def count(frame: FrameType, event: str, arg: object) -> Any:
                nonlocal steps
                frame.f_trace_opcodes, frame.f_trace_lines = True, False
                steps += event == "opcode"
                return count

            sample, before = long(1), sys.gettrace()
            sys.settrace(count)
            try:
                for source in writing:
                    source.out.write_nowait(sample)
                if not quiet:
                    inp.drain()
            finally:
                sys.settrace(before)
            return steps / len(writing)

    assert await cost(200) < 1.2 * await cost(10)


@pytest.mark.slow
def test_order_and_ledgers_hold_through_every_mixture() -> None:
    """Overwriting, superseding, latest, disconnecting and blocked writers, against a plain list of what is unread."""

    async def main(clock: SimulatedClock) -> None:
        chance = random.Random(7)
        async with Kernel() as kernel:
            sources, inp = await fan_in(
                kernel, {"length": 3}, {"subscription": "new"}, {"length": 2, "full": "block", "timeout": None}
            )
            blocked: deque[asyncio.Task[bool]] = deque()
            last_of: dict[int, int] = {}
            for number in range(3_000):
                which = chance.randrange(4)
                if which < 2:
                    sources[which].out.write_nowait(long(number * 4 + which))
                elif which == 2 and len(blocked) < 4:
                    blocked.append(asyncio.create_task(sources[2].out.write(long(number * 4 + 2))))
                    await asyncio.sleep(0)
                elif which == 3 and inp.is_new:
                    sample = inp.read_nowait() if chance.random() < 0.9 else inp.latest
                    assert sample is not None
                    assert inp.last_source is not None
                    source = inp.connectors.index(inp.last_source)
                    assert sample.data % 4 == source
                    assert sample.data > last_of.get(source, -1)  # each writer's samples in its order
                    last_of[source] = sample.data
                    await asyncio.sleep(0)
                while blocked and blocked[0].done():
                    blocked.popleft()
                assert receiver_of(inp).tokens is not None
                check_tokens(inp)
            while blocked:
                inp.drain()
                await blocked.popleft()

    simulate(main)


@pytest.mark.row(39)
@pytest.mark.campaign
async def test_new_never_leaves_the_newest_sample_unread(anyio_backend: Any) -> None:
    """In OpenRTM a value written while the one before is being delivered stays in the sender until the next write."""
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        await kernel.connect(source.out, sink.inp, subscription="new")
        received: list[int] = []

        async def read() -> None:
            while True:
                received.append((await sink.inp.read()).data)

        reading = asyncio.create_task(read())
        for number in range(1_000):
            source.out.write_nowait(long(2 * number))
            for _ in range(number % 3):  # while the one before is being delivered: at its wake-up, in between, after it
                await asyncio.sleep(0)
            source.out.write_nowait(long(2 * number + 1))
            for _ in range(5):  # then silence
                await asyncio.sleep(0)
            assert received[-1] == 2 * number + 1
        reading.cancel()
        await asyncio.wait([reading])


@pytest.mark.row(41)
async def test_a_reader_is_fast_again_once_nobody_waits_for_room(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        sources, inp = await fan_in(kernel, {"length": 1, "full": "block"})
        fast = inp._fast
        await sources[0].out.write(long(1))
        writer = asyncio.ensure_future(sources[0].out.write(long(2)))
        await asyncio.sleep(0)
        assert inp._fast is not fast
        assert inp.read_nowait().data == 1
        assert await writer
        assert inp._fast is fast
        assert inp.read_nowait().data == 2
