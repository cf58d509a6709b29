"""The changes that a kernel makes to the loop it runs in: it wraps two things and leaves both as they were.

The task factory is called, never replaced, and each task that a component's hook makes is marked with that component;
so is what such a task makes in turn. A marked task that fails and whose exception was not asked for half a second
later is that component's failure; as long as the hook or the task that made it still runs, it may yet ask. The
exception handler is called likewise, after anything that belongs to a component's task was reported there.

SystemExit and KeyboardInterrupt would end the loop from within any task. In a component's task they are what that task
failed with, as any other exception is.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import ComponentError, format_error
from aiorts.kernel import naming
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.guarded import GUEST, guarded
from aiorts.kernel.loop.tasks import current_task, owner_of, throw

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import ComponentSide, KernelSide
    from aiorts.kernel.loop.guarded import KernelLine

UNCLAIMED_AFTER: Final = 0.5
"""Seconds in which a failed task of a component may still be awaited."""
_LINES: Final = 100
"""Lines that can still be read."""


class Guest:
    """The kernels that run on one loop, and what was there before the first of them."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.kernels: list[KernelSide] = []
        self.last_lines: deque[KernelLine] = deque(maxlen=_LINES)
        """The newest lines of the kernels' own log."""
        self._unclaimed: dict[asyncio.Task[Any], asyncio.TimerHandle] = {}
        self._factory = loop.get_task_factory()
        self._handler = loop.get_exception_handler()
        self._our_factory: Any = self._make_task
        self._our_handler: Any = self._handle
        loop.set_task_factory(self._our_factory)
        loop.set_exception_handler(self._our_handler)

    def restore(self) -> None:
        """Put back what was there, unless other code has wrapped it since: then ours just passes through."""
        if self.loop.get_task_factory() is self._our_factory:
            self.loop.set_task_factory(self._factory)
        if self.loop.get_exception_handler() is self._our_handler:
            self.loop.set_exception_handler(self._handler)

    def _make_task(self, loop: asyncio.AbstractEventLoop, coroutine: Any, **options: Any) -> Any:
        creator = current_task()
        owner = owner_of(creator)
        kernel = None if owner is None else cell(owner).kernel
        if kernel not in self.kernels:
            kernel = None
        if kernel is not None and isinstance(coroutine, Coroutine):
            coroutine = _Contained(coroutine)
        if self._factory is not None:
            task: Any = self._factory(loop, coroutine, **options)
        else:
            task = asyncio.Task(coroutine, loop=loop, **options)
        if owner is not None and kernel is not None:
            task._aiorts_component = owner
            task._aiorts_creator = creator_of(creator)
            kernel.registry.adopt(owner, task)
            task.add_done_callback(self._task_done)
        return task

    def _task_done(self, task: asyncio.Task[Any]) -> None:
        # Asking for the exception would count as claiming it, so only the mark is looked at.
        if task.cancelled() or not getattr(task, "_log_traceback", False):
            return
        if type(getattr(task, "_exception", None)) is _Interrupted:
            # The sender waits for the end of the process: the exception is not kept back for a later question.
            self._blame(task)
        else:
            self._unclaimed[task] = self.loop.call_later(UNCLAIMED_AFTER, self._look_again, task)

    def _look_again(self, task: asyncio.Task[Any]) -> None:
        if getattr(task, "_log_traceback", False) and _still_runs(task):
            self._unclaimed[task] = self.loop.call_later(UNCLAIMED_AFTER, self._look_again, task)
        else:
            self._blame(task)

    def _blame(self, task: asyncio.Task[Any]) -> None:
        if task in self._unclaimed:
            self._unclaimed.pop(task).cancel()
        if not getattr(task, "_log_traceback", False):
            return  # it was awaited, or asked for its exception
        error = task.exception()
        if type(error) in (_Ended, _Interrupted) and error is not None:
            error = error.__cause__  # the exception that was meant to end more than the task
        owner: ComponentSide = task._aiorts_component  # type: ignore[attr-defined] # marked by _make_task
        if error is not None and (kernel := cell(owner).kernel) is not None:
            kernel.registry.task_failed(owner, task.get_name(), error)

    def settle(self, kernel: KernelSide) -> None:
        """Report what failed: no code of `kernel` will ask for it any more."""
        for task in tuple(self._unclaimed):
            if cell(task._aiorts_component).kernel is kernel:  # type: ignore[attr-defined] # marked by _make_task
                self._blame(task)

    def _handle(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        task: Any = context.get("task") or context.get("future")
        error = context.get("exception")
        owner: ComponentSide | None = getattr(task, "_aiorts_component", None)
        if owner is not None and error is not None and (whose := cell(owner).kernel) is not None:
            whose.registry.task_failed(owner, task.get_name(), error)
            return
        if self._handler is not None:
            self._handler(loop, context)
        else:
            guarded("could not log an error of the loop", loop.default_exception_handler, context)

    def interrupted(self, error: BaseException) -> bool:
        """A KeyboardInterrupt struck while something was recorded: pass it on, unless a kernel contains them."""
        if any(kernel._contain_interrupts for kernel in self.kernels):
            return False
        self.loop.call_soon(throw, error)
        return True


class _Ended(ComponentError):
    """A component's task raised SystemExit."""


class _Interrupted(_Ended):
    """A component's task raised KeyboardInterrupt."""


class _Contained(Coroutine[Any, Any, Any]):
    """A component's coroutine: what would end the loop from within its task is an exception of the task."""

    __slots__ = ("_inner", "_send")

    def __init__(self, inner: Coroutine[Any, Any, Any]) -> None:
        self._inner = inner
        self._send = inner.send

    def send(self, value: Any) -> Any:
        try:
            return self._send(value)
        except (SystemExit, KeyboardInterrupt) as error:
            raise _ended(error) from error

    def throw(self, *error: Any) -> Any:
        try:
            return self._inner.throw(*error)
        except (SystemExit, KeyboardInterrupt) as raised:
            raise _ended(raised) from raised

    def close(self) -> None:
        self._inner.close()

    def __await__(self) -> Any:
        return self._inner.__await__()

    def __getattr__(self, name: str) -> Any:
        """`cr_frame` and its like: stacks and messages show the coroutine itself."""
        return getattr(self._inner, name)


def _ended(error: BaseException) -> _Ended:
    kind = _Interrupted if issubclass(type(error), KeyboardInterrupt) else _Ended
    return kind(f"a task that a component started raised {format_error(error)}")


def enter(kernel: KernelSide, loop: asyncio.AbstractEventLoop) -> None:
    """A kernel starts to run on `loop`."""
    guest: Guest | None = getattr(loop, GUEST, None)
    if guest is None:
        guest = Guest(loop)
        setattr(loop, GUEST, guest)
    guest.kernels.append(kernel)
    naming.opened(kernel)


def leave(kernel: KernelSide, loop: asyncio.AbstractEventLoop) -> None:
    """A kernel has closed: with the last one the loop is as it was found."""
    naming.closed(kernel)
    guest: Guest | None = getattr(loop, GUEST, None)
    if guest is not None and kernel in guest.kernels:
        guest.kernels.remove(kernel)
        if not guest.kernels:
            guest.restore()
            delattr(loop, GUEST)


def settle(kernel: KernelSide, loop: asyncio.AbstractEventLoop) -> None:
    """Report the failed tasks of the kernel's components whose exception was not retrieved yet."""
    guest: Guest | None = getattr(loop, GUEST, None)
    if guest is not None:
        guest.settle(kernel)


def last_lines(loop: asyncio.AbstractEventLoop) -> tuple[KernelLine, ...]:
    """The last lines of the own log of the kernels on this loop."""
    guest: Guest | None = getattr(loop, GUEST, None)
    return () if guest is None else tuple(guest.last_lines)


def creator_of(task: Any) -> Any:
    """The creator of a task: one run of a hook, or a task; so that it is known whether the creator still runs."""
    driver = getattr(task, "_aiorts_driver", None)
    return task if driver is None else (driver, driver.run)


def _still_runs(task: Any) -> bool:
    """Whether what made the task may yet ask for it; a caller in whose step a served method made it never does."""
    creator, owner = task._aiorts_creator, task._aiorts_component
    if isinstance(creator, tuple):
        driver, run = creator
        return bool(driver.run == run) and driver.current is not None and driver.current.component is owner
    return not creator.done() and owner_of(creator) is owner
