"""Turns names of OpenRTM into names that aiorts allows; different names stay different."""

from __future__ import annotations

import re
from collections.abc import Container
from itertools import count
from typing import Final

_ALLOWED: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,99}")
_REFUSED: Final = re.compile(r"[^A-Za-z0-9_-]")


def is_name(text: str) -> bool:
    """Whether a text may be a name as it is."""
    return _ALLOWED.fullmatch(text) is not None


def named(text: str, taken: Container[str] = ()) -> str:
    """The text, or the nearest allowed name that is not taken."""
    name = text if is_name(text) else _REFUSED.sub("_", text).lstrip("-")[:90] or "unnamed"
    if name not in taken:
        return name
    return next(other for number in count(2) if (other := f"{name[:90]}_{number}") not in taken)
