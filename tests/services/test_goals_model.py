"""Goals against a small model: random offers, feedback, ends, cancellations, time-outs and components that go.

Every step takes 1/64 s of virtual time, and each kind of timer ends at another fraction of a second, so that the model
knows what comes first; what is ready at one instant runs in a shuffled order.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import ExternalContext, Kernel, Provided
from aiorts.errors import GoalCancelled, GoalFailed, InterfaceMismatch, ServiceError, ServiceTimeout, StateError
from aiorts.events import GoalAccepted, GoalEnded
from aiorts.model.service_profile import GoalStatistics
from aiorts.testing.simulation import simulate
from campaign import CAMPAIGN, LENGTH, cases, time_limit
from services.goal_parts import Car, Driver, Driving

if TYPE_CHECKING:
    from aiorts import Goal

STEP = 1 / 64
CANCEL = 2 + 1 / 128
PATIENCE = 1 + 1 / 256
KEPT = 8


@dataclass(eq=False)
class Wait:
    """A client's wait: for a result (with or without patience), or for feedback."""

    task: asyncio.Task[Any]
    deadline: float | None = None
    expected: str = ""
    reads: bool = False
    read: list[float] = field(default_factory=list)
    """What it is to have read."""
    got: list[float] = field(default_factory=list)


@dataclass(eq=False)
class Model:
    """What a goal is to be."""

    goal: Goal[float, str]
    driver: int
    state: str = "running"
    reason: str = ""
    own: bool = False
    requested: bool = False
    deadline: float | None = None
    kept: list[float] = field(default_factory=list)
    given: int = 0
    dropped: int = 0
    waits: list[Wait] = field(default_factory=list)

    def request(self, now: float) -> None:
        if self.state == "running" and not self.requested:
            self.requested = True
            self.deadline = now + CANCEL

    def end(self, state: str, reason: str = "", *, own: bool = False) -> bool:
        if self.state != "running":
            return False
        self.state, self.reason, self.own, self.deadline = state, reason, own, None
        self.requested = self.requested or not own
        for wait in self.waits:
            if not wait.expected:
                wait.expected = "stop" if wait.reads else state
        return True

    def feed(self, values: list[float]) -> None:
        self.given += len(values)
        every = self.kept + values
        self.dropped += max(0, len(every) - KEPT)
        self.kept = every[-KEPT:]
        self.read()

    def read(self) -> None:
        for wait in self.waits:
            if wait.reads and not wait.expected:
                wait.read += self.kept
                self.kept = []


class Play:
    """One kernel and the model of it."""

    def __init__(self, kernel: Kernel) -> None:
        self.kernel = kernel
        self.models: list[Model] = []
        self.refused: list[Counter[str]] = [Counter(), Counter()]
        self.car: Any = None
        self.drivers: list[Driver] = []
        self.state = "active"
        self.on = [True, True]
        self.gone: list[Driver] = []
        self.events: Counter[str] = Counter()

    async def build(self) -> None:
        class Timed(Car):
            service = Provided[Driving](cancel_timeout=CANCEL)

        kernel = self.kernel
        self.car = await kernel.add(Timed())
        self.drivers = [await kernel.add(Driver(f"driver{number}")) for number in range(2)]
        for driver in self.drivers:
            await kernel.connect(driver.car, self.car.service)
        self.cars = await kernel.start(ExternalContext(), self.car, activate=True)
        self.clients = await kernel.start(ExternalContext(), *self.drivers, activate=True)
        for kind in (GoalAccepted, GoalEnded):
            kernel.bus.subscribe(kind, lambda event: self.events.update([type(event).__name__]))

    @property
    def now(self) -> float:
        return self.kernel.clock.time()

    async def run(self, op: str, which: int, amount: int) -> None:
        if self.models or op in ("offer", "sleep", "car", "error", "driver", "link", "remove"):
            model = self.models[which % len(self.models)] if self.models else None
            await getattr(self, f"_{op}")(model, which, amount)
        await self.sleep(STEP)
        self.compare()

    async def sleep(self, seconds: float) -> None:
        end = self.now + seconds
        await self.kernel.sleep(seconds)
        while True:
            due = [(model.deadline, model, None) for model in self.models if model.deadline is not None]
            due += [
                (wait.deadline, model, wait)
                for model in self.models
                for wait in model.waits
                if wait.deadline is not None and not wait.expected
            ]
            due = [one for one in due if one[0] is not None and one[0] <= end]
            if not due:
                return
            at, model, wait = min(due, key=lambda one: one[0] or 0.0)
            if wait is None:
                model.end("failed", "cancel_timeout")
            else:
                wait.expected = "timeout"
                model.request(at or 0.0)

    def compare(self) -> None:
        for model in self.models:
            assert model.goal.state == model.state
            assert model.goal.cancel_requested == model.requested
            for wait in model.waits:
                assert wait.task.done() == bool(wait.expected)
                assert wait.got == wait.read
        for number, driver in enumerate(self.drivers):
            self.compare_counts(driver.car.statistics.goals, [number])
        self.compare_counts(self.car.service.statistics.goals, [0, 1])

    def compare_counts(self, counts: GoalStatistics | None, drivers: list[int]) -> None:
        mine = [model for model in self.models if model.driver in drivers]
        refused = sum(self.refused[number]["there"] for number in drivers)
        if len(drivers) == 1:
            refused += self.refused[drivers[0]]["unbound"]
        states = Counter(model.state for model in mine)
        assert counts == GoalStatistics(
            offered=len(mine) + refused,
            refused=refused,
            accepted=len(mine),
            succeeded=states["succeeded"],
            failed=Counter(model.reason for model in mine if model.state == "failed"),
            cancelled=states["cancelled"],
            running=states["running"],
            feedback=sum(model.given for model in mine),
            dropped=sum(model.dropped for model in mine),
        )
        assert counts.balanced

    # -- what can be done ------------------------------------------------------------------------------------------

    async def _offer(self, _: Model | None, which: int, amount: int) -> None:
        number = which % 2
        driver = self.drivers[number]
        bound = driver.car.is_bound
        good = bound and self.state == "active" and amount < 12
        try:
            goal = await driver.car.proxy.drive(1 if amount < 12 else 1000)
        except ServiceError:
            assert not good
            self.refused[number]["there" if bound else "unbound"] += 1
        else:
            assert good
            self.models.append(Model(goal, number))

    async def _sleep(self, _: Model | None, __: int, amount: int) -> None:
        await self.sleep(amount / 4)

    async def _feedback(self, model: Model, _: int, amount: int) -> None:
        values = [float(number) for number in range(amount)]
        for value in values:
            self._done(model, lambda value=value: model.goal.feedback(value), running=True)
        if model.state == "running":
            model.feed(values)

    async def _wrong(self, model: Model, _: int, amount: int) -> None:
        goal: Any = model.goal
        act = goal.succeed if amount % 2 else goal.feedback
        if model.state == "running" or model.own:
            with pytest.raises(InterfaceMismatch if model.state == "running" else StateError):
                act(None)
        else:
            assert not act(None)

    async def _succeed(self, model: Model, _: int, __: int) -> None:
        self._done(model, lambda: model.goal.succeed("home"), running=model.state == "running")
        model.end("succeeded", own=True)

    async def _fail(self, model: Model, _: int, __: int) -> None:
        self._done(model, lambda: model.goal.fail("no fuel"), running=model.state == "running")
        model.end("failed", "provider", own=True)

    async def _cancelled(self, model: Model, _: int, __: int) -> None:
        if model.requested:
            self._done(model, model.goal.cancelled, running=model.state == "running")
            model.end("cancelled", own=True)
            return
        try:
            model.goal.cancelled()
        except StateError:
            return
        raise AssertionError("nobody had asked to cancel it")

    def _done(self, model: Model, act: Any, *, running: bool) -> None:
        """The provider does something: it is taken, refused or ignored."""
        try:
            taken = act()
        except StateError:
            assert model.own
        else:
            assert taken == (model.state == "running")
            assert taken or not model.own

    async def _cancel(self, model: Model, _: int, __: int) -> None:
        model.goal.cancel()
        model.request(self.now)

    async def _wait(self, model: Model, _: int, amount: int) -> None:
        patience = PATIENCE if amount % 2 else None
        wait = Wait(asyncio.create_task(outcome(model.goal, patience)))
        wait.expected = "" if model.state == "running" else model.state
        wait.deadline = None if patience is None else self.now + patience
        model.waits.append(wait)

    async def _read(self, model: Model, _: int, __: int) -> None:
        if any(wait.reads and not wait.expected for wait in model.waits):
            return
        got: list[float] = []
        wait = Wait(asyncio.create_task(reading(model.goal, got)), reads=True, got=got)
        model.waits.append(wait)
        model.read()
        wait.expected = "" if model.state == "running" else "stop"

    async def _drop(self, model: Model, _: int, amount: int) -> None:
        waits = [wait for wait in model.waits if not wait.expected]
        if waits:
            wait = waits[amount % len(waits)]
            await asyncio.sleep(0)
            wait.task.cancel()
            wait.expected = "dropped"
            model.request(self.now)

    async def _car(self, _: Model | None, __: int, ___: int) -> None:
        if self.state == "gone":
            return
        if self.state == "active":
            await self.cars.deactivate(self.car)
            self._all_fail("deactivated")
            self.state = "inactive"
            return
        if self.state == "error":
            await self.cars.reset(self.car)
        await self.cars.activate(self.car)
        self.state = "active"

    async def _error(self, _: Model | None, __: int, ___: int) -> None:
        if self.state == "active":
            self.kernel.registry.task_failed(self.car, "a task", ValueError("broken"))
            self._all_fail("error")
            self.state = "error"

    async def _remove(self, _: Model | None, which: int, amount: int) -> None:
        if amount < 10:
            return
        if which > 3 and self.state != "gone":
            await self.kernel.remove(self.car)
            self._all_fail("removed")
            self.state = "gone"
        elif which <= 3 and self.drivers[which % 2] not in self.gone:
            self.gone.append(self.drivers[which % 2])
            await self.kernel.remove(self.gone[-1])
            self._all_request(which % 2)

    async def _driver(self, _: Model | None, which: int, __: int) -> None:
        number = which % 2
        if self.drivers[number] in self.gone:
            return
        if self.on[number]:
            await self.clients.deactivate(self.drivers[number])
            self._all_request(number)
        else:
            await self.clients.activate(self.drivers[number])
        self.on[number] = not self.on[number]

    async def _link(self, _: Model | None, which: int, __: int) -> None:
        number = which % 2
        driver = self.drivers[number]
        if driver.car.is_bound:
            await self.kernel.disconnect(driver.car.connectors[0])
            self._all_request(number)
        elif self.state != "gone" and driver not in self.gone:
            await self.kernel.connect(driver.car, self.car.service)

    def _all_fail(self, reason: str) -> None:
        for model in self.models:
            model.end("failed", reason)

    def _all_request(self, number: int) -> None:
        for model in self.models:
            if model.driver == number:
                model.request(self.now)

    async def end(self) -> None:
        await self.kernel.aclose()
        self._all_fail("closed")
        await asyncio.sleep(0)
        waits = [wait for model in self.models for wait in model.waits]
        if waits:
            await asyncio.wait([wait.task for wait in waits], timeout=1.0)
        self.compare()
        for wait in waits:
            ended = "dropped" if wait.task.cancelled() else wait.task.result()
            assert ended == wait.expected
        assert self.events == Counter(GoalAccepted=len(self.models), GoalEnded=len(self.models))


async def outcome(goal: Goal[float, str], patience: float | None) -> str:
    try:
        assert await goal.result(patience) == "home"
    except GoalCancelled:
        return "cancelled"
    except GoalFailed:
        return "failed"
    except ServiceTimeout:
        return "timeout"
    return "succeeded"


async def reading(goal: Goal[float, str], got: list[float]) -> str:
    async for feedback in goal:
        got.append(feedback)  # noqa: PERF401 - the test looks at it meanwhile
    return "stop"


OPS = (
    *("offer", "offer", "offer", "feedback", "feedback", "succeed", "fail", "cancelled", "cancelled", "cancel"),
    *("wait", "wait", "read", "drop", "sleep", "sleep", "car", "error", "driver", "link", "remove", "wrong"),
)


@pytest.mark.slow(kept_by="services/test_goals.py::test_a_provider_that_goes_has_failed")
@pytest.mark.timeout(time_limit(1200))
@settings(max_examples=cases(5000))
@given(
    st.lists(
        st.tuples(st.sampled_from(OPS), st.integers(0, 7), st.integers(0, 13)),
        min_size=LENGTH if CAMPAIGN else 1,
        max_size=4 * LENGTH,
    ),
    st.integers(0, 1000),
)
def test_goals_are_what_a_small_model_says(ops: list[tuple[str, int, int]], seed: int) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            play = Play(kernel)
            await play.build()
            for op in ops:
                await play.run(*op)
            await play.end()

    simulate(main(), seed=seed)
