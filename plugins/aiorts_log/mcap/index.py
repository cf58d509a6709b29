"""Finds the index at the end of a recording, and uses it only if its checksum is right and it fits the file size."""

from __future__ import annotations

from aiorts_log.mcap.format import DATA_END, FOOTER_SIZE, HEAD, MAGIC, BadBytes, Footer
from aiorts_log.mcap.source import Source
from aiorts_log.mcap.summary import Summary


def read_index(source: Source) -> tuple[Summary, int] | None:
    """The content of a file by its index, and where the data end; None when the file was not closed, or has no index.

    Raises:
        BadBytes: the index is damaged.
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
        raise BadBytes(f"it cannot begin at byte {footer.summary}")
    summary = Summary.take(source.read(footer.summary, end - footer.summary), footer)
    stop = footer.summary - HEAD.size - 4
    if source.head(stop) != (DATA_END, HEAD.size + 4):
        raise BadBytes("no end of the data stands in front of it")
    summary.check(stop)
    return summary, stop
