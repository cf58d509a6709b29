"""Defines a bench and the options of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import click

from aiorts_bench.harness.case import Case
from aiorts_bench.harness.machine import describe
from aiorts_bench.harness.report import Report, Row
from aiorts_bench.harness.runner import Beside, Progress, choose_loops, measure


@dataclass(frozen=True, slots=True)
class Options:
    """The options of one run. Every bench has these; `extra` holds the values of its own options.

    Attributes:
        rounds: their number; medians are taken over them, and `--quick` has fewer.
        scale: a factor for the messages of a case; `--quick` takes 1.
        loop: "asyncio", "uvloop", "both" or "auto", or "none" for a bench whose cases are plain functions.
        peers: whether other libraries that are installed are measured, too.
        plot: whether figures are wanted.
        extra: the bench's own options by their names.
        progress: shows what is done and what is left, such as `aiorts.progress.progress`; None is quiet.
        notify: shows the user one line, such as how long the run will take.
        command: the command line that repeats the run.
        given: names of the options that were given, not taken from the defaults.
        aimed: measure only the cases that have an aim, and their baselines.
        machine: a description of the machine, made before the bench puts a load on it.
    """

    quick: bool = False
    loop: str = "both"
    rounds: int = 15
    scale: float = 3.0
    peers: bool = True
    plot: bool = False
    extra: Mapping[str, Any] = field(default_factory=dict)
    progress: Progress | None = None
    notify: Callable[[str], None] | None = None
    command: str = ""
    given: frozenset[str] = frozenset()
    aimed: bool = False
    machine: Mapping[str, Any] = field(default_factory=describe)

    @property
    def loops(self) -> tuple[str, ...]:
        """The loops to measure on."""
        return ("none",) if self.loop == "none" else choose_loops(self.loop)

    def rows(self, cases: tuple[Case, ...], *, beside: Beside | None = None, loop: str = "") -> tuple[Row, ...]:
        """Measure `cases` on every loop of these options, or on `loop` alone."""
        if self.aimed and not (cases := with_aims(cases)):
            return ()
        return tuple(
            row
            for name in ((loop,) if loop else self.loops)
            for row in measure(
                cases, loop=name, rounds=self.rounds, scale=self.scale, progress=self.progress, beside=beside
            )
        )

    def report(self, bench: str, rows: tuple[Row, ...], **more: Any) -> Report:
        """The report of `rows`."""
        return Report(bench, self.command, self.machine, self.rounds, self.scale, rows, **more)

    def simple(self, bench: str, cases: tuple[Case, ...], **more: Any) -> Report:
        """Measure and report a bench that is one table of cases."""
        return self.report(bench, self.rows(cases), **more)


def with_aims(cases: tuple[Case, ...]) -> tuple[Case, ...]:
    """The cases that have an aim, and their baselines."""
    needed = {case.name for case in cases if any(aim.factor is not None for aim in case.aims)}
    while more := {aim.baseline for case in cases if case.name in needed for aim in case.aims} - needed - {""}:
        needed |= more  # baselines of baselines: ratios without an aim are taken, too
    return tuple(case for case in cases if case.name in needed)


@dataclass(frozen=True, slots=True)
class Bench:
    """A bench, as a package offers it to `aiorts bench`.

    Attributes:
        help: what it measures, in one line or more.
        report: runs it. May raise click.UsageError for options that make no sense together.
        options: click options of its own; their values come in `Options.extra`.
        quick_rounds: rounds with `--quick`; `rounds` without it.
        full_scale: the scale without `--quick`, which has 1.
        loops: whether it runs on an event loop; if not, `--loop` is refused and `Options.loop` is "none".
    """

    name: str
    help: str
    report: Callable[[Options], Report]
    options: tuple[click.Option, ...] = ()
    quick_rounds: int = 7
    rounds: int = 15
    full_scale: float = 3.0
    loops: bool = True

    def defaults(self) -> dict[str, Any]:
        """The default values of its own options."""
        return dict(click.Command(self.name, params=list(self.options)).make_context(self.name, []).params)

    def requested(self, *, quick: bool = False, command: str = "", **changed: Any) -> Options:
        """The options of a run: this bench's defaults, replaced by the values of `changed` that are not None."""
        options = Options(
            quick=quick,
            loop="both" if self.loops else "none",
            rounds=self.quick_rounds if quick else self.rounds,
            scale=1.0 if quick else self.full_scale,
            extra=self.defaults(),
            command=command or f"aiorts bench {self.name}{' --quick' if quick else ''}",
        )
        given = {name: value for name, value in changed.items() if value is not None}
        extra = given.pop("extra", {})
        return replace(options, **given, extra={**options.extra, **extra}, given=frozenset((*given, *extra)))
