"""Hooks that belong to no execution context, `on_initialize` and `on_finalize`: each runs in a task of its own.

The same containment as in a context (`bulkhead.py`), for one hook: what it raises is returned, what ignores
cancellation is left behind.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from aiorts.errors import ClosedError, HookAbandoned, HookTimeout
from aiorts.kernel.bus import HookAfter, HookBefore
from aiorts.kernel.deadlines import CANCELLATIONS, StopBudget
from aiorts.kernel.hooks import HookKind, bad_return
from aiorts.kernel.tasks import kernel_task, leave_behind, see_through

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel

__all__ = ("run_alone",)


async def run_alone(
    kernel: Kernel,
    component: Component,
    hook: str,
    budget: StopBudget | None,
    *args: Any,
    limit: float | None = None,
) -> BaseException | None:
    """Run one hook; what it raised, or None.

    With a budget it is cancelled when that is used up, without when the kernel closes; and when the caller is
    cancelled, whose cancellation goes on once the hook has ended.

    Args:
        limit: seconds after which it is cancelled where there is no budget; None for none.
    """
    watched = kernel.bus.hooks_wanted
    if watched:
        kernel.bus.publish(HookBefore(component.name, "", hook))
    error = None
    if component._rt_hook_kinds[hook] != HookKind.ABSENT:
        error = await _contain(kernel, component, hook, budget, args, limit)
    if watched:
        kernel.bus.publish(HookAfter(component.name, "", hook, error))
    return error


async def _contain(
    kernel: Kernel,
    component: Component,
    hook: str,
    budget: StopBudget | None,
    args: tuple[Any, ...],
    limit: float | None,
) -> BaseException | None:
    where = f"{component.name}.{hook}"
    task = kernel_task(kernel.loop, _run(component, hook, args), f"aiorts {where}")
    task._aiorts_component = component  # type: ignore[attr-defined] # read by tasks.owner_of
    closing = kernel._closing_begun
    waited: list[asyncio.Future[Any]] = [task] if budget is not None else [task, closing]
    try:
        await asyncio.wait(
            waited, timeout=limit if budget is None else budget.limit, return_when=asyncio.FIRST_COMPLETED
        )
    except asyncio.CancelledError:
        await see_through(kernel_task(kernel.loop, _cancel(task, StopBudget(kernel.loop, 0.0)), f"aiorts end {where}"))
        raise
    if task.done():
        return task.result()
    rest = budget or (closing.result() if closing.done() else StopBudget(kernel.loop, 0.0))
    ended = await see_through(kernel_task(kernel.loop, _cancel(task, rest), f"aiorts end {where}"))
    if not ended:
        component._rt_abandoned = HookAbandoned(f"{where}: ignored {CANCELLATIONS} cancellations; it was left behind")
        return component._rt_abandoned
    if budget is None and closing.done():
        return ClosedError(f"{where}: the kernel closed before it returned; it was cancelled")
    return HookTimeout(f"{where}: did not return in time; it was cancelled")


async def _cancel(task: asyncio.Task[Any], budget: StopBudget) -> bool:
    """Cancel once for each grace step; False when the task was left behind."""
    for _ in range(CANCELLATIONS):
        task.cancel()
        done, _pending = await asyncio.wait([task], timeout=budget.grace)
        if done:
            return True
    leave_behind(task)
    return False


async def _run(component: Component, hook: str, args: tuple[Any, ...]) -> BaseException | None:
    """Never raises: a KeyboardInterrupt in a task would end the loop, a CancelledError would look like ours."""
    try:
        result = getattr(component, hook)(*args)
        if component._rt_hook_kinds[hook] == HookKind.ASYNC:
            result = await result
    except BaseException as error:
        if isinstance(error, GeneratorExit) and asyncio._get_running_loop() is None:
            raise
        return error
    return None if result is None else bad_return(component, hook, result)
