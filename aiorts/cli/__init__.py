"""The `aiorts` command, built on the public interface alone, like any program that uses it."""

from __future__ import annotations

import atexit
import io
import os
import signal
import sys

from aiorts.exits import INTERRUPTED

TYPE_CHECKING = False  # `typing` would take time to import: before the first line of `main` Ctrl-C shows a traceback
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

__all__ = ("main",)

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
_DESCRIPTORS = 24
"""Descriptors besides those of the user's files: three for each loop and timer queue, some for imports and threads."""


def main() -> int:
    """Run the command line of this process; returns the exit status."""
    _fill_gaps()
    _signals_end_it()
    if not _has_room():
        return 2
    # Called last at exit: the rest of the interpreter's end is short, and a signal would change its exit status.
    atexit.register(_ignore_signals)
    _print_for_programs()
    try:
        from aiorts.cli.app import run_command

        _import_command(sys.argv[1:2])
        return run_command(sys.argv[1:], last=True)
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        _signals_end_it()


def _fill_gaps() -> None:
    """Open /dev/null in place of a missing standard stream: else the next opened file would take its number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one


def _print_for_programs() -> None:
    """Make output to a file or pipe UTF-8: JSON lines and system files are UTF-8, whatever the locale is.

    A terminal keeps its encoding; each character that it lacks is printed as a number.
    """
    out = sys.stdout
    if isinstance(out, io.TextIOWrapper) and out.encoding.lower() != "utf-8":
        if out.isatty():
            out.reconfigure(errors="backslashreplace")
        else:
            out.reconfigure(encoding="utf-8")


def _has_room() -> bool:
    """Whether this process can open the files that any command opens; prints an error when not.

    Without this check, the next code to open a descriptor would fail: an import, the event loop, a context's thread.
    """
    opened: list[int] = []
    try:
        opened.extend(os.dup(0) for _ in range(_DESCRIPTORS))
    except OSError as error:
        limit = os.sysconf("SC_OPEN_MAX")  # no import could open its file now
        told = f"aiorts: E-FDS: {error.strerror}: the limit that is set is {limit}; raise it with ulimit -n 4096\n"
        os.write(2, told.encode())
        return False
    finally:
        for descriptor in opened:
            os.close(descriptor)
    return True


def _signals_end_it() -> None:
    """Let a signal end the process at once: before and after a command there is nothing to clean up.

    A KeyboardInterrupt would show a traceback where no code catches it: in a weak reference's callback of an import,
    or while the interpreter ends.
    """
    for name in _SIGNALS:
        _on_signal(name, lambda number, frame: os._exit(128 + number))


def _ignore_signals() -> None:
    for name in _SIGNALS:
        _on_signal(name, signal.SIG_IGN)


def _on_signal(name: str, handler: Callable[[int, Any], object] | signal.Handlers) -> None:
    number = getattr(signal, name, None)
    if number is None or signal.getsignal(number) is signal.SIG_IGN:  # as in the background of a shell script
        return
    try:
        signal.signal(number, handler)
    except ValueError:  # not in the main thread, which alone may set handlers
        return


def _import_command(names: list[str]) -> None:
    """Import the named command while Ctrl-C still ends the process; afterwards Ctrl-C raises KeyboardInterrupt.

    `run` and the filters install their own handlers; until then Ctrl-C ends the process.
    """
    import importlib

    from aiorts.cli import app

    for name in names:
        if name.startswith("-"):
            continue
        own = app._COMMANDS.get(name) or app._HIDDEN.get(name)
        if own is None and app.is_offered_command(name):
            continue  # it imports what it needs itself; the filters' modules are not for it
        own = own or ("aiorts.cli.commands.filter:", "")
        home = own[0].partition(":")[0]
        try:
            importlib.import_module(home)
        except ImportError:
            continue  # the command line reports it later
        if home not in ("aiorts.cli.commands.run", "aiorts.cli.commands.filter"):
            _on_signal("SIGINT", signal.default_int_handler)
