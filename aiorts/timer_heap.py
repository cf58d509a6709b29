"""Timers in the order (deadline, rank, creation), and holds on a clock: data that neither waits nor asks the time.

Timers are fired elsewhere: real ones by `aiorts.kernel.loop.timers`, simulated ones by the driver of the clock.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable
    from types import TracebackType
    from typing import Self


class Timer:
    """One callback that waits for its deadline. `cancel()` is idempotent and allowed at any time."""

    __slots__ = ("_call", "_heap", "deadline_ns")

    def __init__(self, deadline_ns: int, callback: Callable[[], object], heap: TimerHeap) -> None:
        self.deadline_ns = deadline_ns
        self._call: Callable[[], object] | None = callback
        self._heap: TimerHeap | None = heap

    @property
    def pending(self) -> bool:
        """Whether it has neither fired nor been cancelled."""
        return self._call is not None

    def cancel(self) -> None:
        """Cancel the callback; without effect when it has run."""
        self._call = None
        if (heap := self._heap) is not None:
            self._heap = None
            heap.forget_one()

    def __repr__(self) -> str:
        return f"<Timer at {self.deadline_ns} ns, {'pending' if self.pending else 'done'}>"


_Entry = tuple[int, int, int, Timer]
"""Deadline, rank, number in the order of creation (always different: timers are never compared), timer."""


class TimerHeap:
    """Timers by (deadline, rank, creation): a plain data structure that neither waits nor asks the time.

    Cancelled timers leave when they reach the top, or all at once when they outnumber the others.
    """

    __slots__ = ("_cancelled", "_entries", "_on_empty", "_sequence")

    def __init__(self, on_empty: Callable[[], None] | None = None) -> None:
        self._entries: list[_Entry] = []
        self._sequence = 0
        self._cancelled = 0
        self._on_empty = on_empty

    def __len__(self) -> int:
        """Pending timers."""
        return len(self._entries) - self._cancelled

    @property
    def slots(self) -> int:
        """Entries held, cancelled ones included: never above twice the pending ones plus a few."""
        return len(self._entries)

    def push(self, deadline_ns: int, callback: Callable[[], object], rank: int = 0) -> Timer:
        """A new timer. `rank` orders timers of one deadline before their creation does."""
        timer = Timer(deadline_ns, callback, self)
        self._sequence = sequence = self._sequence + 1
        heapq.heappush(self._entries, (deadline_ns, rank, sequence, timer))
        return timer

    def next_deadline(self) -> int | None:
        """The earliest deadline that is still pending."""
        entries = self._entries
        while entries:
            if entries[0][3]._heap is not None:
                return entries[0][0]
            heapq.heappop(entries)
            self._cancelled -= 1
        return None

    def run_due(self, now_ns: int, loop: asyncio.AbstractEventLoop) -> None:
        """Run, in order, all timers whose deadline is not after `now_ns`; ones added meanwhile wait for the next call.

        A callback that raises goes to the loop's exception handler and the others run. An exception that stops the loop
        (KeyboardInterrupt) is passed on, and later timers stay pending.
        """
        due = self._pop_due(now_ns)
        if not due:
            return
        entries = iter(due)
        try:
            for entry in entries:
                timer = entry[3]
                callback, timer._call = timer._call, None
                if callback is not None:
                    try:
                        callback()
                    except Exception as error:  # noqa: BLE001 - reported, as the loop does with its own callbacks
                        message = f"aiorts: timer callback {callback!r} failed"
                        loop.call_exception_handler({"message": message, "exception": error})
        finally:
            for entry in entries:
                self._restore(entry)

    def _pop_due(self, now_ns: int) -> list[_Entry]:
        entries = self._entries
        due: list[_Entry] = []
        while entries and entries[0][0] <= now_ns:
            entry = heapq.heappop(entries)
            if entry[3]._heap is None:
                self._cancelled -= 1
            else:
                entry[3]._heap = None
                due.append(entry)
        return due

    def _restore(self, entry: _Entry) -> None:
        if entry[3].pending:
            entry[3]._heap = self
            heapq.heappush(self._entries, entry)

    def forget_one(self) -> None:
        """Count a timer of this heap as cancelled; the timer calls this."""
        self._cancelled += 1
        if self._cancelled > 8 and self._cancelled * 2 > len(self._entries):
            self._entries = [entry for entry in self._entries if entry[3]._heap is not None]
            heapq.heapify(self._entries)
            self._cancelled = 0
        if self._on_empty is not None and self._cancelled == len(self._entries):
            self._on_empty()


class Hold:
    """Keeps a simulated clock where it is until released; a context manager. May be released in any thread."""

    __slots__ = ("_release",)

    def __init__(self, release: Callable[[], None]) -> None:
        self._release: Callable[[], None] | None = release

    def release(self) -> None:
        """Let time pass again, unless it is held elsewhere, too; idempotent."""
        release, self._release = self._release, None
        if release is not None:
            release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()
