"""Spans of time as text and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from aiorts.cli.commands.live.ledger import EXACT
from aiorts.model.timing import SpanFigures, row_of


def span_text(ns: float) -> str:
    """A span of time in three or four digits."""
    for unit, size in (("s", 1e9), ("ms", 1e6), ("us", 1e3)):
        if abs(ns) >= size:
            return f"{ns / size:.3g} {unit}" if abs(ns) < 999 * size else f"{ns / size:.0f} {unit}"
    return f"{ns:.0f} ns"


def within_text(within_ns: int | None) -> str:
    """The text after a span with this possible error; "?": the error is too large to show the span."""
    if within_ns is None:
        return ""
    return "?" if within_ns > EXACT else f" +- {span_text(within_ns)}"


def span_plain(spans: Sequence[int] | None) -> dict[str, int] | None:
    """Measured spans from a kernel's answer as JSON has them, in nanoseconds."""
    return None if spans is None else row_of(SpanFigures, spans)._asdict()


def spans_text(found: Mapping[str, Sequence[int]], *kinds: str) -> str:
    """Median, 99th percentile and maximum of each of these kinds that was measured; "within" is the possible error
    of the age."""
    texts = []
    for what in (one for one in kinds if one in found):
        spans = row_of(SpanFigures, found[what])
        p50, p99, most = map(span_text, (spans.p50_ns, spans.p99_ns, spans.max_ns))
        off = within_text(found["within"][0]) if what == "age" and "within" in found else ""
        texts.append("age ?" if off == "?" else f"{what} p50 {p50}{off}  p99 {p99}  max {most}")
    return "  ".join(texts)


def read_text(read: Mapping[str, Sequence[int]]) -> str:
    """The figures of the reader's end of a link as text."""
    if "waited" not in read:
        return "nothing was read since it is measured"
    return f"{spans_text(read, 'age', 'waited')}  samples {read['waited'][0]}"


def read_plain(read: Mapping[str, Sequence[int]] | None) -> dict[str, Any] | None:
    """The figures of the reader's end of a link as JSON has them; None where that end does not send them."""
    if read is None:
        return None
    within = {"age_within_ns": read["within"][0]} if "within" in read else {}
    return {what: span_plain(read.get(what)) for what in ("age", "waited")} | within
