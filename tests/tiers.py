"""Which tests are quick: those that `pytest` runs when nothing else is said. The rest have the mark `slow`.

`@pytest.mark.slow(kept_by="test_x")` names the quick test that keeps the promise of a slow one, of the same file or as
"folder/test_file.py::test_x". Where nothing quicker does, `kept_by="first"` says that the first case of the test itself
is run with the quick ones, and the bare `@pytest.mark.slow` that it is left to the slow tier: the quick tests are over
in a minute or two. A test is slow when a case of it takes longer than LIMIT.
Of a quick test with many cases one is quick, chosen by the name of the test: of every two tests that run on both loops
about one has its quick case on either. In the same way the slow tier has one case of each test in ONE_CASE, and none of
what is in LEFT: `--tier all` has all of them, and is run before an issue is called done.

    python -m pytest -q -n 2 --tier all --durations 0 --durations-min 0.05 > all.log; python tests/tiers.py all.log

names the tests that a run of all found slow and that have no mark, and those whose mark is no longer needed.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from zlib import crc32

LIMIT = 0.25
"""Seconds that the longest case of a quick test takes, its fixtures included."""
USUAL = 0.022
"""Seconds that a quick test takes on average on the machine that LIMIT was chosen on: 130 s for 5,986 of them."""
ALWAYS = (
    *("tests/architecture/test_layers.py", "tests/architecture/test_forbidden.py"),
    *("tests/architecture/test_time_limits.py", "tests/scale/test_exact_counts.py"),
    "tests/types/test_kinds.py::test_what_a_frozen_dataclass_did_not_check_is_refused",
    "tests/types/test_convert.py::test_what_has_no_conversion_is_an_error",
)
"""What whoever changes anything is to see at once, with all cases and however long it takes."""
ONE_CASE = (
    *("tests/isolation/", "tests/endings/", "tests/execution/", "tests/realtime/"),
    *("tests/studio/test_page.py", "tests/studio/test_streams.py", "tests/studio/test_refused.py"),
    *("tests/network/test_stopped.py", "tests/network/test_claims.py", "tests/network/test_calls_at_once.py"),
    *("tests/network/test_refusals.py", "tests/network/test_cuts.py", "tests/network/test_slow_links.py"),
    *("tests/network/test_ends.py", "tests/links/test_held_up.py", "tests/scale/test_giving_up.py"),
    *("tests/supervision/test_blocking_hooks.py", "tests/diagnostics/test_loop_monitor.py"),
    "tests/examples/test_lrf.py",
)
"""Tests of which the slow tier runs one case: their other cases took 690 of its 3,070 s, most of them waiting."""
LEFT = (
    *("tests/network/test_fault_campaign.py", "tests/studio/test_measured.py", "tests/studio/test_idle.py"),
    "tests/examples/test_lrf.py::test_three_hosts_find_the_same_poses",
    "tests/examples/test_small_examples.py::test_an_example_runs_by_its_own_command[python examples/lrf/run.py]",
)
"""What the slow tier leaves to a run of all: campaigns, measurements, and what other tests run as well."""
FIRST = "first"
"""Stands for the first case of the slow test itself."""
ALONE = "slow"
"""Stands for the slow test itself, in the slow tier."""


def name_of(nodeid: str) -> str:
    """A test without its parameters."""
    return nodeid.partition("[")[0]


def are_slow(cases: Iterable[tuple[str, str | None]]) -> list[bool]:
    """Of each case, in the order of collection, whether it is left to the slow tier.

    A case is its nodeid and what keeps its promise by its mark: a quick test, FIRST or ALONE; None without a mark.
    """
    named = [(name_of(nodeid), keeper) for nodeid, keeper in cases]
    count, seen, found = Counter(named), Counter[tuple[str, str | None]](), []
    for case in named:
        name, keeper = case
        quick = 0 if keeper == FIRST else crc32(name.encode()) % count[case]
        left = keeper is not None and keeper != FIRST
        found.append(left or (seen[case] != quick and not name.startswith(ALWAYS)))
        seen[case] += 1
    return found


def are_left(nodeids: Iterable[str]) -> list[bool]:
    """Of each slow case, in the order of collection, whether it is left to a run of all."""
    cases = list(nodeids)
    count, seen, found = Counter(map(name_of, cases)), Counter[str](), []
    for case in cases:
        name = name_of(case)
        other = case.startswith(ONE_CASE) and seen[name] != crc32(name.encode()) % count[name]
        found.append(other or case.startswith(LEFT))
        seen[name] += 1
    return found


def far_from_quick(took: dict[str, float], meant_to: Iterable[str] = ()) -> set[str]:
    """Of the seconds that quick tests took: those above four times the limit, but for those that are meant to.

    Where all of them take longer than usual, on a slower or busy machine, the limit is as much longer.
    """
    pace = max(1.0, sum(took.values()) / (USUAL * len(took))) if took else 1.0
    late = {nodeid for nodeid, seconds in took.items() if seconds > 4 * LIMIT * pace}
    return {nodeid for nodeid in late.difference(meant_to) if not nodeid.startswith(ALWAYS)}


def measured(log: str) -> dict[str, float]:
    """Seconds of the longest case of each test, from what `--durations` printed."""
    cases: dict[str, float] = {}
    for seconds, nodeid in re.findall(r"^([\d.]+)s (?:call|setup|teardown) +(tests/.*)$", log, re.MULTILINE):
        cases[nodeid] = cases.get(nodeid, 0.0) + float(seconds)
    longest: dict[str, float] = {}
    for nodeid, seconds in cases.items():
        longest[name_of(nodeid)] = max(longest.get(name_of(nodeid), 0.0), seconds)
    return longest


if __name__ == "__main__":
    from marks import slow

    marked = {f"tests/{name}" for name in slow()}
    for test, seconds in sorted(measured(Path(sys.argv[1]).read_text(encoding="utf-8")).items()):
        if (seconds > LIMIT) != (test in marked) and not test.startswith(ALWAYS):
            print(f"{'marked, but quick' if test in marked else 'slow, but not marked'}: {seconds:.2f} s {test}")
