"""Properties by which a profile keeps what OpenRTM has no words for: `aiorts.KEY`, each with a value in JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any, Final

from aiorts_openrtm.notes import Note

MARK: Final = "aiorts."
_LONGEST: Final = 100_000


def extra(properties: Mapping[str, str], key: str, kind: type, where: str, notes: list[Note]) -> Any:
    """The value of an extra, of type `kind`; None where there is no extra, or its value cannot be read."""
    text = properties.get(MARK + key)
    if text is None:
        return None
    try:
        value = json.loads(text) if len(text) <= _LONGEST else None
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, kind) or not _is_plain(value):
        notes.append(Note(where, f"{MARK}{key} = {text!r:.60}: cannot be read, and is left out"))
        return None
    return value


def extra_text(value: Any) -> str:
    """The text of a value, in JSON."""
    return json.dumps(_plain(value), ensure_ascii=False)


def _is_plain(value: Any, depth: int = 8) -> bool:
    if isinstance(value, dict):
        return depth > 0 and all(_is_plain(one, depth - 1) for one in value.values())
    if isinstance(value, list):
        return depth > 0 and all(_is_plain(one, depth - 1) for one in value)
    return isinstance(value, str | int) or (isinstance(value, float) and not math.isnan(value))


def frozen(value: Any) -> Any:
    """A value with tuples in the place of lists, as the entries of a system have them."""
    if isinstance(value, list | tuple):
        return tuple(frozen(one) for one in value)
    if isinstance(value, Mapping):
        return {key: frozen(one) for key, one in value.items()}
    return value


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    if isinstance(value, PurePath):
        return value.as_posix()
    return value if isinstance(value, str | int | float) else str(value)
