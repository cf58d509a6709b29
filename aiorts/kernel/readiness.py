"""Waits until components are where they are to be, and says who is not; it asks nobody for anything."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from aiorts.errors import ClosedError, DeclarationError, TransitionTimeout, said
from aiorts.kernel.bus import Event
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel

__all__ = ("missing", "names_of", "until", "wait_ready")


async def until(kernel: Kernel, ready: Callable[[], bool], timeout: float | None) -> bool:
    """Wait for a moment when `ready`, asked after each event of the bus; False after `timeout` s of the kernel's clock.

    Raises:
        ClosedError: the kernel closes.
    """
    if ready():
        return True
    late: asyncio.Future[bool] = kernel.loop.create_future()

    def look(_event: Event | None = None) -> None:
        # While it closes components leave: then nobody is missing, and nothing is ready.
        if not late.done() and not kernel._closed and ready():
            late.set_result(True)

    def expire() -> None:
        if not late.done():
            late.set_result(False)

    unsubscribe = kernel.bus.subscribe(Event, look)
    timer = None if timeout is None else kernel.call_later(timeout, expire)
    waited: list[asyncio.Future[Any]] = [late, kernel._closing_begun]
    try:
        await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
        if not late.done():
            raise ClosedError(f"{kernel.name}: closes")
        return late.result()
    finally:
        unsubscribe()
        late.cancel()
        if timer is not None:
            timer.cancel()


async def wait_ready(kernel: Kernel, components: Sequence[Component | str], timeout: float | None) -> None:
    """See `Kernel.wait_ready`."""
    names = names_of(components)
    if not await until(kernel, lambda: not missing(kernel, names), timeout):
        raise TransitionTimeout(f"{kernel.name}: not ready within {timeout} s: {'; '.join(missing(kernel, names))}")


def names_of(components: Sequence[Component | str]) -> tuple[str, ...]:
    """Their names. DeclarationError: one is neither a component nor a name."""
    names = tuple(one if isinstance(one, str) else getattr(one, "name", None) for one in components)
    for one, name in zip(components, names, strict=True):
        if not isinstance(name, str):
            raise DeclarationError(f"{one!r:.80}: expected components or their names, one argument each")
    return names  # type: ignore[return-value] # all of them are


def missing(kernel: Kernel, names: Sequence[str] = ()) -> list[str]:
    """Who is not active (of these, or of all that are in a context), and what is known about why."""
    wanted = names or [name for name, component in kernel.components.items() if component.contexts]
    found = []
    for name in wanted:
        component = kernel.components.get(name)
        if component is None:
            found.append(f"{name} is not there")
            continue
        states = component.states
        if states and all(s is LifeCycleState.ACTIVE for s in states.values()):
            continue
        if component.has_finished:
            continue
        where = ", ".join(f"{state} in {context}" for context, state in states.items()) or "in no context"
        error = component.last_error
        why = "" if error is None else f" ({said(error)})"
        found.append(f"{name} is {where}{why}")
    return found
