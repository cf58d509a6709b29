"""Which tests are quick: those that `pytest` runs when nothing else is said. The rest are in the table SLOW.txt.

Each line names a slow test and the quick one that keeps its promise. Where nothing quicker does, `first` says that the
first case of the test itself is run with the quick ones, and `slow` that it is left to the slow tier: the quick tests
are over in a minute or two. A test is slow when a case of it takes longer than LIMIT.
Of a quick test with many cases one is quick, chosen by the name of the test: of every two tests that run on both loops
about one has its quick case on either. Each case is run with one tier or the other.

    python -m pytest -q -n 2 --tier all --durations 0 --durations-min 0.05 > all.log; python tests/tiers.py all.log

writes the table anew from what a run of all tests took. Whatever is new in it gets a `?`, to be replaced by hand.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from zlib import crc32

LIMIT = 0.25
"""Seconds that the longest case of a quick test takes, its fixtures included."""
USUAL = 0.022
"""Seconds that a quick test takes on average on the machine that LIMIT was chosen on: 130 s for 5,986 of them."""
LIST = Path(__file__).with_name("SLOW.txt")
ALWAYS = (
    *("tests/architecture/test_layers.py", "tests/architecture/test_forbidden.py"),
    *("tests/architecture/test_time_limits.py", "tests/scale/test_exact_counts.py"),
    "tests/types/test_kinds.py::test_what_a_frozen_dataclass_did_not_check_is_refused",
    "tests/types/test_convert.py::test_what_has_no_conversion_is_an_error",
)
"""What whoever changes anything is to see at once, with all cases and however long it takes."""
FIRST = "first"
"""Stands for the first case of the slow test itself."""
ALONE = "slow"
"""Stands for the slow test itself, in the slow tier."""


def name_of(nodeid: str) -> str:
    """A test without its parameters."""
    return nodeid.partition("[")[0]


@cache
def table() -> dict[str, str]:
    """Each slow test and what keeps its promise in the quick tier: a quick test, or `first`."""
    return dict(line.split() for line in LIST.read_text(encoding="utf-8").splitlines())


def is_slow(name: str) -> bool:
    """Whether no case of a test is run with the quick ones."""
    return table().get(name, FIRST) != FIRST


def are_slow(nodeids: Iterable[str]) -> list[bool]:
    """Of each case, in the order of collection, whether it is left to the slow tier."""
    names = [name_of(nodeid) for nodeid in nodeids]
    cases, seen, found = Counter(names), Counter[str](), []
    for name in names:
        quick = 0 if name in table() else crc32(name.encode()) % cases[name]
        found.append(is_slow(name) or (seen[name] != quick and not name.startswith(ALWAYS)))
        seen[name] += 1
    return found


def far_from_quick(took: dict[str, float]) -> set[str]:
    """Of the seconds that quick tests took: those above four times the limit, and meant to be quick.

    Where all of them take longer than usual, on a slower or busy machine, the limit is as much longer.
    """
    pace = max(1.0, sum(took.values()) / (USUAL * len(took))) if took else 1.0
    late = {nodeid for nodeid, seconds in took.items() if seconds > 4 * LIMIT * pace}
    return {nodeid for nodeid in late if name_of(nodeid) not in table() and not nodeid.startswith(ALWAYS)}


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
    found = measured(Path(sys.argv[1]).read_text(encoding="utf-8"))
    slow = sorted(name for name, seconds in found.items() if seconds > LIMIT and not name.startswith(ALWAYS))
    LIST.write_text("".join(f"{name} {table().get(name, '?')}\n" for name in slow), encoding="utf-8")
    print(f"{LIST}: {len(slow)} tests")
