"""Reads fields of a recording as numbers over time, in one pass, with two numbers for each sample and field."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import islice
from operator import attrgetter
from typing import Any, Final

from aiorts.errors import AiortsError, ConfigurationError, RecordError
from aiorts.progress import Step
from aiorts.types import convert, path_type, read_path
from aiorts_log.analysis.values import values_of
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.mcap.reader import RecordedPort, RecordedSample, Recording, counted

_MOST: Final = 16
"""The most items of a sequence that are drawn, a curve for each."""
_STEP: Final = re.compile(r"\.?([^.\[\]]+)|\[(\d{1,9})\]")
_ENDLESS: Final = 2**63
_INDEX: Final = re.compile(r"\[(-?\d{1,9})\]")
_STAMPS: Final = ("tm", "sec", "nsec", "header")
_LOOKED: Final = 20
"""Samples of a port that show which of its fields are numbers: the first may lack some."""


@dataclass(slots=True)
class Series:
    """A curve: seconds since the first sample of the recording, and values; `unit` is "" when unknown.

    `left_out`, on the first item of a sequence, says which items have no curve; "" when all have one.
    """

    label: str
    unit: str = ""
    left_out: str = ""
    times: array[float] = field(default_factory=lambda: array("d"))
    values: array[float] = field(default_factory=lambda: array("d"))


class _Field:
    """A field of a port, and the curves read from it."""

    def __init__(self, port: RecordedPort, name: str, path: str) -> None:
        self.port = port
        self.label = f"{name}.{path}" if path else name
        self._path = path
        self._unit: str | None = None
        simple = re.fullmatch(r"\w+(\.\w+)*", path) is not None
        self._get: Callable[[Any], Any] = attrgetter(path) if simple else lambda record: read_path(record, path)
        self._series: list[Series] = []
        self._items = 0
        self._shape: tuple[int, ...] = ()
        self._lengths: dict[str, int] = {}
        """The length of the longest sequence that lacked an item, by the item's path."""
        self.numbers: Callable[[RecordedSample], Sequence[float]] = self._of_plain if port.unknown else self._of_record
        if not port.unknown and hasattr(port.type, "__dataclass_fields__"):
            try:
                path_type(port.type, path)
            except AiortsError as error:
                raise ConfigurationError(f"{self.label}: {error}") from None

    @property
    def series(self) -> list[Series]:
        """The curves: one for the field, or one for each item of a sequence."""
        if len(self._series) == 1:
            return [Series(self.label, self._series[0].unit, "", self._series[0].times, self._series[0].values)]
        if self._items > _MOST:
            other = f"{self.label}{self._place(_MOST)}"
            self._series[0].left_out = f"{self.label}: {_MOST} of {self._items} items drawn; name others, as {other}"
        return self._series

    @property
    def why_empty(self) -> str:
        """The reason why no sample has a number there; "" when a sample has one, or when there was no sample."""
        if any(value == value for one in self._series for value in one.values) or not self._series:
            return ""
        if not self._lengths:
            return f"{self.label}: is None or NaN in every sample"
        item = max(self._lengths, key=len)
        return f"{self.port.name}: no sample has {item}; the longest has {self._lengths[item]}"

    def add(self, seconds: float, sample: RecordedSample) -> None:
        """Add the values of a sample."""
        if self._unit is None:
            self._unit = self._unit_of(sample)
        for number, value in enumerate(self.numbers(sample)):
            if number == len(self._series):
                self._series.append(Series(f"{self.label}{self._place(number)}", self._unit))
            one = self._series[number]
            one.times.append(seconds)
            one.values.append(value)

    def _place(self, number: int) -> str:
        """The index of an item, in an array of any shape."""
        places = []
        for length in reversed(self._shape[1:]):
            number, rest = divmod(number, length)
            places.append(rest)
        return "".join(f"[{one}]" for one in (number, *reversed(places)))

    def _of_record(self, sample: RecordedSample) -> Sequence[float]:
        try:
            record = sample.port.decode(sample.data)
        except AiortsError as error:
            raise DamagedError(f"port {sample.port.name!r}, sample {sample.sequence}: {error}") from None
        if not hasattr(type(record), "__dataclass_fields__"):
            return self._checked(record)
        try:
            value = self._get(record)
        except (AttributeError, RecordError):
            value = None  # the path is right, and leads through an absent value
            for index in _INDEX.finditer(self._path):
                self._too_short(self._path[: index.end()], _items(record, self._path[: index.start()]), int(index[1]))
        return self._checked(value)

    def _of_plain(self, sample: RecordedSample) -> Sequence[float]:
        value = values_of(sample)
        for step in _STEP.finditer(self._path):
            name, index = step.groups()
            if value is None or (index and self._too_short(self._path[: step.end()], _length(value), int(index))):
                return [math.nan]
            try:
                value = value[int(index)] if index else value[name]
            except (KeyError, IndexError, TypeError):
                raise ConfigurationError(f"{self.label}: there is no {name or index} in its samples") from None
        return self._checked(value)

    def _unit_of(self, sample: RecordedSample) -> str:
        """The unit of the field, else that of the port if the port has only one field."""
        named = re.sub(r"\[[^\]]*\]", "", self._path)
        return self.port.units.get(named) or (self.port.metadata.get("unit", "") if self._has_unit(sample) else "")

    def _has_unit(self, sample: RecordedSample) -> bool:
        """Whether the port's unit is also the field's: the field is no stamp, and not one of several fields."""
        return re.split(r"[.\[]", self._path, maxsplit=1)[0] not in _STAMPS and _is_one(values_of(sample))

    def _too_short(self, item: str, length: int, index: int) -> bool:
        """Whether a sequence of that length lacks the item; notes the length for `why_empty`."""
        short = not -length <= index < length
        if short:
            self._lengths[item] = max(length, self._lengths.get(item, 0))
        return short

    def _checked(self, value: Any) -> Sequence[float]:
        if hasattr(value, "ravel"):
            self._shape, self._items = value.shape or (1,), max(self._items, value.size)
            value = value.ravel()[:_MOST].tolist()
        elif isinstance(value, tuple | list):
            self._items = max(self._items, len(value))
        values = list(value[:_MOST]) if isinstance(value, tuple | list) else [value]
        numbers = [_number(one) for one in values]
        if not all(isinstance(one, int | float) for one in numbers):
            raise ConfigurationError(f"{self.label}: is {type(values[0]).__name__}, not a number; {_way(values[0])}")
        return [float(one) for one in numbers]


def _is_one(value: Any) -> bool:
    """Whether a sample holds one value, or one sequence, in addition to its stamp."""
    if isinstance(value, list) and value:
        return _is_one(value[0])
    if not isinstance(value, dict):
        return True
    data = [one for name, one in value.items() if name not in _STAMPS]
    return len(data) == 1 and _is_one(data[0])


def _items(record: Any, path: str) -> int:
    """The number of items at a path; as good as endless where it leads to no sequence."""
    try:
        return _length(read_path(record, path))
    except (AttributeError, AiortsError):
        return _ENDLESS


def _length(value: Any) -> int:
    return len(value) if hasattr(value, "__len__") and getattr(value, "shape", None) != () else _ENDLESS


def _number(value: Any) -> Any:
    """The number to draw: NaN for an absent value, which leaves a gap in the curve; nanoseconds for a datetime."""
    if value is None:
        return math.nan
    if isinstance(value, Enum):
        return value.value
    return convert(value, "i64") if hasattr(value, "utcoffset") else value


def _way(value: Any) -> str:
    """Advice on what can be drawn in the place of a value that is no number."""
    fields = value if isinstance(value, dict) else getattr(value, "__dataclass_fields__", ())
    if fields:
        return f"name a field of it: {', '.join(list(fields)[:_MOST])}"
    if isinstance(value, tuple | list):
        return "name an item of it"
    return "numbers, moments, and enumerations of numbers whose type is known can be drawn"


def read_series(
    reader: Recording, names: Sequence[str], start: int | None, end: int | None, step: Step
) -> list[list[Series]]:
    """Read the curves of each of these fields (PORT.FIELD, or PORT for its `data`).

    Raises:
        ConfigurationError: there is no such port or field, or it is no number.
        RecordingError: no sample has a number there.
        DamagedError: the recording is damaged.
    """
    fields = [_found(reader, name, start, end) for name in names]
    by_port: dict[int, list[_Field]] = {}
    for one in fields:
        by_port.setdefault(id(one.port), []).append(one)
    zero = reader.start
    wanted = [name for name, port in reader.ports.items() if id(port) in by_port]
    for sample in counted(reader.samples(start=start, end=end, ports=wanted), step):
        seconds = (sample.log_time - zero) / 1e9
        for one in by_port[id(sample.port)]:
            one.add(seconds, sample)
    for one in fields:
        if why := one.why_empty:
            raise RecordingError(f"{reader.path}: {why}; nothing is drawn")
    return [one.series for one in fields]


def numeric_fields(
    reader: Recording, start: int | None, end: int | None, ports: Iterable[str] | None = None
) -> list[str]:
    """The fields (PORT.FIELD) with numbers in the first samples of each port, except stamps and long sequences."""
    found: list[str] = []
    for name in reader.ports if ports is None else ports:
        few = islice(reader.samples(start=start, end=end, ports=[name]), _LOOKED)
        found += dict.fromkeys(path for sample in few for path in _numeric(values_of(sample), name))
    return found


def _numeric(value: Any, path: str, *, top: bool = True) -> Iterator[str]:
    if isinstance(value, dict):
        for name, one in value.items():
            if not (top and name in _STAMPS):
                yield from _numeric(one, f"{path}.{name}", top=False)
        return
    if hasattr(value, "dtype"):
        value = value.tolist() if 0 < value.size <= _MOST else []
    items = value if isinstance(value, list) else [value]
    if 0 < len(items) <= _MOST and all(isinstance(one, int | float) for one in items) and any(x == x for x in items):
        yield path


def _found(reader: Recording, name: str, start: int | None, end: int | None) -> _Field:
    """The field of this name; ConfigurationError with the fields that could be meant, where it is not there."""
    try:
        return _find(reader, name)
    except ConfigurationError as error:
        port = max((one for one in reader.ports if name.startswith((f"{one}.", f"{one}["))), key=len, default="")
        paths = numeric_fields(reader, start, end, [port]) if port else []
        if not paths:
            raise
        last = f".{name.rpartition('.')[2]}"
        near = [path for path in paths if path.endswith(last)] or paths
        more = ", ..." if near[_MOST:] else ""
        raise ConfigurationError(f"{error}; numbers are in {', '.join(near[:_MOST])}{more}") from None


def _find(reader: Recording, name: str) -> _Field:
    for port in sorted(reader.ports, key=len, reverse=True):
        if name == port:
            bare = reader.ports[port].unknown or not hasattr(reader.ports[port].type, "__dataclass_fields__")
            return _Field(reader.ports[port], port, "" if bare else "data")
        if name.startswith((f"{port}.", f"{port}[")):
            return _Field(reader.ports[port], port, name[len(port) :].removeprefix("."))
    there = ", ".join(list(reader.ports)[:20]) or "none"
    raise ConfigurationError(f"{reader.path}: no port for {name[:60]!r}; write PORT.FIELD; ports: {there}")
