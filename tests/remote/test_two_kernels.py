"""Composites with members in another kernel of this program: what is quick to see."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import pytest

from aiorts import Component, Composite, Kernel, LifecycleState, Param, PeriodicContext, Provided, Required
from aiorts.errors import DeniedError, WiringError
from aiorts.kernel.execution.file_access import FileAccess, acting
from remote_gripper import Gripper
from remote_parts import Local, until

pytestmark = [pytest.mark.anyio, pytest.mark.row(15, 101)]
ACTIVE, ERROR, INACTIVE = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE


async def test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component() -> None:
    services = {"control": {"name": "left"}, "links": {}}
    async with Kernel(services=services) as left, Kernel("right", services={"links": {}}) as right:
        gripper: Component = await left.create(Gripper, "gripper")
        await left.start(PeriodicContext(200.0), gripper)
        arm = await right.add(Composite("arm", Local("near"), "left/gripper", exported=["gripper.*"]))
        assert list(arm.ports) == ["inp", "force"]
        await right.start(PeriodicContext(200.0), arm, activate=True)
        assert (arm.state, gripper.state) == (ACTIVE, ACTIVE)
        await right.components["gripper"].configure(factor=5)
        assert gripper.configuration.values["factor"] == 5
        await arm.deactivate()
        await right.components["gripper"].configure(stuck=True)
        with pytest.raises(RuntimeError, match="is stuck"):
            await arm.activate()
        assert [member.state for member in arm.members] == [INACTIVE, ERROR]
        await gripper.configure(stuck=False)
        await until(lambda: not right.components["gripper"].configuration.values["stuck"])
        await arm.reset()
        await arm.activate()
        await left.remove(gripper)
        await until(lambda: [member.state for member in arm.members] == [INACTIVE, ERROR])
        assert "left/gripper: is there no more" in str(arm.last_error)


class Keeps(Component):
    """Names files."""

    note = Param("", file="write")
    map = Param(Path("/etc/map"), file="read")


async def test_a_parameter_that_names_a_file_says_so_in_the_kernel_where_its_stand_in_is(tmp_path: Path) -> None:
    """The check of what a client may name is made there, before the value goes on with the right of that kernel."""
    services = {"control": {"name": "left"}, "links": {}}
    async with Kernel(services=services) as left, Kernel("right", services={"links": {}}) as right:
        kept = await left.create(Keeps, "keeps")
        with acting(FileAccess(tmp_path)):
            here = await right.stand_in("left/keeps")
            with pytest.raises(DeniedError, match="names a file outside of"):
                await here.configure(note="/etc/passwd")
            await here.configure(note=str(tmp_path / "note"))
        assert kept.configuration.values["note"] == str(tmp_path / "note")


class Hold(Protocol):
    async def hold(self, force: float) -> float: ...


class Hand(Gripper):
    """A gripper with a service."""

    grip = Provided[Hold]()

    async def hold(self, force: float) -> float:
        return 2 * force


class Caller(Component):
    """Calls it."""

    grip = Required[Hold](timeout=5.0)


async def test_a_service_of_a_member_elsewhere_is_not_exported_and_is_connected_by_its_kernel() -> None:
    services = {"control": {"name": "left"}, "links": {}}
    async with Kernel(services=services) as left, Kernel("right", services={"links": {}}) as right:
        await left.start(PeriodicContext(200.0), await left.create(Hand, "hand"))
        with pytest.raises(WiringError, match=r"a service of left/hand is not exported, connect with left/hand.grip"):
            await right.add(Composite("arm", Local("near"), "left/hand", exported=["hand.inp", "hand.grip"]))
        arm = await right.add(Composite("arm", "left/hand", exported=["hand.*"]))
        assert list(arm.ports) == ["inp", "force"]
        caller = await right.create(Caller, "caller")
        await right.connect(caller.grip, "left/hand.grip")
        await right.start(PeriodicContext(200.0), arm, activate=True)
        assert await caller.grip.proxy.hold(1.5) == 3.0
