"""The log of a component, `self.log`: this file counts and thins out lines, standard `logging` does the rest.

Every record carries `kernel`, `component`, `hook`, `tick`, `repeated` and `folded` as attributes. A line with the same
level and template as one of the last second is counted instead of emitted (`repeated`), and the count comes with the
next line, so nothing is lost in silence: calls = lines + repeated + dropped, once `flush()` was called. How the line
says so is `folded`: only lines of one text are called repeated. Output over 200 kB in a second is dropped and counted
too, so a component that logs in a tight loop harms no other; and so is what all components of a kernel together say
beyond `SharedBudget`. A handler or filter that raises harms no code either: the line stands on standard error then.
Importing this configures no logging.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from aiorts.kernel.loop.exceptions import behind, trace_of
from aiorts.kernel.loop.guarded import KernelLog, contain, error_of, guarded, line_of, safe_exc_info
from aiorts.model.profile import LogLine

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeAlias

    from aiorts.kernel.loop.guarded import ExcInfo

    _Key: TypeAlias = tuple[int, str]

LOGGER_NAME: Final = "aiorts.component"
BYTES_PER_SECOND: Final = 200_000
SHARED_BYTES_PER_SECOND: Final = 700_000
SHARED_LINES_PER_SECOND: Final = 900
"""The budget of all components of one kernel together: bytes, and lines of tracebacks."""
_SECOND_NS: Final = 1_000_000_000
# What a formatter adds to a line (time, level, names), and what one frame of a traceback takes.
_LINE_BYTES: Final = 100
_FRAME_BYTES: Final = 150
_STACK_BYTES: Final = 4_000
_MAX_KEYS: Final = 256
_MAX_CAUSES: Final = 20
_TEMPLATE_SHOWN: Final = 200
_KEPT: Final = 16
_KEPT_LENGTH: Final = 500
_PLAIN: Final = frozenset((bool, int, float, str, type(None)))
_ARGS: Final[Any] = BaseException.__dict__["args"]


class LogFields(NamedTuple):
    """The place of a component at the moment a line is logged: kernel, hook and tick."""

    kernel: str
    component: str
    hook: str = ""
    """Empty outside of hooks."""
    tick: int = 0
    """Number of the cycle of its execution context."""


class _Folded:
    """One template of the last second: when a line was emitted, what was said last, and how many were not emitted."""

    __slots__ = ("_alike", "_hash", "_known", "count", "emitted_ns", "text")

    def __init__(self, emitted_ns: int, template: str) -> None:
        self.emitted_ns = emitted_ns
        self.text = template[:_TEMPLATE_SHOWN]
        """The text of the last known line: it is formatted outside of the lock, since its objects are the user's."""
        self.count = 0
        self._alike = self._known = True
        self._hash: int | None = None

    def said(self, line: str | None) -> None:
        """One of its lines; None where finding out would run code of the user for a line that is not emitted."""
        self._known = line is not None
        if line is None:
            self._alike = False
            return
        self._alike = self._alike and self._hash in (None, hash(line))
        self._hash, self.text = hash(line), line[:_TEMPLATE_SHOWN]

    def before(self, line: str) -> str:
        """The remark of the next emitted line on those that were not."""
        return (
            _times(self.count) if self._alike and self._hash == hash(line) else f" ({self.count} more like this before)"
        )

    def alone(self) -> str:
        """The line that is emitted where no next line came."""
        if self._alike:
            return f"{self.text}{_times(self.count)}"
        if not self._known:
            return f"{self.text} ({self.count} more like this)"
        return self.text if self.count == 1 else f"{self.text} (the last of {self.count} more like this)"


class SharedBudget:
    """Limits what the components of one kernel log together in a second; what is over it is summed up in one line.

    One component gets no more than it leaves to the others, so that a quiet one is heard while others storm. Lines are
    counted for tracebacks only. `later` is called once for each second in which something was dropped, and has
    `summarize` called when it is over. Safe to use from several threads.
    """

    __slots__ = ("_bytes", "_dropped", "_later", "_lines", "_lock", "_name", "_second_ns", "_silenced")

    def __init__(self, name: str, later: Callable[[], object]) -> None:
        self._name = name
        self._later = later
        self._lock = threading.Lock()
        self._second_ns = 0
        self._bytes: Counter[str] = Counter()
        self._lines: Counter[str] = Counter()
        self._dropped = 0
        self._silenced: set[str] = set()

    def afford(self, now_ns: int, size: int, lines: int, component: str) -> bool:
        """Charge a record of so many bytes, with a traceback of so many lines; when it does not fit, count it."""
        with self._lock:
            if now_ns - self._second_ns >= _SECOND_NS:
                self._second_ns = now_ns
                self._bytes.clear()
                self._lines.clear()
            left = SHARED_BYTES_PER_SECOND - self._bytes.total()
            lines_left = SHARED_LINES_PER_SECOND - self._lines.total()
            if self._bytes[component] + size <= left and (not lines or self._lines[component] + lines <= lines_left):
                self._bytes[component] += size
                self._lines[component] += lines
                return True
            first = not self._dropped
            self._dropped += 1
            self._silenced.add(component)
        if first:
            self._later()
        return False

    def summarize(self) -> None:
        """Tell what was dropped since the last time, if anything was."""
        with self._lock:
            dropped, self._dropped = self._dropped, 0
            components, self._silenced = len(self._silenced), set()
        if dropped:
            KernelLog(LOGGER_NAME).warning(
                "%s: its components logged more than %s traceback lines or %s kB in a second: %s more lines of %s "
                "components dropped; kernel.components has every state and last_error",
                self._name,
                SHARED_LINES_PER_SECOND,
                SHARED_BYTES_PER_SECOND // 1000,
                dropped,
                components,
                extra={**LogFields(self._name, "")._asdict(), "repeated": 0, "folded": "", "dropped": dropped},
            )


class ComponentLog:
    """A component's logger, with the methods and keyword arguments of `logging.LoggerAdapter`.

    `fields` is asked for each line that is emitted, never for others. `now_ns` is the kernel clock's monotonic time in
    nanoseconds. Safe to use from several threads.
    """

    __slots__ = (
        "_dropped",
        "_fields",
        "_kept",
        "_keys",
        "_lock",
        "_now_ns",
        "_second_ns",
        "_shared",
        "_spent",
        "logger",
    )

    def __init__(
        self,
        fields: Callable[[], LogFields],
        now_ns: Callable[[], int],
        *,
        logger: logging.Logger | None = None,
        shared: SharedBudget | None = None,
    ) -> None:
        self.logger = logging.getLogger(LOGGER_NAME) if logger is None else logger
        self._fields = fields
        self._now_ns = now_ns
        self._shared = shared
        self._lock = threading.Lock()
        self._keys: dict[_Key, _Folded] = {}  # ordered by the time of emission
        self._second_ns = now_ns()
        self._spent = 0
        self._dropped = 0
        self._kept: deque[tuple[int, int, str, str]] = deque(maxlen=_KEPT)

    @property
    def last_lines(self) -> tuple[LogLine, ...]:
        """The last 16 lines of a level that was listened to, oldest first; a repeated one stands here once."""
        names = logging.getLevelName
        return tuple(LogLine(at_ns, names(level), text, hook) for at_ns, level, text, hook in tuple(self._kept))

    def __repr__(self) -> str:
        return f"<ComponentLog {self._fields().component} on {self.logger.name!r}>"

    def isEnabledFor(self, level: int) -> bool:  # noqa: N802 - the name that logging.LoggerAdapter gives it
        """True when a line of this level would go anywhere."""
        return self.logger.isEnabledFor(level)

    def debug(self, msg: object, *args: object, **options: Any) -> None:
        """A line for who looks for a fault; options are those of `logging.Logger.debug`."""
        if self.logger.isEnabledFor(logging.DEBUG):
            self._log(logging.DEBUG, msg, args, **options)

    def info(self, msg: object, *args: object, **options: Any) -> None:
        """A line that says all is well."""
        if self.logger.isEnabledFor(logging.INFO):
            self._log(logging.INFO, msg, args, **options)

    def warning(self, msg: object, *args: object, **options: Any) -> None:
        """A line that says something may go wrong."""
        if self.logger.isEnabledFor(logging.WARNING):
            self._log(logging.WARNING, msg, args, **options)

    def error(self, msg: object, *args: object, **options: Any) -> None:
        """A line that says something went wrong."""
        if self.logger.isEnabledFor(logging.ERROR):
            self._log(logging.ERROR, msg, args, **options)

    def exception(self, msg: object, *args: object, exc_info: ExcInfo = True, **options: Any) -> None:
        """An error with the traceback of the exception being handled."""
        if self.logger.isEnabledFor(logging.ERROR):
            self._log(logging.ERROR, msg, args, exc_info=exc_info, **options)

    def critical(self, msg: object, *args: object, **options: Any) -> None:
        """A line that says it cannot go on."""
        if self.logger.isEnabledFor(logging.CRITICAL):
            self._log(logging.CRITICAL, msg, args, **options)

    def log(self, level: int, msg: object, *args: object, **options: Any) -> None:
        """A line of any level."""
        if self.logger.isEnabledFor(level):
            self._log(level, msg, args, **options)

    def flush(self) -> None:
        """Log what was counted and not yet reported; the kernel calls it when it closes."""
        with self._lock:
            pending = [(key[0], folded) for key, folded in self._keys.items() if folded.count]
            self._keys.clear()
            dropped, self._dropped = self._dropped, 0
        for level, folded in pending:
            guarded(f"could not log {folded.text!r}", self._emit_count, level, folded)
        if dropped:
            guarded("could not log what was dropped", self._emit_dropped, dropped)

    def _log(
        self,
        level: int,
        msg: object,
        args: tuple[object, ...],
        *,
        exc_info: ExcInfo = None,
        stack_info: bool = False,
        stacklevel: int = 1,
        extra: Mapping[str, object] | None = None,
    ) -> None:
        try:
            self._log_or_fold(level, msg, args, error_of(exc_info), stack_info, stacklevel, extra)
        except BaseException as error:  # noqa: BLE001 - the border round the application's handlers, filters and texts
            contain(f"could not log {line_of(msg, args)!r}", error)

    def _log_or_fold(
        self,
        level: int,
        msg: object,
        args: tuple[object, ...],
        error: BaseException | None,
        stack_info: bool,
        stacklevel: int,
        extra: Mapping[str, object] | None,
    ) -> None:
        now = self._now_ns()
        key = (level, msg if isinstance(msg, str) else str(msg))
        with self._lock:
            folded = self._keys.get(key)
            if folded is not None and now - folded.emitted_ns < _SECOND_NS:
                folded.count += 1
                folded.said(_text(key[1], args) if _PLAIN.issuperset(map(type, args)) else None)
                return
            if folded is not None:
                del self._keys[key]
            old = self._forget_old(now)
            emitted = self._keys[key] = _Folded(now, key[1])
        for old_level, silent in old:
            if self._afford(now, _LINE_BYTES + len(silent.text), silent.count):
                self._emit_count(old_level, silent)
        line = _text(key[1], args)
        with self._lock:
            emitted.said(line)
        repeated = 0 if folded is None else folded.count
        told = folded.before(line) if folded is not None and repeated else ""
        self._kept.append((now, level, line[:_KEPT_LENGTH], self._fields().hook))
        attached = _chain_bytes(error) + (_STACK_BYTES if stack_info else 0)
        traceback = 2 + 3 * (attached // _FRAME_BYTES) if attached else 0
        if self._afford(now, _line_bytes(key[1], args) + attached, 1 + repeated, traceback):
            self.logger.log(
                level,
                f"{key[1]}{told}" if told else msg,
                *args,
                exc_info=safe_exc_info(error),
                stack_info=stack_info,
                stacklevel=stacklevel + 3,
                extra=self._attributes(repeated, told, extra),
            )

    def _forget_old(self, now: int) -> list[tuple[int, _Folded]]:
        """Take out the templates that fell silent, and the oldest when there are too many; return level and counts."""
        counted = []
        while self._keys:
            key, folded = next(iter(self._keys.items()))
            if now - folded.emitted_ns < _SECOND_NS and len(self._keys) < _MAX_KEYS:
                break
            del self._keys[key]
            if folded.count:
                counted.append((key[0], folded))
        return counted

    def _afford(self, now: int, size: int, lines: int, traceback: int = 0) -> bool:
        """Charge the line to this second's budgets; when it does not fit, count it as dropped."""
        with self._lock:
            dropped = 0
            if now - self._second_ns >= _SECOND_NS:
                self._second_ns, self._spent = now, 0
                dropped, self._dropped = self._dropped, 0
            fits = self._spent + size <= BYTES_PER_SECOND
            if fits:
                self._spent += size
            else:
                self._dropped += lines
        if dropped:
            self._emit_dropped(dropped)
        if fits and self._shared is not None:
            return self._shared.afford(now, size, traceback, self._fields().component)
        return fits

    def _emit_count(self, level: int, folded: _Folded) -> None:
        self.logger.log(level, "%s", folded.alone(), extra=self._attributes(folded.count, "", None))

    def _emit_dropped(self, count: int) -> None:
        line = "1 line" if count == 1 else f"{count} lines"
        text = f"log output over {BYTES_PER_SECOND // 1000} kB/s: {line} dropped"
        self.logger.warning(text, extra={**self._attributes(0, "", None), "dropped": count})

    def _attributes(self, repeated: int, told: str, extra: Mapping[str, object] | None) -> dict[str, object]:
        attributes: dict[str, object] = {} if extra is None else dict(extra)
        attributes.update(self._fields()._asdict(), repeated=repeated, folded=told)
        return attributes


def _times(count: int) -> str:
    return f" (repeated {count} times)" if count > 1 else " (repeated 1 time)"


def _text(template: str, args: tuple[object, ...]) -> str:
    try:
        return template % (args[0] if len(args) == 1 and isinstance(args[0], Mapping) else args) if args else template
    except (TypeError, ValueError, KeyError):
        return template  # the handler reports the bad template, as it does for every logger


def _line_bytes(template: str, args: tuple[object, ...]) -> int:
    text = _text(template, args)
    return _LINE_BYTES + (len(text) if text.isascii() else len(text.encode("utf-8", "replace")))


def _chain_bytes(error: BaseException | None) -> int:
    """About what the tracebacks of an exception and its causes take; renders none of them."""
    size = 0
    for _ in range(_MAX_CAUSES):
        if error is None:
            break
        trace = trace_of(error)
        while trace is not None and size < BYTES_PER_SECOND:
            size += _FRAME_BYTES
            trace = trace.tb_next
        size += _LINE_BYTES + sum(len(argument) for argument in _ARGS.__get__(error) if type(argument) in (str, bytes))
        error = behind(error)
    return size
