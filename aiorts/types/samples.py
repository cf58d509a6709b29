"""What ports ask about samples: may this type travel, can this sample change, the same sample at another time.

A mutable dataclass travels as a snapshot: an instance of a hidden subclass that refuses assignment and compares equal
to the original, so that all readers can share it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from types import MemberDescriptorType
from typing import Any, NoReturn, TypeVar

from aiorts.errors import DeclarationError, RecordError, RecordTypeError
from aiorts.types.arrays import ArrayKind
from aiorts.types.kinds import SCALARS, STAMP_LIMIT
from aiorts.types.rows import RowsKind, TupleKind
from aiorts.types.structure import Field, Structure, describe

T = TypeVar("T")

__all__ = (
    "PLAIN_TYPES",
    "check_port_type",
    "check_shape",
    "frozen_class",
    "has_tm",
    "is_mutable",
    "snapshot",
    "with_tm",
)

PLAIN_TYPES: tuple[type, ...] = (bool, int, float, str, bytes)
FROZEN_OF = "__aiorts_frozen_of__"
_frozen: dict[type, type] = {}


def check_port_type(cls: object) -> None:
    """DeclarationError if values of `cls` cannot travel.

    Not a record, a dataclass, or one of bool, int, float, str, bytes.
    """
    if cls in PLAIN_TYPES:
        return
    if not isinstance(cls, type) or not dataclasses.is_dataclass(cls):
        raise DeclarationError(
            f"{getattr(cls, '__qualname__', cls)!s} cannot be the type of a port; "
            "use a record of aiorts.types, a class decorated with @record or @dataclass, or bool, int, float, str, "
            "bytes"
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
            raise RecordError(
                f"{cls.__qualname__}.{field.name}: expected {field.spelling}, got nothing; set it first"
            ) from None
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
        namespace = {
            "__module__": cls.__module__,
            "__qualname__": cls.__qualname__,
            "__doc__": cls.__doc__,
            "__slots__": (),
        }
        names = tuple(field.name for field in dataclasses.fields(cls))
        methods = {
            "__setattr__": _refuse,
            "__delattr__": _refuse,
            FROZEN_OF: cls,
            "__hash__": None,
            "__eq__": _equality(cls, names),
        }
        known = _frozen[cls] = type(cls)(cls.__name__, (cls,), {**namespace, **methods})
    return known


def _refuse(self: Any, name: str, value: object = None) -> NoReturn:
    raise dataclasses.FrozenInstanceError(
        f"{type(self).__qualname__}.{name}: a sample that was written is shared by all its readers; "
        "copy it first (dataclasses.replace)"
    )


def _equality(cls: type, names: tuple[str, ...]) -> Any:
    structure = describe(cls)
    kinds = {field.name: field.kind for field in structure.fields}

    def equal(self: Any, other: object) -> Any:
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
    """A copy of the sample with another time stamp (int nanoseconds or a Time).

    RecordError if it has none or `tm` does not fit.
    """
    cls = type(sample)
    restamp = _restampers.get(cls) or _restampers.setdefault(cls, _restamper(cls))
    return restamp(sample, tm)  # type: ignore[no-any-return]


_restampers: dict[type, Callable[[Any, Any], Any]] = {}


def _restamper(cls: type) -> Callable[[Any, Any], Any]:
    """The copying of one class, its fields looked up once."""
    structure = describe(original(cls))
    stamp = structure.field("tm")
    if not structure.has_tm or stamp is None:
        raise RecordTypeError(f"{cls.__qualname__} has no time stamp; expected a type with a field tm")
    check, where, as_time = SCALARS["stamp"].check, f"{cls.__qualname__}.tm", stamp.record
    store_tm = _setter(cls, "tm")
    others = tuple((field.name, _setter(cls, field.name)) for field in structure.fields if field.name != "tm")
    new = object.__new__

    def restamp(sample: Any, tm: Any) -> Any:
        ns = tm if type(tm) is int and 0 <= tm < STAMP_LIMIT else check(tm, where)
        copied: Any = new(cls)
        store_tm(copied, ns if as_time is None else as_time.from_ns(ns))  # type: ignore[attr-defined]
        for name, store in others:
            store(copied, getattr(sample, name))
        return copied

    return restamp


def _setter(cls: type, name: str) -> Callable[[Any, Any], None]:
    """What stores a field past any refusal to assign: the slot itself, or the instance's dictionary."""
    slot = getattr(cls, name, None)
    if isinstance(slot, MemberDescriptorType):
        return slot.__set__
    return lambda instance, value: object.__setattr__(instance, name, value)


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
        raise RecordTypeError(
            f"{structure.cls.__qualname__}: expected a field data or one array to check a shape on, found {found}"
        )
    return chosen[0]
