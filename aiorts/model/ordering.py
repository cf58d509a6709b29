"""Puts entries back into a former order."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any, TypeVar

T = TypeVar("T", bound=Hashable)


def ordered(there: Iterable[T], order: Iterable[T]) -> list[T]:
    """The entries named in `order`, in that order, then the others as they stand."""
    left = dict.fromkeys(there)
    first = dict.fromkeys(one for one in order if one in left)
    return [*first, *(one for one in left if one not in first)]


def arrange(named: dict[str, Any], order: Iterable[str]) -> None:
    """Put the entries of a dict in this order, in place; the other entries follow."""
    before = list(named)
    line = ordered(before, order)
    if line != before:
        for name in line:
            named[name] = named.pop(name)
