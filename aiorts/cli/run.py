"""`aiorts run SYSTEM.toml`: builds the system, runs it until it ends, and tells by the exit status how that went."""

from __future__ import annotations

from typing import Any

import click

from aiorts.cli.session import Logging, Options, checked, execute, with_clock
from aiorts.cli.stopping import Stopper
from aiorts.system import build, load, prepare

__all__ = ("run",)


@click.command(short_help="Run a system file.")
@click.argument("file", metavar="SYSTEM.toml", type=click.Path(dir_okay=False))
@click.option(
    "--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="Set a parameter; may be repeated."
)
@click.option("--loop", type=click.Choice(["auto", "uvloop", "asyncio"]), default="auto", help="The event loop.")
@click.option("--simulate", is_flag=True, help="Run in virtual time: exact, and as fast as the machine can.")
@click.option("--speed", type=float, metavar="X", help="Run X times as fast as real time.")
@click.option("--strict", is_flag=True, help="Exit status 3 when a component ended in error.")
@click.option("--duration", type=float, metavar="S", help="End after S seconds of the system's time.")
@click.option("-v", "--verbose", is_flag=True, help="Say what components say, and show tracebacks.")
@click.option("--debug", is_flag=True, help="As -v, and check the thread and copy the sample at every port: slow.")
def run(file: str, changes: tuple[str, ...], **options: Any) -> int:
    """Run the system that SYSTEM.toml describes.

    It ends when every component that produces of itself has finished and nothing is left on its way, when a component
    asks for it, after --duration, or on Ctrl-C. Exit status: what the component that asked said; 1 when a component
    could not be created; 2 when the file or the command line is wrong; 3 with --strict when a component ended in error;
    130 after Ctrl-C, 143 after SIGTERM.
    """
    chosen = checked(Options(**options))
    stopper = Stopper()
    with stopper.signals():
        with Logging(chosen, stopper):
            plan = prepare(load(file, changes))
        return execute(
            lambda kernel: build(kernel, plan),
            len(plan.system.components),
            with_clock(chosen, plan.system.clock),
            stopper,
        )
