"""Finds the index at the end of a recording, and believes it only when its sum and the file's size agree with it."""

from __future__ import annotations

from aiorts_log.form import DATA_END, FOOTER_SIZE, HEAD, MAGIC, BadOctets, Footer
from aiorts_log.source import Source
from aiorts_log.summary import Summary

__all__ = ("read_index",)


def read_index(source: Source) -> tuple[Summary, int] | None:
    """What the end of a file says is in it, and where the data end; None when it was not closed, or has no index.

    Raises:
        BadOctets: there is one, and it is damaged.
    """
    size = FOOTER_SIZE + len(MAGIC)
    end = source.size - size
    if end < source.begin:
        return None
    last = source.read(end, size)
    if not last.endswith(MAGIC):
        return None
    footer = Footer.take(last[:FOOTER_SIZE])
    if not footer.summary:
        return None
    if not source.begin <= footer.summary <= end or end - footer.summary > source.limits.summary:
        raise BadOctets(f"it says that it begins at octet {footer.summary}")
    summary = Summary.take(source.read(footer.summary, end - footer.summary), footer)
    stop = footer.summary - HEAD.size - 4
    if source.head(stop) != (DATA_END, HEAD.size + 4):
        raise BadOctets("no end of the data stands in front of it")
    summary.check(stop)
    return summary, stop
