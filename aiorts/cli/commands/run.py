"""`aiorts run`: runs a system file, or one component, until it ends; the exit status is its result."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from aiorts import Kernel, exits
from aiorts.cli.console.choices_option import choices_options
from aiorts.cli.console.completion import targets
from aiorts.cli.console.output import say_json
from aiorts.cli.runtime.alone import DEFAULT_RATE, input_is_given
from aiorts.cli.runtime.options import Options, checked, with_clock
from aiorts.cli.runtime.printing import Printing
from aiorts.cli.runtime.service_options import RunCommand, chosen
from aiorts.cli.runtime.session import Run, execute, log_of, prepared, refuse
from aiorts.cli.runtime.stopping import Stopper
from aiorts.cli.runtime.summary import Summary
from aiorts.cli.runtime.target import errors_of, find_target
from aiorts.cli.runtime.watching import WINDOW, Watch
from aiorts.errors import AiortsError, ComponentError
from aiorts.system import Choices


@click.command(cls=RunCommand, short_help="Run a system file, or one component.")
@click.argument("target", metavar="SYSTEM.toml|FILE.py:Class", shell_complete=targets)
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="COMPONENT.PARAM=VALUE",
    help="Set a parameter, or with active=NAME the configuration set that is active; repeatable.",
)
@choices_options
@click.option("--for", "duration", type=float, metavar="S", help="End after S seconds of the system's time.")
@click.option("--duration", "duration_once", type=float, hidden=True)
@click.option(
    "--rate", type=float, metavar="HZ", help=f"Rate of a component alone; {DEFAULT_RATE:g} when it has no in-port."
)
@click.option("--count", type=click.IntRange(min=1), metavar="N", help="End a component alone after N samples.")
@click.option("--speed", type=float, metavar="X", help="Run X times as fast as real time.")
@click.option("--simulate", is_flag=True, help="Run in virtual time: exact, and as fast as possible.")
@click.option("--watch", is_flag=True, help="Apply what is changed in the files of the system while it runs.")
@click.option(
    "--window",
    type=click.FloatRange(min=0.0),
    metavar="S",
    help=f"With --watch: S seconds after a change it must not do worse, {WINDOW:g} by default; 0 does not measure.",
)
@click.option("--lenient", is_flag=True, help="A component that ended in error makes the exit status no worse.")
@click.option("--loop", type=click.Choice(["auto", "uvloop", "asyncio"]), default="auto", help="The event loop.")
@click.option("--log-level", default="", metavar="LEVELS", help="Levels of the log, such as warning,pid0=debug.")
@click.option("--log-file", type=Path, metavar="PATH", help="Append the log to a file.")
@click.option("--log-format", type=click.Choice(["text", "json"]), default="text", help="json: an object in a line.")
@click.option(
    "--print",
    "printed",
    multiple=True,
    metavar="PORT",
    help="Print the samples of these out-ports, COMPONENT.PORT with * and ?, as JSON lines; repeatable.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="At the end one JSON document: status, errors, profile. Samples and prints do not go to standard output.",
)
@click.option("-q", "--quiet", is_flag=True, help="Do not print the samples of a component alone.")
@click.option("--no-status", is_flag=True, help="No status line on the terminal.")
@click.option("-v", "--verbose", is_flag=True, help="Short for --log-level info.")
@click.option(
    "--debug",
    is_flag=True,
    help="Show tracebacks, open a debugger where a component failed, check every port call (slow).",
)
def run(
    target: str,
    changes: tuple[str, ...],
    choices: Choices,
    rate: float | None,
    count: int | None,
    duration_once: float | None,
    printed: tuple[str, ...],
    as_json: bool,
    quiet: bool,
    no_status: bool,
    watch: bool,
    window: float | None,
    **given: Any,
) -> int:
    """Run a system file, or one component alone.

    A component is FILE.py:Class, package.module:Class, or the name of an installed one. `aiorts help run-system` says
    what is read and printed, when it ends, and with which status.
    """
    if window is not None and not watch:
        raise click.UsageError("--window is for --watch")
    if given["duration"] is None:
        given["duration"] = duration_once
    if as_json and printed:
        raise click.UsageError("--print goes not with --json, whose document has standard output for itself")
    services = chosen(given)
    options = checked(Options(**given, status=not no_status, post_mortem=True))
    stopper = Stopper()
    summary = Summary() if as_json else None
    with stopper.signals(), log_of(options, stopper) as log, _alone_there(summary) as say:
        try:
            fed = not options.simulate and input_is_given()
            quiet = quiet or sys.stdout is None or as_json
            found = find_target(target, changes, rate, services, choices, quiet=quiet, fed=fed, count=count)
        except AiortsError as error:
            if summary is not None:
                summary.refused(error)
            status = exits.FAILED if isinstance(error, ComponentError) else exits.REFUSED
            return say(refuse(log, error, errors_of(target, changes, choices), status))
        log.levels.check(found.names)
        options = with_clock(options, found.clock)
        if watch and options.simulate:
            raise click.UsageError("--watch: no file can change while virtual time passes; leave --simulate out")
        if (found.streams or printed) and sys.stdout is not None and sys.stdout.isatty():
            options = replace(options, status=False)  # the samples are printed there, and would break the line
        if log.levels.default <= logging.WARNING:
            for text in found.doubts:
                log.tell("W-OPTION", text, level="warning")
        watched = None
        if watch:
            if found.plan is None or found.read is None:
                raise click.UsageError("--watch is for a system file; `aiorts reload` replaces the code of a component")
            wrong = partial(errors_of, target, changes, choices, running=True)
            watched = Watch(found.plan, found.read, wrong, WINDOW if window is None else window)
        ends = found.ends
        if ends is not None:
            stopper.last_words.append(ends.report_rest)
        steps: list[Callable[[Kernel], None]] = [] if summary is None else [summary.prepare]
        if printed:
            steps.append(partial(Printing.prepare, printed))
        whole = Run(
            prepared(found.make, *steps),
            len(found.names),
            options,
            stopper,
            log,
            catalogue=found.catalogue,
            unfed_advice=found.unfed,
            streams=found.streams,
            errors=lambda: errors_of(target, changes, choices),
            watch=watched,
            refused=lambda error: None if summary is None else summary.refused(error),
        )
        status = execute(whole)
        if ends is not None:
            ends.report_rest()
            status = status or (exits.FAILED if ends.bad else exits.DONE)
        say(status)
        stopper.linger(status)
        return status


@contextlib.contextmanager
def _alone_there(summary: Summary | None) -> Iterator[Callable[[int], int]]:
    """Redirect standard output to standard error; yields a function that prints the document on standard output."""
    if summary is None:
        yield lambda status: status
        return

    def say(status: int) -> int:
        with contextlib.redirect_stdout(stream):
            say_json(summary.document(status))
        return status

    stream = sys.stdout
    with contextlib.redirect_stdout(sys.stderr):
        yield say
