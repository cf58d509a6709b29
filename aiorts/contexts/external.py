"""A context driven from outside: `await tick()` runs exactly one cycle and returns when it is over."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from aiorts.errors import ClosedError, StateError
from aiorts.kernel.execution.context import Context, Deadline, Timing
from aiorts.kernel.execution.cycle import Wait

if TYPE_CHECKING:
    from aiorts.kernel.execution.member import Member


class ExternalContext(Context):
    """Runs one cycle for each `tick()`, which a program or a simulator calls.

    Args: see `Context`.
    """

    kind: ClassVar[str] = "external"

    def __init__(self, *, name: str = "", deadline: Deadline = None, timing: Timing = True) -> None:
        super().__init__(name=name, deadline=deadline, timing=timing)
        self._requested: deque[asyncio.Future[None]] = deque()
        self._over: list[asyncio.Future[None]] = []

    async def tick(self, count: int = 1) -> None:
        """Run `count` cycles, one after the other; ticks of several tasks queue up, none is lost.

        Effects of a cycle (a failure, a deactivation) are complete when this returns. A tick that is cancelled before
        its cycle began is withdrawn.

        Raises:
            StateError: called from a hook of this context, which would wait for itself.
            ClosedError: the context stopped.
        """
        kernel = self.runner.check("tick")
        if self.runner.inside():
            raise StateError(f"{self.name}: tick() from a hook of this context would wait for itself")
        for _ in range(count):
            over: asyncio.Future[None] = kernel.loop.create_future()
            self._requested.append(over)
            if self.runner.driver is not None:
                self.runner.driver.kick()
            await over

    def tick_from_thread(self, count: int = 1, *, timeout: float | None = None) -> None:
        """`tick` for another thread, such as a simulator's: blocks it until `count` cycles are over.

        Args:
            timeout: seconds of real time; None waits forever.

        Raises:
            CallTimeout: the cycles were not over in time; those that had not begun are withdrawn.
            ThreadError: called on the loop's own thread.
            StateError: the context does not run.
            ClosedError: the context stopped, or the kernel closes.
        """
        kernel = self._kernel
        if kernel is None:
            raise StateError(f"{self.name}: cannot tick_from_thread: the context does not run; kernel.start it")
        kernel.call_from_thread(self.tick, count, timeout=timeout)

    def _next_cause(self) -> Wait | None:
        over, self._over = self._over, []
        for future in over:
            if not future.done():
                future.set_result(None)
        while self._requested and self._requested[0].done():
            self._requested.popleft()
        return None if self._requested else Wait(None)

    def _begin_cycle(self) -> Sequence[Member]:
        self._over.append(self._requested.popleft())
        return super()._begin_cycle()

    def _life_ended(self, error: BaseException | None) -> None:
        for future in (*self._over, *self._requested):
            if not future.done():
                future.set_exception(ClosedError(f"{self.name}: the context has stopped"))
        self._over, self._requested = [], deque()
        super()._life_ended(error)
