"""A connector: one out-port, one in-port, the options both agreed on, one bounded queue at the reader, and its ledger.

`OutPort` and `InPort` inline the common case (`ports.py`) and come here for everything else. Only `written` and drops
are counted; what was delivered follows from them, so the ledger balances at any moment it is read. `model/policy.py`
and `model/buffer.py` decide; this file carries out.

Across threads the in-port has a lock, and every path here that touches its queues takes it: the fast path is off for
such ports.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from aiorts.model.buffer import FullPolicy, Verdict, decide
from aiorts.model.policy import Choice, Dataflow, Push, Stamp, Subscription, admits, choose
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics

if TYPE_CHECKING:
    from aiorts.kernel.ports import InPort, OutPort

__all__ = ("Connector", "PeriodicConnector", "Waiting")

_UNLOCKED: AbstractContextManager[Any] = nullcontext()


@dataclass(eq=False, slots=True)
class Waiting:
    """A sample whose writer waits for room; the reader that makes room moves it and resolves the future."""

    sample: Any
    future: asyncio.Future[None]


class Connector:
    """One live connection. Made by `Kernel.connect`, ended by `Kernel.disconnect`.

    Attributes:
        name: unique in its kernel.
        profile: the options in force, frozen.
        out: the out-port. in_: the in-port.
        closed: True once disconnected.
    """

    __slots__ = (
        "_clock_ns",
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
        self._push = Push.NEW if self._quiet else chosen
        self._skip = profile.skip
        self._stamp = profile.stamp
        self._written = 0
        self._dropped: dict[str, int] = {}
        self._waiting: deque[Waiting] = deque()
        self._loop = loop
        self._clock_ns = clock_ns

    # -- what tools see --------------------------------------------------------------------------------------------

    @property
    def statistics(self) -> ConnectorStatistics:
        """The ledger at this moment."""
        with self._guard():
            buffered = self._buffered
            dropped = dict(self._dropped)
            delivered = self._written - sum(dropped.values()) - buffered
            return ConnectorStatistics(self._written, delivered, buffered, MappingProxyType(dropped))

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
            and self._push is not Push.SKIP
            and self._stamp is None
            and not self._waiting
            and self.in_._open
            and self.in_._lock is None
        )

    def must_wait(self) -> bool:
        """Whether a sample written now would have to wait for room."""
        if self._full is not FullPolicy.BLOCK or self._push is Push.NEW or self.closed or not self.in_._open:
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
        return sample if self._stamp is not Stamp.READ else _stamped(sample, self._clock_ns())

    def take_newest(self) -> Any:
        """The newest sample of the queue, older ones superseded; the caller holds the lock and knows that there is
        one."""
        sample = self._queue.pop()
        self.discard("superseded")
        return sample if self._stamp is not Stamp.READ else _stamped(sample, self._clock_ns())

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
            self._discard_all("disconnected")
            waiting, self._waiting = self._waiting, deque()
            for entry in waiting:
                self._written += 1
                self._drop("disconnected")
                self._resolve(entry)

    def suspend(self) -> None:
        """The reader takes nothing any more: drop what is queued or waits."""
        self._discard_all("inactive")
        waiting, self._waiting = self._waiting, deque()
        for entry in waiting:
            self._written += 1
            self._drop("inactive")
            self._resolve(entry)

    # -- waiting for room ------------------------------------------------------------------------------------------

    def wait_for_room(self, sample: Any) -> Waiting | None:
        """Queue up for room; None when there is room after all (across threads) and the sample was taken."""
        with self._guard():
            if self.must_wait():
                entry = Waiting(sample, self._loop.create_future())
                self._waiting.append(entry)
                self.out._refresh()
                self.in_._refresh()
                return entry
        self.offer(sample)
        return None

    def give_up(self, entry: Waiting) -> bool:
        """Stop waiting; False when the sample was moved in the meantime."""
        with self._guard():
            if entry not in self._waiting:
                return False
            self._waiting.remove(entry)
            if not self._waiting:
                self.out._refresh()
                self.in_._refresh()
            return True

    def _admit_waiting(self) -> None:
        moved = False
        while self._waiting and len(self._queue) < self._length:
            entry = self._waiting.popleft()
            self._written += 1
            self._push_in(entry.sample)
            self._resolve(entry)
            moved = True
        if moved and not self._waiting:
            self.out._refresh()
            self.in_._refresh()
        self.in_._room_made()

    def _resolve(self, entry: Waiting) -> None:
        if self.in_._lock is None:
            if not entry.future.done():
                entry.future.set_result(None)
        else:
            self._loop.call_soon_threadsafe(_set_done, entry.future)

    # -- storing ---------------------------------------------------------------------------------------------------

    def _guard(self) -> AbstractContextManager[Any]:
        return self.in_._lock or _UNLOCKED

    def _drop(self, reason: str, count: int = 1) -> None:
        self._dropped[reason] = self._dropped.get(reason, 0) + count

    def _discard_all(self, reason: str) -> None:
        if self._queue:
            self._drop(reason, len(self._queue))
            self._queue.clear()

    def _store(self, sample: Any) -> bool:
        if self._push is Push.NEW and self._queue:
            self._drop("superseded", len(self._queue))
            self._queue.clear()
            self._push_in(self._stamp_in(sample), counted=True)
            return True
        return self._store_bounded(sample)

    def _store_bounded(self, sample: Any) -> bool:
        verdict = decide(len(self._queue), self._length, self._full)
        if verdict is Verdict.REFUSE:
            self._drop("rejected")
            return False
        replaces = verdict is Verdict.REPLACE_OLDEST
        if replaces:
            self._queue.popleft()
            self._drop("overwritten")
        self._push_in(self._stamp_in(sample), counted=replaces)
        return True

    def _stamp_in(self, sample: Any) -> Any:
        return _stamped(sample, self._clock_ns()) if self._stamp in (Stamp.SEND, Stamp.RECEIVED) else sample

    def _push_in(self, sample: Any, *, counted: bool = False) -> None:
        """Append; `counted` when the in-port already has a token for a sample of this connector that went away."""
        self._queue.append(sample)
        self.in_._arrived(self, counted)


class PeriodicConnector(Connector):
    """A connector whose samples wait in a backlog and move at each period of `push_rate` on the kernel's clock.

    Periods are counted from the connection: the n-th is over at `start + n / push_rate`, so they do not drift. No
    timer runs while the backlog is empty. With full = block a sample that finds no room stays in the backlog.
    """

    __slots__ = ("_backlog", "_denominator", "_now_ns", "_numerator", "_start_ns", "_timer", "_timers")

    def __init__(
        self,
        profile: ConnectorProfile,
        out: OutPort[Any],
        in_: InPort[Any],
        loop: asyncio.AbstractEventLoop,
        clock_ns: Callable[[], int],
        *,
        timers: Any,
        clock_now_ns: Callable[[], int],
    ) -> None:
        super().__init__(profile, out, in_, loop, clock_ns)
        assert profile.push_rate is not None  # noqa: S101 - options were checked
        self._numerator, self._denominator = profile.push_rate.as_integer_ratio()
        self._backlog: deque[Any] = deque()
        self._timers = timers
        self._now_ns = clock_now_ns
        self._start_ns = clock_now_ns()
        self._timer: Any = None

    @property
    def direct(self) -> bool:
        return False

    @property
    def _buffered(self) -> int:
        return len(self._queue) + len(self._backlog)

    def must_wait(self) -> bool:
        return False

    def offer(self, sample: Any) -> bool:
        with self._guard():
            if self.closed:
                return True
            self._written += 1
            if not self.in_._open:
                self._drop("inactive")
                return True
            if len(self._backlog) >= self.profile.out_length:
                if self._full is FullPolicy.REJECT:
                    self._drop("rejected")
                    return False
                self._backlog.popleft()
                self._drop("overwritten")
            self._backlog.append(sample)
        if self._timer is None:
            self.out._on_loop(self._arm)
        return True

    def _arm(self) -> None:
        if self._timer is not None or self.closed:
            return
        elapsed = self._now_ns() - self._start_ns
        period = elapsed * self._numerator // (1_000_000_000 * self._denominator) + 1
        deadline = self._start_ns + -(-period * 1_000_000_000 * self._denominator // self._numerator)
        self._timer = self._timers.call_at(deadline, self._period_over)

    def _period_over(self) -> None:
        self._timer = None
        with self._guard():
            backlog = self._backlog
            # Every sample that entered the backlog was counted, so the oldest one's number follows from the newest's.
            first = self._written - len(backlog) + 1
            for choice in choose(self._push, self._skip, first, len(backlog)):
                if choice is Choice.SEND:
                    if self._full is FullPolicy.BLOCK and len(self._queue) >= self._length:
                        break
                    self._store_bounded(backlog.popleft())
                else:
                    backlog.popleft()
                    self._drop(choice.value)
            more = bool(backlog)
        if more:
            self._arm()

    def _discard_all(self, reason: str) -> None:
        super()._discard_all(reason)
        if self._backlog:
            self._drop(reason, len(self._backlog))
            self._backlog.clear()

    def close(self) -> None:
        super().close()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _set_done(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _stamped(sample: Any, tm: int) -> Any:
    from aiorts.types import with_tm

    return with_tm(sample, tm)
