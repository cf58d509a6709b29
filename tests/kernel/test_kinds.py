"""What kinds of components tell the kernel: each kind that a class derives from is asked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aiorts import Component, EventContext, Kernel, MultiModeComponent, Participant, StateMachineComponent
from aiorts.kernel.declarations import Kind, kinds_of
from aiorts.statechart import Chart, State
from aiorts.testing import simulated


class Loud(Kind):
    """Notes what it is asked."""

    def __init__(self) -> None:
        self.heard: list[str] = []

    def removed(self, component: Any) -> None:
        self.heard.append(f"{component.name} removed")

    def reports(self, component: Any) -> Mapping[str, Any]:
        self.heard.append(f"{component.name} reports")
        return {}


class Noted(Component, kind=Loud()):
    """Of that kind."""


class Arm(MultiModeComponent, Participant, Noted):
    """Of three kinds."""

    modes = ("manual", "automatic")


class Door(StateMachineComponent):
    """Tells others of its changes."""

    chart = Chart(State("closed"))


@simulated
async def test_each_kind_of_a_component_is_asked() -> None:
    loud = next(kind for kind in kinds_of(Noted("n")) if isinstance(kind, Loud))
    assert loud in kinds_of(Arm("a"))
    assert len(kinds_of(Arm("a"))) == 3
    assert kinds_of(Component("c")) == ()
    async with Kernel() as kernel:
        arm, door = await kernel.create(Arm, "arm"), await kernel.create(Door, "door")
        door.machine.add_participant(arm)
        await kernel.start(EventContext(), arm, door, activate=True)
        report = kernel.profile().components["arm"]
        assert report.modes is not None
        assert report.modes.mode == "manual"
        assert kernel.profile().components["door"].machine is not None
        await kernel.remove(arm)
        assert loud.heard == ["arm reports", "arm reports", "arm removed"]
