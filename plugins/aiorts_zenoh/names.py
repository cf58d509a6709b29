"""Who owns a name: of all kernels that claim one, each that looks sees the same. It has no engine and no clock.

A kernel claims its name with a token and owns it `CLAIMS` seconds later, which a second token says. Whoever sees the
same tokens sees the same owner, in whatever order they came: an owner goes before those that claim, then the lower
(start_ns, epoch) goes before the higher. So no later token evicts an owner, whatever its clock says. While tokens need
less than half of `CLAIMS` there are never two owners; two that were parted and meet again are one, by the same rule.

A host name belongs to one machine in the same way. But where two machines claim it and neither owns it yet, neither
gets it: nobody could say which one is meant by it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from itertools import count
from typing import Final, NamedTuple

CLAIMS: Final = 1.0
"""Seconds that a kernel claims its name before it owns it."""
_LONGEST: Final = 90
"""Letters of a name to which a number is added."""


class Claim(NamedTuple):
    """That a kernel is there, as its token says; the lower goes first."""

    start_ns: int
    epoch: int
    machine: int
    host: str
    kernel: str

    def meets(self, other: Claim) -> bool:
        """Whether both cannot be seen: one name, or one host name of two machines."""
        return self.host == other.host and (self.machine != other.machine or self.kernel == other.kernel)


class Standing(Enum):
    """How a kernel stands with its name."""

    CLAIMS = "claims"
    OWNS = "owns"
    WITHDRAWN = "withdrawn"
    """Another kernel has the name, or another machine the host name; it is claimed again when that one has gone."""
    REFUSED = "refused"
    """Another machine claims the same host name, and neither has it."""


def seen(claims: Mapping[Claim, bool]) -> dict[str, Claim]:
    """The kernels of one host name that others see, by their names.

    Args:
        claims: all that claim a name of this host, and whether they own it.
    """
    order = sorted(claims, key=lambda claim: (not claims[claim], claim))
    if not order or (not claims[order[0]] and any(claim.machine != order[0].machine for claim in order)):
        return {}
    found: dict[str, Claim] = {}
    for claim in order:
        if claim.machine == order[0].machine:
            found.setdefault(claim.kernel, claim)
    return found


def free_name(kernel: str, taken: Iterable[str]) -> str:
    """The first of name-2, name-3, ... that nobody claims."""
    there = set(taken)
    return next(one for number in count(2) if (one := f"{kernel[:_LONGEST]}-{number}") not in there)


class Name:
    """How one kernel stands with its name.

    Args:
        own: what it claims. now: seconds of a clock that is never set.
    """

    def __init__(self, own: Claim, now: float) -> None:
        self.own = own
        self.standing = Standing.CLAIMS
        self.given_to: Claim | None = None
        """The claim that it gave way to last."""
        self._since = now

    @property
    def is_shown(self) -> bool:
        """Whether others are to see it."""
        return self.standing in (Standing.CLAIMS, Standing.OWNS)

    def meets(self, other: Claim, *, owned: bool) -> None:
        """Another claim of its host name has come, or its owner's token."""
        both = {other: owned, self.own: self.standing is Standing.OWNS}
        if not self.is_shown or seen(both).get(self.own.kernel) == self.own:
            return
        self.given_to = other
        taken = owned or other.machine == self.own.machine
        self.standing = Standing.WITHDRAWN if taken else Standing.REFUSED

    def passed(self, others: Iterable[Claim], now: float) -> None:
        """Time has passed; these claim names of its host now."""
        if self.standing is Standing.CLAIMS and now - self._since >= CLAIMS:
            self.standing = Standing.OWNS
        elif self.standing is Standing.WITHDRAWN and not any(other.meets(self.own) for other in others):
            self.standing, self._since = Standing.CLAIMS, now

    def unseen(self, now: float) -> None:
        """Nobody can have seen the token until now: the time of a claim begins anew."""
        self._since = now
