"""The ledger of a connector on one line, and how exact a figure of it has to be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

EXACT: Final = 10_000_000
"""Nanoseconds by which a span of time may be off that is worth its figure."""
UP_TO_LINK: Final = ", up to the link"
"""Behind spans that end where a link takes the sample: the writer's end does not know when it is read."""


def ledger_text(counts: Mapping[str, Any]) -> str:
    """What was written, and what became of it; at the writer's end of a link what is known there."""
    lost = ", ".join(f"{count} {reason}" for reason, count in counts["dropped"].items() if count)
    arrived = f"delivered {counts['delivered']}"
    if counts["delivered"] is None:
        arrived = f"acknowledged {counts['acknowledged']}, in flight {counts['in_flight']}"
    return f"written {counts['written']}, {arrived}, waiting {counts['buffered']}, dropped {lost or '0'}"
