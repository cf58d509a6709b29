"""Threads that stand still between two cycles while the loop changes what is connected to their components."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Final

from aiorts.errors import TransitionTimeout
from aiorts.kernel.between_cycles import between_cycles
from aiorts.kernel.execution.context import Context
from aiorts.kernel.loop.tasks import kernel_task

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel

_LONGEST: Final = 5.0
"""The most seconds that a thread stands still."""


@asynccontextmanager
async def threads_paused(kernel: Microkernel, components: Iterable[Component]) -> AsyncGenerator[None]:
    """A context manager in which these components run no hook in a thread. Its body must not wait for such a hook.

    Raises:
        TransitionTimeout: a hook did not end in time; the body was not run.
    """
    by_context: dict[Context, Component] = {}
    for component in components:
        by_context |= {context: component for context in component.contexts if context.kind == "thread"}
    goes_on = threading.Event()
    pauses = []
    reached: list[asyncio.Future[None]] = []
    try:
        for component in by_context.values():
            still: asyncio.Future[None] = kernel.loop.create_future()
            reached.append(still)
            pause = between_cycles(kernel, component, _Pause(kernel, still, goes_on))
            pauses.append(kernel_task(kernel.loop, pause, f"aiorts pause {component.name}"))
        for still, pausing in zip(reached, pauses, strict=True):
            await asyncio.wait((still, pausing), return_when=asyncio.FIRST_COMPLETED)
            if not still.done():
                await pausing
                raise TransitionTimeout(f"{pausing.get_name()}: its thread did not stand still")
        yield
    finally:
        goes_on.set()
        await asyncio.gather(*pauses, return_exceptions=True)


class _Pause:
    """A pause of a thread between two cycles: it reports that it stands still, and waits."""

    def __init__(self, kernel: Microkernel, still: asyncio.Future[None], goes_on: threading.Event) -> None:
        self._kernel, self._still, self._goes_on = kernel, still, goes_on

    def __call__(self) -> None:
        self._kernel.call_on_loop(self._reached)
        if not self._kernel.on_loop_thread():
            self._goes_on.wait(_LONGEST)

    def _reached(self) -> None:
        if not self._still.done():
            self._still.set_result(None)
