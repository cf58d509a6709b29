"""The lines of a TOML text's keys, and the things in a text that are too much for a TOML reader."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final

TOO_LARGE: Final = "a number of so many digits has no place here (at most 308)"

_DEEPEST: Final = 32  # stands in the two patterns, too
_LONG_KEY: Final = re.compile(r"(?:\.[\w\- \t]*+){32}")
_DEEP: Final = re.compile(r"(?:[\[{][ \t\r\n]*+){32}")
_NO_STRUCTURE: Final = re.compile(
    r'''#[^\n]*+|"""(?:[^"\\]|\\.|"(?!""))*+"{0,5}|\'\'\'(?:[^']|'(?!\'\'))*+'{0,5}'''
    r"""|"(?:[^"\\\n]|\\.)*+"?|'[^'\n]*+'?""",
    re.DOTALL,
)
"""Comments and texts, also unterminated ones."""

_BLANK: Final = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_PART: Final = re.compile(r"""[ \t]*(?:(?P<bare>[\w-]+)|(?P<basic>"(?:[^"\\\n]|\\.)*")|'(?P<literal>[^'\n]*)')[ \t]*""")
_IN_VALUE: Final = re.compile(
    r'''"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|#[^\n]*|[\[{]|[\]}]|\n''', re.DOTALL
)


def excess(text: str) -> tuple[int, str] | None:
    """The place of a key with too many parts, or of too deep nesting, with a message; None if there is neither.

    A TOML reader's time grows with the square of a key's parts, and deep nesting meets the interpreter's limit of
    recursion.
    """
    bare = _NO_STRUCTURE.sub(_filled, text)
    for pattern, what in ((_LONG_KEY, "a key of so many parts"), (_DEEP, "nesting so deep")):
        if (found := pattern.search(bare)) is not None:
            return found.start(), f"{what} has no place here (at most {_DEEPEST})"
    return None


def huge_number(tables: Mapping[str, Any]) -> tuple[str | int, ...] | None:
    """The path to the first whole number beyond the range of a float; None when there is none.

    Such a number is a mistake, and code that computes with it as seconds, Hz or metres, or shows it, would fail.
    """
    waiting: list[tuple[tuple[str | int, ...], Any]] = [((), tables)]
    while waiting:
        key, value = waiting.pop()
        if isinstance(value, int) and abs(value) > sys.float_info.max:
            return key
        if isinstance(value, Mapping | list):
            inner = value.items() if isinstance(value, Mapping) else enumerate(value)
            waiting += reversed([((*key, name), item) for name, item in inner])
    return None


def _filled(found: re.Match[str]) -> str:
    """A text of the same length without dots and brackets: blanks for a comment, a word for a text."""
    return (" " if found[0][0] == "#" else "_") * len(found[0])


def lines_of(text: str) -> dict[tuple[str, ...], int]:
    """The line, counted from 1, of every table header and every key that begins a line."""
    lines: dict[tuple[str, ...], int] = {}
    table: tuple[str, ...] = ()
    line, counted, at = 1, 0, 0
    while True:
        found = _BLANK.match(text, at)
        at = found.end() if found is not None else at
        if at >= len(text):
            return lines
        header = text.startswith("[", at)
        begin = at
        while text.startswith("[", at):
            at += 1
        key, at = _key(text, at)
        if not key:
            return lines
        line += text.count("\n", counted, begin)
        counted = begin
        if header:
            table = key
            at = text.find("\n", at) if "\n" in text[at:] else len(text)
        else:
            key = (*table, *key)
            at = _after_value(text, at)
        lines.setdefault(key, line)


def line_of(lines: Mapping[tuple[str, ...], int], key: Sequence[str]) -> int:
    """The line of a key, or of the nearest table that holds it; 1 when the text has neither."""
    for length in range(len(key), 0, -1):
        wanted = tuple(key[:length])
        if wanted in lines:
            return lines[wanted]
        below = [line for known, line in lines.items() if known[:length] == wanted]
        if below:
            return min(below)
    return 1


def _key(text: str, at: int) -> tuple[tuple[str, ...], int]:
    parts = []
    while (found := _PART.match(text, at)) is not None:
        parts.append(found["bare"] or found["literal"] or _unquoted(found["basic"] or '""'))
        at = found.end()
        if not text.startswith(".", at):
            break
        at += 1
    return tuple(parts), at


def _unquoted(token: str) -> str:
    try:
        return str(json.loads(token))
    except ValueError:
        return token  # an escape of TOML that JSON has not


def _after_value(text: str, at: int) -> int:
    depth = 0
    for found in _IN_VALUE.finditer(text, at):
        part = found[0]
        if part in ("[", "{"):
            depth += 1
        elif part in ("]", "}"):
            depth -= 1
        elif part == "\n" and depth <= 0:
            return found.end()
    return len(text)
