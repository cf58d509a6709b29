"""Runs a recording in the background: a thread of its own opens the file, supervises it and closes it.

Samples that come before the file is open, and large batches, wait in a queue with the bounds of the writer's own. Any
error is stored in `failure`, and notified once.
"""

from __future__ import annotations

import os
import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import sleep
from typing import Any, Final, NamedTuple, TypeAlias

from aiorts_log.errors import RecordingError
from aiorts_log.recorder.options import RecordingOptions, RecordingStatistics
from aiorts_log.recorder.target import continuing
from aiorts_log.recorder.weight import SMALL, weigher
from aiorts_log.recorder.writer import RecordingWriter

MakeWriter: TypeAlias = Callable[..., RecordingWriter]
"""Opens the file: called with its path, and options, metadata and attachments by name, as RecordingWriter is."""
_LOOK: Final = 0.25
"""Seconds between two checks of the recording."""
_AT_ONCE: Final = 500
"""Samples that `write` hands to the writer itself; the thread hands on larger batches."""
_TURN: Final = 100
"""Samples after which the thread lets others have the interpreter; the loop would wait 5 ms for it otherwise."""
_YIELD: Final = 1e-5
_AHEAD: Final = 0.1
"""The load up to which the writer's queue is filled: the garbage collector's pauses grow with the live objects."""
_MOST_NAMED: Final = 8
_PAUSE: Final = 0.001
_WEIGHED: Final = 8
"""Samples of a batch whose weight is measured."""


class Notice(NamedTuple):
    """A notification of the thread. kind: "open", "dropped", "refused", "gone", "failed" or "closed"."""

    kind: str
    text: str = ""


class _Batch(NamedTuple):
    """Samples of one port with one log time, and the approximate bytes of each."""

    port: int
    records: Sequence[Any]
    log_time: int
    each: int


class _Port(NamedTuple):
    """The declaration of a port, and the function that weighs its samples."""

    name: str
    cls: type
    metadata: Mapping[str, str]
    weigh: Callable[[Any], int] | None


class BackgroundRecording:
    """A recording whose file is opened and closed in the background.

    Args:
        path, options, metadata, attachments: see `RecordingWriter`.
        owner: stored for the caller, not used here.
        notify: called in the thread with each notice; it must not wait.
        after: a recording that must be closed before this one is opened; its file, if it is the same, is continued.
        make: opens the file.

    Attributes:
        failure: why it has ended, or was never opened; None while it works.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        options: RecordingOptions,
        *,
        metadata: Mapping[str, Any] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        owner: object = None,
        notify: Callable[[Notice], None],
        after: BackgroundRecording | None = None,
        make: MakeWriter = RecordingWriter,
    ) -> None:
        self.path = Path(path)
        self.options = options
        self._make = partial(make, self.path, metadata=metadata, attachments=attachments)
        self.owner = owner
        self._notify = notify
        self._after = after
        self.part = options.part
        """Number of the file that was written last."""
        self.made = False
        """Whether the file is there because of this recording, or of the one before it."""
        self._ports: list[_Port] = []
        self._batches: deque[_Batch] = deque()
        self._waiting = self._waiting_bytes = 0
        """Samples and bytes in the batches."""
        self._lost_before = 0
        self._dropped: Counter[int] = Counter()
        """By port, the samples that found no room among the batches and are not yet counted by the writer."""
        self._lock = threading.Lock()
        self._writer: RecordingWriter | None = None
        self._direct: RecordingWriter | None = None
        """The writer, while no batch waits that the writer has to get first."""
        self.failure: RecordingError | None = None
        self._remarks: Mapping[str, Any] = {}
        self._wake, self._ordered = threading.Event(), False
        self._opened, self._closed = threading.Event(), threading.Event()
        self._reported_drops = False
        self._reported_refusals: set[str] = set()
        """The ports whose first refused sample was notified."""
        self._reported_displaced: Path | None = None
        self._thread = threading.Thread(target=self._work, name=f"recorder {self.path.name}", daemon=True)
        self._thread.start()

    def add_port(self, name: str, cls: type, metadata: Mapping[str, str]) -> int:
        """Record a port from now on; returns its number, the same for the same port."""
        with self._lock:
            for number, known in enumerate(self._ports):
                if (known.name, known.cls) == (name, cls):
                    return number
            self._ports.append(_Port(name, cls, metadata, weigher(cls)))
            if self._writer is not None:
                self._writer.add_port(name, cls, metadata)
            return len(self._ports) - 1

    def type_of(self, name: str) -> type | None:
        """The type that the samples of a port are recorded as; None when there is no such port."""
        return next((port.cls for port in self._ports if port.name == name), None)

    def write(self, port: int, records: Sequence[Any], log_time: int) -> None:
        """Record samples of a port; from one thread at a time, never waiting. Samples without room are counted."""
        writer = self._direct
        if writer is None or len(records) > _AT_ONCE:
            writer = self._put(port, records, log_time)
        if writer is not None:
            for record in records:
                writer.write(port, record, log_time)

    def _put(self, port: int, records: Sequence[Any], log_time: int) -> RecordingWriter | None:
        """Queue samples for the thread; returns the writer when it can take these few at once."""
        with self._lock:  # the thread may set `_direct` at this moment
            if self._direct is not None and len(records) <= _AT_ONCE:
                return self._direct
            each = self._weight(port, records)
            free = 0.0 if self._closed.is_set() else max(0.0, 1.0 - self.load)
            room = int(min(free * self.options.queue, free * self.options.queue_bytes / each))
            if room < len(records):
                self._dropped[port] += len(records) - room
                records = records[:room]
            if records:
                self._waiting += len(records)
                self._waiting_bytes += each * len(records)
                self._batches.append(_Batch(port, records, log_time, each))
                self._direct = None
        self._wake.set()
        return None

    def _weight(self, port: int, records: Sequence[Any]) -> int:
        """The approximate bytes of one of these samples, on average."""
        weigh = self._ports[port].weigh
        if weigh is None or not records:
            return SMALL
        some = records[:: -(-len(records) // _WEIGHED)]
        return sum(map(weigh, some)) // len(some)

    def belong(self, owner: object, notify: Callable[[Notice], None]) -> None:
        """Give the recording another owner, who is notified from now on."""
        self.owner, self._notify = owner, notify

    @property
    def is_ordered(self) -> bool:
        """Whether `close` was called."""
        return self._ordered

    @property
    def load(self) -> float:
        """The load of the queue, from 0 to 1 when it is full."""
        own = max(self._waiting / self.options.queue, self._waiting_bytes / self.options.queue_bytes)
        return own + (0.0 if self._writer is None else self._writer.load)

    @property
    def statistics(self) -> RecordingStatistics:
        """The counts of samples up to now."""
        with self._lock:
            found = RecordingStatistics(files=0) if self._writer is None else self._writer.statistics
            dropped = Counter(found.dropped)
            for port, count in self._dropped.items():
                dropped[self._ports[port].name] += count
            offered = found.offered + self._waiting + self._dropped.total()
        return replace(found, offered=offered, dropped=dict(dropped))

    @property
    def lost(self) -> int:
        """Samples that are not in the file, including those of the recordings before; 0 after a failure."""
        found = RecordingStatistics() if self.failure is not None else self.statistics
        return self._lost_before + sum(found.dropped.values()) + sum(found.refused.values())

    @property
    def is_closed(self) -> bool:
        """Whether the file was closed."""
        return self._closed.is_set()

    def wait_open(self, seconds: float | None) -> None:
        """Block the thread until the file is open, for at most `seconds`. RecordingError when it cannot be opened."""
        self._opened.wait(seconds)
        if self.failure is not None:
            raise self.failure

    def flush(self) -> None:
        """Block the thread until all samples written are in the file, or the recording has ended."""
        self._opened.wait()
        while self._batches and not self._closed.is_set():
            sleep(_PAUSE)
        if (writer := self._writer) is not None:
            writer.flush()

    def close(self, remarks: Mapping[str, Any] | None = None) -> None:
        """Request the end without waiting for it; `remarks` go into the recording's end report."""
        if not self._ordered:
            self._remarks = remarks or {}
            self._ordered = True
            self._wake.set()

    def wait_closed(self, seconds: float | None = None) -> bool:
        """Block the thread until the file is closed, for at most `seconds`; return whether it is."""
        closed = self._closed.wait(seconds)
        if closed and threading.current_thread() is not self._thread:
            self._thread.join(seconds)  # all it still does is to notify
        return closed

    # -- the thread ------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        orderly = False
        try:
            if self._after is not None:
                self._after.wait_closed()
                self.made = self._after.made and self._after.path == self.path
                self.part, self._lost_before = self._after.part, self._after.lost
                self._after = None
            try:
                self._look_after(self._open())
            except RecordingError as error:
                self.failure = error
            orderly = True
        finally:
            if not orderly:
                self.failure = RecordingError(f"{self.path}: recording ended: its thread failed")
            self._opened.set()
            self._closed.set()
            if self.failure is not None:
                self._notify(Notice("failed", str(self.failure)))
            self._notify(Notice("closed"))

    def _open(self) -> RecordingWriter:
        ours = replace(self.options, existing="append", part=self.part)
        writer = self._make(options=ours if self.made else continuing(self.options, self.path))
        self.made = True
        with self._lock:
            for port in self._ports:
                writer.add_port(port.name, port.cls, port.metadata)
            self._writer = writer
        self._opened.set()
        self._notify(Notice("open"))
        return writer

    def _look_after(self, writer: RecordingWriter) -> None:
        self._hand_on(writer)
        while not self._ordered and writer.failure is None:
            self._wake.wait(_LOOK)
            self._wake.clear()
            self._hand_on(writer)
            self._look(writer)
        self._hand_on(writer)
        writer.remarks.update(self._remarks)
        writer.close()
        self.part = writer.part
        found = writer.statistics
        self._report_drops(writer, found)
        self._report_refusals(found)
        self.failure = writer.failure

    def _hand_on(self, writer: RecordingWriter) -> None:
        """Give the batches to the writer as fast as it takes them, until none is left or it has ended."""
        turn = _TURN
        while (batch := self._next(writer)) is not None:
            handed = 0
            while handed < len(batch.records) and writer.failure is None:
                some = batch.records[handed : handed + turn]
                for record in some:
                    while writer.load > _AHEAD and writer.failure is None:
                        sleep(_PAUSE)
                    writer.write(batch.port, record, batch.log_time)
                handed += len(some)
                turn -= len(some)
                with self._lock:
                    self._waiting -= len(some)
                    self._waiting_bytes -= len(some) * batch.each
                if not turn:
                    sleep(_YIELD)
                    turn = _TURN
            with self._lock:
                self._batches.popleft()
                if handed < len(batch.records):
                    self._batches.appendleft(batch._replace(records=batch.records[handed:]))

    def _next(self, writer: RecordingWriter) -> _Batch | None:
        """The batch to hand on. When the writer has ended, all batches are dropped: its failure is notified soon."""
        with self._lock:
            if writer.failure is not None:
                for batch in self._batches:
                    self._dropped[batch.port] += len(batch.records)
                self._batches.clear()
                self._waiting = self._waiting_bytes = 0
            for port, count in self._dropped.items():
                writer.drop(port, count)
            self._dropped.clear()
            if not self._batches:
                self._direct = writer
                return None
            return self._batches[0]

    def _look(self, writer: RecordingWriter) -> None:
        found = writer.statistics  # counts all ports, at each call
        self._report_drops(writer, found)
        self._report_refusals(found)
        path, what = writer.displaced
        if what and path != self._reported_displaced:
            self._reported_displaced = path
            text = f"{path}: was {what} while it is recorded; what comes goes where it was moved to, or is lost"
            self._notify(Notice("gone", text))

    def _report_refusals(self, found: RecordingStatistics) -> None:
        for name, reasons in found.reasons.items():
            if name not in self._reported_refusals:
                self._reported_refusals.add(name)
                text = f"{self.path}: a sample of {name} is not recorded: {next(iter(reasons))}"
                self._notify(Notice("refused", text))

    def _report_drops(self, writer: RecordingWriter, found: RecordingStatistics) -> None:
        if writer.failure is not None or self._reported_drops:
            return  # the failure explains the drops after it
        if found.dropped:
            self._reported_drops = True
            ports = ", ".join(f"{count} of {name}" for name, count in list(found.dropped.items())[:_MOST_NAMED])
            more = len(found.dropped) - _MOST_NAMED
            text = f"samples are dropped, {ports}{f' and of {more} more' if more > 0 else ''} so far"
            helps = "the disk is too slow: record fewer ports, or use a faster disk"
            self._notify(Notice("dropped", f"{self.path}: {text}; {helps}"))
