"""The ledger of a connector on one line, and the accuracy that its figures need."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

EXACT: Final = 10_000_000
"""The largest possible error, in nanoseconds, with which a span of time is printed."""
UP_TO_LINK: Final = ", up to the link"
"""The text after spans that end when a link takes the sample: the writer's end does not know the time of the read."""


def ledger_text(counts: Mapping[str, Any]) -> str:
    """The counts of a ledger as text; at the writer's end of a link, the counts known there."""
    lost = ", ".join(f"{count} {reason}" for reason, count in counts["dropped"].items() if count)
    arrived = f"delivered {counts['delivered']}"
    if counts["delivered"] is None:
        arrived = f"acknowledged {counts['acknowledged']}, in flight {counts['in_flight']}"
    return f"written {counts['written']}, {arrived}, waiting {counts['buffered']}, dropped {lost or '0'}"
