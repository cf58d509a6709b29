"""The known claims of kernels' names, in order, and the kernels that were told of each. Uses no engine and no clock.

The work for a claim that comes or goes is the same however many claims there are, but for moving a list in memory.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter, OrderedDict
from collections.abc import Iterator
from itertools import islice
from typing import Final

from aiorts_zenoh.names import Claim, Rank, first_seen, gives_way

LOOKED_AT: Final = 8
"""The most rivals of one claim that are compared with it."""
TOLD: Final = 4_000
"""The most kernels that are remembered as told of a claim; beyond that number the oldest are forgotten."""


class _Scope:
    """The claims that may be rivals of each other."""

    def __init__(self) -> None:
        self.tokens: dict[Claim, set[bool]] = {}
        """The present tokens of each claim; True: the token of an owner, False: the token of a mere claim."""
        self.order: list[Rank] = []
        self.of_kernel: dict[str, list[Rank]] = {}
        self.machines: Counter[int] = Counter()

    def add(self, claim: Claim) -> None:
        rank = self.rank(claim)
        insort(self.order, rank)
        insort(self.of_kernel.setdefault(claim.kernel, []), rank)
        self.machines[claim.machine] += 1

    def remove(self, claim: Claim) -> None:
        rank, of_kernel = self.rank(claim), self.of_kernel[claim.kernel]
        for order in (self.order, of_kernel):
            del order[bisect_left(order, rank)]
        if not of_kernel:
            del self.of_kernel[claim.kernel]
        self.machines[claim.machine] -= 1
        if not self.machines[claim.machine]:
            del self.machines[claim.machine]

    def rank(self, claim: Claim) -> Rank:
        return True not in self.tokens[claim], claim


class Claims:
    """The claims that are there, and which of them are seen.

    Args:
        bound: whether a kernel's name is that of its certificate. If so, only claims of the same name are rivals: no
            certificate takes a name from another. If not, all claims of one host name may be rivals.
    """

    def __init__(self, *, bound: bool) -> None:
        self._bound = bound
        self._scopes: dict[str, _Scope] = {}

    def scope_of(self, claim: Claim) -> str:
        """The scope within which a claim may have rivals."""
        return f"{claim.host}/{claim.kernel}" if self._bound else claim.host

    @property
    def scopes(self) -> tuple[str, ...]:
        """All scopes that have claims."""
        return tuple(self._scopes)

    def __contains__(self, claim: Claim) -> bool:
        return claim in self._tokens(claim)

    def has(self, claim: Claim, *, owned: bool) -> bool:
        """Whether this token of a claim is there."""
        return owned in self._tokens(claim).get(claim, ())

    def meets(self, one: Claim, two: Claim) -> bool:
        """Whether the two claims are rivals: only one of them can be seen."""
        return self.scope_of(one) == self.scope_of(two) and one.meets(two)

    def put(self, claim: Claim, *, owned: bool, up: bool) -> None:
        """Note that a token of a claim is there (`up`) or is gone."""
        name = self.scope_of(claim)
        scope = self._scopes.get(name)
        if scope is None:
            scope = self._scopes[name] = _Scope()
        if claim in scope.tokens:
            scope.remove(claim)
        tokens = scope.tokens.setdefault(claim, set())
        (tokens.add if up else tokens.discard)(owned)
        if tokens:
            scope.add(claim)
            return
        del scope.tokens[claim]
        if not scope.tokens:
            del self._scopes[name]

    def remove(self, claim: Claim) -> None:
        """Remove a claim, whatever its tokens say."""
        for owned in (True, False):
            self.put(claim, owned=owned, up=False)

    def count(self, scope: str) -> int:
        """The number of claims in a scope."""
        return len(self._scopes[scope].tokens) if scope in self._scopes else 0

    def is_shared(self, scope: str) -> bool:
        """Whether several machines have claims in a scope."""
        return scope in self._scopes and len(self._scopes[scope].machines) > 1

    def first(self, scope: str, kernel: str) -> Claim | None:
        """The claim of a kernel's name that is seen, in a scope that is not shared."""
        order = self._scopes[scope].of_kernel.get(kernel) if scope in self._scopes else None
        return order[0][1] if order else None

    def seen(self, scope: str) -> dict[str, Claim]:
        """The claims of a scope that are seen, by the kernels' names."""
        return first_seen(self._scopes[scope].order) if scope in self._scopes else {}

    def kernels(self, scope: str) -> tuple[str, ...]:
        """The kernels' names that are claimed in a scope."""
        return tuple(self._scopes[scope].of_kernel) if scope in self._scopes else ()

    def of_kernel(self, kernel: str) -> list[Claim]:
        """All claims of a kernel's name."""
        found = (scope.of_kernel.get(kernel, ()) for scope in self._scopes.values())
        return [claim for order in found for _, claim in order]

    def rivals(self, claim: Claim) -> Iterator[Claim]:
        """The rivals of this claim, which need not be there itself, in their order.

        No more than the first `LOOKED_AT` of a scope are compared.
        """
        scope = self._scopes.get(self.scope_of(claim))
        if scope is None:
            return
        shared = len(scope.machines) > 1 or claim.machine not in scope.machines
        among = scope.order if shared else scope.of_kernel.get(claim.kernel, ())
        for _, other in islice(among, LOOKED_AT):
            if other != claim and claim.meets(other):
                yield other

    def gives_way(self, one: Claim, two: Claim) -> bool:
        """Whether the first claim has to give way to the second."""
        return gives_way(one, two, owned=self.has(one, owned=True), other_owned=self.has(two, owned=True))

    def _tokens(self, claim: Claim) -> dict[Claim, set[bool]]:
        scope = self._scopes.get(self.scope_of(claim))
        return {} if scope is None else scope.tokens


class Told:
    """The kernels that were told of a claim. A kernel is told of a second claim only after the first is gone."""

    def __init__(self) -> None:
        self._of: OrderedDict[Claim, tuple[Claim, str]] = OrderedDict()
        """The claim and its token, by the kernel that was told of it."""
        self._by: dict[Claim, dict[Claim, None]] = {}
        """The kernels that were told of a claim, by the claim."""

    def __contains__(self, who: Claim) -> bool:
        return who in self._of

    def __len__(self) -> int:
        return len(self._of)

    def note(self, who: Claim, of: Claim, token: str) -> None:
        """Note that a kernel was told of this token of a claim."""
        self._forget(who)
        self._of[who] = of, token
        self._by.setdefault(of, {})[who] = None
        if len(self._of) > TOLD:
            self._forget(next(iter(self._of)))

    def ended(self, of: Claim) -> list[tuple[Claim, str]]:
        """The kernels that were told of this claim, now gone, each with the token that it was told of."""
        return [(who, self._forget(who)) for who in tuple(self._by.get(of, ()))]

    def _forget(self, who: Claim) -> str:
        if who not in self._of:
            return ""
        of, token = self._of.pop(who)
        del self._by[of][who]
        if not self._by[of]:
            del self._by[of]
        return token
