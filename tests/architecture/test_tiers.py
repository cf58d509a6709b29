"""What is quick, and what is far from it."""

from __future__ import annotations

import pytest
from test_layers import ROOT

import tiers


def are_slow(*nodeids: str) -> list[bool]:
    """What is left to the slow tier of tests without a mark."""
    return tiers.are_slow((nodeid, None) for nodeid in nodeids)


def test_of_a_test_that_nothing_quicker_replaces_the_first_case_is_quick() -> None:
    keepers = {"test_long[1]": "tests/a.py::test_short", "test_left": tiers.ALONE}
    keepers |= {f"test_alone[{case}]": tiers.FIRST for case in (1, 2, 3)}
    cases = ["test_short", "test_long[1]", "test_alone[1]", "test_alone[2]", "test_alone[3]", "test_left"]
    slow = tiers.are_slow((f"tests/a.py::{case}", keepers.get(case)) for case in cases)
    assert slow == [False, True, False, True, True, True]


def test_a_case_that_is_marked_alone_is_slow_and_of_the_others_one_is_quick() -> None:
    slow = tiers.are_slow([("tests/a.py::test_x[1]", tiers.ALONE), *((f"tests/a.py::test_x[{n}]", None) for n in "23")])
    assert slow[0]
    assert slow[1:].count(False) == 1


def test_of_a_quick_test_with_many_cases_one_is_quick_but_all_of_what_is_always_to_be_seen() -> None:
    for name, quick in (("tests/a.py::test_x", 1), ("tests/architecture/test_layers.py::test_x", 9)):
        assert are_slow(*(f"{name}[{case}]" for case in range(9))).count(False) == quick


def test_both_loops_are_among_the_quick_cases_and_a_test_keeps_its_own() -> None:
    cases = [f"tests/a.py::test_{test}[{loop}]" for test in range(200) for loop in ("asyncio", "uvloop")]
    quick = [case for case, slow in zip(cases, are_slow(*cases), strict=True) if not slow]
    assert len(quick) == 200
    assert 60 < sum("uvloop" in case for case in quick) < 140
    assert [case for case, slow in zip(cases[6:8], are_slow(*cases[6:8]), strict=True) if not slow] == quick[3:4]


def test_no_session_runs_a_failed_test_again() -> None:
    said = (ROOT / "noxfile.py").read_text(encoding="utf-8") + (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    again = ("--last-failed", "--lf", "--failed-first", "--reruns", "lastfailed", "UNSTEADY")
    assert [word for word in again if word in said] == []


def test_far_from_quick_is_what_takes_four_times_the_limit_and_is_not_meant_to() -> None:
    took = {
        "tests/a.py::test_short[1]": 1.1,
        "tests/a.py::test_short[2]": 0.99,
        "tests/a.py::test_alone[1]": 9.0,
        "tests/architecture/test_layers.py::test_x": 9.0,
    }
    others = {f"tests/b.py::test_x[{case}]": tiers.USUAL for case in range(10_000)}
    meant_to = ["tests/a.py::test_alone[1]"]
    assert tiers.far_from_quick(took | others, meant_to) == {"tests/a.py::test_short[1]"}
    slower = {case: 3 * seconds for case, seconds in others.items()}
    assert tiers.far_from_quick(took | slower, meant_to) == set()


def test_a_test_takes_as_long_as_its_longest_case_with_all_its_fixtures() -> None:
    calls = "0.30s call     tests/a.py::test_x[1]\n", "0.35s call     tests/a.py::test_x[2]\n"
    log = "".join([*calls, "0.10s setup    tests/a.py::test_x[1]\n"])
    assert tiers.measured(log) == {"tests/a.py::test_x": pytest.approx(0.4)}


def test_the_slow_tier_has_one_case_of_some_tests_and_leaves_a_few_to_a_run_of_all() -> None:
    several = [f"tests/isolation/test_a.py::test_x[{case}]" for case in range(5)]
    others = [f"tests/a.py::test_x[{case}]" for case in range(5)]
    left = tiers.are_left([*several, *others, f"{tiers.LEFT[0]}::test_x"])
    assert (left[:5].count(False), left[5:10].count(False), left[10]) == (1, 5, True)
    for one in (*tiers.ONE_CASE, *tiers.LEFT):
        file, _, name = one.partition("::")
        found = ROOT / file if file.endswith((".py", "/")) else next((ROOT / file).parent.glob("test_*.py"))
        assert found.exists(), one
        assert f"def {name.partition('[')[0]}(" in found.read_text("utf-8") if name else True, one
