"""A recording that nobody waits for: a thread of its own opens it, looks after it and closes it.

What is written before the file is there, and what comes in large batches, waits in a queue with the bounds of the
writer's own, and the thread hands it on. What goes wrong, at whatever moment, is `failure`, and told once.
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
from aiorts_log.options import RecordingOptions, RecordingStatistics
from aiorts_log.target import continuing
from aiorts_log.weight import SMALL, weigher
from aiorts_log.writer import RecordingWriter

__all__ = ("BackgroundRecording", "MakeWriter", "Notice")

MakeWriter: TypeAlias = Callable[..., RecordingWriter]
"""What opens the file: called with its path, and options, metadata and attachments by name, as RecordingWriter is."""
_LOOK: Final = 0.25
"""Seconds from one look at the recording to the next."""
_AT_ONCE: Final = 500
"""Samples that are handed to the writer at once by who has them; the thread hands on what is more."""
_TURN: Final = 100
"""Samples after which the thread lets others have the interpreter; the loop would have it 5 ms later."""
_YIELD: Final = 1e-5
_AHEAD: Final = 0.1
"""How full the writer's queue is made: few live objects, since the garbage collector holds up everybody."""
_PAUSE: Final = 0.001
_WEIGHED: Final = 8
"""Samples of a batch that are weighed for all of it."""


class Notice(NamedTuple):
    """What the thread has to say. kind: "open", "dropped", "gone", "failed" or "closed"."""

    kind: str
    text: str = ""


class _Batch(NamedTuple):
    """Samples of one port with one log time, and how many octets each holds, about."""

    port: int
    records: Sequence[Any]
    log_time: int
    each: int


class _Port(NamedTuple):
    """What a port was declared as, and what weighs its samples."""

    name: str
    cls: type
    metadata: Mapping[str, str]
    weigh: Callable[[Any], int] | None


class BackgroundRecording:
    """A recording whose file is opened and closed in the background.

    Args:
        path, options, metadata, attachments: see `RecordingWriter`.
        owner: whose it is; nothing is done with that.
        tell: called in the thread with each notice; it must not wait for anything.
        after: a recording that has to be closed before this one is opened; a file that it made is continued.
        make: what opens the file.

    Attributes:
        failure: why it has ended, or was never opened; None as long as all is well.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        options: RecordingOptions,
        *,
        metadata: Mapping[str, Any] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        owner: object = None,
        tell: Callable[[Notice], None],
        after: BackgroundRecording | None = None,
        make: MakeWriter = RecordingWriter,
    ) -> None:
        self.path = Path(path)
        self.options = options
        self._make = partial(make, self.path, metadata=metadata, attachments=attachments)
        self.owner = owner
        self._tell = tell
        self._after = after
        self.part = options.part
        """Number of the file that was written last."""
        self.made = False
        """Whether the file is there because of this recording, or of the one before it."""
        self._ports: list[_Port] = []
        self._batches: deque[_Batch] = deque()
        self._waiting = self._octets = 0
        """Samples and octets in the batches."""
        self._dropped: Counter[int] = Counter()
        """By port, what found no room among the batches and was not yet counted by the writer."""
        self._lock = threading.Lock()
        self._writer: RecordingWriter | None = None
        self._direct: RecordingWriter | None = None
        """The writer, while there is no batch that it has to have before."""
        self.failure: RecordingError | None = None
        self._remarks: Mapping[str, Any] = {}
        self._wake, self._ordered = threading.Event(), False
        self._opened, self._closed = threading.Event(), threading.Event()
        self._told_drops = False
        self._told_displaced: Path | None = None
        self._thread = threading.Thread(target=self._work, name=f"recorder {self.path.name}", daemon=True)
        self._thread.start()

    def add_port(self, name: str, cls: type, metadata: Mapping[str, str]) -> int:
        """Record a port from now on; returns its number, which is the same again for the same port."""
        with self._lock:
            for number, known in enumerate(self._ports):
                if (known.name, known.cls) == (name, cls):
                    return number
            self._ports.append(_Port(name, cls, metadata, weigher(cls)))
            if self._writer is not None:
                self._writer.add_port(name, cls, metadata)
            return len(self._ports) - 1

    def type_of(self, name: str) -> type | None:
        """What the samples of a port are recorded as; None when there is none of that name."""
        return next((port.cls for port in self._ports if port.name == name), None)

    def write(self, port: int, records: Sequence[Any], log_time: int) -> None:
        """Record samples of a port; from one thread at a time, never waiting. What finds no room is counted."""
        writer = self._direct
        if writer is None or len(records) > _AT_ONCE:
            writer = self._put(port, records, log_time)
        if writer is not None:
            for record in records:
                writer.write(port, record, log_time)

    def _put(self, port: int, records: Sequence[Any], log_time: int) -> RecordingWriter | None:
        """Leave samples to the thread; the writer itself when it can take these few after all."""
        with self._lock:
            if self._direct is not None and len(records) <= _AT_ONCE:
                return self._direct
            each = self._weight(port, records)
            free = 0.0 if self._closed.is_set() else max(0.0, 1.0 - self.load)
            room = int(min(free * self.options.queue, free * self.options.queue_octets / each))
            if room < len(records):
                self._dropped[port] += len(records) - room
                records = records[:room]
            if records:
                self._waiting += len(records)
                self._octets += each * len(records)
                self._batches.append(_Batch(port, records, log_time, each))
                self._direct = None
        self._wake.set()
        return None

    def _weight(self, port: int, records: Sequence[Any]) -> int:
        """Octets that one of these samples holds on average, about."""
        weigh = self._ports[port].weigh
        if weigh is None or not records:
            return SMALL
        some = records[:: -(-len(records) // _WEIGHED)]
        return sum(map(weigh, some)) // len(some)

    def belong(self, owner: object, tell: Callable[[Notice], None]) -> None:
        """It is somebody else's from now on."""
        self.owner, self._tell = owner, tell

    @property
    def is_ordered(self) -> bool:
        """Whether it was asked to end."""
        return self._ordered

    @property
    def load(self) -> float:
        """How full the queue is, from 0 to 1."""
        own = max(self._waiting / self.options.queue, self._octets / self.options.queue_octets)
        return own + (0.0 if self._writer is None else self._writer.load)

    @property
    def statistics(self) -> RecordingStatistics:
        """What became of the samples up to now."""
        with self._lock:
            found = RecordingStatistics(files=0) if self._writer is None else self._writer.statistics
            dropped = Counter(found.dropped)
            for port, count in self._dropped.items():
                dropped[self._ports[port].name] += count
            offered = found.offered + self._waiting + self._dropped.total()
        return replace(found, offered=offered, dropped=dict(dropped))

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
        while self._batches and not self._closed.is_set():
            sleep(_PAUSE)
        if (writer := self._writer) is not None:
            writer.flush()

    def close(self, remarks: Mapping[str, Any] | None = None) -> None:
        """Ask for the end and do not wait for it; `remarks` are said at the end of the recording."""
        if not self._ordered:
            self._remarks = remarks or {}
            self._ordered = True
            self._wake.set()

    def wait_closed(self, seconds: float | None = None) -> bool:
        """Block the thread until the file was let go, at most so long; whether it was."""
        return self._closed.wait(seconds)

    # -- the thread ------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        orderly = False
        try:
            if self._after is not None:
                self._after.wait_closed()
                self.made = self._after.made and self._after.path == self.path
                self.part = self._after.part
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
        ours = replace(self.options, existing="append", part=self.part)
        writer = self._make(options=ours if self.made else continuing(self.options, self.path))
        self.made = True
        with self._lock:
            for port in self._ports:
                writer.add_port(port.name, port.cls, port.metadata)
            self._writer = writer
        self._hand_on(writer)
        self._opened.set()
        self._tell(Notice("open"))
        return writer

    def _look_after(self, writer: RecordingWriter) -> None:
        while not self._ordered and writer.failure is None:
            self._wake.wait(_LOOK)
            self._wake.clear()
            self._hand_on(writer)
            self._look(writer)
        self._hand_on(writer)
        writer.remarks.update(self._remarks)
        writer.close()
        self.part = writer.part
        self._tell_drops(writer.statistics)
        self.failure = writer.failure

    def _hand_on(self, writer: RecordingWriter) -> None:
        """Give the batches to the writer, as fast as it can take them."""
        while True:
            with self._lock:
                for port, count in self._dropped.items():
                    writer.drop(port, count)
                self._dropped.clear()
                if not self._batches:
                    self._direct = writer
                    return
                batch = self._batches[0]
            for first in range(0, len(batch.records), _TURN):
                some = batch.records[first : first + _TURN]
                for record in some:
                    while writer.load > _AHEAD and writer.failure is None:
                        sleep(_PAUSE)
                    writer.write(batch.port, record, batch.log_time)
                with self._lock:
                    self._waiting -= len(some)
                    self._octets -= len(some) * batch.each
                sleep(_YIELD)
            with self._lock:
                self._batches.popleft()

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
