"""A periodic transport at a real-time thread: the writer fills the backlog, the loop's timer empties it, neither waits.

The rules are those of `kernel/ports/periodic_transport.py`, the counts those of `lock_free_transport.py`.
"""

from __future__ import annotations

from operator import methodcaller
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.ports.periodic_transport import PeriodicTransport
from aiorts.kernel.ports.transport import Transport
from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Choice, choose
from aiorts.realtime.lock_free_transport import EMPTY, LockFreeTransport, add, take_one

if TYPE_CHECKING:
    from aiorts.kernel.ports.receiver import Receiver

_BLOCK: Final = FullPolicy.BLOCK
_REJECT: Final = FullPolicy.REJECT
_SEND: Final = Choice.SEND


class LockFreePeriodic(LockFreeTransport, PeriodicTransport):
    """A periodic transport that a real-time thread reads or writes: its samples wait with their numbers."""

    __slots__ = ()
    times_each = False

    def take_over(self, old: Transport, receiver: Receiver) -> None:
        super().take_over(old, receiver)
        numbered = list(enumerate(self.backlog, self.first))
        self.backlog.clear()
        self.backlog.extend(numbered)

    def hand_over(self) -> None:
        super().hand_over()
        numbered = list(self.backlog)
        self.first = numbered[0][0] if numbered else 1
        self.backlog.clear()
        self.backlog.extend(sample for _, sample in numbered)

    @property
    def buffered(self) -> int:
        return len(self.queue) + len(self.backlog)

    def must_wait(self) -> bool:
        return False

    def offer(self, sample: Any) -> bool:
        if self.closed:
            return True
        self.miss(sample)
        sides, backlog = self.extra, self.backlog
        sides.writing = True
        try:
            self.written += 1
            if not self.receiver.open:
                self.drop("inactive")
                return True
            if len(backlog) >= self.connector.profile.out_length:
                if self.connector.profile.full is _REJECT:
                    self.drop("rejected")
                    return False
                if take_one(backlog) is not EMPTY:
                    self.drop("overwritten")
            backlog.append((self.written, sample))
            reason = self.refused()
            if reason and take_one(backlog, newest=True) is not EMPTY:
                self.drop(reason)
        finally:
            sides.writing = False
        if not self.timer_requested:
            self.timer_requested = True
            self.on_loop(methodcaller("set_timer"))
        return True

    def append(self, sample: Any, dropped: dict[str, int]) -> None:
        self.sent = True
        super().append(sample, dropped)

    def replace_newest(self, sample: Any, reason: str, dropped: dict[str, int]) -> bool:
        self.sent = True
        return super().replace_newest(sample, reason, dropped)

    def work_off(self) -> None:
        self.timer = None
        # Before the look at the backlog: a write from now on asks for a timer.
        self.timer_requested = False
        sides, backlog = self.extra, self.backlog
        sides.moving = True
        try:
            if backlog:
                self._send(backlog[0][0], len(backlog))
        except IndexError:
            pass  # overwritten or ended in this moment
        finally:
            sides.moving = False
        if backlog:
            self.timer_requested = True
            self.set_timer()

    def _send(self, first: int, number: int) -> None:
        """Send what the push policy chooses of the backlog. IndexError: another thread has emptied it."""
        backlog, by_loop = self.backlog, self.extra.by_loop
        choices = choose(self.push, self.connector.profile.skip, first, number)
        while backlog and backlog[0][0] - first < len(choices):
            sends = choices[backlog[0][0] - first] is _SEND
            if sends and self.connector.profile.full is _BLOCK and len(self.queue) >= self.length:
                return
            position, sample = backlog.popleft()
            choice = choices[position - first] if position - first < len(choices) else _SEND
            if choice is _SEND:
                self.put(sample, by_loop)
            else:
                add(by_loop, choice.value)

    def empty(self) -> int:
        number = super().empty()
        for _ in range(len(self.backlog)):
            number += take_one(self.backlog) is not EMPTY
        return number

    def close(self) -> None:
        LockFreeTransport.close(self)
        if self.timer is not None:
            self.timer.cancel()
            self.timer = None
