"""How late a context would be if the machine had run no other processes; pure, one number carried on."""

from __future__ import annotations


class Backlog:
    """Of one context, from one overrun to the next.

    A cycle that is late makes the next one late: where none was in time in between, the lateness grows by the time that
    passed less a period for each tick, and without the machine it would have grown by so much less.
    """

    __slots__ = ("_at_ns", "_late_ns", "_own_ns", "_stalled_ns")

    def __init__(self) -> None:
        self._at_ns = self._late_ns = self._own_ns = self._stalled_ns = 0.0

    def late_by_itself(
        self, at_ns: float, late_ns: float, left_out: int, period_ns: float, stalled_ns: float, since_ns: float
    ) -> bool:
        """Whether a cycle that begins so late would have been late all the same.

        Args:
            at_ns: when it begins.
            left_out: ticks that are left out for it.
            stalled_ns: how long the process has been stalled by then.
            since_ns: and how long since the tick before the one that is late was due.
        """
        own = max(0.0, late_ns - since_ns)
        if at_ns - late_ns - period_ns <= self._at_ns:
            grown = late_ns - self._late_ns - (stalled_ns - self._stalled_ns)
            own = min(own, max(0.0, self._own_ns + grown))
        self._at_ns, self._stalled_ns = at_ns, stalled_ns
        self._late_ns = late_ns - left_out * period_ns
        self._own_ns = own % period_ns if left_out and period_ns else own
        return own > 0
