"""The status line at the bottom of the terminal, rewritten a few times in a second.

A thread draws the line, so that it also shows when the loop is held up; the figures come from the loop. The line is
erased before other output through `sys.stdout` and `sys.stderr`. The modes of the terminal are not changed, and the
program never waits for a stopped terminal.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, Final, Self

from aiorts import LifecycleState
from aiorts.late import dataclass

if TYPE_CHECKING:
    from aiorts import Kernel

_PERIOD: Final = 0.25
_HELD: Final = 1.0
"""Seconds without an answer of the loop after which the line shows that it is held up."""
_SHARE: Final = 100
"""The loop spends at most one in so many seconds on the figures, for any size of the system."""
_ERASE: Final = b"\r\x1b[K"


@dataclass(frozen=True, slots=True)
class Figures:
    """The figures of the line at one moment."""

    active: int = 0
    in_error: int = 0
    delivered: int = 0
    dropped: int = 0
    late_ns: int | None = None
    """The worst lateness of all contexts with a rate; None without any."""
    overruns: int = 0
    silent: int = 0
    """Connectors with `max_gap` whose writers are silent."""


def is_wanted() -> bool:
    """Whether standard error is a terminal that can rewrite a line."""
    try:
        shown = sys.stderr is not None and os.isatty(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):
        return False
    return shown and os.environ.get("TERM", "") not in ("", "dumb", "unknown")


def text_of(elapsed_s: float, now: Figures, rate: float | None, held_s: float = 0.0) -> list[str]:
    """The parts of the line, the most important first; `rate` is samples in a second, `elapsed_s` the system's time."""
    minutes, seconds = divmod(int(elapsed_s), 60)
    parts = [f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"]
    if held_s:
        parts.append(f"loop held up for {held_s:.0f} s")
    parts.append(f"{now.active} active")
    if now.in_error:
        parts.append(f"{now.in_error} in error")
    if now.silent:
        parts.append(f"{now.silent} silent")
    parts.append("" if rate is None else f"{rate:.0f} samples/s")
    parts.append(f"{now.dropped} dropped")
    if now.late_ns is not None:
        parts.append(f"late {now.late_ns / 1e6:.1f} ms at worst")
        parts.append(f"{now.overruns} overruns")
    return [part for part in parts if part]


def fitted(parts: Iterable[str], columns: int) -> str:
    """As many whole parts as fit before the cursor; the first part is cut."""
    line = ""
    for part in parts:
        longer = f"{line}  {part}" if line else part[: max(0, columns - 1)]
        if len(longer) > columns - 1:
            break
        line = longer
    return line


class StatusLine:
    """The status line during a `with` block, which is entered on the kernel's loop."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._loop = asyncio.get_running_loop()
        self._descriptor = sys.stderr.fileno()
        self._lock = threading.RLock()  # a signal's handler may interrupt a holder and need it, too
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._draw_always, name="aiorts status", daemon=True)
        self._drawn = False
        self._paused = 0
        self._midway = False
        """Whether other output left an unfinished line."""
        self._began_ns = kernel.clock.monotonic_ns()
        self._figures = Figures()
        self._rate: float | None = None
        self._asked = self._answered = time.monotonic()
        self._waits = False
        self._pause_s = _PERIOD

    def __enter__(self) -> Self:
        self._streams = sys.stdout, sys.stderr
        sys.stderr = _guarded(sys.stderr, self)
        sys.stdout = _guarded(sys.stdout, self)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(1.0)
        self.erase()
        sys.stdout, sys.stderr = self._streams

    # -- drawing ---------------------------------------------------------------------------------------------------

    def erase(self) -> None:
        """Erase the line until it is drawn the next time; never waits for long."""
        if self._lock.acquire(timeout=0.1):
            try:
                if self._drawn and self._can_write():
                    self._put(_ERASE)
                    self._drawn = False
            finally:
                self._lock.release()

    @contextlib.contextmanager
    def hidden(self, text: str = "\n") -> Iterator[None]:
        """Hide the line while `text` is written."""
        with self._lock:
            self.erase()
            yield
            if text:
                self._midway = not text.endswith("\n")

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """Hide the line and restore the original streams during the block."""
        self._paused += 1
        self.erase()
        guarded = sys.stdout, sys.stderr
        sys.stdout, sys.stderr = self._streams
        try:
            yield
        finally:
            sys.stdout, sys.stderr = guarded
            self._paused -= 1

    def _draw_always(self) -> None:
        while not self._ended.wait(_PERIOD):
            self._ask()
            with self._lock:
                if not (self._paused or self._midway or self._ended.is_set()) and self._may_draw():
                    self._draw()

    def _draw(self) -> None:
        held_s = time.monotonic() - self._asked if self._waits else 0.0
        elapsed_s = (self._kernel.clock.monotonic_ns() - self._began_ns) / 1e9
        parts = text_of(elapsed_s, self._figures, self._rate, held_s if held_s >= _HELD else 0.0)
        if line := fitted(parts, self._columns()):
            self._put(b"\r" + line.encode("ascii", "replace") + b"\x1b[K")
            self._drawn = True

    def _may_draw(self) -> bool:
        try:
            if os.tcgetpgrp(self._descriptor) != os.getpgrp():
                return False  # in the background of a shell: the terminal belongs to another process
        except OSError:
            pass  # not the controlling terminal of this process
        return self._can_write()

    def _can_write(self) -> bool:
        try:
            return bool(select.select([], [self._descriptor], [], 0)[1])
        except (OSError, ValueError):
            return False

    def _put(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._descriptor, data)

    def _columns(self) -> int:
        stated = os.environ.get("COLUMNS", "")
        if stated.isascii() and stated.isdigit() and int(stated):
            return int(stated)
        try:
            return os.get_terminal_size(self._descriptor).columns or 80
        except OSError:
            return 80

    # -- figures ---------------------------------------------------------------------------------------------------

    def _ask(self) -> None:
        now = time.monotonic()
        if self._waits or now - self._answered < self._pause_s:
            return
        self._asked, self._waits = now, True
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._count)

    def _count(self) -> None:
        """Take new figures; on the loop."""
        began = time.monotonic()
        figures = figures_of(self._kernel)
        passed = began - self._answered
        fresh = figures.delivered - self._figures.delivered
        if passed > 0:
            self._rate = max(0.0, fresh / passed)
        self._figures, self._answered, self._waits = figures, began, False
        self._pause_s = max(_PERIOD * 0.9, _SHARE * (time.monotonic() - began))


def figures_of(kernel: Kernel) -> Figures:
    """The present figures of the system; called on its loop."""
    active = in_error = delivered = dropped = overruns = silent = 0
    late_ns = None
    for component in kernel.components.values():
        states = component.states.values()
        active += LifecycleState.ACTIVE in states
        in_error += LifecycleState.ERROR in states
    for connector in kernel.connectors.values():
        ledger = connector.statistics
        delivered += ledger.arrived
        silent += ledger.silent
        dropped += sum(ledger.dropped.values())
    for context in kernel.contexts.values():
        figures = context.statistics
        if figures.policy:
            late_ns = max(late_ns or 0, figures.lateness_max_ns)
            overruns += figures.overruns
    return Figures(active, in_error, delivered, dropped, late_ns, overruns, silent)


def _guarded(stream: Any, line: StatusLine) -> Any:
    """A terminal's stream that hides the line during writes; other streams are returned as they are."""
    try:
        shown = stream is not None and os.isatty(stream.fileno())
    except (OSError, ValueError, AttributeError):
        return stream
    return _Guarded(stream, line) if shown else stream


class _Guarded:
    def __init__(self, stream: Any, line: StatusLine) -> None:
        self._stream = stream
        self._line = line

    def write(self, text: str) -> int:
        with self._line.hidden(text):
            return int(self._stream.write(text))

    def writelines(self, lines: Iterable[str]) -> None:
        for text in lines:
            self.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
