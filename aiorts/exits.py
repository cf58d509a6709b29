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
DONE = 0
"""Nothing went wrong."""
FAILED = 1
"""The command failed, or found a difference."""
REFUSED = 2
"""Wrong usage or configuration: it was refused before the start."""
IN_ERROR = 3
"""A component ended in error and was not recovered."""
DENIED = 4
"""Permission denied."""
NO_ANSWER = 5
"""There was no answer in time."""
ABSENT = 6
"""The named thing does not exist, or its name is ambiguous."""
STALLED = 70
"""The event loop did not turn for the time that `[watch_loop]` allows."""
_SIGNAL = 128

TABLE = (
    (f"{DONE}", "done"),
    (f"{FAILED}", "failed, or found a difference"),
    (f"{REFUSED}", "wrong usage or configuration: refused before the start"),
    (f"{IN_ERROR}", "a component ended in error and was not recovered"),
    (f"{DENIED}", "permission denied"),
    (f"{NO_ANSWER}", "no answer in time"),
    (f"{ABSENT}", "what was named does not exist, or its name is ambiguous"),
    (f"{STALLED}", 'the event loop stood still ([watch_loop] with policy = "exit")'),
    (
        f"{_SIGNAL} + n",
        "ended by signal n: 129 SIGHUP, 130 Ctrl-C, 141 the reader of standard output has gone, 143 SIGTERM",
    ),
)
"""Status and meaning, in words for people."""
_OF_CODE = {
    "E-ABSENT": ABSENT,
    "E-AMBIGUOUS": ABSENT,
    "E-APPLY": FAILED,
    "E-COMPONENT": FAILED,
    "E-DENIED": DENIED,
    "E-GOAL-CANCELLED": FAILED,
    "E-GOAL-FAILED": FAILED,
    "E-LINK": FAILED,
    "E-LINK-TIMEOUT": NO_ANSWER,
    "E-NO-ANSWER": NO_ANSWER,
    "E-OUTPUT": FAILED,
    "E-PROCESS": FAILED,
    "E-SERVICE-FAILED": FAILED,
    "E-SERVICE-TIMEOUT": NO_ANSWER,
    "E-STALE": ABSENT,
    "E-TRANSITION": NO_ANSWER,
    "E-UNKNOWN-TYPE": ABSENT,
}


def of_signal(number: int) -> int:
    """The status of a process that a signal has ended, as shells count it: 128 + `number`."""
    return _SIGNAL + number


INTERRUPTED = of_signal(2)
"""Ended by Ctrl-C."""
BROKEN_PIPE = of_signal(13)
"""The reader of standard output has gone."""


def of_error(error: BaseException) -> int:
    """The status of a command that an error of aiorts has ended: REFUSED, unless the error's code has another."""
    return _OF_CODE.get(getattr(error, "code", ""), REFUSED)
