"""The thread that waits for the timers of all contexts and loops of the process, without the interpreter lock.

The thread exists while there is a timer, and not in the child of a fork.
"""

from __future__ import annotations

import os
import select
import threading
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, Protocol

from aiorts.kernel.loop import timers
from aiorts.kernel.loop.guarded import KernelLog

if TYPE_CHECKING:
    from aiorts.kernel.loop.timers import _Timerfd as Timerfd

_LOG = KernelLog()
_NEVER: Final = 2**62


class Monitored(Protocol):
    """An object with a timer here: of a context (`deadline_monitor.py`), or of a loop (`loop_monitor.py`)."""

    _fd: int
    _timer: Timerfd | None
    _good_until_ns: int
    _finalizer: Any

    def ring(self, timer: Timerfd) -> None: ...


class _MonitorThread:
    """The thread that waits for all timers of the process."""

    def __init__(self) -> None:
        self.monitored: dict[int, weakref.ref[Monitored]] = {}
        self.ending = False
        self._epoll = select.epoll()
        try:
            self._bell = os.eventfd(0, os.EFD_CLOEXEC)
        except OSError:
            self._epoll.close()
            raise
        self._epoll.register(self._bell, select.EPOLLIN)
        self.thread = threading.Thread(target=self._run, name="aiorts monitor", daemon=True)
        self.thread.start()

    def add(self, fd: int, one: Monitored) -> None:
        # Edge-triggered: a timer that is set again expires again, without a read in between.
        self._epoll.register(fd, select.EPOLLIN | select.EPOLLET)
        self.monitored[fd] = weakref.ref(one)

    def remove(self, fd: int) -> None:
        del self.monitored[fd]
        self._epoll.unregister(fd)
        os.close(fd)

    def end(self) -> None:
        """End the thread and wait for it, unless this is it."""
        self.ending = True
        os.eventfd_write(self._bell, 1)
        if threading.current_thread() is not self.thread:
            self.thread.join(1.0)

    def drop(self) -> None:
        """Forget the thread in the child of a fork: it does not exist there, and its descriptors are shared."""
        for fd in (*self.monitored, self._bell):
            os.close(fd)
        self._epoll.close()
        for ref in self.monitored.values():
            one = ref()
            if one is not None:
                one._timer, one._good_until_ns, one._fd = None, _NEVER, -1
                one._finalizer.detach()
        self.monitored.clear()

    def _run(self) -> None:
        timer = timers.find_timerfd()
        while not self.ending and timer is not None:
            for fd, _ in self._epoll.poll():
                ref = self.monitored.get(fd)
                one = None if ref is None else ref()
                if one is not None:
                    _ring(one, timer)
                del one
        os.eventfd_read(self._bell)  # `end` writes after `ending` is set: it may be closed only then
        self._epoll.close()
        os.close(self._bell)


def _ring(one: Monitored, timer: Timerfd) -> None:
    try:
        one.ring(timer)
    except Exception:  # noqa: BLE001 - what it looks at changes under it; a diagnosis may fail, its thread may not
        _LOG.debug("a glance for %r failed", one, exc_info=True)


_LOCK = threading.RLock()
_THREAD: list[_MonitorThread] = []
_FORKS: list[Callable[[], Any]] = []


def lock() -> threading.RLock:
    """Held while a descriptor is set, so that it is not closed and reused meanwhile."""
    return _LOCK


def timer_count() -> int:
    """The number of timers waited for."""
    return len(_THREAD[0].monitored) if _THREAD else 0


def join(one: Monitored) -> None:
    """Make the thread wait for the timer of this object, too. OSError, RuntimeError when that fails."""
    with _LOCK:
        if not _THREAD:
            _THREAD.append(_MonitorThread())
            if not _FORKS:
                _FORKS.append(_forked)
                os.register_at_fork(after_in_child=_forked)
        _THREAD[0].add(one._fd, one)


def leave(fd: int) -> None:
    """Close this timer; after the last the thread ends."""
    # Re-entrant: an object that was never closed is collected with its context, at any time.
    with _LOCK:
        if _THREAD and fd in _THREAD[0].monitored:
            thread = _THREAD[0]
            thread.remove(fd)
            if thread.monitored:
                return
            _THREAD.clear()
        else:
            return
    thread.end()  # its thread may be waiting for the lock


def _forked() -> None:
    global _LOCK
    _LOCK = threading.RLock()
    for thread in _THREAD:
        thread.drop()
    _THREAD.clear()
