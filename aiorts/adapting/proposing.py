"""The FlexiFilter that joins two ports which do not fit, worked out from their types, units and lengths alone.

Scalars, sequences of known length, fields of the same name, units of one kind. Nothing is made here.
"""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Container, Mapping
from fractions import Fraction
from functools import partial
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias

from aiorts.errors import AiortsError, WiringError
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.late import dataclass
from aiorts.types import describe, type_name
from aiorts.types.structure import sole_unit, units_of

FILTER: Final = "FlexiFilter"
"""The type of the component that is put between, as a plugin offers it."""
_UNITS: Final[dict[str, tuple[str, Fraction]]] = {
    unit: (what, Fraction(size))
    for what, units in {
        "length": {"m": "1", "mm": "1/1000", "cm": "1/100", "km": "1000", "um": "1/1000000"},
        "time": {"s": "1", "ms": "1/1000", "us": "1/1000000", "ns": "1/1000000000", "min": "60", "h": "3600"},
        "angle": {"rad": "1", "deg": "0.017453292519943295"},
        "speed": {"m/s": "1", "mm/s": "1/1000", "cm/s": "1/100", "km/h": "10/36"},
        "turning": {"rad/s": "1", "deg/s": "0.017453292519943295", "rpm": "0.10471975511965977"},
        "acceleration": {"m/s^2": "1", "mm/s^2": "1/1000", "g": "9.80665"},
        "frequency": {"Hz": "1", "kHz": "1000", "MHz": "1000000"},
        "mass": {"kg": "1"},
        "voltage": {"V": "1", "mV": "1/1000"},
        "current": {"A": "1", "mA": "1/1000"},
        "force": {"N": "1", "mN": "1/1000", "kN": "1000"},
        "pressure": {"Pa": "1", "hPa": "100", "kPa": "1000", "bar": "100000"},
        "temperature": {"K": "1", "mK": "1/1000", "degC": "1", "°C": "1", "degF": "5/9", "°F": "5/9"},
    }.items()
    for unit, size in units.items()
}
_ZEROS: Final[dict[str, Fraction]] = {
    "degC": Fraction("273.15"),
    "°C": Fraction("273.15"),
    "degF": Fraction("459.67") * 5 / 9,
    "°F": Fraction("459.67") * 5 / 9,
}
"""The zero of a scale in the unit of its kind whose size is 1, where that is not 0."""
_TEXTS: Final = ("str", "char", "wchar")
_PLAIN: Final = (bool, int, float, str)
_MOST_PINS: Final = 64
_LONGEST: Final = 90
"""Characters of a filter's name before its number."""
_NOTHING: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Between:
    """The options of a FlexiFilter between two ports."""

    source: str
    """Its input, such as "TimedPose2D"."""
    target: str
    """Its output."""
    entries: str
    """Its map, such as "0:position.x>0:x"."""
    guessed: tuple[str, ...] = ()
    """Paths of the ports that do not say how many elements they have."""
    several: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=lambda: _NOTHING)
    """The values of the in-port that can be had in several ways: the entries, or for "all" the maps, that would do it.
    The map has none of them."""
    unset: tuple[str, ...] = ()
    """The values of the in-port to which nothing is sent; they keep their defaults."""
    texts: tuple[str, ...] = ()
    """The values of the in-port that are made of a text: a text that is no such value puts the filter into error."""

    @property
    def options(self) -> tuple[str, ...]:
        """The options as the command line of a FlexiFilter has them."""
        return ("-i", self.source, "-o", self.target, "-m", self.entries)

    @property
    def said(self) -> str:
        """The filter in one line, for people."""
        left = f"; nothing is sent to {', '.join(self.unset)}" if self.unset else ""
        return f"{FILTER} {shlex.join(self.options)}{left}"


def between(out: OutPort[Any], in_: InPort[Any]) -> Between | None:
    """The filter that joins two ports, its map empty where all values can be had in several ways; None: none does."""
    if _factor(out.unit, in_.unit) is None:
        return None
    source, target = _end(out, _length(out, in_)), _end(in_, _length(in_, out))
    if source is None or target is None:
        return None
    pairs, several = _pairs(source, target)
    if not pairs and not several:
        return None
    pairs = pairs[:_MOST_PINS]
    factor = partial(_factor_between, source, target)
    if any(factor(pair) is None for pair in pairs):
        return None
    several = {pin: [way for way in ways if None not in map(factor, way)] for pin, ways in several.items()}
    several = {pin: ways for pin, ways in several.items() if ways}
    done = {other for _, other in pairs}
    named = {pin: pin.removeprefix(":") or in_.name for pin, _ in target.pins}
    return Between(
        source.written,
        target.written,
        _entries(pairs, factor),
        tuple(
            port.path for port, end in ((out, source), (in_, target)) if end.form == "sequence" and not _stated(port)
        ),
        MappingProxyType(
            {named.get(pin, pin): tuple(_entries(one, factor) for one in ways) for pin, ways in several.items()}
        ),
        tuple(name for pin, name in named.items() if pairs and pin not in done and pin not in several),
        tuple(
            named.get(pin, pin) for other, pin in pairs if _may_refuse(source.kinds.get(other), target.kinds.get(pin))
        ),
    )


def plain_between(out: OutPort[Any], in_: InPort[Any], adapt: bool | Literal["text"]) -> Between | None:
    """The filter that joins two ports without any doubt; None where there is none.

    Args:
        adapt: "text": a text may be made into a number.

    Raises:
        WiringError: there are several ways, and all of them are named; or a length is not known; or a number is to be
            made of a text, and the connection does not say so.
    """
    found = between(out, in_)
    if found is None:
        return None
    where = f"{out.path} -> {in_.path}: adapt"
    if found.several:
        ways = "; ".join(f"{what} by {' or by '.join(one)}" for what, one in found.several.items())
        raise WiringError(
            f"{where}: it is not plain which value goes where: {ways}; choose, and put a {FILTER} of your own between "
            f"them, with -i {found.source} -o {found.target}"
        )
    if found.guessed:
        whose = " and ".join(found.guessed)
        raise WiringError(
            f"{where}: how many elements {whose} has is not known; declare a shape, such as shape=(3,), "
            f"{_MOST_PINS} at the most, or put a {FILTER} of your own between them"
        )
    if found.texts and adapt != "text":
        raise WiringError(
            f"{where}: {', '.join(found.texts)} is made of a text, and one such as 'abc' puts the {FILTER} into error; "
            'say adapt = "text" where each text is a value of it'
        )
    return found


def filter_name(out: str, in_: str, taken: Container[str]) -> str:
    """The name of a filter between two ports: not taken, and easy to recognise. The ports are given as paths."""
    base = f"{out.partition('.')[0]}_to_{in_.replace('.', '_')}"[:_LONGEST]
    name, number = base, 2
    while name in taken:
        name, number = f"{base}{number}", number + 1
    return name


def is_accepted(catalogue: Catalogue, one: Between) -> bool:
    """Whether FlexiFilter itself takes this map between these ports."""
    try:
        cls: Any = catalogue.find("components", FILTER).load()
        cls.table(inputs=(one.source,), outputs=(one.target,), map=one.entries)
    except (AiortsError, AttributeError):
        return False
    return True


@dataclass(frozen=True, slots=True)
class _End:
    """A port as FlexiFilter has it: how it is written, and its pins with the last part of their names."""

    written: str
    pins: tuple[tuple[str, str], ...]
    form: str
    kinds: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """The kind of value at each pin."""
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """The unit of each pin that has one."""


def conversion(unit: str, wanted: str) -> tuple[Fraction, Fraction] | None:
    """Factor and offset by which a value in one unit becomes one in the other, exact; None where it is not known."""
    if unit not in _UNITS or wanted not in _UNITS or _UNITS[unit][0] != _UNITS[wanted][0]:
        return None
    size, size_wanted = _UNITS[unit][1], _UNITS[wanted][1]
    return size / size_wanted, (_ZEROS.get(unit, Fraction(0)) - _ZEROS.get(wanted, Fraction(0))) / size_wanted


def _factor(unit: str | None, wanted: str | None) -> str | None:
    """The factor as a map has it, with the offset where there is one, "" for none; None where it is not known."""
    if unit is None or wanted is None or unit == wanted:
        return ""
    found = conversion(unit, wanted)
    if found is None:
        return None
    factor, offset = found
    if offset:
        return f"{factor}{'+' if offset > 0 else ''}{offset}"
    return str(factor.numerator) if factor.denominator == 1 else repr(float(factor))


def _factor_between(source: _End, target: _End, pair: tuple[str, str]) -> str | None:
    """The factor from one pin to the other, by the units of the ports or of their fields."""
    return _factor(source.units.get(pair[0]), target.units.get(pair[1]))


def _length(port: Port[Any], other: Port[Any]) -> int:
    """The number of pins of a sequence: by its shape, else by that of the other end, else one."""
    for one in (port, other):
        if (stated := _stated(one)) > 0:
            return stated
    if _form(other.type) == "record":
        return len(_leaves(other.type))
    return 1


def _stated(port: Port[Any]) -> int:
    """The length that a port declares for its sequences; 0 where it declares none."""
    shape = port.shape
    return shape[0] if shape is not None and len(shape) == 1 and 0 < shape[0] <= _MOST_PINS else 0


def _end(port: Port[Any], length: int) -> _End | None:
    found = _pins(port, length)
    if found is None:
        return None
    fields = {path.removeprefix("data."): unit for path, unit in units_of(port.type).items()}
    whole = port.unit or sole_unit(port.type)
    units = {pin: whole or fields.get(pin.removeprefix(":"), "") for pin, _ in found.pins}
    return dataclasses.replace(found, units={pin: unit for pin, unit in units.items() if unit})


def _pins(port: Port[Any], length: int) -> _End | None:
    name = type_name(port.type)
    match _form(port.type):
        case "scalar":
            return _End(name, (("", port.name),), "scalar", {"": _kind(port.type)})
        case "sequence":
            pins = tuple((f":{pin}", "") for pin in range(length))
            return _End(f"{name}:{length}", pins, "sequence", dict.fromkeys(dict(pins), _kind(port.type)))
        case "record":
            leaves = _leaves(port.type)
            pins = tuple((f":{path}", path.rpartition(".")[2]) for path in leaves)
            return _End(name, pins, "record", {f":{path}": kind for path, kind in leaves.items()})
    return None


def _kind(cls: type) -> str:
    """The kind of a scalar type's value, and of the elements of a sequence."""
    if cls in _PLAIN:
        return "str" if cls is str else cls.__name__
    (data,) = (field for field in describe(cls).fields if field.name != "tm")
    return data.kind.base.removeprefix("seq[").removesuffix("]")


def _may_refuse(source: str | None, target: str | None) -> bool:
    """Whether some texts of the source cannot be made into a value of the target."""
    return source in _TEXTS and target not in (source, "str")


def _form(cls: type) -> str:
    if cls in _PLAIN:
        return "scalar"
    try:
        fields = [field for field in describe(cls).fields if field.name != "tm"]
    except AiortsError:
        return ""
    if len(fields) == 1 and fields[0].name == "data" and fields[0].record is None:
        return "sequence" if fields[0].spelling.startswith("seq[") else "scalar"
    return "record"


def _leaves(cls: type) -> dict[str, str]:
    """Paths of the single values of a record, as pins name them: without `data` in front; each with its kind."""
    paths: dict[str, str] = {}

    def walk(kind: type, prefix: str) -> None:
        for field in describe(kind).fields:
            if field.name == "tm" and not prefix:
                continue
            if field.record is not None and not field.spelling.startswith("seq["):
                walk(field.record, prefix if field.name == "data" and not prefix else f"{prefix}{field.name}.")
            elif not field.kind.base.startswith(("seq[", "map", "ndarray")):
                paths[f"{prefix}{field.name}"] = field.kind.base

    walk(cls, "")
    return paths


_Pairs: TypeAlias = list[tuple[str, str]]


def _pairs(source: _End, target: _End) -> tuple[_Pairs, dict[str, list[_Pairs]]]:
    """The pairs of pins, and pins with several candidates: fields by name, else all in order if equally many."""
    pairs: _Pairs = []
    several: dict[str, list[_Pairs]] = {}
    forms = source.form, target.form
    if forms in (("record", "record"), ("record", "scalar"), ("scalar", "record")):
        for pin, name in target.pins:
            same = [other for other, _ in source.pins if other == pin] or [
                other for other, last in source.pins if last == name
            ]
            if len(same) == 1:
                pairs.append((same[0], pin))
            elif same or target.form == "scalar":
                several[pin] = [[(other, pin)] for other in same or [one for one, _ in source.pins]]
        return pairs, several
    mine, theirs = ([pin for pin, _ in end.pins] for end in (source, target))
    if len(mine) == len(theirs):
        return list(zip(mine, theirs, strict=True)), several
    if forms == ("sequence", "sequence") and len(mine) > len(theirs):  # consecutive ones, from any place on
        several["all"] = [
            list(zip(mine[first : first + len(theirs)], theirs, strict=True))
            for first in range(len(mine) - len(theirs) + 1)
        ]
    return pairs, several


def _entries(pairs: _Pairs, factor: Callable[[tuple[str, str]], str | None]) -> str:
    """The map of a filter with one input and one output."""
    return ",".join(f"0{one}>{f'{by}>' if (by := factor((one, other))) else ''}0{other}" for one, other in pairs)
