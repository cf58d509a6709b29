"""Which benches there are: aiorts' own in a table, others' as entry points of `aiorts.benches`; loaded when used."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Any, Final

import click

from aiorts.bench import machine
from aiorts.bench.case import Case
from aiorts.bench.report import Report, Row
from aiorts.bench.runner import Beside, choose_loops, measure
from aiorts.errors import PluginError
from aiorts.kernel.plugins import extensions, load_extension

__all__ = ("OWN", "Bench", "Options", "load", "names", "with_aims")

OWN: Final = {
    "push": ("aiorts.bench.push", "Throughput and latency of the push policies: flush, new, periodic."),
    "context": ("aiorts.bench.context", "How punctual each kind of execution context is."),
    "codec": ("aiorts.bench.codec", "Records to bytes and back."),
    "record": ("aiorts.bench.record", "Building, checking and converting records."),
    "log": ("aiorts.bench.log", "Recording: samples into a file, beside bare writers of the same."),
    "service": ("aiorts.bench.service", "Calls through service ports, beside coroutines and queues."),
    "scale": ("aiorts.bench.scale", "One to ten thousand components and connectors."),
    "startup": ("aiorts.bench.startup", "Importing aiorts, starting its command, a first system."),
}
"""Module and one line of help by name; each module has a `BENCH`."""


@dataclass(frozen=True, slots=True)
class Options:
    """What a user asked of a bench; every bench has the same, and `extra` holds its own.

    Attributes:
        rounds: medians are taken over them; `--quick` has fewer.
        scale: times the messages of a case; 1 is what `--quick` takes.
        loop: "asyncio", "uvloop", "both" or "auto", or "none" for a bench whose cases are plain functions.
        peers: whether other libraries that are installed are measured beside it.
        plot: whether figures are wanted.
        extra: the bench's own options by their names.
        progress: told the loop and number of each round; None is quiet.
        say: tells the user one line, such as how long it will take.
        command: the command line that repeats it.
        given: names of the options that the user gave himself.
        aimed: only cases that have an aim, and the baselines of those.
    """

    quick: bool = False
    loop: str = "both"
    rounds: int = 15
    scale: float = 3.0
    peers: bool = True
    plot: bool = False
    extra: Mapping[str, Any] = field(default_factory=dict)
    progress: Callable[[str, int], None] | None = None
    say: Callable[[str], None] | None = None
    command: str = ""
    given: frozenset[str] = frozenset()
    aimed: bool = False

    @property
    def loops(self) -> tuple[str, ...]:
        """The loops to measure on."""
        return ("none",) if self.loop == "none" else choose_loops(self.loop)

    def rows(self, cases: tuple[Case, ...], *, beside: Beside | None = None, loop: str = "") -> tuple[Row, ...]:
        """Measure `cases` as asked, on every loop asked for, or on `loop` alone."""
        if self.aimed and not (cases := with_aims(cases)):
            return ()
        return tuple(
            row
            for name in ((loop,) if loop else self.loops)
            for row in measure(
                cases, loop=name, rounds=self.rounds, scale=self.scale, progress=self.progress, beside=beside
            )
        )

    def report(self, bench: str, rows: tuple[Row, ...], described: Mapping[str, Any], **more: Any) -> Report:
        """The report of `rows`; `described` is `machine.describe()` from before the bench itself was the load."""
        return Report(bench, self.command, described, self.rounds, self.scale, rows, **more)

    def simple(self, bench: str, cases: tuple[Case, ...], **more: Any) -> Report:
        """All there is to do for a bench that is one table of cases."""
        described = machine.describe()
        return self.report(bench, self.rows(cases), described, **more)


def with_aims(cases: tuple[Case, ...]) -> tuple[Case, ...]:
    """The cases that have an aim, and the baselines of those."""
    needed = {case.name for case in cases if any(aim.factor is not None for aim in case.aims)}
    while more := {aim.baseline for case in cases if case.name in needed for aim in case.aims} - needed - {""}:
        needed |= more  # baselines of baselines: the ratios that are only shown are taken, too
    return tuple(case for case in cases if case.name in needed)


@dataclass(frozen=True, slots=True)
class Bench:
    """A bench as it is offered to the command.

    Attributes:
        help: what it measures, in one line or more.
        report: does it. May raise click.UsageError for options that make no sense together.
        options: click options of its own; their values come in `Options.extra`.
        quick_rounds: of `--quick`; `rounds` without it.
        full_scale: the scale without `--quick`, which has 1.
        loops: whether it runs on an event loop; without, `--loop` is refused and `Options.loop` is "none".
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
        """The values of its own options when none is given."""
        return dict(click.Command(self.name, params=list(self.options)).make_context(self.name, []).params)

    def asked(self, *, quick: bool = False, command: str = "", **changed: Any) -> Options:
        """This bench's defaults, its own options' among them; of `changed` what is not None."""
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


def names() -> dict[str, str]:
    """One line of help for each bench there is, without importing any."""
    found = {name: line for name, (_, line) in OWN.items()}
    for name, offers in extensions("benches").items():
        found.setdefault(name, f"Of {' and '.join(offer.source for offer in offers)}.")
    return found


def load(name: str) -> Bench:
    """The bench of that name; aiorts' own comes before one of the same name that somebody else offers.

    Raises:
        PluginError: nobody offers it (near names are given), it cannot be imported, or what is offered is no bench.
    """
    if name in OWN:
        try:
            found: Any = importlib.import_module(OWN[name][0]).BENCH
        except ImportError as error:
            raise PluginError(f"bench {name!r} cannot be loaded: {error}") from error
        return _checked(name, found)
    if name not in extensions("benches"):
        near = get_close_matches(name, names(), n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names())}"
        raise PluginError(f"no bench {name[:60]!r}; {hint}")
    return _checked(name, load_extension("benches", name))


def _checked(name: str, found: Any) -> Bench:
    if not isinstance(found, Bench):
        raise PluginError(f"bench {name!r}: expected an aiorts.bench.registry.Bench, got {type(found).__name__}")
    return found
