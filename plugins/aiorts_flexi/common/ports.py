"""Parses port specifications, `TYPE`, `TYPE:LEN` or `TYPE:N`, and finds the pins of such a port.

A sequence has the pins 0 to LEN - 1, a scalar pin 0, a record its fields by path. A path that the record does not have
is looked for below its field `data`, so `position.x` is a pin of TimedPose2D.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

from aiorts.errors import ConfigurationError, RecordError, UnknownTypeError, WiringError
from aiorts.late import dataclass
from aiorts.types import describe, find_type, path_type
from aiorts_flexi.common.place import TypedTextError

MOST_PINS: Final = 1_000_000
MOST_PORTS: Final = 1_000
_LENGTH = re.compile(r"[1-9][0-9]{0,6}")
_STEPS: Final = re.compile(r"[.\[]")
_SCALAR_KINDS: Final = frozenset(
    ("i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64", "f32", "f64", "bool", "char", "wchar", "str", "stamp")
)
_PLAIN: Final[dict[type, str]] = {bool: "bool", int: "i64", float: "f64", str: "str"}


@dataclass(frozen=True, slots=True)
class PortSpec:
    """A port as its user specified it. `shape` is "scalar", "sequence" or "record"; `element` the kind of its pins."""

    name: str
    type: type
    shape: str
    element: str = ""
    length: int = 0
    plain: bool = False
    """Whether the type is a bare int, float, bool or str, without fields."""

    def pin_path(self, pin: int | str) -> str:
        """The field path of a pin, "" for a bare value. ConfigurationError when there is no such pin."""
        if isinstance(pin, int):
            return self._numbered(pin)
        if self.plain:
            raise ConfigurationError(f"{self.name}:{pin}: a {self.type.__name__} has no fields; its only pin is 0")
        try:
            self._check(pin)
        except RecordError as error:
            if describe(self.type).field("data") is None or self.shape != "record":
                raise ConfigurationError(f"{self.name}:{pin}: {error}") from None
        else:
            return pin
        try:
            self._check(f"data.{pin}")
        except RecordError as error:
            raise ConfigurationError(f"{self.name}:{pin}: {error}") from None
        return f"data.{pin}"

    def special(self, pin: int | str) -> Any:
        """The kind at a pin whose values may be absent, or are enumeration members or moments; None for others."""
        path = self.pin_path(pin)
        found: Any = path_type(self.type, path) if path else None
        return found if getattr(found, "base", "") != getattr(found, "spelling", "") else None

    def _check(self, path: str) -> None:
        """Raise RecordError for a path that does not exist, ConfigurationError if a record on it may be absent."""
        path_type(self.type, path)
        for place in (match.start() for match in _STEPS.finditer(path)):
            found: Any = path_type(self.type, path[:place])
            if hasattr(found, "inner"):
                where = f"{self.name}:{path}: {self.type.__name__}.{path[:place]}"
                raise ConfigurationError(f"{where} is {found.spelling} and may be absent; no pin leads through it")

    def kind(self, pin: int | str) -> str:
        """The kind of value at a pin ("f64", "str"). ConfigurationError when the pin is no single value."""
        path = self.pin_path(pin)
        if isinstance(pin, int):
            return self.element
        found: Any = path_type(self.type, path)
        spelling = found.__name__ if isinstance(found, type) else str(found.base)
        if not is_scalar(spelling):
            raise ConfigurationError(
                f"{self.name}:{pin}: a pin is one value, this is {spelling}; name a field inside it"
            )
        return spelling

    def _numbered(self, pin: int) -> str:
        if self.shape == "record":
            raise ConfigurationError(
                f"{self.name}:{pin}: {self.type.__name__} has named pins; "
                f"write a field such as {self.name}:{_example(self.type)}"
            )
        if pin >= self.length:
            raise ConfigurationError(f"{self.name}:{pin}: there is no such pin; the last one is {self.length - 1}")
        if self.plain:
            return ""
        return "data" if self.shape == "scalar" else f"data[{pin}]"


def parse_port(text: str, name: str) -> PortSpec:
    """Parse `TYPE` or, for a sequence, `TYPE:LEN`. TypedTextError marks the part that is wrong."""
    written, colon, _ = text.partition(":")
    cls = parse_type(written, name, text)
    shape, element = _shape(cls)
    if shape != "sequence":
        if colon:
            reason = f"{cls.__name__} is no sequence; write {written.strip()} alone"
            raise TypedTextError(name, text, len(written), reason, found=False)
        return PortSpec(name, cls, shape, element, 1, plain=cls in _PLAIN)
    if not colon:
        reason = f"a sequence needs its length; write {written.strip()}:LEN"
        raise TypedTextError(name, text, len(written), reason, found=False)
    return PortSpec(name, cls, shape, element, _number(text, written, name, "a length", MOST_PINS))


def port_of(cls: type, name: str, length: int) -> PortSpec:
    """A port of this type; `length` is the length of a sequence.

    Raises:
        ConfigurationError: the type has no pins, or not so many.
    """
    if cls not in _PLAIN and not hasattr(cls, "__dataclass_fields__"):
        raise ConfigurationError(f"{name}: a {cls.__name__} has no pins; a record, bool, int, float or str has")
    if length > MOST_PINS:
        raise ConfigurationError(f"{name}: expected at most {MOST_PINS} pins, got {length}")
    shape, element = _shape(cls)
    return PortSpec(name, cls, shape, element, length if shape == "sequence" else 1, plain=cls in _PLAIN)


def parse_counted(text: str, name: str) -> tuple[type, int]:
    """Parse several ports of one type, `TYPE:N`. TypedTextError marks the part that is wrong."""
    written, colon, _ = text.partition(":")
    cls = parse_type(written, name, text)
    if not colon:
        reason = f"expected ':' and how many ports; write {written.strip()}:2"
        raise TypedTextError(name, text, len(written), reason, found=False)
    return cls, _number(text, written, name, "how many ports,", MOST_PORTS)


def parse_type(text: str, name: str, whole: str = "") -> type:
    """The type of a port by its name, which is at the beginning of `whole`.

    TypedTextError with near names when there is none.
    """
    whole = whole or text
    place = len(text) - len(text.lstrip()) if text.strip() else 0
    try:
        cls = find_type(text.strip())
    except UnknownTypeError as error:
        raise TypedTextError(name, whole, place, str(error), found=False) from None
    if cls not in _PLAIN and not hasattr(cls, "__dataclass_fields__"):
        raise TypedTextError(name, whole, place, f"{cls.__name__} cannot be a port's type; a record can", found=False)
    return cls


def named_types(owner: str, inputs: Sequence[str], names: Sequence[str]) -> dict[str, type]:
    """The types of a component's in-ports by port name: the given names, else input0, input1, ...

    Raises:
        ConfigurationError: there is no type, or there are too many names.
        WiringError: a name is given twice.
        TypedTextError: there is no such type.
    """
    if not inputs:
        raise ConfigurationError(f"{owner}.inputs: expected the type of at least one in-port")
    if len(names) > len(inputs):
        raise ConfigurationError(f"{owner}: {len(names)} names for {len(inputs)} in-ports; give at most one for each")
    found: dict[str, type] = {}
    for number, text in enumerate(inputs):
        name = (names[number] if number < len(names) else "") or f"input{number}"
        if name in found:
            raise WiringError(f"{owner}.{name}: there is a port of that name already")
        found[name] = parse_type(text, f"input{number}")
    return found


def is_scalar(kind: str) -> bool:
    """Whether values of this kind are single values, which `convert` makes."""
    return kind in _SCALAR_KINDS


def _number(text: str, written: str, name: str, what: str, most: int) -> int:
    number = text[len(written) + 1 :].rstrip()
    if _LENGTH.fullmatch(number) is None or int(number) > most:
        raise TypedTextError(name, text, len(written) + 1, f"expected {what} from 1 to {most}")
    return int(number)


def _shape(cls: type) -> tuple[str, str]:
    if cls in _PLAIN:
        return "scalar", _PLAIN[cls]
    field = describe(cls).field("data")
    others = [other.name for other in describe(cls).fields if other.name not in ("tm", "data")]
    if field is None or others:
        return "record", ""
    spelling = field.spelling
    if is_scalar(spelling):
        return "scalar", spelling
    if spelling.startswith("seq[") and is_scalar(spelling[4:-1]):
        return "sequence", spelling[4:-1]
    return "record", ""


def _example(cls: type) -> str:
    names = [field.name for field in describe(cls).fields if field.name != "tm"]
    return names[0] if names else "tm"
