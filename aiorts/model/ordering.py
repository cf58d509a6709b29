"""Puts what stands in an order back into an order that it had before."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any, TypeVar

T = TypeVar("T", bound=Hashable)


def ordered(there: Iterable[T], order: Iterable[T]) -> list[T]:
    """The same things: those that the order names in that order, the others behind them as they stand."""
    left = dict.fromkeys(there)
    first = dict.fromkeys(one for one in order if one in left)
    return [*first, *(one for one in left if one not in first)]


def arrange(named: dict[str, Any], order: Iterable[str]) -> None:
    """Have the entries of a dict stand in this order, in place."""
    before = list(named)
    line = ordered(before, order)
    if line != before:
        for name in line:
            named[name] = named.pop(name)
