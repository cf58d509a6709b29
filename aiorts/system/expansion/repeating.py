"""Handles `if` and `repeat`: whether a part exists, and its copies, each with its number in the place of `{i}`.

Numbers count from 0. `{i+1}` and `{i-1}` are the next number and the one before it; `{{i}}` is a literal `{i}`.
"""

from __future__ import annotations

import re
from typing import Any, Final

from aiorts.system.expansion.faults import Fault
from aiorts.system.expansion.variables import Scope
from aiorts.system.text.origins import Origin
from aiorts.system.text.places import Key

IF, REPEAT = "if", "repeat"
MOST: Final = 10_000
"""The most copies of one part."""
_NUMBER: Final = re.compile(r"\{(\{i(?:[+-]\d{1,6})?\})\}|\{i([+-]\d{1,6})?\}")


def copies(table: dict[str, Any], scope: Scope, origin: Origin) -> range | None:
    """The numbers of the copies; None for a part without `repeat`."""
    if REPEAT not in table:
        return None
    at = origin.below(REPEAT)
    count = scope.filled(table[REPEAT], at)
    if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= MOST:
        raise Fault(at, f"expected how often, a whole number 0..{MOST}, got {count!r:.80}")
    return range(count)


def is_there(table: dict[str, Any], scope: Scope, origin: Origin) -> bool:
    """Whether the condition of a part holds."""
    return IF not in table or scope.holds(table[IF], origin.below(IF))


def has_number(text: str) -> bool:
    """Whether a text has a number in it, such as `{i}`, which differs from copy to copy."""
    return any(found[1] is None for found in _NUMBER.finditer(text))


def numbered(value: Any, number: int, origin: Origin, moved: dict[Key, Origin], path: Key = ()) -> Any:
    """The value for one copy; the places of renamed keys are put into `moved`. A text `{i}` becomes an integer."""
    if isinstance(value, str):
        if "{i" not in value:
            return value
        return number if value == "{i}" else _written(value, number)
    if isinstance(value, list):
        return [numbered(one, number, origin.below(at), moved, (*path, at)) for at, one in enumerate(value)]
    if not isinstance(value, dict):
        return value
    made: dict[str, Any] = {}
    for key, one in value.items():
        below = origin.below(key)
        name = _written(key, number) if "{i" in key else key
        if name in made:
            raise Fault(below, f"there is a key {name[:80]!r} already", of_key=True)
        if name != key:
            moved[(*path, name)] = below
        made[name] = numbered(one, number, below, moved, (*path, name))
    return made


def name_of(text: str, number: int) -> str:
    """The name of one copy."""
    return _written(text, number)


def _written(text: str, number: int) -> str:
    return _NUMBER.sub(lambda found: found[1] or str(number + int(found[2] or 0)), text)
