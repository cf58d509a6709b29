"""Components that are moved; processes import this file."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from typing import Protocol

import numpy as np

from aiorts import Component, InPort, OutPort, Param, Provided, Required
from aiorts.types import Point2D, TimedLong, record


@record
class Seen:
    """What was seen last."""

    number: int
    where: Point2D


class Feed(Component):
    """Writes where it is told."""

    out = OutPort(TimedLong)


class Clockwork(Component):
    """Writes 1, 2, 3 ..., five in each cycle."""

    out = OutPort(TimedLong)
    written = 0

    def on_execute(self) -> None:
        for _ in range(5):
            self.written += 1
            self.out.write_nowait(TimedLong(0, self.written))


class Heavy(Component):
    """Has much to take along."""

    def on_initialize(self) -> None:
        self.map, self.text = np.zeros(400_000), ""


class Log(Component):
    """Keeps what it gets until it is read."""

    inp = InPort(TimedLong, length=100_000)


class Controller(Component):
    """Passes on what it gets, with how many it has passed on in its whole life."""

    inp = InPort(TimedLong, length=100_000)
    out = OutPort(TimedLong)
    where = OutPort(TimedLong)
    gain: int = Param(1)

    def on_initialize(self) -> None:
        self.count = 0
        self.integral = np.zeros(3)
        self.last = Seen(0, Point2D(0.0, 0.0))
        self.window: deque[int] = deque(maxlen=5)
        self.cycles: dict[str, tuple[int, ...]] = {}

    def on_execute(self) -> None:
        self.cycles[f"{os.getpid()}, {threading.get_ident()}"] = (len(self.cycles), self.count)
        for sample in self.inp.drain():
            self.count += 1
            self.integral += sample.data
            self.window.append(sample.data)
            self.last = Seen(sample.data, Point2D(float(self.count), 0.0))
            self.out.write_nowait(TimedLong(self.count, sample.data * self.gain))
        self.where.write_nowait(TimedLong(time.monotonic_ns(), os.getpid()))


class Echo(Component):
    """Gives each number back, runs on data, and hears of its transitions."""

    inp = InPort(TimedLong, length=1_000)
    out = OutPort(TimedLong)

    def on_initialize(self) -> None:
        self.heard: list[str] = []

    def on_activated(self) -> None:
        self.heard.append("activated")

    def on_deactivated(self) -> None:
        self.heard.append("deactivated")

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            if sample.data < 0:
                raise ValueError("negative")
            self.out.write_nowait(sample)


class Told(Component):
    """Passes on what it has got each time that it is told to."""

    inp = InPort(TimedLong)
    go = InPort(TimedLong)
    out = OutPort(TimedLong)

    def on_execute(self) -> None:
        if self.go.drain():
            for sample in self.inp.drain():
                self.out.write_nowait(sample)


class Holder(Component):
    """Holds what cannot be moved."""

    inp = InPort(TimedLong)
    count = 0

    def on_initialize(self) -> None:
        self.lock = threading.Lock()


class Careful(Holder):
    """Takes over what it can."""

    came = 0

    def on_reload(self, old: Careful) -> None:
        self.count, self.came = old.count, os.getpid()


class Closed(Component):
    """Starts where it was made alone."""

    home: int = Param(0)

    def on_startup(self) -> None:
        if self.home not in (0, os.getpid()):
            raise RuntimeError("not at home")


class Answer(Protocol):
    """Answers."""

    async def add(self, number: int) -> int: ...


class Counter(Component):
    """Counts, and asks another counter."""

    mine = Provided[Answer]()
    other = Required[Answer](timeout=5.0)
    total = 0

    async def add(self, number: int) -> int:
        self.total += number
        return self.total
