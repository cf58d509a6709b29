"""What concerns a component and its contexts together, and who would wait for himself if he waited for it.

A hook that starts a context with its own component, or changes parameters, is in the way of what it asks for: it is
not made to wait.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from aiorts.errors import DeclarationError, InvalidNameError, StateError, TransitionTimeout
from aiorts.kernel.deadlines import StopBudget
from aiorts.kernel.port import give_turn
from aiorts.kernel.tasks import current_task, kernel_task, owner_of, see_through
from aiorts.kernel.unfold import check_free, composed, unfolded

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.life import Done, Steps

__all__ = ("between_cycles", "check_start", "start")

PATIENCE: Final = 5.0
"""Seconds of the kernel's clock until a change of parameters is given up: two hooks may wait for each other's."""
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


async def between_cycles(kernel: Kernel, component: Component, change: Callable[[], None]) -> None:
    """Run `change` while no hook of the component runs; asked for by one of its own hooks: afterwards.

    Raises:
        TransitionTimeout: that moment did not come in time; nothing was changed.
    """
    contexts = component.contexts
    if not contexts:
        change()
    elif len(contexts) == 1:
        await contexts[0]._ask([("change parameters", lambda done: _steps(change, done))], PATIENCE)
    elif any(context._inside() for context in contexts):
        kernel_task(kernel.loop, _logged(kernel, component, change), f"aiorts configure {component.name}")
    else:
        await _through_gate(kernel, component, change)


def _steps(change: Callable[[], None], done: Done) -> Steps:
    change()
    done(None)
    yield from ()


async def _through_gate(kernel: Kernel, component: Component, change: Callable[[], None]) -> None:
    gate = component._rt_gate
    if not gate.open:
        turn: asyncio.Future[bool] = kernel.loop.create_future()
        timer = kernel.call_later(PATIENCE, lambda: None if turn.done() else turn.set_result(False))
        try:
            granted = await gate.wait(turn)
        finally:
            timer.cancel()
        if not granted:
            raise TransitionTimeout(f"{component.name}: its hooks did not end within {PATIENCE} s; nothing was changed")
    try:
        change()
    finally:
        gate.pass_on()


async def _logged(kernel: Kernel, component: Component, change: Callable[[], None]) -> None:
    try:
        await _through_gate(kernel, component, change)
    except TransitionTimeout as error:
        _LOG.warning("%s: queued change of %s failed: %s", kernel.name, component.name, error)
