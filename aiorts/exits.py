"""The exit statuses of all commands, one table: `aiorts help` shows it, scripts and service managers may rely on it.

A command returns one of the names below, and no number of its own; a component says with `request_stop` what it likes.
"""

from __future__ import annotations

__all__ = (
    "ABSENT",
    "BROKEN_PIPE",
    "DENIED",
    "DONE",
    "FAILED",
    "INTERRUPTED",
    "IN_ERROR",
    "NO_ANSWER",
    "REFUSED",
    "STALLED",
    "TABLE",
    "of_error",
    "of_signal",
)

# Imports nothing: the command line has these before anything else.
DONE, FAILED, REFUSED, IN_ERROR, DENIED, NO_ANSWER, ABSENT = range(7)
STALLED = 70
_SIGNAL = 128

TABLE = (
    (f"{DONE}", "done"),
    (f"{FAILED}", "failed, or a difference found"),
    (f"{REFUSED}", "usage, configuration, or refused before the start"),
    (f"{IN_ERROR}", "a component ended in error, unhelped"),
    (f"{DENIED}", "denied"),
    (f"{NO_ANSWER}", "no answer in time"),
    (f"{ABSENT}", "what was asked for is absent, or its name ambiguous"),
    (f"{STALLED}", 'the event loop stood still ([watch_loop] with policy = "exit")'),
    (f"{_SIGNAL} + n", "ended by signal n: 129 SIGHUP, 130 Ctrl-C, 141 a reader that has gone, 143 SIGTERM"),
)
"""Status and meaning, in words for people."""
_OF_CODE = {"E-COMPONENT": FAILED, "E-UNKNOWN-TYPE": ABSENT}


def of_signal(number: int) -> int:
    """What a process ends with that a signal has ended, as shells count it."""
    return _SIGNAL + number


INTERRUPTED = of_signal(2)
BROKEN_PIPE = of_signal(13)


def of_error(error: BaseException) -> int:
    """What a command ends with that raised an error of aiorts: it has not begun, unless the error's code says so."""
    return _OF_CODE.get(getattr(error, "code", ""), REFUSED)
