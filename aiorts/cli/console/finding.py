"""Findings of a check as lines for people: for `aiorts check`, and for `aiorts run` of a file that cannot run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from aiorts.cli.console.report import cut, printed

if TYPE_CHECKING:
    from aiorts.system import Finding

_QUOTED: Final = 100
"""The number of characters that are quoted of a line."""


def text_of(one: Finding) -> str:
    """The place, key, cause and remedy of a finding in a line, without the code."""
    return f"{one.place}: {one.where}: {one.message}" if one.where else f"{one.place}: {one.message}"


def line_of(one: Finding) -> str:
    """The whole line of a finding, with its code."""
    return cut(printed(f"aiorts: {one.code}: {text_of(one)}"))


def below(one: Finding) -> list[str]:
    """The line of the file around the place with a mark under it, and the suggested repair."""
    found = []
    if one.quote:
        first = max(0, one.column - 1 - _QUOTED // 2) if len(one.quote) > _QUOTED else 0
        text = "".join(c if c.isprintable() else " " if c == "\t" else "?" for c in one.quote[first : first + _QUOTED])
        before = one.column - 1 - first
        found += [f"  {text}", f"  {' ' * before}{'^' * max(1, min(one.width, len(text) - before))}"]
    if one.suggestion:
        found += [f"    {line}".rstrip() for line in one.suggestion.splitlines()] + [""]
    return found
