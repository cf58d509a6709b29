"""Functions for the samples of ports: whether a type may travel, whether a sample can change, copies with another time.

A record was checked when it was built. Any other dataclass is checked when it is written: a mutable one travels as an
instance of a hidden subclass that refuses assignment and compares equal to the original, so that all readers can share
it. A frozen one travels as it is, or as a copy if a field holds something that can change or has to be converted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter, is_
from types import MappingProxyType, MemberDescriptorType
from typing import Any, NoReturn, TypeVar

from aiorts.errors import DeclarationError, RecordError, RecordTypeError
from aiorts.types.arrays import ArrayKind
from aiorts.types.generated import generate
from aiorts.types.kinds import SCALARS, STAMP_LIMIT, IntKind, Kind, StampKind
from aiorts.types.rows import RecordArray, RowsKind, TupleKind
from aiorts.types.structure import STRUCTURE, Field, Structure, describe, kind_of

__all__ = ("check_port_type", "check_shape", "detached", "has_tm", "is_mutable", "snapshot", "with_tm")

T = TypeVar("T")

PLAIN_TYPES: tuple[type, ...] = (bool, int, float, str, bytes)
FROZEN_OF = "__aiorts_frozen_of__"
_frozen: dict[type, type] = {}


def check_port_type(cls: object) -> None:
    """Raise DeclarationError if values of `cls` cannot travel.

    Records, dataclasses, and bool, int, float, str, bytes can.
    """
    if cls in PLAIN_TYPES:
        return
    if not isinstance(cls, type) or not dataclasses.is_dataclass(cls):
        if isinstance(cls, str):
            raise DeclarationError(
                f"{cls!r:.60} is text and cannot be the type of a port; give the class itself, without quotes"
            )
        raise DeclarationError(
            f"{getattr(cls, '__qualname__', cls)!s:.200} cannot be the type of a port; "
            "use a record of aiorts.types, a class decorated with @record or @dataclass, or bool, int, float, str, "
            "bytes"
        )
    describe(original(cls))


def original(cls: type) -> type:
    """For the hidden class of snapshots, the dataclass that it was made from; any other class itself."""
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
    """The sample as it may travel: each field matches its declaration, and nothing in it can change.

    Returns the sample itself if it is so already, else a copy. RecordError names the field that does not match.
    """
    cls = type(sample)
    if cls not in _looks:
        _looks[cls] = look_at(cls)
    look = _looks[cls]
    return sample if look is None else look(sample)


_looks: dict[type, Callable[[Any], Any] | None] = {}


def look_at(cls: type) -> Callable[[Any], Any] | None:
    """The function that `snapshot` calls for samples of one class; None for classes whose samples travel unchecked.

    It compares the class of each field's value, and calls `check` only for values that do not fit or are mutable.
    """
    if cls in PLAIN_TYPES:
        kind, name = kind_of(cls, cls.__name__), cls.__name__
        exact, low, high = _bounds(kind)
        if exact is cls and low is None:
            return None
        return lambda sample: sample if low is not None and low <= sample <= high else kind.check(sample, name)
    if FROZEN_OF in cls.__dict__ or describe(cls).checked:
        return None
    fields = describe(cls).fields
    names = [field.name for field in fields]
    steps = [(*_bounds(one.kind), (one.name, one.kind.check, f"{cls.__qualname__}.{one.name}")) for one in fields]
    values_of = _values_of(names)
    frozen = cls.__dataclass_params__.frozen  # type: ignore[attr-defined]
    target, new, store = cls if frozen else frozen_class(cls), object.__new__, object.__setattr__

    def look(sample: Any) -> Any:
        changed = {}
        try:
            values = values_of(sample)
        except AttributeError:
            _say_missing(sample)
            raise
        for value, (exact, low, high, doubtful) in zip(values, steps, strict=True):
            if type(value) is not exact or (low is not None and not low <= value <= high):
                name, check, where = doubtful
                kept = check(value, where)
                if kept is not value:
                    changed[name] = kept
        if frozen and not changed:
            return sample
        copied: Any = new(target)
        for name, value in zip(names, values, strict=True):
            store(copied, name, changed.get(name, value))
        return copied

    return look


def settling(cls: type) -> Callable[[Any, Sequence[Any]], Any]:
    """A faster `snapshot` for new samples of a dataclass: a function of a sample and the values that it was made of.

    These values are checked already, in the order of the fields; only values that the class changed are checked again.
    """
    fields, frozen = describe(cls).fields, cls.__dataclass_params__.frozen  # type: ignore[attr-defined]
    known: dict[str, Any] = {"listed": _is_listed, "say_missing": _say_missing}
    known |= {"new": object.__new__, "target": cls if frozen else frozen_class(cls), "store": object.__setattr__}
    lines = []
    if fields:
        lines.append(f"{', '.join(f'g{i}' for i in range(len(fields)))}, = given")
    for i, field in enumerate(fields):
        known |= {f"check{i}": field.kind.check, f"where{i}": f"{cls.__qualname__}.{field.name}"}
        lines += [
            f"try: v{i} = getattr(sample, {field.name!r})",
            "except AttributeError: say_missing(sample); raise",
            f"if v{i} is not g{i} and not listed(v{i}, g{i}): g{i} = check{i}(v{i}, where{i})",
        ]
    if frozen:
        lines.append(f"if {' and '.join(f'v{i} is g{i}' for i in range(len(fields))) or True}: return sample")
    lines.append("copied = new(target)")
    lines += [f"store(copied, {field.name!r}, g{i})" for i, field in enumerate(fields)]
    lines.append("return copied")
    return generate("settle(sample, given)", lines, known)


def _is_listed(value: Any, kept: Any) -> bool:
    """Whether the value is a list of exactly the items of the tuple `kept`."""
    return type(value) is list and type(kept) is tuple and len(value) == len(kept) and all(map(is_, value, kept))


def _bounds(kind: Kind) -> tuple[type, Any, Any]:
    """The class of values that need no check, and their range, or None and None."""
    if isinstance(kind, IntKind):
        return int, kind.low, kind.high
    return (int, 0, STAMP_LIMIT - 1) if isinstance(kind, StampKind) else (kind.exact, None, None)


def _values_of(names: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    if len(names) > 1:
        return attrgetter(*names)
    if not names:
        return lambda _sample: ()
    get = attrgetter(names[0])
    return lambda sample: (get(sample),)


def _say_missing(sample: Any) -> None:
    """Raise RecordError if a field was never set."""
    for field in describe(type(sample)).fields:
        if not hasattr(sample, field.name):
            raise RecordError(
                f"{type(sample).__qualname__}.{field.name}: expected {field.spelling}, got nothing; set it first"
            ) from None


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
            STRUCTURE: describe(
                cls
            ),  # described for itself it would take the place of the user's class among the types
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
    """A function that copies samples of one class with another time stamp; the fields are looked up once."""
    structure = describe(original(cls))
    stamp = structure.field("tm")
    if not structure.has_tm:
        raise RecordTypeError(f"{cls.__qualname__} has no time stamp; expected a type with a field tm")
    check, where = SCALARS["stamp"].check, f"{cls.__qualname__}.tm"
    if stamp is None:
        return lambda sample, tm: sample.with_tm(check(tm, where))
    as_time = stamp.record
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
    """The function that stores a field despite a refusal to assign: in the slot, or in the instance's dictionary."""
    slot = getattr(cls, name, None)
    if isinstance(slot, MemberDescriptorType):
        return slot.__set__
    return lambda instance, value: object.__setattr__(instance, name, value)


def check_shape(sample: object, shape: tuple[int, ...]) -> None:
    """Raise RecordError unless the sample's array has this shape; -1 stands for any length.

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


def detached(sample: T) -> T:
    """A copy of `sample`, a record or another dataclass, that shares no array with anything its writer may have kept.

    `copy.deepcopy` returns a record itself, which is right while the record owns its arrays. The debug mode of ports
    searches for writers that kept a view of their own array, and needs a real copy.
    """
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
