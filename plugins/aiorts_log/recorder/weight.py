"""Estimates the bytes of a waiting record, which bounds the memory of a queue; small types cost nothing."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any, Final

from aiorts.types import describe

SMALL: Final = 256
"""Bytes counted for each record besides its parts that can grow without limit."""
_GROWS: Final = ("seq[", "ndarray", "map", "str", "bytes")


def weigher(cls: type) -> Callable[[Any], int] | None:
    """A function that estimates the bytes of a record of this type; None when all of them are small."""
    if cls in (str, bytes):
        return lambda value: SMALL + len(value)
    if not hasattr(cls, "__dataclass_fields__"):
        return None
    fields = [field for field in describe(cls).fields if _grows(field.kind)]
    if not fields:
        return None
    names = tuple(field.name for field in fields)
    kind: Any = fields[0].kind
    is_array = describe(cls).checked and not hasattr(kind, "columns") and not hasattr(kind, "item")
    if len(fields) == 1 and str(kind.spelling).startswith(("seq[", "ndarray")) and is_array:
        nbytes = attrgetter(f"{names[0]}.nbytes")
        return lambda record: SMALL + nbytes(record)

    def weigh(record: Any) -> int:
        return SMALL + sum(_size_of(getattr(record, name)) for name in names)

    return weigh


def _grows(kind: Any) -> bool:
    kind = getattr(kind, "inner", kind)
    if hasattr(kind, "structure"):
        return any(_grows(field.kind) for field in kind.structure.fields)
    if hasattr(kind, "columns") or hasattr(kind, "item"):
        return True
    if hasattr(kind, "items"):
        return any(_grows(item) for item in kind.items)
    return str(kind.spelling).startswith(_GROWS)


def _size_of(value: Any) -> int:
    size = getattr(value, "nbytes", None)
    if size is not None:
        return int(size)
    array = getattr(value, "array", None)
    if array is not None:
        return int(array.nbytes)
    if isinstance(value, str | bytes):
        return len(value)
    if hasattr(value, "values") and hasattr(value, "keys"):
        return sum(map(_size_of, value.values()))
    if isinstance(value, tuple | list):
        return sum(map(_size_of, value))
    if hasattr(type(value), "__dataclass_fields__"):
        return SMALL + sum(_size_of(getattr(value, name)) for name in type(value).__dataclass_fields__)
    return 16
