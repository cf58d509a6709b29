"""Bounds what one peer may ask of a kernel; who asks more is cut off for a while. It asks no clock, knows no engine.

It counts with leaky buckets: a peer may ask up to the limit at once, and after that as much in each second as leaks. So
a peer that begins with many questions, such as a kernel with a thousand connectors, is no flood.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from typing import Final, NamedTuple

CUT_OFF: Final = 10.0
"""Seconds for which nothing of a peer is heard."""
NAMES: Final = 10_000
"""Tokens of one host that are known at the same time."""
OF_KERNEL: Final = 2_000
"""Tokens of one kernel's name, on all hosts together: a certificate is for one name."""
MOST: Final[Mapping[str, int]] = {"host": NAMES, "kernel": OF_KERNEL}
_ALL_NAMES: Final = 100_000
_PEERS: Final = 10_000
"""Peers whose amounts are kept; beyond it the one that was heard longest ago is forgotten."""
_SAID: Final = 60.0
"""Seconds in which a peer that is cut off again gets no further line in the log."""


class Limit(NamedTuple):
    """So many, in so many seconds."""

    most: int
    seconds: float
    text: str
    at_first: int = 0
    """How many more a peer that is new may ask, once."""


LIMITS: Final[Mapping[str, Limit]] = {
    # A kernel that starts asks once for each of its connectors.
    "question": Limit(2_000, 10.0, "200 questions a second", at_first=10_000),
    "bad": Limit(100, 60.0, "100 messages a minute that are none"),
    "slow": Limit(3, 60.0, "3 messages a minute that take longer to read than they may"),
}
"""By what is counted."""
SLOW_NS: Final = 10_000_000
"""Nanoseconds that the processor may take to read a message; so many, since garbage may be collected meanwhile."""
SLOW_NS_PER_BYTE: Final = 10
"""And for each byte of a long frame."""


class Limits:
    """What peers have asked, and who is cut off."""

    def __init__(self) -> None:
        self._levels: dict[tuple[str, str], tuple[float, float]] = {}
        """By peer and what is counted: how much, and when."""
        self._until: dict[str, float] = {}
        self._said: dict[str, float] = {}

    def admits(self, who: str, now: float) -> bool:
        """Whether anything of this peer is heard."""
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
        """A peer has done one thing that is limited; what to say if it is cut off for it, else ""."""
        limit = LIMITS[what]
        level, at = self._levels.pop((who, what), (-float(limit.at_first), now))
        level = max(min(level, 0.0), level - (now - at) * limit.most / limit.seconds) + 1.0
        if level <= limit.most:
            self._levels[who, what] = level, now  # the last is the one that was heard last
            if len(self._levels) > _PEERS:
                del self._levels[next(iter(self._levels))]
            return ""
        self._levels[who, what] = 0.0, now + CUT_OFF
        self._until[who] = now + CUT_OFF
        if len(self._until) > _PEERS:
            del self._until[next(iter(self._until))]
        before = self._said.pop(who, None)
        self._said[who] = now
        if len(self._said) > _PEERS:
            del self._said[next(iter(self._said))]
        if before is not None and now - before < _SAID:
            return ""
        return f"{who} is beyond {limit.text}, and is not heard for {CUT_OFF:g} s"


class Names:
    """The tokens that are known, of each host and of each kernel's name up to a limit."""

    def __init__(self) -> None:
        self._known: set[str] = set()
        self._counts: Counter[tuple[str, str]] = Counter()
        """Of each host, ("host", its name), and of each kernel's name."""
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
        """Which of both has as many tokens as it may: what it is, and its name."""
        return next((one for one in _both(host, kernel) if self._counts[one] >= MOST[one[0]]), None)

    def is_first(self, one: tuple[str, str]) -> bool:
        """Whether to say now that this has too many: once, until it has none any more."""
        if one in self._full or len(self._full) > _PEERS:
            return False
        self._full.add(one)
        return True


def _both(host: str, kernel: str) -> tuple[tuple[str, str], tuple[str, str]]:
    return ("host", host), ("kernel", kernel)
