"""Waits until components have the required states, and reports those that have not."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from aiorts.errors import ClosedError, DeclarationError, TransitionTimeout, format_error
from aiorts.kernel.loop.bus import Event
from aiorts.model.lifecycle import LifecycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel


async def until(kernel: Microkernel, ready: Callable[[], bool], timeout: float | None) -> bool:
    """Wait until `ready`, evaluated after each event of the bus; False after `timeout` s of the kernel's clock.

    Raises:
        ClosedError: the kernel closes.
    """
    if ready():
        return True
    late: asyncio.Future[bool] = kernel.loop.create_future()

    def look(_event: Event | None = None) -> None:
        # Components leave while the kernel closes: none is missing then, but none is ready.
        if not late.done() and not kernel.closed and ready():
            late.set_result(True)

    def expire() -> None:
        if not late.done():
            late.set_result(False)

    unsubscribe = kernel.bus.subscribe(Event, look)
    timer = None if timeout is None else kernel.call_later(timeout, expire)
    waited: list[asyncio.Future[Any]] = [late, kernel.closing]
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


async def wait_ready(kernel: Microkernel, components: Sequence[Component | str], timeout: float | None) -> None:
    """See `Kernel.wait_ready`."""
    names = names_of(components)
    if not await until(kernel, lambda: not missing(kernel, names), timeout):
        raise TransitionTimeout(f"{kernel.name}: not ready within {timeout} s: {'; '.join(missing(kernel, names))}")


def names_of(components: Sequence[Component | str]) -> tuple[str, ...]:
    """The names of components. DeclarationError: an item is neither a component nor a name."""
    names = tuple(one if isinstance(one, str) else getattr(one, "name", None) for one in components)
    for one, name in zip(components, names, strict=True):
        if not isinstance(name, str):
            raise DeclarationError(f"{one!r:.80}: expected components or their names, one argument each")
    return names  # type: ignore[return-value] # all of them are


def missing(kernel: Microkernel, names: Sequence[str] = ()) -> list[str]:
    """The components that are not active (of these, or of all in a context), and the known reasons."""
    wanted = names or [name for name, component in kernel.components.items() if component.contexts]
    found = []
    for name in wanted:
        component = kernel.components.get(name)
        if component is None:
            found.append(f"{name} is not there")
            continue
        states = component.states
        if states and all(s is LifecycleState.ACTIVE for s in states.values()):
            continue
        if component.has_finished:
            continue
        where = ", ".join(f"{state} in {context}" for context, state in states.items()) or "in no context"
        error = component.last_error
        why = "" if error is None else f" ({format_error(error)})"
        found.append(f"{name} is {where}{why}")
    return found
