"""Spans of time, as they are shown."""

from __future__ import annotations

from collections.abc import Sequence

from aiorts.cli.commands.live.ledger import EXACT


def span_text(ns: float) -> str:
    """A span of time in three or four digits."""
    for unit, size in (("s", 1e9), ("ms", 1e6), ("us", 1e3)):
        if abs(ns) >= size:
            return f"{ns / size:.3g} {unit}" if abs(ns) < 999 * size else f"{ns / size:.0f} {unit}"
    return f"{ns:.0f} ns"


def within_text(within_ns: int | None) -> str:
    """What stands behind a span that may be off by so much; "?": it says nothing."""
    if within_ns is None:
        return ""
    return "?" if within_ns > EXACT else f" +- {span_text(within_ns)}"


def span_plain(spans: Sequence[int] | None) -> dict[str, int] | None:
    """What the kernel says of the spans it has taken, in nanoseconds."""
    if spans is None:
        return None
    count, p50, p99, most = spans
    return {"samples": count, "p50_ns": p50, "p99_ns": p99, "max_ns": most}
