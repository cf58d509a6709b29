"""Reads the samples of a recording ahead of the player, in blocks, of which at most two are held.

A thread reads and decodes, so that neither a slow disk nor a large chunk delays the loop. In simulated time nothing can
be late, and blocks are read in place: what runs between two moments then never depends on a thread.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, Final, Literal, NamedTuple, TypeVar

from aiorts.types import has_tm
from aiorts_log.errors import RecordingError
from aiorts_log.mcap.reader import RecordedSample, Recording

T = TypeVar("T")

_MOST: Final = 256
"""Samples of a block: the thread finishes it in about a millisecond, and then lets the loop have the interpreter."""
_BYTES: Final = 2**20


@dataclass(frozen=True, slots=True)
class Reading:
    """The recording to read, and the samples wanted of it.

    Attributes:
        open: opens it; raises RecordingError.
        routes: the target of the samples of a port, and their expected type, by the port's name.
        start: the first log time that is wanted, in ns; None is from its beginning.
        end: the first log time that is not wanted any more.
    """

    open: Callable[[], Recording]
    routes: Mapping[str, tuple[Any, type]]
    start: int | None = None
    end: int | None = None


@dataclass(slots=True)
class Unreadable:
    """The number of samples that are not of their type, and the error of the first."""

    count: int = 0
    first: str = ""


class Block(NamedTuple):
    """Samples in order (target, log time, record, whether it has a time stamp), and the error that ended reading.

    A block without samples and error is the end.
    """

    samples: list[tuple[Any, int, Any, bool]]
    error: RecordingError | None


class ReadAhead:
    """The samples of one recording, from any log time.

    Args:
        reading: the recording and the wanted samples.
        in_place: whether the caller's thread reads.
    """

    def __init__(self, reading: Reading, *, in_place: bool) -> None:
        self._reading = reading
        self._executor = None if in_place else ThreadPoolExecutor(1, thread_name_prefix="aiorts replay")
        self._reader: Recording | None = None
        self._samples: Iterator[RecordedSample] = iter(())
        self._routes: dict[int, tuple[Any, Callable[[bytes], Any], bool]] = {}
        self._order: Literal["time", "file"] = "time"
        self._next: asyncio.Future[Block] | None = None
        self._closing = False
        self.unreadable = Unreadable()

    @property
    def fault(self) -> str:
        """The fault of the recording when it was opened, as far as known; "" is none."""
        reader = self._reader
        if reader is None:
            return ""
        return reader.fault or (f"it {reader.unclosed}" if reader.unclosed else "")

    @property
    def loses(self) -> bool:
        """Whether the recording has samples that cannot be sent: its end is torn, or a sample is not of its type."""
        return self.unreadable.count > 0 or (self._reader is not None and self._reader.torn_bytes > 0)

    async def open(self) -> None:
        """Open the file. RecordingError when it cannot be opened, or has other ports than before."""
        await self._do(self._open)

    async def begin(self, start: int | None) -> None:
        """Continue with the first sample of this log time or later, within the range."""
        await self._settle()
        await self._do(partial(self._begin, start))

    async def block(self) -> Block:
        """The next block; the block after it is read while this one is played."""
        if self._executor is None:
            return self._read()
        loop, waiting = asyncio.get_running_loop(), self._next
        if waiting is None:
            waiting = loop.run_in_executor(self._executor, self._read)
        self._next = None
        found = await waiting
        if found.samples:
            self._next = loop.run_in_executor(self._executor, self._read)
        return found

    async def close(self) -> None:
        """Close the file and end the thread."""
        self._closing = True
        try:
            await self._settle()
            await self._do(self._close)
        finally:
            if self._executor is not None:
                # Without waiting: a slow disk must not hold up the loop.
                self._executor.shutdown(wait=False)

    async def _settle(self) -> None:
        waiting, self._next = self._next, None
        if waiting is not None:
            await asyncio.wait([waiting])

    async def _do(self, job: Callable[[], T]) -> T:
        if self._executor is None:
            return job()
        return await asyncio.get_running_loop().run_in_executor(self._executor, job)

    # -- in the thread ---------------------------------------------------------------------------------------------

    def _open(self) -> None:
        try:
            reader = self._reader = self._reading.open()
            for name, (target, cls) in self._reading.routes.items():
                port = reader.ports.get(name)
                if port is None or port.type is not cls:
                    raise RecordingError(f"{reader.path}: port {name!r} has changed; configure its replay again")
                self._routes[port.id] = target, port.decode, has_tm(cls)
            if _goes_by_number(reader):
                self._order = "file"
        except OSError as error:
            raise RecordingError(f"cannot be read: {error}") from error

    def _begin(self, start: int | None) -> None:
        reader, reading = self._reader, self._reading
        if reader is None:
            raise RecordingError("is closed here")
        first = max((time for time in (start, reading.start) if time is not None), default=None)
        names = list(reading.routes)
        self._samples = iter(reader.samples(start=first, end=reading.end, ports=names, order=self._order))

    def _read(self) -> Block:
        found: list[tuple[Any, int, Any, bool]] = []
        routes, size = self._routes, 0
        try:
            for sample in self._samples:
                port, log_time, _, _, data = sample
                target, decode, stamped = routes[port.id]
                try:
                    found.append((target, log_time, decode(data), stamped))
                except Exception as error:  # noqa: BLE001 - the class's own check of its values may raise anything
                    self._note(port.name, error)
                    continue
                size += len(data)
                if len(found) >= _MOST or size >= _BYTES or self._closing:
                    break
        except RecordingError as error:
            return Block(found, error)
        except OSError as error:
            return Block(found, RecordingError(f"cannot be read on: {error}"))
        return Block(found, None)

    def _note(self, port: str, error: Exception) -> None:
        self.unreadable.count += 1
        self.unreadable.first = self.unreadable.first or f"port {port}: {error}"

    def _close(self) -> None:
        self._samples = iter(())
        if self._reader is not None:
            self._reader.close()


def _goes_by_number(reader: Recording) -> bool:
    """Whether a port's times go back while its numbers go on: its clock was set back, and the file's order is right.

    Chunks that overlap in time are no proof of that, since some writers make them in several threads.
    """
    pieces = [piece for piece in reader.pieces if piece.filled]
    overlap = any(before.end > after.start for before, after in pairwise(pieces))
    if not overlap and (len(pieces) != 1 or reader.header.profile == "aiorts"):
        return False
    last: dict[int, tuple[int, int]] = {}
    try:
        for port, log_time, _, sequence, _ in reader.samples(order="file"):
            time, number = last.get(port.id, (0, 0))
            if log_time < time and sequence > number:
                return True
            last[port.id] = log_time, sequence
    except RecordingError:
        return False  # the player gets the same error
    return False
