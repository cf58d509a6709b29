"""The distances between log lines that repeat: each is twice the one before."""

from __future__ import annotations

from typing import Final

FIRST: Final = 10
"""Seconds from the first line to the second."""
_LONGEST: Final = 3600


def longer(seconds: int) -> int:
    """The distance that follows one of so many seconds."""
    return min(2 * seconds, _LONGEST)
