"""A periodic connector at a real-time thread: the writer fills the backlog, the loop's timer empties it, neither waits.

The rules are those of `backlog.py`, the way of counting that of `crossing.py`.
"""

from __future__ import annotations

from typing import Any, Final

from aiorts.kernel.backlog import PeriodicConnector
from aiorts.kernel.crossing import NOTHING, CrossingConnector, add, take_one
from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Choice, choose

__all__ = ("CrossingPeriodic",)

_BLOCK: Final = FullPolicy.BLOCK
_REJECT: Final = FullPolicy.REJECT
_SEND: Final = Choice.SEND


class CrossingPeriodic(CrossingConnector, PeriodicConnector):
    """A periodic connector that a real-time thread reads or writes: its samples wait with their numbers."""

    __slots__ = ()
    _times_each = False

    @property
    def _buffered(self) -> int:
        return len(self._queue) + len(self._backlog)

    def must_wait(self) -> bool:
        return False

    def offer(self, sample: Any) -> bool:
        if self.closed:
            return True
        sides, backlog = self._cross, self._backlog
        sides.writing = True
        try:
            self._written += 1
            if not self.in_._open:
                self._drop("inactive")
                return True
            if len(backlog) >= self.profile.out_length:
                if self._full is _REJECT:
                    self._drop("rejected")
                    return False
                if take_one(backlog) is not NOTHING:
                    self._drop("overwritten")
            backlog.append((self._written, sample))
            reason = self._refused()
            if reason and take_one(backlog, newest=True) is not NOTHING:
                self._drop(reason)
        finally:
            sides.writing = False
        if not self._arming:
            self._arming = True
            self.out._on_loop(self._arm)
        return True

    def _append(self, sample: Any, counted: bool, dropped: dict[str, int]) -> None:
        self._sent = True
        super()._append(sample, counted, dropped)

    def _replace_newest(self, sample: Any, reason: str, dropped: dict[str, int]) -> bool:
        self._sent = True
        return super()._replace_newest(sample, reason, dropped)

    def _work_off(self) -> None:
        self._timer = None
        # Before the backlog is looked at: who writes from now on asks for a timer.
        self._arming = False
        sides, backlog = self._cross, self._backlog
        sides.moving = True
        try:
            if backlog:
                self._send(backlog[0][0], len(backlog))
        except IndexError:
            pass  # overwritten or ended in this moment
        finally:
            sides.moving = False
        if backlog:
            self._arming = True
            self._arm()

    def _send(self, first: int, number: int) -> None:
        """Raises IndexError when somebody else has emptied the backlog."""
        backlog, by_loop = self._backlog, self._cross.by_loop
        choices = choose(self._push, self._skip, first, number)
        while backlog and backlog[0][0] - first < len(choices):
            sends = choices[backlog[0][0] - first] is _SEND
            if sends and self._full is _BLOCK and len(self._queue) >= self._length:
                return
            position, sample = backlog.popleft()
            choice = choices[position - first] if position - first < len(choices) else _SEND
            if choice is _SEND:
                self._put(sample, by_loop)
            else:
                add(by_loop, choice.value)

    def _empty(self) -> int:
        number = super()._empty()
        for _ in range(len(self._backlog)):
            number += take_one(self._backlog) is not NOTHING
        return number

    def close(self) -> None:
        CrossingConnector.close(self)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
