"""Components that note what happens to them and when, for the tests of execution contexts."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from aiorts import Component, InPort, OutPort
from aiorts.types import TimedLong

S = 1_000_000_000
MS = 1_000_000


class Idle(Component):
    """Has no hooks."""


class Ticker(Component):
    """Notes the moment of every execution; takes `takes` seconds of the kernel's clock for it."""

    def __init__(self, name: str = "", takes: float | Callable[[], float] = 0.0) -> None:
        super().__init__(name)
        self.takes = takes
        self.begun: list[int] = []

    async def on_execute(self) -> None:
        self.begun.append(self.clock.monotonic_ns())
        takes = self.takes if isinstance(self.takes, float) else self.takes()
        if takes:
            await self.sleep(takes)


class Diary(Component):
    """Writes every hook of its own into a diary that may be shared."""

    def __init__(self, name: str, diary: list[tuple[Any, ...]]) -> None:
        super().__init__(name)
        self.diary = diary

    def note(self, hook: str) -> None:
        self.diary.append((self.name, hook))

    def on_startup(self) -> None:
        self.note("startup")

    def on_shutdown(self) -> None:
        self.note("shutdown")

    async def on_activated(self) -> None:
        self.note("activated")

    async def on_deactivated(self) -> None:
        self.note("deactivated")

    async def on_execute(self) -> None:
        self.note("execute")

    async def on_state_update(self) -> None:
        self.note("update")

    async def on_rate_changed(self) -> None:
        self.note("rate")


class Doer(Component):
    """Does what it is told in its hooks: `activated`, `execute`, `deactivated` are functions without argument."""

    def __init__(
        self,
        name: str = "",
        *,
        execute: Callable[[], Awaitable[None]] | None = None,
        activated: Callable[[], Awaitable[None]] | None = None,
        deactivated: Callable[[], Awaitable[None]] | None = None,
        reset: Callable[[], Awaitable[None]] | None = None,
    ) -> None:
        super().__init__(name)
        self.execute, self.activated, self.deactivated, self.reset = execute, activated, deactivated, reset

    async def on_activated(self) -> None:
        if self.activated is not None:
            await self.activated()

    async def on_execute(self) -> None:
        if self.execute is not None:
            await self.execute()

    async def on_deactivated(self) -> None:
        if self.deactivated is not None:
            await self.deactivated()

    async def on_reset(self) -> None:
        if self.reset is not None:
            await self.reset()


class Sender(Component):
    """An out-port for the test to write to."""

    output = OutPort(TimedLong)

    def send(self, *values: int) -> None:
        for value in values:
            self.output.write_nowait(TimedLong(0, value))


class Reader(Component):
    """Takes up to `share` samples in each execution and notes them."""

    input = InPort(TimedLong)

    def __init__(self, name: str = "", share: int = 1000) -> None:
        super().__init__(name)
        self.share = share
        self.runs: list[list[int]] = []

    async def on_execute(self) -> None:
        taken: list[int] = []
        while len(taken) < self.share and self.input.is_new:
            taken.append(self.input.read_nowait().data)
        self.runs.append(taken)
