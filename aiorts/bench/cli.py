"""The command `aiorts bench`: a click group that `aiorts` loads when it is asked for."""

from __future__ import annotations

import json
import sys

import click

from aiorts.bench import machine, printer
from aiorts.bench.push import CASES
from aiorts.bench.report import Report
from aiorts.bench.runner import choose_loops, measure

__all__ = ("bench", "report_push")

_QUICK_ROUNDS = 7
_ROUNDS = 15
_SCALE = 3.0
"""Messages of the full bench for each one of the quick bench."""


@click.group()
def bench() -> None:
    """Measure what aiorts costs, beside bare baselines of the same run."""


def report_push(
    *, quick: bool, loop: str = "both", rounds: int | None = None, scale: float | None = None, progress: bool = False
) -> Report:
    """Run the bench of push policies."""
    rounds = (_QUICK_ROUNDS if quick else _ROUNDS) if rounds is None else rounds
    scale = (1.0 if quick else _SCALE) if scale is None else scale
    described = machine.describe()  # before the bench itself is the load
    rows = [
        row
        for name in choose_loops(loop)
        for row in measure(CASES, loop=name, rounds=rounds, scale=scale, progress=_say if progress else None)
    ]
    words = ["aiorts bench push", *(["--quick"] if quick else []), f"--loop {loop} --rounds {rounds} --scale {scale:g}"]
    return Report("push", " ".join(words), described, rounds, scale, tuple(rows))


def _say(loop: str, number: int) -> None:
    click.echo(f"\r{loop}: round {number + 1} ", nl=False, err=True)


@bench.command()
@click.option("--quick", is_flag=True, help="Below 30 seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
@click.option("--markdown", "as_markdown", is_flag=True, help="The table as markdown.")
@click.option("--loop", type=click.Choice(["auto", "both", "asyncio", "uvloop"]), default="both", show_default=True)
@click.option("--rounds", type=click.IntRange(min=1), help="Rounds; medians are taken over them.")
@click.option("--scale", type=click.FloatRange(min=0, min_open=True), help="Times the messages of the quick bench.")
def push(quick: bool, as_json: bool, as_markdown: bool, loop: str, rounds: int | None, scale: float | None) -> None:
    """Throughput and latency of the push policies: flush, new and periodic.

    Exit status 1 when a ledger does not balance or a message that may not be lost was lost; a ratio that is not on
    course is shown and changes nothing.
    """
    if as_json and as_markdown:
        raise click.UsageError("--json and --markdown exclude each other")
    watched = sys.stderr.isatty()
    try:
        report = report_push(quick=quick, loop=loop, rounds=rounds, scale=scale, progress=watched)
    except ImportError as error:
        raise click.ClickException(f"--loop {loop}: {error}; install uvloop or choose --loop asyncio") from error
    if watched:
        click.echo("\r", nl=False, err=True)
    if as_json:
        click.echo(json.dumps(report.plain(), indent=1, allow_nan=False))
    else:
        click.echo(printer.markdown(report) if as_markdown else printer.table(report))
    if report.faults:
        sys.exit(1)
