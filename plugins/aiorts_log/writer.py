"""Records samples of any ports into a file: `write` never waits; a thread of its own encodes and writes.

The queue between them is bounded in number and octets; what finds no room is counted. A chunk goes to the system when
it is full or old, so that at most `age` seconds or `chunk` octets are at risk when the process is killed. The first
write that fails ends the recording: what is in the file up to there is whole, and stays.
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
from aiorts.types import check_port_type, snapshot
from aiorts_log.errors import RecordingError
from aiorts_log.file import Existing, LogFile, next_part, part_path
from aiorts_log.form import Attachment
from aiorts_log.forms import encoder, name_of, schema_of, splitter
from aiorts_log.info import GAP
from aiorts_log.options import RecordingOptions, RecordingStatistics
from aiorts_log.outfile import OutFile
from aiorts_log.portstate import PortState, said_at_end, tally
from aiorts_log.reader import END_NAME, METADATA_NAME
from aiorts_log.weight import SMALL

__all__ = ("RecordingWriter",)

_TICK: Final = 0.02
_LATEST: Final = 2**63
_LARGE: Final = 65_536
_LOOK: Final = 8_192
_HELD: Final = 0.001
"""Seconds of work after which the thread lets the interpreter go, looked at after so many octets: nobody else would
have it for 5 ms. Beside 150,000 samples a second, the p99 lateness of a loop at 100 Hz was 8.5 ms without."""
_YIELD: Final = 1e-5
"""Seconds that it does; with 0 it mostly has the interpreter again before anybody else woke up."""


class RecordingWriter:
    """A recording that is being made.

    Args:
        path: the file; `run.mcap`, and when it is rotated `run.1.mcap`, `run.2.mcap`, ...
        options: how.
        metadata: what is to be known of the system: plain data that JSON can carry.
        attachments: files to put in, by name: their octets, such as the system file's.
        kind: the class that writes the file; tests give one that fails or is slow.

    Attributes:
        failure: what ended it before it was closed; None as long as all is well.
        part: number of the file that is written.

    Raises:
        RecordingError: the file cannot be had.
    """

    out: ClassVar[type[OutFile]] = OutFile
    """What writes the form of the file; `encoder` makes what stands in it of a record."""
    encoder = staticmethod(encoder)
    splitter = staticmethod(splitter)

    def __init__(
        self,
        path: str | os.PathLike[str],
        options: RecordingOptions | None = None,
        *,
        metadata: Mapping[str, Any] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        kind: type[LogFile] = LogFile,
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
        self._most, self._most_octets = self.options.queue, self.options.queue_octets
        self._put_octets = 0
        self._taken_octets = 0
        self._wake = threading.Event()
        self._asleep = self._closing = False
        self._flushes: deque[threading.Event] = deque()
        self.failure: RecordingError | None = None
        self.remarks: dict[str, Any] = {}
        """What else is to be said at the end of the recording: plain data."""
        self.part = self.options.part
        self._last = -1
        self._opened_at = 0.0
        self._clamped = self._octets_before = self._durable = 0
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
        """Record a port from now on; returns the number to give to `write`, the same again for a port that it has.

        Args:
            cls: the type of its samples; DeclarationError if it cannot travel.
            metadata: what else is to be said of it, such as its unit.

        Raises:
            RecordingError: there is a port of that name for samples of another type.
        """
        check_port_type(cls)
        known = next((number for number, port in enumerate(self._ports) if port.name == name), None)
        if known is None:
            self._ports.append(PortState(name, cls, dict(metadata or {})))
            return len(self._ports) - 1
        if (other := self._ports[known].cls) is not cls:
            raise RecordingError(f"port {name!r}: is recorded already, as {name_of(other)}; rename one of them")
        return known

    def write(self, port: int, record: Any, log_time: int) -> bool:
        """Record a sample; from one thread at a time, and never waiting.

        Args:
            port: what `add_port` returned.
            record: of the port's type or a subclass; one that can still change is copied.
            log_time: ns on a clock that does not go back; what goes back is given the time of the sample before.

        Returns:
            False when it was dropped: there was no room in the queue, or the recording has ended; or refused.

        Raises:
            ValueError: the time is none.
        """
        if log_time.__class__ is not int or not 0 <= log_time < _LATEST:
            raise ValueError(f"log_time: expected nanoseconds, 0 <= log_time < 2**63, got {log_time!r}")
        one = self._ports[port]
        one.offered += 1
        if record.__class__ is not one.cls and not isinstance(record, one.cls):
            one.unfit += 1
            return False
        if one.mutable:
            try:
                record = snapshot(record)
            except RecordError:
                one.unfit += 1
                return False
        octets = SMALL if one.weigh is None else one.weigh(record)
        queue = self._queue
        if (
            self._ended
            or len(queue) >= self._most
            or self._put_octets - self._taken_octets + octets > self._most_octets
        ):
            one.dropped += 1
            return False
        self._put_octets += octets
        queue.append((one, record, log_time, octets))
        if self._asleep:
            self._wake.set()
        return True

    def drop(self, port: int, count: int) -> None:
        """Count samples as dropped that were lost before they came here."""
        self._ports[port].offered += count
        self._ports[port].dropped += count

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until all that was given is in the file (and on the disk, unless `sync="never"`); blocks the thread.

        Returns:
            False when it is not: after `timeout` seconds, or because the recording has ended.
        """
        done = threading.Event()
        self._flushes.append(done)
        self._wake.set()
        if self._ended and not done.is_set():
            return self.failure is None
        return done.wait(timeout) and self.failure is None

    def close(self, timeout: float | None = None) -> RecordingStatistics:
        """Write what is waiting, then the index, and end; again it only tells the statistics. Blocks the thread.

        Args:
            timeout: seconds after which the thread is left behind; None waits for it.
        """
        self._closing = True
        self._wake.set()
        self._thread.join(timeout)
        return self.statistics

    @property
    def load(self) -> float:
        """How full the queue is, from 0 to 1."""
        octets = self._put_octets - self._taken_octets
        return max(len(self._queue) / self.options.queue, octets / self.options.queue_octets)

    @property
    def displaced(self) -> tuple[Path, str]:
        """The file that is written now, and what became of its name ("deleted or renamed"); "" when nothing did."""
        return self._file.path, self._file.displaced

    @property
    def statistics(self) -> RecordingStatistics:
        """What became of the samples up to now."""
        octets = self._octets_before + self._file.size
        return tally(self._ports, not self._thread.is_alive(), self._durable, self._clamped, octets, self.part + 1)

    # -- the thread ------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            self._begin()
            while True:
                closing = self._closing
                flushes = len(self._flushes)  # they stay there: who waits is told in any case
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
        """Say in the file what is known of the system, and once more of each file that follows."""
        now = max(self._last, 0)
        self._file.attach_json(METADATA_NAME, {**self._metadata, "part": self.part}, now)
        for name, octets in self._attachments.items():
            self._file.attach(Attachment(now, now, name, "application/octet-stream", octets))
        if self.options.sync != "never":
            self._file.sync()
            self._file.sync_folder()

    def _drain(self) -> None:
        """Encode what waits, and write each chunk as it becomes full."""
        popleft, encoding, builder = self._queue.popleft, self.options.encoding, self._file.builder
        most = 1 if self.options.sync == "record" else self.options.chunk
        last, turn, taken, add = self._last, monotonic() + _HELD, 0, builder.add
        is_begun = not builder.is_empty
        for _ in range(len(self._queue)):
            port, record, log_time, octets = popleft()
            taken += octets
            if taken > _LOOK:
                self._taken_octets += taken
                taken = 0
                if monotonic() > turn:
                    sleep(_YIELD)
                    turn = monotonic() + _HELD
            try:
                if record.__class__ is not port.kind:
                    port.encode = self.encoder(encoding, record.__class__)
                    port.split = self.splitter(encoding, record.__class__)
                    port.kind = record.__class__
                if octets > _LARGE and port.split is not None:
                    data, more = port.split(record)
                else:
                    data, more = port.encode(record), b""
            except (AiortsError, MemoryError):
                port.refused += 1
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
        self._taken_octets += taken

    def _choose(self, port: PortState, cls: type) -> None:
        """Go on with the channel of a port for records of a class; a subclass has its own, with its own schema."""
        if port.seen is not None:
            port.next[port.channel] = port.sequence
        name = name_of(cls)
        declared = port.cls if name == name_of(port.cls) else cls  # a snapshot's hidden class is no type of its own
        schema = schema_of(0, declared, self.options.encoding)
        channel = self._file.channel_of(port.name, schema, self.options.encoding, port.metadata).id
        self._owners[channel] = port
        port.seen, port.channel = cls, channel
        port.sequence = port.next.get(channel, self._file.counts.get(channel, 0))

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
        """Hand the open chunk to the system, to the disk as well if that is wanted; go on in the next file in time."""
        self._store()
        if self.options.sync != "never":
            self._file.sync()
            self._durable = sum(port.stored for port in self._ports)
        options, file = self.options, self._file
        if file.first is None:
            return
        too_large = options.max_octets is not None and file.size >= options.max_octets
        if too_large or (options.max_seconds is not None and (self._last - file.first) / 1e9 >= options.max_seconds):
            self._rotate()

    def _rotate(self) -> None:
        self._finish("continued in the next file")
        self._octets_before += self._file.size
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
        """Wait for something to do."""
        if not self._file.builder.is_empty:
            self._wake.wait(self._tick)
        else:
            self._asleep = True
            if not self._queue and not self._flushes and not self._closing:
                self._wake.wait()
            self._asleep = False
            if self.options.sync == "never" and not self._flushes and not self._closing:
                self._wake.clear()
                self._wake.wait(self._tick)  # whatever comes next is likely to come at once
        self._wake.clear()

    def _finish(self, why: str) -> None:
        self._store()
        found = self.statistics
        self._file.attach_json(END_NAME, {**self.remarks, "why": why, **said_at_end(found)}, max(self._last, 0))
        if self.options.sync != "never" and self._file.can_sync:
            self._file.sync()
            self._durable = found.stored
        self._file.finish()

    def _fail(self, error: OSError | RecordingError) -> None:
        """End here; what is in the file stays, with an index if there is room for one."""
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
        """Whatever happened: nobody waits for this thread any more."""
        if not self._orderly:
            self.failure = RecordingError(f"{self.path}: recording ended: its thread failed")
            self._file.abandon()
        self._ended = True
        while self._flushes:
            self._flushes.popleft().set()
