"""How many cases a test runs: 2 % in the ordinary suite, all of them in a campaign (AIORTS_CAMPAIGN=1); how long."""

from __future__ import annotations

import os

CAMPAIGN = os.environ.get("AIORTS_CAMPAIGN") == "1"

ORDERS = 10_000 if CAMPAIGN else 200
"""In how many orders of what is ready at one instant (`simulate(..., seed=)`) a property is tried."""

LENGTH = 14 if CAMPAIGN else 6
"""How many changes are made in each at the most."""


def cases(full: int) -> int:
    """The number of cases to run out of `full`."""
    return full if CAMPAIGN else max(1, full // 50)


def time_limit(seconds: float) -> float:
    """The seconds that a test may take in a campaign; in the ordinary suite never more than the 120 of all tests."""
    return seconds if CAMPAIGN else min(seconds, 120)
