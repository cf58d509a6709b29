"""Writers and readers of numbers, of two types each with the same ports: one can be put in the other's place."""

from __future__ import annotations

from contextlib import suppress

from anyio import WouldBlock

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong


class Count(Component):
    """Writes 1, 2, 3, ... on its ports, one more in each cycle."""

    a = OutPort(TimedLong)
    b = OutPort(TimedLong)
    step: int = Param(1)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.number = 0

    def on_reload(self, old: Component) -> None:
        self.number = getattr(old, "number", 0)

    def on_execute(self) -> None:
        self.number += 1
        for port in (self.a, self.b):
            with suppress(WouldBlock):
                port.write_nowait(TimedLong(data=self.number))


class CountBack(Count):
    """Writes the same."""


class Note(Component):
    """Keeps what it reads, with the connector that it came through."""

    x = InPort(TimedLong)
    y = InPort(TimedLong)
    most: int = Param(3)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[tuple[object, int]] = []

    def on_reload(self, old: Component) -> None:
        self.seen = getattr(old, "seen", [])

    def on_execute(self) -> None:
        for port in (self.x, self.y):
            self.seen += [(source, sample.data) for source, sample in port.drain(sources=True)[:100]]


class NoteAgain(Note):
    """Keeps the same."""


class Broken(Count):
    """Fails where it is told to."""

    where: str = Param("on_initialize")

    def on_initialize(self) -> None:
        self._fail("on_initialize")

    def on_startup(self) -> None:
        self._fail("on_startup")

    def on_activated(self) -> None:
        self._fail("on_activated")

    def _fail(self, hook: str) -> None:
        if self.where == hook:
            raise ValueError(f"broken in {hook}")
