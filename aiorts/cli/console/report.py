"""Reports of errors on standard error, one line each: `aiorts: E-CODE: where: cause; what to do`.

Tracebacks are printed only on request. A closed or full standard error causes no further error.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Callable
from typing import Final, TextIO

from aiorts.cli.console.quote import quote
from aiorts.errors import AiortsError, ComponentError, format_error
from aiorts.kernel.loop.origins import in_brackets, origin_of

LONGEST: Final = 600
"""Characters of the longest line; messages of aiorts are shorter, but texts of others that they quote may be long."""
_END: Final = 200
"""Characters that are kept at the end of a cut line."""
_USUAL: Final = 240
"""Characters up to which a line is printed unchanged; in a longer line each long value is shortened."""
_VALUE: Final = re.compile(r"""(?<![\w\\])(?:'(?:[^'\\]|\\.)*+'|"(?:[^"\\]|\\.)*+")(?!\w)|[^\s'"]{101,}+""")
"""A text in quotes, or a long text without blanks."""
_LONGEST_VALUE: Final = 100
_PATH: Final = re.compile(
    r"""((?<![^\s'"(=])'[^'/]{0,200}/[^']{1,4096}'|(?<![^\s'"(=])[^\s'"(),;/]{0,200}/[^\s'"(),;]{1,4096})"""
)
"""A word, or a text in quotes, with a slash in it."""
_LONGEST_PATHS: Final = 8192
"""Characters of all paths of a line; a line with more is cut without regard to paths."""
_CODED: Final = re.compile(r"aiorts: ([EWN]-[A-Z-]+|critical|error|warning|info|debug)(?=: )")
_COLOURS: Final = {"e": "red", "c": "red", "w": "yellow", "n": "cyan", "i": "green", "d": "blue"}
"""The colours by the first letter of a code or level."""
ADVICE: Final = "; --debug shows the traceback"


def advice_on(error: BaseException, *, debug: bool) -> str:
    """The advice for an exception of a component's code; errors of aiorts explain themselves."""
    explained = isinstance(error, AiortsError) and not isinstance(error, ComponentError)
    return "" if explained or debug else ADVICE


def report(code: str, text: str) -> None:
    """Print one line on standard error."""
    say(shortened(f"aiorts: {code}: {text}"))


def report_error(error: BaseException, *, verbose: bool) -> None:
    """Report an exception in one line, and its traceback on request; its notes give the place."""
    advice = advice_on(error, debug=verbose)
    report(code_of(error), f"{place_of(error)}{cause_of(error)}{in_brackets(origin_of(error))}{advice}")
    say(*(f"  {line}" for line in marked_in(error)))
    if verbose:
        from traceback import format_exception

        say("".join(format_exception(error)).rstrip())


def place_of(error: BaseException) -> str:
    """The place of an exception, from its notes, with a colon after it; "" without a note."""
    notes = [note for note in getattr(error, "__notes__", ()) if "\n" not in note]
    return "".join(f"{note}: " for note in notes[:1])


def marked_in(error: BaseException) -> list[str]:
    """The quoted text and a mark under the place, for a mistake in typed text."""
    if isinstance(error, AiortsError) and error.typed is not None:
        from shutil import get_terminal_size

        return list(quote(error.typed, min(get_terminal_size().columns, 120) - 2, _encoding()))
    marked: Callable[[], str] | None = getattr(error, "marked", None)
    return [] if marked is None else marked().splitlines()


def code_of(error: BaseException) -> str:
    """The code of an error of aiorts; all other exceptions are E-COMPONENT."""
    return error.code if isinstance(error, AiortsError) else "E-COMPONENT"


def cause_of(error: BaseException) -> str:
    """The text of an error, for errors of aiorts without the name of the class."""
    text = format_error(error)
    return text.partition(": ")[2] or text if issubclass(type(error), AiortsError) else text


def printed(text: str) -> str:
    """The text with control characters as numbers, so that it cannot command a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(text: str) -> str:
    """The text in one line, without control characters."""
    return printed("; ".join(part.strip() for part in text.splitlines() if part.strip()))


def shortened(text: str) -> str:
    """One line of at most LONGEST characters, its paths not counted; advice is kept, long values are shortened."""
    return cut(one_line(text))


def cut(line: str) -> str:
    """A line cut to at most LONGEST characters, without counting its paths; its end and whole paths are kept.

    In a long line each value in quotes and each long word is shortened before words are cut.
    """
    if len(line) <= _USUAL:
        return line
    parts = _PATH.split(line)  # words, a path, words, a path, ...
    if sum(map(len, parts[::2])) > _USUAL:
        parts[::2] = [_VALUE.sub(_short, words) for words in parts[::2]]
        line = "".join(parts)
    words = sum(map(len, parts[::2]))
    if words <= LONGEST and len(line) <= LONGEST + _LONGEST_PATHS:
        return line
    if len(line) - words > _LONGEST_PATHS:
        return f"{line[: LONGEST - 3 - _END]}...{line[-_END:]}"
    head, tail = LONGEST - 3 - _END, words - _END
    at, kept = 0, []
    for number, text in enumerate(parts):
        if number % 2:
            kept.append(text)
            continue
        first = text[: max(0, head - at)]
        last = text[max(len(first), tail - at) :]
        gap = "..." if len(first) + len(last) < len(text) else ""
        if gap and number and not first:
            gap = f" {gap}"  # ".../x.py" would look like another path
        if gap and number < len(parts) - 1 and not last:
            gap = f"{gap} "
        kept.append(f"{first}{gap}{last}")
        at += len(text)
    return "".join(kept)


def _short(value: re.Match[str]) -> str:
    text = value[0]
    return text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 23]}...{text[-20:]}"


def has_colours(stream: TextIO | None) -> bool:
    """Whether text on a stream is coloured: on a terminal, unless NO_COLOR is set; elsewhere with FORCE_COLOR."""
    if stream is None or os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR", "0") not in ("", "0"):
        return True
    try:
        return stream.isatty() and os.environ.get("TERM", "") not in ("", "dumb", "unknown")
    except (OSError, ValueError, AttributeError):
        return False


def painted(line: str) -> str:
    """The line with its code or level in colour, or the mark under a quoted line."""
    from click import style  # late: few lines are printed, and most of them not on a terminal

    found = _CODED.match(line)
    if found is not None:
        word = style(found[1], fg=_COLOURS[found[1][0].lower()], bold=True)
        return f"{line[: found.start(1)]}{word}{line[found.end(1) :]}"
    return style(line, fg="green") if line.strip() and not line.strip(" ^") else line


def say(*lines: str) -> None:
    """Print lines on standard error, where it can be written."""
    stream = sys.stderr
    if stream is None or not lines:
        return
    if has_colours(stream):
        lines = tuple(map(painted, lines))
    text = "".join(f"{line}\n" for line in lines)
    with contextlib.suppress(OSError, ValueError):
        encoding = _encoding()
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        stream.flush()


def _encoding() -> str:
    return getattr(sys.stderr, "encoding", None) or "utf-8"
