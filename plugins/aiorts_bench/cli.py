"""The command `aiorts bench`: one subcommand for each bench, with the common options and its own.

A bench is imported when its subcommand is called.
"""

from __future__ import annotations

import json
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import Any, Final

import click

from aiorts import exits
from aiorts.errors import PluginError
from aiorts.progress import progress
from aiorts_bench import registry
from aiorts_bench.harness import compare, plot, printer
from aiorts_bench.harness.bench import Bench
from aiorts_bench.harness.report import Report

_LOOPS: Final = ("auto", "both", "asyncio", "uvloop")
_OUT: Final = click.Path(dir_okay=False, writable=True, path_type=Path)


def _common(found: Bench) -> list[click.Parameter]:
    loop = (
        [click.Option(["--loop"], type=click.Choice(_LOOPS), help="Event loops. Default both.")] if found.loops else []
    )
    return [
        click.Option(["--quick"], is_flag=True, help="Do less: below 30 seconds."),
        click.Option(["--json", "as_json"], is_flag=True, help="One JSON document."),
        click.Option(["--markdown", "as_markdown"], is_flag=True, help="The table as markdown."),
        click.Option(["--plot"], type=_OUT, help="Draw it into FILE.html, which loads nothing, or FILE.png."),
        click.Option(
            ["--compare"],
            type=click.Path(exists=True, dir_okay=False, path_type=Path),
            help="Say what changed since this JSON document, beyond the spread.",
        ),
        click.Option(["--fail-on-change"], is_flag=True, help="Exit status 1 when --compare finds a change."),
        *loop,
        click.Option(
            ["--rounds"], type=click.IntRange(min=1, max=100_000), help="Rounds that the medians are taken over."
        ),
        click.Option(
            ["--scale"],
            type=click.FloatRange(0, 1e6, min_open=True),
            help="The work, as a multiple of that of --quick.",
        ),
        click.Option(["--peers/--no-peers"], default=True, help="Measure other libraries that are installed, too."),
        click.Option(["-o", "--output"], type=_OUT, help="Write there instead of to standard output."),
    ]


def command_of(found: Bench) -> click.Command:
    """The click command of a bench."""

    def run(**values: Any) -> None:
        _run(found, values)

    text = found.help if found.name != found.help else ""
    epilog = "Exit status 1 when a promise was broken, such as a ledger that does not balance; a missed aim is shown."
    return click.Command(found.name, params=[*found.options, *_common(found)], callback=run, help=text, epilog=epilog)


def _run(found: Bench, values: dict[str, Any]) -> None:
    if values["as_json"] and values["as_markdown"]:
        raise click.UsageError("--json and --markdown exclude each other")
    if values["fail_on_change"] and values["compare"] is None:
        raise click.UsageError("--fail-on-change needs --compare OLD.json")
    if values["plot"] is not None:
        plot.check(values["plot"])
    old = None if values["compare"] is None else compare.read(values["compare"])
    own = {str(option.name): values[str(option.name)] for option in found.options}
    options = found.requested(
        quick=values["quick"],
        command=_command(found, values, own),
        loop=values.get("loop"),
        rounds=values["rounds"],
        scale=values["scale"],
        peers=values["peers"],
        plot=values["plot"] is not None,
        progress=progress,
        notify=partial(click.echo, err=True),
        extra={name: value for name, value in own.items() if value is not None},
    )
    try:
        report = found.report(options)
    except ImportError as error:
        raise click.ClickException(f"{error}; install what is missing, or choose another --loop") from error
    _deliver(report, values, old)


def _deliver(report: Report, values: dict[str, Any], old: compare.Document | None) -> None:
    plain = report.plain()
    if values["as_json"]:
        text = json.dumps(plain, indent=1, allow_nan=False)
    else:
        text = printer.markdown(report) if values["as_markdown"] else printer.table(report)
    if values["plot"] is not None:
        plot.write(values["plot"], report)
    outcome = None if old is None else compare.compare(old, plain)
    if outcome is not None:
        lines = "\n".join(outcome.lines)
        if values["as_json"]:
            click.echo(lines, err=True)
        else:
            text += f"\n\n{lines}"
    _put(text, values["output"])
    if report.faults or (values["fail_on_change"] and outcome is not None and outcome.changes):
        sys.exit(exits.FAILED)


def _put(text: str, file: Path | None) -> None:
    if file is None:
        click.echo(text)
        return
    try:
        file.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise click.ClickException(f"{file}: {error.strerror or error}") from error


def _command(found: Bench, values: dict[str, Any], own: dict[str, Any]) -> str:
    """The command line that repeats the measurement, without the file of the result."""
    words = ["aiorts", "bench", found.name, *(["--quick"] if values["quick"] else [])]
    defaults = found.defaults()
    for option in found.options:
        value = own[str(option.name)]
        if option.is_flag:
            words += [option.opts[0]] if value else []
        elif value != defaults[str(option.name)]:
            words += [option.opts[0], str(value)]
    for name in ("loop", "rounds", "scale"):
        if values.get(name) is not None:
            words += [f"--{name}", f"{values[name]:g}" if name == "scale" else str(values[name])]
    return shlex.join(
        (*words, *([] if values["peers"] else ["--no-peers"]), *(["--plot", "FILE"] if values["plot"] else []))
    )


class _Benches(click.Group):
    """The benches by name. A bench that cannot be imported fails only when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(registry.names())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return command_of(registry.load(cmd_name))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except PluginError as error:
            raise click.UsageError(str(error), ctx) from error

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Benches"):
            formatter.write_dl(list(registry.names().items()))


@click.group(cls=_Benches)
def bench() -> None:
    """Measure what aiorts costs on this machine, beside bare baselines of the same run."""
