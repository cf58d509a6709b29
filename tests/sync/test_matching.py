"""Which samples a synchroniser matches, and the counts: against a model that sees all streams whole."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.sync.matching import POLICIES, Matching
from campaign import cases
from sync.model import MODELS, check_order, rising

PAST = 1000
STREAMS = st.lists(st.lists(st.integers(0, 60), max_size=25), min_size=2, max_size=4)


def fed(matching: Matching, order: list[tuple[int, int]]) -> list[tuple[Any, ...]]:
    """The matches when samples come in this order; the ledger is right after each."""
    matches = []
    for number, tm in order:
        matching.offer(number, tm, tm)
        while (match := matching.match()) is not None:
            matches.append(match)
        check_ledgers(matching)
    return matches


def check_ledgers(matching: Matching) -> None:
    for number in range(len(matching.lanes)):
        counts = matching.statistics(number, cleared=False)
        assert counts.balanced
        assert counts.held == sum(not held.matched for held in matching.lanes[number].queue)


def interleaved(streams: list[list[int]], seed: int) -> list[tuple[int, int]]:
    """One order in which the samples of all streams may come."""
    numbers = [number for number, stream in enumerate(streams) for _ in stream]
    random.Random(seed).shuffle(numbers)
    left = [iter(stream) for stream in streams]
    return [(number, next(left[number])) for number in numbers]


def counts_of(matching: Matching) -> list[tuple[int, int, dict[str, int], int]]:
    all_counts = [matching.statistics(number, cleared=False) for number in range(len(matching.lanes))]
    return [(one.taken, one.matched, dict(one.dropped), one.held) for one in all_counts]


@pytest.mark.parametrize(
    ("policy", "within", "streams", "matches"),
    [
        ("exact", None, [[1, 2, 3], [2, 3], [1, 3]], [(3, 3, 3)]),
        ("exact", None, [[1, 2], [3, 4]], []),
        ("nearest", 2, [[10, 20, 30], [11, 19, 33]], [(10, 11), (20, 19)]),
        ("nearest", 2, [[10, 20], [8, 12, 30]], [(10, 8)]),
        ("nearest", 0, [[10, 20], [10, 20]], [(10, 10), (20, 20)]),
        ("nearest", 9, [[10, 12], [11, 40]], [(10, 11)]),
        ("latest", None, [[10, 20, 30], [5, 25], [1, 40]], [(10, 5, 1), (20, 5, 1)]),
        ("latest", None, [[10, 20, 30], [5, 25], [1, 30]], [(10, 5, 1), (20, 5, 1)]),
        ("latest", 5, [[10, 20, 30], [5, 25, 60]], [(10, 5), (30, 25)]),
        ("latest", None, [[1, 10], [5, 10]], [(10, 10)]),
    ],
)
def test_each_policy_matches_what_it_says(
    policy: str, within: int | None, streams: list[list[int]], matches: list[tuple[int, ...]]
) -> None:
    for seed in range(20):
        matching = Matching(len(streams), policy, within, 100)
        assert fed(matching, interleaved(streams, seed)) == matches
    assert MODELS[policy](streams, within) == matches


@pytest.mark.slow(kept_by="test_each_policy_matches_what_it_says")
@settings(max_examples=cases(10_000), deadline=None)
@given(STREAMS, st.integers(0, 12), st.integers(0, 1 << 30))
def test_no_match_of_nearest_ones_is_given_out_before_it_is_known(
    streams: list[list[int]], within: int, seed: int
) -> None:
    matching = Matching(len(streams), "nearest", within, 1000)
    early = fed(matching, interleaved(streams, seed))
    ended = [[*rising(stream), PAST] for stream in streams]
    assert early == MODELS["nearest"](ended, within)[: len(early)]
    for number, stream in enumerate(ended):
        if stream[:-1]:
            going_on = [*ended]
            going_on[number] = [*stream[:-1], stream[-2] + 1, PAST]
            assert early == MODELS["nearest"](going_on, within)[: len(early)]


def stamps(period: int, count: int, offset: int = 0, lost: tuple[int, ...] = ()) -> list[int]:
    return [period * number + offset for number in range(1, count + 1) if number not in lost]


@pytest.mark.parametrize("offset", [1, -1, 40, -40])
@pytest.mark.parametrize("lost_of_lead", [(), (7,)])
def test_one_lost_sample_loses_one_match(offset: int, lost_of_lead: tuple[int, ...]) -> None:
    streams = [stamps(100, 12, lost=lost_of_lead), stamps(100, 12, offset, lost=(3,))]
    for seed in range(20):
        found = fed(Matching(2, "nearest", 110, 100), interleaved(streams, seed))
        left = [100 * number for number in range(1, 13) if number != 3 and number not in lost_of_lead]
        assert found[:9] == [(tm, tm + offset) for tm in left][:9]
        assert all(abs(other - tm) == abs(offset) for tm, other in found)


def test_every_sample_is_counted_by_what_became_of_it() -> None:
    matching = Matching(2, "nearest", 2, 3)
    order = [(0, 10), (0, 9), (0, 10), (1, 4), (1, 11), (0, 30), (1, 50), (0, 60), (0, 70), (0, 80), (0, 90)]
    assert fed(matching, order) == [(10, 11)]
    assert counts_of(matching) == [
        (8, 1, {"late": 2, "unmatched": 1, "overflow": 1}, 3),
        (3, 1, {"unmatched": 2}, 0),
    ]
    matching.clear()
    assert matching.statistics(0, cleared=False).dropped["inactive"] == 3
    assert fed(matching, [(0, 10), (1, 10)]) == [(10, 10)], "after that the stamps may begin anew"


@pytest.mark.slow(kept_by="test_each_policy_matches_what_it_says")
@settings(max_examples=cases(10_000), deadline=None)
@given(st.sampled_from(sorted(POLICIES)), STREAMS, st.integers(0, 12), st.booleans(), st.integers(0, 1 << 30))
def test_any_streams_match_as_in_the_model_in_whatever_order_they_come(
    policy: str, streams: list[list[int]], within: int, unlimited: bool, seed: int
) -> None:
    limit = None if policy == "exact" or (policy == "latest" and unlimited) else within
    if policy == "nearest":  # which is known of all of them once each port is past them
        streams = [[*stream, PAST] for stream in streams]
    matching = Matching(len(streams), policy, limit, 1000)
    matches = fed(matching, interleaved(streams, seed))
    assert matches == MODELS[policy]([rising(stream) for stream in streams], limit)
    other = Matching(len(streams), policy, limit, 1000)
    fed(other, interleaved(streams, seed + 1))
    assert counts_of(other) == counts_of(matching), "the counts do not depend on the order either"
    for number, stream in enumerate(streams):
        counts = matching.statistics(number, cleared=False)
        assert counts.taken == len(stream)
        assert counts.matched == len({match[number] for match in matches})
        assert counts.dropped.get("late", 0) == len(stream) - len(rising(stream))


@pytest.mark.slow(kept_by="test_every_sample_is_counted_by_what_became_of_it")
@settings(max_examples=cases(10_000), deadline=None)
@given(st.sampled_from(sorted(POLICIES)), STREAMS, st.integers(1, 4), st.integers(0, 12), st.integers(0, 1 << 30))
def test_with_little_room_every_sample_is_still_counted_and_no_match_is_wrong(
    policy: str, streams: list[list[int]], length: int, within: int, seed: int
) -> None:
    matching = Matching(len(streams), policy, None if policy == "exact" else within, length)
    matches = []
    for part in range(2):
        some = fed(matching, interleaved(streams, seed + part))
        check_order(some, reused=policy == "latest")
        for lead, *others in some:
            apart = [lead - other for other in others]
            low = {"exact": 0, "nearest": -within, "latest": 0}[policy]
            assert all(low <= one <= (0 if policy == "exact" else within) for one in apart)
        matches += some
        assert all(counts[3] <= length for counts in counts_of(matching))
        matching.clear()
        check_ledgers(matching)
        assert all(counts[3] == 0 for counts in counts_of(matching))
    assert [counts[0] for counts in counts_of(matching)] == [2 * len(stream) for stream in streams]
