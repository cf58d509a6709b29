"""The log of one run: messages of components, libraries and the command itself, as lines for a person or a program.

Each `Line` is made once, and each sink writes it in its form: standard error, and a log file where one is named; then
standard error gets only warnings and errors. The log is a handler of Python's logging while the command runs, and is
removed without trace afterwards. A sink that cannot be written raises no exception here.
"""

from __future__ import annotations

import json
import logging
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Self

from aiorts.cli.console.finding import below
from aiorts.cli.console.finding import text_of as finding_text
from aiorts.cli.console.report import (
    advice_on,
    cause_of,
    code_of,
    marked_in,
    one_line,
    place_of,
    report,
    say,
    shortened,
)
from aiorts.cli.runtime.logfile import LogFile
from aiorts.cli.runtime.options import Levels, Options, levels_of
from aiorts.errors import ComponentError
from aiorts.kernel.loop.origins import in_brackets, origin_of
from aiorts.late import dataclass

if TYPE_CHECKING:
    from aiorts import Kernel
    from aiorts.events import ComponentAdded, HookFailed
    from aiorts.system import Finding


@dataclass(frozen=True, slots=True)
class Line:
    """One message of the log."""

    time_ns: int
    """The time by the system's clock, in nanoseconds since the epoch."""
    level: str
    message: str
    component: str = ""
    context: str = ""
    hook: str = ""
    code: str = ""
    """The code of an error; empty for other messages."""
    error: BaseException | None = None
    advice: str = ""
    times: str = ""
    below: tuple[str, ...] = ()
    """Further lines for a person, below this one."""

    @property
    def where(self) -> str:
        """The component and hook with a colon after it; "" where the message begins with them."""
        dot = "." if self.hook.isidentifier() else ": "  # the name of a task is no identifier
        where = f"{self.component}{dot}{self.hook}: " if self.code and self.hook else f"{self.component}: "
        named = (where, f"{self.component}.")
        return "" if not self.component or self.message.startswith(named) else where


class Log(logging.Handler):
    """The log of one run, from `with` to its end.

    Args:
        on_output_error: called when the write of a component failed; it returns True to suppress the message.

    Raises:
        ConfigurationError: on entering; the log file cannot be opened, or another process has it.
    """

    def __init__(self, options: Options, on_output_error: Callable[[OSError], bool]) -> None:
        super().__init__()
        self._options = options
        self.levels: Levels = levels_of(options)
        self._on_output_error = on_output_error
        self._now_ns: Callable[[], int] = time.time_ns
        self._kernel: Kernel | None = None
        self._failures: dict[str, tuple[str, int]] = {}
        """The last failure of each component: the context, and the time in nanoseconds."""
        self._file: LogFile | None = None

    # -- from beginning to end -------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        path = self._options.log_file
        if path is not None:
            self._file = LogFile(path, lambda what: report("E-LOG", what), self._lost)
        root, components = logging.getLogger(), logging.getLogger("aiorts.component")
        self._before = root.level, components.level
        root.addHandler(self)
        root.setLevel(self.levels.default)
        components.setLevel(self.levels.lowest)
        return self

    def __exit__(self, *_: object) -> None:
        root, components = logging.getLogger(), logging.getLogger("aiorts.component")
        root.removeHandler(self)
        root.setLevel(self._before[0])
        components.setLevel(self._before[1])
        if self._file is not None:
            self._file.close()
        self.close()

    def attach(self, kernel: Kernel) -> None:
        """Take lines of this kernel's system from now on, by this kernel's clock."""
        from aiorts.events import ComponentAdded, HookFailed

        self._kernel = kernel
        self._now_ns = kernel.time_ns
        kernel.bus.subscribe(HookFailed, self._note_failure)
        if self.levels.components:
            kernel.bus.subscribe(ComponentAdded, self._set_level)

    def _note_failure(self, event: HookFailed) -> None:
        self._failures[event.component] = event.context, self._now_ns()

    def has_failed(self, component: str, *, just_now: bool) -> bool:
        """Whether a failure of this component was logged; `just_now`: within the last second, its line in sight."""
        if component not in self._failures:
            return False
        return not just_now or self._now_ns() - self._failures[component][1] < 1_000_000_000

    def _set_level(self, event: ComponentAdded) -> None:
        """Give a component a logger of its own, unknown to logging: lines below its level are not even counted."""
        assert self._kernel is not None  # noqa: S101 - the kernel's bus calls this
        log = self._kernel.components[event.component].log
        logger = logging.Logger(log.logger.name, self.levels.of(event.component))
        logger.parent = log.logger
        log.logger = logger

    # -- what is said ----------------------------------------------------------------------------------------------

    def tell(self, code: str, message: str, *, component: str = "", level: str = "error") -> None:
        """Log a line of the command itself."""
        self._write(Line(self._now_ns(), level, message, component, code=code))

    def failed(self, error: BaseException) -> None:
        """Log that the run failed, and why."""
        advice = advice_on(error, debug=self._options.debug)
        message = f"{place_of(error)}{cause_of(error)}{in_brackets(origin_of(error))}"
        self._write(Line(self._now_ns(), "error", message, code=code_of(error), error=error, advice=advice))

    def refused(self, error: BaseException, findings: Iterable[Finding]) -> None:
        """Log that a system file cannot run: all its errors that were found."""
        found, text = list(findings), str(error).replace("\n", " ")
        same = [one for one in found if one.cause in text]
        if all(one.where.startswith("--set") for one in same):  # the error has the place in the typed text
            self.failed(error)
            found = [one for one in found if one not in same]
        for one in found:
            line = Line(self._now_ns(), "error", finding_text(one), code=one.code, below=tuple(below(one)))
            if one in same and one.code == ComponentError.code:
                line = replace(line, error=error, advice=advice_on(error, debug=self._options.debug))
            self._write(line)

    def emit(self, record: logging.LogRecord) -> None:
        """Log a record; never raises, since `handleError` of logging would print an unwanted traceback."""
        component = str(getattr(record, "component", ""))
        error = record.exc_info[1] if record.exc_info else None
        if record.levelno < self.levels.of(component):
            return
        if isinstance(error, OSError) and self._on_output_error(error):
            return
        self._write(self._line(record, component, error))

    def _line(self, record: logging.LogRecord, component: str, error: BaseException | None) -> Line:
        level, hook = record.levelname.lower(), str(getattr(record, "hook", ""))
        context = self._failures.get(component, ("", 0))[0] if error is not None else self._context_of(component)
        if error is None or not component:
            return Line(self._now_ns(), level, _message(record), component, context, hook, error=error)
        times = str(getattr(record, "folded", ""))
        advice = advice_on(error, debug=self._options.debug)
        hook = _message(record).partition(" failed")[0].removeprefix(f"{component}.")
        cause = f"{cause_of(error)}{in_brackets(origin_of(error, installed=True))}"
        return Line(self._now_ns(), level, cause, component, context, hook, code_of(error), error, advice, times)

    def _context_of(self, component: str) -> str:
        """The context of a component that is in exactly one, else ""."""
        found = None if self._kernel is None else self._kernel.components.get(component)
        contexts = () if found is None else found.contexts
        return contexts[0].name if len(contexts) == 1 else ""

    # -- where it goes ---------------------------------------------------------------------------------------------

    def _write(self, line: Line) -> None:
        as_json = self._options.log_format == "json"
        form = _as_json if as_json else _as_text
        trace = "" if line.error is None or not self._options.debug else _trace(line.error)
        if self._file is not None:
            self._file.write(form(line, trace))
            if line.level in ("debug", "info"):
                return
        say(*([_as_json(line, trace)] if as_json else _for_a_person(line, trace)))

    def _lost(self, count: int) -> str:
        line = Line(self._now_ns(), "warning", f"{count} lines lost: the log file could not be written", code="E-LOG")
        return _as_json(line, "") if self._options.log_format == "json" else _as_text(line, "")


def _for_a_person(line: Line, trace: str) -> list[str]:
    text = shortened(f"aiorts: {line.code or line.level}: {line.where}{line.message}{line.times}{line.advice}")
    marked = [] if line.error is None or line.component else [f"  {part}" for part in marked_in(line.error)]
    return [text, *marked, *line.below, *([trace] if trace else [])]


def _as_text(line: Line, trace: str) -> str:
    what = f"{line.code}: " if line.code else ""
    text = one_line(f"{_time(line.time_ns)} {line.level} {what}{line.where}{line.message}{line.times}")
    return f"{text}\n{trace}" if trace else text


def _as_json(line: Line, trace: str) -> str:
    found: dict[str, Any] = {
        "time": _time(line.time_ns),
        "level": line.level,
        "component": line.component or None,
        "context": line.context or None,
        "hook": line.hook or None,
        "code": line.code or None,
        "message": f"{line.message}{line.times}",
    }
    if trace:
        found["traceback"] = trace
    return json.dumps(found)


def _time(time_ns: int) -> str:
    seconds, rest = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1000:06}Z"


def _trace(error: BaseException) -> str:
    return "".join(traceback.format_exception(error)).rstrip()


def _message(record: logging.LogRecord) -> str:
    try:
        return record.getMessage()
    except (TypeError, ValueError, KeyError) as error:
        return f"{record.msg} ({error})"
