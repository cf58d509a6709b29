"""Computes when a sample of a recording is due, without reading, waiting or asking a clock.

An anchor joins two time lines: log times as recorded, and `now`, the player's monotonic clock; both in ns. A pause
shifts the anchor and a jump moves it, so that no burst of samples is due after a time without playing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

_LONE_NS: Final = 1_000_000_000
"""The time from one pass to the next where all samples of a recording have one log time."""


@dataclass(frozen=True, slots=True)
class Pace:
    """The pace at which a recording is played.

    Attributes:
        speed: recorded seconds in a second; inf is as fast as the readers take them.
        rate: samples a second whatever their times are; None follows their times.
        max_gap: ns of log time without a sample after which the rest of a gap is left out.

    Raises:
        ValueError: a value makes no sense.
    """

    speed: float = 1.0
    rate: float | None = None
    max_gap: int | None = None

    def __post_init__(self) -> None:
        for name, value in (("speed", self.speed), ("rate", self.rate), ("max_gap", self.max_gap)):
            if value is not None and not value > 0:
                raise ValueError(f"{name}: expected a number above 0, got {value!r}")
        if self.rate is not None and math.isinf(self.rate):
            raise ValueError(f"rate: expected a finite number, got {self.rate!r}")

    @property
    def unhurried(self) -> bool:
        """Whether samples wait for their time: not at infinite speed without a rate."""
        return self.rate is not None or not math.isinf(self.speed)

    @property
    def step(self) -> Fraction:
        """ns of the clock for one ns of log time, or for one sample where there is a rate."""
        if self.rate is not None:
            return Fraction(10**9) / Fraction(repr(self.rate))
        return 1 / Fraction(repr(self.speed)) if self.unhurried else Fraction(0)


class Schedule:
    """The position of a replay, and when it goes on.

    For each sample call `take` with its log time, wait until `due`, call `step` if it is paused, and then `sent`. Other
    events are calls as well: `pause`, `resume`, `allow`, `jump`, `again`, `change`.

    Args:
        pace: how fast.
        now: the moment at which it begins.
        position: log time from which it plays; None is that of the first sample.

    Attributes:
        shift: ns of the clock in which nothing was played, less the ns that were jumped over. A stamp to which
            it is added goes on evenly through pauses, jumps and gaps, and at speed 1 keeps step with the clock.
    """

    __slots__ = (
        "_allowed",
        "_anchor",
        "_due_last",
        "_last",
        "_log",
        "_next",
        "_number",
        "_pace",
        "_spacing",
        "_step",
        "_stopped",
        "shift",
    )

    def __init__(self, pace: Pace, now: int, position: int | None = None) -> None:
        self._put(pace)
        self._anchor = self._due_last = now
        self._log = position
        """Log time that belongs to the anchor."""
        self._last = position
        """Log time of the last sample that was sent, or where it began."""
        self._next: int | None = None
        self._number = 0
        """Samples since the anchor, the taken one included; for a rate."""
        self._spacing = 0
        """The last difference between two successive log times that was not 0."""
        self._stopped: int | None = None
        """The moment since which the replay is paused."""
        self._allowed = 0
        self.shift = 0

    def _put(self, pace: Pace) -> None:
        self._pace = pace
        self._step = pace.step.as_integer_ratio()

    @property
    def paused(self) -> bool:
        """Whether the replay is paused: samples wait, except those that `allow` let go."""
        return self._stopped is not None

    @property
    def last(self) -> int | None:
        """Log time of the last sample sent, or of the begin; None before that is known."""
        return self._last

    def position(self, now: int) -> int | None:
        """The log time that is played now; None before the first sample is known."""
        if self._last is None or self._log is None or self._pace.rate is not None or not self._pace.unhurried:
            return self._last
        now = now if self._stopped is None else self._stopped
        mul, div = self._step
        played = self._log + max(0, now - self._anchor) * div // mul
        played = max(played, self._last)
        return played if self._next is None else min(played, self._next)

    # -- sample by sample ------------------------------------------------------------------------------------------

    def take(self, log_time: int) -> int:
        """Take the next sample; return the ns of a gap before it that are left out.

        When log times go back, the sample is due at the same moment as the last one, later samples are counted from it,
        and the result is negative.
        """
        last, most = self._last, self._pace.max_gap
        self._next = log_time
        if last is None or self._log is None:
            self._log = self._last = log_time
            return 0
        apart = log_time - last
        if apart < 0:
            cut = apart
        elif most is not None and apart > most:
            cut = apart - most
        else:
            return 0
        self._log += cut
        self._last = last + cut
        self.shift -= cut
        return cut

    @property
    def due(self) -> int | None:
        """The moment at which the sample taken is due; None while it waits for `allow` or `resume`."""
        if self._stopped is not None:
            return self._stopped if self._allowed else None
        return self._due_at()

    def _due_at(self) -> int:
        mul, div = self._step
        if self._pace.rate is not None:
            return self._anchor + -(-self._number * mul // div)
        if self._next is None or self._log is None:
            return self._anchor
        # Rounded up: no sample is due before its time.
        return self._anchor + -(-(self._next - self._log) * mul // div)

    def step(self, now: int) -> None:
        """Release the sample taken while the replay is paused; `shift` makes its stamp one of this moment."""
        if self._stopped is not None and self._next is not None:
            self._step_to(self._next, now)
            self._number = 0

    def sent(self, now: int, *, allowed: bool = False) -> None:
        """Record that the sample taken was sent; `allowed`: while it was paused."""
        taken = self._next
        if allowed and self._allowed:
            self._allowed -= 1
        if taken is None:
            return
        if self._stopped is not None:
            self._step_to(taken, now)
        else:
            self._due_last = self._due_at()
            self._number += 1
        if self._last is not None and taken != self._last:
            self._spacing = taken - self._last
        self._last, self._next = taken, None

    def _step_to(self, taken: int, now: int) -> None:
        """Count from the sample `taken` on, which was sent during a pause."""
        self._hold(now)
        before = self.position(now)
        self.shift -= taken - (taken if before is None else before)
        self._anchor = self._due_last = now
        self._log = taken
        self._number = 1

    def _hold(self, now: int) -> None:
        """Count the pause up to now as time that went by."""
        if self._stopped is not None:
            self._anchor += now - self._stopped
            self._due_last += now - self._stopped
            self.shift += now - self._stopped
            self._stopped = now

    def _forgive(self, now: int) -> None:
        """Make a late sample due now, so that a call does not release a burst of late samples."""
        if self._stopped is None and self._next is not None:
            late = max(0, now - self._due_at())
            self._anchor += late
            self.shift += late

    def begin(self, now: int) -> None:
        """Start the clock at the sample that was looked for: the time it took to find it is not played."""
        self._hold(now)
        if self._pace.rate is None or not self._number:
            if self._stopped is None:
                self.shift += now - self._anchor
            self._anchor = self._due_last = now

    # -- what else happens -----------------------------------------------------------------------------------------

    def pause(self, now: int) -> None:
        """Let nothing be due from now on; do nothing if the replay is paused already."""
        if self._stopped is not None:
            return
        self._forgive(now)
        self._stopped, self._allowed = now, 0

    def resume(self, now: int) -> None:
        """Continue where the replay was paused."""
        self._hold(now)
        self._stopped, self._allowed = None, 0

    def allow(self, count: int) -> None:
        """Release that many samples, one after the other, while the replay is paused; else do nothing."""
        if self._stopped is not None:
            self._allowed += count

    def jump(self, now: int, position: int) -> None:
        """Play from that log time on, paused or not; the sample taken is dropped."""
        self._forgive(now)
        self._hold(now)
        before = self.position(now)
        self.shift += (position if before is None else before) - position
        if self._pace.rate is None:
            self._anchor = self._due_last = now
        self._log = self._last = position
        self._next = None

    def again(self, first: int) -> None:
        """Begin the next pass with a sample of that log time, at the same distance as that of the last two samples."""
        if self._last is None:
            return
        spacing = self._spacing or _LONE_NS
        self.shift += self._last - (first - spacing)
        if self._pace.rate is None:
            self._anchor = self._due_last
        self._log = self._last = first - spacing
        self._next = None

    def change(self, now: int, pace: Pace) -> None:
        """Go on at another pace."""
        if pace == self._pace:
            return
        self._forgive(now)
        self._hold(now)
        position = self.position(now)
        self._anchor = self._due_last = now
        self._log = position
        self._number = 0 if self._pace.rate is None else 1
        self._put(pace)
