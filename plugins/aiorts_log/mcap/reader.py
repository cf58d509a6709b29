"""Reads a recording: its content is known at once, its samples come in the order of their log time.

Every checksum is verified; the index at the end only tells where to look. A type that a file names is imported only if
a plugin declares a class of that very name: a sample of any other type that is not loaded is given as plain data, as
far as the recording's own schema explains it.
"""

from __future__ import annotations

import contextlib
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Literal, NamedTuple, Self, TypeVar

from aiorts.errors import RecordError, WireError
from aiorts.progress import Step
from aiorts.types import units_of
from aiorts.wire import units_in, without_units
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.mcap.checking import faults
from aiorts_log.mcap.chunks import Content, Message, Messages
from aiorts_log.mcap.encodings import ENCODINGS, named_type, plain_of, schema_of, taker
from aiorts_log.mcap.format import Attachment, BadBytes, Channel, Schema
from aiorts_log.mcap.index import read_index
from aiorts_log.mcap.merge import merged
from aiorts_log.mcap.source import Header, Limits, Piece, Source
from aiorts_log.mcap.summary import Summary
from aiorts_log.mcap.survey import Gap, Survey, survey

METADATA_NAME: Final = "metadata.json"
"""The attachment with the writer's description of the system, one for each begin or continuation."""
END_NAME: Final = "end.json"
"""The attachment with the writer's counts, and the reason for its end."""
_STEP: Final = 2048
"""Items between two calls that advance a progress bar."""
T = TypeVar("T")


class RecordedPort:
    """A port of a recording.

    Attributes:
        name, type_name: as the recording has them.
        encoding: of its messages; schema: explains them (None in recordings of other programs).
        metadata: further properties, such as the unit; count: its samples.
    """

    def __init__(self, channel: Channel, schema: Schema | None, count: int) -> None:
        self.id = channel.id
        self.name = channel.topic
        self.type_name = schema.name if schema is not None else ""
        self.encoding = channel.encoding
        self.schema = schema
        self.metadata: Mapping[str, str] = channel.metadata
        self.count = count

    def __repr__(self) -> str:
        return f"RecordedPort({self.name!r}, {self.type_name!r}, {self.encoding!r})"

    @cached_property
    def type(self) -> Any:
        """The type of its samples; None when it is not loaded or differs: `unknown` has the reason."""
        return None if self.unknown else named_type(self.type_name)[0]

    @cached_property
    def unknown(self) -> str:
        """The reason why its samples cannot become records; "" when they can."""
        if self.encoding not in ENCODINGS or self.schema is None:
            return f"its messages are {self.encoding or 'of no encoding'}, which are not read here"
        cls, why = named_type(self.type_name)
        if cls is None:
            return why
        own = schema_of(self.schema.id, cls, "json" if self.encoding == "json" else "msgpack")
        if own != self.schema and not _alike(own, self.schema):
            return f"{self.type_name} was another type when it was recorded: its fields differ"
        return ""

    @cached_property
    def units(self) -> Mapping[str, str]:
        """The units of its fields, by their paths without indices: as recorded, else as its type states them."""
        recorded: Mapping[str, str] = {}
        if self.schema is not None:
            with contextlib.suppress(ValueError, RecursionError):
                recorded = units_in(json.loads(self.schema.data))
        return recorded or ({} if self.unknown else units_of(self.type))

    @cached_property
    def decode(self) -> Callable[[bytes], Any]:
        """A function that makes a record of the bytes of a sample.

        Raises:
            RecordingError: its type is not loaded.
            WireError: from the function, for bytes that are none of its type.
        """
        if self.unknown:
            raise RecordingError(f"port {self.name!r}: {self.unknown}")
        return taker(self.type, self.encoding)

    def plain(self, data: bytes) -> Any:
        """Decode a sample to plain data that JSON can carry, whether its type is loaded or not."""
        return plain_of(data, self.encoding, self.schema)


def _alike(one: Schema, other: Schema) -> bool:
    """Whether two schemas differ only in units."""
    if (one.name, one.encoding) != (other.name, other.encoding):
        return False
    try:
        return bool(without_units(json.loads(one.data)) == without_units(json.loads(other.data)))
    except (ValueError, RecursionError):
        return False


class RecordedSample(NamedTuple):
    """A sample as it was recorded.

    `log_time`: when it was recorded, ns on the recording's time line; `publish_time`: its own time stamp.
    """

    port: RecordedPort
    log_time: int
    publish_time: int
    sequence: int
    data: bytes

    @property
    def record(self) -> Any:
        """The record. RecordingError when its type is not loaded, WireError when the bytes are no record of it."""
        return self.port.decode(self.data)


def counted(items: Iterable[T], step: Step) -> Iterator[T]:
    """Pass items on, and tell `step` how many of them were taken."""
    number = 0
    for number, one in enumerate(items, 1):
        yield one
        if not number % _STEP:
            step(_STEP)
    step(number % _STEP)


def not_closed(readers: Iterable[Recording]) -> Iterator[tuple[str, int]]:
    """The recordings that were not closed, and the number of unusable bytes at the end of each."""
    for reader in readers:
        if not reader.clean:
            yield str(reader.path), reader.torn_bytes


def unclosed_text(torn_bytes: int) -> str:
    """Words for the part that is missing in a recording that was not closed."""
    torn = f"; {torn_bytes} bytes at its end are unusable" if torn_bytes else ""
    return f"was not closed: what was not yet written when it ended is missing{torn}"


class Recording(ABC):
    """An open recording of any format.

    Attributes:
        path, size: the file, and its bytes.
        header: which program wrote it.
        pieces: its chunks in the order of the file: first and last log time, and the place of each.
        clean: whether the writer closed it.
        fault: its damage in words; "" when none is known.
        damage: the broken ranges between its samples.
        torn: the broken range at the end, when it was not closed; all samples before it are there.
        skipped: records of kinds that this version does not know.
    """

    path: Path
    size: int
    limits: Limits
    header: Header
    pieces: tuple[Piece, ...] = ()
    clean = True
    fault = ""
    damage: tuple[Gap, ...] = ()
    torn: Gap | None = None
    skipped = 0
    _ports: dict[int, RecordedPort]
    _counts: dict[int, int]

    @property
    def unclosed(self) -> str:
        """The part that is missing since the recording was not closed, in words; "" for a closed one."""
        return "" if self.clean else unclosed_text(self.torn_bytes)

    @property
    def torn_bytes(self) -> int:
        """Bytes at its end that were recorded and cannot be read."""
        return 0 if self.clean or self.torn is None else self.torn.length

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Close the file; samples cannot be read any more."""

    @abstractmethod
    def attachments(self) -> Iterator[Attachment]:
        """The files within the file. DamagedError for one that is not what was written."""

    @abstractmethod
    def check(self) -> tuple[Gap, ...]:
        """Read everything; returns the damage, the torn end of a file that was not closed included."""

    @abstractmethod
    def _loader(self) -> Callable[[Piece], Any]:
        """A function that loads the messages of a piece, for one pass over the samples."""

    def _channels(self, piece: Piece) -> Collection[int] | None:
        """The channels that have messages in a piece, by its index; None when it has no index."""
        return None

    @abstractmethod
    def _damaged(self, gap: Gap) -> DamagedError: ...

    def _place(self, sample: RecordedSample) -> str:
        return f"port {sample.port.name}"

    @cached_property
    def ports(self) -> dict[str, RecordedPort]:
        """The recorded ports, by name; the second channel of a name is NAME#NUMBER."""
        found: dict[str, RecordedPort] = {}
        for port in self._ports.values():
            found[port.name if port.name not in found else f"{port.name}#{port.id}"] = port
        return found

    @property
    def count(self) -> int:
        """The number of its samples."""
        return sum(self._counts.values())

    @cached_property
    def start(self) -> int:
        """The first log time, in ns; 0 when it has no samples."""
        return min((piece.start for piece in self.pieces if piece.filled), default=0)

    @cached_property
    def end(self) -> int:
        """The last log time, in ns."""
        return max((piece.end for piece in self.pieces), default=0)

    @property
    def metadata(self) -> tuple[Any, ...]:
        """The writer's descriptions of the system, one for each time that the recording was begun or continued."""
        return self._documents(METADATA_NAME)

    @property
    def endings(self) -> tuple[Any, ...]:
        """The writer's end reports: counts (stored, dropped by port, ...) and the reason, one for each end."""
        return self._documents(END_NAME)

    def _documents(self, name: str) -> tuple[Any, ...]:
        found = []
        for one in self.attachments():
            if one.name == name:
                with contextlib.suppress(ValueError, RecursionError):  # else another program's file of that name
                    found.append(json.loads(one.data))
        return tuple(found)

    def samples(
        self,
        *,
        start: int | None = None,
        end: int | None = None,
        ports: Collection[str] | None = None,
        order: Literal["time", "file"] = "time",
    ) -> Iterator[RecordedSample]:
        """Read samples in the order of their log time, those of equal time as they were written; chunk by chunk.

        Args:
            start: the first log time in ns that is wanted.
            end: the first log time in ns that is not wanted any more.
            ports: names; None is all. RecordingError for a name that is not there.
            order: "file" gives the samples as they lie in the file.

        Raises:
            DamagedError: bytes are not what was written; all samples before them were given.
        """
        wanted = self._ports if ports is None else {port.id: port for port in self.chosen(ports).values()}
        first, last = start if start is not None else -1, end if end is not None else 2**64
        hole = self.damage[0].offset if self.damage else self.size
        pieces = [piece for piece in self.pieces if piece.end >= first and piece.start < last]
        whole = [piece for piece in pieces if piece.offset < hole]
        cls, new, count = RecordedSample, tuple.__new__, 0
        for message in merged(whole, self._loader(), self.limits.overlap, order == "time"):
            channel, sequence, log_time, publish_time, data = message
            count += 1
            if first <= log_time < last and (port := wanted.get(channel)) is not None:
                yield new(cls, (port, log_time, publish_time, sequence, data))
        if self.damage and (last == 2**64 or len(whole) < len(pieces)):
            raise self._damaged(self.damage[0])
        if len(whole) == len(self.pieces) and count != self.count:
            raise self._damaged(Gap(0, 0, f"its index counts {self.count} samples, there are {count}"))

    def spans(self) -> dict[int, tuple[int, int]]:
        """The first and the last log time of each channel that has samples, from as few chunks as the index allows.

        DamagedError: one of these chunks is not what was written.
        """
        firsts, lasts = self._firsts(1), self._firsts(-1)
        return {channel: (firsts[channel], -lasts[channel]) for channel in firsts.keys() & lasts.keys()}

    def _firsts(self, sign: Literal[1, -1]) -> dict[int, int]:
        """The first log time of each channel, or, with the sign -1, the negative of its last."""
        found: dict[int, int] = {}
        open_ = {channel for channel, count in self._counts.items() if count}
        load = self._loader()
        pieces = ((sign * (piece.start if sign > 0 else piece.end), piece) for piece in self.pieces if piece.filled)
        for earliest, piece in sorted(pieces):
            open_ = {channel for channel in open_ if channel not in found or found[channel] > earliest}
            if not open_:
                break
            there = self._channels(piece)
            if there is not None and open_.isdisjoint(there):
                continue
            for message in load(piece):
                time = sign * message[2]
                found[message[0]] = min(time, found.get(message[0], time))
        return found

    def records(self, **chosen: Any) -> Iterator[tuple[str, int, Any]]:
        """Read port, log time and record of each sample; arguments and errors as of `samples`.

        Raises:
            RecordingError: the type of one of the ports is not loaded.
            DamagedError: a sample is not of its type.
        """
        for sample in self.samples(**chosen):
            try:
                yield sample.port.name, sample.log_time, sample.port.decode(sample.data)
            except (WireError, RecordError) as error:
                raise DamagedError(f"{self.path}: {self._place(sample)}: {error}") from None

    def chosen(self, names: Collection[str]) -> dict[str, RecordedPort]:
        """The ports of these names, in the order of the recording. RecordingError for a name that it does not have."""
        if missing := [name for name in names if name not in self.ports]:
            there = ", ".join(list(self.ports)[:20]) or "none"
            raise RecordingError(f"{self.path}: no port {missing[0][:60]!r}; there are {there}")
        return {name: port for name, port in self.ports.items() if name in names}


class RecordingReader(Recording):
    """An open MCAP file.

    Args:
        path: the file.
        limits: how much memory it may ask for.

    Raises:
        RecordingError: it cannot be read, or is no recording.
        DamagedError: not even its beginning can be read.
    """

    def __init__(self, path: str | os.PathLike[str], *, limits: Limits | None = None) -> None:
        self._source = source = Source(path, limits or Limits())
        self.path, self.size, self.limits, self.header = source.path, source.size, source.limits, source.header
        try:
            self._open()
        except BaseException:
            source.close()
            raise

    def _open(self) -> None:
        found = None
        try:
            found = self._indexed()
        except BadBytes as error:
            self.fault = f"its index is damaged: {error}"
        self.clean = found is not None or bool(self.fault)
        if found is None:
            found = self._surveyed(survey(self._source))
        self._summary = found
        self.skipped = found.skipped
        self._ports = {}
        for channel in found.channels.values():
            schema = found.schemas.get(channel.schema)
            self._ports[channel.id] = RecordedPort(channel, schema, found.counts.get(channel.id, 0))
        self._counts = found.counts

    def _indexed(self) -> Summary | None:
        """The content by the index; None when there is no index, or it is incomplete. BadBytes if it is damaged."""
        found = read_index(self._source)
        if found is None:
            return None
        summary, self._stop = found
        counted = summary.counted
        if counted is None or counted.chunks != len(summary.chunks) or summary.counts.keys() - summary.channels.keys():
            return None
        if counted.messages and not summary.chunks:
            return None
        unpacked = sum(one.uncompressed for one in summary.chunks)
        self._source.allow(chunks=len(summary.chunks), unpacked=unpacked, messages=counted.messages)
        self.pieces = tuple(
            Piece(*one[:4], filled=bool(one.end or one.indexes), unpacked=one.uncompressed) for one in summary.chunks
        )
        return summary

    def _surveyed(self, found: Survey) -> Summary:
        self.pieces = tuple(found.pieces)
        self._stop = found.stop
        self.torn, self.damage = found.torn, tuple(found.damage)
        self.clean = self.clean or found.ended
        if found.ended and self.header.profile == "aiorts" and not self.fault:
            self.fault = "its index is missing"
        if found.damage and not self.fault:
            gap = found.damage[0]
            self.fault = f"byte {gap.offset}: {gap.why}"
        return found.summary

    def close(self) -> None:
        """Close the file; samples cannot be read any more."""
        self._source.close()

    def attachments(self) -> Iterator[Attachment]:
        """The files within the file. DamagedError for one that is not what was written."""
        for at, length, _ in self._summary.attachments:
            try:
                yield self._source.attachment(at, length)
            except BadBytes as error:
                raise self._damaged(Gap(at, length, str(error))) from None

    def _channels(self, piece: Piece) -> Collection[int] | None:
        return self._indexes.get(piece.offset) or None

    @cached_property
    def _indexes(self) -> dict[int, frozenset[int]]:
        """The channels of each chunk that has an index of its messages."""
        return {one.offset: frozenset(one.indexes) for one in self._summary.chunks}

    def _loader(self) -> Callable[[Piece], Any]:
        held = 0

        def load(piece: Piece) -> list[Message] | Messages:
            nonlocal held
            content = self._load(piece)
            held += content.held
            self._source.allow(messages=held)  # counted here: the index may give a smaller number
            return content.messages

        return load

    def resume(self) -> tuple[Summary, int]:
        """The content, and where the data end, to continue the file. DamagedError when either cannot be read."""
        found, source = self._summary, self._source
        try:
            if not found.chunks:
                found.chunks = [source.place(piece) for piece in self.pieces]
            found.attachments = [(at, size, source.attachment(at, size)) for at, size, _ in found.attachments]
        except BadBytes as error:
            raise self._damaged(Gap(source.begin, 0, str(error))) from None
        return found, self._stop

    def check(self) -> tuple[Gap, ...]:
        """Read everything; return the damage, which includes the torn end of a file that was not closed.

        Indexes are verified as well, although this reader does not use them all.
        """
        found = survey(self._source)
        gaps = [*found.damage, *([found.torn] if found.torn else [])]
        if not gaps:
            gaps += faults(self._source, found)
        if not gaps and {piece.offset for piece in found.pieces} != {piece.offset for piece in self.pieces}:
            gaps.append(Gap(0, 0, "the index does not name every chunk"))
        if not gaps and set(map(_extent, found.pieces)) != set(map(_extent, self.pieces)):
            gaps.append(Gap(0, 0, "the index contradicts a chunk"))
        if not gaps and found.summary.counts != {k: v for k, v in self._summary.counts.items() if v}:
            gaps.append(Gap(0, 0, "the index counts other samples than there are"))
        if not gaps and self.fault:
            gaps.append(Gap(0, 0, self.fault))
        return tuple(gaps)

    def _load(self, piece: Piece) -> Content:
        try:
            content = self._source.load(piece)
            for schema in content.schemas:
                self._summary.define(schema)
            for channel in content.channels:
                self._summary.define(channel=channel)
            messages = content.messages
            used = messages.channels() if isinstance(messages, Messages) else {message[0] for message in messages}
            if unknown := used - self._ports.keys():
                raise BadBytes(f"a message of channel {min(unknown)}, which nothing defines")
        except BadBytes as error:
            raise self._damaged(Gap(piece.offset, piece.length, str(error))) from None
        return content

    def _damaged(self, gap: Gap) -> DamagedError:
        text = f"{self.path}: damaged at byte {gap.offset}: {gap.why}; aiorts log salvage copies what is whole"
        return DamagedError(text, gap.offset)


def _extent(piece: Piece) -> tuple[int, ...]:
    """Times, place and size of a chunk."""
    return piece.start, piece.end, piece.offset, piece.length, piece.unpacked
