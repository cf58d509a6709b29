"""Two lines for a mistake in typed text: the line it is in, and a mark under the place; they command no terminal.

Every character is shown in cells of a known width, so the mark stands where it should: tabs, control characters and
what the stream cannot write by their escapes, wide characters as the two columns they take. A long line is cut.
"""

from __future__ import annotations

import unicodedata
from typing import Final

from aiorts.errors import Place

__all__ = ("cells_of", "quote")

_NARROWEST: Final = 20
_CUT: Final = "..."
_LONGEST_MARK: Final = 60


def quote(place: Place, width: int = 78, encoding: str = "utf-8") -> tuple[str, str]:
    """The line of the text in which the place begins, and `^` under it; neither is wider than `width` columns."""
    width = max(width, _NARROWEST)
    first = place.text.rfind("\n", 0, place.start) + 1
    last = place.text.find("\n", place.start)
    last = len(place.text) if last < 0 else last
    start = place.start - first
    # Only what can be shown is looked at: a line may be a megabyte long.
    skip = max(0, start - width)
    cells = [_cell(c, encoding) for c in place.text[first + skip : min(last, place.start + width)]]
    at = start - skip
    count = max(1, min(place.end, last) - place.start)
    shown, before, is_cut = _window(cells, at, width, cut=skip > 0)
    mark = sum(cells_of(cell) for cell in cells[at : at + min(count, _LONGEST_MARK)]) or 1
    more = _CUT if is_cut or last > place.start + width else ""
    line = f"{shown}{more}"
    return line, f"{' ' * before}{'^' * max(1, min(mark, width - before, cells_of(line) - before))}"


def cells_of(text: str) -> int:
    """Columns that a text takes on a terminal."""
    if text.isascii():
        return len(text)
    return sum(2 if unicodedata.east_asian_width(c) in "WF" else 0 if unicodedata.combining(c) else 1 for c in text)


def _cell(character: str, encoding: str) -> str:
    """One character as it is shown."""
    # A combining character has no column of its own, and a mark under none is under another.
    if not character.isprintable() or unicodedata.combining(character):
        return ascii(character)[1:-1]
    return character.encode(encoding, "backslashreplace").decode(encoding)


def _window(cells: list[str], at: int, width: int, *, cut: bool) -> tuple[str, int, bool]:
    """What is shown of the cells, the columns before the one of number `at`, and whether the end is missing."""
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
