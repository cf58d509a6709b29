"""The thread that waits on the deadman timers of all watches of the process, without the interpreter lock.

It is there while there is a timer, and not in the child of a fork.
"""

from __future__ import annotations

import logging
import os
import select
import threading
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, Protocol

from aiorts.kernel import timers

if TYPE_CHECKING:
    from aiorts.kernel.timers import _Timerfd as Timerfd

__all__ = ("join", "leave", "lock", "watched")

_LOG = logging.getLogger("aiorts.kernel")
_NEVER: Final = 2**62


class Watched(Protocol):
    """What has a timer here: the deadman of a context (`deadman.py`), or the watchdog of a loop (`watchdog.py`)."""

    _fd: int
    _timer: Timerfd | None
    _good_until_ns: int
    _finalizer: Any

    def ring(self, timer: Timerfd) -> None: ...


class _Watcher:
    """The thread that waits on the timers of all watches of the process."""

    def __init__(self) -> None:
        self.watches: dict[int, weakref.ref[Watched]] = {}
        self.ending = False
        self._epoll = select.epoll()
        try:
            self._bell = os.eventfd(0, os.EFD_CLOEXEC)
        except OSError:
            self._epoll.close()
            raise
        self._epoll.register(self._bell, select.EPOLLIN)
        self.thread = threading.Thread(target=self._run, name="aiorts deadman", daemon=True)
        self.thread.start()

    def add(self, fd: int, watch: Watched) -> None:
        # Edge-triggered: set anew, a timer rings anew, without anybody reading it.
        self._epoll.register(fd, select.EPOLLIN | select.EPOLLET)
        self.watches[fd] = weakref.ref(watch)

    def remove(self, fd: int) -> None:
        del self.watches[fd]
        self._epoll.unregister(fd)
        os.close(fd)

    def end(self) -> None:
        """Have the thread end and wait for it, unless this is it."""
        self.ending = True
        os.eventfd_write(self._bell, 1)
        if threading.current_thread() is not self.thread:
            self.thread.join(1.0)

    def drop(self) -> None:
        """In the child of a fork the thread is not there, and what it waited on is shared with the parent."""
        for fd in (*self.watches, self._bell):
            os.close(fd)
        self._epoll.close()
        for ref in self.watches.values():
            watch = ref()
            if watch is not None:
                watch._timer, watch._good_until_ns, watch._fd = None, _NEVER, -1
                watch._finalizer.detach()
        self.watches.clear()

    def _run(self) -> None:
        timer = timers._find_timerfd()
        while not self.ending and timer is not None:
            for fd, _ in self._epoll.poll():
                ref = self.watches.get(fd)
                watch = None if ref is None else ref()
                if watch is not None:
                    _ring(watch, timer)
                del watch
        os.eventfd_read(self._bell)  # who ends this writes after `ending` is set: not before that may it be closed
        self._epoll.close()
        os.close(self._bell)


def _ring(watch: Watched, timer: Timerfd) -> None:
    try:
        watch.ring(timer)
    except Exception:  # noqa: BLE001 - what it looks at changes under it; a diagnosis may fail, its thread may not
        _LOG.debug("a glance for %r failed", watch, exc_info=True)


_LOCK = threading.RLock()
_WATCHER: list[_Watcher] = []
_FORKS: list[Callable[[], Any]] = []


def lock() -> threading.RLock:
    """Held while a descriptor is set, so that it is not closed and somebody else's."""
    return _LOCK


def watched() -> int:
    """How many timers are waited on."""
    return len(_WATCHER[0].watches) if _WATCHER else 0


def join(watch: Watched) -> None:
    """Have the thread wait on the timer of this watch, too. OSError, RuntimeError when that cannot be."""
    with _LOCK:
        if not _WATCHER:
            _WATCHER.append(_Watcher())
            if not _FORKS:
                _FORKS.append(_forked)
                os.register_at_fork(after_in_child=_forked)
        _WATCHER[0].add(watch._fd, watch)


def leave(fd: int) -> None:
    """Close this timer; after the last the thread ends."""
    # Re-entrant: a watch that nobody closed goes with its context, whenever the collector finds it.
    with _LOCK:
        if _WATCHER and fd in _WATCHER[0].watches:
            watcher = _WATCHER[0]
            watcher.remove(fd)
            if watcher.watches:
                return
            _WATCHER.clear()
        else:
            return
    watcher.end()  # its thread may be waiting for the lock


def _forked() -> None:
    global _LOCK
    _LOCK = threading.RLock()
    for watcher in _WATCHER:
        watcher.drop()
    _WATCHER.clear()
