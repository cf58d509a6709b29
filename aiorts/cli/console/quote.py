"""Quotes a line of typed text that has a mistake, with a mark under the place.

Each character is printed in a known number of columns, so that the mark is at its place: tabs, control characters and
characters outside the stream's encoding as escapes, wide characters as two columns. A long line is cut.
"""

from __future__ import annotations

import unicodedata
from typing import Final

from aiorts.errors import Place

_NARROWEST: Final = 20
_CUT: Final = "..."
_LONGEST_MARK: Final = 60


def quote(place: Place, width: int = 78, encoding: str = "utf-8") -> tuple[str, str]:
    """The line of the text that has the place, and `^` under it; both at most `width` columns wide."""
    width = max(width, _NARROWEST)
    first = place.text.rfind("\n", 0, place.start) + 1
    last = place.text.find("\n", place.start)
    last = len(place.text) if last < 0 else last
    start = place.start - first
    # Only the part that fits is examined: a line may be a megabyte long.
    skip = max(0, start - width)
    cells = [_cell(c, encoding) for c in place.text[first + skip : min(last, place.start + width)]]
    at = start - skip
    count = max(1, min(place.end, last) - place.start)
    visible, before, is_cut = _window(cells, at, width, cut=skip > 0)
    mark = sum(cells_of(cell) for cell in cells[at : at + min(count, _LONGEST_MARK)]) or 1
    more = _CUT if is_cut or last > place.start + width else ""
    line = f"{visible}{more}"
    return line, f"{' ' * before}{'^' * max(1, min(mark, width - before, cells_of(line) - before))}"


def cells_of(text: str) -> int:
    """The number of columns of a text on a terminal."""
    if text.isascii():
        return len(text)
    return sum(2 if unicodedata.east_asian_width(c) in "WF" else 0 if unicodedata.combining(c) else 1 for c in text)


def _cell(character: str, encoding: str) -> str:
    """The printed form of one character."""
    # A combining character has no column of its own: a mark for it would stand under another character.
    if not character.isprintable() or unicodedata.combining(character):
        return ascii(character)[1:-1]
    return character.encode(encoding, "backslashreplace").decode(encoding)


def _window(cells: list[str], at: int, width: int, *, cut: bool) -> tuple[str, int, bool]:
    """The part of the cells to print, the columns before the cell `at`, and whether the end is cut."""
    room = width - 2 * len(_CUT)
    low = at
    used = cells_of(cells[at]) if at < len(cells) else 1
    while low > 0 and (used + cells_of(cells[low - 1])) <= room * 2 // 3:
        low -= 1
        used += cells_of(cells[low])
    high = min(at + 1, len(cells))
    while high < len(cells) and used + cells_of(cells[high]) <= room:
        used += cells_of(cells[high])
        high += 1
    while low > 0 and used + cells_of(cells[low - 1]) <= room:
        low -= 1
        used += cells_of(cells[low])
    ahead = _CUT if low > 0 or cut else ""
    before = len(ahead) + sum(cells_of(cell) for cell in cells[low:at])
    return ahead + "".join(cells[low:high]), before, high < len(cells)
