"""How many cases a test runs: 2 % in the ordinary suite, all of them in a campaign (AIORTS_CAMPAIGN=1)."""

from __future__ import annotations

import os

CAMPAIGN = os.environ.get("AIORTS_CAMPAIGN") == "1"


def cases(full: int) -> int:
    """The number of cases to run out of `full`."""
    return full if CAMPAIGN else max(1, full // 50)
