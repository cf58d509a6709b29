"""A connector whose samples wait in a backlog and move at each period of `push_rate` on the kernel's clock.

Periods are counted from the connection: the n-th is over at `start + n / push_rate`, so they do not drift. No timer
runs while the backlog is empty. The writer never waits; with full = block a sample that finds no room at the reader
stays in the backlog.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from aiorts.kernel.connector import Connector
from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Choice, Push, choose
from aiorts.model.profile import ConnectorProfile

if TYPE_CHECKING:
    from aiorts.kernel.ports import InPort, OutPort

__all__ = ("PeriodicConnector",)


# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_ALL = Push.ALL


class PeriodicConnector(Connector):
    """A connector with a backlog that is worked off at each period of `push_rate`. See `Connector`."""

    __slots__ = (
        "_arming",
        "_backlog",
        "_denominator",
        "_first",
        "_now_ns",
        "_numerator",
        "_sent",
        "_start_ns",
        "_timer",
        "_timers",
    )

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
        self._first = 1
        """The number since the connection of the oldest sample in the backlog."""
        self._sent = False
        """Whether the period that is over has sent anything."""
        self._arming = False
        """Whether the loop was asked for a timer that it has not set yet."""
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
            if self._crosses:
                return self.offer(sample)
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
                self._leave("overwritten")
            if not self._backlog:
                self._first = self._written
            self._backlog.append(sample)
            asked, self._arming = self._arming, True
        if self._timer is None and not asked:
            self.out._on_loop(self._arm)
        return True

    def _leave(self, reason: str | None = None) -> Any:
        """Take the oldest sample out of the backlog, dropping it if there is a reason."""
        self._first += 1
        if reason is not None:
            self._drop(reason)
        return self._backlog.popleft()

    def _arm(self) -> None:
        if self._timer is not None or self.closed:
            return
        elapsed = self._now_ns() - self._start_ns
        period = elapsed * self._numerator // (1_000_000_000 * self._denominator) + 1
        deadline = self._start_ns + -(-period * 1_000_000_000 * self._denominator // self._numerator)
        # Looked up when it is over: the connector may cross threads then and obey the rules for that.
        self._timer = self._timers.call_at(deadline, lambda: self._period_over())

    def _period_over(self) -> None:
        if self._times is None:
            self._work_off()
            return
        began_ns, self._sent = self._now_ns(), False
        self._work_off()
        if self._sent:
            with self._guard():
                self._times.add(began_ns, self._now_ns())

    def _work_off(self) -> None:
        """The period is over: send what the push policy says."""
        with self._guard():
            self._timer = None
            if self._push is _ALL and self._takes_all():
                self._move_all()
                return
            for choice in choose(self._push, self._skip, self._first, len(self._backlog)):
                if choice is not Choice.SEND:
                    self._leave(choice.value)
                elif self._full is FullPolicy.BLOCK and len(self._queue) >= self._length:
                    break
                else:
                    self._store_bounded(self._leave())
            more = self._arming = bool(self._backlog)
        if more:
            self._arm()

    def _takes_all(self) -> bool:
        """Whether the reader has room for the whole backlog and there is nothing to stamp or to put in order."""
        fits = len(self._queue) + len(self._backlog) <= self._length
        return fits and self._stamp is None and self.in_._tokens is None

    def _move_all(self) -> None:
        backlog = self._backlog
        self._arming = False
        if backlog:
            self._sent = True
            self._queue.extend(backlog)
            backlog.clear()
            self.in_._arrived(self, False)

    def _push_in(self, sample: Any, *, counted: bool = False) -> None:
        self._sent = True
        self._queue.append(sample)
        self.in_._arrived(self, counted)

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
