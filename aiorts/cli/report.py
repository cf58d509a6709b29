"""What the command says on standard error: one line for each thing that went wrong.

Its form is `aiorts: E-CODE: where: cause; what to do`. Tracebacks only on demand. Nothing here fails because standard
error is closed or full.
"""

from __future__ import annotations

import contextlib
import re
import sys
import traceback
from collections.abc import Callable
from shutil import get_terminal_size
from typing import Final

from aiorts.cli.quote import quote
from aiorts.errors import AiortsError

__all__ = (
    "ADVICE",
    "LONGEST",
    "cause_of",
    "code_of",
    "cut",
    "marked_in",
    "one_line",
    "place_of",
    "printed",
    "report",
    "report_error",
    "say",
    "shortened",
)

LONGEST: Final = 240
_END: Final = 70
"""Characters of the end that are kept."""
_FOLDER: Final = re.compile(r"(?<![\w.])/(?:[^\s/:;,()'\"]+/)+")
ADVICE: Final = "; --debug shows the traceback"


def report(code: str, text: str) -> None:
    """One line on standard error."""
    say(shortened(f"aiorts: {code}: {text}"))


def report_error(error: BaseException, *, verbose: bool) -> None:
    """An exception as one line, and its traceback when asked for; notes say where it happened."""
    advice = "" if isinstance(error, AiortsError) or verbose else ADVICE
    report(code_of(error), f"{place_of(error)}{cause_of(error)}{advice}")
    say(*(f"  {line}" for line in marked_in(error)))
    if verbose:
        say("".join(traceback.format_exception(error)).rstrip())


def place_of(error: BaseException) -> str:
    """Where it happened, with a colon behind it, as far as a note says so."""
    notes = [note for note in getattr(error, "__notes__", ()) if "\n" not in note]
    return "".join(f"{note}: " for note in notes[:1])


def marked_in(error: BaseException) -> list[str]:
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


def printed(text: str) -> str:
    """The text with whatever does not print as its number: nothing that is shown commands a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(text: str) -> str:
    """The text in one line, with nothing in it that commands a terminal."""
    return printed("; ".join(part.strip() for part in text.splitlines() if part.strip()))


def shortened(text: str) -> str:
    """One line of at most LONGEST characters: folders are left out first; the end, which says what to do, is kept."""
    line = one_line(text)
    for folder in sorted(set(_FOLDER.findall(line)), key=len, reverse=True):
        if len(line) > LONGEST:
            line = line.replace(folder, ".../")
    return cut(line)


def cut(line: str) -> str:
    """At most LONGEST characters of a line; what is left out is left out before its end."""
    return f"{line[: LONGEST - 3 - _END]}...{line[-_END:]}" if len(line) > LONGEST else line


def say(*lines: str) -> None:
    """Lines on standard error, as far as it takes them."""
    stream = sys.stderr
    if stream is None or not lines:
        return
    text = "".join(f"{line}\n" for line in lines)
    with contextlib.suppress(OSError, ValueError):
        encoding = _encoding()
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        stream.flush()


def _encoding() -> str:
    return getattr(sys.stderr, "encoding", None) or "utf-8"
