"""Windows of a kernel that runs, in virtual time, are what its ledgers and statistics say."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort, PeriodicContext
from aiorts.errors import ClosedError
from aiorts.events import Overrun
from aiorts.health import Health
from aiorts.model.blame import Blame
from aiorts.model.health.verdict import verdict
from aiorts.model.health.windows import ContextCounts
from aiorts.testing import simulated

if TYPE_CHECKING:
    from aiorts.model.health.windows import Window

BETWEEN_TICKS = 0.005
EDGE = "writer.out-reader.into"


class Writer(Component):
    out = OutPort(float)

    def on_execute(self) -> None:
        self.out.write_nowait(1.0)


class Reader(Component):
    """Reads some of what is there in each cycle, and fails when it is asked to."""

    into = InPort(float)
    at_once = 10
    fails = False

    def on_execute(self) -> None:
        if self.fails:
            raise OSError("no device")
        for _ in range(self.at_once):
            if self.into.is_new:
                self.into.read_nowait()


class System:
    """A writer of 100 Hz and a reader of 10 Hz, that keeps up with it."""

    def __init__(self, kernel: Kernel) -> None:
        self.kernel = kernel
        self.health = Health(kernel)

    async def start(self, **options: Any) -> System:
        kernel = self.kernel
        self.writer, self.reader = await kernel.create(Writer, "writer"), await kernel.create(Reader, "reader")
        self.connector = await kernel.connect(self.writer.out, self.reader.into, **({"length": 10} | options))
        self.fast, self.slow = PeriodicContext(rate=100.0, name="fast"), PeriodicContext(rate=10.0, name="slow")
        await kernel.start(self.slow, self.reader, activate=True)
        await kernel.start(self.fast, self.writer, activate=True)
        await kernel.sleep(0.5 + BETWEEN_TICKS)
        return self


def seen(window: Window) -> tuple[int, int]:
    one = window.edges[EDGE]
    return one.written, one.dropped


@simulated
async def test_a_window_has_what_came_in_it() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start()
        start = system.connector.statistics
        window = await system.health.window(2.0)
        assert window.length_ns == 2_000_000_000
        assert seen(window) == (system.connector.statistics.written - start.written, 0) == (200, 0)
        assert window.contexts["fast"] == ContextCounts(200, rate=100.0, paced=True, members=("writer",))
        assert (dict(window.errors), window.idle, window.stalled) == ({}, frozenset(), 0.0)


@simulated
async def test_drops_that_more_than_double_are_found_and_fewer_are_not() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start()
        system.reader.at_once = 9
        await kernel.sleep(1.0)
        before = await system.health.window(2.0)
        system.reader.at_once = 8
        assert verdict(before, await system.health.window(2.0)) is None
        system.reader.at_once = 7
        await kernel.sleep(0.5)
        found = verdict(before, await system.health.window(4.0))
        assert str(found) == f"{EDGE}: 120 of 400 samples were dropped in 4 s, and 20 of 200 before"


@simulated
async def test_what_an_option_asks_for_is_no_loss() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start(push="new", subscription="new")
        window = await system.health.window(2.0)
        assert system.connector.statistics.dropped["superseded"] > 100
        assert seen(window) == (200, 0)


@simulated
async def test_what_an_option_left_out_before_was_not_read_before_either() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start(push="new", subscription="new")
        before = await system.health.window(2.0)
        await kernel.disconnect(system.connector)
        await kernel.connect(system.writer.out, system.reader.into, length=1)
        overwritten = await system.health.window(2.0)
        assert overwritten.edges[EDGE].dropped > 100
        assert verdict(before, overwritten) is None
        seldom = replace(before, edges={EDGE: before.edges[EDGE]._replace(left_out=10)})
        found = verdict(seldom, overwritten)
        assert str(found).endswith("samples were dropped in 2 s, and 10 of 200 before")


@simulated
async def test_a_connector_that_was_made_anew_is_compared_by_its_name() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start()
        before = await system.health.window(2.0)
        await kernel.disconnect(system.connector)
        await kernel.connect(system.writer.out, system.reader.into, length=1)
        after = await system.health.window(2.0)
        found = verdict(before, after)
        assert found is not None
        assert (found.what, found.name) == ("drops", EDGE)


@simulated
async def test_a_writer_that_falls_silent_is_found_and_one_that_is_deactivated_is_not() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start()
        before = await system.health.window(1.0)
        system.writer.on_execute = lambda: None  # type: ignore[method-assign]
        await system.fast.remove(system.writer)
        await system.fast.add(system.writer)
        after = await system.health.window(1.0)
        assert after.idle == {"writer"}
        assert verdict(before, after) is None
        await system.fast.activate()
        found = verdict(before, await system.health.window(1.0))
        assert str(found) == f"{EDGE}: 0 samples a second, and 100 before"


@simulated
async def test_a_rate_that_was_lowered_is_no_fault() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start()
        before = await system.health.window(2.0)
        await system.fast.set_rate(50.0)
        after = await system.health.window(2.0)
        assert seen(after)[0] == pytest.approx(100, abs=1)
        assert verdict(before, after) is None


@simulated
async def test_who_was_in_error_meanwhile_is_known_though_it_is_not_any_more() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start()

        async def repair() -> None:
            await kernel.sleep(0.55)
            system.reader.fails = True
            await kernel.sleep(0.2)
            system.reader.fails = False
            await system.slow.reset()
            await system.slow.activate()

        before = await system.health.window(1.0)
        repairing = asyncio.ensure_future(repair())
        after = await system.health.window(1.0)
        await repairing
        assert dict(after.errors) == {"reader": "OSError: no device"}
        assert str(verdict(before, after)) == "reader: in error: OSError: no device"
        assert dict((await system.health.window(1.0)).errors) == {}
        system.reader.fails = True
        await kernel.sleep(0.2)
        assert dict((await system.health.window(0.0)).errors) == {"reader": "OSError: no device"}


@simulated
async def test_overruns_that_the_machine_is_to_blame_for_are_counted_apart() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start()
        measured = asyncio.ensure_future(system.health.window(1.0))
        await kernel.sleep(0.5)
        kernel.bus.publish(Overrun("fast", 3, 30_000_000, "skip", Blame("machine", held_ns=30_000_000)))
        kernel.bus.publish(Overrun("fast", 2, 20_000_000, "skip", Blame("hook", held_ns=20_000_000)))
        kernel.bus.publish(Overrun("fast", 2, 20_000_000))
        found = (await measured).contexts["fast"]
        assert (found.by_machine, found.left_out) == (1, 3)
        assert (await system.health.window(1.0)).contexts["fast"].by_machine == 0


@simulated
async def test_a_window_that_was_watched_is_there_at_once_and_is_as_long_as_it_was_asked_for() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start()
        clock = kernel.clock
        began = clock.monotonic_ns()
        assert (await system.health.before(1.0)).length_ns == clock.monotonic_ns() - began == 1_000_000_000
        system.health.watch(1.0)
        await kernel.sleep(0.5)
        began = clock.monotonic_ns()
        assert (await system.health.before(1.0)).length_ns == 1_000_000_000
        assert clock.monotonic_ns() == began + 1_000_000_000
        for wait in (0.7, 1.0, 2.6):
            await kernel.sleep(wait)
            began = clock.monotonic_ns()
            window = await system.health.before(1.0)
            assert clock.monotonic_ns() == began
            assert 1_000_000_000 <= window.length_ns <= 2_000_000_000
            assert seen(window)[0] == pytest.approx(window.length_ns / 1e7, abs=1)
        system.health.forget()
        await kernel.sleep(0.0)
        assert kernel.bus.observers == ()
        system.health.watch(1.0)
        await kernel.sleep(3.5)
    assert kernel.bus.observers == ()


@simulated
async def test_a_kernel_that_closes_ends_the_window_and_a_caller_that_gives_up_leaves_nothing() -> None:
    async with Kernel() as kernel:
        system = await System(kernel).start()
        given_up = asyncio.ensure_future(system.health.window(100.0))
        await kernel.sleep(0.5)
        assert len(kernel.bus.observers) == 2
        given_up.cancel()
        with pytest.raises(asyncio.CancelledError):
            await given_up
        assert kernel.bus.observers == ()
        left = asyncio.ensure_future(system.health.window(100.0))
        await kernel.sleep(0.5)
    with pytest.raises(ClosedError):
        await left
    assert kernel.bus.observers == ()


@pytest.mark.slow
@simulated
async def test_the_loop_turns_while_many_are_counted() -> None:
    async with Kernel() as kernel:
        out = await kernel.create(Writer, "writer")
        for number in range(450):
            await kernel.connect(out.out, (await kernel.create(Reader, f"r{number}")).into)
        turns = 0
        measuring = asyncio.ensure_future(Health(kernel).window(0.0))
        while not measuring.done():
            turns += 1
            await asyncio.sleep(0)
        assert len(measuring.result().edges) == 450
        assert turns >= 2 * 3 + 2
