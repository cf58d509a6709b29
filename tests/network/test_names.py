"""Who owns a name: whatever the order of tokens, all see the same, and there are never two owners."""

from __future__ import annotations

import heapq
from itertools import count
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("zenoh")

from aiorts.links import Peer
from aiorts_zenoh.keys import Keys, claim_of
from aiorts_zenoh.names import CLAIMS, Claim, Name, Standing, seen

SLOWEST = CLAIMS * 0.45
"""Seconds that a token needs at the most."""
TICK = 0.04


class Start(NamedTuple):
    """A kernel is started: at a time, with a clock that is wrong."""

    at: float
    start_ns: int
    machine: int
    kernel: str


STARTS = st.lists(
    st.builds(
        Start,
        st.floats(0, 3),
        st.integers(0, 3),
        st.sampled_from((1, 1, 1, 2)),
        st.sampled_from(("arm", "arm", "leg")),
    ),
    min_size=1,
    max_size=5,
)


class Play:
    """Kernels of one host name and two that look on; tokens need their time, and come in order from each."""

    def __init__(self, starts: list[Start], delays: list[float]) -> None:
        self.delays, self.times = delays, count()
        self.names: dict[Claim, Name] = {}
        self.views: dict[object, dict[Claim, set[bool]]] = {"one": {}, "two": {}}
        self.shown: dict[Claim, set[bool]] = {}
        self.latest: dict[tuple[object, Claim], float] = {}
        self.events: list[tuple[float, int, tuple[object, ...]]] = []
        self.owned: list[tuple[float, Claim]] = []
        for epoch, start in enumerate(starts):
            self.plan(start.at, "start", Claim(start.start_ns, epoch, start.machine, "same", start.kernel))

    def plan(self, at: float, *what: object) -> None:
        heapq.heappush(self.events, (at, next(self.times), what))

    def run(self) -> None:
        while self.events:
            now, _, (what, *rest) = heapq.heappop(self.events)
            getattr(self, str(what))(now, *rest)
            by_name: dict[str, list[Claim]] = {}
            for claim, name in self.names.items():
                if name.standing is Standing.OWNS:
                    by_name.setdefault(claim.kernel, []).append(claim)
            assert all(len(owners) == 1 for owners in by_name.values()), (now, by_name)
            assert len({claim.machine for owners in by_name.values() for claim in owners}) <= 1, (now, by_name)

    def start(self, now: float, claim: Claim) -> None:
        self.names[claim], self.views[claim] = Name(claim, now), {}
        for other, tokens in self.shown.items():
            for owned in sorted(tokens):
                self.send(now, claim, other, owned, True)
        self.say(now, claim)
        self.tick(now, claim)

    def tick(self, now: float, claim: Claim) -> None:
        name = self.names[claim]
        name.passed(self.views[claim], now)
        self.say(now, claim)
        if now < 12.0:
            self.plan(now + TICK, "tick", claim)

    def say(self, now: float, claim: Claim) -> None:
        wanted = {Standing.CLAIMS: {False}, Standing.OWNS: {False, True}}.get(self.names[claim].standing, set())
        before, self.shown[claim] = self.shown.get(claim, set()), wanted
        for owned in sorted(before ^ wanted):
            for viewer in self.views:
                if viewer != claim:
                    self.send(now, viewer, claim, owned, owned in wanted)

    def send(self, now: float, viewer: object, claim: Claim, owned: bool, up: bool) -> None:
        delay = self.delays[next(self.times) % len(self.delays)]
        at = self.latest[viewer, claim] = max(now + delay, self.latest.get((viewer, claim), 0.0))
        self.plan(at, "came", viewer, claim, owned, up)

    def came(self, now: float, viewer: object, claim: Claim, owned: bool, up: bool) -> None:
        tokens = self.views[viewer].setdefault(claim, set())
        (tokens.add if up else tokens.discard)(owned)
        if not tokens:
            del self.views[viewer][claim]
        elif up and isinstance(viewer, Claim):
            self.names[viewer].meets(claim, owned=owned)
            self.say(now, viewer)


@pytest.mark.slow(kept_by="first")
@given(STARTS, st.lists(st.floats(0, SLOWEST), min_size=1, max_size=7))
def test_there_is_one_owner_at_the_most_and_in_the_end_all_see_it(starts: list[Start], delays: list[float]) -> None:
    play = Play(starts, delays)
    play.run()
    owners = {claim for claim, name in play.names.items() if name.standing is Standing.OWNS}
    for viewer in ("one", "two"):
        claims = {claim: True in tokens for claim, tokens in play.views[viewer].items()}
        assert set(seen(claims).values()) == owners
    if len({start.machine for start in starts}) == 1:
        assert {claim.kernel for claim in owners} == {start.kernel for start in starts}
        assert all(name.standing is not Standing.REFUSED for name in play.names.values())


@pytest.mark.slow(kept_by="test_an_owner_stays_whatever_the_clock_of_a_later_one_says")
@given(STARTS, st.lists(st.floats(0, SLOWEST), min_size=1, max_size=7))
def test_nobody_who_owns_a_name_is_evicted_by_one_that_comes_later(starts: list[Start], delays: list[float]) -> None:
    play = Play(starts, delays)
    play.run()
    first = min(play.names, key=lambda claim: starts[claim.epoch].at)
    if all(start.at > starts[first.epoch].at + CLAIMS + SLOWEST for n, start in enumerate(starts) if n != first.epoch):
        assert play.names[first].standing is Standing.OWNS


CLAIM = st.builds(
    Claim, st.integers(0, 3), st.integers(0, 5), st.integers(1, 2), st.just("same"), st.sampled_from(("arm", "leg"))
)


@given(st.dictionaries(CLAIM, st.booleans(), max_size=8), st.randoms())
def test_the_order_of_tokens_does_not_matter(claims: dict[Claim, bool], random: object) -> None:
    shuffled = list(claims.items())
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    found = seen(dict(shuffled))
    assert found == seen(claims)
    assert len({claim.machine for claim in found.values()}) <= 1
    for name, claim in found.items():
        rivals = [one for one in claims if one.kernel == name and one.machine == claim.machine]
        assert min(rivals, key=lambda one: (not claims[one], one.start_ns, one.epoch, one.machine)) == claim


def test_an_owner_stays_whatever_the_clock_of_a_later_one_says() -> None:
    name = Name(Claim(5, 1, 1, "same", "arm"), 10.0)
    name.passed((), 10.9)
    assert name.standing is Standing.CLAIMS
    name.passed((), 11.0)
    assert name.standing is Standing.OWNS
    name.meets(Claim(0, 0, 1, "same", "arm"), owned=False)
    name.meets(Claim(0, 0, 2, "same", "leg"), owned=False)
    assert name.standing is Standing.OWNS


def test_of_two_that_claim_the_lower_stays_and_the_other_takes_the_name_when_it_is_free() -> None:
    low, high = Claim(5, 1, 1, "same", "arm"), Claim(5, 2, 1, "same", "arm")
    one, two = Name(low, 10.0), Name(high, 10.2)
    one.meets(high, owned=False)
    two.meets(low, owned=False)
    assert (one.standing, two.standing, two.given_to) == (Standing.CLAIMS, Standing.WITHDRAWN, low)
    two.passed([low], 12.0)
    assert two.standing is Standing.WITHDRAWN
    two.passed([], 13.0)
    assert two.standing is Standing.CLAIMS
    two.passed([], 14.0)
    assert two.standing is Standing.OWNS


def test_of_two_machines_of_one_name_neither_has_it() -> None:
    arm, leg = Claim(5, 1, 1, "same", "arm"), Claim(6, 2, 2, "same", "leg")
    one, two = Name(arm, 10.0), Name(leg, 10.2)
    one.meets(leg, owned=False)
    two.meets(arm, owned=False)
    one.passed([], 20.0)
    assert (one.standing, two.standing) == (Standing.REFUSED, Standing.REFUSED)
    assert seen({arm: False, leg: False}) == {}
    assert seen({arm: True, leg: False}) == {"arm": arm}


@given(st.integers(0, 2**63), st.integers(0, 2**64 - 1), st.integers(0, 2**64 - 1))
def test_a_token_is_read_back(start_ns: int, epoch: int, machine: int) -> None:
    keys = Keys("default", Peer("a.host-1", "robot", epoch), start_ns, machine)
    assert claim_of(keys.token) == (keys.claim, False)
    assert claim_of(keys.owned) == (keys.claim, True)


@pytest.mark.parametrize(
    "token",
    [
        "",
        "aiorts/1/d/live/h/k",
        "aiorts/1/d/live/h/k/1-2",
        "aiorts/1/d/live/h/k/1-x-2",
        "aiorts/1/d/live/h/k/1-2-3/other",
        "aiorts/1/d/live/h/k/1-2-3/own/own",
        "aiorts/1/d/svc/h/k/1-2-3",
        "aiorts/1/d/live/h/\x1b[2J/1-2-3",
    ],
)
def test_what_is_no_token_is_left_out(token: str) -> None:
    assert claim_of(token) is None
