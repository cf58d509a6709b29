"""On which line a key of a TOML text stands: for messages about a text that a TOML reader has accepted already."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Final

__all__ = ("line_of", "lines_of")

_BLANK: Final = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_PART: Final = re.compile(r"""[ \t]*(?:(?P<bare>[\w-]+)|(?P<basic>"(?:[^"\\\n]|\\.)*")|'(?P<literal>[^'\n]*)')[ \t]*""")
_IN_VALUE: Final = re.compile(
    r'''"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|#[^\n]*|[\[{]|[\]}]|\n''', re.DOTALL
)


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
    """The line of a key, or of what holds it; 1 when nothing of it stands anywhere."""
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
