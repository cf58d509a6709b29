"""Requests made from inside hooks, and callers that are cancelled while they wait: no deadlock, no half a system."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, EventContext, ExternalContext, Kernel, Param, PeriodicContext, SimulatedClock
from aiorts.errors import ClosedError, ComponentError, StateError
from aiorts.model.lifecycle import LifecycleState
from aiorts.testing.simulation import simulate
from kernel_parts import AsyncDiary, Diary, PlainDiary

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

I, A, E = LifecycleState.INACTIVE, LifecycleState.ACTIVE, LifecycleState.ERROR  # noqa: E741


class Asker(Component):
    """Runs `wish` once, in the hook of your choice, and notes when it had come back."""

    gain = Param(1.0)

    def __init__(self, name: str = "", hook: str = "on_execute") -> None:
        super().__init__(name)
        self.hook = hook
        self.wish: Callable[[], Awaitable[Any]] | None = None
        self.returned = False
        self.seen: list[float] = []
        self.ran: list[str] = []

    async def _ask(self, hook: str) -> None:
        self.ran.append(hook)
        if hook == self.hook and self.wish is not None:
            wish, self.wish = self.wish, None
            self.seen.append(self.gain)
            await wish()
            self.seen.append(self.gain)
            self.returned = True

    async def on_activated(self) -> None:
        await self._ask("on_activated")

    async def on_execute(self) -> None:
        await self._ask("on_execute")

    async def on_deactivated(self) -> None:
        await self._ask("on_deactivated")

    async def on_finalize(self) -> None:
        await self._ask("on_finalize")


WISHES: dict[str, tuple[Callable[[Any, Any, Any, Any], Awaitable[Any]], Callable[[Any, Any, Any, Any], bool]]] = {
    "deactivate itself": (lambda k, c, me, _: c.deactivate(me), lambda k, c, me, _: c.state(me) is I),
    "deactivate a neighbour": (lambda k, c, me, n: c.deactivate(n), lambda k, c, me, n: c.state(n) is I),
    "activate all": (lambda k, c, me, _: c.activate(), lambda k, c, me, _: c.state(me) is A),
    "remove itself from the context": (lambda k, c, me, _: c.remove(me), lambda k, c, me, _: me not in c.members),
    "remove a neighbour from the context": (lambda k, c, me, n: c.remove(n), lambda k, c, me, n: n not in c.members),
    "remove itself": (lambda k, c, me, _: k.remove(me), lambda k, c, me, _: me.name not in k.components),
    "remove a neighbour": (lambda k, c, me, n: k.remove(n), lambda k, c, me, n: n.name not in k.components),
    "stop the context": (lambda k, c, me, _: c.stop(), lambda k, c, me, _: not c.running),
    "stop the context by the kernel": (lambda k, c, me, _: k.stop(c), lambda k, c, me, _: not c.running),
    "configure itself": (lambda k, c, me, _: me.configure(gain=2.0), lambda k, c, me, _: me.gain == 2.0),
    "configure a neighbour": (lambda k, c, me, n: n.configure(gain=2.0), lambda k, c, me, n: n.gain == 2.0),
    "start a context of its own": (
        lambda k, c, me, _: k.start(EventContext(name="own"), me, activate=True),
        lambda k, c, me, _: k.contexts["own"].state(me) is A,
    ),
    "add a component": (lambda k, c, me, _: k.add(AsyncDiary("new")), lambda k, c, me, _: "new" in k.components),
    "close the kernel": (lambda k, c, me, _: k.aclose(), lambda k, c, me, _: not k.components and not k.contexts),
}


@pytest.mark.fault("A17")
@pytest.mark.row(34)
@pytest.mark.parametrize("shared", [False, True], ids=["one context", "two contexts"])
@pytest.mark.parametrize("hook", ["on_execute", "on_activated"])
@pytest.mark.parametrize("wish", WISHES)
def test_request_from_a_hook_is_queued_and_done_within_a_period(wish: str, hook: str, shared: bool) -> None:
    ask, fulfilled = WISHES[wish]

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            me, neighbour = await kernel.add(Asker("me", hook)), await kernel.add(Asker("neighbour"))
            context = await kernel.start(PeriodicContext(10.0, name="loop"), me, neighbour)
            if shared:
                other = await kernel.start(PeriodicContext(10.0, name="second"), me, neighbour)
            me.wish = lambda: ask(kernel, context, me, neighbour)
            try:
                await context.activate()
                if shared:
                    await other.activate()
            except (StateError, ClosedError):
                assert hook == "on_activated"
            await clock.advance(0.25)
            assert me.returned
            assert me.seen == [1.0, 1.0]
            assert fulfilled(kernel, context, me, neighbour)
            assert me.last_error is None

    simulate(main)


@pytest.mark.fault("A17")
@pytest.mark.parametrize("hook", ["on_deactivated", "on_finalize"])
def test_closing_the_kernel_again_on_the_way_out_is_no_deadlock(hook: str) -> None:
    async def main(clock: SimulatedClock) -> list[str]:
        kernel = await Kernel().open()
        me = await kernel.add(Asker("me", hook))
        await kernel.start(PeriodicContext(10.0), me, activate=True)
        me.wish = kernel.aclose
        await asyncio.wait_for(kernel.aclose(), 1.0)
        return me.ran

    assert simulate(main)[-2:] == ["on_deactivated", "on_finalize"]


@pytest.mark.fault("A17")
def test_finish_from_a_hook_takes_effect_after_the_cycle() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(AsyncDiary("source"))
            diary.plan["on_execute"] = diary.finish
            context = await kernel.start(PeriodicContext(10.0), diary, activate=True)
            await clock.advance(0.5)
            assert (context.state(diary), diary.count("on_execute"), diary.count("on_state_update")) == (I, 1, 1)

    simulate(main)


@pytest.mark.fault("A17")
def test_components_that_configure_each_other_across_contexts_are_not_stuck_for_ever() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            one, two = await kernel.add(Asker("one")), await kernel.add(Asker("two"))

            async def change(other: Asker) -> None:
                await asyncio.sleep(0.01)
                await other.configure(gain=2.0)

            one.wish, two.wish = lambda: change(two), lambda: change(one)
            for component in (one, two):
                await kernel.start(ExternalContext(name=f"of_{component.name}"), component, activate=True)
            contexts: Any = kernel.contexts
            await asyncio.gather(contexts["of_one"].tick(), contexts["of_two"].tick())
            assert clock.monotonic_ns() <= 5_100_000_000
            assert any("did not take effect within 5.0 s" in str(one.last_error) for one in (one, two))

    simulate(main)


def test_component_in_two_contexts_is_never_entered_twice_even_when_it_joins_the_second_in_mid_hook() -> None:
    class Slow(Component):
        inside = most = runs = 0

        async def on_execute(self) -> None:
            self.inside += 1
            self.most = max(self.most, self.inside)
            await asyncio.sleep(0.25)
            self.inside -= 1
            self.runs += 1

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            slow = await kernel.add(Slow("slow"))
            await kernel.start(PeriodicContext(10.0), slow, activate=True)
            second = await kernel.start(PeriodicContext(7.0))
            await clock.advance(0.1)
            await second.add(slow)
            await second.activate(slow)
            await clock.advance(3.0)
            assert (slow.most, slow.last_error) == (1, None)
            assert slow.runs >= 10
            await slow.configure()
        assert slow.inside == 0

    simulate(main)


# -- callers that are cancelled --------------------------------------------------------------------------------------


class SlowStarter(Component):
    """Suspends a few times in every hook of a start."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.open = 0

    async def _suspend(self) -> None:
        for _ in range(3):
            await asyncio.sleep(0.01)

    async def on_initialize(self) -> None:
        await self._suspend()

    async def on_startup(self) -> None:
        await self._suspend()
        self.open += 1

    async def on_activated(self) -> None:
        await self._suspend()
        self.open += 1

    async def on_deactivated(self) -> None:
        self.open -= 1

    async def on_shutdown(self) -> None:
        self.open -= 1


async def _cancelled_after(turns: int, what: Callable[[], Awaitable[Any]]) -> bool:
    """Whether `what` was still running after so many turns of the loop and was cancelled then."""

    async def run() -> None:
        await what()

    task = asyncio.create_task(run())
    for _ in range(turns):
        await asyncio.sleep(0.001)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return task.cancelled()


@pytest.mark.slow
@pytest.mark.parametrize("what", ["add", "start", "activate", "remove"])
def test_caller_cancelled_at_any_moment_leaves_a_whole_system_that_goes_on(what: str) -> None:
    async def main(clock: SimulatedClock) -> int:
        cancelled = 0
        for turns in range(0, 100, 3):
            async with Kernel() as kernel:
                component = SlowStarter("slow")
                context = ExternalContext(name="loop")
                if what != "add":
                    await kernel.add(component)
                if what in ("activate", "remove"):
                    await kernel.start(context, component)
                do: dict[str, tuple[Callable[..., Awaitable[Any]], Any]] = {
                    "add": (kernel.add, component),
                    "start": (partial(kernel.start, activate=True), context),
                    "activate": (context.activate, component),
                    "remove": (kernel.remove, component),
                }
                call, argument = do[what]
                more = (component,) if what == "start" else ()
                was = await _cancelled_after(turns, partial(call, argument, *more))
                cancelled += was
                await asyncio.sleep(1.0)
                if what == "add":
                    assert (not was) == ("slow" in kernel.components)
                if what == "start":
                    assert (not was) == bool(kernel.contexts)
                    assert (not was) == bool(component.contexts)
                    if was:
                        await kernel.start(ExternalContext(name="loop"), component, activate=True)
                        assert component.state is A
                if what == "activate" and component.state is I:
                    await context.activate(component)
                if what == "remove":
                    assert was or not kernel.components
                assert await kernel.add(AsyncDiary("other"))
            assert component.open == 0
        return cancelled

    assert simulate(main) >= (3 if what == "remove" else 10) - 2


def test_host_cancelled_in_the_body_closes_the_kernel_properly_however_often_it_is_cancelled() -> None:
    diary: Diary = PlainDiary("pid0")

    class Leisurely(Component):
        done = False

        async def on_deactivated(self) -> None:
            await asyncio.sleep(0.5)
            self.done = True

    async def main(clock: SimulatedClock) -> None:
        leisurely = Leisurely("slow")

        async def host() -> None:
            async with Kernel() as kernel:
                await kernel.add(diary)
                await kernel.start(PeriodicContext(10.0), diary, await kernel.add(leisurely), activate=True)
                await asyncio.Event().wait()

        task = asyncio.create_task(host())
        await clock.advance(0.3)
        for _ in range(4):
            task.cancel()
            await asyncio.sleep(0.1)
        await asyncio.gather(task, return_exceptions=True)
        assert task.cancelled()
        assert leisurely.done
        assert diary.ran[-3:] == ["on_deactivated", "on_shutdown", "on_finalize"]

    simulate(main)


@pytest.mark.slow(kept_by="test_host_cancelled_in_the_body_closes_the_kernel_properly_however_often_it_is_cancelled")
@pytest.mark.anyio
async def test_anyio_scope_that_is_cancelled_waits_for_the_close_without_a_busy_loop(anyio_backend: Any) -> None:
    import time

    import anyio

    class Leisurely(Component):
        async def on_deactivated(self) -> None:
            await asyncio.sleep(0.3)

    with anyio.move_on_after(0.05) as scope:
        async with Kernel() as kernel:
            await kernel.start(PeriodicContext(10.0), await kernel.add(Leisurely("slow")), activate=True)
            try:
                await anyio.sleep_forever()
            finally:
                used = time.process_time()
    assert scope.cancelled_caught
    assert time.process_time() - used <= 0.15


def test_kernel_that_closes_ends_an_on_initialize_that_does_not_return() -> None:
    class Endless(Component):
        async def on_initialize(self) -> None:
            await asyncio.Event().wait()

    async def main(clock: SimulatedClock) -> None:
        kernel = await Kernel().open()
        adding = asyncio.create_task(kernel.add(Endless("endless")))
        await clock.advance(0.1)
        with pytest.raises(StateError, match="while its on_initialize runs"):
            await kernel.remove(kernel.components["endless"])
        await kernel.aclose()
        with pytest.raises(ClosedError, match="the kernel closed before it returned"):
            await adding
        assert not kernel.components

    simulate(main)


def test_removed_twice_at_once_is_finalised_once() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(AsyncDiary("pid0"))
            await kernel.start(PeriodicContext(10.0), diary, activate=True)
            await asyncio.gather(kernel.remove(diary), kernel.remove(diary))
            assert diary.count("on_finalize") == 1
            with pytest.raises(StateError, match="does not belong to"):
                await kernel.remove(diary)

    simulate(main)


def test_failure_to_activate_reaches_who_started_and_leaves_the_context_running() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(AsyncDiary("pid0"))
            diary.plan["on_activated"] = lambda: 1 / 0
            with pytest.raises(ComponentError, match="on_activated raised ZeroDivisionError"):
                await kernel.start(PeriodicContext(10.0, name="loop"), diary, activate=True)
            assert kernel.contexts["loop"].running

    simulate(main)
