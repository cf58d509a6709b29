"""A scanner of typed text, and the error for a mistake in it, whose place a command line can mark."""

from __future__ import annotations

import re
from typing import Final

from aiorts.errors import ConfigurationError

_QUOTED: Final = 60
"""Characters of the text that a message quotes: enough for one line."""
_BLANKS: Final = re.compile(r"[ \t\r\n]*")


class TypedTextError(ConfigurationError):
    """A text does not follow its grammar. Attributes: the kind `what`, the whole `text`, and the `place` from 0.

    Args:
        what: the kind of text ("map", "input0").
        expected: the content of a correct text at the place, or the reason of the refusal.
        found: whether to show the wrong text at the place, too.
    """

    def __init__(self, what: str, text: str, place: int, expected: str, *, found: bool = True) -> None:
        self.what, self.text, self.place = what, text, place
        start = max(0, place - _QUOTED // 2)
        rest = text[place : place + _QUOTED]
        seen = "" if not found else f", found {rest!r}" if rest else ", found the end"
        super().__init__(f"{what} {text[start : place + _QUOTED // 2]!r}, character {place + 1}: {expected}{seen}")
        self.at(text, place)

    def marked(self) -> str:
        """Two lines: the text around the mistake, with "?" for control characters, and a mark under the place."""
        start = max(0, self.place - _QUOTED)
        quoted = "".join(c if c.isprintable() else "?" for c in self.text[start : self.place + _QUOTED])
        return f"{quoted}\n{' ' * (self.place - start)}^"


class Scanner:
    """The text, its kind `what`, and the place of the next character."""

    def __init__(self, text: str, what: str) -> None:
        self.text, self.what, self.place = text, what, 0

    def error(self, expected: str, place: int | None = None) -> TypedTextError:
        """The error for the text at the present place, or at another one."""
        return TypedTextError(self.what, self.text, self.place if place is None else place, expected)

    def blanks(self) -> None:
        """Skip blanks and ends of lines."""
        self.take(_BLANKS)

    def take(self, pattern: re.Pattern[str]) -> str | None:
        """Return the match of a pattern at the place, and move behind it; None where the pattern does not match."""
        match = pattern.match(self.text, self.place)
        if match is None:
            return None
        self.place = match.end()
        return match[0]
