"""One life for each pair of component and context, added and removed while everything runs."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

import pytest

from aiorts import EventContext, ExternalContext, Kernel, PeriodicContext, SimulatedClock
from aiorts.errors import StateError
from aiorts.kernel.loop.bus import MemberAdded, MemberRemoved, StateChanged
from aiorts.model.lifecycle import LifecycleState
from aiorts.testing.simulation import simulate
from kernel_parts import AsyncDiary, PlainDiary, raising

I, A, E = LifecycleState.INACTIVE, LifecycleState.ACTIVE, LifecycleState.ERROR  # noqa: E741


@pytest.mark.row(10, 19)
def test_component_has_a_state_of_its_own_in_each_context() -> None:
    async def main(clock: SimulatedClock) -> None:
        changes: list[StateChanged] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(StateChanged, changes.append)
            diary = await kernel.add(AsyncDiary("pid0"))
            fast = await kernel.start(ExternalContext(name="fast"), diary)
            slow = await kernel.start(ExternalContext(name="slow"), diary)
            await fast.activate(diary)
            assert dict(diary.states) == {"fast": A, "slow": I}
            await slow.tick()
            assert diary.count("on_execute") == 0
            await slow.activate(diary)
            diary.plan["on_execute"] = raising(ValueError("x"))
            await fast.tick()
            diary.plan.clear()
            assert dict(diary.states) == {"fast": E, "slow": A}
            await slow.tick()
            assert (fast.state(diary), slow.state(diary), diary.contexts) == (E, A, (fast, slow))
            await fast.reset(diary)
            assert dict(diary.states) == {"fast": I, "slow": A}
            assert [(c.context, c.old, c.new) for c in changes] == [
                ("fast", I, A),
                ("slow", I, A),
                ("fast", A, E),
                ("fast", E, I),
            ]

    simulate(main)


@pytest.mark.row(92)
def test_members_leave_a_context_that_stops_in_the_reverse_of_the_order_in_which_they_came() -> None:
    async def main(clock: SimulatedClock) -> None:
        ran: list[tuple[str, str]] = []
        async with Kernel() as kernel:
            members = [await kernel.add(PlainDiary(name)) for name in ("one", "two", "three")]
            context = await kernel.start(PeriodicContext(10.0), *members, activate=True)
            for member in members:
                for hook in ("on_deactivated", "on_shutdown"):
                    member.plan[hook] = partial(ran.append, (member.name, hook))
            await context.stop()
        assert ran == [(name, hook) for name in ("three", "two", "one") for hook in ("on_deactivated", "on_shutdown")]

    simulate(main)


@pytest.mark.row(19)
def test_components_join_and_leave_a_running_context_in_order() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard: list[Any] = []
        async with Kernel() as kernel:
            for kind in (MemberAdded, MemberRemoved):
                kernel.bus.subscribe(kind, heard.append)
            one, two, three = [await kernel.add(PlainDiary(name)) for name in ("one", "two", "three")]
            context = await kernel.start(PeriodicContext(10.0, name="loop"), one, activate=True)
            await context.add(two, three)
            assert context.members == (one, two, three)
            assert two.ran[-1] == "on_startup"
            await context.activate()
            await clock.advance(0.25)
            await context.remove(two)
            assert context.members == (one, three)
            assert two.ran[-2:] == ["on_deactivated", "on_shutdown"]
            assert (two.contexts, two.state) == ((), None)
            with pytest.raises(StateError, match="two: is not in loop"):
                await context.activate(two)
            with pytest.raises(StateError, match="three: is in loop already"):
                await context.add(three)
            second = await kernel.start(EventContext(), two, activate=True)
            assert second.state(two) is A
            assert heard == [MemberAdded("loop", "two"), MemberAdded("loop", "three"), MemberRemoved("loop", "two")]

    simulate(main)


@pytest.mark.row(10)
@pytest.mark.parametrize(
    ("state", "request_", "why"),
    [
        (I, "deactivate", "it is inactive already"),
        (I, "reset", "only a component in error is reset"),
        (A, "activate", "it is active already"),
        (A, "reset", "deactivate it instead"),
        (E, "activate", "reset it first"),
        (E, "deactivate", "reset it instead"),
    ],
)
def test_request_that_does_not_fit_the_state_is_refused_with_advice(state: str, request_: str, why: str) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(PlainDiary("pid0"))
            context = await kernel.start(ExternalContext(name="loop"), diary, activate=state != I)
            if state == E:
                diary.plan["on_execute"] = raising(ValueError("x"))
                await context.tick()
            ran = list(diary.ran)
            with pytest.raises(StateError, match=rf"pid0 in loop: cannot {request_} from {state}: .*{why}"):
                await getattr(context, request_)(diary)
            assert (context.state(diary), diary.ran) == (state, ran)

    simulate(main)


@pytest.mark.slow
@pytest.mark.row(5)
@pytest.mark.anyio
async def test_components_are_coroutines_that_wait_without_holding_anybody_up(anyio_backend: Any) -> None:
    class Waiting(AsyncDiary):  # type: ignore[misc, valid-type]
        async def on_execute(self) -> None:
            self.note("on_execute")
            await asyncio.sleep(0.05)

    async with Kernel() as kernel:
        waiting, quick = await kernel.add(Waiting("waiting")), await kernel.add(PlainDiary("quick"))
        await kernel.start(PeriodicContext(1000.0), waiting, activate=True)
        await kernel.start(PeriodicContext(200.0), quick, activate=True)
        await asyncio.sleep(0.3)
        assert waiting.count("on_execute") <= 7
        assert quick.count("on_execute") >= 20  # 60 on an idle machine, 7 if it were held up
