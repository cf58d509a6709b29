"""A connector: one out-port, one in-port, the options both agreed on, one bounded queue at the reader, and its ledger.

`OutPort` and `InPort` inline the common case (`out_port.py`, `in_port.py`) and come here for everything else. Only
`written` and drops are counted; what was delivered follows from them, so the ledger balances at any moment it is
read. What an out-port gives to all of its direct connectors alike it counts once, for all of them (`_sent`).
`model/policy.py` and `model/buffer.py` decide; this file carries out.

Across threads the in-port has a lock, and every path here that touches its queues takes it: its fast path is off.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from aiorts.kernel.ledger import Ledger
from aiorts.kernel.port import OFF, UNLOCKED
from aiorts.kernel.waiting import Waiting, admit_each, set_done
from aiorts.model.buffer import FullPolicy, Verdict, decide
from aiorts.model.policy import Dataflow, Push, Stamp, Subscription, admits
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics
from aiorts.model.timing import SendTimes

if TYPE_CHECKING:
    from aiorts.kernel.ports import InPort, OutPort
    from aiorts.model.timing import PublisherTiming

__all__ = ("Connector",)


# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_NEW = Push.NEW
_SKIP = Push.SKIP
_BLOCK = FullPolicy.BLOCK
_READ = Stamp.READ
_ON_THE_WAY = (Stamp.SEND, Stamp.RECEIVED)
_REFUSE = Verdict.REFUSE
_REPLACE_OLDEST = Verdict.REPLACE_OLDEST
_WAIT = Verdict.WAIT


class Connector(Ledger):
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
        "_length",
        "_loop",
        "_queue",
        "_quiet",
        "_skip",
        "_stamp",
        "_times",
        "_waiting",
        "closed",
        "in_",
        "name",
        "profile",
    )

    _crosses: ClassVar[bool] = False
    """Whether this is one of `crossing.py`; a thread that waited for the lock asks again: it may have become one."""

    def __init__(
        self,
        profile: ConnectorProfile,
        out: OutPort[Any],
        in_: InPort[Any],
        loop: asyncio.AbstractEventLoop,
        clock_ns: Callable[[], int],
    ) -> None:
        super().__init__(out)
        self.name = profile.name
        self.profile = profile
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
        self._arrived_at = 0
        """When the newest sample arrived, counted at an in-port with several connectors."""
        self._waiting: deque[Waiting] | None = None
        """Who waits for room; the buffer is full as long as there is somebody. None before the first."""
        self._loop = loop
        self._clock_ns = clock_ns
        self._times = SendTimes(profile.measure) if profile.measure else None
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
            delivered = self.delivered
            return ConnectorStatistics(self._total(), delivered, self._buffered, MappingProxyType(dict(self._dropped)))

    @property
    def delivered(self) -> int:
        """Samples that were read: what was written, less what was dropped and what is still buffered."""
        with self._guard():
            self._count_displaced()
            return self._total() - sum(self._dropped.values()) - self._buffered

    @property
    def timing(self) -> PublisherTiming | None:
        """When and how long this connector sent, over its last `measure` sends; None when it was not asked for.

        `measure` is an option of `Kernel.connect`; OpenRTM's keys `measurement.*` are aliases.
        """
        with self._guard():
            return None if self._times is None else self._times.timing

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
        """Whether a write may go straight into the queue: nothing to choose, stamp or lock."""
        return (
            not self.closed
            and not self._quiet
            and self._push is not _SKIP
            and self._stamp is None
            and self._times is None
            and self.in_._open
            and self.in_._lock is None
            and not (self.blocks and self._retired)
        )

    @property
    def room(self) -> int:
        """How many unread samples fit."""
        return 1 if self._push is _NEW else self._length

    @property
    def keeps(self) -> bool:
        """Whether a full buffer keeps what it has."""
        return self._push is not _NEW and self._full is not FullPolicy.OVERWRITE

    @property
    def blocks(self) -> bool:
        """Whether a writer waits while the buffer is full."""
        return self._push is not _NEW and self._full is _BLOCK

    @property
    def _retired(self) -> bool:
        """Whether nobody runs the reader any more: what has no room then is dropped{inactive}, and no writer waits."""
        host = self.in_._host
        return host is not None and host.retired

    def must_wait(self) -> bool:
        """Whether a sample written now would have to wait for room."""
        if self._full is not _BLOCK or self._push is _NEW or self.closed or not self.in_._open or self._retired:
            return False
        if not admits(self._push, self._skip, self._written + 1):
            return False
        return len(self._queue) >= self._length or bool(self._waiting)

    def offer(self, sample: Any) -> bool:
        """Take a sample that need not wait; False when it was rejected."""
        with self._guard():
            if self._crosses:
                return self.offer(sample)
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
            if self._crosses:
                return self.refuse(reason)
            self._written += 1
            self._drop(reason)

    def take(self) -> Any:
        """The oldest sample of the queue, which has one; the caller holds the lock."""
        sample = self._queue.popleft()
        self._admit_waiting()
        return sample if self._stamp is not _READ else _stamped(sample, self._clock_ns())

    def take_newest(self) -> Any:
        """The newest sample of the queue, which has one, older ones superseded; the caller holds the lock."""
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
        waiting, self._waiting = self._waiting, None
        for entry in waiting or ():
            self._written += 1
            self._drop(reason)
            self._resolve(entry)
        self.in_._room_made()

    # -- waiting for room ------------------------------------------------------------------------------------------

    def wait_for_room(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting | None:
        """Queue up for room; None when there is room after all (across threads) and the sample was taken."""
        with self._guard():
            if self._crosses:
                return self.wait_for_room(sample, future)
            if self.must_wait():
                return self.queue_up(sample, future)
            self.offer(sample)
            return None

    def queue_up(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting:
        """Queue up for room that there is known not to be; across threads the caller holds the lock."""
        entry = Waiting(self, sample, future)
        if self._waiting is None:
            self._waiting = deque()
        self._waiting.append(entry)
        self.in_._fast = OFF
        return entry

    def moved(self, entry: Waiting) -> bool:
        """Whether the sample of a waiting thread is in; asked in that thread."""
        return entry.done

    def give_up(self, entry: Waiting) -> bool:
        """Stop waiting; False when the sample was moved in the meantime."""
        with self._guard():
            waiting = self._waiting
            if entry.done or not waiting or entry not in waiting:
                return False
            waiting.remove(entry)
            if not waiting:
                self.in_._fast = self.in_._direct
            return True

    def _admit_waiting(self) -> None:
        """Move in who waits, as far as there is room. A sample has its number when it comes in, not when it queued up:
        one that gave up in the meantime was never written."""
        waiting = self._waiting
        if not waiting:
            return
        in_, queue = self.in_, self._queue
        plain = self._times is None and self._stamp is None and self._push is not _SKIP and in_._lock is None
        while plain and waiting and len(queue) < self._length:
            # Written out: the writer and the reader of a full buffer do this once for each sample.
            entry = waiting.popleft()
            self._written += 1
            queue.append(entry.sample)
            in_._arrived(self, False)
            entry.done = True
            if entry.future is not None and not entry.future.done():
                entry.future.set_result(None)
        if not plain:
            admit_each(self, waiting)
        if not waiting:
            in_._fast = in_._direct
        in_._room_made()

    def _resolve(self, entry: Waiting) -> None:
        entry.done = True
        if entry.future is None:
            return  # a thread: woken by `_room_made` of whoever called
        if self.in_._lock is None:
            if not entry.future.done():
                entry.future.set_result(None)
        else:
            self._loop.call_soon_threadsafe(set_done, entry.future)

    # -- storing ---------------------------------------------------------------------------------------------------

    def _guard(self) -> AbstractContextManager[Any]:
        return self.in_._lock or UNLOCKED

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
        if verdict is _WAIT:  # and `must_wait` has said no
            self._drop("inactive")
            return True
        replaces = verdict is _REPLACE_OLDEST
        if replaces:
            self._queue.popleft()
            self._drop("overwritten")
        self._push_in(self._stamp_in(sample), counted=replaces)
        return True

    def _stamp_in(self, sample: Any) -> Any:
        return _stamped(sample, self._clock_ns()) if self._stamp in _ON_THE_WAY else sample

    def _push_in(self, sample: Any, *, counted: bool = False) -> None:
        """Append; `counted` when the in-port already has a token for a sample of this connector that went away."""
        if self._times is None:
            self._queue.append(sample)
            self.in_._arrived(self, counted)
            return
        began_ns = self._monotonic_ns()
        self._queue.append(sample)
        self.in_._arrived(self, counted)
        self._times.add(began_ns, self._monotonic_ns())

    def _monotonic_ns(self) -> int:
        """The kernel's clock; asked only by who times each send."""
        kernel = None if self.out._host is None else self.out._host.kernel
        assert kernel is not None  # noqa: S101 - connected
        return kernel.clock.monotonic_ns()


def _stamped(sample: Any, tm: int) -> Any:
    from aiorts.types import with_tm

    return with_tm(sample, tm)
