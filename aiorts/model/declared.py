"""Declarations of options: the values that a field of a frozen dataclass, or a parameter, takes, stated once.

A declaration is metadata of the field, or of the parameter's type: `Annotated[float, Option("Its rate.", unit="Hz")]`.
Code that reads a value, writes a schema, compares or describes asks the declaration; none of it names an option.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import Field, field
from enum import StrEnum
from functools import lru_cache
from types import MappingProxyType, NoneType
from typing import Any, Final, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from aiorts.errors import ConfigurationError
from aiorts.model.annotations import alternatives
from aiorts.model.values import shown, truth_of, whole_of
from aiorts.spelling import meant, suggestion

T = TypeVar("T")
_NUMBERS: Final[Mapping[str, str]] = MappingProxyType(
    {"s": "seconds", "MB": "MB", "Hz": "a number of Hz", "processors": "a share of one processor"}
)
"""The words for numbers of a unit."""


class OptionError(ValueError):
    """A value that an option does not take."""


class Option(NamedTuple):
    """The declaration of one field or parameter."""

    doc: str
    """The description of its values, in whole sentences."""
    default: Any = None
    """The default of the field; a parameter has its own."""
    unit: str = ""
    """The unit of a number; "" where it has none."""
    low: float | None = None
    """The smallest number, or the fewest characters of a text."""
    high: float | None = None
    """The largest number, or the most characters of a text."""
    above: float | None = None
    """The bound that a number is above. Where there is a bound, infinity is refused unless the option is endless."""
    words: Mapping[str, str] = MappingProxyType({})
    """OpenRTM's word for a value -> ours, where they differ."""
    end: str = "both"
    """The part of a connection that the option is about: "writer", "reader", "both", "ports" or "services"."""
    changes: bool = False
    """Whether the option may be changed while it is in force."""
    shown: bool = False
    """Whether reports show the option at its default, too."""
    endless: bool = False
    """Whether a system file may say `inf`; it means None where None is a value."""
    takes: Callable[[Any], Any] | None = None
    """A function that reads a value which is no text, number or word; None: the type decides."""
    schema: Mapping[str, Any] = MappingProxyType({})
    """The JSON Schema of the contents of a table or a list."""
    flag: bool | str = False
    """Whether a service's setting is an option of `aiorts run`, and under which word (`aiorts.setting`)."""

    def __hash__(self) -> int:
        return hash(self.doc)  # a union of types asks for a hash, and the mappings among the fields have none

    @property
    def described(self) -> str:
        """The description with the unit."""
        return f"{self.doc} Unit: {self.unit}." if self.unit else self.doc


def option(default: T, doc: str, **declared: Any) -> T:
    """A field that users set; `declared` are further fields of `Option`."""
    metadata = {"option": Option(doc, default, **declared)}
    if isinstance(default, MappingProxyType):  # immutable, but dataclasses refuse it as a default
        return field(default_factory=lambda: default, metadata=metadata)
    return field(default=default, metadata=metadata)


@lru_cache
def options_of(cls: type) -> Mapping[str, Option]:
    """The declared options of a class, in the order of its fields; without fields, those of its constructor.

    The methods of a late class are not made by it (see `aiorts.late`).
    """
    if not (fields := _fields_of(cls)):
        return MappingProxyType(dict(_of_parameters(cls)))
    found = ((name, one.metadata.get("option")) for name, one in fields.items() if isinstance(one, Field))
    return MappingProxyType({name: one for name, one in found if isinstance(one, Option)})


def _fields_of(cls: type) -> dict[str, Any]:
    given: dict[str, Any] = {}
    for base in reversed(cls.__mro__):
        space = vars(base)
        given |= space["__declared__"] if "__declared__" in space else space.get("__dataclass_fields__", {})
    return given


def _of_parameters(cls: Any) -> Iterator[tuple[str, Option]]:
    hints = hints_of(cls.__init__, extras=True)
    for name, one in inspect.signature(cls.__init__).parameters.items() if hints else ():
        hint = hints.get(name)
        for part in (hint, *get_args(hint)):  # of `Annotated[float, ...] | None` it is the first argument
            for declared in getattr(part, "__metadata__", ()):
                if isinstance(declared, Option):
                    yield name, declared._replace(default=None if one.default is one.empty else one.default)


def hints_of(of: Any, *, extras: bool = False) -> dict[str, Any]:
    """The annotations as types; empty if a name in them is not known."""
    try:
        return get_type_hints(of, include_extras=extras)
    except (NameError, TypeError):
        return {}


@lru_cache
def _alternatives_of(cls: Any) -> Mapping[str, tuple[Any, ...]]:
    """The alternatives in the annotation of each declared option, None among them; empty if a name is not known."""
    if not (hints := hints_of(cls if _fields_of(cls) else cls.__init__)):
        return {}
    return {name: alternatives(hints[name]) for name in options_of(cls)}


@lru_cache
def kinds_of(cls: type) -> Mapping[str, tuple[Any, ...]]:
    """The types that each declared option takes, without None."""
    known = _alternatives_of(cls).items()
    return MappingProxyType({name: tuple(kind for kind in kinds if kind is not NoneType) for name, kinds in known})


def may_be_none(cls: type, name: str) -> bool:
    """Whether None is among the values of an option."""
    return NoneType in _alternatives_of(cls).get(name, (NoneType,))


def words_of(kind: Any) -> tuple[str, ...]:
    """The words of a Literal, or of a class of words; () for another type."""
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return tuple(kind)
    return get_args(kind) if get_origin(kind) is Literal else ()


def read_option(cls: type, name: str, value: Any, *, low: float | None = None) -> Any:
    """The value of an option from what a user gave; texts are read, in any case and with blanks round them.

    Args:
        low: the smallest number in place of the declared one.

    Raises:
        OptionError: names the option, what it takes and what was given.
    """
    one = options_of(cls)[name]
    if value is None:
        return None
    if one.takes is not None:
        try:
            return one.takes(value)
        except OptionError as error:
            raise OptionError(f"{name} = {error}") from None
    kinds = kinds_of(cls)[name]
    kind = kinds[0]
    if kind is bool:
        words = [word for other in kinds[1:] for word in words_of(other)]
        return folded(value) if folded(value) in words else _yes(name, value, words)
    if kind is str:
        return str(value)
    if issubclass(kind, StrEnum):
        return _word(name, kind, value, one)
    return _number(name, kind, value, one.low if low is None else low, one.high)


def read_yes(name: str, value: object) -> bool:
    """Read a truth value, also as OpenRTM writes it. OptionError: the value is none."""
    return _yes(name, value, [])


def fault_of(cls: type, name: str, value: Any) -> str:
    """The fault of an option's value, in words; "" where there is none. Only numbers and words are looked at."""
    if value is None or not (what := expected_of(cls, name, value)):
        return ""
    if isinstance(value, str) and (words := words_among(cls, name)):
        return f"unknown {name} {value[:80]!r}; {suggestion(value, words)}"
    return f"{what}, got {value!r:.80}"


def expected_of(cls: type, name: str, value: Any) -> str:
    """The expectation that a number or a word misses, in words; "" where the value fits, or the option has other types.

    Only options of words alone, or of numbers and at most truth values, are judged: values of options with other
    alternatives are for their class to refuse.
    """
    one, kinds = options_of(cls).get(name), kinds_of(cls).get(name, ())
    if one is None or not kinds or (value is None and may_be_none(cls, name)):
        return ""
    if words := words_among(cls, name):
        return "" if isinstance(value, str) and value in words else f"expected one of {', '.join(words)}"
    return expected_text(one, value) if kinds == (str,) else expected_number(one, kinds, value)


def expected_text(one: Option, value: Any) -> str:
    """The expectation that a text misses by its length, in words; "" where it fits, and for what is no text."""
    if not isinstance(value, str) or (one.low or 0) <= len(value) <= (math.inf if one.high is None else one.high):
        return ""
    ends = ("at least", one.low), ("at most", one.high)
    return f"expected a text of {' and '.join(f'{word} {_shown(end)}' for word, end in ends if end)} characters"


def expected_number(one: Option, kinds: Collection[Any], value: Any) -> str:
    """The expectation that a value misses at an option of numbers and at most truth values; "" for other types."""
    if not {int, float} & {*kinds} or {*kinds} - {bool, int, float} or (isinstance(value, bool) and bool in kinds):
        return ""
    is_number = isinstance(value, (int, float) if float in kinds else int) and not isinstance(value, bool)
    if is_number and _is_within(one, value):
        return ""
    ends = ("from", one.low), ("above", one.above), ("to", one.high)
    bounds = [f"{word} {_shown(end)}" for word, end in ends if end is not None]
    if one.low is not None and one.high is None:
        bounds.append("on")
    number = _NUMBERS.get(one.unit) or ("a number" if float in kinds else "a whole number")
    truth = "true, false or " if bool in kinds else ""
    such = f", such as {one.default!r}" if one.default else ""
    return f"expected {truth}{' '.join((number, *bounds))}{such}"


def _is_within(one: Option, value: Any) -> bool:
    if one.low is one.above is one.high is None:
        return True
    if value == math.inf:
        return one.endless
    low, high = (-math.inf if one.low is None else one.low), (math.inf if one.high is None else one.high)
    return low <= value <= high and (one.above is None or one.above < value)


def _shown(end: float) -> str:
    return f"{end:g}" if isinstance(end, float) else str(end)


def check_declared(made: Any) -> None:
    """Refuse numbers and words that are out of range.

    Raises:
        ConfigurationError: names the first such field.
    """
    cls: type = type(made)
    check_values(cls, {name: getattr(made, name) for name in options_of(cls)})


def check_values(cls: type, given: Mapping[str, Any], where: str = "") -> None:
    """Refuse numbers and words by name that are out of range; the message begins with `where`."""
    for name, value in given.items():
        if what := expected_of(cls, name, value):
            raise ConfigurationError(f"{where}{name} = {shown(value)}: {what}")


def words_among(cls: type, name: str) -> list[str]:
    """The words of an option that takes words alone; [] for any other."""
    kinds = kinds_of(cls).get(name, ())
    words = [word for kind in kinds for word in words_of(kind)]
    are_all = all(map(words_of, kinds)) and all(isinstance(word, str) for word in words)
    return [str(word) for word in words] if are_all else []


def folded(value: Any) -> Any:
    """A word in the form that is looked up; a value that is no text stays as it is."""
    return value.strip().lower() if isinstance(value, str) else value


def _yes(name: str, value: object, words: list[str]) -> bool:
    if isinstance(value, bool):
        return value
    answer = truth_of(str(value))
    if answer is None:
        more = "".join(f', or "{word}"' for word in words)
        raise OptionError(f"{name} = {value!r}: expected true or false{more}")
    return answer


def _word(name: str, kind: type[StrEnum], value: Any, one: Option) -> StrEnum | None:
    word = folded(value)
    word = one.words.get(word, word) if isinstance(word, str) else word
    if one.default is None and (word == "" or word is False):
        return None
    try:
        return kind(word)
    except ValueError:
        known = [member.value for member in kind]
        raise OptionError(f"{name} = {value!r}: expected {', '.join(known)}{meant(word, known)}") from None


def _number(name: str, kind: type[int] | type[float], value: Any, low: Any, high: Any) -> int | float:
    number = "a whole number" if kind is int else "a number"
    wrong = f"{name} = {value!r}: expected {number} from {_shown(low)} to {_shown(high)}"
    try:
        if isinstance(value, bool) or (kind is int and isinstance(value, float) and not value.is_integer()):
            raise OptionError(wrong)
        read = whole_of(value) if kind is int and isinstance(value, str) else kind(value)
    except (TypeError, ValueError, OverflowError):
        raise OptionError(wrong) from None
    if not low <= read <= high:  # also refuses NaN
        raise OptionError(wrong)
    return read
