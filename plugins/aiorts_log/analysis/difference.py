"""Compares two recordings port by port: samples missing, extra or changed, and how their times differ.

Both are read once, side by side; the samples that wait for a partner are bounded. Samples are partners when their log
times are within a tolerance ("time"), when their own stamps are ("tm"), or by their number in the port ("order").
With "tm", and where "log_time" is ignored, only values are compared: two runs never have the same log times.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any, Final, Literal, TypeAlias

from aiorts.errors import AiortsError, ConfigurationError
from aiorts.progress import Step, progress
from aiorts.types import to_plain
from aiorts.wire import MsgpackCodec
from aiorts_log.analysis.values import values_of
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.mcap.reader import RecordedPort, RecordedSample, Recording, counted, not_closed

By: TypeAlias = Literal["time", "tm", "order"]
LOG_TIME: Final = "log_time"
"""The name, among the ignored fields, of the log time, which is no field of the record."""
_MOST_PLACES: Final = 10
_WAITING: Final = 64 * 2**20
_SMALL: Final = 256
_LATEST: Final = 2**64


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffOptions:
    """The rules by which samples count as equal.

    Attributes:
        by: what makes samples partners; None is "time", or "order" where log times are ignored.
        time_tolerance: ns by which times of partners may differ; None is 0, and with "tm" allows any log time.
        absolute, relative: tolerances of numbers: |a - b| <= max(absolute, relative * max(|a|, |b|)).
        ignored: fields that are not compared, such as "tm"; "log_time" is the log time.
        from_start: take times from the first sample of each recording.
    """

    by: By | None = None
    time_tolerance: int | None = None
    absolute: float = 0.0
    relative: float = 0.0
    ignored: frozenset[str] = frozenset()
    from_start: bool = False

    def __post_init__(self) -> None:
        if self.by == "time" and LOG_TIME in self.ignored:
            raise ConfigurationError('partners by log time, which is ignored; choose by "tm" or "order"')

    @property
    def partners_by(self) -> By:
        """The rule that makes samples partners."""
        return self.by or ("order" if LOG_TIME in self.ignored else "time")

    @property
    def tolerance(self) -> int:
        """ns by which times may differ."""
        return self.time_tolerance or 0

    @property
    def compares_log_times(self) -> bool:
        """Whether different log times of partners are a difference."""
        return LOG_TIME not in self.ignored and (self.by != "tm" or self.time_tolerance is not None)


@dataclass(slots=True)
class PortDifference:
    """One port in both recordings; times in ns from the start of the first.

    Attributes:
        left, right: number of samples in each.
        missing, extra: samples only in the first, only in the second; changed: partners with other values.
        late: partners whose log times, where they are compared, differ by more than the tolerance.
        furthest, mean: difference of the log times of partners, in ns; 0 where they are ignored.
        types: both types when they differ; nothing is compared then.
        places: the first differences: time, kind, and for a change the field and both values.
    """

    name: str
    left: int = 0
    right: int = 0
    missing: int = 0
    extra: int = 0
    changed: int = 0
    late: int = 0
    partners: int = 0
    furthest: int = 0
    total: int = 0
    types: tuple[str, str] | None = None
    places: list[tuple[int, str, str]] = field(default_factory=list)

    @property
    def equal(self) -> bool:
        """Whether there is no difference."""
        return not (self.missing or self.extra or self.changed or self.late or self.types)

    @property
    def mean(self) -> float:
        """Mean absolute difference of the log times of partners, in ns."""
        return self.total / self.partners if self.partners else 0.0

    def note(self, time: int, what: str, detail: str = "") -> None:
        """Keep a difference, if it is one of the first."""
        if len(self.places) < _MOST_PLACES:
            self.places.append((time, what, detail))


@dataclass(frozen=True, slots=True)
class Difference:
    """The differences of two recordings.

    Attributes:
        ports: the ports in both; only_left, only_right: by name, the number of samples of ports in one alone.
        not_closed: the recordings that were not closed, with the number of unusable bytes at the end of each.
    """

    ports: tuple[PortDifference, ...]
    only_left: dict[str, int]
    only_right: dict[str, int]
    not_closed: tuple[tuple[str, int], ...] = ()

    @property
    def equal(self) -> bool:
        """Whether there is no difference; a recording with a torn end equals no other, since its end is not known."""
        return self.equal_so_far and not any(length for _, length in self.not_closed)

    @property
    def equal_so_far(self) -> bool:
        """Whether there is no difference in what can be read."""
        return not (self.only_left or self.only_right) and all(port.equal for port in self.ports)

    @property
    def apart(self) -> bool:
        """Whether almost no sample has a partner in the other recording: one in ten at most."""
        partners = sum(port.partners for port in self.ports)
        samples = [sum(port.missing for port in self.ports), sum(port.extra for port in self.ports)]
        return min(samples) >= 9 * max(1, partners)


def difference(
    left: Recording, right: Recording, options: DiffOptions | None = None, ports: Collection[str] | None = None
) -> Difference:
    """Compare two open recordings.

    Args:
        ports: the ports to compare; None is all of both.

    Raises:
        RecordingError: partners are too far apart to be held, or a port is in neither.
        DamagedError: one of them is damaged.
    """
    names = [name for name in dict.fromkeys([*left.ports, *right.ports]) if ports is None or name in ports]
    if ports is not None and (absent := [name for name in ports if name not in names]):
        raise RecordingError(f"no port {absent[0][:60]!r} in {left.path} or {right.path}; there are {', '.join(names)}")
    both = [name for name in names if name in left.ports and name in right.ports]
    pairs = [_Pair(left.ports[name], right.ports[name], name, options or DiffOptions()) for name in both]
    total = sum(port.count for pair in pairs for port in pair.sides)
    with progress("comparing", total) as step:
        found = _Walk(left, right, pairs, options or DiffOptions()).run(step)
    return Difference(
        found,
        _only(left, right, names),
        _only(right, left, names),
        tuple(not_closed([left, right])),
    )


def _only(one: Recording, other: Recording, names: Collection[str]) -> dict[str, int]:
    """The number of samples of each port that the other recording lacks; most formats name no port without samples."""
    there = [name for name in names if name in one.ports and name not in other.ports]
    return {name: one.ports[name].count for name in there if one.ports[name].count}


class _Pair:
    """A port of both recordings, and the samples that wait for a partner."""

    def __init__(self, left: RecordedPort, right: RecordedPort, name: str, options: DiffOptions) -> None:
        self.found = PortDifference(name)
        self.sides = left, right
        self.waiting: tuple[deque[Any], deque[Any]] = (deque(), deque())
        self._options = options
        self._same_bytes = left.encoding == right.encoding and left.schema == right.schema
        self._packed = None if left.unknown or right.unknown else _packed
        if left.type_name != right.type_name:
            self.found.types = left.type_name, right.type_name

    def compare(self, one: tuple[int, RecordedSample], other: tuple[int, RecordedSample]) -> None:
        """Compare two partners."""
        found, options = self.found, self._options
        apart = abs(one[0] - other[0])
        found.partners += 1
        if LOG_TIME not in options.ignored:
            found.total += apart
            found.furthest = max(found.furthest, apart)
        if options.compares_log_times and apart > options.tolerance:
            found.late += 1
            found.note(one[0], "late", f"{(other[0] - one[0]) / 1e6:+.6g} ms")
        if self._same_bytes and one[1].data == other[1].data:
            return
        if self._packed is not None and self._packed(one[1]) == self._packed(other[1]):
            return
        change = first_change(values_of(one[1]), values_of(other[1]), options)
        if change is not None:
            found.changed += 1
            found.note(one[0], "changed", change)


_encode: Final = MsgpackCodec().encode


def _packed(sample: RecordedSample) -> bytes:
    """The encoded record, to compare every bit: half the work of a comparison field by field."""
    if sample.port.encoding == "msgpack":
        return sample.data
    try:
        return _encode(sample.port.decode(sample.data))
    except AiortsError as error:
        raise DamagedError(f"port {sample.port.name!r}, sample {sample.sequence}: {error}") from None


class _Walk:
    """One pass through both recordings, side by side."""

    def __init__(self, left: Recording, right: Recording, pairs: list[_Pair], options: DiffOptions) -> None:
        self._options = options
        self._pairs = pairs
        self._by_port = [{id(pair.sides[side]): pair for pair in pairs} for side in (0, 1)]
        names = [pair.found.name for pair in pairs]
        self._streams = [self._timed(side, reader, names) for side, reader in enumerate((left, right))]
        self._held = 0

    def _timed(self, side: int, reader: Recording, names: list[str]) -> Iterator[tuple[int, int, RecordedSample]]:
        zero = reader.start if self._options.from_start else 0
        for sample in reader.samples(ports=names):
            yield sample.log_time - zero, side, sample

    def run(self, step: Step) -> tuple[PortDifference, ...]:
        """Compare everything."""
        for time, side, sample in counted(heapq.merge(*self._streams, key=itemgetter(0)), step):
            self._take(time, side, sample)
        for pair in self._pairs:
            self._resolve(pair, _LATEST)
        return tuple(pair.found for pair in self._pairs)

    def _take(self, time: int, side: int, sample: RecordedSample) -> None:
        pair = self._by_port[side][id(sample.port)]
        found = pair.found
        if side:
            found.right += 1
        else:
            found.left += 1
        if found.types is not None:
            return
        pair.waiting[side].append((time, sample))
        self._held += len(sample.data) + _SMALL
        self._resolve(pair, time)
        if self._held > _WAITING:
            for other in self._pairs:
                self._resolve(other, time)
            if self._held > _WAITING:
                raise RecordingError(
                    f"port {found.name!r}: partners lie more than {_WAITING >> 20} MiB of samples apart; "
                    "--from-start, another --by, or --port"
                )

    def _resolve(self, pair: _Pair, now: int) -> None:
        """Compare the waiting partners; a sample that can get no partner any more is missing or extra."""
        left, right = pair.waiting
        by, tolerance = self._options.partners_by, self._options.tolerance
        while left and right:
            if by == "order":
                pair.compare(self._pop(left), self._pop(right))
                continue
            first, second = _key(left[0], by), _key(right[0], by)
            if abs(first - second) <= tolerance:
                pair.compare(self._pop(left), self._pop(right))
            else:
                self._alone(pair, 0 if first < second else 1)
        for side, queue in enumerate(pair.waiting):
            while queue and (now == _LATEST or (by == "time" and queue[0][0] + tolerance < now)):
                self._alone(pair, side)

    def _alone(self, pair: _Pair, side: int) -> None:
        time, _ = self._pop(pair.waiting[side])
        if side:
            pair.found.extra += 1
        else:
            pair.found.missing += 1
        pair.found.note(time, "extra" if side else "missing")

    def _pop(self, queue: deque[Any]) -> Any:
        head = queue.popleft()
        self._held -= len(head[1].data) + _SMALL
        return head


def _key(head: tuple[int, RecordedSample], by: By) -> int:
    return head[0] if by == "time" else head[1].publish_time


def first_change(left: Any, right: Any, options: DiffOptions, path: str = "") -> str | None:
    """The first difference of two pieces of plain data, or arrays in them, as "field: a -> b"; None for none."""
    if path in options.ignored:
        return None
    if hasattr(left, "dtype") and hasattr(right, "dtype"):
        return _array_change(left, right, options, path or "value")
    left, right = _listed(left), _listed(right)
    if isinstance(left, dict) and isinstance(right, dict):
        if left.keys() != right.keys():
            return f"{path or 'record'}: other fields"
        front = f"{path}." if path else ""
        found = (first_change(left[key], right[key], options, f"{front}{key}") for key in left)
        return next((change for change in found if change is not None), None)
    if isinstance(left, list) and isinstance(right, list):
        if len(left) != len(right):
            return f"{path}: {len(left)} items -> {len(right)}"
        items = (first_change(a, b, options, f"{path}[{i}]") for i, (a, b) in enumerate(zip(left, right, strict=True)))
        return next((change for change in items if change is not None), None)
    if _same(left, right, options):
        return None
    return f"{path or 'value'}: {_brief(left)} -> {_brief(right)}"


def _array_change(left: Any, right: Any, options: DiffOptions, path: str) -> str | None:
    import numpy as np  # late: most commands need none

    if left.dtype != right.dtype:
        return f"{path}: {left.dtype} -> {right.dtype}"
    if left.shape != right.shape:
        if left.ndim == right.ndim == 1:
            return f"{path}: {len(left)} items -> {len(right)}"
        return f"{path}: shape {left.shape} -> {right.shape}"
    kind = left.dtype.kind
    differs = left != right
    if kind == "f":
        differs |= np.signbit(left) != np.signbit(right)
    differs &= (left == left) | (right == right)  # a NaN equals a NaN
    if (options.absolute or options.relative) and (kind == "f" or (kind in "iu" and left.dtype.itemsize < 8)):
        a, b = left.astype("f8"), right.astype("f8")  # without loss: `_same` for most items at once
        with np.errstate(all="ignore"):
            most = np.maximum(options.absolute, options.relative * np.maximum(np.abs(a), np.abs(b)))
            differs &= ~((a != b) & np.isfinite(a - b) & (np.abs(a - b) <= most))
    for index in map(tuple, np.argwhere(differs)):
        place = f"{path}{''.join(f'[{one}]' for one in index)}"
        found = None if place in options.ignored else (_item(left[index].item()), _item(right[index].item()))
        if found is not None and not _same(*found, options):
            return f"{place}: {_brief(found[0])} -> {_brief(found[1])}"
    return None


def _listed(value: Any) -> Any:
    """An array as lists, to compare it with lists of the other recording."""
    if not hasattr(value, "dtype"):
        return value
    return [_listed(one) for one in value] if value.ndim else _item(value.item())


def _item(value: Any) -> Any:
    return to_plain(value) if isinstance(value, float) else value


def _same(left: Any, right: Any, options: DiffOptions) -> bool:
    if type(left) is type(right) and left == right:
        # 0.0 == -0.0, but they are different samples unless there is a tolerance.
        return (
            not isinstance(left, float) or bool(options.absolute) or math.copysign(1, left) == math.copysign(1, right)
        )
    numbers = all(isinstance(value, int | float | complex) and not isinstance(value, bool) for value in (left, right))
    if not numbers or not (options.absolute or options.relative):
        return False
    return bool(abs(left - right) <= max(options.absolute, options.relative * max(abs(left), abs(right))))


def _brief(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
