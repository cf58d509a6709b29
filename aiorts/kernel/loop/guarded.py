"""Records objects of the application, an exception, a log line, an event, and cannot fail while it does.

An application's exception, logging handler, filter or observer may raise whatever it likes when it is touched. That
ends here, as one plain line on standard error, and the code that recorded it goes on: a context, a thread,
supervision, the end of a kernel. A KeyboardInterrupt is the user's: it goes on to the code that runs the loop.
"""

from __future__ import annotations

import asyncio
import logging
import sys
import threading
from collections.abc import Callable, Mapping
from time import monotonic_ns, time_ns
from types import TracebackType
from typing import Any, Final, NamedTuple, TypeAlias, cast

from aiorts.errors import format_error
from aiorts.kernel.loop.exceptions import presentable, trace_of

GUEST: Final = "_aiorts_guest"
"""The attribute of a loop that knows the kernels in it."""
_SECOND_NS: Final = 1_000_000_000
_LINES_PER_SECOND: Final = 20
_LONGEST: Final = 1_000

ExcInfo: TypeAlias = (
    bool
    | BaseException
    | tuple[type[BaseException], BaseException, TracebackType | None]
    | tuple[None, None, None]
    | None
)


def guarded(what: str, act: Callable[..., object], *args: Any) -> None:
    """Call `act`; what it raises is contained, and logged as what went wrong while `what` was done."""
    try:
        act(*args)
    except BaseException as error:  # noqa: BLE001 - the border round everything that records
        contain(what, error)


def contain(what: str, error: BaseException) -> None:
    """Contain what foreign code raised while something was recorded."""
    try:
        if not interrupts(error):
            _LAST_RESORT.write(f"aiorts: E-LOG: {what}: {format_error(error)}")
    except BaseException:  # noqa: BLE001, S110 - standard error is closed or full, and there is no other place to write to
        pass


def interrupts(error: BaseException) -> bool:
    """Whether it is a KeyboardInterrupt, which was passed on to the code that runs this loop."""
    if not issubclass(type(error), KeyboardInterrupt):
        return False
    guest: Any = getattr(asyncio._get_running_loop(), GUEST, None)
    return guest is not None and bool(guest.interrupted(error))


class _LastResort:
    """Standard error, for what nothing else would take: so many lines in a second, the others are counted."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._second_ns = 0
        self._written = self._omitted = 0

    def write(self, text: str) -> None:
        """One line of it."""
        text = " ".join(text.split())[:_LONGEST]
        with self._lock:
            now_ns = monotonic_ns()
            if now_ns - self._second_ns >= _SECOND_NS:
                self._second_ns, self._written = now_ns, 0
            if self._written >= _LINES_PER_SECOND:
                self._omitted += 1
                return
            self._written += 1
            if self._omitted:
                text += f" ({self._omitted} lines before it were left out)"
                self._omitted = 0
        if sys.stderr is not None:
            sys.stderr.write(f"{text}\n")


_LAST_RESORT: Final = _LastResort()


class KernelLine(NamedTuple):
    """A line of the kernel's own log."""

    at_ns: int
    """When, in nanoseconds since the epoch."""
    level: int
    text: str


class KernelLog:
    """The kernel's own logger: writes to the log, or else to standard error, and never raises."""

    __slots__ = ("_logger",)

    def __init__(self, name: str = "aiorts.kernel") -> None:
        self._logger = logging.getLogger(name)

    def debug(self, msg: str, *args: object, exc_info: ExcInfo = None) -> None:
        """A line for who looks for a fault."""
        self._log(logging.DEBUG, msg, args, exc_info)

    def info(self, msg: str, *args: object, exc_info: ExcInfo = None) -> None:
        """A line that says all is well."""
        self._log(logging.INFO, msg, args, exc_info)

    def warning(
        self, msg: str, *args: object, exc_info: ExcInfo = None, extra: Mapping[str, object] | None = None
    ) -> None:
        """A line that says something may go wrong."""
        self._log(logging.WARNING, msg, args, exc_info, extra)

    def error(self, msg: str, *args: object, exc_info: ExcInfo = None) -> None:
        """A line that says something went wrong."""
        self._log(logging.ERROR, msg, args, exc_info)

    def exception(self, msg: str, *args: object) -> None:
        """An error with the traceback of the exception being handled."""
        self._log(logging.ERROR, msg, args, True)

    def _log(
        self,
        level: int,
        msg: str,
        args: tuple[object, ...],
        exc_info: ExcInfo,
        extra: Mapping[str, object] | None = None,
    ) -> None:
        try:
            if self._logger.isEnabledFor(level):
                told = tuple(presentable(arg) if issubclass(type(arg), BaseException) else arg for arg in args)
                trace = safe_exc_info(error_of(exc_info))
                _keep(level, msg, told)
                self._logger.log(level, msg, *told, exc_info=trace, extra=extra, stacklevel=3)
        except BaseException as error:  # noqa: BLE001 - the border round the application's handlers and filters
            contain(f"could not log {line_of(msg, args)!r}", error)


def _keep(level: int, msg: str, args: tuple[object, ...]) -> None:
    """Keep the line with the loop that it belongs to, for who begins to look at its log later."""
    guest: Any = getattr(asyncio._get_running_loop(), GUEST, None)
    if guest is not None:
        guest.last_lines.append(KernelLine(time_ns(), level, line_of(msg, args)[:_LONGEST]))


def error_of(exc_info: object) -> BaseException | None:
    """The exception that is meant by what a log call is given for `exc_info`."""
    if type(exc_info) is tuple:
        exc_info = exc_info[1]
    if issubclass(type(exc_info), BaseException):
        return cast("BaseException", exc_info)
    return sys.exception() if exc_info else None


def safe_exc_info(
    error: BaseException | None,
) -> tuple[type[BaseException], BaseException, TracebackType | None] | None:
    """The `exc_info` for a handler: its text raises nothing."""
    if error is None:
        return None
    error = presentable(error)
    return type(error), error, trace_of(error)


def line_of(msg: object, args: tuple[object, ...]) -> str:
    """The line as far as it can be had."""
    try:
        text = str(msg)
        return text % args if args else text
    except BaseException:  # noqa: BLE001 - the texts of the application's objects
        return f"a line of {type(msg).__name__}" if type(msg) is not str else msg
