"""A connector: one out-port, one in-port, the options both agreed on, one bounded queue at the reader, and its ledger.

`OutPort` and `InPort` inline the common case (`out_port.py`, `in_port.py`) and come here for everything else. Only
`written` and drops are counted; what was delivered follows from them, so the ledger balances at any moment it is
read. `model/policy.py` and `model/buffer.py` decide; this file carries out.

Across threads the in-port has a lock, and every path here that touches its queues takes it: the fast path is off for
such ports.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from aiorts.kernel.port import UNLOCKED
from aiorts.model.buffer import FullPolicy, Verdict, decide
from aiorts.model.policy import Dataflow, Push, Stamp, Subscription, admits
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics

if TYPE_CHECKING:
    from aiorts.kernel.ports import InPort, OutPort

__all__ = ("Connector", "Waiting")


# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_NEW = Push.NEW
_SKIP = Push.SKIP
_BLOCK = FullPolicy.BLOCK
_READ = Stamp.READ
_SEND = Stamp.SEND
_RECEIVED = Stamp.RECEIVED
_REFUSE = Verdict.REFUSE
_REPLACE_OLDEST = Verdict.REPLACE_OLDEST


@dataclass(eq=False, slots=True)
class Waiting:
    """A sample whose writer waits for room: the reader that makes room moves it. A writer in a thread has no future
    and waits on the in-port's lock."""

    connector: Connector
    sample: Any
    future: asyncio.Future[None] | None
    done: bool = False


class Connector:
    """One live connection. Made by `Kernel.connect`, ended by `Kernel.disconnect`.

    Attributes:
        name: unique in its kernel.
        profile: the options in force, frozen.
        out: the out-port. in_: the in-port.
        closed: True once disconnected.
    """

    __slots__ = (
        "_arrived_at",
        "_clock_ns",
        "_cross",
        "_dropped",
        "_full",
        "_length",
        "_loop",
        "_push",
        "_queue",
        "_quiet",
        "_skip",
        "_stamp",
        "_waiting",
        "_written",
        "closed",
        "in_",
        "name",
        "out",
        "profile",
    )

    def __init__(
        self,
        profile: ConnectorProfile,
        out: OutPort[Any],
        in_: InPort[Any],
        loop: asyncio.AbstractEventLoop,
        clock_ns: Callable[[], int],
    ) -> None:
        self.name = profile.name
        self.profile = profile
        self.out = out
        self.in_ = in_
        self.closed = False
        self._queue: deque[Any] = deque()
        self._length = profile.length
        self._full = profile.full
        # Pull: the writer keeps its latest unread sample, the reader asks for it; nobody is woken by data.
        self._quiet = profile.dataflow is Dataflow.PULL
        chosen = Push.ALL if profile.subscription is Subscription.FLUSH else profile.push
        self._push = _NEW if self._quiet else chosen
        self._skip = profile.skip
        self._stamp = profile.stamp
        self._written = 0
        self._arrived_at = 0
        """When the newest sample arrived, counted at an in-port with several connectors."""
        self._dropped: dict[str, int] = {}
        self._waiting: deque[Waiting] = deque()
        self._loop = loop
        self._clock_ns = clock_ns
        self._cross: Any = None
        """What the threads at its ends count, while one is a real-time thread (`crossing.py`)."""

    # -- what tools see --------------------------------------------------------------------------------------------

    @property
    def statistics(self) -> ConnectorStatistics:
        """The ledger at this moment.

        Raises:
            ThreadError: read in another thread than the loop's, where neither end belongs to a ThreadContext.
        """
        host = self.in_._host
        if self.in_._lock is None and host is not None:
            host.check_loop_thread(f"{self.name}: statistics")
        with self._guard():
            return ConnectorStatistics(
                self._written, self.delivered, self._buffered, MappingProxyType(dict(self._dropped))
            )

    @property
    def delivered(self) -> int:
        """Samples that were read: what was written, less what was dropped and what is still buffered."""
        with self._guard():
            return self._written - sum(self._dropped.values()) - self._buffered

    @property
    def unread(self) -> int:
        """Samples of this connector that the reader can read now."""
        return len(self._queue)

    @property
    def _buffered(self) -> int:
        return len(self._queue)

    def __repr__(self) -> str:
        p = self.profile
        mark = " closed" if self.closed else ""
        options = f"{p.subscription}/{p.push} length={p.length} full={p.full}"
        return f"<Connector {self.out.path} -> {self.in_.path} {options}{mark}>"

    # -- what ports ask --------------------------------------------------------------------------------------------

    @property
    def direct(self) -> bool:
        """Whether a write may go straight into the queue while it has room: nothing to choose, stamp, lock or wait
        for."""
        return (
            not self.closed
            and not self._quiet
            and self._push is not _SKIP
            and self._stamp is None
            and not self._waiting
            and self.in_._open
            and self.in_._lock is None
        )

    def must_wait(self) -> bool:
        """Whether a sample written now would have to wait for room."""
        if self._full is not _BLOCK or self._push is _NEW or self.closed or not self.in_._open:
            return False
        if not admits(self._push, self._skip, self._written + 1):
            return False
        return len(self._queue) >= self._length or bool(self._waiting)

    def offer(self, sample: Any) -> bool:
        """Take a sample that need not wait; False when it was rejected."""
        with self._guard():
            if self.closed:
                return True
            self._written += 1
            if not self.in_._open:
                self._drop("inactive")
                return True
            if not admits(self._push, self._skip, self._written):
                self._drop("skipped")
                return True
            return self._store(sample)

    def refuse(self, reason: str) -> None:
        """Count a sample that was written and never got in."""
        with self._guard():
            self._written += 1
            self._drop(reason)

    def take(self) -> Any:
        """The oldest sample of the queue; the caller holds the lock and knows that there is one."""
        sample = self._queue.popleft()
        self._admit_waiting()
        return sample if self._stamp is not _READ else _stamped(sample, self._clock_ns())

    def take_newest(self) -> Any:
        """The newest sample of the queue, older ones superseded; the caller holds the lock and knows that there is
        one."""
        sample = self._queue.pop()
        self.discard("superseded")
        return sample if self._stamp is not _READ else _stamped(sample, self._clock_ns())

    def discard(self, reason: str) -> None:
        """Drop what is queued; the caller holds the lock."""
        if self._queue:
            self._drop(reason, len(self._queue))
            self._queue.clear()
        self._admit_waiting()

    def close(self) -> None:
        """Drop everything and let those who wait for room go on; idempotent."""
        with self._guard():
            if self.closed:
                return
            self.closed = True
            self._end_all("disconnected")

    def suspend(self) -> None:
        """The reader takes nothing any more: drop what is queued or waits; the caller holds the lock."""
        self._end_all("inactive")

    def _end_all(self, reason: str) -> None:
        self._discard_all(reason)
        waiting, self._waiting = self._waiting, deque()
        for entry in waiting:
            self._written += 1
            self._drop(reason)
            self._resolve(entry)
        self.in_._room_made()

    # -- waiting for room ------------------------------------------------------------------------------------------

    def wait_for_room(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting | None:
        """Queue up for room; None when there is room after all (across threads) and the sample was taken."""
        with self._guard():
            if self.must_wait():
                entry = Waiting(self, sample, future)
                self._waiting.append(entry)
                self._waiting_changed()
                return entry
            self.offer(sample)
            return None

    def moved(self, entry: Waiting) -> bool:
        """Whether the sample of a waiting thread is in; asked in that thread."""
        return entry.done

    def give_up(self, entry: Waiting) -> bool:
        """Stop waiting; False when the sample was moved in the meantime."""
        with self._guard():
            if entry not in self._waiting:
                return False
            self._waiting.remove(entry)
            if not self._waiting:
                self._waiting_changed()
            return True

    def _admit_waiting(self) -> None:
        """Move in who waits, as far as there is room. A sample has its number when it comes in, not when it queued up:
        one that gave up in the meantime was never written."""
        waiting = self._waiting
        if not waiting:
            return
        while waiting:
            sent = admits(self._push, self._skip, self._written + 1)
            if sent and len(self._queue) >= self._length:
                break
            entry = waiting.popleft()
            self._written += 1
            if sent:
                self._push_in(self._stamp_in(entry.sample))
            else:
                self._drop("skipped")
            self._resolve(entry)
        if not waiting:
            self._waiting_changed()
        self.in_._room_made()

    def _waiting_changed(self) -> None:
        """The fast path is off while somebody waits; across threads it always is."""
        if self.in_._lock is None:
            self.out._choose_path()
            self.in_._choose_path()

    def _resolve(self, entry: Waiting) -> None:
        entry.done = True
        if entry.future is None:
            return  # a thread: woken by `_room_made` of whoever called
        if self.in_._lock is None:
            if not entry.future.done():
                entry.future.set_result(None)
        else:
            self._loop.call_soon_threadsafe(_set_done, entry.future)

    # -- storing ---------------------------------------------------------------------------------------------------

    def _guard(self) -> AbstractContextManager[Any]:
        return self.in_._lock or UNLOCKED

    def _drop(self, reason: str, count: int = 1) -> None:
        self._dropped[reason] = self._dropped.get(reason, 0) + count

    def _discard_all(self, reason: str) -> None:
        if self._queue:
            self._drop(reason, len(self._queue))
            self._queue.clear()

    def _store(self, sample: Any) -> bool:
        if self._push is _NEW and self._queue:
            self._drop("superseded", len(self._queue))
            self._queue.clear()
            self._push_in(self._stamp_in(sample), counted=True)
            return True
        return self._store_bounded(sample)

    def _store_bounded(self, sample: Any) -> bool:
        verdict = decide(len(self._queue), self._length, self._full)
        if verdict is _REFUSE:
            self._drop("rejected")
            return False
        replaces = verdict is _REPLACE_OLDEST
        if replaces:
            self._queue.popleft()
            self._drop("overwritten")
        self._push_in(self._stamp_in(sample), counted=replaces)
        return True

    def _stamp_in(self, sample: Any) -> Any:
        return _stamped(sample, self._clock_ns()) if self._stamp in (_SEND, _RECEIVED) else sample

    def _push_in(self, sample: Any, *, counted: bool = False) -> None:
        """Append; `counted` when the in-port already has a token for a sample of this connector that went away."""
        self._queue.append(sample)
        self.in_._arrived(self, counted)


def _set_done(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _stamped(sample: Any, tm: int) -> Any:
    from aiorts.types import with_tm

    return with_tm(sample, tm)
