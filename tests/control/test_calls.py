"""Services are called, and goals sent, from another terminal."""

from __future__ import annotations

import asyncio
import enum
import json
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import pytest

from aiorts import Component, EventContext, Goal, Kernel, PeriodicContext, Provided, ThreadContext
from aiorts.sessions import Client
from aiorts.types import TimedDouble
from control_parts import WAIT, commanded, entry_of

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    """One loop is enough: what a command does passes through the socket."""
    return "asyncio"


class Side(enum.Enum):
    LEFT = 1
    RIGHT = 2


@dataclass
class Point:
    x: float = 0.0
    y: float = 0.0


class Arm(Protocol):
    async def move(self, to: Point, speed: float = 1.0) -> float: ...
    async def grip(self, side: Side, fingers: list[int], how: Literal["soft", "hard"] = "soft") -> str: ...
    async def say(self, text: str, times: int | None = None) -> str: ...
    def table(self, entries: dict[str, float]) -> Mapping[str, float]: ...
    async def stamp(self, sample: TimedDouble) -> TimedDouble: ...
    async def fail(self) -> None: ...
    async def hang(self) -> None: ...


class Robot(Component):
    arm = Provided[Arm]()
    hung = cancelled = 0

    async def move(self, to: Point, speed: float = 1.0) -> float:
        return (to.x + to.y) * speed

    async def grip(self, side: Side, fingers: list[int], how: Literal["soft", "hard"] = "soft") -> str:
        return f"{side.name} {fingers} {how}"

    async def say(self, text: str, times: int | None = None) -> str:
        return text * (1 if times is None else times)

    def table(self, entries: dict[str, float]) -> Mapping[str, float]:
        return {name: 2 * value for name, value in entries.items()}

    async def stamp(self, sample: TimedDouble) -> TimedDouble:
        return TimedDouble(7, sample.data)

    async def fail(self) -> None:
        raise RuntimeError("the motor is hot")

    async def hang(self) -> None:
        self.hung += 1
        try:
            await asyncio.sleep(WAIT)
        except asyncio.CancelledError:
            self.cancelled += 1
            raise


class Driving(Protocol):
    async def drive(self, metres: int) -> Goal[int, str]: ...


class Car(Component):
    driving = Provided[Driving]()
    goal: Goal[int, str] | None = None
    metres = done = 0

    async def drive(self, metres: int) -> Goal[int, str]:
        self.goal, self.metres, self.done = Goal(), metres, 0
        return self.goal

    def on_execute(self) -> None:
        goal = self.goal
        if goal is None or goal.state != "running":
            return
        if goal.cancel_requested:
            goal.cancelled()
        elif self.done < self.metres:
            self.done += 1
            goal.feedback(self.done)
        elif self.metres == 0:
            goal.fail("there is no road")
        else:
            goal.succeed("there")


@asynccontextmanager
async def robots() -> AsyncIterator[Kernel]:
    async with Kernel(services={"control": {"name": "robots"}}) as kernel:
        await kernel.create(Robot, "r2")
        car = await kernel.create(Car, "car0")
        await kernel.start(PeriodicContext(rate=500.0), car, activate=True)
        yield kernel


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("words", "result"),
    [
        (["move", 'to={"x": 1, "y": 2}'], 3.0),
        (["move", '{"to": {"x": 1, "y": 2}, "speed": 2}'], 6.0),
        (["move", '[{"x": 1}, 3]'], 3.0),
        (["move", 'to={"x": 1}', "speed=0.5"], 0.5),
        (["grip", "LEFT", "1,2"], "LEFT [1, 2] soft"),
        (["grip", "side=RIGHT", "fingers=[1, 2]", "how=hard"], "RIGHT [1, 2] hard"),
        (["say", "12", "2"], "1212"),
        (["say", "text=a=b", "times=none"], "a=b"),
        (["table", 'entries={"a": 1}'], {"a": 2.0}),
        (["table", "entries=a: 1, b: 2"], {"a": 2.0, "b": 4.0}),
        (["stamp", 'sample={"data": 2.5}'], {"tm": 7, "data": 2.5}),
    ],
)
async def test_arguments_are_read_by_the_types_of_the_interface(
    capsys: pytest.CaptureFixture[str], words: list[str], result: Any
) -> None:
    async with robots():
        status, text = await commanded(capsys, "call", f"r2.arm.{words[0]}", *words[1:])
        assert (status, json.loads(text)) == (0, result)


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (["r2.arm.move", "to=5"], 2, "r2.arm.move: to: Point = '5'"),
        (["r2.arm.move"], 2, "missing a required argument: 'to'"),
        (["r2.arm.say", "a", "1", "2"], 2, "too many positional arguments"),
        (["r2.arm.say", "text=a", "nosuch=2"], 2, "got an unexpected keyword argument 'nosuch'"),
        (["r2.arm.say", "a", "many"], 2, "times: int | None = 'many'"),
        (["r2.arm.mov"], 6, "did you mean move?"),
        (["r2.am.move"], 6, "did you mean arm?"),
        (["r3.arm.move"], 6, "there are r2, car0"),
        (["r2.arm"], 6, "expected COMPONENT.PORT.METHOD"),
        (["r2.arm.fail"], 1, "raised RuntimeError: the motor is hot"),
        (["r2.arm.hang", "--timeout", "0.02"], 5, "0.02 s"),
        (["car0.driving.drive", "3"], 2, "send it with `aiorts goal`"),
    ],
)
async def test_calls_without_a_result_say_why(
    capsys: pytest.CaptureFixture[str], words: list[str], status: int, text: str
) -> None:
    async with robots():
        found, said = await commanded(capsys, "call", *words)
        assert (found, text in said) == (status, True), said


async def test_a_provider_that_is_not_active_or_in_a_thread_answers_as_it_does_others(
    capsys: pytest.CaptureFixture[str],
) -> None:
    async with robots() as kernel:
        robot = kernel.components["r2"]
        context = await kernel.start(EventContext(), robot)
        status, text = await commanded(capsys, "call", "r2.arm.say", "a")
        assert (status, "it is inactive" in text) == (2, True)
        await kernel.stop(context)
        provider = await kernel.create(Plain, "plain0")
        await kernel.start(ThreadContext(rate=200.0), provider, activate=True)
        assert await commanded(capsys, "call", "plain0.twice.twice", "4") == (0, "8\n")


class Twice(Protocol):
    async def twice(self, number: int) -> int: ...


class Plain(Component):
    twice_ = Provided[Twice](port="twice", instance="twice")

    def twice(self, number: int) -> int:
        return 2 * number


async def test_the_end_of_the_session_cancels_a_call() -> None:
    async with robots() as kernel:
        robot: Any = kernel.components["r2"]
        client = await asyncio.to_thread(Client.open, entry_of("robots"))
        client.begin("call", path="r2.arm.hang", timeout=WAIT)
        async with asyncio.timeout(WAIT):
            while not robot.hung:
                await asyncio.sleep(0.005)
            client.close()
            while not robot.cancelled:
                await asyncio.sleep(0.005)
            (end,) = [one for port in robot.ports.values() for one in port.interfaces]
            while end.profile.bound_to:
                await asyncio.sleep(0.005)
        assert kernel.service_connectors == {}


async def test_a_goal_shows_its_feedback_and_its_end(capsys: pytest.CaptureFixture[str]) -> None:
    async with robots():
        assert await commanded(capsys, "goal", "car0.driving.drive", "3") == (0, '1\n2\n3\n"there"\n')
        status, text = await commanded(capsys, "goal", "car0.driving.drive", "metres=2", "--json")
        lines = [json.loads(line) for line in text.splitlines()]
        assert (status, lines[0], lines[-1]["state"]) == (0, {"feedback": 1, "missed": 0}, "succeeded")
        status, text = await commanded(capsys, "goal", "car0.driving.drive", "0")
        assert (status, "E-GOAL-FAILED" in text, "there is no road" in text) == (1, True, True)
        status, text = await commanded(capsys, "goal", "r2.arm.say", "a")
        assert (status, "call it with `aiorts call`" in text) == (2, True)


async def test_a_goal_is_cancelled_with_its_stream_and_with_its_session() -> None:
    async with robots() as kernel:
        car: Any = kernel.components["car0"]

        def send(end: str) -> None:
            with Client.open(entry_of("robots"), timeout=WAIT) as client:
                stream = client.stream("goal", WAIT, path="car0.driving.drive", args=[10**9])
                stream.next(WAIT)
                if end == "stream":
                    stream.close()
                    client.call("names", WAIT)

        for end in ("stream", "session"):
            await asyncio.to_thread(send, end)
            async with asyncio.timeout(WAIT):
                while car.goal.state == "running":
                    await asyncio.sleep(0.005)
            assert car.goal.state == "cancelled"
