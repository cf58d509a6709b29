"""Bounds what one peer may ask of a kernel; a peer that asks more is cut off for a while. It has no clock or engine.

It counts with leaky buckets: a peer may ask up to the limit at once, and after that as much in each second as leaks. So
a peer that begins with many questions, such as a kernel with a thousand connectors, is no flood.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Collection, Mapping
from typing import Final, NamedTuple

CUT_OFF: Final = 10.0
"""Seconds for which a peer is cut off."""
NAMES: Final = 10_000
"""The most tokens of one host that are known at the same time."""
OF_KERNEL: Final = 2_000
"""The most tokens of one kernel's name, on all hosts together: a certificate is for one name."""
MOST: Final[Mapping[str, int]] = {"host": NAMES, "kernel": OF_KERNEL}
_ALL_NAMES: Final = 100_000
_PEERS: Final = 10_000
"""The most peers whose amounts are kept; beyond it the peer that was heard longest ago is forgotten."""
_SAID: Final = 60.0
"""Seconds in which a peer that is cut off again gets no further line in the log."""


class Limit(NamedTuple):
    """The most things of one kind, in so many seconds."""

    most: int
    seconds: float
    text: str
    at_first: int = 0
    """The number of things that a new peer may do in addition, once."""


LIMITS: Final[Mapping[str, Limit]] = {
    # A kernel that starts asks once for each of its connectors.
    "question": Limit(2_000, 10.0, "200 questions a second", at_first=10_000),
    "bad": Limit(100, 60.0, "100 messages a minute that are none"),
    "slow": Limit(3, 60.0, "3 messages a minute that take longer to read than they may"),
}
"""The limits, by the kind of what is counted."""
SLOW_NS: Final = 10_000_000
"""Nanoseconds that the processor may take to read a message, with time for a garbage collection meanwhile."""
SLOW_NS_PER_BYTE: Final = 10
"""Nanoseconds in addition for each byte of a long frame."""


class Limits:
    """The counts of what peers have done, and the peers that are cut off."""

    def __init__(self) -> None:
        self._levels: OrderedDict[tuple[str, str], tuple[float, float]] = OrderedDict()
        """Amount and time, by peer and kind. A plain dict would search its first item among those removed."""
        self._until: OrderedDict[str, float] = OrderedDict()
        self._said: OrderedDict[str, float] = OrderedDict()

    def admits(self, who: str, now: float) -> bool:
        """Whether messages of this peer are taken: the peer is not cut off."""
        until = self._until.get(who)
        if until is None:
            return True
        if now < until:
            return False
        del self._until[who]
        return True

    @property
    def cut_off(self) -> Collection[str]:
        """The peers that were beyond a limit, and have not been heard since."""
        return self._until.keys()

    def count(self, who: str, what: str, now: float) -> str:
        """Count one limited thing of a peer; the text for the log if the peer is cut off for it, else ""."""
        limit = LIMITS[what]
        level, at = self._levels.pop((who, what), (-float(limit.at_first), now))
        level = max(min(level, 0.0), level - (now - at) * limit.most / limit.seconds) + 1.0
        if level <= limit.most:
            self._levels[who, what] = level, now  # kept as the last: the peer that was heard last
            if len(self._levels) > _PEERS:
                self._levels.popitem(last=False)
            return ""
        self._levels[who, what] = 0.0, now + CUT_OFF
        self._until[who] = now + CUT_OFF
        if len(self._until) > _PEERS:
            self._until.popitem(last=False)
        before = self._said.pop(who, None)
        self._said[who] = now
        if len(self._said) > _PEERS:
            self._said.popitem(last=False)
        if before is not None and now - before < _SAID:
            return ""
        return f"{who} is beyond {limit.text}, and is not heard for {CUT_OFF:g} s"


class Names:
    """The known tokens, up to a limit for each host and each kernel's name."""

    def __init__(self) -> None:
        self._known: set[str] = set()
        self._counts: Counter[tuple[str, str]] = Counter()
        """Tokens of each host, ("host", its name), and of each kernel's name, ("kernel", the name)."""
        self._full: set[tuple[str, str]] = set()

    def admits(self, host: str, kernel: str, token: str, *, up: bool) -> bool:
        """Whether a token that has come or gone is looked at."""
        is_known = token in self._known
        if up and not is_known:
            if self.beyond(host, kernel) is not None or len(self._known) >= _ALL_NAMES:
                return False
            self._known.add(token)
            self._counts.update(_both(host, kernel))
        elif not up and is_known:
            self._known.remove(token)
            for one in _both(host, kernel):
                self._counts[one] -= 1
                if not self._counts[one]:
                    del self._counts[one]
                    self._full.discard(one)
        return up or is_known

    def beyond(self, host: str, kernel: str) -> tuple[str, str] | None:
        """The host or the kernel's name that has as many tokens as it may; None: neither has."""
        return next((one for one in _both(host, kernel) if self._counts[one] >= MOST[one[0]]), None)

    def is_first(self, one: tuple[str, str]) -> bool:
        """Whether to report now that a host or name has too many tokens: once, until its last token is gone."""
        if one in self._full or len(self._full) > _PEERS:
            return False
        self._full.add(one)
        return True


def _both(host: str, kernel: str) -> tuple[tuple[str, str], tuple[str, str]]:
    return ("host", host), ("kernel", kernel)
