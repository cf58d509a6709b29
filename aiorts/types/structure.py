"""Finds the structure of a record type: its fields, and the kind of each from its annotation.

`describe(cls)` reads record types, and plain dataclasses of any module when they are first used. A type that cannot
travel is a DeclarationError that names the field and the annotation.
"""

from __future__ import annotations

import builtins
import dataclasses
import inspect
import sys
import types
import typing
from collections.abc import Mapping, MutableMapping, MutableSequence, Sequence
from contextlib import suppress
from enum import Enum
from typing import Annotated, Any, ClassVar, get_args, get_origin

import aiorts.types.spelling as spelled
from aiorts.errors import DeclarationError, RecordError
from aiorts.late import dataclass
from aiorts.types.arrays import ArrayKind, NDArrayKind
from aiorts.types.kinds import SCALARS, DateTimeKind, EnumKind, Kind, LiteralKind, OptionalKind
from aiorts.types.registry import register
from aiorts.types.rows import FixedTupleKind, MapKind, TupleKind

if typing.TYPE_CHECKING:
    from aiorts.types.nested import RecordKind

__all__ = ("Field", "Structure", "describe", "fields_of", "units_of")

MISSING: Any = dataclasses.MISSING
NUMBERS = frozenset({*(f"{sign}{bits}" for sign in "iu" for bits in (8, 16, 32, 64)), "f32", "f64", "bool"})
_FLOATS = ("f32", "f64")
STRUCTURE = "__aiorts_structure__"
_BARE = (bool, int, float, str)


class UnresolvedName(DeclarationError):
    """A name in an annotation is not defined, at least not yet."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a record type."""

    name: str
    kind: Kind
    default: Any = MISSING
    factory: Any = MISSING
    unit: str = ""
    """The unit of its values, such as "rad"; for a nested record, of all its fields without one."""
    doc: str = ""
    """The field's description."""

    @property
    def spelling(self) -> str:
        """The kind as text: "f64", "seq[i32]", "Point3D"."""
        return self.kind.spelling

    @property
    def element(self) -> str | None:
        """Element type of a number field or number sequence ("f64"); None for all others."""
        return self.kind.element

    @property
    def has_default(self) -> bool:
        """Whether the constructor can be called without the field."""
        return self.default is not MISSING or self.factory is not MISSING

    @property
    def record(self) -> type | None:
        """The record type of a nested record or of a sequence of records."""
        kind = getattr(self.kind, "item", self.kind)
        return getattr(kind, "cls", None)


@dataclass(frozen=True, slots=True)
class Structure:
    """The fields of one record type, in order."""

    cls: type
    fields: tuple[Field, ...]
    checked: bool
    mutable: bool
    has_tm: bool

    def field(self, name: str) -> Field | None:
        """The field of that name, or None."""
        return next((field for field in self.fields if field.name == name), None)


_being_described: list[type] = []


def describe(cls: type) -> Structure:
    """The structure of a record type or dataclass. DeclarationError if it is neither or cannot travel."""
    known = cls.__dict__.get(STRUCTURE) if isinstance(cls, type) else None
    if known is not None:
        return typing.cast("Structure", known)
    if not isinstance(cls, type) or not dataclasses.is_dataclass(cls):
        raise DeclarationError(
            f"{_label(cls)}: expected a record or a dataclass; decorate the class with @record or @dataclass"
        )
    if cls in _being_described:
        raise DeclarationError(f"{cls.__qualname__}: a record cannot contain its own type, not even inside another")
    _being_described.append(cls)
    try:
        structure = _of_dataclass(cls)
    finally:
        _being_described.remove(cls)
    type.__setattr__(cls, STRUCTURE, structure)
    register(cls)
    return structure


def fields_of(cls: type) -> tuple[Field, ...]:
    """The fields of a record type or dataclass, in order."""
    return describe(cls).fields


def units_of(cls: type) -> dict[str, str]:
    """The units of a record type's fields, by their paths without indices; fields without a unit are left out."""
    found: dict[str, str] = {}

    def walk(kind: type, prefix: str, outer: str) -> None:
        for field in describe(kind).fields:
            path, unit = f"{prefix}{field.name}", field.unit or outer
            kind_of_value = getattr(field.kind, "inner", field.kind)  # of a field that may be absent
            nested = getattr(getattr(kind_of_value, "item", kind_of_value), "cls", None)
            if isinstance(nested, type) and dataclasses.is_dataclass(nested):
                walk(nested, f"{path}.", unit)
            elif unit:
                found[path] = unit

    if dataclasses.is_dataclass(cls):
        walk(cls, "", "")
    return found


def sole_unit(cls: type) -> str:
    """The unit of a type that has one field besides its stamp; "" where it has none, or several fields."""
    if not dataclasses.is_dataclass(cls):
        return ""
    fields = [field for field in describe(cls).fields if field.name != "tm"]
    return fields[0].unit if len(fields) == 1 else ""


def has_single_values(cls: type) -> bool:
    """Whether a type consists of single values, or of one list of numbers: FlexiFilter converts these."""
    if not dataclasses.is_dataclass(cls):
        return cls in _BARE
    fields = [field for field in describe(cls).fields if field.name != "tm"]
    return all(_is_single(field.kind) or (len(fields) == 1 and field.element is not None) for field in fields)


def _is_single(kind: Kind) -> bool:
    if isinstance(kind, OptionalKind):
        return _is_single(kind.inner)
    nested = getattr(kind, "structure", None)
    return has_single_values(nested.cls) if nested is not None else kind is SCALARS.get(kind.spelling)


def _of_dataclass(cls: type) -> Structure:
    hints = resolve(cls)
    fields = tuple(
        Field(
            field.name,
            kind_of(hints[field.name], f"{cls.__qualname__}.{field.name}", cls),
            field.default,
            field.default_factory,
            *notes_of(field),
        )
        for field in dataclasses.fields(cls)
    )
    return assemble(cls, fields, checked=False, frozen=cls.__dataclass_params__.frozen)  # type: ignore[attr-defined]


def notes_of(field: dataclasses.Field[Any]) -> tuple[str, str]:
    """Unit and description of a field, as `field(unit=, doc=)` has them in its metadata."""
    return str(field.metadata.get("unit", "")), str(field.metadata.get("doc", ""))


def assemble(cls: type, fields: tuple[Field, ...], *, checked: bool, frozen: bool) -> Structure:
    stamped = any(field.name == "tm" and field.kind.spelling in ("stamp", "Time") for field in fields)
    stamped = stamped or (isinstance(getattr(cls, "tm", None), property) and hasattr(cls, "with_tm"))
    mutable = not frozen or (not checked and any(holds_mutable(field.kind) for field in fields))
    return Structure(cls, fields, checked, mutable, stamped)


def holds_mutable(kind: Kind) -> bool:
    """Whether an unchecked field of this kind may hold something that can change after the write."""
    kind = kind.inner if isinstance(kind, OptionalKind) else kind
    if isinstance(kind, (ArrayKind, MapKind)):
        return True
    return kind.mutable


def resolve(cls: type) -> dict[str, Any]:
    """The annotations of `cls` as objects, local classes of a running function included."""
    try:
        return typing.get_type_hints(cls, localns=_locals_of(cls), include_extras=True)
    except NameError as error:
        raise UnresolvedName(
            f"{cls.__qualname__}: the name {error.name!r} in its annotations cannot be found; "
            "import it at run time (not under TYPE_CHECKING) and define it before this class"
        ) from None


def resolve_own(cls: type) -> dict[str, Any]:
    """The annotations of `cls` as objects; the result may have inherited annotations, too."""
    own = inspect.get_annotations(cls)
    known = vars(builtins) | vars(sys.modules.get(cls.__module__, builtins))
    # Annotations are nearly always names of the module: this look-up halves the time of importing our 101 records.
    found = {name: known.get(text) for name, text in own.items() if isinstance(text, str)}
    plain = all(isinstance(kind, type) or get_origin(kind) is Annotated for kind in found.values())
    return found if plain and len(found) == len(own) and "<locals>" not in cls.__qualname__ else resolve(cls)


def _locals_of(cls: type) -> dict[str, Any] | None:
    """The local variables of the function that defines `cls`, which annotations may name; None if it is not running."""
    owner, local, _ = cls.__qualname__.rpartition(".<locals>.")
    if not local:
        return None
    frame = sys._getframe()
    while frame is not None:
        code = frame.f_code
        if code.co_qualname == owner and frame.f_globals.get("__name__") == cls.__module__:
            return dict(frame.f_locals)
        frame = frame.f_back  # type: ignore[assignment]
    return None


def kind_of(annotation: Any, where: str, owner: type | None = None) -> Kind:
    """The kind that an annotation asks for; DeclarationError naming `where` if no such value can travel."""
    if get_origin(annotation) is Annotated:
        base, *metadata = get_args(annotation)
        tag = next((str(entry) for entry in metadata if isinstance(entry, spelled.Tag)), None)
        _check_metadata(metadata, where, owner)
        return SCALARS[tag] if tag else kind_of(base, where, owner)
    if isinstance(annotation, typing.NewType):
        return kind_of(annotation.__supertype__, where, owner)
    if where.endswith(".tm") and annotation is int:
        return SCALARS["stamp"]
    if annotation in _PLAIN:
        return SCALARS[_PLAIN[annotation]]
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return EnumKind(register(annotation))
    if isinstance(annotation, type) and (annotation.__module__, annotation.__name__) == ("datetime", "datetime"):
        return _no_stamp(DateTimeKind(), where)
    if annotation in (spelled.NDArray, spelled.Map):
        return NDArrayKind() if annotation is spelled.NDArray else MapKind()
    if isinstance(annotation, type) and get_origin(annotation) is None and dataclasses.is_dataclass(annotation):
        return _nested(annotation, where, owner)
    generic = _generic(annotation, where, owner)
    if generic is None:
        raise _cannot_travel(annotation, where)
    return generic


def _check_metadata(metadata: list[Any], where: str, owner: type | None) -> None:
    """Raise DeclarationError for metadata of `Annotated` that aiorts would ignore; a text is a note and is allowed.

    Metadata of other libraries is allowed in a user's dataclass; a plain value such as a length is not.
    """
    own = owner is not None and "__dataclass_fields__" not in owner.__dict__  # @record makes it a dataclass later
    for entry in metadata:
        plain = type(entry).__module__ == "builtins"
        if not isinstance(entry, str) and (own or plain):
            shown = f"{entry!r:.60}" if plain else f"{type(entry).__qualname__}(...)"
            raise DeclarationError(
                f"{where}: Annotated[..., {shown}]: aiorts does not know what {shown} asks for; check a length "
                "or a range in __post_init__, write tuple[float, float, float] for three numbers, give a unit to the "
                'field: field(default=0.0, unit="rad"), and a shape to the port: InPort(..., shape=(3,))'
            )


_ENTRIES = {*NUMBERS, "str", "char", "wchar", "bytes"}

# int is 64 bits wide, as on the wire; a bigger number is refused when the record is made
_PLAIN: dict[Any, str] = {int: "i64", float: "f64", str: "str", bool: "bool", bytes: "bytes", bytearray: "bytes"}


def _generic(annotation: Any, where: str, owner: type | None) -> Kind | None:
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is typing.Literal:
        return _literal(args, where)
    if origin in (typing.Union, types.UnionType) and len(args) == 2 and types.NoneType in args:
        given = args[0] if args[1] is types.NoneType else args[1]
        return _no_stamp(OptionalKind(kind_of(given, where, owner)), where)
    if origin in (spelled.Array, spelled.Seq, spelled.Rows) and args:
        kind = sequence_kind(args[0], where, owner)
        if origin is spelled.Array and not isinstance(kind, ArrayKind):
            raise DeclarationError(f"{where}: Array[...] takes a number type; write Seq[...] for {_label(args[0])}")
        return kind
    if origin is tuple and args and args[-1] is not Ellipsis:
        return FixedTupleKind(tuple(kind_of(arg, where, owner) for arg in args))
    if origin in (tuple, list, Sequence, MutableSequence) and args:
        return TupleKind(kind_of(args[0], where, owner), restore=list if origin in (list, MutableSequence) else tuple)
    if origin in (dict, Mapping, MutableMapping) and args and args[0] is str:
        return MapKind(_entry_kinds(args[1], where, owner))
    return _numpy_array(annotation, origin, args)


def _no_stamp(kind: Kind, where: str) -> Kind:
    """Return the kind unless the field is called `tm`, which must be a time stamp; raise DeclarationError then."""
    if where.rpartition(".")[2] == "tm":
        raise DeclarationError(
            f"{where}: a time stamp is an int (nanoseconds) and never absent, not {kind.spelling}; annotate it int, or "
            "call the field otherwise"
        )
    return kind


def _literal(values: tuple[Any, ...], where: str) -> Kind:
    """One kind for all values of a Literal; None among them makes it optional."""
    choices = tuple(value for value in values if value is not None)
    sorts = {type(value) for value in choices}
    if len(sorts) != 1 or not sorts <= {str, int, bool}:
        raise DeclarationError(
            f"{where}: Literal[{', '.join(map(repr, values))}]: its values are all text, all integers or all truth "
            "values; for others take an Enum, or two fields"
        )
    plain = SCALARS[_PLAIN[sorts.pop()]]
    try:
        kind: Kind = LiteralKind(tuple(plain.check(value, where) for value in choices), plain)
    except RecordError as error:
        raise DeclarationError(str(error)) from None
    return kind if len(choices) == len(values) else OptionalKind(kind)


def _entry_kinds(annotation: Any, where: str, owner: type | None) -> tuple[Kind, ...]:
    """The kinds of a map's values: of a union, its parts that can travel; empty for every kind a map may hold.

    Raises:
        DeclarationError: a map of these values cannot travel: its values are scalars, arrays and maps.
    """
    if annotation in (Any, object):
        return ()
    if get_origin(annotation) in (typing.Union, types.UnionType):
        found: list[Kind] = []
        for one in get_args(annotation):
            with suppress(DeclarationError):
                found += _entry_kinds(one, where, owner)
        return tuple(sorted(found, key=lambda kind: kind.spelling in _FLOATS))  # floats last: they take an int, too
    kind = kind_of(annotation, where, owner)
    item = kind.item.spelling if isinstance(kind, TupleKind) else ""
    if item in NUMBERS:
        return (ArrayKind(item),)  # a list of numbers travels in a map as an array
    if not (kind.spelling in _ENTRIES or isinstance(kind, (ArrayKind, MapKind))):
        raise DeclarationError(
            f"{where}: a map has bool, int, float, str, bytes, arrays and maps as its values, not {_label(annotation)};"
            " write a record for it"
        )
    return (kind,)


def _numpy_array(annotation: Any, origin: Any, args: tuple[Any, ...]) -> Kind | None:
    """numpy.ndarray or numpy.typing.NDArray[...], recognised without importing numpy."""
    target = origin or annotation
    if getattr(target, "__module__", "") != "numpy" or getattr(target, "__name__", "") != "ndarray":
        return None
    import numpy as np

    from aiorts.types.arrays import element_name

    dtype = get_args(args[-1])[0] if args and get_args(args[-1]) else None
    if not isinstance(dtype, type) or dtype is np.generic or not issubclass(dtype, np.generic):
        return NDArrayKind()
    element = element_name(np.dtype(dtype)) if dtype.__subclasses__() == [] else None
    return NDArrayKind(element)


def sequence_kind(item: Any, where: str = "", owner: type | None = None) -> Kind:
    """The kind of a sequence of `item` (an annotation): array, (n, k) array with record views, or tuple."""
    kind = kind_of(item, where or _label(item), owner)
    if kind.spelling in NUMBERS:
        return ArrayKind(kind.spelling)
    from aiorts.types.nested import RecordKind, rows_kind

    rows = rows_kind(kind) if isinstance(kind, RecordKind) else None
    return rows or TupleKind(kind)


def _nested(cls: type, where: str, owner: type | None) -> RecordKind:
    from aiorts.types.nested import RecordKind

    if cls is owner:
        raise DeclarationError(f"{where}: a record cannot contain its own type")
    return RecordKind(describe(cls))


def _cannot_travel(annotation: Any, where: str) -> DeclarationError:
    if get_origin(annotation) in (typing.Union, types.UnionType):
        return DeclarationError(
            f"{where}: {_label(annotation)} has more than one type; a field has one, or that and None; "
            "for several take a field each, with None where there is nothing"
        )
    return DeclarationError(
        f"{where}: a value of type {_label(annotation)} cannot travel; use bool, int, float, str, bytes, the types of "
        "aiorts.types (f32, u16, Array[f64], Seq[str], ...), an Enum, a Literal, a datetime, another record or "
        "dataclass, or one of these and None"
    )


def _label(annotation: Any) -> str:
    if isinstance(annotation, type) and not get_args(annotation):
        return annotation.__qualname__
    return str(annotation).replace("typing.", "")


def is_class_variable(annotation: Any) -> bool:
    return annotation is ClassVar or get_origin(annotation) is ClassVar
