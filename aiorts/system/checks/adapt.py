"""The FlexiFilter that would join two ports which do not fit, as text for the system file; FlexiFilter itself is asked.

It is worked out from the types alone: scalars, sequences of known length, fields of the same name, units of one kind.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from fractions import Fraction
from typing import Any, Final

from aiorts.errors import AiortsError
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.late import dataclass
from aiorts.model.wanted.entries import ConnectionEntry
from aiorts.system.file.survey import Survey
from aiorts.types import describe, type_name

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
    }.items()
    for unit, size in units.items()
}
_PLAIN: Final = (bool, int, float, str)
_MOST_PINS: Final = 64


@dataclass(frozen=True, slots=True)
class Adaptation:
    """What would join the two ports: one line to read, and text for the file."""

    remedy: str
    text: str


@dataclass(frozen=True, slots=True)
class _End:
    """A port as FlexiFilter has it: how it is written, and its pins with the last part of their names."""

    written: str
    pins: tuple[tuple[str, str], ...]
    form: str


def adaptation(found: Survey, connection: ConnectionEntry, out: OutPort[Any], in_: InPort[Any]) -> Adaptation | None:
    """The entry of a FlexiFilter between these two; None where none is known that does it."""
    factor = _factor(out.unit, in_.unit)
    if factor is None:
        return None
    lengths = _length(out, in_), _length(in_, out)
    ends = _end(out, lengths[0]), _end(in_, lengths[1])
    if ends[0] is None or ends[1] is None:
        return None
    pairs = list(_pairs(ends[0], ends[1], out, in_))[:_MOST_PINS]
    entries = ",".join(f"{source}>{factor}>{target}" if factor else f"{source}>{target}" for source, target in pairs)
    if not pairs or not _accepted(found, ends[0].written, ends[1].written, entries):
        return None
    return _told(found, connection, out, in_, ends[0].written, ends[1].written, entries)


def _told(
    found: Survey,
    connection: ConnectionEntry,
    out: OutPort[Any],
    in_: InPort[Any],
    source: str,
    target: str,
    entries: str,
) -> Adaptation:
    name = _free_name(found, f"{out.path.partition('.')[0]}_to_{in_.path.replace('.', '_')}")
    options = json.dumps(["-i", source, "-o", target, "-m", entries])
    kept = "".join(
        f"{word} = {_toml(value)}\n" for word, value in connection.options.items() if word not in ("name", "stamp")
    )
    reader = in_.path.partition(".")[0]
    homes = (one.name for one in found.system.contexts.values() if reader in one.members)
    home = next((one for one in homes if one in found.contexts and not found.contexts[one].exclusive), "")
    place = f"contexts.{home}, before {reader!r}" if home else "an event context"
    guess = "".join(
        f"# {written} is a guess: {port.path} does not say how many elements it has\n"
        for port, written in ((out, source), (in_, target))
        if ":" in written and not _stated(port)
    )
    replaced = f"in place of connections[{connection.number}]"
    if len(connection.ports) > 2:
        replaced = f'and take "{in_.path}" out of connections[{connection.number}]'
    text = (
        f'{guess}[components.{name}]\ntype = "FlexiFilter"\noptions = {options}\n\n'
        f"# {replaced}\n"
        f'[[connections]]\nfrom = "{out.path}"\nto = "{name}.input0"\n{kept}\n'
        f'[[connections]]\nfrom = "{name}.output0"\nto = "{in_.path}"\n{kept}'
        f"# and in the members of {place}: {name!r}\n"
    )
    return Adaptation(f"put the FlexiFilter {name!r} between them, as below", text)


def _free_name(found: Survey, wanted: str) -> str:
    name, number = wanted[:90], 2
    while name in found.system.components:
        name, number = f"{wanted[:90]}{number}", number + 1
    return name


def _toml(value: Any) -> str:
    return "inf" if value is None else json.dumps(value)


# -- pins --------------------------------------------------------------------------------------------------------------


def _factor(unit: str | None, wanted: str | None) -> str | None:
    """The factor as a map has it, "" for none; None where it is not known."""
    if unit is None or wanted is None or unit == wanted:
        return ""
    if unit not in _UNITS or wanted not in _UNITS or _UNITS[unit][0] != _UNITS[wanted][0]:
        return None
    factor = _UNITS[unit][1] / _UNITS[wanted][1]
    return str(factor.numerator) if factor.denominator == 1 else repr(float(factor))


def _length(port: Port[Any], other: Port[Any]) -> int:
    """How many pins a sequence has: what its shape says, else that of the other end, else one."""
    for one in (port, other):
        if (stated := _stated(one)) > 0:
            return stated
    if _form(other.type) == "record":
        return len(_leaves(other.type))
    return 1


def _stated(port: Port[Any]) -> int:
    """The length that a port says its sequences have; 0 where it says none."""
    shape = port.shape
    return shape[0] if shape is not None and len(shape) == 1 and 0 < shape[0] <= _MOST_PINS else 0


def _end(port: Port[Any], length: int) -> _End | None:
    name = type_name(port.type)
    match _form(port.type):
        case "scalar":
            return _End(name, (("", port.name),), "scalar")
        case "sequence":
            return _End(f"{name}:{length}", tuple((f":{pin}", "") for pin in range(length)), "sequence")
        case "record":
            return _End(name, tuple((f":{path}", path.rpartition(".")[2]) for path in _leaves(port.type)), "record")
    return None


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


def _leaves(cls: type) -> tuple[str, ...]:
    """Paths of the single values of a record, as pins name them: without `data` in front."""
    paths: list[str] = []

    def walk(kind: type, prefix: str) -> None:
        for field in describe(kind).fields:
            if field.name == "tm" and not prefix:
                continue
            if field.record is not None and not field.spelling.startswith("seq["):
                walk(field.record, prefix if field.name == "data" and not prefix else f"{prefix}{field.name}.")
            elif not field.kind.base.startswith(("seq[", "map", "ndarray")):
                paths.append(f"{prefix}{field.name}")

    walk(cls, "")
    return tuple(paths)


def _pairs(source: _End, target: _End, out: Port[Any], in_: Port[Any]) -> Iterator[tuple[str, str]]:
    """Which pin goes to which: fields by name, else all in their order where there are equally many."""
    if source.form == target.form == "record" or {source.form, target.form} == {"record", "scalar"}:
        for pin, name in target.pins:
            same = [other for other, _ in source.pins if other == pin] or [
                other for other, last in source.pins if last == name
            ]
            if len(same) == 1:
                yield f"0{same[0]}", f"0{pin}"
        return
    if len(source.pins) != len(target.pins):
        return
    for (pin, _), (other, _) in zip(source.pins, target.pins, strict=True):
        yield f"0{pin}", f"0{other}"


def _accepted(found: Survey, source: str, target: str, entries: str) -> bool:
    """Whether FlexiFilter itself takes this map between these ports."""
    try:
        cls: Any = found.catalogue.find("components", "FlexiFilter").load()
        cls.table(inputs=(source,), outputs=(target,), map=entries)
    except (AiortsError, AttributeError):
        return False
    return True
