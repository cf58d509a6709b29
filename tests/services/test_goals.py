"""Goals: accepted or refused by a call, advanced by the provider, awaited by the client, ended once; all counted."""

from __future__ import annotations

import asyncio
import gc
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

import pytest

from aiorts import Component, EventContext, Goal, Kernel, PeriodicContext, Provided, Required, Supervision
from aiorts.errors import (
    BusyError,
    ConfigurationError,
    DeclarationError,
    GoalCancelled,
    GoalFailed,
    InterfaceMismatch,
    ServiceFailed,
    ServiceTimeout,
    ServiceUnavailable,
    StateError,
)
from aiorts.events import GoalAccepted, GoalEnded
from aiorts.model.service_profile import GoalStatistics
from aiorts.testing import simulated
from services.goal_parts import Car, Driver, Driving, pair

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable


async def read(goal: Goal[float, str]) -> list[float]:
    return [feedback async for feedback in goal]


def counts(end: Any) -> GoalStatistics:
    goals: GoalStatistics | None = end.statistics.goals
    assert goals is not None
    assert goals.balanced, goals
    return goals


@simulated
async def test_a_goal_gives_feedback_and_then_its_result() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(10)
        assert goal.state == "running"
        reading = asyncio.create_task(read(goal))
        waiting = asyncio.create_task(goal.result())
        for metres in (2, 5.0, 9.5):
            await kernel.sleep(1.0)
            assert car.goals[0].feedback(metres)
        assert car.goals[0].succeed("home")
        assert await reading == [2, 5.0, 9.5]
        assert await waiting == "home"
        assert await goal.result() == "home"
        assert goal.state == "succeeded"
        for end in (driver.car, car.service, *kernel.service_connectors.values()):
            assert counts(end) == GoalStatistics(offered=1, accepted=1, succeeded=1, feedback=3)


@simulated
async def test_raising_refuses_as_in_any_call() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        with pytest.raises(ServiceFailed, match="ValueError: too far"):
            await driver.car.proxy.drive(101)
        assert car.goals == []
        assert counts(car.service) == GoalStatistics(offered=1, refused=1)
        lonely = await kernel.add(Driver("lonely"))
        with pytest.raises(ServiceUnavailable):
            await lonely.car.proxy.drive(1)
        assert counts(lonely.car) == GoalStatistics(offered=1, refused=1)


@simulated
async def test_what_failed_says_why() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goals = [await driver.car.proxy.drive(1) for _ in range(2)]
        assert car.goals[0].fail(OSError("no fuel"))
        assert car.goals[1].fail("flat tyre")
        with pytest.raises(
            GoalFailed, match=r"^driver\.car -> car\.service\.drive: failed: OSError: no fuel"
        ) as caught:
            await goals[0].result()
        assert isinstance(caught.value.__cause__, OSError)
        assert caught.value.reason == "provider"
        wrong: Any = car.goals[1]
        with pytest.raises(TypeError, match=r"fail\(None\): expected an exception or a text"):
            wrong.fail(None)
        with pytest.raises(GoalFailed, match="failed: flat tyre"):
            await goals[1].result()
        assert counts(driver.car).failed == {"provider": 2}


@simulated
async def test_a_goal_is_cancelled_in_the_middle() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(10)
        with pytest.raises(StateError, match="its client did not ask to cancel it"):
            car.goals[0].cancelled()
        assert not car.goals[0].cancel_requested
        goal.cancel()
        goal.cancel()
        assert car.goals[0].cancel_requested
        await kernel.sleep(1.0)
        assert goal.state == "running"
        assert car.goals[0].cancelled()
        with pytest.raises(GoalCancelled, match="its client cancelled it"):
            await goal.result()
        assert await read(goal) == []
        goal.cancel()
        assert counts(driver.car) == GoalStatistics(offered=1, accepted=1, cancelled=1)


@simulated
async def test_one_that_was_asked_to_cancel_may_still_succeed() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(10)
        goal.cancel()
        assert car.goals[0].succeed("arrived")
        assert await goal.result() == "arrived"


@simulated
async def test_a_provider_that_does_not_cancel_in_time_has_failed_and_is_not_hurt() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(10)
        goal.cancel()
        begun = kernel.clock.time()
        with pytest.raises(GoalFailed, match=r"\(its client cancelled it\) and did not end within 2.0 s") as caught:
            await goal.result()
        assert caught.value.reason == "cancel_timeout"
        assert kernel.clock.time() == begun + 2.0
        mine = car.goals[0]
        assert [mine.feedback(1.0), mine.succeed("late"), mine.cancelled(), mine.fail("late")] == [False] * 4
        assert goal.state == "failed"
        assert counts(driver.car).failed == {"cancel_timeout": 1}


@simulated
async def test_the_first_end_wins_and_a_second_of_the_provider_is_its_error() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(10)
        goal.cancel()
        mine = car.goals[0]
        assert mine.succeed("home")
        for again in (lambda: mine.succeed("again"), lambda: mine.fail("no"), mine.cancelled, lambda: mine.feedback(1)):
            with pytest.raises(StateError, match="its provider has ended it, it is succeeded"):
                again()
        assert await goal.result() == "home"
        await kernel.sleep(5.0)
        assert counts(driver.car) == GoalStatistics(offered=1, accepted=1, succeeded=1)


@simulated
async def test_a_slow_client_has_the_newest_eight() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(10)
        for metres in range(20):
            car.goals[0].feedback(metres)
        car.goals[0].succeed("home")
        assert await read(goal) == list(range(12, 20))
        assert counts(car.service) == GoalStatistics(offered=1, accepted=1, succeeded=1, feedback=20, dropped=12)


# -- clients that give up ----------------------------------------------------------------------------------------------


@simulated
async def test_a_client_that_waited_long_enough_asks_to_cancel() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(10)
        with pytest.raises(ServiceTimeout, match=r"did not end within 3 s; it was asked to cancel"):
            await goal.result(timeout=3)
        assert car.goals[0].cancel_requested
        assert goal.state == "running"
        with pytest.raises(GoalFailed, match=r"its client waited for 3 s"):
            await goal.result()
        with pytest.raises(ConfigurationError, match="timeout = -1: expected seconds from 0 on, or None"):
            await goal.result(timeout=-1)


async def _result(goal: Goal[float, str]) -> None:
    await goal.result()


async def _feedback(goal: Goal[float, str]) -> None:
    async for _ in goal:
        pass


async def _elsewhere(_: Goal[float, str]) -> None:
    await asyncio.Event().wait()


@pytest.mark.parametrize("wait", [_result, _feedback, _elsewhere])
@simulated
async def test_a_client_whose_task_is_cancelled_asks_to_cancel(wait: Callable[[Any], Awaitable[None]]) -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)

        async def ask() -> None:
            await wait(await driver.car.proxy.drive(10))

        task = asyncio.create_task(ask())
        await kernel.sleep(1.0)
        task.cancel()
        await asyncio.wait([task])
        await kernel.sleep(0.0)
        assert task.cancelled()
        assert car.goals[0].cancel_requested
        assert car.goals[0].cancelled()
        assert counts(driver.car) == GoalStatistics(offered=1, accepted=1, cancelled=1)


@pytest.mark.fault("G05")
@pytest.mark.parametrize("wait", [_result, _feedback])
@simulated
async def test_a_client_that_is_cancelled_while_the_goal_ends_leaves_nothing(
    wait: Callable[[Any], Awaitable[None]],
) -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        for turns in range(5):
            goal = await driver.car.proxy.drive(10)
            waiting = asyncio.ensure_future(wait(goal))
            await kernel.sleep(0.1)
            car.goals[-1].feedback(1.0)
            car.goals[-1].succeed("home")
            for _ in range(turns):
                await asyncio.sleep(0)
            waiting.cancel()
            await asyncio.wait([waiting])
            assert not goal.cancel_requested
            assert await goal.result() == "home"
            assert await read(goal) in ([], [1.0])
        assert counts(driver.car) == GoalStatistics(offered=5, accepted=5, succeeded=5, feedback=5)


@simulated
async def test_a_task_that_ends_in_order_leaves_its_goal_running() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await asyncio.create_task(driver.car.proxy.drive(10))  # type: ignore[arg-type] # a coroutine
        await kernel.sleep(1.0)
        assert not car.goals[0].cancel_requested
        car.goals[0].succeed("home")
        assert await goal.result() == "home"


async def _deactivated(kernel: Kernel, driver: Driver, _: Car) -> None:
    await kernel.contexts["clients"].deactivate(driver)


async def _in_error(kernel: Kernel, driver: Driver, _: Car) -> None:
    kernel.registry.task_failed(driver, "x", ValueError("broken"))
    await kernel.sleep(0.2)


async def _removed(kernel: Kernel, driver: Driver, _: Car) -> None:
    await kernel.remove(driver)


async def _disconnected(kernel: Kernel, driver: Driver, _: Car) -> None:
    await kernel.disconnect(driver.car.connectors[0])


async def _stopped(kernel: Kernel, _: Driver, __: Car) -> None:
    await kernel.stop(kernel.contexts["clients"])


@pytest.mark.parametrize("gone", [_deactivated, _in_error, _removed, _disconnected, _stopped])
@simulated
async def test_a_client_that_goes_asks_to_cancel(gone: Callable[[Kernel, Driver, Car], Awaitable[None]]) -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        await kernel.start(PeriodicContext(10.0, name="clients"), driver, activate=True)
        await kernel.start(PeriodicContext(10.0, name="cars"), car, activate=True)
        goal, other = [await driver.car.proxy.drive(10) for _ in range(2)]
        await gone(kernel, driver, car)
        assert goal.state == "running"
        assert [one.cancel_requested for one in car.goals] == [True, True]
        assert car.goals[0].cancelled()
        with pytest.raises(GoalCancelled):
            await goal.result()
        with pytest.raises(GoalFailed, match="was asked to cancel") as caught:
            await other.result()
        assert caught.value.reason == "cancel_timeout"
        assert counts(car.service) == GoalStatistics(offered=2, accepted=2, cancelled=1, failed={"cancel_timeout": 1})


@simulated
async def test_a_hook_that_waits_for_a_provider_that_it_holds_up_is_told_so() -> None:
    class Waiting(Driver):
        said = ""

        async def on_execute(self) -> None:
            goal = await self.car.proxy.drive(1)
            with suppress(GoalFailed):
                try:
                    await goal.result(timeout=1.0)
                except ServiceTimeout as error:
                    self.said = str(error)
                    await goal.result()

    async with Kernel() as kernel:
        driver, car = await kernel.add(Waiting()), await kernel.add(Car())
        await kernel.connect(driver.car, car.service)
        await kernel.start(PeriodicContext(0.1, name="both"), driver, car, activate=True)
        await kernel.sleep(5.0)
        assert driver.said.endswith("; car does not run while a hook in both waits: wait elsewhere")


# -- providers that go -------------------------------------------------------------------------------------------------


async def _car_deactivated(kernel: Kernel, car: Car) -> None:
    await kernel.contexts["cars"].deactivate(car)


async def _car_in_error(kernel: Kernel, car: Car) -> None:
    kernel.registry.task_failed(car, "x", ValueError("broken"))
    await kernel.sleep(0.2)


async def _car_removed(kernel: Kernel, car: Car) -> None:
    await kernel.remove(car)


async def _car_stopped(kernel: Kernel, _: Car) -> None:
    await kernel.stop(kernel.contexts["cars"])


async def _closed(kernel: Kernel, _: Car) -> None:
    await kernel.aclose()


@pytest.mark.parametrize(
    ("gone", "reason", "text"),
    [
        (_car_deactivated, "deactivated", "car went to inactive in cars"),
        (_car_in_error, "error", "car went to error in cars"),
        (_car_removed, "removed", "car: it is being removed"),
        (_car_stopped, "deactivated", "car went to inactive in cars"),
        (_closed, "closed", "car: its kernel closes"),
    ],
)
@simulated
async def test_a_provider_that_goes_has_failed(
    gone: Callable[[Kernel, Car], Awaitable[None]], reason: str, text: str
) -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        await kernel.start(PeriodicContext(10.0, name="cars"), car, activate=True)
        goal = await driver.car.proxy.drive(10)
        waiting = asyncio.create_task(goal.result())
        reading = asyncio.create_task(read(goal))
        await kernel.sleep(0.1)
        await gone(kernel, car)
        await asyncio.wait([waiting, reading], timeout=1.0)
        error = waiting.exception()
        assert isinstance(error, GoalFailed)
        assert (error.reason, reading.result()) == (reason, [])
        assert text in str(error)
        mine = car.goals[0]
        assert mine.cancel_requested
        assert [mine.feedback(1.0), mine.succeed("late"), mine.cancelled()] == [False] * 3
        assert counts(car.service) == GoalStatistics(offered=1, accepted=1, failed={reason: 1})


class Always(Car):
    service = Provided[Driving](always=True)


@simulated
async def test_one_that_is_always_there_keeps_its_goals_until_it_fails() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel, Always())
        context = await kernel.start(PeriodicContext(10.0), car, activate=True)
        goal = await driver.car.proxy.drive(10)
        other = await driver.car.proxy.drive(10)
        await context.deactivate(car)
        assert goal.state == "running"
        car.goals[0].succeed("home")
        assert await goal.result() == "home"
        await context.activate(car)
        kernel.registry.task_failed(car, "x", ValueError("broken"))
        with pytest.raises(GoalFailed, match="car went to error"):
            await other.result()


@pytest.mark.parametrize("inside", [True, False], ids=["in a context", "in none"])
@simulated
async def test_a_task_of_the_provider_works_on_a_goal_and_its_failure_is_the_goals(inside: bool) -> None:
    class Working(Car):
        def drive(self, metres: int) -> Goal[float, str]:
            goal = super().drive(metres)
            self.task = asyncio.create_task(self._work(goal, metres))
            return goal

        async def _work(self, goal: Goal[float, str], metres: int) -> None:
            for driven in range(metres):
                await self.sleep(1.0)
                if goal.cancel_requested:
                    goal.cancelled()
                    return
                goal.feedback(driven)
                if driven == 3:
                    raise OSError("no fuel")
            goal.succeed("home")

    async with Kernel() as kernel:
        driver, car = await pair(kernel, Working())
        if inside:
            await kernel.start(PeriodicContext(10.0), car, activate=True)
        goal = await driver.car.proxy.drive(2)
        assert await read(goal) == [0, 1]
        assert await goal.result() == "home"
        goal = await driver.car.proxy.drive(2)
        goal.cancel()
        with pytest.raises(GoalCancelled):
            await goal.result()
        goal = await driver.car.proxy.drive(9)
        with pytest.raises(GoalFailed) as caught:
            await goal.result()
        assert (caught.value.reason, repr(caught.value.__cause__)) == ("error", "OSError('no fuel')")
        assert kernel.clock.time() == pytest.approx(7.5, abs=0.2)  # half a second later, as any task that failed


@simulated
async def test_a_provider_that_supervision_helps_has_lost_its_goals_and_takes_others() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        kernel.supervise(car, Supervision("restart", backoff=0.5))
        await kernel.start(PeriodicContext(10.0), car, activate=True)
        goal = await driver.car.proxy.drive(10)
        kernel.registry.task_failed(car, "x", ValueError("broken"))
        with pytest.raises(GoalFailed) as caught:
            await goal.result()
        assert (caught.value.reason, str(caught.value.__cause__)) == ("error", "broken")
        await kernel.sleep(2.0)
        assert kernel.components["car"] is not car
        again = await driver.car.proxy.drive(10)
        assert again.state == "running"
        new: Any = kernel.components["car"]
        new.goals[0].succeed("home")
        assert await again.result() == "home"


@simulated
async def test_a_service_port_that_is_removed_disconnects_its_goals() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(10)
        car.remove_port("service")
        assert car.goals[0].cancel_requested
        with pytest.raises(GoalFailed, match="it was disconnected"):
            await goal.result()


@simulated
async def test_goals_that_have_ended_leave_nothing_behind() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        for number in range(20):
            goal = await driver.car.proxy.drive(10)
            if number % 2:
                goal.cancel()
            car.goals.pop().succeed("home")
            assert await goal.result(timeout=1.0) == "home"
        del goal
        await kernel.sleep(10.0)
        gc.collect()
        assert [one for one in gc.get_objects() if type(one) is Goal] == []


# -- hooks -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("inside", [True, False], ids=["in a context", "in none"])
@simulated
async def test_a_task_of_a_served_method_that_fails_is_found_while_the_caller_goes_on(inside: bool) -> None:
    class Failing(Car):
        def drive(self, metres: int) -> Goal[float, str]:
            self.task = asyncio.create_task(self._fail())
            return super().drive(metres)

        async def _fail(self) -> None:
            raise OSError("no fuel")

    class Waiting(Driver):
        reason = ""

        async def on_execute(self) -> None:
            try:
                await (await self.car.proxy.drive(1)).result(timeout=10.0)
            except GoalFailed as error:
                self.reason = error.reason

    async with Kernel() as kernel:
        driver, car = await kernel.add(Waiting()), await kernel.add(Failing())
        await kernel.connect(driver.car, car.service)
        if inside:
            await kernel.start(PeriodicContext(10.0), car, activate=True)
        await kernel.start(PeriodicContext(0.01), driver, activate=True)
        await kernel.sleep(5.0)
        assert driver.reason == "error"


@simulated
async def test_an_event_context_executes_a_provider_that_has_a_goal_to_begin_or_to_cancel() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        await kernel.start(EventContext(), car, activate=True)
        await kernel.sleep(1.0)
        assert car.executed == 0
        goal = await driver.car.proxy.drive(10)
        await kernel.sleep(1.0)
        assert car.executed == 1
        goal.cancel()
        await kernel.sleep(1.0)
        assert car.executed == 2
        await kernel.sleep(1.5)
        assert (goal.state, car.executed) == ("failed", 3)


@simulated
async def test_what_the_provider_does_before_it_returns_the_goal_counts() -> None:
    class Quick(Car):
        def drive(self, metres: int) -> Goal[float, str]:
            goal = super().drive(metres)
            assert goal.state == "offered"
            goal.feedback(float(metres))
            goal.succeed("there already")
            return goal

    async with Kernel() as kernel:
        driver, car = await pair(kernel, Quick())
        goal = await driver.car.proxy.drive(3)
        assert goal.state == "succeeded"
        assert await read(goal) == [3.0]
        assert await goal.result() == "there already"
        assert counts(car.service) == GoalStatistics(offered=1, accepted=1, succeeded=1, feedback=1)


# -- wrong uses --------------------------------------------------------------------------------------------------------


@simulated
async def test_values_of_wrong_types_are_the_providers_error() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(3)
        wrong: Any = car.goals[0]
        where = r"^driver\.car -> car\.service\.drive: "
        with pytest.raises(InterfaceMismatch, match=where + "feedback = str 'far', the interface says float"):
            wrong.feedback("far")
        with pytest.raises(InterfaceMismatch, match=where + "result = int 7, the interface says str"):
            wrong.succeed(7)
        assert goal.state == "running"
        assert wrong.succeed("home")
        assert counts(car.service).feedback == 0


@pytest.mark.parametrize("what", ["feedback", "succeed"])
@simulated
async def test_values_of_wrong_types_before_it_was_accepted_fail_it(what: str) -> None:
    class Quick(Car):
        def drive(self, metres: int) -> Goal[float, str]:
            goal: Any = super().drive(metres)
            getattr(goal, what)(None)
            return goal  # type: ignore[no-any-return]

    async with Kernel() as kernel:
        driver, car = await pair(kernel, Quick())
        goal = await driver.car.proxy.drive(3)
        with pytest.raises(GoalFailed, match=r"= NoneType None, the interface says (float|str)") as caught:
            await goal.result()
        assert caught.value.reason == "mismatch"
        assert counts(car.service).failed == {"mismatch": 1}


@simulated
async def test_a_goal_is_returned_once() -> None:
    class Again(Car):
        def drive(self, metres: int) -> Goal[float, str]:
            return self.goals[0] if self.goals else super().drive(metres)

    async with Kernel() as kernel:
        driver, car = await pair(kernel, Again())
        goal = await driver.car.proxy.drive(3)
        with pytest.raises(InterfaceMismatch, match="a goal that it has returned before; make a Goal"):
            await driver.car.proxy.drive(3)
        assert goal.state == "running"
        assert counts(car.service) == GoalStatistics(offered=2, refused=1, accepted=1, running=1)


@simulated
async def test_no_goal_is_an_answer_of_a_wrong_type() -> None:
    class Wrong(Car):
        def drive(self, metres: int) -> Any:
            return None

    async with Kernel() as kernel:
        driver, car = await pair(kernel, Wrong())
        with pytest.raises(InterfaceMismatch, match=r"answered with NoneType None, driver.car takes Goal\[float"):
            await driver.car.proxy.drive(3)
        assert counts(car.service) == GoalStatistics(offered=1, refused=1)


@simulated
async def test_a_goal_that_was_not_accepted_cannot_be_waited_for() -> None:
    goal: Goal[float, str] = Goal()
    assert goal.state == "offered"
    for wait in (goal.result(), anext(goal)):
        with pytest.raises(StateError, match="cannot be waited for before it is accepted: the method has to return it"):
            await wait
    with pytest.raises(StateError, match="cannot be cancelled before it is accepted"):
        goal.cancel()


@simulated
async def test_one_task_reads_the_feedback() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        goal = await driver.car.proxy.drive(3)
        first = asyncio.create_task(read(goal))
        await kernel.sleep(0.0)
        with pytest.raises(BusyError, match="another task waits for its feedback; one task reads it"):
            await read(goal)
        car.goals[0].succeed("home")
        assert await first == []


def test_a_time_to_cancel_is_above_nothing() -> None:
    with pytest.raises(DeclarationError, match=r"Provided\[Driving\]: cancel_timeout = 0: expected seconds above 0"):
        Provided[Driving](cancel_timeout=0)


def test_a_goal_of_types_that_cannot_be_known_is_refused_at_once() -> None:
    class Unknown(Protocol):
        async def drive(self) -> Goal[Nowhere, str]: ...  # type: ignore[name-defined] # noqa: F821 - on purpose

    class Maybe(Protocol):
        async def drive(self) -> Goal[float, str] | None: ...

    with pytest.raises(DeclarationError, match=r"drive: returns 'Goal\[Nowhere, str\]', which cannot be resolved"):
        Required[Unknown]()
    with pytest.raises(DeclarationError, match=r"drive: returns .*; annotate `-> Goal\[Feedback, Result\]` alone"):
        Provided[Maybe]()


def test_interfaces_with_other_goals_do_not_fit() -> None:
    class Other(Protocol):
        async def drive(self, metres: int) -> Goal[str, str]: ...

    with pytest.raises(DeclarationError, match=r"drive returns Goal\[float, str\], not Goal\[str, str\]"):

        class Wrong(Car):
            other = Provided[Other]()


# -- calls that end at the same time -----------------------------------------------------------------------------------


@pytest.mark.parametrize("turns", range(1, 12))
@simulated
async def test_a_goal_whose_client_was_cancelled_while_it_was_accepted_is_not_left_running(turns: int) -> None:
    class Slow(Component):
        service = Provided[Driving]()

        def __init__(self) -> None:
            super().__init__("car")
            self.goals: list[Goal[float, str]] = []

        async def drive(self, metres: int) -> Goal[float, str]:
            await asyncio.sleep(0)
            self.goals.append(Goal())
            with suppress(asyncio.CancelledError):
                await asyncio.sleep(0)
            return self.goals[-1]

    async with Kernel() as kernel:
        driver, car = await pair(kernel, Slow())
        task = asyncio.create_task(driver.car.proxy.drive(3))  # type: ignore[arg-type] # a coroutine
        for _ in range(turns):
            await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait([task])
        await kernel.sleep(0.5)
        gone = [goal for goal in car.goals if not goal.cancel_requested]
        assert len(gone) == (not task.cancelled())
        goals = counts(driver.car)
        assert (goals.accepted, goals.refused) == ((1, 0) if not task.cancelled() else (0, 1))


# -- what is told ------------------------------------------------------------------------------------------------------


@simulated
async def test_the_bus_and_the_profile_tell_of_goals() -> None:
    heard: list[Any] = []
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        kernel.bus.subscribe(GoalAccepted, heard.append)
        kernel.bus.subscribe(GoalEnded, heard.append)
        goal = await driver.car.proxy.drive(3)
        await kernel.sleep(1.5)
        report = kernel.profile().to_plain()["components"]["car"]["calls"]["service"]["goals"]
        assert (report["accepted"], report["running"]) == (1, 1)
        car.goals[0].fail("flat tyre")
        between = "driver.car", "car.service", "drive"
        assert heard == [
            GoalAccepted(*between),
            GoalEnded(*between, "failed", "provider", 1_500_000_000),
        ]
        (connector,) = kernel.profile().service_connectors.values()
        assert connector.bindings[0].statistics.goals == GoalStatistics(offered=1, accepted=1, failed={"provider": 1})
        assert "Goal[float, str]" in str(driver.car.profile.methods[0])
        assert repr(goal) == "<Goal driver.car -> car.service.drive failed>"


@simulated
async def test_counts_of_a_connection_that_has_ended_stay_at_both_ends() -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel)
        await driver.car.proxy.drive(3)
        await kernel.disconnect(driver.car.connectors[0])
        car.goals[0].feedback(1.0)
        assert counts(driver.car).running == 1
        await kernel.connect(driver.car, car.service)
        car.goals[0].cancelled()
        await driver.car.proxy.drive(3)
        for end in (driver.car, car.service):
            assert counts(end) == GoalStatistics(offered=2, accepted=2, cancelled=1, running=1, feedback=1)


def test_an_interface_without_goals_counts_none() -> None:
    class Plain(Protocol):
        def count(self) -> int: ...

    class Needs(Component):
        plain = Required[Plain]()

    assert Needs("needs").plain.statistics.goals is None
