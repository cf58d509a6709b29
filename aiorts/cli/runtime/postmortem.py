"""The debugger at the frame that failed, with the loop standing still; only where a person sits at a terminal.

The debugger is `pdb`; the system goes on when the user leaves it. Ctrl-C goes to the debugger meanwhile, and the
terminal is restored afterwards.
"""

from __future__ import annotations

import contextlib
import os
import pdb
import signal
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from aiorts.cli.console.report import say
from aiorts.errors import AiortsError


def is_possible() -> bool:
    """Whether standard input and standard error are a terminal."""
    try:
        return all(
            stream is not None and not stream.closed and os.isatty(stream.fileno())
            for stream in (sys.stdin, sys.stderr)
        )
    except (OSError, ValueError, AttributeError):
        return False


class PostMortem:
    """The debugger. Args: quietly: a context manager that keeps other output from the terminal meanwhile."""

    def __init__(self, quietly: Callable[[], AbstractContextManager[object]]) -> None:
        self._quietly = quietly
        self._settings = _settings()

    def look(self, where: str, error: BaseException | None) -> None:
        """Open the debugger where an error was raised; an error that aiorts found in a file has no such place."""
        if error is None or (isinstance(error, AiortsError) and error.__cause__ is None and not where):
            return
        trace = error.__traceback__
        if trace is None:
            return
        with self._quietly():
            say(f"aiorts: post-mortem{f' of {where}' if where else ''}; q goes on with the run")
            before = signal.signal(signal.SIGINT, signal.default_int_handler)
            try:
                # Prompts belong on standard error, unless a person has standard output in view as well.
                shown = sys.stdout is not None and sys.stdout.isatty()
                debugger = pdb.Pdb() if shown else pdb.Pdb(stdin=sys.stdin, stdout=sys.stderr)
                debugger.reset()
                debugger.interaction(None, trace)
            except KeyboardInterrupt:
                pass
            finally:
                signal.signal(signal.SIGINT, before)

    def restore(self) -> None:
        """Restore the terminal, where the process ends from inside the debugger."""
        if self._settings is not None:
            import termios

            with contextlib.suppress(OSError, ValueError, termios.error):
                termios.tcsetattr(sys.stdin.fileno(), termios.TCSANOW, self._settings)


def _settings() -> list[Any] | None:
    try:
        import termios
    except ImportError:
        return None
    try:
        return termios.tcgetattr(sys.stdin.fileno())
    except (OSError, ValueError, termios.error):
        return None
