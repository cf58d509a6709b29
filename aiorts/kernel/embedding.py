"""What a kernel does to the loop it runs in: it wraps two things while it runs and leaves both as they were.

The task factory is called, never replaced, and each task that a component's hook makes is marked with that component;
so is what such a task makes in turn. A marked task that fails and whose exception nobody has asked for half a second
later is that component's failure. The exception handler is called likewise, after anything that belongs to a
component's task was reported there.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel

__all__ = ("Guest", "enter", "leave", "owner_of")

_ATTRIBUTE: Final = "_aiorts_guest"
UNCLAIMED_AFTER: Final = 0.5
"""Seconds in which somebody may still await a failed task of a component."""


class Guest:
    """The kernels that run on one loop, and what was there before the first of them."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.kernels: list[Kernel] = []
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
        owner = owner_of(_current_task())
        if owner is not None and self.kernels:
            task._aiorts_component = owner
            if owner._kernel is not None:
                owner._kernel._adopt(task)
            task.add_done_callback(self._task_done)
        return task

    def _task_done(self, task: asyncio.Task[Any]) -> None:
        # Asking for the exception would count as claiming it, so only the mark is looked at.
        if not task.cancelled() and getattr(task, "_log_traceback", False):
            self.loop.call_later(UNCLAIMED_AFTER, self._claim, task)

    def _claim(self, task: asyncio.Task[Any]) -> None:
        if not getattr(task, "_log_traceback", False):
            return  # somebody has awaited it, or asked for its exception
        error = task.exception()
        owner: Component | None = getattr(task, "_aiorts_component", None)
        if error is not None and owner is not None and owner._kernel is not None:
            owner._kernel._task_failed(owner, task, error)

    def _handle(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        task: Any = context.get("task") or context.get("future")
        error = context.get("exception")
        owner: Component | None = getattr(task, "_aiorts_component", None)
        if owner is not None and owner._kernel is not None and error is not None:
            owner._kernel._task_failed(owner, task, error)
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


def leave(kernel: Kernel, loop: asyncio.AbstractEventLoop) -> None:
    """A kernel has closed: with the last one the loop is as it was found."""
    guest: Guest | None = getattr(loop, _ATTRIBUTE, None)
    if guest is not None and kernel in guest.kernels:
        guest.kernels.remove(kernel)
        if not guest.kernels:
            guest.restore()
            delattr(loop, _ATTRIBUTE)


def owner_of(task: asyncio.Task[Any] | None) -> Component | None:
    """The component whose hook (or whose task) this is."""
    if task is None:
        return None
    component: Component | None = getattr(task, "_aiorts_component", None)
    if component is not None:
        return component
    driver = getattr(task, "_aiorts_driver", None)
    member = driver.current if driver is not None else None
    return None if member is None else member.component


def _current_task() -> asyncio.Task[Any] | None:
    try:
        return asyncio.current_task()
    except RuntimeError:
        return None
