"""Service ports of components that run in processes of their own: calls into them and out of them."""

from __future__ import annotations

import os
from typing import Any

import pytest
from anyio import fail_after

from aiorts import EventContext, Kernel, LifecycleState
from aiorts.errors import (
    DeclarationError,
    GoalCancelled,
    GoalFailed,
    ServiceFailed,
    ServiceTimeout,
    ServiceUnavailable,
    WiringError,
)
from aiorts.types import Point2D, Pose2D, TimedLong, TimedPose2D
from isolation.isolated_parts import Caller, Client, Looker, Robot, Sink, Source
from isolation.test_isolated import until

pytestmark = pytest.mark.anyio


async def robot_of(kernel: Kernel) -> tuple[Client, Any]:
    """A client of this kernel, and the robot in its process, connected and active."""
    client = await kernel.add(Client("client"))
    robot = await kernel.create_isolated(Robot, "robot")
    await kernel.connect(client.arm, "robot.arm")
    await kernel.start(EventContext(name="apart"), robot, activate=True)
    return client, robot


@pytest.mark.slow(kept_by="first")
async def test_what_it_provides_is_called_from_here() -> None:
    async with Kernel() as kernel:
        client, robot = await robot_of(kernel)
        arm = client.arm.proxy
        with fail_after(20):
            assert await arm.where() == robot.pid != os.getpid()
            assert (await arm.add(1.5), await arm.add(1, right=2.0)) == (2.5, 3.0)
            assert await arm.place(TimedPose2D(0, Pose2D(Point2D(2.0, 0.0), 0.5))) == [2.0, 0.5]
            with pytest.raises(ServiceFailed, match=r"robot\.arm\.fail.*OSError.*no grip"):
                await arm.fail("no grip")
            with pytest.raises(ServiceTimeout):
                await client.arm.within(0.1).wait(5.0)
            assert await arm.add(1.0) == 2.0
        (connector,) = client.arm.connectors
        assert connector.profile.mapping == (("client.arm", "robot.arm"),)
        assert (robot.ports["arm"].connectors, client.arm.statistics.calls) == ((connector,), 7)


@pytest.mark.slow(kept_by="test_what_it_provides_is_called_from_here")
async def test_several_call_it_and_are_disconnected_alone() -> None:
    async with Kernel() as kernel:
        client, robot = await robot_of(kernel)
        other = await kernel.add(Client("other"))
        connector = await kernel.connect(other.arm, robot.arm)
        with fail_after(20):
            assert (await client.arm.proxy.add(1.0), await other.arm.proxy.add(2.0)) == (2.0, 3.0)
            await kernel.disconnect(connector)
            assert await client.arm.proxy.add(1.0) == 2.0
            with pytest.raises(ServiceUnavailable, match="is not connected"):
                await other.arm.proxy.add(2.0)


@pytest.mark.slow(kept_by="test_what_it_provides_is_called_from_here")
async def test_a_deactivated_one_refuses_and_says_so() -> None:
    async with Kernel() as kernel:
        client, robot = await robot_of(kernel)
        await robot.context.deactivate()
        with fail_after(20), pytest.raises(ServiceUnavailable, match="it is inactive in apart; activate it"):
            await client.arm.proxy.add(1.0)


@pytest.mark.slow(kept_by="test_what_it_provides_is_called_from_here")
async def test_goals_are_followed_and_cancelled() -> None:
    async with Kernel() as kernel:
        client, _robot = await robot_of(kernel)
        with fail_after(20):
            goal = await client.arm.proxy.reach(3, True)
            assert [one async for one in goal] == [0.0, 1.0, 2.0]
            assert await goal.result() == "there"
            goal = await client.arm.proxy.reach(1, False)
            goal.cancel()
            with pytest.raises(GoalCancelled):
                await goal.result()


@pytest.mark.slow(kept_by="test_what_it_provides_is_called_from_here")
async def test_its_process_dies_in_a_call_and_a_goal_and_is_bound_again_when_it_is_back() -> None:
    async with Kernel() as kernel:
        client, robot = await robot_of(kernel)
        with fail_after(30):
            goal = await client.arm.proxy.reach(1, False)
            with pytest.raises(ServiceUnavailable):
                await client.arm.proxy.die()
            with pytest.raises(GoalFailed):
                await goal.result()
            await until(lambda: robot.state is LifecycleState.ERROR)
            with pytest.raises(ServiceUnavailable, match="is gone"):
                await client.arm.proxy.add(1.0)
            await robot.context.reset(robot)
            await robot.context.activate(robot)
            assert await client.arm.proxy.add(1.0) == 2.0


async def caller_of(kernel: Kernel, provider: Any) -> tuple[Source, Any, Sink]:
    """A caller in a process, and who asks it."""
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    caller = await kernel.create_isolated(Caller, "caller")
    await kernel.connect(source.out, "caller.inp", length=100)
    await kernel.connect("caller.out", sink.inp, length=100)
    await kernel.connect(caller.arm, provider)
    await kernel.start(EventContext(name="calls"), caller, activate=True)
    return source, caller, sink


async def heard(source: Source, sink: Sink, value: int) -> int:
    source.out.write_nowait(TimedLong(0, value))
    return (await sink.inp.read(timeout=10)).data


@pytest.mark.slow(kept_by="test_what_it_provides_is_called_from_here")
async def test_what_it_requires_is_answered_here() -> None:
    async with Kernel() as kernel:
        robot = await kernel.add(Robot("robot"))
        robot.arm.port.max_connectors = 1
        source, caller, sink = await caller_of(kernel, robot.arm)
        assert await heard(source, sink, 5) == 6
        assert await heard(source, sink, 100) == 1
        (connector,) = caller.arm.connectors
        assert (connector.profile.mapping, robot.arm.statistics.calls) == ((("caller.arm", "robot.arm"),), 3)
        await kernel.disconnect(connector)
        await until(lambda: robot.arm.connectors == ())
        assert await heard(source, sink, 5) == -1
        other = await kernel.add(Robot("other"))
        await kernel.connect(caller.arm, other.arm)
        assert await heard(source, sink, 7) == 8
        assert (robot.arm.statistics.calls, other.arm.statistics.calls) == (3, 1)
        os.kill(caller.pid, 9)
        await until(lambda: caller.state is LifecycleState.ERROR)
        await caller.context.reset(caller)
        await caller.context.activate(caller)
        assert await heard(source, sink, 8) == 9


@pytest.mark.slow(kept_by="test_what_it_provides_is_called_from_here")
async def test_one_isolated_component_calls_another() -> None:
    async with Kernel() as kernel:
        _client, robot = await robot_of(kernel)
        source, caller, sink = await caller_of(kernel, robot.arm)
        assert await heard(source, sink, 5) == 6
        assert await heard(source, sink, 100) == 1
        assert len({caller.pid, robot.pid, os.getpid()}) == 3


@pytest.mark.slow(kept_by="test_what_it_provides_is_called_from_here")
async def test_what_cannot_be_called_across_processes_is_refused() -> None:
    async with Kernel("here") as kernel, Kernel("there", services={"links": {}}) as other:
        with pytest.raises(DeclarationError, match=r"Looker.quick: Quick.look may not wait.*write `async def`"):
            await kernel.create_isolated(Looker, "looker")
        await other.add(Robot("robot"))
        caller = await kernel.create_isolated(Caller, "caller")
        with fail_after(20), pytest.raises(WiringError, match="runs in a process of its own, which reaches"):
            await kernel.connect(caller.arm, "there/robot.arm")
        assert (caller.arm.connectors, dict(kernel.service_connectors)) == ((), {})
