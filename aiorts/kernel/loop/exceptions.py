"""Failures that follow one another are one chain of causes, and neither it nor a traceback grows without end.

The exceptions are an application's own. What belongs to every exception is read and set here by way of the class
BaseException, so that whatever a class of theirs redefines (a frozen dataclass lets nothing be set) has no say in it.
"""

from __future__ import annotations

import traceback
from types import TracebackType
from typing import Any, Final

from aiorts.errors import format_error

_LINKS: Final = 8
"""Causes that an error keeps, itself included; the failure it belongs to comes after them."""
_FRAMES: Final = 40
"""Frames kept of an exception that is raised again and again."""
_CAUSE: Final[Any] = BaseException.__dict__["__cause__"]
_CONTEXT: Final[Any] = BaseException.__dict__["__context__"]
_TRACE: Final[Any] = BaseException.__dict__["__traceback__"]
_DICT: Final[Any] = BaseException.__dict__["__dict__"]


class NotShowable(Exception):
    """Stands in a log for an exception that raises when it is looked at: with its name, its text and its traceback."""


def chain(error: BaseException, cause: BaseException | None) -> None:
    """Make `cause` the last link of the causes of `error`, and keep both bounded however often they are raised."""
    if error is cause:
        # Raised again and again, an exception collects the frames of every raise.
        _TRACE.__set__(error, _shortened(trace_of(error)))
        return
    known = set(map(id, _links(cause)))
    links = _links(error)
    if known.isdisjoint(map(id, links)):
        _CAUSE.__set__(links[-1], cause)
        _CONTEXT.__set__(links[-1], None)


def behind(error: BaseException) -> BaseException | None:
    """The exception that another followed from."""
    cause: BaseException | None = _CAUSE.__get__(error)
    if cause is None:
        cause = _CONTEXT.__get__(error)
    return cause


def trace_of(error: BaseException) -> TracebackType | None:
    """The frames it came through."""
    trace: TracebackType | None = _TRACE.__get__(error)
    return trace


def note(error: BaseException, text: str) -> None:
    """Add a note, as `add_note` does."""
    notes = _DICT.__get__(error).setdefault("__notes__", [])
    if type(notes) is list:
        notes.append(text)


def presentable(error: Any) -> BaseException:
    """The exception itself where it and its causes can be looked at and shown, else one that stands for it."""
    try:
        looked_at = error.__class__, error.__traceback__, error.__cause__, bool(error), str(error), repr(error)
        traceback_of = traceback.TracebackException(type(error), error, None, limit=0, lookup_lines=False)
        "".join((looked_at[4], looked_at[5], *traceback_of.format())).encode("utf-8", "replace")
    except BaseException:  # noqa: BLE001 - the text of an application's exception may raise in its turn
        return NotShowable(format_error(error)).with_traceback(trace_of(error))
    return error  # type: ignore[no-any-return]


def text_of(error: BaseException) -> str:
    """As the interpreter prints it, notes included, without the traceback."""
    showable = presentable(error) is error
    return "".join(traceback.format_exception_only(error)).strip() if showable else format_error(error)


def _links(error: BaseException | None) -> list[BaseException]:
    """An exception and its causes, the first few."""
    links: list[BaseException] = []
    while error is not None and len(links) < _LINKS and not any(link is error for link in links):
        links.append(error)
        error = behind(error)
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
