"""`aiorts run`: a system file, or one component, run until it ends; the exit status tells how that went."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import click

from aiorts.cli.completion import targets
from aiorts.cli.options import Options, checked, with_clock
from aiorts.cli.session import execute, log_of
from aiorts.cli.stopping import Stopper
from aiorts.cli.target import DEFAULT_RATE, find_target
from aiorts.cli.watched import Watched
from aiorts.errors import AiortsError

__all__ = ("run",)


@click.command(short_help="Run a system file, or one component.")
@click.argument("target", metavar="SYSTEM.toml|MODULE:COMPONENT", shell_complete=targets)
@click.option("--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="Set a parameter; repeatable.")
@click.option("--for", "duration", type=float, metavar="S", help="End after S seconds of the system's time.")
@click.option("--duration", "duration_once", type=float, hidden=True)
@click.option(
    "--rate", type=float, metavar="HZ", help=f"Of a component alone; {DEFAULT_RATE:g} when it has no in-port."
)
@click.option("--speed", type=float, metavar="X", help="Run X times as fast as real time.")
@click.option("--simulate", is_flag=True, help="Run in virtual time: exact, and as fast as the machine can.")
@click.option("--strict", is_flag=True, help="Exit status 3 when a component ended in error.")
@click.option("--plugins", "folders", multiple=True, type=Path, metavar="DIR", help="A folder.")
@click.option("--loop", type=click.Choice(["auto", "uvloop", "asyncio"]), default="auto", help="The event loop.")
@click.option("--log-level", default="", metavar="LEVELS", help="Such as warning,pid0=debug.")
@click.option("--log-file", type=Path, metavar="PATH", help="Append the log to a file.")
@click.option("--log-format", type=click.Choice(["text", "json"]), default="text", help="json: an object in a line.")
@click.option("--no-status", is_flag=True, help="No line on the terminal that tells how it goes.")
@click.option("-v", "--verbose", is_flag=True, help="Short for --log-level info.")
@click.option("--debug", is_flag=True, help="Tracebacks, a debugger where a component failed; checks ports: slow.")
def run(
    target: str,
    changes: tuple[str, ...],
    folders: tuple[Path, ...],
    rate: float | None,
    duration_once: float | None,
    no_status: bool,
    **given: Any,
) -> int:
    """Run a system file, or one component alone.

    A component is MODULE:COMPONENT, FILE.py:COMPONENT, or the name of an installed one. Alone it runs on data, or
    periodically when it has no in-port or --rate is given; --set takes PARAM=VALUE.

    It ends when every component that produces of itself has finished and nothing is left on its way, when a component
    asks for it, after --for, or on Ctrl-C; a second Ctrl-C ends it at once. Exit status: what the component that asked
    said; 1 when a component could not be created; 2 when the file or the command line is wrong; 3 with --strict when a
    component ended in error; 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP. SIGUSR1 prints state and stacks.
    What keeps the event loop from turning for 0.2 s is named while it does; [watch_loop] of the file may end it
    for that. systemd is told of readiness, status and life where NOTIFY_SOCKET asks for it.
    With --log-file standard error is told of warnings and errors only.
    """
    if given["duration"] is None:
        given["duration"] = duration_once
    options = checked(Options(**given, status=not no_status, post_mortem=True))
    stopper = Stopper()
    with stopper.signals(), log_of(options, stopper) as log:
        try:
            found = find_target(target, changes, folders, rate)
        except AiortsError as error:
            log.failed(error)
            return 2
        log.levels.check(found.names)
        options = with_clock(options, found.clock)
        if log.levels.default <= logging.WARNING:
            for text in found.doubts:
                log.tell("W-OPTION", text, level="warning")
        return execute(
            found.make,
            len(found.names),
            options,
            stopper,
            log=log,
            catalogue=found.catalogue,
            unfed_advice=found.unfed,
            watched=Watched(found.watch_loop, found.ready),
        )
