"""A thread calls on the loop and blocks: what it gets, what ends its wait, and who may not."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from aiorts import Component, ExternalContext, Kernel
from aiorts.errors import CallTimeout, ClosedError, ConfigurationError, StateError, ThreadError

pytestmark = pytest.mark.anyio


async def in_thread(function: Callable[[], Any]) -> Any:
    """What the function returns or raises in a thread, while the loop goes on."""
    return await asyncio.wait_for(asyncio.to_thread(function), 20)


async def test_it_returns_what_a_function_or_a_coroutine_returns_on_the_loop() -> None:
    async def later(a: int, b: int) -> tuple[int, int, int]:
        await asyncio.sleep(0)
        return a, b, threading.get_ident()

    async with Kernel() as kernel:
        here = threading.get_ident()
        assert await in_thread(lambda: kernel.call_from_thread(threading.get_ident)) == here
        assert await in_thread(lambda: kernel.call_from_thread(later, 1, 2)) == (1, 2, here)


@pytest.mark.parametrize("error", [KeyError("k"), TimeoutError("t"), SystemExit(3), asyncio.CancelledError()])
async def test_it_raises_what_the_function_raises(error: BaseException) -> None:
    def fail() -> None:
        raise error

    async def fail_later() -> None:
        await asyncio.sleep(0)
        raise error

    async with Kernel() as kernel:
        for function in (fail, fail_later):
            raised: list[BaseException] = []

            def call(function: Callable[[], Any] = function, raised: list[BaseException] = raised) -> None:
                try:
                    kernel.call_from_thread(function)
                except BaseException as caught:
                    raised.append(caught)

            await in_thread(call)
            assert [type(one) for one in raised] == [type(error)]


@pytest.mark.slow
async def test_over_its_time_what_has_begun_is_cancelled_and_what_has_not_is_never_called() -> None:
    ended: list[str] = []
    begun = threading.Event()

    async def forever() -> None:
        begun.set()
        try:
            await asyncio.sleep(3600)
        except asyncio.CancelledError:
            ended.append("cancelled")
            raise

    async with Kernel() as kernel:
        with pytest.raises(CallTimeout, match=r"kernel: call_from_thread\(forever\): was not done within 0\.05 s"):
            await in_thread(lambda: kernel.call_from_thread(forever, timeout=0.05))
        assert begun.is_set()
        for _ in range(5):
            await asyncio.sleep(0)
        assert ended == ["cancelled"]

        raised: list[BaseException] = []

        def call() -> None:
            try:
                kernel.call_from_thread(ended.append, "called", timeout=0.02)
            except CallTimeout as error:
                raised.append(error)

        thread = threading.Thread(target=call)
        thread.start()
        thread.join(20)  # the loop stands still
        assert len(raised) == 1
        for _ in range(5):
            await asyncio.sleep(0)
        assert ended == ["cancelled"]


async def test_closing_ends_the_wait_of_a_thread() -> None:
    begun = threading.Event()

    async def forever() -> None:
        begun.set()
        await asyncio.sleep(3600)

    async with Kernel() as kernel:
        waiting = asyncio.ensure_future(in_thread(lambda: kernel.call_from_thread(forever)))
        while not begun.is_set():
            await asyncio.sleep(0.001)
    with pytest.raises(ClosedError, match="the kernel is closing, or closed"):
        await waiting
    with pytest.raises(ClosedError, match="the kernel is closing, or closed"):
        await in_thread(lambda: kernel.call_from_thread(forever))
    with pytest.raises(ClosedError, match="is not open"):
        await in_thread(lambda: Kernel().call_from_thread(forever))


async def test_wrong_uses_are_refused_with_what_to_do() -> None:
    async with Kernel() as kernel:
        with pytest.raises(ThreadError, match="would block the event loop; call the function itself"):
            kernel.call_from_thread(time.time)
        for timeout in (0, -1.0, float("nan")):
            with pytest.raises(ConfigurationError, match="call_from_thread: timeout = "):
                kernel.call_from_thread(time.time, timeout=timeout)


class Counter(Component):
    """Counts its cycles, each of which takes a turn of the loop."""

    count = 0

    async def on_execute(self) -> None:
        await asyncio.sleep(0)
        self.count += 1


async def test_a_simulator_ticks_from_its_thread() -> None:
    async with Kernel() as kernel:
        counter, context = await kernel.add(Counter("counter")), ExternalContext(name="world")
        with pytest.raises(StateError, match="world: cannot tick_from_thread: the context does not run"):
            context.tick_from_thread()
        await kernel.start(context, counter, activate=True)
        seen: list[int] = []

        def simulate() -> None:
            for _ in range(3):
                context.tick_from_thread()
                seen.append(counter.count)
            context.tick_from_thread(10)
            seen.append(counter.count)

        await in_thread(simulate)
        assert seen == [1, 2, 3, 13]
        with pytest.raises(ThreadError, match="would block the event loop"):
            context.tick_from_thread()


async def test_a_tick_over_its_time_is_withdrawn() -> None:
    class Slow(Component):
        begun = 0

        async def on_execute(self) -> None:
            self.begun += 1
            await gate.wait()

    gate = asyncio.Event()
    async with Kernel() as kernel:
        slow = await kernel.add(Slow("slow"))
        context = await kernel.start(ExternalContext(), slow, activate=True)
        with pytest.raises(CallTimeout):
            await in_thread(lambda: context.tick_from_thread(5, timeout=0.05))
        gate.set()
        await context.tick()
        assert slow.begun == 2


async def test_stopping_the_context_ends_the_wait_of_a_thread_that_ticks() -> None:
    class Slow(Component):
        async def on_execute(self) -> None:
            begun.set()
            await gate.wait()

    begun, gate = asyncio.Event(), asyncio.Event()
    async with Kernel() as kernel:
        slow = await kernel.add(Slow("slow"))
        context = await kernel.start(ExternalContext(), slow, activate=True)
        ticking = asyncio.ensure_future(in_thread(lambda: context.tick_from_thread(2)))
        await asyncio.wait_for(begun.wait(), 20)
        stopping = asyncio.ensure_future(context.stop())
        await asyncio.sleep(0)
        gate.set()
        await stopping
        with pytest.raises(ClosedError):
            await ticking
