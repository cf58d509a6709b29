"""A call from another thread, which blocks until the loop has carried it out."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Any, Protocol

from aiorts.errors import CallTimeout, ClosedError
from aiorts.kernel.loop.tasks import kernel_task


class Called(Protocol):
    """The kernel, as far as a call needs it."""

    name: str
    closed: bool
    closing: asyncio.Future[Any]

    @property
    def loop(self) -> asyncio.AbstractEventLoop: ...


def call_from_thread(kernel: Called, function: Callable[..., Any], args: tuple[Any, ...], seconds: float | None) -> Any:
    """See `Microkernel.call_from_thread`."""
    call = _Call(kernel, function, args)
    if kernel.closed:
        raise call.closed()
    try:
        kernel.loop.call_soon_threadsafe(call.begin)
        if not wait((call.answer,), None if seconds is None else min(seconds, threading.TIMEOUT_MAX)).done:
            kernel.loop.call_soon_threadsafe(call.withdraw)
            raise CallTimeout(f"{call.what}: was not done within {seconds:g} s; what had begun is cancelled")
    except RuntimeError as error:
        if isinstance(error, ClosedError) or not kernel.loop.is_closed():
            raise
        raise call.closed() from None
    return call.answer.result()


class _Call:
    """A call for which one thread waits."""

    def __init__(self, kernel: Called, function: Callable[..., Any], args: tuple[Any, ...]) -> None:
        self.kernel, self.function, self.args = kernel, function, args
        self.what = f"{kernel.name}: call_from_thread({getattr(function, '__name__', function)!s:.60})"
        self.answer: Future[Any] = Future()
        self.withdrawn = False
        self.task: asyncio.Task[None] | None = None

    def closed(self) -> ClosedError:
        return ClosedError(f"{self.what}: the kernel is closing, or closed")

    # -- on the loop -----------------------------------------------------------------------------------------------

    def begin(self) -> None:
        if self.withdrawn:
            return
        if self.kernel.closed:
            self.answer.set_exception(self.closed())
            return
        self.task = kernel_task(self.kernel.loop, self.run(), f"aiorts {self.what}")
        self.task.add_done_callback(self.end)
        self.kernel.closing.add_done_callback(self.withdraw)

    def withdraw(self, _: object = None) -> None:
        self.withdrawn = True
        if self.task is not None:
            self.task.cancel()

    async def run(self) -> None:
        try:
            value = self.function(*self.args)
            if inspect.isawaitable(value):
                value = await value
        except asyncio.CancelledError as error:
            self.answer.set_exception(self.closed() if self.withdrawn else error)
        except BaseException as error:  # noqa: BLE001 - it is the thread's affair
            self.answer.set_exception(error)
        else:
            self.answer.set_result(value)

    def end(self, _: object) -> None:
        self.kernel.closing.remove_done_callback(self.withdraw)
        if not self.answer.done():  # cancelled before its first step
            self.answer.set_exception(self.closed())
