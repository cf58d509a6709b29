"""`aiorts bench record`: what it costs to build a record that is checked, beside classes that check nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import repeat
from time import perf_counter_ns
from typing import Any, Final, NamedTuple

import numpy as np

from aiorts.bench.case import COST, RATE, Aim, Case, Reading
from aiorts.bench.registry import Bench, Options
from aiorts.bench.report import Report
from aiorts.types import Point3D, TimedDouble, TimedDoubleSeq, record

__all__ = ("BENCH", "CASES")


@dataclass(slots=True)
class Slotted:
    """As plain as a dataclass is."""

    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True)
class Frozen:
    """The same, frozen by the standard library."""

    x: float
    y: float
    z: float


class Named(NamedTuple):
    """The same as a tuple."""

    x: float
    y: float
    z: float


@record
class Own:
    """What a user declares."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


_LIST: Final = [0.5, 1.5, -2.5, 3.25, 4.0, 5.0]
_ARRAY: Final = np.array(_LIST)


def _tuple() -> Callable[[], Any]:
    x = 1.0
    return lambda: (x, 2.0, 3.0)


_MAKERS: Final[tuple[tuple[str, str, Callable[[], Any], tuple[str, ...]], ...]] = (
    ("tuple", "a tuple of three floats", _tuple(), ()),
    ("NamedTuple", "of three floats", lambda: Named(1.0, 2.0, 3.0), ()),
    ("slotted dataclass", "of three floats, mutable, nothing checked", lambda: Slotted(1.0, 2.0, 3.0), ()),
    ("frozen dataclass", "of three floats, nothing checked", lambda: Frozen(1.0, 2.0, 3.0), ()),
    ("array of a list", "numpy.array of six floats", lambda: np.array(_LIST), ()),
    ("array copy", "a copy of an array of six doubles", lambda: _ARRAY.copy(), ()),
    ("Point3D", "three floats, checked, frozen", lambda: Point3D(1.0, 2.0, 3.0), ("slotted", "frozen")),
    ("@record", "the same, declared by a user", lambda: Own(1.0, 2.0, 3.0), ("slotted", "frozen")),
    ("TimedDouble", "a time and a float, checked, frozen", lambda: TimedDouble(1, 1.0), ("slotted", "frozen")),
    ("TimedDoubleSeq, list", "a time and six floats of a list", lambda: TimedDoubleSeq(1, _LIST), ("array of a list",)),
    (
        "TimedDoubleSeq, array",
        "a time and an array taken over",
        lambda: TimedDoubleSeq(1, _ARRAY.copy()),
        ("array copy",),
    ),
)
_FULL: Final = {"slotted": "slotted dataclass", "frozen": "frozen dataclass"}


def _timed(make: Callable[[], Any], count: int) -> Reading:
    began = perf_counter_ns()
    for _ in repeat(None, count):
        make()
    return Reading.timed(count, perf_counter_ns() - began)


def _case(name: str, what: str, make: Callable[[], Any], bases: tuple[str, ...]) -> Case:
    aims = tuple(Aim(_FULL.get(base, base)) for base in bases)

    def run(count: int) -> Reading:
        return _timed(make, count)

    return Case(name, what, COST, run, 20_000, aims, columns=(RATE,))


CASES: Final = tuple(_case(*maker) for maker in _MAKERS)
"""Baselines first; each cost holds one call of a lambda."""


def report(options: Options) -> Report:
    """The bench."""
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
