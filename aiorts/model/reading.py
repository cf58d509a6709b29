"""Makes frozen values of data from JSON or msgpack: the inverse of `plain`; it looks nothing up and never waits.

The data may be hostile: the outcome is a value of the requested class, RecordError or LimitError. The
annotations of a class are read once.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import lru_cache
from types import MappingProxyType, NoneType
from typing import Any, Final, TypeVar, cast

from aiorts.errors import DeclarationError, LimitError, RecordError, RecordTypeError
from aiorts.late import dataclass
from aiorts.model.annotations import ByAnnotation
from aiorts.model.plain import has_default
from aiorts.model.values import WORDS, shown

T = TypeVar("T")
_SHOWN: Final = 80
_DEEPEST: Final = 100
_NUMBERS: Final = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
_WORDS: Final[Mapping[type, str]] = {**WORDS, dict: "an object", tuple: "a list", bytes: "bytes", NoneType: "null"}
"""The words of messages for the types of JSON and msgpack."""


@dataclass(frozen=True, slots=True)
class PlainLimits:
    """Limits of reading: levels of nesting, values (each item of an object or list is one), the length of a text."""

    depth: int = 32
    values: int = 4_000_000
    text: int = 1_048_576

    def __post_init__(self) -> None:
        for name, most in (("depth", _DEEPEST), ("values", 2**31), ("text", 2**31)):
            limit = getattr(self, name)
            if type(limit) is not int or not 1 <= limit <= most:
                raise ValueError(f"PlainLimits.{name}: expected an integer 1..{most}, got {limit!r}")


PROFILE_LIMITS: Final = PlainLimits()


class _Place:
    """An object or list that is being read, for the paths in messages."""

    __slots__ = ("depth", "key", "outer")

    def __init__(self, outer: _Place | None, key: Any, reading: _Reading, count: int) -> None:
        self.outer, self.key = outer, key
        self.depth: int = 1 if outer is None else outer.depth + 1
        if self.depth > reading.depth:
            raise LimitError(f"{_path(outer, key)}: nested deeper than {reading.depth} levels")
        reading.spend(count, outer, key)


class _Reading:
    """The state of one call of `from_plain`: the number of values that it may still take, and unknown keys."""

    __slots__ = ("depth", "left", "text", "unknown", "values")

    def __init__(self, limits: PlainLimits, unknown: dict[str, Any] | None) -> None:
        self.depth, self.text = limits.depth, limits.text
        self.left = self.values = limits.values
        self.unknown = unknown

    def spend(self, count: int, at: _Place | None, key: Any) -> None:
        self.left -= count
        if self.left < 0:
            raise LimitError(f"{_path(at, key)}: more than {self.values} values in all")

    def keep(self, at: _Place, key: Any, value: Any) -> None:
        """Keep a value that no field takes; its path costs as many values as it has parts."""
        if self.unknown is not None:
            self.spend(at.depth, at, key)
            path = _path(at, key)
            self.unknown[path if path not in self.unknown else f"{path} ({len(self.unknown)})"] = value


_Reader = Callable[[Any, "_Place | None", Any, _Reading], Any]
"""Reads a value that stands in a place under a key."""


def from_plain(
    kind: type[T], data: object, *, limits: PlainLimits = PROFILE_LIMITS, unknown: dict[str, Any] | None = None
) -> T:
    """The value of a frozen dataclass, or of another annotation of a field, of which `data` is the `plain` form.

    A key without a field is put into `unknown`, by its path, if that is given, and else left out; a missing field has
    its default. Objects become read-only mappings (a dict where the annotation says so), lists tuples.

    Raises:
        RecordError: a value is missing or wrong; names its path, what was expected and what came.
        LimitError: the data exceeds `limits`.
        DeclarationError: a class has an annotation that cannot be read.
    """
    read = _reader(cast("Any", kind))
    return cast("T", read(data, None, _name(kind), _Reading(limits, unknown)))


@lru_cache(maxsize=256)
def _reader(kind: Hashable) -> _Reader:
    return _Readers(_SIMPLE).of(kind)


# -- single values -----------------------------------------------------------------------------------------------------


def _exactly(kind: type) -> _Reader:
    def read(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
        if value.__class__ is not kind:
            raise _wrong(at, key, _WORDS[kind], value)
        return value

    return read


def _bounded(kind: type[str] | type[bytes]) -> _Reader:
    def read(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
        if value.__class__ is not kind:
            raise _wrong(at, key, _WORDS[kind], value)
        if len(value) > reading.text:
            raise LimitError(f"{_path(at, key)}: {_WORDS[kind]} of length {len(value)}; at most {reading.text}")
        return value

    return read


def _float(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
    kind = value.__class__
    if kind is float:
        return value
    if kind is int:
        try:
            float(value)
        except OverflowError:
            raise _wrong(at, key, "a number that a float holds", value) from None
        return value  # an int is a number as it is, and is written again as it was
    if kind is str and value in _NUMBERS:
        return _NUMBERS[value]
    raise _wrong(at, key, "a number", value)


def _any(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
    kind = value.__class__
    if value is None or kind in _SCALARS:
        return value
    if kind is str or kind is bytes:
        return _SIMPLE[kind](value, at, key, reading)
    if kind is dict:
        here = _Place(at, key, reading, len(value))
        pairs = value.items()
        return MappingProxyType({_text_key(name, here, reading): _any(one, here, name, reading) for name, one in pairs})
    if kind is list or kind is tuple:
        here = _Place(at, key, reading, len(value))
        return tuple([_any(one, here, index, reading) for index, one in enumerate(value)])
    raise _wrong(at, key, "what JSON can carry", value)


_SCALARS: Final = frozenset((bool, int, float))
_SIMPLE: Final[Mapping[Any, _Reader]] = {
    str: _bounded(str),
    bytes: _bounded(bytes),
    bool: _exactly(bool),
    int: _exactly(int),
    float: _float,
    NoneType: _exactly(NoneType),
    Any: _any,
    object: _any,
}


# -- of several --------------------------------------------------------------------------------------------------------


class _Readers(ByAnnotation[_Reader]):
    """The readers of annotations, also of a class that mentions itself."""

    def __init__(self, simple: Mapping[Any, _Reader]) -> None:
        super().__init__(simple)
        self._made: dict[type, _Reader] = {}

    def union(self, hint: Any, arms: dict[Any, _Reader]) -> _Reader:
        """The reader that chooses an arm by the type of the value, among classes by the keys; no arm is tried twice."""
        expected = " or ".join(dict.fromkeys(_name(one) for one in arms))
        by_kind = {kind: tuple(arms[one] for one in arms if kind in _taken(one)) for kind in _WORDS}
        records = [one for one in arms if is_dataclass(one)]
        if len(by_kind[list]) > 1 or len(by_kind[dict]) > max(len(records), 1):
            raise DeclarationError(f"{hint!r}: is not read; nothing says which of these an object or list is")

        def read(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
            found = by_kind.get(value.__class__, ())
            if len(found) == 1:
                return found[0](value, at, key, reading)
            if value.__class__ is dict and found:
                return arms[max(records, key=lambda one: _fit(one, value))](value, at, key, reading)
            for arm in found:
                try:
                    return arm(value, at, key, reading)
                except RecordError:
                    continue
            raise _wrong(at, key, expected, value)

        return read

    def words(self, hint: Any, words: tuple[Any, ...]) -> _Reader:
        return _one_of(words, words)

    def members(self, kind: type[Enum]) -> _Reader:
        return _one_of([one.value for one in kind], list(kind))

    def many(self, hint: Any, kind: Any, item: _Reader) -> _Reader:
        if kind not in (tuple, Sequence):
            return self.other(hint)

        def read(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
            if value.__class__ is not list and value.__class__ is not tuple:
                raise _wrong(at, key, "a list", value)
            if not value:
                return ()
            here = _Place(at, key, reading, len(value))
            return tuple([item(one, here, index, reading) for index, one in enumerate(value)])

        return read

    def fixed(self, hint: Any, items: list[_Reader]) -> _Reader:
        make = getattr(hint, "_make", tuple)

        def read(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
            if (value.__class__ is not list and value.__class__ is not tuple) or len(value) != len(items):
                raise _wrong(at, key, f"a list of {len(items)}", value)
            here = _Place(at, key, reading, len(value))
            pairs = enumerate(zip(items, value, strict=True))
            return make([item(one, here, index, reading) for index, (item, one) in pairs])

        return read

    def mapping(self, hint: Any, kind: Any, key: Any, item: _Reader) -> _Reader:
        if (name := _KEYS.get(key)) is None:
            return self.other(hint)
        frozen = MappingProxyType if kind is Mapping else dict

        def read(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
            if value.__class__ is not dict:
                raise _wrong(at, key, "an object", value)
            here = _Place(at, key, reading, len(value))
            read = {name(one, here, reading): item(inner, here, one, reading) for one, inner in value.items()}
            if len(read) != len(value):
                raise RecordError(f"{_path(at, key)}: two keys mean the same")
            return frozen(read)

        return read

    def record(self, kind: Any) -> _Reader:
        if kind in self._made:
            return self._made[kind]
        readers: dict[Any, _Reader] = {}
        required: list[str] = []
        expected = f"an object ({kind.__name__})"

        def read(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
            if value.__class__ is not dict:
                raise _wrong(at, key, expected, value)
            here = _Place(at, key, reading, len(value))
            given = {}
            for name, one in value.items():
                reader = readers.get(name)
                if reader is not None:
                    given[name] = reader(one, here, name, reading)
                else:
                    reading.keep(here, _text_key(name, here, reading), one)
            if len(given) < len(readers):
                for name in required:
                    if name not in given:
                        raise RecordError(f"{_path(here, name)}: is missing")
            try:
                return kind(**given)
            except (ArithmeticError, LookupError, TypeError, ValueError) as error:  # of the class's own check
                raise RecordError(f"{_path(at, key)}: {error}") from error

        self._made[kind] = read  # the class may mention itself
        try:
            hints = typing.get_type_hints(kind)
        except NameError as error:
            raise DeclarationError(f"{kind.__qualname__}: its annotations cannot be read: {error}") from error
        for field in fields(kind):
            if not field.init:
                where = f"{kind.__qualname__}.{field.name}"
                raise DeclarationError(f"{where}: is not read, since __init__ does not take it")
            readers[field.name] = self.of(hints[field.name])
            if not has_default(field):
                required.append(field.name)
        return read

    def other(self, hint: Any) -> _Reader:
        raise DeclarationError(f"{hint!r}: is not read; there are those of JSON, Enum, tuple and Mapping")


def _one_of(words: Iterable[Any], members: Iterable[Any]) -> _Reader:
    """The reader of an Enum or a Literal."""
    table = {(type(word), word): member for word, member in zip(words, members, strict=True)}
    expected = ", ".join(shown(word) for _, word in table)

    def read(value: Any, at: _Place | None, key: Any, reading: _Reading) -> Any:
        kind = value.__class__
        if kind is str or kind in _SCALARS or value is None:
            found = table.get((kind, value), table)
            if found is not table:
                return found
        raise _wrong(at, key, expected, value)

    return read


def _text_key(key: Any, at: _Place, reading: _Reading) -> Any:
    return _SIMPLE[str](key, at, key, reading)


def _int_key(key: Any, at: _Place, reading: _Reading) -> Any:
    if key.__class__ is int:
        return key
    if key.__class__ is str and len(key) <= _SHOWN and key.removeprefix("-").isdecimal():
        number = int(key)
        if str(number) == key:
            return number
    raise RecordTypeError(f"{_path(at, key)}: expected a whole number as the key, got {_got(key)}")


_KEYS: Final[Mapping[Any, Callable[[Any, _Place, _Reading], Any]]] = {str: _text_key, int: _int_key}


def _taken(hint: Any) -> Iterable[type]:
    """The types of values that are read as this annotation."""
    if hint is Any or hint is object:
        return _WORDS
    if hint is float:
        return (float, int, str)
    if hint in _SIMPLE:
        return (hint,)
    if typing.get_origin(hint) is typing.Literal:
        return {type(word) for word in typing.get_args(hint)}
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {type(one.value) for one in hint}
    return (list, tuple) if typing.get_origin(hint) in (tuple, Sequence) else (dict,)


def _fit(kind: Any, value: Mapping[Any, Any]) -> tuple[int, int]:
    """A rank for how well keys fit a class: first by few missing required fields, then by many known fields."""
    known = fields(kind)
    missing = sum(not has_default(one) and one.name not in value for one in known)
    return -missing, sum(one.name in value for one in known)


# -- messages ----------------------------------------------------------------------------------------------------------


def _wrong(at: _Place | None, key: Any, expected: str, value: Any) -> RecordTypeError:
    return RecordTypeError(f"{_path(at, key)}: expected {expected}, got {_got(value)}")


def _got(value: Any) -> str:
    kind = value.__class__
    if kind in (dict, list, tuple):
        return _WORDS[kind]
    if kind in (str, bytes):
        return shown(value[: _SHOWN + 1])
    return shown(value) if kind in _SCALARS else _WORDS.get(kind) or f"<{kind.__name__}>"


def _path(at: _Place | None, key: Any) -> str:
    """The path of a value, such as components.pid0.ports[2].shape; for the outermost value the name of its class."""
    if at is None:
        return str(key)
    steps = []
    place: _Place | None = at
    while place is not None:
        plain = key.__class__ is str and len(key) <= _SHOWN and f"_{key}".replace("-", "_").isidentifier()
        steps.append(f".{key}" if plain else f"[{_got(key)}]")
        key = place.key
        place = place.outer
    return "".join(reversed(steps)).removeprefix(".")


def _name(hint: Any) -> str:
    """The name of an annotation in messages."""
    if isinstance(hint, type) and typing.get_origin(hint) is None:
        return _WORDS.get(hint) or hint.__name__
    return {tuple: "a list", Sequence: "a list", Mapping: "an object", dict: "an object"}.get(
        typing.get_origin(hint)
    ) or str(hint)
