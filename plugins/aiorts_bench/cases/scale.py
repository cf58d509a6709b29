"""`aiorts bench scale`: one to ten thousand components, each size in a fresh process."""

from __future__ import annotations

import json
from functools import partial
from typing import Any, Final

from aiorts_bench.harness import child
from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import Aim, Case, Measure, Reading
from aiorts_bench.harness.report import Figure, Report, Row, Series

SIZES: Final = (1, 10, 100, 1000, 10_000)
QUICK_SIZES: Final = (1, 10, 100, 1000)
_MESSAGES: Final = 2000
_TIMEOUT_S: Final = 300.0

TOTAL: Final = Measure("total", "ms", digits=1)
"""Time to create, connect, start and stop."""
TRACED: Final = Measure("traced each", "B")
"""Memory of one component beyond the user's object, as tracemalloc counts it."""
RESIDENT: Final = Measure("resident each", "B")
"""Memory of one component beyond the user's object, as growth of the resident set."""
MESSAGE: Final = Measure("message", "ns")
"""Cost of a message to one of a hundred components, while all the others are idle."""
EVERY: Final = Measure("message, all", "ns")
"""Cost of a message to each component in turn: its data has left the processor's cache before its turn."""
_STEPS: Final = tuple(Measure(step, "ms", digits=1) for step in ("create", "connect", "start", "stop"))
_AIMS: Final = {10_000: (Aim("", factor=5000.0), Aim("", factor=6144.0, measure=TRACED))}


def _run(size: int, count: int) -> Reading:
    """Measure times and the resident set in one process, traced memory in another."""
    try:
        plain: dict[str, Any] = json.loads(_child(size, _MESSAGES * count))
        traced: dict[str, Any] = json.loads(_child(size, 1, "--trace"))
    except OSError as error:
        values = dict.fromkeys((TRACED.name, RESIDENT.name, MESSAGE.name, EVERY.name), 0.0)
        values[TOTAL.name] = _TIMEOUT_S * 1e3
        return Reading(values, faults=(str(error),))
    values = {step.name: plain[step.name] * 1e3 for step in (*_STEPS, TOTAL)}
    values |= {RESIDENT.name: plain["memory"], TRACED.name: traced["memory"]}
    values |= {measure.name: plain[measure.name] for measure in (MESSAGE, EVERY)}
    return Reading(values, size, faults=tuple(plain["faults"] + traced["faults"]))


def _child(size: int, messages: int, *words: str) -> str:
    return child.run(["-m", "aiorts_bench.cases.crowd", str(size), str(messages), *words], timeout=_TIMEOUT_S)


def cases(sizes: tuple[int, ...] = SIZES) -> tuple[Case, ...]:
    """A case for each size; the cost of a message is compared with that of the first size."""
    columns = (*_STEPS, TRACED, RESIDENT, MESSAGE, EVERY)
    return tuple(
        Case(
            f"{size:,}",
            "components with 2 ports, 1 connector and an event context each",
            TOTAL,
            partial(_run, size),
            1,
            (Aim(f"{sizes[0]:,}", measure=MESSAGE), *_AIMS.get(size, ())) if size != sizes[0] else (),
            columns=columns,
            warm=False,
        )
        for size in sizes
    )


def report(options: Options) -> Report:
    """Measure every size."""
    sizes = QUICK_SIZES if options.quick else SIZES
    rows = options.rows(cases(sizes))
    notes = ("--quick stops at 1,000 components",) if options.quick else ()
    how = (
        "Each size in a fresh process. Total is created + connected + started + stopped. Memory is what one component "
        "takes beyond an object of the user with as many attributes: as tracemalloc counts it (traced), and as the "
        "resident set grows (pages, so coarse for few). A message wakes an idle event context and is read there: "
        "one among at most a hundred components while the others are idle, or among all of them in turn."
    )
    return options.report("scale", rows, notes=notes, figures=_figures(rows), how=how)


def _figures(rows: tuple[Row, ...]) -> tuple[Figure, ...]:
    """Lines over the number of components."""
    lines = (
        ("Created, connected, started, stopped", TOTAL),
        ("One message", MESSAGE),
        ("One message, each component in turn", EVERY),
        ("Memory each", TRACED),
    )
    return tuple(
        Figure(title, "components", "", measure.name, measure.unit, (Series("aiorts", _points(rows, measure)),))
        for title, measure in lines
    )


def _points(rows: tuple[Row, ...], measure: Measure) -> tuple[tuple[float, float, float, float], ...]:
    spreads = [(float(row.case.name.replace(",", "")), row.figures[measure.name].spread) for row in rows]
    return tuple((size, spread.median, spread.min, spread.max) for size, spread in spreads)


BENCH: Final = Bench(
    "scale",
    "One to ten thousand components and connectors: creation, memory, messages, start and stop.",
    report,
    quick_rounds=3,
    rounds=5,
    loops=False,
)
