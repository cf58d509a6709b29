"""Finds the places of all keys and values in a TOML text that a TOML parser has accepted before.

Pure, and linear in the text: it reads keys, strings and brackets, and of values only their extent.
"""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_right
from collections.abc import Iterator
from functools import lru_cache
from typing import Final, TypeAlias

from aiorts.late import dataclass

Key: TypeAlias = tuple[str | int, ...]
"""The path to a value: names of tables and keys, and places in lists from 0."""

_BLANK: Final = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_INLINE_BLANK: Final = re.compile(r"[ \t]*")
_PART: Final = re.compile(r"""[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'""")
_TEXT: Final = re.compile(
    r'''"""(?:[^"\\]|\\[\s\S]|"(?!""))*"{3,5}|\'\'\'(?:[^']|'(?!''))*'{3,5}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*\''''
)
_BARE: Final = re.compile(r"[^,\]}#\n]*[^,\]}#\s]|")


@dataclass(frozen=True, slots=True)
class Place:
    """A stretch of one line. Lines and columns count from 1, columns in characters; `width` is at least 1."""

    line: int
    column: int
    width: int = 1


class Places:
    """The places in one text. A key that is not in it has the place of the nearest key above it."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._keys: dict[Key, tuple[int, int]] = {}
        self._values: dict[Key, tuple[int, int]] = {}
        self._counts: dict[Key, int] = {}
        self._starts = [0, *(found.end() for found in re.finditer("\n", text))]
        for _ in self._document():
            pass

    def key(self, key: Key) -> Place:
        """The place of a key; for an element of a list that of the element."""
        return self._place(self._nearest(key, self._keys, self._values))

    def value(self, key: Key) -> Place:
        """The place of a value; for a table that of its heading."""
        return self._place(self._nearest(key, self._values, self._keys))

    def known(self, key: Key) -> Key:
        """The key, or as much of its beginning as stands in the text."""
        while key and key not in self._keys and key not in self._values:
            key = key[:-1]
        return key

    def inside(self, key: Key, text: str, offset: int) -> Place | None:
        """The place of the character at `offset` of a part of a value; None when the value does not have that part.

        A text with escapes is written differently from its value, so that its parts are not found.
        """
        start, end = self._values.get(key, (0, 0))
        found = self._text.find(text, start, end) if text else -1
        return None if found < 0 else self._place((found + offset, found + offset + 1))

    def extent(self, place: Place) -> tuple[int, int]:
        """The start and end of a place, in characters of the text from 0."""
        start = self._starts[place.line - 1] + place.column - 1
        return start, start + place.width

    def end(self, key: Key) -> int:
        """The end of a key's value, which may be in a later line, in characters of the text from 0."""
        return self._values[key][1]

    def line(self, number: int) -> str:
        """A line of the text, counted from 1; "" where there is none."""
        if not 0 < number <= len(self._starts):
            return ""
        end = self._text.find("\n", self._starts[number - 1])
        return self._text[self._starts[number - 1] : len(self._text) if end < 0 else end].rstrip("\r")

    def _nearest(
        self, key: Key, first: dict[Key, tuple[int, int]], second: dict[Key, tuple[int, int]]
    ) -> tuple[int, int]:
        while key:
            for table in (first, second):
                if key in table:
                    return table[key]
            key = key[:-1]
        return 0, 1

    def _place(self, extent: tuple[int, int]) -> Place:
        start, end = extent
        line = bisect_right(self._starts, start)
        stop = self._text.find("\n", start, end)
        return Place(line, start - self._starts[line - 1] + 1, max(1, (end if stop < 0 else stop) - start))

    # -- reading -----------------------------------------------------------------------------------------------------

    def _document(self) -> Iterator[None]:
        text, here = self._text, 0
        base: Key = ()
        while (here := self._match(_BLANK, here)) < len(text):
            if text[here] != "[":
                here = self._pair(here, base)
                yield
                continue
            double = text.startswith("[[", here)
            start, (parts, here) = here, self._parts(here + 1 + double)
            end = here + 1 + double
            base = self._resolved(tuple(name for name, _, _ in parts[:-1]))
            for depth in range(len(parts) - 1):
                prefix = self._resolved(tuple(name for name, _, _ in parts[: depth + 1]))
                self._keys.setdefault(prefix, parts[depth][1:])
            base = (*base, parts[-1][0])
            if double:
                number = self._counts.get(base, 0)
                self._counts[base] = number + 1
                self._keys.setdefault(base, (start, end))
                base = (*base, number)
            self._keys[base] = parts[-1][1:] if not double else (start, end)
            here = end
            yield

    def _resolved(self, key: Key) -> Key:
        """The key in which the last element's number follows each list of tables."""
        found: Key = ()
        for part in key:
            found = (*found, part)
            if found in self._counts:
                found = (*found, self._counts[found] - 1)
        return found

    def _match(self, pattern: re.Pattern[str], here: int) -> int:
        found = pattern.match(self._text, here)
        return here if found is None else found.end()

    def _parts(self, here: int) -> tuple[list[tuple[str, int, int]], int]:
        """The parts of a dotted key with their extents, and the end of the key."""
        parts = []
        while True:
            start = self._match(_INLINE_BLANK, here)
            end = self._match(_PART, start)
            parts.append((_name(self._text[start:end]), start, end))
            here = self._match(_INLINE_BLANK, end)
            if not self._text.startswith(".", here):
                return parts, here
            here += 1

    def _pair(self, here: int, base: Key) -> int:
        parts, here = self._parts(here)
        key = base
        for name, start, end in parts:
            key = (*key, name)
            self._keys.setdefault(key, (start, end))
        here = self._match(_INLINE_BLANK, here + 1)  # the equals sign
        return max(self._value(here, key), here)

    def _value(self, here: int, key: Key) -> int:
        opening = self._text[here : here + 1]
        if opening == "[":
            end = self._list(here + 1, key)
        elif opening == "{":
            end = self._inline(here + 1, key)
        else:
            end = self._match(_TEXT if opening in ("'", '"') else _BARE, here)
        self._values.setdefault(key, (here, end))
        return end

    def _list(self, here: int, key: Key) -> int:
        number = 0
        while True:
            here = self._match(_BLANK, here)
            if here >= len(self._text) or self._text[here] == "]":
                return here + 1
            if self._text[here] == ",":
                here += 1
                continue
            end = self._value(here, (*key, number))
            number += 1
            here = max(end, here + 1)

    def _inline(self, here: int, key: Key) -> int:
        while True:
            here = self._match(_BLANK, here)
            if here >= len(self._text) or self._text[here] == "}":
                return here + 1
            here = here + 1 if self._text[here] == "," else self._pair(here, key)


def _name(written: str) -> str:
    """The name that a written part of a key means."""
    if written[:1] == '"' and "\\" in written:
        return str(tomllib.loads(f"x = {written}")["x"])
    return written[1:-1] if written[:1] in ("'", '"') else written


@lru_cache(maxsize=32)
def places_of(text: str) -> Places:
    """The places in a text, read at the first call and kept."""
    return Places(text)
