"""Where a lower layer asks for what it does not know by name: the layer that loads plugins has put its answer here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ("finder", "look_in")

_finders: dict[str, Callable[[str], Any]] = {}


def look_in(kind: str, found_by: Callable[[str], Any]) -> None:
    """Have `found_by` asked for names of this kind ("types", "codecs") that nobody knows; the last one counts."""
    _finders[kind] = found_by


def finder(kind: str) -> Callable[[str], Any] | None:
    """What to ask, or None when nothing that loads plugins is there."""
    return _finders.get(kind)
