"""Applies FlexiFilter's map to samples; it never waits and knows no port of the kernel.

A `Mapping` is made once, and checks everything that can be checked without data. `apply` takes the samples of one round
(at most one for each in-port) and gives the samples to send, one for each out-port with a pin that got a new value. A
pin without new data keeps its last value, or goes back to `reset` where one is given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from collections.abc import Mapping as ReadOnlyMap
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Final

from aiorts.errors import ConfigurationError, ConversionError, RecordError
from aiorts.types import convert, describe, has_tm, with_tm
from aiorts_flexi.common.place import TypedTextError
from aiorts_flexi.common.ports import PortSpec
from aiorts_flexi.mapping.grammar import Entry, Number, parse_map, parse_number
from aiorts_flexi.mapping.pins import holder, reader, with_values

COMBINE: Final = ("", "sum", "min", "max", "newest")
NAN: Final = ("pass", "error")
_LARGEST: Final = math.nextafter(math.inf, 0.0)
_TEXT: Final = ("str", "char", "wchar")


@dataclass(frozen=True, slots=True)
class Rules:
    """The rules for making values.

    Attributes:
        rounding: from a fraction to an integer: "nearest" (halves to the even neighbour: 0.5 is 0, 1.5 and 2.5 are 2),
            "truncate" (toward zero) or "floor".
        overflow: "error", "saturate" or "wrap".
        reset: the value of pins without new data; "" keeps their last value.
        zero_old: set pins without new data to 0, False or the empty text; `reset` may give another value.
        clamp: (low, high) for numbers; () is none.
        nan: "pass", "error", or a number that replaces NaN.
        combine: the rule by which several entries to one pin make one value; "" allows one entry. "newest" is the
            value with the latest time, which is then the time of the pin.
        time: "oldest" or "newest" of the sources of a sample.
    """

    rounding: str = "nearest"
    overflow: str = "error"
    reset: str = ""
    clamp: tuple[float, ...] = ()
    nan: str = "pass"
    combine: str = ""
    time: str = "oldest"
    zero_old: bool = False

    def __post_init__(self) -> None:
        if len(self.clamp) not in (0, 2) or (self.clamp and not self.clamp[0] <= self.clamp[1]):
            raise ConfigurationError(f"clamp = {self.clamp}: expected two numbers, the lower one first")
        if self.reset and self.zero_old:
            raise ConfigurationError(f"reset = {self.reset!r} and zero_old exclude each other; give one of them")
        if self.nan not in NAN:
            parse_number(self.nan, 'nan, which is "pass", "error" or a number')


@dataclass(slots=True)
class _Route:
    """One entry of the map, with its pins looked up."""

    entry: Entry
    read: Callable[[Any], Any]
    """Reads the value at the entry's pin from a sample. RecordError when the value is missing."""
    kind: str
    timed: bool
    """Whether samples of the in-port have a time."""


@dataclass(slots=True)
class _Target:
    """One pin of an out-port: its entries, its value, and the time of the value."""

    pin: int | str
    kind: str
    routes: list[_Route]
    holds: Callable[[Any], bool]
    """Whether a value is of the pin's kind without conversion."""
    value: Any
    empty: Any
    tm: int | None = None
    valid: bool = False
    last: dict[int, tuple[Any, int | None]] = field(default_factory=dict)
    """The newest converted value of each route and its time, for `combine`."""


@dataclass(slots=True)
class _Output:
    spec: PortSpec
    targets: list[_Target]
    sources: frozenset[int]
    timed: bool
    base: Any = None
    """A record with the values of the fields that no entry sets."""
    headed: bool = False
    """Whether the record's header holds the time."""


class Mapping:
    """A map between these ports under these rules; it remembers the last value of each pin.

    Raises ConfigurationError for a port or pin that does not exist, two entries to one pin without `combine`, and a
    meaningless factor.
    """

    def __init__(self, inputs: Sequence[PortSpec], outputs: Sequence[PortSpec], text: str, rules: Rules) -> None:
        self.inputs = tuple(inputs)
        self._text = text
        self.entries = parse_map(text)
        self.rules = rules
        self._rounding = "round" if rules.rounding == "nearest" else rules.rounding
        self._passes_nan = rules.nan == "pass"
        self._nan = None if rules.nan in NAN else float(parse_number(rules.nan, "nan"))
        self._outputs = self._make_outputs(outputs)

    def clear(self) -> None:
        """Forget all values, as activation does."""
        for output in self._outputs:
            for target in output.targets:
                target.value, target.tm, target.valid = target.empty, None, False
                target.last.clear()

    def apply(self, samples: ReadOnlyMap[int, Any], now: int) -> list[tuple[str, Any]]:
        """Make the samples of one round from samples by the number of their in-port.

        `now`, in ns, stamps samples whose sources have no time.

        Raises:
            ConversionError: the value of an entry, which is named, cannot be converted; no sample of the round is sent.
        """
        if len(self.inputs) == 1:  # values that a bad sample leaves, the next sample replaces
            return self._apply(samples, now)
        before = [(each, each.value, each.tm, each.valid, dict(each.last)) for o in self._outputs for each in o.targets]
        try:
            return self._apply(samples, now)
        except ConversionError:
            for target, value, tm, valid, last in before:
                target.value, target.tm, target.valid, target.last = value, tm, valid, last
            raise

    def _apply(self, samples: ReadOnlyMap[int, Any], now: int) -> list[tuple[str, Any]]:
        made = []
        for output in self._outputs:
            if output.sources.isdisjoint(samples):
                continue
            for target in output.targets:
                self._update(target, samples)
            made.append((output.spec.name, self._build(output, now)))
        return made

    # -- values ----------------------------------------------------------------------------------------------------

    def _update(self, target: _Target, samples: ReadOnlyMap[int, Any]) -> None:
        if len(target.routes) == 1:
            route = target.routes[0]
            sample = samples.get(route.entry.source)
            if sample is not None:
                target.value = self._value(route, target, sample)
                target.tm, target.valid = int(sample.tm) if route.timed else None, True
                return
        fresh = False
        for number, route in enumerate(target.routes):
            sample = samples.get(route.entry.source)
            if sample is not None:
                target.last.pop(number, None)  # the newest one stands last
                target.last[number] = self._value(route, target, sample), int(sample.tm) if route.timed else None
                fresh = True
        if fresh:
            if self.rules.combine == "newest":
                target.value, target.tm = _newest(list(target.last.values()))
            else:
                target.value = self._combined(target)
                target.tm = self._chosen_time(tm for _, tm in target.last.values())
            target.valid = True
        elif self.rules.reset or self.rules.zero_old:
            target.value, target.tm, target.valid = target.empty, None, False

    def _value(self, route: _Route, target: _Target, sample: Any) -> Any:
        entry = route.entry
        try:
            value = route.read(sample)
        except RecordError as error:
            raise ConversionError(f"{entry}: {self.inputs[entry.source].name}: {error}") from None
        try:
            # A NaN may have been text, or infinity times zero: each step is followed by a check.
            return self._without_nan(self._fitted(self._limited(self._scaled(value, entry)), target))
        except ConversionError as error:
            raise ConversionError(f"{entry}: {error}") from None

    def _scaled(self, value: Any, entry: Entry) -> Any:
        value = self._without_nan(value)
        if entry.mult is None:
            return value
        number = self._without_nan(convert(value, "f64")) if isinstance(value, str) else value
        try:
            if isinstance(entry.mult, Fraction) or isinstance(entry.off, Fraction):
                result = _exactly(number, entry.mult, entry.off or 0)
            else:
                result = number * entry.mult + (entry.off or 0)
        except OverflowError:
            result = math.copysign(math.inf, number) * math.copysign(1.0, entry.mult)
        if isinstance(result, float) and math.isinf(result) and math.isfinite(number):
            return self._overflowed(result, f"{number!r} times the factor")
        return self._without_nan(result)

    def _fitted(self, value: Any, target: _Target) -> Any:
        if target.holds(value):
            return value
        return convert(value, target.kind, overflow=self.rules.overflow, rounding=self._rounding)

    def _overflowed(self, result: float, what: str) -> float:
        if self.rules.overflow == "error":
            raise ConversionError(f"{what} is too large for a number of 64 bits; see overflow")
        return math.copysign(_LARGEST, result) if self.rules.overflow == "saturate" else result

    def _without_nan(self, value: Any) -> Any:
        if self._passes_nan or not isinstance(value, float) or value == value:
            return value
        if self._nan is None:
            raise ConversionError("the value is NaN, and nan is error")
        return self._nan

    def _limited(self, value: Any) -> Any:
        if not self.rules.clamp or isinstance(value, str | bool):
            return value
        low, high = self.rules.clamp
        return low if value < low else min(value, high)

    def _combined(self, target: _Target) -> Any:
        values = [value for value, _ in target.last.values()]
        rule = self.rules.combine
        if len(values) == 1:
            return values[0]
        if rule != "sum":
            # NaN is neither less nor more than any number: the result is NaN, whichever entry gave it.
            unordered = [value for value in values if value != value]
            return unordered[0] if unordered else min(values) if rule == "min" else max(values)
        try:
            total = sum(values)
            if isinstance(total, float) and math.isinf(total) and all(map(math.isfinite, values)):
                total = self._overflowed(total, "it")
            return self._without_nan(self._fitted(total, target))
        except ConversionError as error:
            raise ConversionError(
                f"sum of {' and '.join(str(route.entry) for route in target.routes)}: {error}"
            ) from None

    # -- samples ---------------------------------------------------------------------------------------------------

    def _chosen_time(self, times: Iterable[int | None]) -> int | None:
        known = [tm for tm in times if tm is not None]
        if not known:
            return None
        return min(known) if self.rules.time == "oldest" else max(known)

    def _build(self, output: _Output, now: int) -> Any:
        spec, first = output.spec, output.targets[0]
        if len(output.targets) == 1 and first.valid:
            tm = first.tm
        else:
            tm = self._chosen_time(target.tm for target in output.targets if target.valid)
        stamp = now if tm is None else tm
        if spec.plain:
            return first.value
        if spec.shape == "scalar":
            return spec.type(stamp, first.value) if output.timed else spec.type(first.value)
        if spec.shape == "sequence":
            values: list[Any] = [self._empty(spec.element)] * spec.length
            for target in output.targets:
                values[int(target.pin)] = target.value
            return spec.type(stamp, values) if output.timed else spec.type(values)
        changes = {spec.pin_path(target.pin): target.value for target in output.targets}
        if output.headed:
            named = any(path.startswith("header.stamp.") for path in changes)
            tm = changes.pop("tm", None if named else stamp)
            made = with_values(output.base, changes)
            return made if tm is None else with_tm(made, tm)
        if output.timed and "tm" not in changes:
            changes["tm"] = stamp
        try:
            return with_values(output.base, changes)
        except RecordError as error:  # a value of the right kind that the field does not allow
            raise ConversionError(str(error)) from None

    def _empty(self, kind: str) -> Any:
        text = self.rules.reset
        if not text:
            return convert("" if kind == "str" else "\0" if kind in _TEXT else 0, kind)
        try:
            return convert(text, kind, overflow=self.rules.overflow, rounding=self._rounding)
        except ConversionError as error:
            raise ConfigurationError(f"reset = {text!r}: {error}") from None

    # -- construction ----------------------------------------------------------------------------------------------

    def _make_outputs(self, specs: Sequence[PortSpec]) -> list[_Output]:
        found: dict[int, dict[str, _Target]] = {}
        for entry in self.entries:
            try:
                route, kind, path = self._looked_up(entry, specs)
            except ConfigurationError as error:
                raise TypedTextError("map", self._text, entry.place, str(error), found=False) from None
            targets = found.setdefault(entry.target, {})
            target = targets.get(path)
            if target is None:
                special = specs[entry.target].special(entry.target_pin)
                empty = self._empty(kind) if special is None or self.rules.reset else special.zero()
                targets[path] = _Target(entry.target_pin, kind, [route], holder(kind), empty, empty)
            else:
                self._check_combine(target, route)
                target.routes.append(route)
        return [_output(specs[number], found[number]) for number in sorted(found)]

    def _looked_up(self, entry: Entry, specs: Sequence[PortSpec]) -> tuple[_Route, str, str]:
        """The entry with its source looked up, and kind and path of its target."""
        source, spec = _port(self.inputs, entry.source, "in-port"), _port(specs, entry.target, "out-port")
        path, kind = spec.pin_path(entry.target_pin), spec.kind(entry.target_pin)
        if "[" in path and spec.shape == "record":
            raise ConfigurationError(f"{entry}: an item of a sequence cannot be set; name a field without index")
        read = reader(source, entry.source_pin)
        route = _Route(entry, read, source.kind(entry.source_pin), has_tm(source.type))
        if entry.mult is not None and route.kind in ("char", "wchar"):
            raise ConfigurationError(f"{entry}: a character cannot be multiplied; leave the factor out")
        return route, kind, path

    def _check_combine(self, target: _Target, route: _Route) -> None:
        first, second = target.routes[0].entry, route.entry
        reason = ""
        if not self.rules.combine:
            reason = f"{first} and {second} feed one pin; take one away, or set combine (sum, min, ...)"
        elif self.rules.combine == "sum" and target.kind in _TEXT:
            reason = f"{first} and {second}: there is no sum of {target.kind}"
        if reason:
            raise TypedTextError("map", self._text, second.place, reason, found=False)


def _output(spec: PortSpec, targets: dict[str, _Target]) -> _Output:
    sources = frozenset(route.entry.source for target in targets.values() for route in target.routes)
    base = _base(spec) if spec.shape == "record" else None
    timed = has_tm(spec.type)
    return _Output(
        spec, list(targets.values()), sources, timed, base, timed and describe(spec.type).field("tm") is None
    )


def _base(spec: PortSpec) -> Any:
    try:
        return spec.type()
    except (TypeError, RecordError) as error:
        raise ConfigurationError(
            f"{spec.name}: {spec.type.__name__} needs a default for every field, so that the map may set some: {error}"
        ) from None


def _port(specs: Sequence[PortSpec], number: int, word: str) -> PortSpec:
    if number >= len(specs):
        names = ", ".join(spec.name for spec in specs[:20]) or "none"
        raise ConfigurationError(f"there is no {word} {number}; there are {names}")
    return specs[number]


def _exactly(number: float, mult: Number, off: Number) -> float:
    """The number times a factor, plus an offset, rounded once; an int stays an int where the result is whole."""
    if not math.isfinite(number):
        return number * float(mult) + float(off)
    exact = Fraction(number) * Fraction(mult) + Fraction(off)
    return exact.numerator if isinstance(number, int) and exact.denominator == 1 else float(exact)


def _newest(found: Sequence[tuple[Any, int | None]]) -> tuple[Any, int | None]:
    """Value and time of the latest entry; where times are equal or absent, of the entry that arrived last."""
    value, latest = found[0]
    for other, tm in found[1:]:
        if latest is None or tm is None or tm >= latest:
            value, latest = other, tm
    return value, latest
