"""Who asked this process to end, and how long the end may take.

The first SIGINT or SIGTERM asks the kernel for an orderly stop, the second ends the process at once, also when the
event loop is blocked: Python runs the handler between two instructions of whatever blocks it. Once a stop began, the
process is gone within `LONGEST_STOP` seconds, whatever threads or hooks are left.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from aiorts import Kernel

__all__ = ("LONGEST_STOP", "Stopper")

LONGEST_STOP: Final = 4.8
_SIGNALS: Final = ("SIGINT", "SIGTERM")


class Stopper:
    """What asks one run of a system to end.

    status: what a signal, or a reader that has gone, makes the exit status; None when nobody has asked.
    output_failed: whether what the system said was lost, because a disk is full.
    """

    def __init__(self) -> None:
        self.status: int | None = None
        self.output_failed = False
        self._kernel: Kernel | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._watched = False
        self._outcome = 1

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
        if not self._watched:
            self._watched = True
            threading.Thread(target=self._end_late, name="aiorts stop", daemon=True).start()

    def _end_late(self) -> None:
        time.sleep(LONGEST_STOP)
        with contextlib.suppress(OSError, ValueError):
            if sys.stderr is not None:
                sys.stderr.write("aiorts: E-STOP: not everything ended in time; the process ends now\n")
        os._exit(self._outcome if self.status is None else self.status)

    def end_now(self, status: int) -> None:
        """End the process here: a hook that was left behind would not let the interpreter come to its end."""
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                if stream is not None:
                    stream.flush()
        os._exit(status)

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """Take SIGINT and SIGTERM, and give them back as they were."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        taken = [getattr(signal, name) for name in _SIGNALS if hasattr(signal, name)]
        before: dict[Any, Any] = {number: signal.signal(number, self._handle) for number in taken}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def _handle(self, number: int, frame: object) -> None:
        if self.status is not None or self._kernel is None:
            os._exit(130 if number == signal.SIGINT or self.status is not None else 128 + number)
        self.request(128 + number)
