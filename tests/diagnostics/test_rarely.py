"""What repeats is said at growing distances."""

from __future__ import annotations

import itertools

from aiorts.diagnostics.rarely import Rarely

S = 1_000_000_000


def test_what_repeats_is_said_at_growing_distances_with_how_often_it_was_left_out() -> None:
    rarely = Rarely()
    said = [(at, count) for at in range(100, 200) if (count := rarely.left_out("hook", at * S)) is not None]
    assert said == [(100, 0), (110, 9), (130, 19), (170, 39)]
    assert rarely.left_out("another", 199 * S) == 0
    assert rarely.left_out("hook", 400 * S) == 29  # it was quiet for long: it begins anew
    assert rarely.left_out("hook", 409 * S) is None
    assert rarely.left_out("hook", 410 * S) == 1


def test_it_never_is_silent_for_more_than_an_hour_and_knows_no_more_than_256_things() -> None:
    rarely = Rarely()
    said = [at for at in range(0, 100_000, 10) if rarely.left_out("hook", at * S) is not None]
    assert max(later - sooner for sooner, later in itertools.pairwise(said)) == 3_600
    for number in range(256):
        rarely.left_out(number, 100_000 * S)
    assert rarely.left_out("hook", 100_000 * S) == 0
