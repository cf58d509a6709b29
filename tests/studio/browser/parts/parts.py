"""Components of tests of the page: figures to see, and a hostile text in every place that takes one."""

from __future__ import annotations

import math

from aiorts import Component, InPort, OutPort, Param, StateMachineComponent
from aiorts.statechart import After, Chart, On, State
from aiorts.types import Point2D, Pose2D, TimedDouble, TimedPose2D, TimedString

MARKUP = "<img src=x onerror=window.hit=1>"


class Wave(Component):
    __doc__ = f"Writes a sine. {MARKUP}"

    out = OutPort(TimedDouble, unit="V", doc=MARKUP)
    pose = OutPort(TimedPose2D, unit=MARKUP)
    words = OutPort(TimedString)
    gain: float = Param(3.0, ge=0.0, le=10.0, unit=MARKUP, doc=MARKUP)
    label: str = Param(MARKUP, doc="a text")
    kind: str = Param("a", choices=("a", MARKUP))
    count = 0

    async def on_execute(self) -> None:
        self.count += 1
        now = self.clock.time_ns()
        self.out.write_nowait(TimedDouble(now, self.gain * math.sin(self.count / 40)))
        self.pose.write_nowait(TimedPose2D(now, Pose2D(Point2D(math.cos(self.count / 60), 0.5), 0.1)))
        self.words.write_nowait(TimedString(now, MARKUP))
        if self.count % 100 == 0:
            self.log.error("%s at %d", MARKUP, self.count)


class Slow(Component):
    """Takes one sample a cycle."""

    in_ = InPort(TimedDouble, name="in")

    async def on_execute(self) -> None:
        await self.in_.read()


class Fails(Component):
    """Fails in its tenth cycle."""

    count = 0

    async def on_execute(self) -> None:
        self.count += 1
        if self.count == 10:
            raise RuntimeError(MARKUP)


class Door(StateMachineComponent):
    """Opens, and closes by itself."""

    chart = Chart(
        State("closed", On("open", to="opening"), initial=True),
        State(
            "moving", State("opening", After(60.0, to="open"), initial=True), State("closing", After(60.0, to="closed"))
        ),
        State("open", After(60.0, to="closing")),
    )


class Loud(Component):
    """Logs as many lines a cycle as it is told to."""

    lines: int = Param(0, ge=0, le=1000)

    async def on_execute(self) -> None:
        for line in range(self.lines):
            self.log.warning(f"line {line} of {self.lines}, cycle {self.clock.time_ns()}")  # noqa: G004 - each another
