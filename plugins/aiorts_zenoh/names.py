"""The owner of a name: all kernels that look at its claims see the same one. It has no engine and no clock.

A kernel claims its name with a token and owns it `CLAIMS` seconds later, which a second token says. Kernels with the
same tokens see the same owner, in whatever order they came: an owner goes before a mere claim, then the lower
(start_ns, epoch) goes before the higher. So no later token evicts an owner, whatever its clock says. While tokens need
less than half of `CLAIMS` there are never two owners. Of two owners that were parted and meet again, one stays.

A host name belongs to one machine in the same way. But where two machines claim it and neither owns it yet, neither
gets it: the name would not say which one is meant. With certificates this holds for each kernel's name by itself (see
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
"""The most letters that a name keeps when a number is added."""


class Claim(NamedTuple):
    """A kernel's claim of its name, as its token makes it; the lower claim goes first."""

    start_ns: int
    epoch: int
    machine: int
    host: str
    kernel: str

    def meets(self, other: Claim) -> bool:
        """Whether only one of the two claims can be seen: both have one name, or one host name on two machines."""
        return self.host == other.host and (self.machine != other.machine or self.kernel == other.kernel)


class Standing(Enum):
    """The standings of a kernel with its name."""

    CLAIMS = "claims"
    OWNS = "owns"
    WITHDRAWN = "withdrawn"
    """Another kernel has the name, or another machine the host name; claimed again when that one is gone."""
    REFUSED = "refused"
    """Another machine claims the same host name, and neither has it."""


Rank = tuple[bool, Claim]
"""The place of a claim in the order: not owned, and the claim; the lower goes first."""


def seen(claims: Mapping[Claim, bool]) -> dict[str, Claim]:
    """The claims that other kernels see, chosen from claims that may be rivals; by the kernels' names.

    Args:
        claims: all claims of names of one host, and whether each is owned.
    """
    return first_seen(sorted((not owned, claim) for claim, owned in claims.items()))


def first_seen(order: Sequence[Rank]) -> dict[str, Claim]:
    """The claims that other kernels see, chosen from claims that are in order; see `seen`."""
    if not order or (order[0][0] and any(claim.machine != order[0][1].machine for _, claim in order)):
        return {}
    found: dict[str, Claim] = {}
    for _, claim in order:
        if claim.machine == order[0][1].machine:
            found.setdefault(claim.kernel, claim)
    return found


def gives_way(one: Claim, two: Claim, *, owned: bool, other_owned: bool) -> bool:
    """Whether the first of two claims, owned or not, is not seen while both are there."""
    return seen({one: owned, two: other_owned}).get(one.kernel) != one


def free_name(kernel: str, taken: Iterable[str]) -> str:
    """The first of name-2, name-3, ... that no kernel claims."""
    there = set(taken)
    return next(one for number in count(2) if (one := f"{kernel[:_LONGEST]}-{number}") not in there)


class Name:
    """The standing of one kernel with its name.

    Args:
        own: its claim. now: seconds of a clock that is never set.
    """

    def __init__(self, own: Claim, now: float) -> None:
        self.own = own
        self.standing = Standing.CLAIMS
        self.given_to: Claim | None = None
        """The claim to which this kernel gave way last."""
        self._since = now

    @property
    def is_shown(self) -> bool:
        """Whether other kernels are to see it."""
        return self.standing in (Standing.CLAIMS, Standing.OWNS)

    def meets(self, other: Claim, *, owned: bool) -> None:
        """Handle another claim of the same host name that has come, or the token that makes it an owner."""
        owns = self.standing is Standing.OWNS
        if not self.is_shown or not gives_way(self.own, other, owned=owns, other_owned=owned):
            return
        self.given_to = other
        taken = owned or other.machine == self.own.machine
        self.standing = Standing.WITHDRAWN if taken else Standing.REFUSED

    def passed(self, others: Iterable[Claim], now: float) -> None:
        """Update the standing by the present time and the present claims of names of this host."""
        if self.standing is Standing.CLAIMS and now - self._since >= CLAIMS:
            self.standing = Standing.OWNS
        elif self.standing is Standing.WITHDRAWN and not any(other.meets(self.own) for other in others):
            self.standing, self._since = Standing.CLAIMS, now

    def unseen(self, now: float) -> None:
        """Begin the time of the claim again, since no kernel can have seen the token before now."""
        self._since = now
