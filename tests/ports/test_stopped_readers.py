"""A writer with full = block never waits for a reader that has left its last context; what has no room is counted."""

from __future__ import annotations

import functools
import threading
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, Context, EventContext, Kernel, PeriodicContext, ThreadContext, WouldBlock
from aiorts.kernel.ports.connector import unread_of
from aiorts.testing import simulate
from campaign import cases
from ports.parts import Sink, Source, long

Leave = Callable[[Kernel, Context, Component], Awaitable[None]]
WAYS: dict[str, Leave] = {
    "stop": lambda kernel, context, sink: context.stop(),
    "remove": lambda kernel, context, sink: context.remove(sink),
    "deactivate": lambda kernel, context, sink: context.deactivate(sink),
    "component": lambda kernel, context, sink: kernel.remove(sink),
}


class Idle(Sink):
    """Is active and reads nothing."""

    def on_execute(self) -> None: ...


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "kind", [EventContext, functools.partial(PeriodicContext, 10.0), functools.partial(ThreadContext, 10.0)]
)
@pytest.mark.parametrize("subscription", ["flush", "new"])
def test_a_blocked_writer_goes_on_when_its_reader_leaves(way: str, kind: Callable[[], Any], subscription: str) -> None:
    async def main(_clock: object) -> None:
        async with Kernel() as kernel:
            out = (await kernel.create(Source)).out
            sink = await kernel.create(Idle)
            connector = await kernel.connect(
                out, sink.inp, subscription=subscription, push="all", length=2, full="block", timeout=None
            )
            context = await kernel.start(kind(), sink, activate=True)
            wrote: list[int] = []

            async def write() -> None:
                for number in range(10):
                    await out.write(long(number))
                    wrote.append(number)

            writer = kernel.loop.create_task(write())
            await kernel.sleep(1.0)
            assert wrote == [0, 1]
            await WAYS[way](kernel, context, sink)
            await kernel.sleep(1.0)
            assert writer.done()
            ledger = connector.statistics
            if way == "component":
                assert set(ledger.dropped) <= {"disconnected", "inactive"}
            else:
                # In no context at all it is open to application code again, as far as there is room. A thread shuts it
                # down while the writer goes on: what comes between deactivation and leaving is dropped.
                kept, room = ledger.buffered, 0 if way == "deactivate" else 2
                assert kept <= room if isinstance(context, ThreadContext) else kept == room
                assert ledger.dropped == {"inactive": 10 - kept}
                assert (ledger.written, ledger.delivered) == (10, 0)
                assert out.write_nowait(long(10))
                assert len(sink.inp.drain()) == min(kept + 1, room)
                if way == "stop":
                    await kernel.start(EventContext(), sink, activate=True)
                    assert out.write_nowait(long(11))
                    assert unread_of(connector) == 1
                    out.write_nowait(long(12))
                    with pytest.raises(WouldBlock):
                        out.write_nowait(long(13))

    simulate(main)


@pytest.mark.parametrize("way", ["stop", "remove"])
def test_what_is_written_while_a_thread_shuts_its_reader_down_is_dropped(way: str) -> None:
    wrote_all = threading.Event()

    class Slow(Idle):
        def on_shutdown(self) -> None:
            assert wrote_all.wait(20.0)

    async def main(_clock: object) -> None:
        async with Kernel() as kernel:
            out, sink = (await kernel.create(Source)).out, await kernel.create(Slow)
            connector = await kernel.connect(out, sink.inp, length=2, full="block", timeout=None)
            context = await kernel.start(ThreadContext(10.0), sink, activate=True)

            async def write() -> None:
                for number in range(10):
                    await out.write(long(number))
                wrote_all.set()

            writer = kernel.loop.create_task(write())
            await kernel.sleep(1.0)
            await WAYS[way](kernel, context, sink)
            assert writer.done()
            ledger = connector.statistics
            assert (ledger.written, ledger.dropped) == (10, {"inactive": 10})
            assert out.write_nowait(long(10))
            assert len(sink.inp.drain()) == 1

    simulate(main)


def test_a_reader_in_two_contexts_is_read_until_the_last_one_stops() -> None:
    async def main(_clock: object) -> None:
        async with Kernel() as kernel:
            out = (await kernel.create(Source)).out
            sink = await kernel.create(Idle)
            connector = await kernel.connect(out, sink.inp, length=2, full="block")
            first = await kernel.start(EventContext(), sink, activate=True)
            second = await kernel.start(EventContext(), sink, activate=True)
            await first.stop()
            await second.deactivate()
            await second.activate()
            out.write_nowait(long(1))
            out.write_nowait(long(2))
            assert unread_of(connector) == 2
            with pytest.raises(WouldBlock):
                out.write_nowait(long(3))
            await second.stop()
            assert connector.statistics.dropped == {"inactive": 2}
            assert unread_of(connector) == 0

    simulate(main)


def test_a_component_that_was_never_in_a_context_is_open_to_application_code() -> None:
    async def main(_clock: object) -> None:
        async with Kernel() as kernel:
            out, sink = (await kernel.create(Source)).out, await kernel.create(Idle)
            await kernel.connect(out, sink.inp)
            out.write_nowait(long(1))
            assert (await sink.inp.read()).data == 1

    simulate(main)


@pytest.mark.slow(kept_by="test_a_blocked_writer_goes_on_when_its_reader_leaves")
@given(steps=st.lists(st.sampled_from(["start", "stop", "activate", "deactivate", "sleep"]), max_size=12))
@settings(max_examples=cases(2000), deadline=None)
def test_a_writer_waits_only_while_its_reader_is_active_or_was_never_run(steps: list[str]) -> None:
    async def main(_clock: object) -> None:
        async with Kernel() as kernel:
            out, sink = (await kernel.create(Source)).out, await kernel.create(Idle)
            connector = await kernel.connect(out, sink.inp, length=2, full="block", timeout=None)
            context: EventContext | None = None
            run = active = False
            wrote = 0

            async def write() -> None:
                nonlocal wrote
                while True:
                    await out.write(long(0))
                    wrote += 1
                    await kernel.sleep(0.1)

            writer = kernel.loop.create_task(write())
            for step in steps:
                if step == "start" and context is None:
                    context, run, active = await kernel.start(EventContext(), sink), True, False
                elif step == "stop" and context is not None:
                    await context.stop()
                    context, active = None, False
                elif step in ("activate", "deactivate") and context is not None:
                    await getattr(context, step)()
                    active = step == "activate"
                await kernel.sleep(0.5)
                before = wrote
                await kernel.sleep(1.05)
                assert (wrote > before) is (run and not active), (step, connector)
                ledger = connector.statistics
                assert ledger.written == ledger.delivered + sum(ledger.dropped.values()) + ledger.buffered
            writer.cancel()

    simulate(main)
