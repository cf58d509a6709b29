"""What the class of a context takes, read from its signature: names and kinds of value; it makes no context."""

from __future__ import annotations

import inspect
import types
import typing
from typing import Any, Final

from aiorts.kernel.context import Context

__all__ = ("WORDS", "arguments_of", "needs_rate", "unfit")

WORDS: Final = {bool: "true or false", int: "a whole number", float: "a number", str: "text", list: "a list"}


def arguments_of(cls: type[Context]) -> dict[str, tuple[type, ...]]:
    """By the name of each argument that a system file may set: the kinds of value it takes; () is any."""
    init: Any = cls.__init__
    try:
        hints = typing.get_type_hints(init)
    except (NameError, TypeError):
        hints = {}
    return {name: _kinds(hints.get(name)) for name in inspect.signature(cls).parameters if name != "name"}


def needs_rate(cls: type[Context]) -> bool:
    """Whether it has a rate with a number as default.

    In a program a default is seen by whoever completes the call; in a file nobody sees what does not stand there.
    """
    rate = inspect.signature(cls).parameters.get("rate")
    return rate is not None and isinstance(rate.default, float)


def unfit(value: Any, kinds: tuple[type, ...]) -> str:
    """What was expected in place of a value; "" when it fits."""
    if not kinds or type(value) in kinds or (type(value) is int and float in kinds):
        return ""
    return f"expected {' or '.join(WORDS[kind] for kind in kinds)}, got {value!r:.80}"


def _kinds(hint: Any) -> tuple[type, ...]:
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    parts = typing.get_args(hint) if union else (hint,)
    known = [part if part in WORDS else list for part in parts if part in WORDS or typing.get_origin(part) is not None]
    return tuple(known) if len(known) == len([part for part in parts if part is not types.NoneType]) else ()
