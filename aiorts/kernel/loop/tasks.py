"""Tasks the kernel makes for itself, and how any task is waited for or given up; no user code is run here.

They are made without the host's task factory and belong to no component, also where a hook asked for them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextvars import Context
from typing import Any, TypeVar

T = TypeVar("T")


def kernel_task(
    loop: asyncio.AbstractEventLoop, coroutine: Coroutine[Any, Any, T], name: str, context: Context | None = None
) -> asyncio.Task[T]:
    """A task of the kernel's own, which starts at the loop's next turn; in the caller's context by default."""
    return asyncio.Task(coroutine, loop=loop, name=name, context=context)


async def see_through(task: asyncio.Future[T]) -> T:
    """The result of a task, waited for to its end even when the caller is cancelled; then the cancellation goes on."""
    from anyio import CancelScope  # late: 5 ms

    cancelled: asyncio.CancelledError | None = None
    # A cancel scope of the caller would deliver its cancellation at every turn.
    with CancelScope(shield=True):
        while not task.done():
            try:
                await asyncio.wait([task])
            except asyncio.CancelledError as error:
                cancelled = error
    if cancelled is not None:
        raise cancelled
    return task.result()


_LEFT_BEHIND: list[asyncio.Task[Any]] = []


def abandon_task(task: asyncio.Task[Any]) -> None:
    """Take a task that cannot be ended out of the loop's books, or `asyncio.run` would wait for it forever."""
    asyncio._unregister_task(task)
    # Kept for good: collected, its coroutine would be sent a GeneratorExit, and might ignore that one too, forever.
    _LEFT_BEHIND.append(task)
    task._log_destroy_pending = False  # type: ignore[attr-defined] # it is known and was reported


def owner_of(task: asyncio.Task[Any] | None) -> Any:
    """The component whose hook (or whose task) this is."""
    if task is None:
        return None
    component: Any = getattr(task, "_aiorts_component", None)
    if component is not None:
        return component
    driver = getattr(task, "_aiorts_driver", None)
    member = driver.current if driver is not None else None
    return None if member is None else member.component


def waiting_driver(task: Any) -> Any:
    """The driver of the hook that may wait for this task: it runs the hook itself, or one that made the task and still
    runs."""
    while task is not None and not task.done():
        driver = getattr(task, "_aiorts_driver", None)
        if driver is not None:
            return driver
        task = getattr(task, "_aiorts_creator", None)
        if isinstance(task, tuple):
            driver, run = task
            return driver if driver.run == run else None
    return None


def current_task() -> asyncio.Task[Any] | None:
    """The task that runs, None outside of tasks and loops."""
    try:
        return asyncio.current_task()
    except RuntimeError:
        return None


def throw(error: BaseException) -> None:
    """Raise it, as a callback: an interrupt leaves the loop this way."""
    raise error
