"""What concerns a component and its contexts together, and who would wait for himself if he waited for it.

A hook that starts a context with its own component is in the way of what it asks for: it is not made to wait.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING

from aiorts.errors import DeclarationError, InvalidNameError, StateError
from aiorts.kernel.deadlines import StopBudget
from aiorts.kernel.port import give_turn
from aiorts.kernel.tasks import current_task, kernel_task, owner_of, see_through
from aiorts.kernel.unfold import check_free, composed, unfolded

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel

__all__ = ("check_start", "start")

_LOG = logging.getLogger("aiorts.kernel")


def check_start(kernel: Kernel, context: Context, components: Sequence[Component]) -> None:
    """Everything that says no to a start, before anything is changed; the context has a name afterwards."""
    from aiorts.kernel.context import Context

    if not isinstance(context, Context):
        raise DeclarationError(f"{context!r}: expected an execution context such as PeriodicContext(rate=100.0)")
    if context.running or (context.name and kernel._contexts.get(context.name) is context):
        raise StateError(f"{context.name}: runs already")
    for component in components:
        kernel._check_mine(component, "start a context with")
        if not component._rt_composes:
            context._check_can_add(component)
    if composed(components):
        from aiorts.kernel.composition_check import check_startable

        check_free(components, "start")
        check_startable([component for component in components if component._rt_composes])
    running = unfolded(components)
    if len(set(map(id, running))) != len(running) or len(set(map(id, components))) != len(components):
        raise StateError(f"{context.name or context.kind}: a component was given twice")
    if not context._named and (context.name == "" or context.name in kernel._contexts):
        context.name = kernel._free_name(context.kind or type(context).__name__)
    if context.name in kernel._contexts:
        raise InvalidNameError(f"{context.name}: there is a context of that name in {kernel.name}; choose another")


async def start(kernel: Kernel, context: Context, components: Sequence[Component], *, activate: bool) -> None:
    """Start a context that was checked; when the caller is cancelled, or it cannot begin, nothing of it stays."""
    kernel._pool.look_out()
    beginning = _start
    if composed(components):
        from aiorts.kernel.membership import start as beginning
    starting = kernel_task(
        kernel.loop, beginning(kernel, context, components, activate=activate), f"aiorts start {context.name}"
    )
    if owner_of(current_task()) in unfolded(components):
        starting.add_done_callback(lambda task: _after_start(kernel, context, task))
        await give_turn()
        return
    try:
        await asyncio.shield(starting)
    except asyncio.CancelledError:
        await see_through(kernel_task(kernel.loop, _undo(context, starting), f"aiorts stop {context.name}"))
        raise
    finally:
        _forget_unless_running(kernel, context)


async def _start(kernel: Kernel, context: Context, components: Sequence[Component], *, activate: bool) -> None:
    context._sections = ()
    await context._start(kernel, components, activate=activate)


async def _undo(context: Context, starting: asyncio.Task[None]) -> None:
    # It was made first, so it has taken its first step and has a driver, or it has failed.
    if context._kernel is not None:
        await context._stop(StopBudget(context._kernel.loop))
    await asyncio.wait([starting])
    if context._driver is not None and context._kernel is not None:
        await context._stop(StopBudget(context._kernel.loop))  # members of composites had to leave others first
    if not starting.cancelled():
        starting.exception()


def _after_start(kernel: Kernel, context: Context, task: asyncio.Task[None]) -> None:
    error = None if task.cancelled() else task.exception()
    _forget_unless_running(kernel, context)
    if error is not None:
        _LOG.warning("%s: queued request to start %s failed: %s", kernel.name, context.name, error)


def _forget_unless_running(kernel: Kernel, context: Context) -> None:
    if context._driver is None:
        for member in tuple(reversed(context._members)):
            context._detach(member)
        kernel._context_ended(context)
