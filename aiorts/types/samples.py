"""What ports ask about samples: may this type travel, can this sample change, the same sample at another time.

A mutable dataclass travels as a snapshot: an instance of a hidden subclass that refuses assignment and compares equal to the
original, so that all readers can share it.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NoReturn, TypeVar

from aiorts.errors import DeclarationError, RecordError, RecordTypeError
from aiorts.types.arrays import ArrayKind
from aiorts.types.kinds import SCALARS
from aiorts.types.rows import RowsKind, TupleKind
from aiorts.types.structure import Field, Structure, describe

T = TypeVar("T")

__all__ = ("PLAIN_TYPES", "check_port_type", "check_shape", "frozen_class", "has_tm", "is_mutable", "snapshot", "with_tm")

PLAIN_TYPES: tuple[type, ...] = (bool, int, float, str, bytes)
FROZEN_OF = "__aiorts_frozen_of__"
_frozen: dict[type, type] = {}


def check_port_type(cls: object) -> None:
    """DeclarationError if values of `cls` cannot travel: not a record, a dataclass, or one of bool, int, float, str, bytes."""
    if cls in PLAIN_TYPES:
        return
    if not isinstance(cls, type) or not dataclasses.is_dataclass(cls):
        raise DeclarationError(
            f"{getattr(cls, '__qualname__', cls)!s} cannot be the type of a port; "
            "use a record of aiorts.types, a class decorated with @record or @dataclass, or bool, int, float, str, bytes"
        )
    describe(original(cls))


def original(cls: type) -> type:
    """The class a snapshot is of; any other class itself."""
    found: type = cls.__dict__.get(FROZEN_OF, cls)
    return found


def is_mutable(cls: type) -> bool:
    """Whether a sample of `cls` can still change after it was written: then it travels as a snapshot."""
    if cls in PLAIN_TYPES or FROZEN_OF in cls.__dict__:
        return False
    return describe(cls).mutable


def has_tm(cls: type) -> bool:
    """Whether samples of `cls` carry a time stamp `tm` (int nanoseconds or a Time)."""
    return cls not in PLAIN_TYPES and describe(original(cls)).has_tm


def snapshot(sample: T) -> T:
    """A deeply immutable copy of a sample of a mutable dataclass, checked as it is made; any other sample itself."""
    cls = type(sample)
    if not is_mutable(cls):
        return sample
    structure = describe(cls)
    target = frozen_class(cls) if not _is_frozen(cls) else cls
    copied: Any = object.__new__(target)
    for field in structure.fields:
        try:
            value = getattr(sample, field.name)
        except AttributeError:
            raise RecordError(f"{cls.__qualname__}.{field.name}: expected {field.spelling}, got nothing; set it first") from None
        if type(value) is not field.kind.exact:
            value = field.kind.check(value, f"{cls.__qualname__}.{field.name}")
        object.__setattr__(copied, field.name, value)
    return copied  # type: ignore[no-any-return]


def _is_frozen(cls: type) -> bool:
    return bool(cls.__dataclass_params__.frozen)  # type: ignore[attr-defined]


def frozen_class(cls: type) -> type:
    """The hidden subclass of a mutable dataclass whose instances refuse assignment."""
    known = _frozen.get(cls)
    if known is None:
        namespace = {"__module__": cls.__module__, "__qualname__": cls.__qualname__, "__doc__": cls.__doc__, "__slots__": ()}
        names = tuple(field.name for field in dataclasses.fields(cls))
        methods = {"__setattr__": _refuse, "__delattr__": _refuse, FROZEN_OF: cls, "__hash__": None, "__eq__": _equality(cls, names)}
        known = _frozen[cls] = type(cls)(cls.__name__, (cls,), {**namespace, **methods})
    return known


def _refuse(self: Any, name: str, value: object = None) -> NoReturn:
    raise dataclasses.FrozenInstanceError(
        f"{type(self).__qualname__}.{name}: a sample that was written is shared by all its readers; copy it first (dataclasses.replace)"
    )


def _equality(cls: type, names: tuple[str, ...]) -> Any:
    structure = describe(cls)
    kinds = {field.name: field.kind for field in structure.fields}

    def equal(self: Any, other: object) -> bool:
        if original(type(other)) is not cls:
            return NotImplemented
        return all(_same(kinds[name], getattr(self, name), getattr(other, name)) for name in names)

    return equal


def _same(kind: Any, left: Any, right: Any) -> bool:
    if left is right:
        return True
    if isinstance(right, list) or isinstance(left, list):
        left, right = tuple(left), tuple(right)
    return bool(kind.same(left, right))


def with_tm(sample: T, tm: Any) -> T:
    """A copy of the sample with another time stamp (int nanoseconds or a Time). RecordError if it has none or `tm` does not fit."""
    cls = type(sample)
    structure = describe(original(cls))
    if not structure.has_tm:
        raise RecordTypeError(f"{cls.__qualname__} has no time stamp; expected a type with a field tm")
    stamp = _stamp(structure, tm)
    copied: Any = object.__new__(cls)
    for field in structure.fields:
        value = stamp if field.name == "tm" else getattr(sample, field.name)
        object.__setattr__(copied, field.name, value)
    return copied  # type: ignore[no-any-return]


def _stamp(structure: Structure, tm: Any) -> Any:
    where = f"{structure.cls.__qualname__}.tm"
    ns = SCALARS["stamp"].check(tm, where)
    field = structure.field("tm")
    if field is not None and field.record is not None:
        return field.record.from_ns(ns)  # type: ignore[attr-defined]
    return ns


def check_shape(sample: object, shape: tuple[int, ...]) -> None:
    """RecordError unless the sample's array has this shape; -1 stands for any length.

    The array is the field `data`, or the only array of the sample. A sequence of records has the shape (n,).
    """
    structure = describe(original(type(sample)))
    field = _array_field(structure)
    value = getattr(sample, field.name)
    got: tuple[int, ...] = value.shape if hasattr(value, "shape") else (len(value),)
    if len(got) == len(shape) and all(want in (-1, have) for want, have in zip(shape, got, strict=True)):
        return
    expected = f"({', '.join('any' if want == -1 else str(want) for want in shape)}{',' if len(shape) == 1 else ''})"
    raise RecordError(f"{type(sample).__qualname__}.{field.name}: expected shape {expected}, got {got}")


def _array_field(structure: Structure) -> Field:
    arrays = [field for field in structure.fields if isinstance(field.kind, (ArrayKind, RowsKind, TupleKind))]
    chosen = [field for field in arrays if field.name == "data"] or arrays
    if len(chosen) != 1:
        found = ", ".join(field.name for field in chosen) or "none"
        raise RecordTypeError(f"{structure.cls.__qualname__}: expected a field data or one array to check a shape on, found {found}")
    return chosen[0]


