"""A copy of a sample that shares no memory with anything its writer may have kept.

`copy.deepcopy` of a record is the record itself, which is right as long as its arrays are owned. Whoever looks for a
writer that kept a view of its own array needs a copy that really is one: the debug mode of ports uses this.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeVar

from aiorts.types.rows import RecordArray
from aiorts.types.samples import PLAIN_TYPES, original
from aiorts.types.structure import describe

__all__ = ("detached",)

T = TypeVar("T")


def detached(sample: T) -> T:
    """A copy of `sample`, a record or another dataclass, with arrays of its own."""
    cls = type(sample)
    if cls in PLAIN_TYPES:
        return sample
    copied: Any = object.__new__(cls)
    for field in describe(original(cls)).fields:
        object.__setattr__(copied, field.name, _detached_value(getattr(sample, field.name)))
    return copied  # type: ignore[no-any-return]


def _detached_value(value: Any) -> Any:
    if isinstance(value, RecordArray):
        return RecordArray(value._kind, _detached_value(value.array))  # type: ignore[attr-defined]
    if isinstance(value, (tuple, list)):
        return type(value)(_detached_value(item) for item in value)
    if isinstance(value, Mapping):
        copied = {key: _detached_value(item) for key, item in value.items()}
        return MappingProxyType(copied) if isinstance(value, MappingProxyType) else type(value)(copied)  # type: ignore[call-arg]
    if hasattr(value, "__array_interface__") and hasattr(value, "setflags"):
        array = value.copy()
        array.setflags(write=False)
        return array
    return detached(value) if hasattr(type(value), "__dataclass_fields__") else value
