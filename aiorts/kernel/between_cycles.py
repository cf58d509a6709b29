"""When a change of a component takes effect: while no hook of it runs, between two cycles, whole; never in a hook.

A component that is active nowhere is changed at once. Whoever awaits a change knows afterwards that it is in force; a
hook that would wait for itself is not made to wait, and what becomes of its change is logged.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from aiorts.errors import AiortsError, TransitionTimeout
from aiorts.kernel.hooks import HookKind
from aiorts.kernel.life import Action, Call
from aiorts.kernel.tasks import current_task, kernel_task, owner_of
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    import asyncio

    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.life import Done, Steps

__all__ = ("PATIENCE", "Change", "between_cycles", "soon")

PATIENCE: Final = 5.0
"""Seconds of the kernel's clock until a change of parameters is given up: two hooks may wait for each other's."""
Change = Callable[[], BaseException | None]
"""What is to be done; it returns what it was refused for, with nothing changed, and raises nothing."""
_WHAT: Final = "change parameters"
_LOG = logging.getLogger("aiorts.kernel")
_INACTIVE: Final = LifeCycleState.INACTIVE


async def between_cycles(kernel: Kernel, component: Component, change: Change) -> None:
    """Do `change` while no hook of the component runs; asked for by one of its own hooks: afterwards.

    Raises:
        TransitionTimeout: that moment did not come in time; nothing was changed. What `change` returns.
    """
    contexts = component.contexts
    if component._rt_gate.open and (not contexts or _at_rest(component)):
        _raise(change())
    elif len(contexts) == 1:
        change = _counted(component, change) if contexts[0]._inside() else change
        await contexts[0]._ask([(_WHAT, lambda done: _steps(component, change, done))], PATIENCE)
    elif owner_of(current_task()) is component or any(context._inside() for context in contexts):
        _later(kernel, component, _counted(component, change))
    else:
        await _through_gate(kernel, component, change)


def soon(kernel: Kernel, component: Component, change: Change) -> None:
    """Do `change` between two cycles and do not wait for it; from the loop, or from a hook in its own thread."""
    change = _counted(component, change)
    contexts = component.contexts
    if len(contexts) == 1 and (kernel.on_loop_thread() or contexts[0].exclusive):
        told = _Told(component)
        contexts[0]._submit(Action(lambda: _steps(component, change, told), told))
    else:
        kernel._on_loop(lambda: _later(kernel, component, change))


def _at_rest(component: Component) -> bool:
    """Whether it is active nowhere, runs no hook, and nothing that was asked for before is still to be done."""
    return (
        component._rt_running is None
        and not component._rt_changes_queued
        and all(member.state is _INACTIVE and not member.context.exclusive for member in component._rt_members)
    )


def _counted(component: Component, change: Change) -> Change:
    component._rt_changes_queued += 1

    def counted() -> BaseException | None:
        component._rt_changes_queued -= 1
        return change()

    return counted


def _raise(error: BaseException | None) -> None:
    if error is not None:
        raise error


def _steps(component: Component, change: Change, done: Done) -> Steps:
    if component._rt_gate.open:
        done(change())
        return
    # A call is served there: it waits for its turn, as a hook does.
    member = component._rt_members[0]
    outcome: list[BaseException | None] = []
    member.hooks["configure"] = HookKind.PLAIN, lambda: outcome.append(change())
    yield Call(member, "configure")
    done(outcome[0] if outcome else TransitionTimeout(f"{component.name}: left behind before {_WHAT}"))


class _Told:
    """Who is told of a change that nobody waits for."""

    def __init__(self, component: Component) -> None:
        self._component = component

    def __call__(self, error: BaseException | None) -> None:
        if error is not None:
            _LOG.warning("%s: queued request to %s failed: %s", self._component.name, _WHAT, error)


def _later(kernel: Kernel, component: Component, change: Change) -> asyncio.Task[None]:
    return kernel_task(kernel.loop, _logged(kernel, component, change), f"aiorts configure {component.name}")


async def _logged(kernel: Kernel, component: Component, change: Change) -> None:
    try:
        await (between_cycles if len(component.contexts) < 2 else _through_gate)(kernel, component, change)
    except AiortsError as error:
        _Told(component)(error)


async def _through_gate(kernel: Kernel, component: Component, change: Change) -> None:
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
        error = change()
    finally:
        gate.pass_on()
    _raise(error)
