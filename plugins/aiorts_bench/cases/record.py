"""`aiorts bench record`: the cost of building a checked record, next to classes without checks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import repeat
from time import perf_counter_ns
from typing import Any, Final, NamedTuple

import numpy as np

from aiorts.types import Point3D, TimedDouble, TimedDoubleSeq, record
from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, RATE, Aim, Case, Reading
from aiorts_bench.harness.report import Report


@dataclass(slots=True)
class Slotted:
    """A plain dataclass."""

    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True)
class Frozen:
    """A frozen dataclass."""

    x: float
    y: float
    z: float


class Named(NamedTuple):
    """A named tuple."""

    x: float
    y: float
    z: float


@record
class Own:
    """A record that a user declares."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


_LIST: Final = [0.5, 1.5, -2.5, 3.25, 4.0, 5.0]
_ARRAY: Final = np.array(_LIST)


def _tuple() -> Callable[[], Any]:
    x = 1.0
    return lambda: (x, 2.0, 3.0)


_BASES: Final = ("slotted dataclass", "frozen dataclass")
_MAKERS: Final[tuple[tuple[str, str, Callable[[], Any], tuple[str, ...]], ...]] = (
    ("tuple", "a tuple of three floats", _tuple(), ()),
    ("NamedTuple", "of three floats", lambda: Named(1.0, 2.0, 3.0), ()),
    ("slotted dataclass", "of three floats, mutable, nothing checked", lambda: Slotted(1.0, 2.0, 3.0), ()),
    ("frozen dataclass", "of three floats, nothing checked", lambda: Frozen(1.0, 2.0, 3.0), ()),
    ("array of a list", "numpy.array of six floats", lambda: np.array(_LIST), ()),
    ("array copy", "a copy of an array of six doubles", lambda: _ARRAY.copy(), ()),
    ("Point3D", "three floats, checked, frozen", lambda: Point3D(1.0, 2.0, 3.0), _BASES),
    ("@record", "the same, declared by a user", lambda: Own(1.0, 2.0, 3.0), _BASES),
    ("TimedDouble", "a time and a float, checked, frozen", lambda: TimedDouble(1, 1.0), _BASES),
    ("TimedDoubleSeq, list", "a time and six floats of a list", lambda: TimedDoubleSeq(1, _LIST), ("array of a list",)),
    ("TimedDoubleSeq, array", "a time and an array", lambda: TimedDoubleSeq(1, _ARRAY.copy()), ("array copy",)),
)


def _case(name: str, what: str, make: Callable[[], Any], bases: tuple[str, ...]) -> Case:
    def run(count: int) -> Reading:
        began = perf_counter_ns()
        for _ in repeat(None, count):
            make()
        return Reading.timed(count, perf_counter_ns() - began)

    return Case(name, what, COST, run, 20_000, tuple(Aim(base) for base in bases), columns=(RATE,))


CASES: Final = tuple(_case(*maker) for maker in _MAKERS)
"""The cases, baselines first; each cost includes one call of a lambda."""


def report(options: Options) -> Report:
    """Measure every maker of records."""
    return options.simple("record", CASES, how="Cost is one object built, the call of a lambda included in all rows.")


BENCH: Final = Bench(
    "record",
    "Records built: checked and frozen, beside dataclasses and tuples that check nothing.",
    report,
    quick_rounds=9,
    rounds=21,
    full_scale=5.0,
    loops=False,
)
