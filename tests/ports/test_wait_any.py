"""Waiting for several in-ports: which are returned, what is taken, how a wait ends and what it leaves behind."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, InPort, Kernel, OutPort, SimulatedClock, wait_any
from aiorts.errors import BusyError, ClosedError, ConfigurationError, ReadTimeout, ThreadError
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases
from ports.parts import Source, long


class Three(Component):
    a = InPort(TimedLong)
    b = InPort(TimedLong)
    c = InPort(TimedLong)


class System:
    """Three writers, each connected to one in-port of a reader."""

    def __init__(self, outs: list[OutPort[TimedLong]], reader: Three, kernel: Kernel, clock: SimulatedClock) -> None:
        self.outs, self.reader, self.kernel, self.clock = outs, reader, kernel, clock
        self.ports = (reader.a, reader.b, reader.c)

    def write(self, port: int, number: int = 0) -> None:
        self.outs[port].write_nowait(long(number))


def run(test: Callable[[System], Awaitable[None]], seed: int | None = None, **options: Any) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            reader = await kernel.add(Three())
            sources = [await kernel.add(Source()) for _ in range(3)]
            system = System([source.out for source in sources], reader, kernel, clock)
            for out, port in zip(system.outs, system.ports, strict=True):
                await kernel.connect(out, port, **options)
            await test(system)

    simulate(main, seed=seed)


def test_the_ports_with_unread_data_come_in_the_order_of_the_arguments_and_keep_their_samples() -> None:
    async def test(system: System) -> None:
        a, b, c = system.ports
        system.write(2, 7)
        system.write(0, 8)
        assert await wait_any(a, b, c) == (a, c)
        assert await wait_any(c, b, a, c) == (c, a)
        assert (a.read_nowait().data, c.read_nowait().data) == (8, 7)
        system.write(1)
        assert await wait_any(a, b, c) == (b,)

    run(test)


@pytest.mark.parametrize("options", [{}, {"dataflow": "pull"}, {"full": "block", "length": 1}, {"stamp": "read"}])
def test_a_wait_ends_with_the_first_sample_at_any_of_its_ports(options: dict[str, Any]) -> None:
    async def test(system: System) -> None:
        for port in (2, 0, 1):
            waiting = asyncio.create_task(wait_any(*system.ports))
            await asyncio.sleep(1.0)
            assert not waiting.done()
            system.write(port)
            assert await waiting == (system.ports[port],)
            assert not system.ports[port].read_nowait().data

    run(test, **options)


def test_a_time_out_is_counted_on_the_kernels_clock_and_names_the_ports() -> None:
    async def test(system: System) -> None:
        a, b, _ = system.ports
        with pytest.raises(ReadTimeout, match=r"three0\.a, three0\.b: no sample within 1\.5 s"):
            await wait_any(a, b, timeout=1.5)
        assert system.clock.time() == 1.5
        with pytest.raises(ReadTimeout):
            await wait_any(a, b, timeout=0)
        assert system.clock.time() == 1.5
        system.write(1)
        assert await wait_any(a, b, timeout=0) == (b,)
        assert await wait_any(a, b, timeout=math.inf) == (b,)

    run(test)


def test_while_one_waits_at_a_port_another_task_cannot() -> None:
    async def test(system: System) -> None:
        a, b, c = system.ports
        waiting = asyncio.create_task(wait_any(a, b))
        await asyncio.sleep(0)
        with pytest.raises(BusyError, match=r"three0\.b: another task waits"):
            await b.read()
        with pytest.raises(BusyError, match=r"three0\.b: another task waits"):
            await wait_any(c, b)
        system.write(2)
        assert (await c.read()).data == 0, "the refused wait has left nothing behind"
        reading = asyncio.create_task(c.read())
        await asyncio.sleep(0)
        system.write(0)
        assert await waiting == (a,)
        system.write(2, 5)
        assert (await reading).data == 5

    run(test)


def test_a_cancelled_wait_leaves_no_waiter_and_takes_nothing() -> None:
    async def test(system: System) -> None:
        waiting = asyncio.create_task(wait_any(*system.ports))
        await asyncio.sleep(1.0)
        waiting.cancel()
        await asyncio.wait([waiting])
        assert waiting.cancelled()
        reads = [asyncio.create_task(port.read()) for port in system.ports]
        await asyncio.sleep(0)
        for port in range(3):
            system.write(port, port)
        assert [(await read).data for read in reads] == [0, 1, 2]

    run(test)


def test_a_removed_port_ends_the_wait_unless_another_has_data() -> None:
    async def test(system: System) -> None:
        a, b, c = system.ports
        waiting = asyncio.create_task(wait_any(a, b, c))
        await asyncio.sleep(1.0)
        system.reader.remove_port("b")
        with pytest.raises(ClosedError, match=r"three0\.b"):
            await waiting
        system.write(2)
        assert await wait_any(a, c, b) == (c,)

    run(test)


def test_a_sample_that_others_took_does_not_end_the_wait() -> None:
    async def test(system: System) -> None:
        a, b, _ = system.ports
        waiting = asyncio.create_task(wait_any(a, b, timeout=5.0))
        await asyncio.sleep(1.0)
        system.write(0)
        a.read_nowait()
        await asyncio.sleep(1.0)
        assert not waiting.done()
        system.write(1)
        assert await waiting == (b,)

    run(test)


def test_a_member_of_an_event_context_waits_in_its_hook_and_still_runs_for_data() -> None:
    ready: list[tuple[str, ...]] = []

    class Waiting(Three):
        async def on_execute(self) -> None:
            ready.append(tuple(port.name for port in await wait_any(self.b, self.c)))
            for port in (self.a, self.b, self.c):
                port.drain()

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            source, waiting = await kernel.add(Source()), await kernel.add(Waiting())
            other = await kernel.add(Source())
            await kernel.connect(source.out, waiting.a)
            await kernel.connect(other.out, waiting.c)
            await kernel.start(EventContext(), waiting, activate=True)
            for _ in range(3):
                source.out.write_nowait(long(0))
                await asyncio.sleep(1.0)
                other.out.write_nowait(long(0))
                await asyncio.sleep(1.0)

    simulate(main)
    assert ready == [("c",)] * 3


@pytest.mark.parametrize("timeout", [-1, math.nan, True, "1"])
def test_a_time_out_that_is_none_is_refused(timeout: Any) -> None:
    async def test(system: System) -> None:
        with pytest.raises(ConfigurationError, match=r"timeout = .*: expected seconds, 0 or more, or None"):
            await wait_any(system.reader.a, timeout=timeout)

    run(test)


def test_what_is_no_in_port_of_a_component_is_refused_with_what_to_do() -> None:
    async def test(system: System) -> None:
        with pytest.raises(ConfigurationError, match=r"no in-port given.*wait_any\(self\.command\)"):
            await wait_any()
        wrong: Any = system.outs[0]
        with pytest.raises(ConfigurationError, match="expected in-ports"):
            await wait_any(system.reader.a, wrong)
        with pytest.raises(ClosedError, match="belongs to no component"):
            await wait_any(system.reader.a, InPort(TimedLong))
        with pytest.raises(ThreadError, match="ask on the kernel's loop"):
            await asyncio.to_thread(_step, wait_any(system.reader.a))

    run(test)


def _step(coroutine: Any) -> None:
    coroutine.send(None)


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("write"), st.integers(0, 2)),
        st.tuples(st.just("read"), st.integers(0, 2)),
        st.tuples(st.just("wait"), st.lists(st.integers(0, 2), min_size=1, max_size=3, unique=True)),
        st.tuples(st.just("cancel"), st.just(0)),
        st.tuples(st.just("pass"), st.integers(1, 4)),
    ),
    max_size=30,
)


@pytest.mark.slow(kept_by="test_a_wait_ends_with_the_first_sample_at_any_of_its_ports")
@settings(max_examples=cases(5_000), deadline=None)
@given(STEPS, st.integers(0, 1_000_000))
def test_any_waits_are_as_in_a_model(steps: list[tuple[str, Any]], seed: int) -> None:
    """The model: what is unread at each port, and the one wait, which ends as soon as one of its ports has data."""

    async def test(system: System) -> None:
        unread = [0, 0, 0]
        wanted: list[int] = []
        until = 0
        now = 0
        task: asyncio.Task[Any] | None = None

        async def check(later: float) -> None:
            """Let the wait end where it has to; compare it, and what is unread, with the model."""
            nonlocal task
            await asyncio.sleep(later)
            ready = tuple(system.ports[port] for port in wanted if unread[port])
            if task is not None and (ready or until <= now):
                assert task.done()
                if ready:
                    assert task.result() == ready
                else:
                    assert isinstance(task.exception(), ReadTimeout)
                task = None
            assert task is None or not task.done()
            assert [sum(one.statistics.buffered for one in port.connectors) for port in system.ports] == unread

        for verb, what in steps:
            if verb == "write":
                system.write(what)
                unread[what] += 1
            elif verb == "read" and unread[what]:
                system.ports[what].read_nowait()
                unread[what] -= 1
            elif verb == "wait" and task is None:
                wanted, until = what, now + 3
                waited = [system.ports[port] for port in what]
                task = asyncio.create_task(wait_any(*waited, timeout=2.5))
            elif verb == "cancel" and task is not None:
                task.cancel()
                await asyncio.wait([task])
                task = None
            elif verb == "pass":
                await asyncio.sleep(what)
                now += what
            await check(0.25)
            now += 1
            await check(0.75)
        if task is not None:
            task.cancel()

    run(test, seed, length=64)
