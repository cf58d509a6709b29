"""Measures what the arm did, says so in a table, and ends the run: status 0 if all was as promised, else 1."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import exp, pi, sqrt
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from aiorts import Component, InPort, Param
from aiorts.types import TimedBoolean, TimedDouble

SECOND = 500
"""Ticks."""
HEAD = "set         damping    rise  settled  overshoot (ideal)  force at 1 s  brake"


class Row(NamedTuple):
    """One tick of the four."""

    push: float
    """N, what the operator wants."""
    force: float
    """N, what the sensor says."""
    command: float
    """m/s, what the controller answers."""
    speed: float
    """m/s, what the encoder says."""
    pressed: bool
    """Whether the red button is down."""
    touch: float
    """N, what the wall feels: only a simulated one can tell."""


@dataclass(frozen=True, slots=True)
class Figures:
    """What a run was like. Times in ticks; forces as a part of the set-point, the first push."""

    rise: int
    """From 10 % to 90 %."""
    settled: int
    """Until the force was within bounds for good."""
    overshoot: float
    steady: float
    """The last tenth of the first second."""
    moving: float
    """m/s, when the brake was called."""
    stop: int
    """From there until the arm stood still for good."""

    @classmethod
    def of(cls, rows: Sequence[Row], within: float) -> Figures:
        forces = [row.touch / rows[0].push for row in rows[:SECOND]]
        reached = {part: next((n for n, f in enumerate(forces) if f >= part), SECOND) for part in (0.1, 0.9)}
        pressed = [row.pressed for row in rows].index(True)
        return cls(
            rise=reached[0.9] - reached[0.1],
            settled=after_last([not abs(force - 1.0) <= within for force in forces]),
            overshoot=max(0.0, max(forces) - 1.0),
            steady=fmean(forces[-SECOND // 10 :]),
            moving=abs(rows[pressed - 1].speed),
            stop=max(0, after_last([row.speed != 0.0 for row in rows]) - pressed),
        )


def after_last(wrong: Sequence[bool]) -> int:
    """How many ticks until nothing is wrong any more."""
    return max((n + 1 for n, one in enumerate(wrong) if one), default=0)


def ideal_overshoot(mass: float, damping: float, stiffness: float) -> float:
    """Of M x'' + D x' + K x = F, the textbook's oscillator, as a part of F / K."""
    ratio = damping / (2.0 * sqrt(mass * stiffness))
    return exp(-pi * ratio / sqrt(1.0 - ratio * ratio)) if ratio < 1.0 else 0.0


class Judge(Component):
    """Keeps one row for each tick of the four, and judges when it has them all."""

    push = InPort(TimedDouble, unit="N")
    force = InPort(TimedDouble, unit="N")
    command = InPort(TimedDouble, unit="m/s")
    speed = InPort(TimedDouble, unit="m/s")
    button = InPort(TimedBoolean)
    touch = InPort(TimedDouble, unit="N")

    ticks = Param(700, gt=SECOND, doc="how many make a run")
    within = Param(0.02, gt=0.0, doc="of the set-point")
    ideal_within = Param(0.1, gt=0.0, doc="of the set-point: how far the overshoot may be from a textbook's")
    record = Param("", doc="a file for the rows, if any")
    patience = Param(5.0, gt=0.0, unit="s", doc="how long it waits for a tick")

    def on_activated(self) -> None:
        self.columns: list[list[Any]] = [[], [], [], [], [], []]
        self.stamps: list[list[int]] = [[], [], [], [], [], []]
        self.heard_ns = self.clock.monotonic_ns()

    def on_execute(self) -> None:
        ports: list[InPort[Any]] = [self.push, self.force, self.command, self.speed, self.button, self.touch]
        before, now_ns = self.count, self.clock.monotonic_ns()
        for column, stamps, port in zip(self.columns, self.stamps, ports, strict=True):
            for sample in port.drain():
                column.append(sample.data)
                stamps.append(sample.tm)
        if self.count > before:
            self.heard_ns = now_ns
        if self.count >= self.ticks or now_ns - self.heard_ns > self.patience * 1e9:
            self.finish()

    @property
    def count(self) -> int:
        """Ticks of which all is there."""
        return min(map(len, self.columns))

    def on_deactivated(self) -> None:
        *columns, touch = self.columns
        if touch:  # the world has turned before the first tick, too, and may turn by a clock of its own
            touched, ticked = self.stamps[5], self.stamps[0]
            touch = [touch[max(0, bisect_right(touched, stamp) - 1)] for stamp in ticked]
        rows = [*map(Row._make, zip(*columns, touch, strict=False))][: self.ticks]
        faults = [*self.faults(rows)] if len(rows) == self.ticks else [f"{len(rows)} of {self.ticks} ticks came"]
        for fault in faults:
            print(f"not as promised: {fault}")
        if self.record:
            Path(self.record).write_text("".join(f"{','.join(map(repr, row))}\n" for row in rows))
        self.kernel.request_stop(1 if faults else 0)

    def faults(self, rows: Sequence[Row]) -> Iterator[str]:
        """Print the figures, and yield what is wrong with them."""
        if not rows[0].push or not any(row.pressed for row in rows):
            yield "the joystick was not pushed" if not rows[0].push else "nobody called the brake"
            return
        damper, wall = self.kernel.components["damper"].configuration, self.kernel.components["world"].configuration
        damping, goal, made = damper.values["damping"], rows[0].push, Figures.of(rows, self.within)
        ideal = ideal_overshoot(damper.values["mass"], damping, wall.values["stiffness"])
        print(HEAD)
        print(
            f"{damper.active:10}{damping:4.0f} N s/m{2 * made.rise:5} ms{2 * made.settled:6} ms"
            f"{made.overshoot:10.1%} {f'({ideal:.1%})':9}{goal * made.steady:7.2f} of {goal:g} N"
            f"  {made.stop} tick{'s' * (made.stop != 1)} from {made.moving:.3f} m/s"
        )
        if made.settled >= SECOND:
            yield f"the force at 1 s is {goal * made.steady:.2f} N, not at rest within {self.within:.0%} of {goal:g} N"
        if abs(made.overshoot - ideal) > self.ideal_within:
            yield f"the overshoot is {made.overshoot:.1%}, where a mass on a damper has {ideal:.1%}"
        if made.moving < 0.01:
            yield f"the arm moved at {made.moving:.3f} m/s when the brake was called: nothing to stop"
        if made.stop > 2:
            yield f"the brake was called and the arm moved for {made.stop} ticks more; 2 are allowed"
