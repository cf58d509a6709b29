"""The `aiorts` command, built on the public face alone, like any user of it."""

from __future__ import annotations

import atexit
import os
import signal
import sys

TYPE_CHECKING = False  # without `typing`: until the first line of `main` Ctrl-C shows a traceback
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

__all__ = ("main",)


def main() -> int:
    """Run the command line of this process; returns the exit status."""
    _fill_gaps()
    _interrupts_end_it()
    # Called last of all: what the interpreter does then is short, and a signal would end it with another status.
    atexit.register(_on_interrupt, signal.SIG_IGN)
    try:
        from aiorts.cli.app import run_command

        _import_command(sys.argv[1:2])
        return run_command(sys.argv[1:], last=True)
    except KeyboardInterrupt:
        return 130
    finally:
        _interrupts_end_it()


def _fill_gaps() -> None:
    """Open nothing at all in the place of a missing standard stream, or the first file we open takes its number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one


def _interrupts_end_it() -> None:
    """Have Ctrl-C end the process where it stands: there is nothing to put in order before a command runs, and after.

    A KeyboardInterrupt would show a traceback wherever nobody catches it: in a weak reference's callback of an import,
    in the interpreter's own end.
    """
    _on_interrupt(lambda number, frame: os._exit(130))


def _on_interrupt(handler: Callable[[int, Any], object] | signal.Handlers) -> None:
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a shell script
        return
    try:
        signal.signal(signal.SIGINT, handler)
    except ValueError:  # not the main thread, which has the signals
        return


def _import_command(names: list[str]) -> None:
    """Import the command that is meant while Ctrl-C still ends the process; only then may it raise an exception.

    `run` and the filters take the signals themselves, and until then leave it at that.
    """
    import importlib

    from aiorts.cli import app

    for name in names:
        if name.startswith("-"):
            continue
        home = app._COMMANDS.get(name, ("aiorts.cli.filter:",))[0].partition(":")[0]
        try:
            importlib.import_module(home)
        except ImportError:
            continue  # the command line says so when it comes to it
        if home not in ("aiorts.cli.run", "aiorts.cli.filter"):
            _on_interrupt(signal.default_int_handler)
