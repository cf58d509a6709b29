"""Hooks that belong to no execution context, `on_initialize` and `on_finalize`: each runs in a task of its own.

The same containment as in a context (`execution/task_driver.py`), for one hook: what it raises is returned, what
ignores cancellation is abandoned.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any

from aiorts.errors import ClosedError, HookAbandoned, HookTimeout
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.file_access import own_context
from aiorts.kernel.execution.hook_timeout import too_late
from aiorts.kernel.execution.hooks import HookKind, bad_return
from aiorts.kernel.loop.bus import HookAfter, HookBefore
from aiorts.kernel.loop.deadlines import CANCELLATIONS, StopBudget
from aiorts.kernel.loop.tasks import abandon_task, kernel_task, see_through

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import ComponentSide, KernelSide


async def run_alone(
    kernel: KernelSide,
    component: ComponentSide,
    hook: str,
    budget: StopBudget | None,
    *args: Any,
    limit: float | None = None,
) -> BaseException | None:
    """Run one hook; what it raised, or None.

    With a budget it is cancelled when that is used up, without when the kernel closes; and when the caller is
    cancelled, whose cancellation goes on once the hook has ended.

    Args:
        limit: seconds of the kernel's clock after which it is cancelled where there is no budget, or judged when it
            returns if it blocks the loop; None for none.
    """
    observed = kernel.bus.hooks_wanted
    if observed:
        kernel.bus.publish(HookBefore(component.name, "", hook))
    error = None
    if cell(component).hook_kinds[hook] != HookKind.ABSENT:
        error = await _contain(kernel, component, hook, budget, args, limit)
    if observed:
        kernel.bus.publish(HookAfter(component.name, "", hook, error))
    return error


async def _contain(
    kernel: KernelSide,
    component: ComponentSide,
    hook: str,
    budget: StopBudget | None,
    args: tuple[Any, ...],
    limit: float | None,
) -> BaseException | None:
    where = f"{component.name}.{hook}"
    limit = limit if budget is None else None
    task = kernel_task(kernel.loop, _run(kernel, component, hook, args, limit), f"aiorts {where}", own_context())
    task._aiorts_component = component  # type: ignore[attr-defined] # read by tasks.owner_of
    closing = kernel.closing
    waited: list[asyncio.Future[Any]] = [task] if budget is not None else [task, closing]
    timer = None
    if limit is not None:
        late: asyncio.Future[Any] = kernel.loop.create_future()
        waited.append(late)
        timer = kernel.call_later(limit, partial(late.set_result, None))
    real = None if budget is None else budget.limit
    try:
        await asyncio.wait(waited, timeout=real, return_when=asyncio.FIRST_COMPLETED)
    except asyncio.CancelledError:
        await see_through(kernel_task(kernel.loop, _cancel(task, StopBudget(kernel.loop, 0.0)), f"aiorts end {where}"))
        raise
    finally:
        if timer is not None:
            timer.cancel()
    if task.done():
        return task.result()
    rest = budget or (closing.result() if closing.done() else StopBudget(kernel.loop, 0.0))
    ended = await see_through(kernel_task(kernel.loop, _cancel(task, rest), f"aiorts end {where}"))
    if not ended:
        cell(component).abandoned = HookAbandoned(f"{where}: ignored {CANCELLATIONS} cancellations; it was abandoned")
        return cell(component).abandoned
    if budget is None and closing.done():
        return ClosedError(f"{where}: the kernel closed before it returned; it was cancelled")
    within = "in time" if limit is None else f"within {limit:g} s"
    return HookTimeout(f"{where}: did not return {within}; it was cancelled")


async def _cancel(task: asyncio.Task[Any], budget: StopBudget) -> bool:
    """Cancel once for each grace step; False when the task was abandoned."""
    for _ in range(CANCELLATIONS):
        task.cancel()
        done, _pending = await asyncio.wait([task], timeout=budget.grace)
        if done:
            return True
    abandon_task(task)
    return False


async def _run(
    kernel: KernelSide, component: ComponentSide, hook: str, args: tuple[Any, ...], limit: float | None
) -> BaseException | None:
    """Never raises: a KeyboardInterrupt in a task would end the loop, a CancelledError would look like ours."""
    begun_ns = kernel.clock.monotonic_ns()
    try:
        result = getattr(component, hook)(*args)
        if cell(component).hook_kinds[hook] == HookKind.ASYNC:
            result = await result
    except BaseException as error:
        if issubclass(type(error), GeneratorExit) and asyncio._get_running_loop() is None:
            raise
        return error
    if result is not None:
        return bad_return(component.name, hook, result)
    return too_late(f"{component.name}.{hook}", kernel.clock.monotonic_ns() - begun_ns, limit)
