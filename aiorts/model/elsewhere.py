"""Where a lower layer asks for what it does not know by name: the layer that loads plugins, which is not imported
before somebody asks."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, Final

__all__ = ("finder",)

_HOME: Final = "aiorts.kernel.offers"
"""Has a function for each kind, in a table `FINDERS`."""


def finder(kind: str) -> Callable[[str], Any]:
    """Whom to ask for a name of this kind ("types", "codecs") that nobody knows."""
    found: Callable[[str], Any] = import_module(_HOME).FINDERS[kind]
    return found
