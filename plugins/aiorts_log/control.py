"""A recording that nobody waits for: a thread of its own opens it, looks after it and closes it.

What is written before the file is there waits in a queue with the bounds of the writer's own. What goes wrong, at
whatever moment, is `failure`, and told once.
"""

from __future__ import annotations

import os
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from time import sleep
from typing import Any, Final, NamedTuple, TypeAlias

from aiorts_log.errors import RecordingError
from aiorts_log.options import RecordingOptions, RecordingStatistics
from aiorts_log.writer import RecordingWriter

__all__ = ("BackgroundRecording", "MakeWriter", "Notice", "Offered")

MakeWriter: TypeAlias = Callable[..., RecordingWriter]
"""What opens the file: called with path, options, metadata and attachments as RecordingWriter is."""
Offered: TypeAlias = tuple[int, Any, int]
"""A sample: number of its port, the record, its log time."""
_LOOK: Final = 0.25
"""Seconds from one look at the recording to the next."""
_AT_ONCE: Final = 256
_PAUSE: Final = 0.002


class Notice(NamedTuple):
    """What the thread has to say. kind: "open", "dropped", "gone", "failed" or "closed"."""

    kind: str
    text: str = ""


class BackgroundRecording:
    """A recording whose file is opened and closed in the background.

    Args:
        path, options, metadata, attachments: see `RecordingWriter`.
        tell: called in the thread with each notice; it must not wait for anything.
        after: a recording that has to be closed before this one is opened.
        make: what opens the file.

    Attributes:
        failure: why it has ended, or was never opened; None as long as all is well.
        statistics: what became of the samples; of the writer, once there is one.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        options: RecordingOptions,
        *,
        metadata: Mapping[str, Any] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        tell: Callable[[Notice], None],
        after: BackgroundRecording | None = None,
        make: MakeWriter = RecordingWriter,
    ) -> None:
        self.path = Path(path)
        self.options = options
        self._make: Callable[[], RecordingWriter] = partial(
            make, self.path, options, metadata=metadata, attachments=attachments
        )
        self._tell = tell
        self._after = after
        self._ports: list[tuple[str, type, Mapping[str, str]]] = []
        self._early: deque[Offered] = deque()
        self._early_dropped: Counter[int] = Counter()
        self._lock = threading.Lock()
        self._writer: RecordingWriter | None = None
        self.failure: RecordingError | None = None
        self._order = threading.Event()
        self._rest: Iterable[Offered] = ()
        self._remarks: Mapping[str, Any] = {}
        self._opened, self._closed = threading.Event(), threading.Event()
        self._told_drops = False
        self._told_displaced: Path | None = None
        self._thread = threading.Thread(target=self._work, name=f"recorder {self.path.name}", daemon=True)
        self._thread.start()

    def add_port(self, name: str, cls: type, metadata: Mapping[str, str]) -> int:
        """Record a port from now on; returns the number to give to `write`."""
        with self._lock:
            self._ports.append((name, cls, metadata))
            if self._writer is not None:
                self._writer.add_port(name, cls, metadata)
            return len(self._ports) - 1

    def write(self, port: int, record: Any, log_time: int) -> None:
        """Record a sample; from one thread at a time, and never waiting. What is dropped is counted."""
        writer = self._writer
        if writer is None:
            with self._lock:
                writer = self._writer
                if writer is None:
                    if len(self._early) < self.options.queue and not self._closed.is_set():
                        self._early.append((port, record, log_time))
                    else:
                        self._early_dropped[port] += 1
                    return
        writer.write(port, record, log_time)

    @property
    def load(self) -> float:
        """How full the queue is, from 0 to 1."""
        writer = self._writer
        return len(self._early) / self.options.queue if writer is None else writer.load

    @property
    def statistics(self) -> RecordingStatistics:
        """What became of the samples up to now."""
        writer = self._writer
        if writer is None:
            dropped: Counter[str] = Counter()
            for port, count in list(self._early_dropped.items()):
                dropped[self._ports[port][0]] += count
            return RecordingStatistics(len(self._early) + dropped.total(), dropped=dropped, files=0)
        return writer.statistics

    @property
    def is_closed(self) -> bool:
        """Whether the file was let go."""
        return self._closed.is_set()

    def wait_open(self, seconds: float | None) -> None:
        """Block the thread until the file is open, at most so long. RecordingError when it cannot be had."""
        self._opened.wait(seconds)
        if self.failure is not None:
            raise self.failure

    def flush(self) -> None:
        """Block the thread until all that was given is in the file, or the recording has ended."""
        self._opened.wait()
        if (writer := self._writer) is not None:
            writer.flush()

    def close(self, rest: Iterable[Offered] = (), remarks: Mapping[str, Any] | None = None) -> None:
        """Ask for the end and do not wait for it.

        Args:
            rest: what is still to be recorded, by the thread, which waits for room.
            remarks: what else is to be said at the end of the recording.
        """
        if not self._order.is_set():
            self._rest, self._remarks = rest, remarks or {}
            self._order.set()

    def wait_closed(self, seconds: float | None = None) -> bool:
        """Block the thread until the file was let go, at most so long; whether it was."""
        return self._closed.wait(seconds)

    # -- the thread ------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        orderly = False
        try:
            if self._after is not None:
                self._after.wait_closed()
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
                self._tell(Notice("failed", str(self.failure)))
            self._tell(Notice("closed"))

    def _open(self) -> RecordingWriter:
        """Open the file and put in what has come until then."""
        writer = self._make()
        known = 0
        while True:
            with self._lock:
                for declared in self._ports[known:]:
                    writer.add_port(*declared)
                known = len(self._ports)
                for _ in range(min(_AT_ONCE, len(self._early))):
                    writer.write(*self._early.popleft())
                if not self._early:
                    for port, count in self._early_dropped.items():
                        writer.drop(port, count)
                    self._writer = writer
                    break
        self._opened.set()
        self._tell(Notice("open"))
        return writer

    def _look_after(self, writer: RecordingWriter) -> None:
        while not self._order.wait(_LOOK) and writer.failure is None:
            self._look(writer)
        for offered in self._rest:
            while writer.load > 0.9 and writer.failure is None:
                sleep(_PAUSE)
            writer.write(*offered)
        writer.remarks.update(self._remarks)
        writer.close()
        self._tell_drops(writer.statistics)
        self.failure = writer.failure

    def _look(self, writer: RecordingWriter) -> None:
        self._tell_drops(writer.statistics)
        path, what = writer.displaced
        if what and path != self._told_displaced:
            self._told_displaced = path
            text = f"{path}: was {what} while it is recorded; what comes goes where it was moved to, or is lost"
            self._tell(Notice("gone", text))

    def _tell_drops(self, found: RecordingStatistics) -> None:
        if found.dropped and not self._told_drops and self.failure is None:
            self._told_drops = True
            ports = ", ".join(f"{count} of {name}" for name, count in found.dropped.items())
            self._tell(Notice("dropped", f"{self.path}: samples are dropped, {ports} so far; the disk is too slow"))
