"""What the command says on standard error: one line for each thing that went wrong.

Its form is `aiorts: E-CODE: where: cause; what to do`. Tracebacks only on demand. Nothing here fails because standard
error is closed or full.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import traceback
from collections.abc import Callable
from shutil import get_terminal_size
from typing import Final

from aiorts.cli.quote import quote
from aiorts.errors import AiortsError

__all__ = ("LONGEST", "LineHandler", "code_of", "cause_of", "printed", "report", "report_error")

LONGEST: Final = 240
_ADVICE: Final = "; -v shows the traceback"


def report(code: str, text: str) -> None:
    """One line on standard error."""
    _say(f"aiorts: {code}: {text}")


def report_error(error: BaseException, *, verbose: bool) -> None:
    """An exception as one line, and its traceback when asked for; notes say where it happened."""
    notes = [note for note in getattr(error, "__notes__", ()) if "\n" not in note]
    where = "".join(f"{note}: " for note in notes[:1])
    advice = "" if isinstance(error, AiortsError) or verbose else _ADVICE
    report(code_of(error), f"{where}{cause_of(error)}{advice}")
    _say_all("".join(f"  {line}\n" for line in _quoted(error)))
    if verbose:
        _say_all("".join(traceback.format_exception(error)))


def _quoted(error: BaseException) -> list[str]:
    """For a mistake in text that somebody typed: the text, and a mark under the place."""
    if isinstance(error, AiortsError) and error.typed is not None:
        return list(quote(error.typed, min(get_terminal_size().columns, 120) - 2, _encoding()))
    marked: Callable[[], str] | None = getattr(error, "marked", None)
    return [] if marked is None else marked().splitlines()


def code_of(error: BaseException) -> str:
    """The code of an error of aiorts; everything else is a component's."""
    return error.code if isinstance(error, AiortsError) else "E-COMPONENT"


def cause_of(error: BaseException) -> str:
    """What went wrong, in the words of the error."""
    text = str(error)
    if isinstance(error, AiortsError) and text:
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


class LineHandler(logging.Handler):
    """Writes log records as lines: failures of hooks in the form of errors, all else as `aiorts: LEVEL: text`.

    `on_output_error` is asked when the system refused what a component wrote; it returns True to say nothing of it.
    """

    def __init__(self, *, verbose: bool, on_output_error: Callable[[OSError], bool]) -> None:
        super().__init__()
        self._verbose = verbose
        self._on_output_error = on_output_error

    def emit(self, record: logging.LogRecord) -> None:
        """Never raises: `handleError` of logging writes a traceback, which nobody asked for."""
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, OSError) and self._on_output_error(error):
            return
        component = getattr(record, "component", "")
        if error is not None and component:
            self._failure(record, component, error)
        else:
            where = f"{component}: " if component else ""
            _say(f"aiorts: {record.levelname.lower()}: {where}{_message(record)}")
            if error is not None and self._verbose:
                _say_all("".join(traceback.format_exception(error)))

    def _failure(self, record: logging.LogRecord, component: str, error: BaseException) -> None:
        hook = _message(record).partition(" failed")[0]
        advice = "" if isinstance(error, AiortsError) or self._verbose else _ADVICE
        repeated = getattr(record, "repeated", 0)
        times = f" (repeated {repeated} times)" if repeated else ""
        where, cause = f"{component}.{hook}: ", cause_of(error)
        _say(f"aiorts: {code_of(error)}: {'' if cause.startswith(where) else where}{cause}{times}{advice}")
        if self._verbose:
            _say_all("".join(traceback.format_exception(error)))


def printed(text: str) -> str:
    """The text with whatever does not print as its number: nothing that is shown commands a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _message(record: logging.LogRecord) -> str:
    try:
        return record.getMessage()
    except (TypeError, ValueError, KeyError) as error:
        return f"{record.msg} ({error})"


def _say(line: str) -> None:
    """One line of at most LONGEST characters: the end, which says what to do, is kept."""
    line = "; ".join(part.strip() for part in line.splitlines() if part.strip())
    line = printed(line)
    if len(line) > LONGEST:
        line = f"{line[: LONGEST - 73]}...{line[-70:]}"
    _say_all(f"{line}\n")


def _say_all(text: str) -> None:
    stream = sys.stderr
    if stream is None:
        return
    with contextlib.suppress(OSError, ValueError):
        encoding = _encoding()
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        stream.flush()


def _encoding() -> str:
    return getattr(sys.stderr, "encoding", None) or "utf-8"
