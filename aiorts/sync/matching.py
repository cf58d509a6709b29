"""Decides which samples belong together: pure computation on time stamps, it never reads, waits or asks the time.

The stamps of a port go up; a sample that is not later than the one before it is dropped as late. A sample is matched or
dropped only when no sample that is still to come could change that. So the order in which samples of different ports
come has no influence, as long as no port overflows.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import field
from typing import Any, ClassVar, Final

from aiorts.late import dataclass
from aiorts.model.timing import Counted


@dataclass(frozen=True, slots=True)
class SynchronizerStatistics(Counted):
    """The counts of one port's samples: taken = matched + sum(dropped.values()) + held."""

    taken: int
    """Samples that were read from the port."""
    matched: int
    """Samples that are part of a match; each counts once."""
    dropped: Mapping[str, int]
    """Samples that are in no match, by reason: unmatched, late, overflow, inactive."""
    held: int
    """Samples that wait for those of other ports."""
    at_ns: int = field(default=0, compare=False, repr=False)
    """The time of these counts, on the kernel's monotonic clock; 0 while the component is in no kernel."""
    counted: ClassVar[str] = "taken"

    @property
    def balanced(self) -> bool:
        """Whether the sum is right; it always is."""
        return self.taken == self.matched + sum(self.dropped.values()) + self.held


class Held:
    """A sample that waits, or that was matched and may be again (policy latest)."""

    __slots__ = ("matched", "sample", "tm")

    def __init__(self, tm: int, sample: Any) -> None:
        self.tm = tm
        self.sample = sample
        self.matched = False


class Lane:
    """The samples of one port that are held, and the counts."""

    __slots__ = ("dropped", "matched", "newest", "queue", "taken", "unused")

    def __init__(self) -> None:
        self.queue: deque[Held] = deque()
        self.newest: int | None = None
        """The stamp of the sample taken last."""
        self.unused = 0
        """Held samples that are in no match yet."""
        self.taken = self.matched = 0
        self.dropped: Counter[str] = Counter()

    @property
    def floor(self) -> int | None:
        """The stamp before which this port has no sample that can still be matched; None before the first."""
        if self.queue:
            return self.queue[0].tm
        return None if self.newest is None else self.newest + 1

    def drop(self, reason: str) -> None:
        """Drop the oldest sample: it is in no match from now on."""
        if not self.queue.popleft().matched:
            self.unused -= 1
            self.dropped[reason] += 1

    def drop_before(self, tm: int) -> bool:
        """Drop samples before `tm` as unmatched; return whether there were any."""
        queue, before = self.queue, len(self.queue)
        while queue and queue[0].tm < tm:
            self.drop("unmatched")
        return len(queue) < before

    def use(self) -> Any:
        """The oldest sample, which stays held and counts as matched."""
        held = self.queue[0]
        if not held.matched:
            held.matched = True
            self.unused -= 1
            self.matched += 1
        return held.sample

    def take(self) -> Any:
        """The oldest sample, matched and no longer held."""
        sample = self.use()
        self.queue.popleft()
        return sample


class Matching:
    """The samples of some ports, and the matches among them.

    Args:
        count: ports. policy: a word of POLICIES. tolerance_ns: see `Synchronizer`; None is any. length: samples held of
            each port.
    """

    def __init__(self, count: int, policy: str, tolerance_ns: int | None, length: int) -> None:
        self.lanes = tuple(Lane() for _ in range(count))
        self._find = POLICIES[policy]
        self._tolerance_ns = tolerance_ns
        self._length = length

    def offer(self, number: int, tm: int, sample: Any) -> None:
        """Take in a sample read from a port; afterwards the caller calls `match` until it returns None."""
        lane = self.lanes[number]
        lane.taken += 1
        if lane.newest is not None and tm <= lane.newest:
            lane.dropped["late"] += 1
            return
        lane.newest = tm
        lane.queue.append(Held(tm, sample))
        lane.unused += 1

    def match(self) -> tuple[Any, ...] | None:
        """The next match; None when there is none before more samples come."""
        while (found := self._find(self.lanes, self._tolerance_ns)) is None:
            full = [lane for lane in self.lanes if lane.unused > self._length]
            if not full:
                return None
            for lane in full:
                lane.drop("overflow")
        return found

    def clear(self) -> None:
        """Drop held samples as inactive, and begin again."""
        for lane in self.lanes:
            while lane.queue:
                lane.drop("inactive")
            lane.newest = None

    def statistics(self, number: int, *, cleared: bool) -> SynchronizerStatistics:
        """The counts of one port; `cleared`: as they are once held samples are dropped as inactive."""
        lane = self.lanes[number]
        held, dropped = lane.unused, +lane.dropped
        if cleared and held:
            dropped["inactive"] += held
            held = 0
        return SynchronizerStatistics(lane.taken, lane.matched, dict(dropped), held)


def _exact(lanes: tuple[Lane, ...], _tolerance_ns: int | None) -> tuple[Any, ...] | None:
    """Samples with one and the same stamp."""
    dropped, first = True, 0
    while dropped:
        first = max((floor for lane in lanes if (floor := lane.floor) is not None), default=0)
        dropped = False
        for lane in lanes:
            dropped = lane.drop_before(first) or dropped
    if not all(lane.queue and lane.queue[0].tm == first for lane in lanes):
        return None
    return tuple(lane.take() for lane in lanes)


def _nearest(lanes: tuple[Lane, ...], tolerance_ns: int | None) -> tuple[Any, ...] | None:
    """A sample of the first port and its partners of the others (see `_partner`)."""
    lead, *others = lanes
    within = tolerance_ns or 0
    while (floor := lead.floor) is not None:
        for lane in others:
            lane.drop_before(floor - within)
        if not lead.queue:
            return None
        leads = [held.tm for held in lead.queue]
        partners = [_partner(leads, lane, within) for lane in others]
        if _UNKNOWN in partners:
            return None
        if None not in partners:
            for lane, stamp in zip(others, partners, strict=True):
                lane.drop_before(stamp or 0)
            return tuple(lane.take() for lane in lanes)
        lead.drop("unmatched")
        for lane, stamp in zip(others, partners, strict=True):
            if stamp is not None:
                lane.drop_before(stamp + 1)
    return None


def _partner(leads: list[int], lane: Lane, within: int) -> int | None:
    """The stamp in a lane that goes with the first of the leads.

    The lead and the sample that are nearest to each other of all go together; then the same holds for those before both
    and for those after both. So a lead gets no sample that is nearer to another lead, unless that has one nearer still.
    The nearest pair comes first, not the first lead: a first lead whose partner is lost would take that of the next,
    the next that of the one after it, and so on to the end.

    Returns:
        The stamp; None where there is none within reach and none will be; `_UNKNOWN` where it depends on samples that
        are still to come.
    """
    stamps = [held.tm for held in lane.queue]
    newest = -1 if lane.newest is None else lane.newest
    ended = False  # whether no stamp can come any more among those that are looked at
    while True:
        lead = 0
        while True:  # from each to the one nearest to it, until two are nearest to each other
            tm = leads[lead]
            place = _nearest_in(stamps, tm)
            if not ended and newest < tm + within and (not stamps or stamps[-1] < tm):
                return _UNKNOWN
            if place is None or abs(stamps[place] - tm) > within:
                return None  # of the first lead: each of the others has one, by which it was found
            back = _nearest_in(leads, stamps[place]) or 0
            if not ended and leads[-1] < stamps[place]:
                return _UNKNOWN
            if back == lead:
                break
            lead = back
        if lead == 0:
            return stamps[place]
        leads, stamps, ended = leads[:lead], stamps[:place], True


def _nearest_in(stamps: list[int], tm: int) -> int | None:
    """The place of the stamp nearest to `tm`, of two the earlier one; None: there are none."""
    after = bisect_left(stamps, tm)
    if after == len(stamps):
        return after - 1 if stamps else None
    if after and tm - stamps[after - 1] <= stamps[after] - tm:
        return after - 1
    return after


def _latest(lanes: tuple[Lane, ...], tolerance_ns: int | None) -> tuple[Any, ...] | None:
    """A sample of the first port and the last ones of the others that are not after it."""
    lead, *others = lanes
    while (floor := lead.floor) is not None:
        for lane in others:
            queue = lane.queue
            while len(queue) > 1 and queue[1].tm <= floor:
                lane.drop("unmatched")
            if tolerance_ns is not None:
                lane.drop_before(floor - tolerance_ns)
        if not lead.queue:
            return None
        known = [lane for lane in others if lane.newest is not None and lane.newest >= floor]
        if any(not lane.queue or lane.queue[0].tm > floor for lane in known):
            lead.drop("unmatched")
        elif len(known) < len(others):
            return None
        else:
            return (lead.take(), *(lane.use() for lane in others))
    return None


_UNKNOWN: Final = -1
"""The value of a stamp that depends on samples still to come. A stamp is never negative."""
POLICIES: Final[Mapping[str, Callable[[tuple[Lane, ...], int | None], tuple[Any, ...] | None]]] = {
    "exact": _exact,
    "nearest": _nearest,
    "latest": _latest,
}
