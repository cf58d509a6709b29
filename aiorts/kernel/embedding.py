"""What a kernel does to the loop it runs in: it wraps two things while it runs and leaves both as they were.

The task factory is called, never replaced, and each task that a component's hook makes is marked with that component;
so is what such a task makes in turn. A marked task that fails and whose exception nobody has asked for half a second
later is that component's failure; as long as the hook or the task that made it still runs, it may yet ask. The
exception handler is called likewise, after anything that belongs to a component's task was reported there.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel import naming
from aiorts.kernel.tasks import current_task, owner_of

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel

__all__ = ("Guest", "creator_of", "enter", "leave", "settle")

_ATTRIBUTE: Final = "_aiorts_guest"
UNCLAIMED_AFTER: Final = 0.5
"""Seconds in which somebody may still await a failed task of a component."""


class Guest:
    """The kernels that run on one loop, and what was there before the first of them."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.kernels: list[Kernel] = []
        self._unclaimed: dict[asyncio.Task[Any], asyncio.TimerHandle] = {}
        self._factory = loop.get_task_factory()
        self._handler = loop.get_exception_handler()
        self._our_factory: Any = self._make_task
        self._our_handler: Any = self._handle
        loop.set_task_factory(self._our_factory)
        loop.set_exception_handler(self._our_handler)

    def restore(self) -> None:
        """Put back what was there, unless somebody has wrapped it since: then ours just passes through."""
        if self.loop.get_task_factory() is self._our_factory:
            self.loop.set_task_factory(self._factory)
        if self.loop.get_exception_handler() is self._our_handler:
            self.loop.set_exception_handler(self._handler)

    def _make_task(self, loop: asyncio.AbstractEventLoop, coroutine: Any, **options: Any) -> Any:
        if self._factory is not None:
            task: Any = self._factory(loop, coroutine, **options)
        else:
            task = asyncio.Task(coroutine, loop=loop, **options)
        creator = current_task()
        owner = owner_of(creator)
        if owner is not None and owner._rt_kernel in self.kernels:
            task._aiorts_component = owner
            task._aiorts_creator = creator_of(creator)
            owner._rt_kernel._roster.adopt(owner, task)
            task.add_done_callback(self._task_done)
        return task

    def _task_done(self, task: asyncio.Task[Any]) -> None:
        # Asking for the exception would count as claiming it, so only the mark is looked at.
        if not task.cancelled() and getattr(task, "_log_traceback", False):
            self._unclaimed[task] = self.loop.call_later(UNCLAIMED_AFTER, self._look_again, task)

    def _look_again(self, task: asyncio.Task[Any]) -> None:
        if getattr(task, "_log_traceback", False) and _still_runs(task):
            self._unclaimed[task] = self.loop.call_later(UNCLAIMED_AFTER, self._look_again, task)
        else:
            self._blame(task)

    def _blame(self, task: asyncio.Task[Any]) -> None:
        self._unclaimed.pop(task).cancel()
        if not getattr(task, "_log_traceback", False):
            return  # somebody has awaited it, or asked for its exception
        error = task.exception()
        owner: Component = task._aiorts_component  # type: ignore[attr-defined] # marked by _make_task
        if error is not None and owner._rt_kernel is not None:
            owner._rt_kernel._roster.task_failed(owner, task.get_name(), error)

    def settle(self, kernel: Kernel) -> None:
        """Nobody of `kernel` will ask any more: what failed is reported now."""
        for task in tuple(self._unclaimed):
            if task._aiorts_component._rt_kernel is kernel:  # type: ignore[attr-defined] # marked by _make_task
                self._blame(task)

    def _handle(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        task: Any = context.get("task") or context.get("future")
        error = context.get("exception")
        owner: Component | None = getattr(task, "_aiorts_component", None)
        if owner is not None and owner._rt_kernel is not None and error is not None:
            owner._rt_kernel._roster.task_failed(owner, task.get_name(), error)
            return
        if self._handler is not None:
            self._handler(loop, context)
        else:
            loop.default_exception_handler(context)


def enter(kernel: Kernel, loop: asyncio.AbstractEventLoop) -> None:
    """A kernel starts to run on `loop`."""
    guest: Guest | None = getattr(loop, _ATTRIBUTE, None)
    if guest is None:
        guest = Guest(loop)
        setattr(loop, _ATTRIBUTE, guest)
    guest.kernels.append(kernel)
    naming.opened(kernel)


def leave(kernel: Kernel, loop: asyncio.AbstractEventLoop) -> None:
    """A kernel has closed: with the last one the loop is as it was found."""
    naming.closed(kernel)
    guest: Guest | None = getattr(loop, _ATTRIBUTE, None)
    if guest is not None and kernel in guest.kernels:
        guest.kernels.remove(kernel)
        if not guest.kernels:
            guest.restore()
            delattr(loop, _ATTRIBUTE)


def settle(kernel: Kernel, loop: asyncio.AbstractEventLoop) -> None:
    """Report the failed tasks of the kernel's components that nobody has asked for yet."""
    guest: Guest | None = getattr(loop, _ATTRIBUTE, None)
    if guest is not None:
        guest.settle(kernel)


def creator_of(task: Any) -> Any:
    """Who made a task, so that one can tell whether it still runs: one run of a hook, or a task."""
    driver = getattr(task, "_aiorts_driver", None)
    return task if driver is None else (driver, driver.run)


def _still_runs(task: Any) -> bool:
    creator = task._aiorts_creator
    if isinstance(creator, tuple):
        driver, run = creator
        return bool(driver.run == run)
    return not creator.done()
