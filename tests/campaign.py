"""How many cases a test runs, and how long: all in a campaign (AIORTS_CAMPAIGN=1), else 2 %, in the quick tier less."""

from __future__ import annotations

import os

CAMPAIGN = os.environ.get("AIORTS_CAMPAIGN") == "1"

ORDERS = 10_000 if CAMPAIGN else 200
"""In how many orders of what is ready at one instant (`simulate(..., seed=)`) a property is tried."""

_quick = False

LENGTH = 14 if CAMPAIGN else 6
"""How many changes are made in each at the most."""


def cases(full: int) -> int:
    """The number of cases to run out of `full`."""
    if CAMPAIGN:
        return full
    some = max(1, full // 50)
    return max(full // 500, min(some, 20)) if _quick else some


def be_quick() -> None:
    """Run fewer cases from now on; only what has not been imported yet hears of it."""
    global _quick, ORDERS
    _quick, ORDERS = True, cases(10_000)


def time_limit(seconds: float) -> float:
    """The seconds that a test may take in a campaign; in the ordinary suite never more than the 120 of all tests."""
    return seconds if CAMPAIGN else min(seconds, 120)
