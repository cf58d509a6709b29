"""Changes of a component take effect whole, between two cycles, while no hook of it runs.

A component that is active nowhere is changed at once. An awaited change is in force when the await returns. A hook
that would wait for itself does not wait, and the outcome of its change is logged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from aiorts.errors import AiortsError, TransitionTimeout
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.cycle import Action, Call
from aiorts.kernel.execution.file_access import carried
from aiorts.kernel.execution.hooks import HookKind
from aiorts.kernel.execution.runner import Logged
from aiorts.kernel.loop.tasks import current_task, kernel_task, owner_of
from aiorts.model.lifecycle import LifecycleState

if TYPE_CHECKING:
    import asyncio

    from aiorts.kernel.execution.cell import ComponentSide, KernelSide
    from aiorts.kernel.execution.cycle import Done, Steps

PATIENCE: Final = 5.0
"""Seconds of the kernel's clock until a change of parameters is given up: two hooks may wait for each other."""
Change = Callable[[], BaseException | None]
"""Carries out a change and returns None; or changes nothing and returns the reason. Raises nothing."""
_WHAT: Final = "change parameters"
_INACTIVE: Final = LifecycleState.INACTIVE


async def between_cycles(kernel: KernelSide, component: ComponentSide, change: Change) -> None:
    """Do `change` while no hook of the component runs; if one of its own hooks requests it, after that hook.

    Raises:
        TransitionTimeout: that moment did not come in time; nothing was changed. What `change` returns.
    """
    contexts, change = component.contexts, carried(change)
    if cell(component).entry_lock.open and (not contexts or _at_rest(component)):
        _raise(change())
    elif len(contexts) == 1:
        change = _counted(component, change) if contexts[0].runner.inside() else change
        await contexts[0].runner.ask([(_WHAT, lambda done: _steps(component, change, done))], PATIENCE)
    elif owner_of(current_task()) is component or any(context.runner.inside() for context in contexts):
        _later(kernel, component, _counted(component, change))
    else:
        await _through_lock(kernel, component, change)


def soon(kernel: KernelSide, component: ComponentSide, change: Change) -> None:
    """Do `change` between two cycles and do not wait for it; from the loop, or from a hook in its own thread."""
    change = _counted(component, carried(change))
    contexts = component.contexts
    if len(contexts) == 1 and (kernel.on_loop_thread() or contexts[0].exclusive):
        logged = Logged(component, _WHAT)
        contexts[0].runner.submit(Action(lambda: _steps(component, change, logged), logged))
    else:
        kernel.call_on_loop(lambda: _later(kernel, component, change))


def _at_rest(component: ComponentSide) -> bool:
    """Whether the component is active in no context, runs no hook, and has no earlier change waiting."""
    return (
        cell(component).running is None
        and not cell(component).changes_queued
        and all(member.state is _INACTIVE and not member.context.exclusive for member in cell(component).members)
    )


def _counted(component: ComponentSide, change: Change) -> Change:
    here = cell(component)  # of the place: another instance may be in it by then
    here.changes_queued += 1

    def counted() -> BaseException | None:
        here.changes_queued -= 1
        return change()

    return counted


def _raise(error: BaseException | None) -> None:
    if error is not None:
        raise error


def _steps(component: ComponentSide, change: Change, done: Done) -> Steps:
    if cell(component).entry_lock.open:
        done(change())
        return
    # The component serves a call now: the change waits for its turn, as a hook does.
    member = cell(component).members[0]
    outcome: list[BaseException | None] = []
    member.hooks["configure"] = HookKind.PLAIN, lambda: outcome.append(change())
    yield Call(member, "configure")
    done(outcome[0] if outcome else TransitionTimeout(f"{component.name}: abandoned before {_WHAT}"))


def _later(kernel: KernelSide, component: ComponentSide, change: Change) -> asyncio.Task[None]:
    return kernel_task(kernel.loop, _logged(kernel, component, change), f"aiorts configure {component.name}")


async def _logged(kernel: KernelSide, component: ComponentSide, change: Change) -> None:
    try:
        await (between_cycles if len(component.contexts) < 2 else _through_lock)(kernel, component, change)
    except AiortsError as error:
        Logged(component, _WHAT)(error)


async def _through_lock(kernel: KernelSide, component: ComponentSide, change: Change) -> None:
    lock = cell(component).entry_lock
    if not lock.open:
        turn: asyncio.Future[bool] = kernel.loop.create_future()
        timer = kernel.call_later(PATIENCE, lambda: None if turn.done() else turn.set_result(False))
        try:
            granted = await lock.wait(turn)
        finally:
            timer.cancel()
        if not granted:
            raise TransitionTimeout(f"{component.name}: its hooks did not end within {PATIENCE} s; nothing was changed")
    try:
        error = change()
    finally:
        lock.pass_on()
    _raise(error)
