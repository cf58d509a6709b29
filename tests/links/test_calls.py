"""Services and goals whose provider is in another kernel, over the sockets of this host."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import pytest
from anyio import fail_after, sleep
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, Goal, Kernel, Provided, Required, idempotent
from aiorts.errors import (
    GoalCancelled,
    GoalFailed,
    InterfaceMismatch,
    LinkError,
    ServiceFailed,
    ServiceTimeout,
    ServiceUnavailable,
    WiringError,
)
from aiorts.links import Links
from aiorts.links.call_values import frame_of, interface_difference, interface_text, plain, restored, values_of
from aiorts.model.interface import read_interface
from aiorts.types import Pose2D, TimedDouble, TimedPose2D, record
from campaign import cases

pytestmark = pytest.mark.anyio


class Colour(Enum):
    RED = 1
    BLUE = 2


@record
class Limit:
    """A number with a rule of its own."""

    value: float

    def __post_init__(self) -> None:
        if self.value < 0:
            raise ValueError("below 0")


class Arm(Protocol):
    async def add(self, left: float, right: float = 1.0) -> float: ...
    async def move(self, pose: TimedPose2D, names: list[str], *, colour: Colour | None = None) -> tuple[str, int]: ...
    async def limit(self, limit: Limit | None) -> dict[str, Limit]: ...
    async def wait(self, seconds: float) -> str: ...
    async def fail(self, text: str) -> None: ...
    async def anything(self, value: Any) -> Any: ...
    async def reach(self, steps: int) -> Goal[float, str]: ...
    async def look(self) -> Goal[Limit, Colour]: ...


class Robot(Component):
    arm = Provided[Arm](concurrent=True)

    def on_initialize(self) -> None:
        self.cancelled = 0
        self.goals: list[Goal[float, str]] = []

    def add(self, left: float, right: float = 1.0) -> float:
        return left + right

    async def move(self, pose: TimedPose2D, names: list[str], *, colour: Colour | None = None) -> tuple[str, int]:
        return f"{pose.data.heading} {names} {colour}", len(names)

    async def limit(self, limit: Limit | None) -> dict[str, Limit]:
        return {} if limit is None else {"upper": limit}

    async def wait(self, seconds: float) -> str:
        try:
            await asyncio.sleep(seconds)
        except asyncio.CancelledError:
            self.cancelled += 1
            raise
        return "waited"

    async def fail(self, text: str) -> None:
        raise OSError(text)

    async def anything(self, value: Any) -> Any:
        return value

    async def reach(self, steps: int) -> Goal[float, str]:
        goal: Goal[float, str] = Goal()
        self.goals.append(goal)
        for step in range(steps):
            goal.feedback(float(step))
        if steps:
            goal.succeed("there")
        return goal

    async def look(self) -> Goal[Limit, Colour]:
        goal: Goal[Limit, Colour] = Goal()
        goal.feedback(Limit(2.0))
        goal.succeed(Colour.RED)
        return goal


class Client(Component):
    arm = Required[Arm](timeout=5.0)


@dataclass
class Pair:
    plant: Kernel
    station: Kernel
    client: Client
    robot: Robot


@pytest.fixture
async def pair() -> Any:
    async with Kernel("station", services={"links": {}}) as station, Kernel("plant") as plant:
        robot, client = await station.add(Robot("robot")), await plant.add(Client("client"))
        with fail_after(5):
            await plant.connect(client.arm, "station/robot.arm")
        yield Pair(plant, station, client, robot)


async def test_a_call_is_answered_in_another_kernel(pair: Pair) -> None:
    arm = pair.client.arm.proxy
    with fail_after(5):
        assert await arm.add(1.5) == 2.5
        assert await arm.add(left=1, right=2.0) == 3.0
        pose = TimedPose2D(1, Pose2D(heading=0.5))
        assert await arm.move(pose, ["a", "b"], colour=Colour.BLUE) == ("0.5 ['a', 'b'] Colour.BLUE", 2)
        assert await arm.limit(Limit(3.0)) == {"upper": Limit(3.0)}
        assert await arm.limit(None) == {}
        assert await arm.anything({"a": [1, None, "x"]}) == {"a": [1, None, "x"]}
    assert pair.client.arm.statistics.calls == 6
    assert pair.robot.arm.statistics.calls == 6
    (connector,) = pair.client.arm.connectors
    assert connector.profile.mapping == (("client.arm", "station/robot.arm"),)
    assert pair.plant.service(Links).report() == {"client.arm-station/robot.arm": "up"}


async def test_what_a_provider_raises_comes_by_name_and_text(pair: Pair) -> None:
    with fail_after(5):
        with pytest.raises(ServiceFailed, match=r"plant/client.arm -> robot.arm.fail: raised OSError: broken"):
            await pair.client.arm.proxy.fail("broken")
        with pytest.raises(InterfaceMismatch, match="gave left = str"):
            await pair.client.arm.proxy.add("x")  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="missing a required argument: 'left'"):
            await pair.client.arm.proxy.add()  # type: ignore[call-arg]
        with pytest.raises(InterfaceMismatch, match="a TimedDouble cannot travel"):
            await pair.client.arm.proxy.anything(TimedDouble(0, 1.0))
        with pytest.raises(InterfaceMismatch, match="cannot travel"):
            await pair.client.arm.proxy.anything([[[0]] * 50] * 100)
        assert await pair.client.arm.proxy.add(1.0) == 2.0


@pytest.mark.slow
async def test_a_call_has_a_deadline_and_its_provider_is_cancelled(pair: Pair) -> None:
    with fail_after(5):
        with pytest.raises(ServiceTimeout, match=r"within 0.05 s"):
            await pair.client.arm.within(0.05).wait(3.0)
        while not pair.robot.cancelled:
            await sleep(0.01)
        waiting = asyncio.ensure_future(pair.client.arm.proxy.wait(3.0))
        await sleep(0.05)
        waiting.cancel()
        while pair.robot.cancelled < 2:
            await sleep(0.01)
    assert not pair.station.service(Links).report()


@pytest.mark.slow
async def test_calls_of_several_ports_at_the_same_time_do_not_meet(pair: Pair) -> None:
    others = [await pair.plant.add(Client(f"c{number}")) for number in range(3)]
    with fail_after(10):
        for other in others:
            await pair.plant.connect(other.arm, "station/robot.arm")
        calls = [one.arm.proxy.wait(0.02) for one in (*others, pair.client) for _ in range(50)]
        assert await asyncio.gather(*calls) == ["waited"] * 200
        goals = [await one.arm.proxy.reach(2) for one in others]
        assert [await goal.result() for goal in goals] == ["there"] * 3


async def test_goals_are_followed_and_cancelled(pair: Pair) -> None:
    with fail_after(5):
        goal = await pair.client.arm.proxy.reach(3)
        assert [step async for step in goal] == [0.0, 1.0, 2.0]
        assert await goal.result() == "there"
        looking = await pair.client.arm.proxy.look()
        assert ([step async for step in looking], await looking.result()) == ([Limit(2.0)], Colour.RED)
        slow = await pair.client.arm.proxy.reach(0)
        slow.cancel()
        theirs = pair.robot.goals[1]
        while not theirs.cancel_requested:
            await sleep(0.01)
        theirs.cancelled()
        with pytest.raises(GoalCancelled):
            await slow.result()
        failing = await pair.client.arm.proxy.reach(0)
        pair.robot.goals[2].fail("stuck")
        with pytest.raises(GoalFailed, match="stuck"):
            await failing.result()


async def test_callers_of_other_kernels_count_as_connectors_of_the_port(caplog: pytest.LogCaptureFixture) -> None:
    class Narrow(Robot):
        arm = Provided[Arm](max_connectors=2)

    async with Kernel("station", services={"links": {}}) as station, Kernel("plant") as plant:
        narrow = await station.add(Narrow("robot"))
        near, *far = await station.add(Client("near")), *[await plant.add(Client(name)) for name in "abc"]
        with fail_after(5):
            await station.connect(near.arm, narrow.arm)
            first = await plant.connect(far[0].arm, "station/robot.arm")
            with pytest.raises(WiringError, match=r"robot.arm: takes 2 connectors at the most, has 2"):
                await plant.connect(far[1].arm, "station/robot.arm")
            assert "robot.arm: takes 2 connectors at the most" in caplog.text
            await plant.disconnect(first)
            while not far[2].arm.connectors:
                with suppress(WiringError):  # the other kernel does not know yet that there is room again
                    await plant.connect(far[2].arm, "station/robot.arm")


async def test_interfaces_that_differ_are_refused_at_both_ends(caplog: pytest.LogCaptureFixture) -> None:
    class Other(Protocol):
        async def add(self, left: str) -> float: ...

    class Plain(Protocol):
        def add(self, left: float, right: float = 1.0) -> float: ...

    class Wrong(Component):
        arm = Required[Other]()
        plain = Required[Plain]()

    async with Kernel("station", services={"links": {}}) as station, Kernel("plant") as plant:
        await station.add(Robot("robot"))
        wrong = await plant.add(Wrong("wrong"))
        with fail_after(5):
            with pytest.raises(WiringError, match=r"station/robot.arm: .*parameter left: is float, not str"):
                await plant.connect(wrong.arm, "station/robot.arm")
            with pytest.raises(WiringError, match="add may not wait"):
                await plant.connect(wrong.plain, "station/robot.arm")
            with pytest.raises(WiringError, match="no port"):
                await plant.connect(wrong.arm, "station/robot.leg")
        assert not wrong.arm.connectors
        assert not plant.connectors
        assert "refused by station" in caplog.text
        assert (
            "refused to bind a service port of plant: robot.arm provides Arm: Other: add, parameter left" in caplog.text
        )


@pytest.mark.slow
async def test_who_comes_later_or_again_is_bound_and_calls_meanwhile_say_so(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel("plant", services={"links": {}}) as plant:
        client = await plant.add(Client("client"))
        await plant.connect(client.arm, "station/robot.arm")
        with pytest.raises(ServiceUnavailable, match="there is no kernel 'station' yet"):
            await client.arm.proxy.add(1.0)
        for value in (1.0, 2.0):
            async with Kernel("station", services={"links": {}}) as station:
                robot = await station.add(Robot("robot"))
                with fail_after(5):
                    assert await answered(client, value) == value + 1.0
                    waiting = asyncio.ensure_future(client.arm.proxy.wait(3.0))
                    goal = await client.arm.proxy.reach(0)
                    await sleep(0.05)
                    if value == 2.0:
                        await station.remove(robot)
                        with pytest.raises(ServiceUnavailable):
                            await waiting
                        await station.add(Robot("robot"))
                        assert await answered(client, 5.0) == 6.0
            with fail_after(5):
                with pytest.raises(ServiceUnavailable):
                    await waiting
                with pytest.raises(GoalFailed):
                    await goal.result()
    assert not [one.getMessage() for one in caplog.records if one.levelno >= logging.ERROR]


async def answered(client: Client, value: float) -> float:
    while True:
        try:
            return await client.arm.proxy.add(value)
        except ServiceUnavailable:
            await sleep(0.02)


@pytest.mark.slow
async def test_only_an_idempotent_method_is_called_again() -> None:
    class Meter(Protocol):
        @idempotent
        async def read(self) -> float: ...
        async def count(self) -> int: ...

    class Device(Component):
        meter = Provided[Meter](concurrent=True)
        slow = True

        async def read(self) -> float:
            if self.slow:
                await asyncio.sleep(10)
            return 1.5

        async def count(self) -> int:
            await asyncio.sleep(10)
            return 1

    class Reader(Component):
        meter = Required[Meter](timeout=4.0)

    class Quick(Device):
        slow = False

    async with Kernel("plant", services={"links": {}}) as plant:
        reader = await plant.add(Reader("reader"))
        async with Kernel("station", services={"links": {}}) as station:
            await station.add(Device("device"))
            with fail_after(5):
                await plant.connect(reader.meter, "station/device.meter")
                again = asyncio.ensure_future(reader.meter.proxy.read())
                once = asyncio.ensure_future(reader.meter.proxy.count())
                await sleep(0.05)
        with fail_after(5), pytest.raises(ServiceUnavailable):
            await once
        async with Kernel("station", services={"links": {}}) as station:
            await station.add(Quick("device"))
            with fail_after(5):
                assert await again == 1.5


async def test_an_answer_that_comes_too_late_is_counted() -> None:
    class Deaf(Robot):
        async def wait(self, seconds: float) -> str:
            for _ in range(2):
                try:
                    await asyncio.sleep(0.1)
                except asyncio.CancelledError:
                    continue
            return "waited"

    async with Kernel("station", services={"links": {}}) as station, Kernel("plant") as plant:
        await station.add(Deaf("robot"))
        client = await plant.add(Client("client"))
        with fail_after(5):
            await plant.connect(client.arm, "station/robot.arm")
            with pytest.raises(ServiceTimeout):
                await client.arm.within(0.02).wait(3.0)
            while "too late" not in str(plant.service(Links).report()):
                await sleep(0.01)


async def test_a_component_calls_from_its_context(pair: Pair) -> None:
    class Caller(Component):
        arm = Required[Arm]()
        found = 0.0

        async def on_activated(self) -> None:
            self.found = await self.arm.proxy.add(20.0, 22.0)

    caller = await pair.plant.add(Caller("caller"))
    with fail_after(5):
        await pair.plant.connect(caller.arm, "station/robot.arm")
        await pair.plant.start(EventContext(), caller, activate=True)
        while not caller.found:
            await sleep(0.01)
    assert caller.found == 42.0
    await pair.plant.disconnect(caller.arm.connectors[0])
    with fail_after(5):
        while len(pair.robot.arm.profile.bound_to) > 1:
            await sleep(0.01)


async def test_a_connector_is_made_again_from_its_profile(pair: Pair) -> None:
    (connector,) = pair.client.arm.connectors
    await pair.plant.disconnect(connector)
    with pytest.raises(ServiceUnavailable, match="is not connected"):
        await pair.client.arm.proxy.add(1.0)
    pair.plant.connections.renew(connector.profile, reports_losses=False)
    with fail_after(5):
        assert await answered(pair.client, 1.0) == 2.0
    assert list(pair.plant.connectors) == []
    assert [one.name for one in pair.client.arm.connectors] == [connector.name]


@pytest.mark.filterwarnings("error")
async def test_nothing_that_a_peer_asks_ends_a_kernel(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    links = pair.plant.service(Links)
    (peer,) = links.peers
    bodies = [
        b"",
        b"\xc1",
        frame_of([]),
        frame_of([1, 2, "add", [], {}, 1.0]),
        frame_of([1, 7, "add", [1, 2, 3], {}, 1.0]),
        frame_of([1, 8, "add", [], {"x": 1}, 1.0]),
        frame_of([1, 9, "__class__", [], {}, 1.0]),
        frame_of([1, 10, "add", [[1]], {}, -1.0]),
        frame_of(["x/y.z", "arm", "robot.arm", ["Arm", [["add", False, "", [["1", 9, "", False]]]], {}]]),
        frame_of([99, "feedback", [1]]),
        b"\x9f" * 2_000,
    ]
    with fail_after(10):
        for what in ("bind", "unbind", "call", "cancel", "goal", "cancel goal"):
            for body in bodies:
                try:
                    await links.ask(peer, what, body, 1.0)
                except LinkError:
                    continue
        assert await pair.client.arm.proxy.add(1.0) == 2.0
    assert not [one for one in caplog.records if one.levelno >= logging.ERROR]


PLAIN = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False) | st.text()
ANY = st.recursive(PLAIN, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4))


@given(ANY)
@settings(max_examples=cases(200), deadline=None)
def test_plain_values_come_as_they_were(value: Any) -> None:
    (found,) = values_of(frame_of([[plain(Any, value)]]), (list,))
    assert restored(Any, found[0]) == value


@given(
    st.tuples(
        st.sets(st.integers(0, 9)), st.dictionaries(st.text(), st.tuples(st.floats(0, 9), st.sampled_from(Colour)))
    )
)
@settings(max_examples=cases(200), deadline=None)
def test_typed_values_come_as_they_were(value: Any) -> None:
    hint = tuple[set[int], dict[str, tuple[float, Colour]]]
    (found,) = values_of(frame_of([plain(hint, value)]), (list,))
    assert restored(hint, found) == value


@given(st.binary(max_size=60))
@settings(max_examples=cases(500), deadline=None)
def test_bytes_that_are_no_message_are_a_link_error(body: bytes) -> None:
    try:
        text = values_of(body, (str, list, dict))
        interface_difference(text, read_interface(Arm))
    except LinkError:
        pass


def test_a_record_that_its_class_refuses_is_a_mismatch() -> None:
    good = plain(Limit, Limit(1.0))
    assert restored(Limit | None, good) == Limit(1.0)
    with pytest.raises(InterfaceMismatch, match="no Limit"):
        restored(Limit, good[:-9] + b"\xcb\xc0" + bytes(7))
    assert restored(bytes, b"x") == b"x"


def test_a_value_comes_as_the_alternative_that_it_is_of() -> None:
    hint = Colour | Limit | None
    assert [restored(hint, plain(hint, one)) for one in (Colour.RED, Limit(1.0), None)] == [
        Colour.RED,
        Limit(1.0),
        None,
    ]
    with pytest.raises(InterfaceMismatch, match="no Colour"):
        restored(Colour | None, 3)


def test_an_interface_fits_itself() -> None:
    spec = read_interface(Arm)
    (found,) = values_of(frame_of([interface_text(spec)]), (list,))
    assert interface_difference(found, spec) == ""
    found[2]["TimedPose2D"] = "{}"
    assert "TimedPose2D" in interface_difference(found, spec)
