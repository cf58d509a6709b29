"""Systems made at random end, in every way and at any moment, without an error, and each sample is accounted for."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from campaign import CAMPAIGN, time_limit
from endings.endings import WAYS
from endings.generated import CALLS, CELLS, LEAST_KINDS, System, owner, system_of

SYSTEMS = 200
HERE = range(SYSTEMS) if CAMPAIGN else range(10)
"""Seeds of the systems that are left in this process."""
AT_ONCE = 2
"""Runs."""


def runs_of(way: str) -> range:
    """Seeds of the systems that run in processes of their own: others in each way."""
    if CAMPAIGN:
        return range(SYSTEMS)
    first = sorted(WAYS).index(way) * 7
    return range(first, first + 6)


def test_each_system_has_four_kinds_and_each_kind_is_in_sixty_systems() -> None:
    systems = [system_of(seed) for seed in range(SYSTEMS)]
    kinds = Counter(kind for system in systems for kind in system.kinds)
    assert min(len(system.kinds) for system in systems) >= LEAST_KINDS
    assert kinds.keys() == {*CELLS, "contexts"}
    assert min(kinds.values()) >= 60
    assert min(len(system.contexts) for system in systems) > 1


def test_a_circle_of_calls_is_in_thirty_systems() -> None:
    def calls(system: System) -> set[tuple[str, str]]:
        """Who calls whom."""
        return {(owner(out), owner(into)) for out, into, options in system.connections if options == CALLS}

    circles = [edges for edges in map(calls, map(system_of, range(SYSTEMS))) if edges & {edge[::-1] for edge in edges}]
    assert len(circles) >= 30


@pytest.mark.parametrize("seed", HERE)
def test_a_system_is_left_in_simulated_time(seed: int, tmp_path: Path) -> None:
    assert WAYS["with simulated"](system_of(seed), tmp_path / "books") == []


@pytest.mark.slow(kept_by="test_a_system_is_left_in_simulated_time")
@pytest.mark.parametrize("seed", HERE)
def test_a_system_is_left_in_real_time(seed: int, tmp_path: Path) -> None:
    assert WAYS["with real"](system_of(seed), tmp_path / "books") == []


@pytest.mark.slow
@pytest.mark.timeout(time_limit(3600))
@pytest.mark.parametrize("way", [way for way in WAYS if not way.startswith("with")])
def test_a_run_is_ended(way: str, tmp_path: Path) -> None:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        found = pool.map(lambda seed: (seed, WAYS[way](system_of(seed), tmp_path / str(seed))), runs_of(way))
        assert {seed: wrong for seed, wrong in found if wrong} == {}
