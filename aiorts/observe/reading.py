"""Reads profiles, changes and statistics of a saved or remote system from JSON data, as values of the same classes.
Nothing of the kernel is imported, and no input is trusted: the result is a value, RecordError or LimitError.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final, TypeVar, cast

from aiorts.errors import RecordError, RecordTypeError
from aiorts.late import dataclass
from aiorts.model.plain import plain
from aiorts.model.reading import PROFILE_LIMITS, PlainLimits, from_plain
from aiorts.model.values import convert_value, parse_type
from aiorts.observe.change_values import Change, Part, PastEvent, ProfileSnapshot
from aiorts.observe.profiles import PROFILE_VERSION, ComponentReport, ParameterReport, SystemProfile

T = TypeVar("T")
_AS_TOLD: Final = frozenset(("str", "int", "bool", ""))
"""Types of parameters whose values JSON carries as they are."""


def profile_to_plain(value: object) -> dict[str, Any]:
    """A profile, report, change or statistics as JSON has it: dicts, lists, text, numbers, booleans and None."""
    made: dict[str, Any] = value.to_plain() if isinstance(value, _OWN) else plain(value)
    return made


def profile_from_plain(
    kind: type[T], data: object, limits: PlainLimits = PROFILE_LIMITS, *, unknown: dict[str, Any] | None = None
) -> T:
    """The value of which `data` is the plain form: a `SystemProfile`, or any report, change or statistics.

    Unknown keys, which a later version may write, are put into `unknown` by their paths; missing fields have their
    defaults. Values of parameters have the types of the parameters again, but a member of an Enum is its value. The
    event of a `Change` is a `PastEvent`.

    Raises:
        RecordError: something is missing or of a wrong type, with its path; or a later aiorts wrote it, in a form that
            this one would misread.
        LimitError: there is more than `limits` allow.
    """
    if isinstance(data, dict):
        inner = data.get("profile") if kind is ProfileSnapshot else data
        version = inner.get("schema") if isinstance(inner, dict) and kind in (SystemProfile, ProfileSnapshot) else None
        if type(version) is int and version > PROFILE_VERSION:
            raise RecordError(
                f"schema: the profile is of a later form than this aiorts reads ({PROFILE_VERSION}); read it with the "
                "aiorts that wrote it"
            )
    read: Any
    if kind is Change:
        told = _read(ToldChange, kind, data, limits, unknown)
        read = Change(told.sequence, PastEvent(told.kind, told.event), tuple(map(_typed, told.parts)))
    elif kind is ProfileSnapshot:
        whole = _read(ToldSnapshot, kind, data, limits, unknown)
        if whole.kind != "ProfileSnapshot":
            raise RecordError("kind: expected ProfileSnapshot, got a Change; ask for that")
        read = ProfileSnapshot(whole.sequence, _typed(whole.profile), whole.missed)
    else:
        read = _typed(from_plain(kind, data, limits=limits, unknown=unknown))
    return cast("T", read)


_OWN: Final = (SystemProfile, Change, ProfileSnapshot)
"""Classes with a plain form of their own."""


@dataclass(frozen=True, slots=True)
class ToldChange:
    """A change as JSON has it."""

    sequence: int
    """Number of the event on the bus."""
    kind: str
    """The name of the event's class."""
    event: Mapping[str, Any]
    """The fields of the event."""
    parts: tuple[Part, ...]
    """Every part of the profile that is different since."""


@dataclass(frozen=True, slots=True)
class ToldSnapshot:
    """A snapshot as JSON has it."""

    sequence: int
    profile: SystemProfile
    kind: str
    """"ProfileSnapshot": a change has the name of its event here."""
    missed: int = 0
    """The number of dropped changes that this snapshot replaces."""


def _read(form: type[T], kind: type, data: object, limits: PlainLimits, unknown: dict[str, Any] | None) -> T:
    if not isinstance(data, dict):
        raise RecordTypeError(f"{kind.__name__}: expected an object, got {type(data).__name__}")
    if kind is Change and data.get("kind") == "ProfileSnapshot":
        raise RecordError("kind: expected a change, got ProfileSnapshot; ask for that")
    return from_plain(form, data, limits=limits, unknown=unknown)


def _typed(value: Any) -> Any:
    """A report or profile, with values of parameters as the parameters hold them."""
    if isinstance(value, SystemProfile):
        components = {name: _typed(one) for name, one in value.components.items()}
        return replace(value, components=MappingProxyType(components))
    if isinstance(value, Part):
        return replace(value, now=_typed(value.now))
    if isinstance(value, ComponentReport):
        return _typed_component(value)
    if isinstance(value, ParameterReport) and value.type not in _AS_TOLD:
        choices = value.choices and tuple(_held(one, value.type) for one in value.choices)
        held, default = _held(value.value, value.type), _held(value.default, value.type)
        return replace(value, value=held, default=default, choices=choices)
    return value


def _typed_component(report: ComponentReport) -> ComponentReport:
    kinds = {name: one.type for name, one in report.params.items() if one.type not in _AS_TOLD}
    if not kinds:
        return report
    params = {name: _typed(one) for name, one in report.params.items()}
    sets = {
        name: MappingProxyType({key: _held(one, kinds.get(key, "")) for key, one in values.items()})
        for name, values in report.configuration.sets.items()
    }
    configuration = replace(report.configuration, sets=MappingProxyType(sets))
    return replace(report, params=MappingProxyType(params), configuration=configuration)


def _held(value: Any, type_text: str) -> Any:
    """A value as a parameter of that type holds it; unchanged where the type is not known or does not fit."""
    kind = None if value is None or type_text in _AS_TOLD else _parameter_type(type_text)
    if kind is None or (kind is float and value.__class__ is float):
        return value
    try:
        return convert_value(value, kind)
    except (TypeError, ValueError):
        return value


@lru_cache(maxsize=256)
def _parameter_type(text: str) -> Any:
    try:
        return parse_type(text)
    except ValueError:
        return None
