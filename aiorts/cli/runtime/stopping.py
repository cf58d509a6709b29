"""The end of the process: requests to stop, and the limit of the time that a stop may take.

The first SIGINT, SIGTERM or SIGHUP asks the kernel for an orderly stop. The second ends the process at once, even when
the event loop is blocked: Python runs the handler between two instructions of the blocking code. Once a stop began, the
process ends within `LONGEST_STOP` seconds, whatever threads or hooks are left. SIGUSR1 prints a dump and ends nothing.
SIGQUIT is left to the system.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import threading

# Not from `threading`: code that a signal's handler interrupts may hold its locks.
from _thread import LockType, allocate_lock, start_new_thread
from collections.abc import Callable, Iterator
from itertools import count
from typing import TYPE_CHECKING, Any, Final

from aiorts import exits
from aiorts.cli.runtime.dump import dump, dumping_stacks, where_now
from aiorts.kernel.service import linger

if TYPE_CHECKING:
    from aiorts import Kernel

LONGEST_STOP: Final = 4.8
_SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP")
_WATCHING: Final[list[Stopper]] = []


class Stopper:
    """The requests to end one run of a system.

    status: the exit status by a signal, or by a reader that has gone; None when no end was requested.
    output_failed: whether output of the system was lost, because a disk is full.
    last_words: functions that are called before the process is ended at once; they may not wait.
    """

    def __init__(self) -> None:
        self.status: int | None = None
        self.output_failed = False
        self.last_words: list[Callable[[], None]] = []
        self._kernel: Kernel | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._lingers = False
        self._over: LockType | None = None
        """The lock that is released when the watched end has come; None: no end is watched."""
        self._outcome = exits.FAILED
        self._signals = count()

    def attach(self, kernel: Kernel) -> None:
        """Send requests to this kernel from now on, also a request that came before."""
        self._kernel = kernel
        self._loop = asyncio.get_running_loop()
        if self.status is not None:
            kernel.request_stop(self.status)

    def request(self, status: int) -> None:
        """Request the end; the first request decides the status. From any thread, and from a signal handler."""
        if self.status is not None:
            return
        self.status = status
        self.watch(status)
        if self._kernel is not None and self._loop is not None:
            # Also in the loop's own thread: a plain call would not wake a loop that waits for events.
            with contextlib.suppress(RuntimeError):  # the loop is closed: there is nothing left to stop
                self._loop.call_soon_threadsafe(self._kernel.request_stop, status)

    def watch(self, status: int) -> None:
        """Watch an end that has begun: a process that is late is ended by force."""
        self._outcome = status
        if self._over is None:
            self._over = over = allocate_lock()
            over.acquire()
            _WATCHING.append(self)
            start_new_thread(self._end_late, (over,))

    def _end_late(self, over: LockType) -> None:
        # Each watch has its own lock: with a common lock, a new watch would get the release meant for another.
        if over.acquire(timeout=LONGEST_STOP):
            return  # the run is over, and the process goes on
        what = f"not everything ended in {LONGEST_STOP} s{where_now()}; the process ends now"
        self.end_now(self._outcome if self.status is None else self.status, f"aiorts: E-STOP: {what}\n")

    def end_now(self, status: int, text: str = "") -> None:
        """End the process at once, without waiting: leftover threads would keep the interpreter from its end.

        Args:
            text: printed on standard error, if that can be written.
        """
        told = allocate_lock()
        told.acquire()
        # In a thread: the stream may have no reader, or code interrupted in a write may hold it.
        start_new_thread(self._say_last, (text, told))
        told.acquire(timeout=0.2)
        os._exit(status)

    def _say_last(self, text: str, told: LockType) -> None:
        for word in self.last_words:
            word()
        for stream, last in ((sys.stdout, ""), (sys.stderr, text)):
            with contextlib.suppress(OSError, ValueError, RuntimeError):
                if stream is not None:
                    stream.write(last)
                    stream.flush()
        told.release()

    def linger(self, status: int) -> None:
        """Let services that still show the ended run go on without a time limit; a signal ends them."""
        if self._kernel is None or self.status is not None:
            return
        self.over()
        self._lingers = True
        try:
            linger(self._kernel.services, status)
        except KeyboardInterrupt:
            pass
        finally:
            self._lingers = False
            self.watch(status)

    def over(self) -> None:
        """Note that the run has ended: the process is not watched any more."""
        over, self._over = self._over, None
        if over is not None:
            over.release()

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """Handle the signals during the block, and restore the earlier handlers after it."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        taken = [getattr(signal, name) for name in _SIGNALS if hasattr(signal, name)]
        before: dict[Any, Any] = {}
        for number in taken:
            if number != getattr(signal, "SIGHUP", None) or signal.getsignal(number) is not signal.SIG_IGN:  # nohup
                before[number] = signal.signal(number, self._handle)
        if hasattr(signal, "SIGUSR1"):
            before[signal.SIGUSR1] = signal.signal(signal.SIGUSR1, self._tell)
        try:
            with dumping_stacks():
                yield
        finally:
            for number, handler in before.items():
                signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def _handle(self, number: int, frame: object) -> None:
        if self._lingers:
            raise KeyboardInterrupt
        # Counted in one step: the second signal may interrupt the handler of the first.
        if next(self._signals) or self.status is not None or self._kernel is None:
            self.end_now(exits.of_signal(number))
        self.request(exits.of_signal(number))

    def _tell(self, number: int, frame: object) -> None:
        dump(self._kernel, self._loop)


def watch_no_more() -> None:
    """End all watches: the runs are over and the process goes on, so it must not be ended for them."""
    while _WATCHING:
        _WATCHING.pop().over()
