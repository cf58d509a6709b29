"""Functions that are written out for a number of fields: they do the work of loops in a third of the time.

This is the only place where text becomes code. A text consists of the words of its author, of numbers, and of names
and values by `repr`: nothing that came in a frame or a file can be in it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any


def generate(head: str, lines: Sequence[str], known: Mapping[str, Any]) -> Callable[..., Any]:
    """The function with this head, such as "read(record)", and these lines, in which `known` names other objects."""
    names = dict(known)
    exec("\n ".join((f"def {head}:", *lines)), names)  # noqa: S102
    made: Callable[..., Any] = names[head.partition("(")[0]]
    return made
