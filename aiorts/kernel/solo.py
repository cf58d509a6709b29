"""Hooks that belong to no execution context, `on_initialize` and `on_finalize`: each runs in a task of its own.

The same containment as in a context (`bulkhead.py`), for one hook: what it raises is returned, what ignores
cancellation is left behind.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from aiorts.errors import HookAbandoned, HookTimeout, StateError
from aiorts.kernel.bulkhead import CANCELLATIONS, GRACE, StopBudget, leave_behind
from aiorts.kernel.bus import HookAfter, HookBefore
from aiorts.kernel.hooks import HookKind

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel

__all__ = ("run_alone",)


async def run_alone(kernel: Kernel, component: Component, hook: str, budget: StopBudget | None) -> BaseException | None:
    """Run one hook; what it raised, or None. With a budget it is cancelled when that is used up."""
    watched = kernel.bus.hooks_wanted
    if watched:
        kernel.bus.publish(HookBefore(component.name, "", hook))
    error = None
    if component._hook_kinds[hook] != HookKind.ABSENT:
        error = await _contain(kernel, component, hook, budget)
    if watched:
        kernel.bus.publish(HookAfter(component.name, "", hook, error))
    return error


async def _contain(kernel: Kernel, component: Component, hook: str, budget: StopBudget | None) -> BaseException | None:
    task = kernel.loop.create_task(_run(component, hook), name=f"aiorts {component.name}.{hook}")
    task._aiorts_component = component  # type: ignore[attr-defined] # read by embedding.owner_of
    try:
        if budget is None:
            await asyncio.wait([task])
        else:
            await asyncio.wait([task], timeout=max(0.05, budget.limit))
    except asyncio.CancelledError:
        # The caller was cancelled: so is the hook, and its end is waited for a little.
        await _cancel(task, StopBudget(kernel.loop, 0.0))
        raise
    if task.done():
        error = task.result()
        if isinstance(error, KeyboardInterrupt):
            kernel._interrupted(error)
        return error
    if await _cancel(task, budget):
        return HookTimeout(f"{component.name}.{hook}: did not return in time; it was cancelled")
    return HookAbandoned(f"{component.name}.{hook}: ignored {CANCELLATIONS} cancellations; it was left behind")


async def _cancel(task: asyncio.Task[Any], budget: StopBudget | None) -> bool:
    """Cancel once for each grace step; False when the task was left behind."""
    for _ in range(CANCELLATIONS):
        task.cancel()
        done, _pending = await asyncio.wait([task], timeout=GRACE if budget is None else budget.grace)
        if done:
            return True
    leave_behind(task)
    return False


async def _run(component: Component, hook: str) -> BaseException | None:
    """Never raises: a KeyboardInterrupt in a task would end the loop, a CancelledError would look like ours."""
    try:
        result = getattr(component, hook)()
        if component._hook_kinds[hook] == HookKind.ASYNC:
            result = await result
    except BaseException as error:
        if isinstance(error, GeneratorExit) and asyncio._get_running_loop() is None:
            raise
        return error
    if result is None:
        return None
    if asyncio.iscoroutine(result):
        result.close()
    return StateError(f"{component.name}.{hook}: returned {result!r:.60}; a hook returns nothing")
