"""Samples as lines of strict JSON, and back, for components that run as Unix filters. It opens no stream.

A line out: `{"port": "output0", "type": "TimedLong", "tm": 1700000000000000000, "data": 6200}`. A record whose fields
besides `tm` are not `data` alone has an object of them as its `data`; where a header holds the time, both tell it, and
a line in is believed at its `tm`. A line in may leave out all but `data`, and there each field that has a default; an
object with the key `data` is a line, any other value is the data itself.
"""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Mapping
from typing import Any, Final, NoReturn

from aiorts.errors import AiortsError, RecordError
from aiorts.spelling import suggestion
from aiorts.types import describe, fields_of, from_plain, full_name, has_tm, to_plain, type_name, wire_type, with_tm
from aiorts.types.samples import original
from aiorts.types.structure import has_single_values

_KEYS: Final = ("port", "type", "tm", "data")
_LONGEST: Final = 60
_encode: Final = json.JSONEncoder(allow_nan=False, ensure_ascii=False, separators=(", ", ": ")).encode
_NUMBERS: Final[dict[str, type]] = {
    **dict.fromkeys(("i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64"), int),
    **dict.fromkeys(("f32", "f64"), float),
}
"""Kinds of `data` whose values, if of exactly this class, are written in JSON as in Python."""


def line_of(port: str, sample: Any) -> str:
    """The line, without its end, for a sample of the port `port`."""
    tm, data = split_sample(sample)
    line: dict[str, Any] = {"port": port, "type": type_name(type(sample))}
    if tm is not None:
        line["tm"] = tm
    line["data"] = data
    return json_text(line)


def split_sample(sample: Any) -> tuple[int | None, Any]:
    """Time (None for a type without `tm`) and plain data of a sample."""
    exact = _number_of(type(sample))
    if exact is not None and type(sample.data) is exact and (exact is int or math.isfinite(sample.data)):
        return sample.tm, sample.data
    plain = to_plain(sample)
    if not isinstance(plain, dict) or not hasattr(type(sample), "__dataclass_fields__"):
        return None, plain
    tm = None
    if has_tm(type(sample)):
        tm = plain.pop("tm") if "tm" in plain else sample.tm
    return tm, plain["data"] if list(plain) == ["data"] else plain


def json_text(plain: Any) -> str:
    """Strict JSON on one line; characters that do not print, such as a terminal's escapes, are written by number."""
    text = _encode(plain)
    # JSON escapes the first 32 characters itself; other characters that do not print are written as JSON would.
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in text)


class LineWriter:
    """Writes the lines of one port, as `line_of` does, with their common beginning made once."""

    def __init__(self, port: str, cls: type[Any]) -> None:
        self._port = port
        self._cls = cls
        self._exact = _number_of(cls)
        self._head = json_text({"port": port, "type": type_name(cls)})[:-1]

    def line(self, sample: Any) -> str:
        """The line, without its end, for a sample."""
        if self._exact is not None and type(sample) is self._cls:
            data = sample.data
            if type(data) is self._exact and (self._exact is int or math.isfinite(data)):
                return f'{self._head}, "tm": {sample.tm}, "data": {data!r}}}'
        return line_of(self._port, sample)


def _number_of(cls: type) -> Any:
    """int or float if records of `cls` are checked and have only a time in ns and one such number; else None."""
    if cls not in _numbers:
        _numbers[cls] = _found_number_of(cls)
    return _numbers[cls]


_numbers: dict[type, type | None] = {}


def _found_number_of(cls: type) -> type | None:
    if not hasattr(cls, "__dataclass_fields__") or original(cls) is not cls:
        return None  # the class of a snapshot is no port's type
    structure = describe(cls)
    if not structure.checked or [field.name for field in structure.fields] != ["tm", "data"]:
        return None
    stamp, data = structure.fields
    return _NUMBERS.get(data.spelling) if structure.has_tm and stamp.record is None else None


class LineReader:
    """Reads lines for the given in-ports.

    With a single in-port every line is for it, whatever port the line names: that of its writer. A line of
    `output1` is for `input1` where there is no in-port `output1`: filters in a pipe need not know each other's names.

    Args:
        ports: the type of each in-port by its name; at least one.
    """

    def __init__(self, ports: Mapping[str, type]) -> None:
        self._forms = {name: _Form(cls) for name, cls in ports.items()}
        self._only = next(iter(ports)) if len(ports) == 1 else ""
        numbers = [(name, name.removeprefix("input")) for name in ports]
        pairs = {f"output{digits}": name for name, digits in numbers if name != digits and digits.isdecimal()}
        self._partners = {out: name for out, name in pairs.items() if out not in ports}
        self._decode = json.JSONDecoder(
            parse_constant=_no_constant, parse_float=_finite, object_pairs_hook=_unique
        ).decode

    def sample(self, line: str, now_ns: int) -> tuple[str, Any]:
        """In-port and sample of a line.

        Args:
            now_ns: `tm` where the line has none, nanoseconds since the epoch.

        Raises:
            RecordError: names the fault of the line.
        """
        try:
            plain = self._decode(line)
        except json.JSONDecodeError as error:
            raise RecordError(f"column {error.colno}: no JSON: {error.msg}: {_shown(line)}") from None
        except (ValueError, RecursionError) as error:
            raise RecordError(f"no JSON: {str(error) or 'nested too deeply'}: {_shown(line)}") from None
        if not isinstance(plain, dict) or "data" not in plain:
            return self._port(""), self._form("").sample(plain, now_ns)
        for key in plain:
            if key not in _KEYS:
                hint = suggestion(key, _KEYS, f"a line has {', '.join(_KEYS)}")
                raise RecordError(f"unknown key {_shown(key)}; {hint}")
        port = plain.get("port", "")
        form = self._form(port)
        form.check_type(plain.get("type"))
        sample = form.sample(plain["data"], plain.get("tm", now_ns))
        if form.is_headed and "tm" in plain and sample.tm != plain["tm"]:
            sample = with_tm(sample, plain["tm"])
        return self._port(port), sample

    def _port(self, name: Any) -> str:
        return self._only or self._partners.get(str(name), str(name))

    def _form(self, name: Any) -> _Form:
        form = self._forms.get(self._port(name)) if isinstance(name, str) else None
        if form is not None:
            return form
        there = ", ".join(self._forms)
        if name == "":
            raise RecordError(f'which in-port? write {{"port": NAME, "data": ...}}; there are {there}')
        raise RecordError(f"no in-port {_shown(name)}; there are {there}; the writer's ports need these names")


class _Form:
    """The plain data of one type in a line, and the way back to a sample."""

    def __init__(self, cls: type) -> None:
        self._cls = cls
        self._name = type_name(cls)
        self._names = {self._name, full_name(cls), *([cls.__name__] if wire_type(cls.__name__) in (None, cls) else [])}
        self._bare = not hasattr(cls, "__dataclass_fields__")
        fields = [] if self._bare else [field.name for field in fields_of(cls)]
        self._timed = "tm" in fields and has_tm(cls)
        self.is_headed = "tm" not in fields and has_tm(cls)
        self._whole = [name for name in fields if name != "tm" or not self._timed] != ["data"]
        self._number = _number_of(cls) is not None

    def check_type(self, name: Any) -> None:
        """Check the type that a line names. RecordError: it is not the type of this form."""
        if name is not None and (type(name) is not str or name not in self._names):
            raise RecordError(f"a {_shown(name)} for a port of {self._name}; {self._advice(name)}")

    def _advice(self, name: Any) -> str:
        """The advice for lines of another type."""
        try:
            other = wire_type(name, bare=True) if type(name) is str else None
        except AiortsError:
            other = None
        if other is not None and has_single_values(other) and has_single_values(self._cls):
            return "put a flexifilter between them"
        return f"pass on only lines of {self._name} (of a replay: --ports NAME)"

    def sample(self, data: Any, tm: Any) -> Any:
        """The sample with this data."""
        if self._number and (type(data) is int or type(data) is float):
            return self._cls(tm, data)  # as `from_plain` would, for a number alone
        if self._bare:
            return from_plain(self._cls, data)
        if not self._whole:
            plain = {"data": data}
        elif isinstance(data, dict):
            plain = dict(data)
        else:
            raise RecordError(f"{self._name}: expected an object with its fields, got {_shown(data)}")
        if self._timed and "tm" not in plain:
            plain["tm"] = tm
        return from_plain(self._cls, plain, defaults=True)


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f'{name} is not JSON; write "{name}" in quotes')


def _finite(text: str) -> float:
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"{_shown(text)} is too large for a number of 64 bits")
    return number


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        seen: set[str] = set()
        for name, _ in pairs:
            if name in seen:
                raise ValueError(f"the key {_shown(name)} stands there twice")
            seen.add(name)
    return found


_brief: Final = reprlib.Repr()
_brief.maxstring = _brief.maxother = _brief.maxlong = _LONGEST
_brief.maxlevel = 3


def _shown(value: Any) -> str:
    """A few characters of a value, in a time that does not grow with it: a line may be long, and nest deep."""
    text = _brief.repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
