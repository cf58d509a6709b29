"""Computes how late a context would be if the machine had run no other processes. Pure."""

from __future__ import annotations


class Backlog:
    """The backlog of one context, from one overrun to the next.

    A late cycle makes the next one late. As long as no cycle is in time, the lateness grows by the time passed, less a
    period for each tick. Without the machine it would have grown less, by the time that the process was stalled.
    """

    __slots__ = ("_at_ns", "_late_ns", "_own_ns", "_stalled_ns")

    def __init__(self) -> None:
        self._at_ns = self._late_ns = self._own_ns = self._stalled_ns = 0.0

    def late_by_itself(
        self, at_ns: float, late_ns: float, left_out: int, period_ns: float, stalled_ns: float, since_ns: float
    ) -> bool:
        """Whether a cycle that begins `late_ns` late would have been late without the machine, too.

        Args:
            at_ns: the start of the cycle.
            left_out: ticks that are left out because of this cycle.
            stalled_ns: the time for which the process has been stalled by then.
            since_ns: the part of `stalled_ns` since the tick before the late one was due.
        """
        own = max(0.0, late_ns - since_ns)
        if at_ns - late_ns - period_ns <= self._at_ns:
            grown = late_ns - self._late_ns - (stalled_ns - self._stalled_ns)
            own = min(own, max(0.0, self._own_ns + grown))
        self._at_ns, self._stalled_ns = at_ns, stalled_ns
        self._late_ns = late_ns - left_out * period_ns
        self._own_ns = own % period_ns if left_out and period_ns else own
        return own > 0
