"""The requests that concern a component and its contexts together, and the check that no hook waits for itself.

A hook that starts a context with its own component would wait for itself: it does not wait.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal

from aiorts.errors import ConfigurationError, DeclarationError, InvalidNameError, StateError
from aiorts.kernel.component import Component
from aiorts.kernel.execution.apart import check_apart
from aiorts.kernel.execution.cell import as_group, check_free, flattened, group_among
from aiorts.kernel.execution.context import Context
from aiorts.kernel.loop.deadlines import StopBudget
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import current_task, kernel_task, owner_of, see_through
from aiorts.kernel.ports.port import give_turn
from aiorts.model.ordering import arrange
from aiorts.model.values import shown
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel

_LOG = KernelLog()


def check_start(kernel: Microkernel, context: Context, components: Sequence[Component]) -> None:
    """Make every check that may refuse a start, before anything is changed; give the context a name."""
    if not isinstance(context, Context):
        raise DeclarationError(f"{context!r}: expected an execution context such as PeriodicContext(rate=100.0)")
    if context.running or (context.name and kernel.contexts.get(context.name) is context):
        raise StateError(f"{context.name}: runs already")
    for component in components:
        kernel.check_mine(component, "start a context with")
        if as_group(component) is None:
            context.runner.check_can_add(component)
    if group_among(components) is not None:
        check_free(components, "start")
        for group in filter(None, map(as_group, components)):
            group.check_startable()
    running = flattened(components)
    if len(set(map(id, running))) != len(running) or len(set(map(id, components))) != len(components):
        raise StateError(f"{context.name or context.kind}: a component was given twice")
    check_apart(running, (), context.name or context.kind)
    if not context.runner.named and (context.name == "" or context.name in kernel.contexts):
        context.name = kernel._free_name(context.kind or type(context).__name__)
    if context.name in kernel.contexts:
        raise InvalidNameError(f"{context.name}: there is a context of that name already; choose another")


async def start(
    kernel: Microkernel, context: Context, components: Sequence[Component], *, activate: bool, timeout: float | None
) -> None:
    """Start a context that was checked; when the caller is cancelled, or it cannot begin, nothing of it stays."""
    kernel._pool.look_out()
    group = group_among(components)
    beginning = _start if group is None else group.start
    queued = owner_of(current_task()) in flattened(components)
    steps = beginning(kernel, context, components, activate=activate, timeout=None if queued else timeout)
    starting = kernel_task(kernel.loop, steps, f"aiorts start {context.name}")
    if queued:
        starting.add_done_callback(lambda task: _after_start(kernel, context, task))
        await give_turn()
        return
    try:
        await asyncio.shield(starting)
    except asyncio.CancelledError:
        await see_through(kernel_task(kernel.loop, _undo(kernel, context, starting), f"aiorts stop {context.name}"))
        raise
    finally:
        _forget_unless_running(kernel, context)


async def _start(
    kernel: Microkernel, context: Context, components: Sequence[Component], *, activate: bool, timeout: float | None
) -> None:
    context.runner.divide(None)
    await context.runner.begin(kernel, components, activate=activate, timeout=timeout)


async def _undo(kernel: Microkernel, context: Context, starting: asyncio.Task[None]) -> None:
    # It was made first, so it has taken its first step and has a driver, or it has failed.
    await context.runner.end(StopBudget(kernel.loop))
    await asyncio.wait([starting])
    await context.runner.end(StopBudget(kernel.loop))  # members of composites had to leave others first
    if not starting.cancelled():
        starting.exception()


def _after_start(kernel: Microkernel, context: Context, task: asyncio.Task[None]) -> None:
    error = None if task.cancelled() else task.exception()
    _forget_unless_running(kernel, context)
    if error is not None:
        _LOG.warning("%s: queued request to start %s failed: %s", kernel.name, context.name, error)


def _forget_unless_running(kernel: Microkernel, context: Context) -> None:
    if not context.running:
        context.runner.let_go()
        kernel._context_ended(context)


def arrange_contexts(kernel: Microkernel, names: Iterable[str]) -> None:
    """Put the contexts with these names in this order; other contexts follow."""
    arrange(kernel._contexts, names)


async def request(
    kernel: Microkernel,
    what: Literal["activate", "deactivate", "reset"],
    component: Component | str,
    context: Context | str | None,
    timeout: float | None,
) -> None:
    """Ask for a transition of a component in the context in which it is; a composite that is in none asks its members.

    Raises:
        InvalidNameError: a text is no path.
        WiringError: there is no component of that path.
        StateError: the component is in no context, or in several and none is named; or there is no such context.
        ConfigurationError: `context` is neither a context nor a name.
    """
    kernel.check_reachable(what)
    found: Any = kernel.find(component) if isinstance(component, str) else component
    if not isinstance(found, Component):
        path = component if isinstance(component, str) else getattr(found, "path", None) or shown(found)
        raise StateError(f"cannot {what} {path}: it is no component; give a component or its name")
    name = found.name
    if kernel.components.get(name) is not found:
        raise StateError(kernel.registry.stranger(found, name, kernel.name))
    group = as_group(found)
    if group is not None and group.is_spread and context is None:
        await group.request(what, timeout)
        return
    where = _context(kernel, what, found) if context is None else _named(kernel, context)
    if group is not None and where in found.contexts:
        await group.request(what, timeout)  # what it makes of it, such as all or none
        return
    await getattr(where, what)(found, timeout=timeout)


def _context(kernel: Microkernel, what: str, component: Component) -> Context:
    """The only context of a component."""
    contexts = component.contexts
    if len(contexts) == 1:
        return contexts[0]
    if not contexts:
        raise StateError(f"{component.name}: cannot {what}: it is in no context; kernel.start one with it")
    names = ", ".join(context.name for context in contexts)
    raise StateError(
        f"{component.name}: cannot {what}: it is in {len(contexts)} contexts, {names}; "
        f"say which: context={contexts[0].name!r}"
    )


def _named(kernel: Microkernel, context: Context | str) -> Context:
    if isinstance(context, Context):
        return context
    if not isinstance(context, str):
        raise ConfigurationError(f"context = {shown(context)}: expected a context or its name")
    there = kernel.contexts
    if context not in there:
        raise StateError(f"no context {context[:100]!r} runs in {kernel.name}; {suggestion(context, there)}")
    return there[context]
