"""Who asked this process to end, and how long the end may take.

The first SIGINT, SIGTERM or SIGHUP asks the kernel for an orderly stop, the second ends the process at once, also when
the event loop is blocked: Python runs the handler between two instructions of whatever blocks it. Once a stop began,
the process is gone within `LONGEST_STOP` seconds, whatever threads or hooks are left. SIGUSR1 tells what goes on, and
ends nothing. SIGQUIT is left to the system.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import threading

# Not of `threading`: its locks may be held by whoever a signal's handler has interrupted.
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
    """What asks one run of a system to end.

    status: what a signal, or a reader that has gone, makes the exit status; None when nobody has asked.
    output_failed: whether what the system said was lost, because a disk is full.
    last_words: called before the process is ended at once; may not wait for anything.
    """

    def __init__(self) -> None:
        self.status: int | None = None
        self.output_failed = False
        self.last_words: list[Callable[[], None]] = []
        self._kernel: Kernel | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._lingers = False
        self._over: LockType | None = None
        """The lock that is released when the end that is watched has come; None: no end is watched."""
        self._outcome = exits.FAILED
        self._signals = count()

    def attach(self, kernel: Kernel) -> None:
        """From now on it is this kernel that is asked."""
        self._kernel = kernel
        self._loop = asyncio.get_running_loop()
        if self.status is not None:
            kernel.request_stop(self.status)

    def request(self, status: int) -> None:
        """Ask for the end; the first who asks decides the status. From any thread, and from a signal handler."""
        if self.status is not None:
            return
        self.status = status
        self.watch(status)
        if self._kernel is not None and self._loop is not None:
            # Also in the loop's own thread: a plain call would not wake a loop that waits for events.
            with contextlib.suppress(RuntimeError):  # the loop is closed: there is nothing left to stop
                self._loop.call_soon_threadsafe(self._kernel.request_stop, status)

    def watch(self, status: int) -> None:
        """The end has begun: see to it that it comes."""
        self._outcome = status
        if self._over is None:
            self._over = over = allocate_lock()
            over.acquire()
            _WATCHING.append(self)
            start_new_thread(self._end_late, (over,))

    def _end_late(self, over: LockType) -> None:
        # Each watch has its own lock: with one for all, a new watch took the release that was meant for another.
        if over.acquire(timeout=LONGEST_STOP):
            return  # the run is over, and the process has other things to do
        what = f"not everything ended in {LONGEST_STOP} s{where_now()}; the process ends now"
        self.end_now(self._outcome if self.status is None else self.status, f"aiorts: E-STOP: {what}\n")

    def end_now(self, status: int, text: str = "") -> None:
        """End the process here, without waiting for anything: what is left would keep the interpreter from its end.

        Args:
            text: said on standard error, if that takes it.
        """
        told = allocate_lock()
        told.acquire()
        # In a thread: nobody may read, and who was interrupted in the middle of a write holds the stream.
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
        """Let services of the run wait, such as one that still shows it; a signal ends that, and no limit of time."""
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
        """The run has ended: what is left of the process is no affair of it any longer."""
        over, self._over = self._over, None
        if over is not None:
            over.release()

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """Take the signals, and give them back as they were."""
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
        # Counted in one step: the second signal may come in the middle of the first one's handler.
        if next(self._signals) or self.status is not None or self._kernel is None:
            self.end_now(exits.of_signal(number))
        self.request(exits.of_signal(number))

    def _tell(self, number: int, frame: object) -> None:
        dump(self._kernel, self._loop)


def watch_no_more() -> None:
    """The runs are over, and their process goes on with other things: it is not to be ended for their sake."""
    while _WATCHING:
        _WATCHING.pop().over()
