"""`@record`: a frozen, slotted class whose constructor is the only place that checks and converts.

Two records are equal when they are of one class and all their fields are equal; NaN equals NaN there, so that a record
equals its own copy. A record is hashable when nothing in it is an array or a map. It works with `dataclasses.fields`,
`replace`, `asdict`, `copy`, `match`, and refuses assignment.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from types import FunctionType, MemberDescriptorType
from typing import Any, NoReturn, TypeVar, cast, dataclass_transform, overload

from aiorts.errors import DeclarationError, RecordError
from aiorts.types.arrays import ArrayKind
from aiorts.types.constructors import MISSING, Parameter, give_init
from aiorts.types.kinds import NS_PER_SEC, Kind, OptionalKind
from aiorts.types.nested import RecordKind
from aiorts.types.registry import register
from aiorts.types.rows import FixedTupleKind, MapKind, RowsKind, TupleKind, as_dict
from aiorts.types.structure import (
    STRUCTURE,
    Field,
    Structure,
    assemble,
    is_class_variable,
    kind_of,
    notes_of,
    resolve_own,
)

T = TypeVar("T")
Check = Callable[[Any, str], Any]


class Lazy:
    """A default that is made when it is first needed: declaring a record must not load numpy."""

    __slots__ = ("make",)

    def __init__(self, make: Callable[[], Any]) -> None:
        self.make = make

    def __repr__(self) -> str:
        return "..."


class Stamped:
    """Declares `sec` and `nsec` to type checkers; a record with a time stamp has them without this base, too."""

    __slots__ = ()

    @property
    def sec(self) -> int:
        """Whole seconds of the time stamp `tm`."""
        return self.tm // NS_PER_SEC  # type: ignore[attr-defined,no-any-return]

    @property
    def nsec(self) -> int:
        """Nanoseconds of the time stamp `tm` beyond the whole seconds."""
        return self.tm % NS_PER_SEC  # type: ignore[attr-defined,no-any-return]


def zero(cls: type[T]) -> T:
    """A default for a field of the type `cls`: its record of zeros, made on first use."""
    return cast("T", Lazy(cls))


@overload
def field(*, default: T, unit: str = "", doc: str = "") -> T: ...


@overload
def field(*, default_factory: Callable[[], T], unit: str = "", doc: str = "") -> T: ...


@overload
def field(*, unit: str = "", doc: str = "") -> Any: ...


def field(
    *, default: Any = dataclasses.MISSING, default_factory: Any = dataclasses.MISSING, unit: str = "", doc: str = ""
) -> Any:
    """Declare a field of a record or dataclass, with the unit and text that `aiorts types`, schemas and plots show.

    `angle: float = field(default=0.0, unit="rad")`. Two ports are not connected when a field has
    different units at the two ends, as with `unit=` of ports.

    Args:
        default, default_factory: as `dataclasses.field` has them.
        unit: the unit of its values; for a nested record, of all its fields without one.
        doc: the description of the field.
    """
    for name, text in (("unit", unit), ("doc", doc)):
        if not isinstance(text, str):
            raise DeclarationError(f"field: {name} = {text!r:.60}: expected text")
    made: Any = dataclasses.field(default=default, default_factory=default_factory, metadata={"unit": unit, "doc": doc})
    return made


@dataclass_transform(frozen_default=True, field_specifiers=(field, dataclasses.field))
def record(cls: type[T]) -> type[T]:
    """Make a record type of a class with annotated fields. DeclarationError if a field cannot travel.

    Fields are checked when the record is built; `__post_init__` may check more. A field `tm: int` is the record's time
    stamp: nanoseconds since the epoch, 0 <= tm < 2**32 s, also given as a Time; `sec` and `nsec` read it. A record with
    the stamp elsewhere has a property `tm` and a method `with_tm(ns)`, which returns a copy with another stamp.
    """
    if "__init__" in cls.__dict__ or "__slots__" in cls.__dict__:
        raise DeclarationError(
            f"{cls.__qualname__}: @record writes __init__ and __slots__; further checks go into __post_init__"
        )
    fields = (*_inherited(cls), *_declared(cls))
    fields = tuple({field.name: field for field in fields}.values())
    new = _rebuild(cls, fields)
    structure = assemble(new, fields, checked=True, frozen=True)
    setattr_type = type.__setattr__
    setattr_type(new, STRUCTURE, structure)
    dataclasses.dataclass(init=False, repr=False, eq=False)(new)
    _give_init(new, structure)
    return register(new)


def _inherited(cls: type) -> list[Field]:
    fields: list[Field] = []
    for base in reversed(cls.__mro__[1:]):
        structure = base.__dict__.get(STRUCTURE)
        if structure is not None and structure.checked:
            fields += structure.fields
        elif "__dataclass_fields__" in base.__dict__:
            raise DeclarationError(
                f"{cls.__qualname__}: a record extends records only; {base.__qualname__} is a dataclass"
            )
    return fields


def _declared(cls: type) -> list[Field]:
    hints = resolve_own(cls)
    fields = []
    for name in inspect.get_annotations(cls):
        if is_class_variable(hints[name]):
            continue
        where = f"{cls.__qualname__}.{name}"
        kind = kind_of(hints[name], where, cls)
        given = cls.__dict__.get(name)
        notes = notes_of(given) if isinstance(given, dataclasses.Field) else ()
        fields.append(Field(name, kind, *_default(cls, name, kind, where), *notes))
    return fields


def _default(cls: type, name: str, kind: Kind, where: str) -> tuple[Any, Any]:
    """The field's default and factory, of which at most one is given."""
    none = dataclasses.MISSING
    default = cls.__dict__.get(name, none)
    if isinstance(default, MemberDescriptorType):
        return none, none
    if isinstance(default, dataclasses.Field):
        if default.default_factory is not none:
            return none, default.default_factory
        default = default.default
    if isinstance(default, Lazy):
        return none, default.make
    empty_sequence = type(default) is tuple and not default
    if default is none or empty_sequence:
        return default, none
    try:
        return kind.check(default, where), none
    except RecordError as error:
        raise DeclarationError(f"{error} as its default") from None


def _rebuild(cls: type, fields: tuple[Field, ...]) -> type:
    """Make the class again, with slots; `super()` in its methods refers to the new class."""
    inherited = {field.name for base in cls.__mro__[1:] for field in _fields_of_base(base)}
    own = tuple(field.name for field in fields if field.name not in inherited)
    left_out = {"__dict__", "__weakref__", *(field.name for field in fields)}
    namespace = {name: value for name, value in cls.__dict__.items() if name not in left_out}
    namespace["__slots__"] = own
    namespace["__qualname__"] = cls.__qualname__
    for name, method in _methods(cls, fields).items():
        namespace.setdefault(name, method)
    new = type(cls)(cls.__name__, cls.__bases__, namespace)
    for value in cls.__dict__.values():
        function = getattr(value, "fget", value)
        if isinstance(function, FunctionType) and "__class__" in function.__code__.co_freevars:
            cells = function.__closure__ or ()
            cells[function.__code__.co_freevars.index("__class__")].cell_contents = new
    return new


def _fields_of_base(base: type) -> tuple[Field, ...]:
    structure = base.__dict__.get(STRUCTURE)
    return structure.fields if structure is not None else ()


def _give_init(cls: type, structure: Structure) -> None:
    parameters: list[Parameter] = []
    for field, store in zip(structure.fields, setters_of(cls), strict=True):
        check: Check = field.kind.check
        default: Any = MISSING if field.default is dataclasses.MISSING else field.default
        if field.factory is not dataclasses.MISSING:
            default, check = Lazy(field.factory), _made(check)
        elif default is MISSING and parameters and parameters[-1].default is not MISSING:
            raise DeclarationError(
                f"{cls.__qualname__}.{field.name}: a field without default follows one with a default"
            )
        parameters.append(Parameter(field.name, field.kind, check, f"{cls.__qualname__}.{field.name}", store, default))
    give_init(cls, parameters)


def _made(check: Check) -> Check:
    return lambda value, where: check(value.make() if type(value) is Lazy else value, where)


def setters_of(cls: type) -> tuple[Callable[[Any, Any], None], ...]:
    """The slots' own setters, in order of the fields: they store values in a record that refuses assignment."""
    structure: Structure = cls.__dict__[STRUCTURE]
    return tuple(getattr(cls, field.name).__set__ for field in structure.fields)


def _methods(cls: type, fields: tuple[Field, ...]) -> dict[str, Any]:
    pairs = tuple((field.name, field.kind.same) for field in fields)
    hashes = tuple((field.name, field.kind.hashed) for field in fields)
    names = tuple(name for name, _ in pairs)

    def equal(self: Any, other: object) -> Any:
        if self is other:
            return True
        if type(self) is not type(other):
            return NotImplemented
        for name, same in pairs:
            left, right = getattr(self, name), getattr(other, name)
            if left is not right and not same(left, right):
                return False
        return True

    def hashed_fields(self: Any) -> int:
        return hash((type(self).__qualname__, *(hashed(getattr(self, name)) for name, hashed in hashes)))

    def reduced(self: Any) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, name) for name in names)

    methods: dict[str, Any] = {
        "__eq__": equal,
        "__hash__": hashed_fields if all(map(_hashable, (field.kind for field in fields))) else None,
        "__reduce__": reduced,
        **_SHARED,
    }
    if any(field.name == "tm" and field.kind.spelling == "stamp" for field in fields):
        methods |= {name: Stamped.__dict__[name] for name in ("sec", "nsec") if name not in names}
    return methods


def _hashable(kind: Kind) -> bool:
    kind = kind.inner if isinstance(kind, OptionalKind) else kind
    if isinstance(kind, (ArrayKind, RowsKind, MapKind)):
        return False
    if isinstance(kind, FixedTupleKind):
        return all(map(_hashable, kind.items))
    if isinstance(kind, TupleKind):
        return _hashable(kind.item)
    return not isinstance(kind, RecordKind) or kind.cls.__hash__ is not None


def _refuse_assignment(self: Any, name: str, value: object = None) -> NoReturn:
    cls = type(self)
    known = any(field.name == name for field in _fields_of_base(cls))
    what = "records are immutable; make a new one, for example with dataclasses.replace" if known else "no such field"
    raise dataclasses.FrozenInstanceError(f"{cls.__qualname__}.{name}: {what}")


def _repr(self: Any) -> str:
    cls = type(self)
    inside = ", ".join(f"{f.name}={_short(getattr(self, f.name))}" for f in cls.__dataclass_fields__.values())
    return f"{cls.__qualname__.rpartition('.')[2]}({inside})"


def _short(value: Any) -> str:
    """The text of a field in `repr`: a long sequence is shown by its first items and its length."""
    if hasattr(value, "dtype") and hasattr(value, "tolist") and value.ndim != 1:
        return f"array({value.tolist()})" if value.size <= 8 else f"<{value.dtype} array of shape {value.shape}>"
    if hasattr(value, "dtype") or (type(value) is tuple and len(value) > 8):
        first: Any = value[:8]
        head = [repr(item) for item in (first.tolist() if hasattr(value, "dtype") else first)]
        return f"[{', '.join(head)}{f', ... {len(value)} in all' if len(value) > 8 else ''}]"
    text = repr(as_dict(value)) if type(value).__name__ == "mappingproxy" else repr(value)
    return text if len(text) <= 2000 else text[:2000] + "..."


def _same(self: Any, memo: object = None) -> Any:
    return self


_SHARED: dict[str, Any] = {
    "__setattr__": _refuse_assignment,
    "__delattr__": _refuse_assignment,
    "__repr__": _repr,
    "__copy__": _same,
    "__deepcopy__": _same,
}
