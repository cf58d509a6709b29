"""Failures that follow one another are one chain of causes, and neither it nor a traceback grows without end."""

from __future__ import annotations

from types import TracebackType
from typing import Final

__all__ = ("chain",)

_LINKS: Final = 8
"""Causes that an error keeps, itself included; the failure it belongs to comes after them."""
_FRAMES: Final = 40
"""Frames kept of an exception that is raised again and again."""


def chain(error: BaseException, cause: BaseException | None) -> None:
    """Make `cause` the last link of the causes of `error`, and keep both bounded however often they are raised."""
    if error is cause:
        # Raised again and again, an exception collects the frames of every raise.
        error.__traceback__ = _shortened(error.__traceback__)
        return
    known = set(map(id, _links(cause)))
    links = _links(error)
    if known.isdisjoint(map(id, links)):
        links[-1].__cause__ = cause
        links[-1].__context__ = None


def _links(error: BaseException | None) -> list[BaseException]:
    """An exception and its causes, the first few."""
    links: list[BaseException] = []
    while error is not None and len(links) < _LINKS and not any(link is error for link in links):
        links.append(error)
        error = error.__cause__ or error.__context__
    return links


def _shortened(trace: TracebackType | None) -> TracebackType | None:
    frames = []
    while trace is not None:
        frames.append(trace)
        trace = trace.tb_next
    if len(frames) <= _FRAMES:
        return frames[0] if frames else None
    kept = None
    for frame in reversed(frames[-_FRAMES:]):
        kept = TracebackType(kept, frame.tb_frame, frame.tb_lasti, frame.tb_lineno)
    return kept
