"""The comparison of a type at both ends of a link: the text of its layout, its hash, and the first difference.

The text of the other end is data: it is compared, and nothing is imported or made because of it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, Final
from weakref import WeakKeyDictionary

from aiorts.wire import layout_text

_SHOWN: Final = 80
_LONGEST: Final = 65_536
"""The most letters of the other end's text that are compared; more if our own text has over half as many."""
_NOTHING: Final[Mapping[str, Any]] = {}
_LAYOUTS: Final[WeakKeyDictionary[type, tuple[bytes, str]]] = WeakKeyDictionary()
"""The layouts of the types of ports: thousands of links may share one."""


def layout_of(cls: type) -> tuple[bytes, str]:
    """The hash (SHA-256, its first 16 bytes) and the text of a type's layout; equal for equal types."""
    if (found := _LAYOUTS.get(cls)) is None:
        text = layout_text(cls)
        found = _LAYOUTS[cls] = hashlib.sha256(text.encode()).digest()[:16], text
    return found


def difference(theirs: str, ours: str) -> str:
    """The first difference between two layouts, in the order of our fields; "" if there is none."""
    if theirs == ours:
        return ""
    if len(theirs) > max(_LONGEST, 2 * len(ours)):
        return f"the other end describes its type in {len(theirs)} letters"
    try:
        other = json.loads(theirs)
    except (ValueError, RecursionError):
        return "the other end describes its type in another way"
    mine = json.loads(ours)
    sent, taken = _name(other), _name(mine)
    if sent != taken:
        return f"the writer sends {_shown(sent)}, the reader takes {taken}"
    if found := _between(_value(other), _value(mine), taken):
        return found
    lies, wanted = other.get("x-frame"), mine["x-frame"]
    if lies != wanted:
        return f"{taken} lies otherwise in its frames: {_shown(lies)} at the writer, {_shown(wanted)} at the reader"
    return "the other end describes its type in another way"


def _between(other: Any, mine: Any, place: str) -> str:
    if other == mine and _order(other) == _order(mine):
        return ""
    theirs, ours = _fields(other), _fields(mine)
    if theirs is None or ours is None:
        return f"{place} is of another kind: {_kind(other)} at the writer, {_kind(mine)} at the reader"
    for name in ours:
        if name not in theirs:
            return f"{place} has no field {name!r} at the writer"
        if found := _between(theirs[name], ours[name], f"{place}.{name}"):
            return found
    for name in theirs:
        if name not in ours:
            return f"{place} has no field {_shown(name)} at the reader"
    return f"the fields of {place} are in another order"


def _fields(schema: Any) -> Mapping[str, Any] | None:
    found = schema.get("properties") if isinstance(schema, dict) else None
    return found if isinstance(found, dict) else None


def _order(schema: Any) -> list[str]:
    return list(_fields(schema) or _NOTHING)


def _name(document: Any) -> Any:
    return document.get("title") if isinstance(document, dict) else None


def _value(document: Any) -> Any:
    """The schema of the value itself, which stands third in a frame."""
    items = document.get("prefixItems") if isinstance(document, dict) else None
    return items[2] if isinstance(items, list) and len(items) == 3 else None


def _kind(schema: Any) -> str:
    if not isinstance(schema, dict):
        return _shown(schema)
    return _shown(schema.get("x-array", schema.get("x-number", schema.get("type"))))


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
