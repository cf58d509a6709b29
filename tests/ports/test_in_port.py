"""Reading: what each method takes, how a read waits, wakes, is cancelled and ends."""

from __future__ import annotations

import asyncio
import random
from typing import Any

import pytest

from aiorts import Component, EventContext, InPort, Kernel, OutPort, SimulatedClock, WouldBlock
from aiorts.errors import BusyError, ClosedError, ConfigurationError, ReadTimeout
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases
from ports.parts import Sink, Source, data, long

pytestmark = pytest.mark.anyio


async def pair(kernel: Kernel, **options: Any) -> tuple[OutPort[TimedLong], InPort[TimedLong]]:
    source, sink = await kernel.add(Source()), await kernel.add(Sink())
    await kernel.connect(source.out, sink.inp, **options)
    return source.out, sink.inp


async def test_each_method_takes_what_its_name_says(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        out, inp = await pair(kernel)
        assert inp.latest is None
        assert inp.peek() is None
        assert not inp.is_new
        assert inp.drain() == []
        with pytest.raises(WouldBlock, match=r"sink0\.inp"):
            inp.read_nowait()
        for number in range(5):
            out.write_nowait(long(number))
        peeked = inp.peek()
        assert peeked is not None
        assert peeked.data == 0
        assert inp.is_new
        assert inp.read_nowait() is peeked
        assert (await inp.read()).data == 1
        newest = inp.latest
        assert newest is not None
        assert newest.data == 4
        assert inp.latest is newest
        assert not inp.is_new
        assert inp.connectors[0].statistics.dropped == {"superseded": 2}
        out.write_nowait(long(5))
        out.write_nowait(long(6))
        assert data(inp.drain()) == [5, 6]
        latest = inp.latest
        assert latest is not None
        assert latest.data == 6


@pytest.mark.row(45)
async def test_a_read_waits_for_the_next_sample(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        out, inp = await pair(kernel)
        reading = asyncio.create_task(inp.read())
        await asyncio.sleep(0)
        assert not reading.done()
        out.write_nowait(long(7))
        assert (await reading).data == 7


@pytest.mark.row(45)
@pytest.mark.parametrize("ending", ["port", "component", "kernel"])
async def test_iteration_gives_every_sample_and_ends_when_the_port_is_closed(ending: str, anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        out, inp = await pair(kernel)
        seen = []

        async def iterate() -> None:
            async for sample in inp:
                seen.append(sample.data)  # noqa: PERF401 - looked at before the end

        task = asyncio.create_task(iterate())
        for number in range(20):
            out.write_nowait(long(number))
            await asyncio.sleep(0)
            await asyncio.sleep(0)
        sink = kernel.components["sink0"]
        if ending == "port":
            sink.remove_port("inp")
        elif ending == "component":
            await kernel.remove(sink)
        else:
            await kernel.aclose()
        await asyncio.wait_for(task, 1.0)
        assert seen == list(range(20))


async def test_leaving_an_iteration_early_takes_no_further_sample(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        out, inp = await pair(kernel)
        for number in range(3):
            out.write_nowait(long(number))
        async for sample in inp:
            assert sample.data == 0
            break
        assert data(inp.drain()) == [1, 2]


async def test_a_second_waiting_reader_is_refused_and_the_first_goes_on(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        out, inp = await pair(kernel)
        first = asyncio.create_task(inp.read())
        await asyncio.sleep(0)
        with pytest.raises(BusyError, match="one at a time"):
            await inp.read()
        out.write_nowait(long(1))
        assert (await first).data == 1
        second = asyncio.create_task(inp.read())
        await asyncio.sleep(0)
        second.cancel()
        await asyncio.wait([second])
        third = asyncio.create_task(inp.read())
        await asyncio.sleep(0)
        out.write_nowait(long(2))
        assert (await third).data == 2


@pytest.mark.parametrize("what", ["port", "component"])
async def test_a_waiting_read_ends_with_closed_error_when_its_port_goes(what: str, anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        out, inp = await pair(kernel)
        reading = asyncio.create_task(inp.read())
        await asyncio.sleep(0)
        if what == "port":
            kernel.components["sink0"].remove_port("inp")
        else:
            await kernel.remove(kernel.components["sink0"])
        with pytest.raises(ClosedError, match=r"sink0\.inp"):
            await reading
        with pytest.raises(ClosedError, match="removed"):
            inp.read_nowait()
        assert out.connectors == ()


async def test_ports_of_a_removed_component_say_so_when_used() -> None:
    async with Kernel() as kernel:
        out, inp = await pair(kernel)
        out.write_nowait(long(1))
        await kernel.remove(kernel.components["source0"])
        with pytest.raises(ClosedError, match=r"source0\.out"):
            out.write_nowait(long(2))
        with pytest.raises(ClosedError):
            await out.write(long(2))
        with pytest.raises(WouldBlock):
            inp.read_nowait()  # what was queued went with the connector


@pytest.mark.row(45)
@pytest.mark.fault("B19")
@pytest.mark.campaign
@pytest.mark.parametrize("writers", [1, 2])
async def test_a_cancelled_read_takes_nothing_and_repeats_nothing(writers: int, anyio_backend: Any) -> None:
    """Reads are cancelled before, in the same turn as, and after the sample that would have woken them."""
    chance = random.Random(writers)
    async with Kernel() as kernel:
        sink = await kernel.add(Sink())
        outs = [(await kernel.add(Source())).out for _ in range(writers)]
        for out in outs:
            await kernel.connect(out, sink.inp, length=1_000_000)
        taken: list[int] = []
        cancelled = written = 0

        async def read() -> None:
            taken.append((await sink.inp.read()).data)

        while cancelled < cases(10_000):
            task = asyncio.create_task(read())
            for _ in range(chance.randrange(3)):
                await asyncio.sleep(0)
            if chance.random() < 0.6:
                outs[written % writers].write_nowait(long(written))
                written += 1
            for _ in range(chance.randrange(2)):
                await asyncio.sleep(0)
            task.cancel()
            await asyncio.wait([task])
            cancelled += task.cancelled()
        taken += data(sink.inp.drain())
        assert taken == list(range(written))
        assert all(out.connectors[0].statistics.balanced for out in outs)


async def test_awaited_reads_and_writes_give_the_loop_a_turn_within_256_calls(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        out, inp = await pair(kernel, length=100_000)
        turns = [0]
        flags = {"stop": False}

        async def count() -> None:
            while not flags["stop"]:
                turns[0] += 1
                await asyncio.sleep(0)

        counting = asyncio.create_task(count())
        await asyncio.sleep(0)
        for what in ("write", "read"):
            longest, before, calls = 0, turns[0], 0
            for number in range(2_000):
                if what == "write":
                    await out.write(long(number))
                else:
                    await inp.read()
                calls += 1
                if turns[0] != before:
                    longest, before, calls = max(longest, calls), turns[0], 0
            assert 0 < longest <= 256
        flags["stop"] = True
        await counting


@pytest.mark.parametrize("options", [{"subscription": "new"}, {"subscription": "periodic", "push_rate": 1000.0}, {}])
async def test_a_flooding_writer_does_not_starve_its_reader(options: dict[str, Any], anyio_backend: Any) -> None:
    class Reader(Component):
        inp = InPort(TimedLong)
        seen = 0

        async def on_execute(self) -> None:
            self.seen += len(self.inp.drain())

    async with Kernel() as kernel:
        source, reader = await kernel.add(Source()), await kernel.add(Reader())
        await kernel.connect(source.out, reader.inp, **options)
        await kernel.start(EventContext(), reader, activate=True)
        for _ in range(10):
            before, until = reader.seen, kernel.clock.monotonic_ns() + 2_000_000_000
            while reader.seen == before:
                await source.out.write(long(1))
                assert kernel.clock.monotonic_ns() < until


# -- pull -----------------------------------------------------------------------------------------------------------


@pytest.mark.row(37)
async def test_pull_knows_whether_the_writer_has_news_and_takes_the_latest(anyio_backend: Any) -> None:
    """In OpenRTM `isNew` looks into the reader's own empty buffer, so that `if isNew: read` never reads."""
    async with Kernel() as kernel:
        out, inp = await pair(kernel, dataflow="pull")
        assert not inp.is_new
        for number in range(3):
            out.write_nowait(long(number))
        assert inp.is_new
        assert inp.read_nowait().data == 2
        assert not inp.is_new
        with pytest.raises(WouldBlock):
            inp.read_nowait()
        ledger = inp.connectors[0].statistics
        assert (ledger.written, ledger.delivered, ledger.dropped) == (3, 1, {"superseded": 2})


@pytest.mark.row(37)
async def test_a_pulling_read_waits_for_the_writer(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        out, inp = await pair(kernel, dataflow="pull")
        reading = asyncio.create_task(inp.read())
        await asyncio.sleep(0)
        out.write_nowait(long(3))
        assert (await reading).data == 3


async def test_pulled_data_is_no_cause_for_an_event_context(anyio_backend: Any) -> None:
    class Reader(Component):
        inp = InPort(TimedLong)
        runs = 0

        async def on_execute(self) -> None:
            self.runs += 1

    async with Kernel() as kernel:
        source, reader = await kernel.add(Source()), await kernel.add(Reader())
        await kernel.connect(source.out, reader.inp, dataflow="pull")
        await kernel.start(EventContext(), reader, activate=True)
        for number in range(5):
            source.out.write_nowait(long(number))
            await asyncio.sleep(0.001)
        assert reader.runs == 0
        assert reader.inp.is_new


# -- activation and time --------------------------------------------------------------------------------------------


def test_samples_for_an_inactive_component_are_dropped_and_activation_starts_empty() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            out, inp = await pair(kernel)
            sink, connector = kernel.components["sink0"], inp.connectors[0]
            out.write_nowait(long(0))  # in no context: open to plain application code
            assert inp.read_nowait().data == 0
            out.write_nowait(long(1))
            context = await kernel.start(EventContext(), sink)
            assert connector.statistics.dropped == {"inactive": 1}
            assert out.write_nowait(long(2))
            assert not inp.is_new
            assert connector.statistics.dropped == {"inactive": 2}
            await context.activate()
            assert inp.latest is None
            assert inp.last_source is None
            out.write_nowait(long(3))
            assert inp.read_nowait().data == 3
            assert inp.last_source is connector
            await context.stop()
            out.write_nowait(long(4))
            assert inp.read_nowait().data == 4
            assert connector.statistics.balanced

    simulate(main)


@pytest.mark.row(60)
def test_latency_and_age_follow_from_the_clock_and_the_sample() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            out, inp = await pair(kernel, subscription="periodic", push_rate=10.0)
            await kernel.sleep(0.03)
            out.write_nowait(TimedLong(clock.time_ns(), 1))
            sample = await inp.read()
            assert clock.time_ns() - sample.tm == 70_000_000  # written at 30 ms, sent at the period's end
            ledger = inp.connectors[0].statistics
            assert (ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)) == (1, 1, 0, {})

    simulate(main)


def test_a_read_with_a_time_out_waits_no_longer_on_the_kernels_clock() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            out, inp = await pair(kernel)
            with pytest.raises(ReadTimeout, match=r"sink0\.inp: no sample within 2\.5 s"):
                await inp.read(timeout=2.5)
            assert clock.monotonic_ns() == 2_500_000_000
            with pytest.raises(ReadTimeout):
                await inp.read(timeout=0)
            assert clock.monotonic_ns() == 2_500_000_000
            out.write_nowait(long(1))
            assert (await inp.read(timeout=0)).data == 1
            reading = asyncio.ensure_future(inp.read(timeout=3600.0))
            await asyncio.sleep(10.0)
            out.write_nowait(long(2))
            assert (await reading).data == 2
            assert clock.monotonic_ns() == 12_500_000_000
            out.write_nowait(long(3))
            assert (await inp.read(1.0)).data == 3

    simulate(main)


def test_a_read_that_timed_out_or_was_cancelled_leaves_nobody_waiting() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            out, inp = await pair(kernel)
            reading = asyncio.ensure_future(inp.read(timeout=5.0))
            await asyncio.sleep(1.0)
            with pytest.raises(BusyError):
                await inp.read(timeout=5.0)
            reading.cancel()
            with pytest.raises(asyncio.CancelledError):
                await reading
            with pytest.raises(ReadTimeout):
                await inp.read(timeout=1.0)
            after = asyncio.ensure_future(inp.read())
            await asyncio.sleep(100.0)  # no timer of a read that is over wakes this one
            assert not after.done()
            out.write_nowait(long(4))
            assert (await after).data == 4

    simulate(main)


async def test_a_time_out_that_is_none_is_refused_and_a_removed_port_ends_the_wait() -> None:
    async with Kernel() as kernel:
        _, inp = await pair(kernel)
        text: Any = "soon"
        for timeout in (-1.0, float("nan"), float("inf"), text):
            with pytest.raises(ConfigurationError, match=r"sink0\.inp: read: timeout = .*expected seconds from 0 on"):
                await inp.read(timeout=timeout)
        reading = asyncio.ensure_future(inp.read(timeout=60.0))
        await asyncio.sleep(0)
        await kernel.remove(kernel.components["sink0"])
        with pytest.raises(ClosedError):
            await reading
