"""Who owns a name: of all kernels that claim one, each that looks sees the same. It has no engine and no clock.

A kernel claims its name with a token and owns it `CLAIMS` seconds later, which a second token says. Whoever sees the
same tokens sees the same owner, in whatever order they came: an owner goes before those that claim, then the lower
(start_ns, epoch) goes before the higher. So no later token evicts an owner, whatever its clock says. While tokens need
less than half of `CLAIMS` there are never two owners; two that were parted and meet again are one, by the same rule.

A host name belongs to one machine in the same way. But where two machines claim it and neither owns it yet, neither
gets it: nobody could say which one is meant by it. With certificates this holds for each kernel's name by itself (see
`claims`): a certificate says which kernel it is, on whatever host, so that no claim takes a host from another name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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


Rank = tuple[bool, Claim]
"""Who goes before whom: not owned, and the claim; the lower goes first."""


def seen(claims: Mapping[Claim, bool]) -> dict[str, Claim]:
    """The kernels that others see of claims which may be rivals, by their names.

    Args:
        claims: all that claim a name of this host, and whether they own it.
    """
    return first_seen(sorted((not owned, claim) for claim, owned in claims.items()))


def first_seen(order: Sequence[Rank]) -> dict[str, Claim]:
    """The same, of claims that are in order."""
    if not order or (order[0][0] and any(claim.machine != order[0][1].machine for _, claim in order)):
        return {}
    found: dict[str, Claim] = {}
    for _, claim in order:
        if claim.machine == order[0][1].machine:
            found.setdefault(claim.kernel, claim)
    return found


def gives_way(one: Claim, two: Claim, *, owned: bool, other_owned: bool) -> bool:
    """Whether the first is not seen where these two are there, whose names are owned or not."""
    return seen({one: owned, two: other_owned}).get(one.kernel) != one


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
        owns = self.standing is Standing.OWNS
        if not self.is_shown or not gives_way(self.own, other, owned=owns, other_owned=owned):
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
