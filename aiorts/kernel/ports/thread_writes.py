"""The writes of foreign threads at an out-port: a bounded queue that the loop empties, with counts of its own.

Neither side takes a lock that the other may hold: a thread that is not scheduled would stop the loop. A deque's `pop`,
`popleft` and `append` are atomic, so a right is an item of a deque, which only one thread can take: `_free` has an item
for each sample that may still be queued; the item of `_idle` is the right to start the task that empties the queue.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from itertools import repeat
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import ClosedError, ConfigurationError, StateError, ThreadError, WriteTimeout
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.model.profile import ThreadWriteStatistics
from aiorts.model.timing import mean_rate

LIMIT: Final = 1024
"""The most samples that may wait at one out-port."""
BATCH: Final = 256
"""The most samples that the loop takes in one turn."""

_MAKING: Final = threading.Lock()
"""A lock, held while an out-port gets its queue: two threads may need the queue at once."""


class ThreadWrites:
    """The samples that foreign threads wrote at one out-port and the loop has not passed on yet."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self._open = True
        self._since_ns: int | None = None
        """The time of the first write, on the kernel's monotonic clock."""
        self._samples: deque[Any] = deque()
        self._free = deque(repeat(None, LIMIT))
        self._idle = deque((None,))
        self._blocked: deque[threading.Lock] = deque()
        """The threads that wait for room, each as a lock that is released when there is room."""
        self._refusing = threading.Lock()
        self._refused = 0
        # Only the loop's thread uses the following attributes.
        self._held = 0
        """1 while a sample that was taken out of the queue waits for room at a reader, else 0."""
        self._written = 0
        self._dropped = {"timeout": 0, "closed": 0}

    def statistics(self) -> ThreadWriteStatistics:
        """See `OutPort.thread_writes`."""
        self._host().check_loop_thread(f"{self._port.path}: thread_writes")
        waiting, dropped = len(self._samples) + self._held, {why: n for why, n in self._dropped.items() if n}
        accepted = self._written + waiting + sum(dropped.values())
        kernel = self._host().kernel
        now_ns = 0 if kernel is None else kernel.clock.monotonic_ns()
        rate = 0.0 if self._since_ns is None else mean_rate(accepted, self._since_ns, now_ns)
        return ThreadWriteStatistics(
            accepted, self._written, waiting, MappingProxyType(dropped), self._refused, now_ns, rate
        )

    # -- in any thread ---------------------------------------------------------------------------------------------

    def write(self, sample: Any, full: str) -> bool:
        """See `OutPort.write_from_thread`."""
        host, path = self._host(), self._port.path
        if full not in ("reject", "block"):
            raise ConfigurationError(f'{path}: write_from_thread: full = {full!r}: expected "reject" or "block"')
        if host.realtime or host.threaded:
            raise StateError(
                f"{path}: its component runs in a thread, which alone writes here; add it to a context on the loop"
            )
        if full == "block" and host.on_loop_thread():
            raise ThreadError(f'{path}: write_from_thread(full="block") would block the event loop; await write() here')
        self._raise_if_closed()
        if self._since_ns is None:
            self._since_ns = host.kernel.clock.monotonic_ns()
        sample = self._port._checked(sample, host)
        while not _took(self._free):
            if full == "reject":
                with self._refusing:
                    self._refused += 1
                return False
            self._wait_for_room()
            self._raise_if_closed()
        self._samples.append(sample)
        if _took(self._idle):
            try:
                host.loop.call_soon_threadsafe(self._begin)
            except RuntimeError:
                raise self._is_closed() from None
        return True

    def _wait_for_room(self) -> None:
        gate = threading.Lock()
        gate.acquire()
        self._blocked.append(gate)
        if not self._free and self._open:  # else the loop may have made room and not seen this thread
            gate.acquire()

    def _raise_if_closed(self) -> None:
        kernel = self._host().kernel
        self._port._raise_if_removed()
        if not self._open or kernel is None or kernel.closed:
            raise self._is_closed()

    def _is_closed(self) -> ClosedError:
        return ClosedError(f"{self._port.path}: is in no kernel yet, or closing; the thread that writes has to end")

    def _host(self) -> Any:
        return self._port._host

    # -- on the loop -----------------------------------------------------------------------------------------------

    def set_open(self, is_open: bool) -> None:
        """Accept samples, or drop queued samples as closed and refuse later ones."""
        self._open = is_open
        if not is_open:
            self._drop_all()

    def _begin(self) -> None:
        kernel_task(self._host().loop, self._pass_on(), f"aiorts writes of threads at {self._port.path}")

    async def _pass_on(self) -> None:
        """Write the queued samples until the queue is empty."""
        left = BATCH
        try:
            while self._samples and self._open:
                if left:
                    left -= 1
                    await self._write(self._samples.popleft())
                else:
                    left = BATCH
                    self._let_in()
                    await asyncio.sleep(0)
        except asyncio.CancelledError:  # all tasks of the loop are ended: there is no other turn
            self.set_open(False)
            raise
        finally:
            if not self._open:
                self._drop_all()
            self._let_in()
            self._idle.append(None)
            if self._samples and _took(self._idle):  # written after the last look
                self._begin()

    async def _write(self, sample: Any) -> None:
        port, host = self._port, self._host()
        self._held = 1
        reason = "closed"
        try:
            if host.threaded or host.realtime:  # it joined a thread after the sample was accepted
                return
            if port._stale:
                port._update_fast_path()
            if (port._blocking or port._others) and port._without_room() is not None:
                self._let_in()
                await port._write_waiting(sample)
            else:
                port._deliver(sample)
            reason = ""
        except WriteTimeout:
            reason = "timeout"
        finally:
            self._held = 0
            if reason:
                self._dropped[reason] += 1
            else:
                self._written += 1
            self._free.append(None)

    def _drop_all(self) -> None:
        while self._samples:
            self._samples.popleft()
            self._dropped["closed"] += 1
            self._free.append(None)
        self._let_in()

    def _let_in(self) -> None:
        """Wake the threads that wait for room: each checks again."""
        for _ in range(len(self._blocked)):
            self._blocked.popleft().release()


def thread_writes_of(port: Any) -> ThreadWrites:
    """The out-port's `ThreadWrites`, made at the first call. ClosedError: the port belongs to no component."""
    found: ThreadWrites | None = port._thread_writes
    if found is None:
        if port._host is None:
            port._bound()
        with _MAKING:
            found = port._thread_writes
            if found is None:
                found = port._thread_writes = ThreadWrites(port)
    return found


def _took(rights: deque[None]) -> bool:
    try:
        rights.pop()
    except IndexError:
        return False
    return True
