"""Monitoring looks at chosen values at a rate and changes nothing."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort, Param, PeriodicContext, SimulatedClock
from aiorts.errors import ClosedError, ConfigurationError, WiringError
from aiorts.testing import simulate, simulated
from aiorts.types import TimedDouble

pytestmark = pytest.mark.row(81)
SECOND = 1_000_000_000


class Source(Component):
    out = OutPort(TimedDouble)
    gain = Param(2.0)
    sent = 0.0

    def on_execute(self) -> None:
        self.sent += 1.0
        self.out.write_nowait(TimedDouble(0, self.sent))


class Sink(Component):
    into = InPort(TimedDouble)

    def on_initialize(self) -> None:
        self.got: list[float] = []

    def on_execute(self) -> None:
        self.got += [sample.data for sample in self.into.drain()]


async def system(kernel: Kernel) -> tuple[Source, Sink, Any]:
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    await kernel.connect(source.out, sink.into, name="wire", length=1000)
    loop = await kernel.start(PeriodicContext(10.0, name="loop"), source, activate=True)
    return source, sink, loop


PATHS = ["source.out.data", "sink.into", "source.gain", "source.state", "loop.lateness", "loop.ticks", "wire.written"]


@simulated
async def test_a_connector_without_a_name_of_its_own_is_named_by_its_ports() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        connector = await kernel.connect(source.out, sink.into)
        source.out.write_nowait(TimedDouble(0, 1.0))
        assert connector.profile.name == "source.out-sink.into"
        reading = await anext(kernel.monitor(["source.out-sink.into.written"], rate=2.0))
        assert dict(reading.values) == {"source.out-sink.into.written": 1}


def test_values_come_at_the_rate_with_the_time_and_no_sample_is_taken() -> None:
    """OpenRTM's get_monitoring raises InterfaceNotImplemented; its status list is empty."""

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            source, sink, _ = await system(kernel)
            await clock.advance(0.05)
            begun = clock.monotonic_ns()
            readings = []
            async with kernel.monitor(PATHS, rate=2.0) as monitor:
                async for reading in monitor:
                    readings.append(reading)
                    if len(readings) == 5:
                        break
            assert [r.monotonic_ns - begun for r in readings] == [n * SECOND // 2 for n in range(5)]
            assert [r.values["loop.ticks"] for r in readings] == [r.values["wire.written"] for r in readings]
            assert [r.values["source.out.data"] for r in readings] == [float(r.values["loop.ticks"]) for r in readings]
            assert readings[-1].values["sink.into"] == TimedDouble(0, source.sent)
            assert readings[-1].values["source.gain"] == 2.0
            assert readings[-1].values["source.state"] == "active"
            assert readings[-1].values["loop.lateness"] == 0.0
            assert [r.missed for r in readings] == [0] * 5
            assert [s.data for s in sink.into.drain()] == [float(n + 1) for n in range(int(source.sent))]

    simulate(main)


def test_what_was_read_is_still_seen_and_a_component_that_went_is_none() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            source, sink, _ = await system(kernel)
            monitor = kernel.monitor(["sink.into.data", "source.gain"], rate=10.0)
            await clock.advance(0.35)
            taken = [s.data for s in sink.into.drain()]
            assert (await anext(monitor)).values == {"sink.into.data": taken[-1], "source.gain": 2.0}
            await source.configure(gain=5.0)
            assert (await anext(monitor)).values["source.gain"] == 5.0
            await kernel.remove(source)
            assert (await anext(monitor)).values["source.gain"] is None

    simulate(main)


def test_a_slow_reader_is_told_what_it_missed() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            await system(kernel)
            monitor = kernel.monitor(["loop.ticks"], rate=10.0)
            assert (await anext(monitor)).missed == 0
            await asyncio.sleep(1.05)
            assert (await anext(monitor)).missed == 9
            first = clock.monotonic_ns()
            await anext(monitor)
            assert clock.monotonic_ns() - first < SECOND // 10

    simulate(main)


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("sourc.gain", "did you mean source"),
        ("source.gian", "it has out, gain, state"),
        ("loop.speed", "it has ticks"),
        ("wire.speed", "it has written"),
        ("source", r"is a component; say what of it, such as source\.state"),
        ("nobody", "no component"),
    ],
)
def test_what_is_not_there_is_refused_with_what_there_is(path: str, says: str) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            await system(kernel)
            with pytest.raises(WiringError, match=says):
                kernel.monitor([path])

    simulate(main)


@pytest.mark.parametrize("rate", [0, -1.0, float("nan"), float("inf"), True, "10"])
def test_a_rate_that_is_none_is_refused(rate: Any) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            await system(kernel)
            with pytest.raises(ConfigurationError):
                kernel.monitor(["loop.ticks"], rate=rate)
            with pytest.raises(ConfigurationError):
                kernel.monitor("loop.ticks")

    simulate(main)


def test_it_ends_with_its_kernel() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            await system(kernel)
            monitor = kernel.monitor(["loop.ticks"], rate=0.01)
            await anext(monitor)
            waiting = asyncio.create_task(anext(monitor, None))
            await asyncio.sleep(0)
        assert await waiting is None
        assert clock.monotonic_ns() < 10 * SECOND
        with pytest.raises(ClosedError):
            kernel.monitor(["loop.ticks"])

    simulate(main)


@simulated
async def test_an_out_port_shows_what_was_written_last_whoever_reads() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        seen: list[float | None] = []

        async def look() -> None:
            reading = await anext(kernel.monitor(["source.out.data", "source.out"], rate=10.0))
            sample = reading.values["source.out"]
            seen.append(reading.values["source.out.data"])
            assert seen[-1] == (None if sample is None else sample.data)

        await look()
        source.out.write_nowait(TimedDouble(0, 1.0))
        await look()
        context = await kernel.start(PeriodicContext(10.0), sink)
        wire = await kernel.connect(source.out, sink.into)
        source.out.write_nowait(TimedDouble(0, 2.0))
        await look()
        await context.activate(sink)
        await look()
        await kernel.disconnect(wire)
        await look()
        assert seen == [None, 1.0, 2.0, 2.0, 2.0]


@pytest.mark.row(60)
@simulated
async def test_a_connector_between_two_ports_shows_latency_age_and_rate() -> None:
    async with Kernel() as kernel:
        await kernel.sleep(1.0)
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        await kernel.connect(source.out, sink.into, name="wire", measure=10)
        wire = "source.out->sink.into"
        figures = ("latency", "latency_p99", "latency_max", "age", "age_p99", "age_max", "rate")
        async with kernel.monitor([f"{wire}.{figure}" for figure in figures], rate=2.0) as monitor:
            assert tuple((await anext(monitor)).values.values()) == (None,) * 6 + (0.0,)
            for wait in (0.001, 0.002, 0.003):
                source.out.write_nowait(TimedDouble(kernel.time_ns() - 1_000_000, 1.0))
                await kernel.sleep(wait)
                sink.into.read_nowait()
            assert tuple((await anext(monitor)).values.values()) == (0.002, 0.003, 0.003, 0.003, 0.004, 0.004, 6.0)
            assert (await anext(monitor)).values[f"{wire}.rate"] == 0.0
        async with kernel.monitor(["wire.rate", "wire.latency"], rate=2.0) as monitor:
            assert tuple((await anext(monitor)).values.values()) == (3.0, 0.002)  # since it was made, 1 s ago


@pytest.mark.row(60)
@simulated
async def test_what_a_connector_does_not_measure_is_refused() -> None:
    async with Kernel() as kernel:
        await system(kernel)
        with pytest.raises(WiringError, match=r"wire\.latency: is not measured; connect with measure=1000"):
            kernel.monitor(["source.out->sink.into.latency"])
        with pytest.raises(WiringError, match=r"no connector from source\.in to sink\.into; there are source"):
            kernel.monitor(["source.in->sink.into.age"])


@pytest.mark.row(33)
@simulated
async def test_the_lateness_of_a_context_is_seen() -> None:
    async with Kernel() as kernel:
        await system(kernel)
        async with kernel.monitor(["loop.lateness_p50", "loop.lateness_p99"]) as monitor:
            assert set((await anext(monitor)).values.values()) == {0.0}


@simulated
async def test_it_is_closed_where_its_block_ends() -> None:
    async with Kernel() as kernel:
        await system(kernel)
        async with kernel.monitor(["loop.ticks"], rate=0.01) as monitor:
            await anext(monitor)
            waiting = asyncio.create_task(anext(monitor, None))
            await asyncio.sleep(0)
        assert await waiting is None
        assert [reading async for reading in monitor] == []
        monitor.close()
        assert kernel.clock.monotonic_ns() < 10 * SECOND
