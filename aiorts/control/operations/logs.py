"""Operations on the log: the last lines, the lines from now on, and the level of a component's log."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final

from aiorts.control.operation import Operation, Right
from aiorts.control.operations.known import component_named
from aiorts.control.session import Session, Stream
from aiorts.control.values import Done
from aiorts.errors import ConfigurationError
from aiorts.kernel.embedding import last_lines
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.log import LOGGER_NAME
from aiorts.late import dataclass

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.loop.log import ComponentLog

LEVELS: Final = ("debug", "info", "warning", "error", "critical")
_LONGEST: Final = 500
_ROOT: Final = LOGGER_NAME.partition(".")[0]


@dataclass(frozen=True, slots=True)
class Lines:
    """The log lines to send."""

    components: tuple[str, ...] = ()
    """Names of components; an empty tuple is all, and the kernel's own lines."""
    level: str = "debug"
    """The lowest level."""
    follow: bool = False
    """Whether to go on with new lines."""


@dataclass(frozen=True, slots=True)
class Line:
    """One log line."""

    time_ns: int
    """The kernel's clock, in nanoseconds since the epoch."""
    level: str
    component: str
    """The component's name; "" for the kernel's own lines."""
    hook: str
    text: str
    """At most 500 characters."""


@dataclass(frozen=True, slots=True)
class Level:
    """The lowest level that components log."""

    level: str
    components: tuple[str, ...] = ()
    """Names of components; an empty tuple is all."""
    lasting: bool = True
    """Whether the level stays when the session ends."""


@dataclass(frozen=True, slots=True)
class Logged:
    """The state of a component's log."""

    level: str
    """The lowest level that is logged."""
    lines: int
    """Lines that can still be read."""


def _lines(session: Session, given: Lines, stream: Stream) -> tuple[Line, ...]:
    """Return the last lines, with the kernel's own where no component is named; new lines are streamed."""
    kernel, least = session.kernel, _number(given.level)
    chosen = _components(session, given.components)
    behind = kernel.clock.time_ns() - kernel.clock.monotonic_ns()
    found = [
        (line.monotonic_ns, Line(line.monotonic_ns + behind, line.level.lower(), one.name, line.hook, line.text))
        for one in chosen
        if (log := cell(one).log) is not None
        for line in log.last_lines
        if _number(line.level.lower()) >= least
    ]
    if not given.components:
        now_ns = kernel.clock.time_ns()  # simulated time may be before the times of the kernel's lines
        found += [
            (line.at_ns - behind, Line(min(line.at_ns, now_ns), _name(line.level), "", "", line.text))
            for line in last_lines(kernel.loop)
            if line.level >= least
        ]
    last = tuple(line for _, line in sorted(found, key=lambda pair: pair[0]))
    if not given.follow:
        stream.finish()
        return last
    names = frozenset(one.name for one in chosen) if given.components else None
    handler = _Follower(session, stream, names, least)
    logger = logging.getLogger(_ROOT)
    logger.addHandler(handler)
    stream.on_close(lambda: logger.removeHandler(handler))
    return last


def _level(session: Session, given: Level) -> Done:
    """Set the log level of components; each then has a logger of its own."""
    number = _number(given.level)
    for one in _components(session, given.components):
        log = one.log
        before = log.logger
        log.logger = logging.getLogger(f"{LOGGER_NAME}.{session.kernel.name}.{one.name}")
        level = log.logger.level
        log.logger.setLevel(number)
        if not given.lasting:
            session.keep(lambda log=log, before=before, level=level: _put_back(log, before, level))  # type: ignore[misc]
    return Done()


def _put_back(log: ComponentLog, before: logging.Logger, level: int) -> None:
    log.logger.setLevel(level)
    log.logger = before


def _levels(session: Session, given: Lines) -> dict[str, Logged]:
    found = {}
    for one in _components(session, given.components):
        log = cell(one).log  # None until it has logged
        logger = logging.getLogger(LOGGER_NAME) if log is None else log.logger
        found[one.name] = Logged(_name(logger.getEffectiveLevel()), 0 if log is None else len(log.last_lines))
    return found


def _components(session: Session, names: tuple[str, ...]) -> list[Component]:
    return [component_named(session, name) for name in dict.fromkeys(names)] or list(session.kernel.components.values())


def _number(level: str) -> int:
    if level not in LEVELS:
        raise ConfigurationError(f"level {level!r:.60}: expected {', '.join(LEVELS)}")
    return int(getattr(logging, level.upper()))


def _name(number: int) -> str:
    return next((name for name in reversed(LEVELS) if _number(name) <= number), LEVELS[0])


class _Follower(logging.Handler):
    """A log handler that sends the lines of one kernel to a client; a line without room is dropped and counted."""

    def __init__(self, session: Session, stream: Stream, names: frozenset[str] | None, level: int) -> None:
        super().__init__(level)
        self._kernel = session.kernel
        self._stream = stream
        self._names = names

    def emit(self, record: logging.LogRecord) -> None:
        component = getattr(record, "component", "")
        if getattr(record, "kernel", self._kernel.name) != self._kernel.name:
            return
        if self._names is not None and component not in self._names:
            return
        text = record.getMessage()[:_LONGEST]
        level = _name(record.levelno)
        line = Line(self._kernel.clock.time_ns(), level, component, getattr(record, "hook", ""), text)
        self._kernel.call_on_loop(lambda: self._stream.send(line))


ROWS: Final = (
    Operation("log", "The last lines, and a stream.", Lines, tuple[Line, ...], Right.VIEW, _lines, item=Line),
    Operation("log_level", "Set the level of components' logs.", Level, Done, Right.OPERATE, _level, idempotent=True),
    Operation("log_levels", "The level of each log.", Lines, dict[str, Logged], Right.VIEW, _levels, idempotent=True),
)
