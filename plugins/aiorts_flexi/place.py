"""A mistake in text that somebody typed: what is wrong and where, so that a command line can put a mark under it."""

from __future__ import annotations

from typing import Final

from aiorts.errors import ConfigurationError

__all__ = ("TypedTextError",)

_SHOWN: Final = 60
"""Characters of the text that a message quotes: a line is read, a page is not."""


class TypedTextError(ConfigurationError):
    """A text does not follow its grammar. Attributes: `what` it is, the whole `text`, and the `place` from 0.

    Args:
        what: what the text is ("map", "input0").
        expected: what stands there in a good text, or the reason of the refusal.
        found: show what stands there instead.
    """

    def __init__(self, what: str, text: str, place: int, expected: str, *, found: bool = True) -> None:
        self.what, self.text, self.place = what, text, place
        start = max(0, place - _SHOWN // 2)
        rest = text[place : place + _SHOWN]
        seen = "" if not found else f", found {rest!r}" if rest else ", found the end"
        super().__init__(f"{what} {text[start : place + _SHOWN // 2]!r}, character {place + 1}: {expected}{seen}")
        self.at(text, place)

    def marked(self) -> str:
        """Two lines: the text round the mistake with what does not print as "?", and a mark under the place."""
        start = max(0, self.place - _SHOWN)
        quoted = "".join(c if c.isprintable() else "?" for c in self.text[start : self.place + _SHOWN])
        return f"{quoted}\n{' ' * (self.place - start)}^"
