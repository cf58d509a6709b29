"""Records samples of any ports into a file: `write` never waits; a thread of its own encodes and writes.

The queue between them is bounded in samples and bytes; samples without room are counted. A chunk is written when it is
full or old, so that at most `age` seconds or `chunk` bytes are at risk when the process is killed. The first write that
fails ends the recording; the file stays whole up to that write.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from time import monotonic, sleep
from types import TracebackType
from typing import Any, ClassVar, Final, Self

from aiorts.errors import AiortsError, RecordError
from aiorts.types import check_port_type, snapshot, wire_name
from aiorts_log.errors import RecordingError
from aiorts_log.mcap.encodings import encoder, schema_of, splitter
from aiorts_log.mcap.format import Attachment, Schema
from aiorts_log.mcap.locked_file import Existing, LockedFile, next_part, part_path
from aiorts_log.mcap.outfile import OutFile
from aiorts_log.mcap.reader import END_NAME, METADATA_NAME
from aiorts_log.mcap.survey import GAP
from aiorts_log.recorder.options import RecordingOptions, RecordingStatistics
from aiorts_log.recorder.port_state import PortState, end_report, refuse, tally
from aiorts_log.recorder.weight import SMALL
from aiorts_log.whole import sync

_TICK: Final = 0.02
_LATEST: Final = 2**63
_LARGE: Final = 65_536
_LOOK: Final = 8_192
_HELD: Final = 0.001
"""Seconds of work after which the thread releases the interpreter, checked every `_LOOK` bytes: other threads would
wait 5 ms for it. With 150,000 samples a second, the p99 lateness of a loop at 100 Hz was 8.5 ms without it."""
_YIELD: Final = 1e-5
"""Seconds for which the interpreter is released; with 0 the thread mostly gets it back before another wakes up."""


class RecordingWriter:
    """A recording that is being made.

    Args:
        path: the file; `run.mcap`, and when it is rotated `run.1.mcap`, `run.2.mcap`, ...
        options: how it is written.
        metadata: properties of the system: plain data that JSON can carry.
        attachments: bytes of files to put in, such as the system file, by name.
        kind: the class that writes the file; tests give one that fails or is slow.

    Attributes:
        failure: why it ended before it was closed; None while it works.
        part: number of the file that is written.

    Raises:
        RecordingError: the file cannot be opened.
    """

    out: ClassVar[type[OutFile]] = OutFile
    """The class that writes the file's format; `encoder` encodes records for that format."""
    encoder = staticmethod(encoder)
    splitter = staticmethod(splitter)

    def __init__(
        self,
        path: str | os.PathLike[str],
        options: RecordingOptions | None = None,
        *,
        metadata: Mapping[str, Any] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        kind: type[LockedFile] = LockedFile,
    ) -> None:
        self.path = Path(path)
        self.options = options or RecordingOptions()
        self._metadata = dict(metadata or {})
        try:
            json.dumps(self._metadata, default=str)
        except (TypeError, ValueError, RecursionError) as error:
            raise RecordingError(f"{path}: metadata: expected what JSON can carry: {error}") from None
        self._attachments = dict(attachments or {})
        self._kind = kind
        self._ports: list[PortState] = []
        self._queue: deque[tuple[PortState, Any, int, int]] = deque()
        self._most, self._most_bytes = self.options.queue, self.options.queue_bytes
        self._put_bytes = 0
        self._taken_bytes = 0
        self._wake = threading.Event()
        self._asleep = self._closing = False
        self._flushes: deque[threading.Event] = deque()
        self.failure: RecordingError | None = None
        self.remarks: dict[str, Any] = {}
        """Further entries of the end report: plain data."""
        self.part = self.options.part
        self._last = -1
        self._opened_at = 0.0
        self._clamped = self._bytes_before = self._durable = 0
        self._ended = self._orderly = False
        self._owners: dict[int, PortState] = {}
        self._file = self.out(part_path(self.path, self.part), self.options.existing, self.options.min_free, kind)
        self._last = self._file.floor
        self.floor = self._file.floor
        """The last log time of a recording that is continued; samples have to be later."""
        self._thread = threading.Thread(target=self._work, name=f"recording {self.path.name}", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def add_port(self, name: str, cls: type, metadata: Mapping[str, str] | None = None) -> int:
        """Record a port from now on; returns the number for `write`, the same for the same port.

        Args:
            cls: the type of its samples; DeclarationError if it cannot travel.
            metadata: further properties, such as its unit.

        Raises:
            RecordingError: there is a port of that name for samples of another type.
        """
        known = next((number for number, port in enumerate(self._ports) if port.name == name), None)
        if known is None:
            self._ports.append(self._state(name, cls, dict(metadata or {})))
            return len(self._ports) - 1
        if (other := self._ports[known].cls) is not cls:
            raise RecordingError(f"port {name!r}: is recorded already, as {wire_name(other)}; rename one of them")
        return known

    def _state(self, name: str, cls: type, metadata: Mapping[str, str]) -> PortState:
        """The state of a new port; DeclarationError if its type cannot travel."""
        check_port_type(cls)
        return PortState.of(name, cls, metadata)

    def write(self, port: int, record: Any, log_time: int) -> bool:
        """Record a sample; from one thread at a time, never waiting.

        Args:
            port: the number from `add_port`.
            record: of the port's type or a subclass; a mutable one is copied.
            log_time: ns on a clock that does not go back; an earlier time is replaced by that of the sample before.

        Returns:
            False when it was dropped (no room in the queue, or the recording has ended) or refused.

        Raises:
            ValueError: `log_time` is no valid time.
        """
        if log_time.__class__ is not int or not 0 <= log_time < _LATEST:
            raise ValueError(f"log_time: expected nanoseconds, 0 <= log_time < 2**63, got {log_time!r}")
        one = self._ports[port]
        one.offered += 1
        if record.__class__ is not one.cls and not isinstance(record, one.cls):
            refuse(one.unfit, f"expected {one.cls.__name__}, got {type(record).__name__}")
            return False
        if one.mutable:
            try:
                record = snapshot(record)
            except RecordError as error:
                refuse(one.unfit, str(error))
                return False
        weight = SMALL if one.weigh is None else one.weigh(record)
        queue = self._queue
        if self._ended or len(queue) >= self._most or self._put_bytes - self._taken_bytes + weight > self._most_bytes:
            one.dropped += 1
            return False
        self._put_bytes += weight
        queue.append((one, record, log_time, weight))
        if self._asleep:
            self._wake.set()
        return True

    def drop(self, port: int, count: int) -> None:
        """Count samples as dropped that were lost before they reached the writer."""
        self._ports[port].offered += count
        self._ports[port].dropped += count

    def flush(self, timeout: float | None = None) -> bool:
        """Block the thread until all samples written are in the file (and on the disk, unless `sync="never"`).

        Returns:
            False when they are not: after `timeout` seconds, or because the recording has ended.
        """
        done = threading.Event()
        self._flushes.append(done)
        self._wake.set()
        if self._ended and not done.is_set():
            return self.failure is None
        return done.wait(timeout) and self.failure is None

    def close(self, timeout: float | None = None) -> RecordingStatistics:
        """Write what is waiting, then the index, and end; blocks the thread. A second call only gives the statistics.

        Args:
            timeout: seconds after which the thread is abandoned; None waits for it.
        """
        self._closing = True
        self._wake.set()
        self._thread.join(timeout)
        return self.statistics

    @property
    def load(self) -> float:
        """The load of the queue, from 0 to 1 when it is full."""
        waiting = self._put_bytes - self._taken_bytes
        return max(len(self._queue) / self.options.queue, waiting / self.options.queue_bytes)

    @property
    def displaced(self) -> tuple[Path, str]:
        """The file that is written now, and the fate of its name ("deleted or renamed"); "" while it is unchanged."""
        return self._file.path, self._file.displaced

    @property
    def statistics(self) -> RecordingStatistics:
        """The counts of samples up to now."""
        size = self._bytes_before + self._file.size
        return tally(self._ports, not self._thread.is_alive(), self._durable, self._clamped, size, self.part + 1)

    # -- the thread ------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            self._begin()
            while True:
                closing = self._closing
                flushes = len(self._flushes)  # they stay queued: `_end` releases them in any case
                self._drain()
                if flushes or closing or self._is_old():
                    self._end_chunk()
                for _ in range(flushes):
                    self._flushes.popleft().set()
                if closing:
                    break
                self._pause()
            self._finish("closed")
            self._orderly = True
        except (OSError, RecordingError) as error:
            self._fail(error)
        finally:
            self._end()

    def _begin(self) -> None:
        """Write the description of the system and the attachments, which each file of the recording has."""
        now = max(self._last, 0)
        self._file.attach_json(METADATA_NAME, {**self._metadata, "part": self.part}, now)
        for name, data in self._attachments.items():
            self._file.attach(Attachment(now, now, name, "application/octet-stream", data))
        if self.options.sync != "never":
            self._file.sync()
            sync(self._file.path.absolute().parent)  # the folder, for the entry of the file

    def _drain(self) -> None:
        """Encode the waiting samples, and write each chunk when it is full."""
        popleft, encoding, builder = self._queue.popleft, self.options.encoding, self._file.builder
        most = 1 if self.options.sync == "record" else self.options.chunk
        last, turn, taken, add = self._last, monotonic() + _HELD, 0, builder.add
        is_begun = not builder.is_empty
        for _ in range(len(self._queue)):
            port, record, log_time, weight = popleft()
            taken += weight
            if taken > _LOOK:
                self._taken_bytes += taken
                taken = 0
                if monotonic() > turn:
                    sleep(_YIELD)
                    turn = monotonic() + _HELD
            try:
                if record.__class__ is not port.kind:
                    port.encode = self.encoder(encoding, record.__class__)
                    port.split = self.splitter(encoding, record.__class__)
                    port.kind = record.__class__
                if weight > _LARGE and port.split is not None:
                    data, more = port.split(record)
                else:
                    data, more = port.encode(record), b""
            except (AiortsError, MemoryError) as error:
                self.refused(port, record, str(error) or type(error).__name__)
                continue
            if log_time < last:
                log_time = last
                self._clamped += 1
            if is_begun and log_time - last < GAP:
                self._last = last = log_time
            else:
                if is_begun:
                    self._end_chunk()  # so that the index shows the gap
                self._opened_at, is_begun, add = monotonic(), True, self._file.builder.add
                self._last = last = log_time
            if record.__class__ is not port.seen:
                self._choose(port, record.__class__)
            tm: Any = record.tm if port.stamped else log_time
            size = add(port.channel, port.sequence, log_time, tm if tm.__class__ is int else tm.ns, data, more)
            port.sequence += 1
            if size >= most:
                self._end_chunk()
                is_begun, add = False, self._file.builder.add
        self._taken_bytes += taken

    def refused(self, port: PortState, record: Any, why: str) -> None:
        """Count a sample that the encoding refuses; called in the thread."""
        refuse(port.refused, why)

    def _choose(self, port: PortState, cls: type) -> None:
        """Switch to the channel of a port for records of a class; a subclass has its own, with its own schema."""
        if port.seen is not None:
            port.next[port.channel] = port.sequence
        schema = self._schema(port, cls)
        channel = self._file.channel_of(port.name, schema, self.options.encoding, port.metadata).id
        self._owners[channel] = port
        port.seen, port.channel = cls, channel
        port.sequence = port.next.get(channel, self._file.counts.get(channel, 0))

    def _schema(self, port: PortState, cls: type) -> Schema:
        name = wire_name(cls)
        declared = port.cls if name == wire_name(port.cls) else cls  # a snapshot's hidden class is no type of its own
        return schema_of(0, declared, self.options.encoding)

    def _is_old(self) -> bool:
        is_empty = self._file.builder.is_empty
        return not is_empty and monotonic() - self._opened_at >= self.options.age - 3 * self._tick

    @property
    def _tick(self) -> float:
        return min(_TICK, self.options.age / 8)

    def _store(self) -> None:
        counts = self._file.builder.counts()
        self._file.end_chunk()
        for channel, count in counts.items():
            self._owners[channel].stored += count

    def _end_chunk(self) -> None:
        """Give the open chunk to the system, and to the disk if `sync` demands it; begin the next file if it is due."""
        self._store()
        if self.options.sync != "never":
            self._file.sync()
            self._durable = sum(port.stored for port in self._ports)
        options, file = self.options, self._file
        if file.first is None:
            return
        too_large = options.max_bytes is not None and file.size >= options.max_bytes
        if too_large or (options.max_seconds is not None and (self._last - file.first) / 1e9 >= options.max_seconds):
            self._rotate()

    def _rotate(self) -> None:
        self._finish("continued in the next file")
        self._bytes_before += self._file.size
        number = next_part(self.path, self.part, self.options.existing)
        existing: Existing = "overwrite" if self.options.existing == "overwrite" else "refuse"
        self._file = self.out(part_path(self.path, number), existing, self.options.min_free, self._kind)
        self.part = number
        for port in self._ports:
            port.seen = None
            port.next.clear()
        self._owners.clear()
        self._begin()

    def _pause(self) -> None:
        """Wait for work."""
        if not self._file.builder.is_empty:
            self._wake.wait(self._tick)
        else:
            self._asleep = True
            if not self._queue and not self._flushes and not self._closing:
                self._wake.wait()
            self._asleep = False
            if self.options.sync == "never" and not self._flushes and not self._closing:
                self._wake.clear()
                self._wake.wait(self._tick)  # more samples are likely to follow: they are taken together
        self._wake.clear()

    def _finish(self, why: str) -> None:
        if not self._ended:
            for port in self._ports:
                if port.seen is None:
                    self._choose(port, port.cls)  # a port without samples is named, too
        self._store()
        found = self.statistics
        self._file.attach_json(END_NAME, {**self.remarks, "why": why, **end_report(found)}, max(self._last, 0))
        if self.options.sync != "never" and self._file.can_sync:
            self._file.sync()
            self._durable = found.stored
        self._file.finish()

    def _fail(self, error: OSError | RecordingError) -> None:
        """End the recording after an error; the file gets an index if there is room for one."""
        if isinstance(error, OSError):
            held = sum(self._file.counts.values())
            why = f"recording ended: {error.strerror or error}; the {held} samples up to there are whole"
            error = RecordingError(f"{self._file.path}: {why}; make room or name another file")
        self.failure = error
        self._ended = self._orderly = True
        self._file.drop_chunk()
        with contextlib.suppress(OSError):
            self._finish(str(error))
        self._file.abandon()

    def _end(self) -> None:
        """Release all waiting callers, whatever happened."""
        if not self._orderly:
            self.failure = RecordingError(f"{self.path}: recording ended: its thread failed")
            self._file.abandon()
        self._ended = True
        while self._flushes:
            self._flushes.popleft().set()
