"""A recording, read: what it holds is known at once, its samples come in the order of their log time.

Every checksum is checked; the index at the end only says where to look. Nothing that a file names is imported: a type
that is not known here is told as plain data, as far as the recording's own schema explains it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cached_property
from types import TracebackType
from typing import Any, Final, Literal, NamedTuple, Self

from aiorts.errors import WireError
from aiorts_log.chunks import Message, Messages
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.form import Attachment, BadOctets, Channel, Schema
from aiorts_log.forms import ENCODINGS, known_type, plain_of, schema_of, taker
from aiorts_log.index import read_index
from aiorts_log.merge import merged
from aiorts_log.source import Header, Limits, Piece, Source
from aiorts_log.summary import Summary
from aiorts_log.survey import Gap, Survey, survey

__all__ = ("METADATA_NAME", "RecordedPort", "RecordedSample", "RecordingReader")

METADATA_NAME: Final = "metadata.json"
"""The attachment that has what is known of the system that was recorded; one for each time that was begun."""
END_NAME: Final = "end.json"
"""The attachment that says what the writer counted, and why it ended."""


class RecordedPort:
    """A port of a recording.

    Attributes:
        name: of the port; type_name: of its type, as the recording says.
        encoding: of its messages; schema: what explains them (None in recordings made by others).
        metadata: what else is said of it; count: its samples.
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
        """The type of its samples; None when that is not known here, or is another one: `unknown` says which."""
        return None if self.unknown else known_type(self.type_name)

    @cached_property
    def unknown(self) -> str:
        """Why its samples cannot become records here; "" when they can."""
        if self.encoding not in ENCODINGS or self.schema is None:
            return f"its messages are {self.encoding or 'of no encoding'}, which are not read here"
        cls = known_type(self.type_name)
        if cls is None:
            return f"no type {self.type_name[:80]!r} is known here; import the module that defines it"
        own = schema_of(self.schema.id, cls, "json" if self.encoding == "json" else "msgpack")
        if own != self.schema:
            return f"{self.type_name} was another type when it was recorded: its fields differ"
        return ""

    @cached_property
    def decode(self) -> Callable[[bytes], Any]:
        """Makes a record of the octets of a sample.

        Raises:
            RecordingError: when its type is not known here.
            WireError: from the function, for octets that are none of its type.
        """
        if self.unknown:
            raise RecordingError(f"port {self.name!r}: {self.unknown}")
        return taker(self.type, self.encoding)

    def plain(self, data: bytes) -> Any:
        """The octets of a sample as plain data that JSON can carry, whether its type is known or not."""
        return plain_of(data, self.encoding, self.schema)


class RecordedSample(NamedTuple):
    """A sample as it was recorded.

    `log_time`: when it was recorded, ns on the recording's own time line; `publish_time`: its own time stamp.
    """

    port: RecordedPort
    log_time: int
    publish_time: int
    sequence: int
    data: bytes

    @property
    def record(self) -> Any:
        """The record. RecordingError when its type is not known here, WireError when it is none."""
        return self.port.decode(self.data)


class RecordingReader:
    """A recording that is open.

    Args:
        path: the file.
        limits: how much memory it may ask for.

    Attributes:
        ports: what was recorded, by name. Two channels of one name are told apart by "#" and their number.
        clean: whether the writer closed it.
        fault: what is wrong with it in words; "" when nothing is known to be.
        torn: what is broken at the end of one that was not closed; samples before it are all there.
        skipped: records of kinds that this version does not know.

    Raises:
        RecordingError: it cannot be read, or is no recording.
        DamagedError: not even its beginning can be read.
    """

    def __init__(self, path: str | os.PathLike[str], *, limits: Limits | None = None) -> None:
        self._source = Source(path, limits or Limits())
        self.fault = ""
        self.torn: Gap | None = None
        self.damage: tuple[Gap, ...] = ()
        try:
            self._open()
        except BaseException:
            self._source.close()
            raise

    def _open(self) -> None:
        found = None
        try:
            found = self._indexed()
        except BadOctets as error:
            self.fault = f"its index is damaged: {error}"
        self.clean = found is not None or bool(self.fault)
        if found is None:
            found = self._surveyed(survey(self._source))
        self._summary = found
        self.skipped = found.skipped
        self._ports: dict[int, RecordedPort] = {}
        for channel in found.channels.values():
            schema = found.schemas.get(channel.schema)
            self._ports[channel.id] = RecordedPort(channel, schema, found.counts.get(channel.id, 0))
        self.ports: dict[str, RecordedPort] = {}
        for port in self._ports.values():
            self.ports[port.name if port.name not in self.ports else f"{port.name}#{port.id}"] = port

    def _indexed(self) -> Summary | None:
        """What the index says; None when there is none, or it does not say enough. BadOctets if it is damaged."""
        found = read_index(self._source)
        if found is None:
            return None
        summary, self._stop = found
        counted = summary.counted
        if counted is None or counted.chunks != len(summary.chunks) or summary.counts.keys() - summary.channels.keys():
            return None
        if counted.messages and not summary.chunks:
            return None
        self._pieces = [
            Piece(one.start, one.end, one.offset, one.length, filled=bool(one.end or one.indexes))
            for one in summary.chunks
        ]
        return summary

    def _surveyed(self, found: Survey) -> Summary:
        self._pieces = found.pieces
        self._stop = found.stop
        self.torn, self.damage = found.torn, tuple(found.damage)
        self.clean = self.clean or found.ended
        if found.ended and self.header.profile == "aiorts" and not self.fault:
            self.fault = "its index is missing"
        if found.damage and not self.fault:
            gap = found.damage[0]
            self.fault = f"octet {gap.offset}: {gap.why}"
        return found.summary

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Let the file go; samples cannot be had any more."""
        self._source.close()

    @property
    def path(self) -> Any:
        """The file."""
        return self._source.path

    @property
    def header(self) -> Header:
        """Who wrote it."""
        return self._source.header

    @property
    def octets(self) -> int:
        """How large the file is."""
        return self._source.size

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Its chunks in the order of the file: first and last log time, and where each lies."""
        return tuple(self._pieces)

    @property
    def count(self) -> int:
        """How many samples it has."""
        return sum(self._summary.counts.values())

    @cached_property
    def start(self) -> int:
        """The first log time, in ns; 0 when it has no samples."""
        return min((piece.start for piece in self._pieces if piece.filled), default=0)

    @cached_property
    def end(self) -> int:
        """The last log time, in ns."""
        return max((piece.end for piece in self._pieces), default=0)

    def attachments(self) -> Iterator[Attachment]:
        """The files within the file. DamagedError for one that is not what was written."""
        for at, length, _ in self._summary.attachments:
            try:
                yield self._source.attachment(at, length)
            except BadOctets as error:
                raise self._damaged(at, error) from None

    @property
    def metadata(self) -> tuple[Any, ...]:
        """What was known of the system when the recording was begun, and each time that it was continued."""
        return self._documents(METADATA_NAME)

    @property
    def endings(self) -> tuple[Any, ...]:
        """What the writer counted (stored, dropped by port, ...) and why it ended, each time that it did."""
        return self._documents(END_NAME)

    def _documents(self, name: str) -> tuple[Any, ...]:
        found = []
        for one in self.attachments():
            if one.name == name:
                try:
                    found.append(json.loads(one.data))
                except (ValueError, RecursionError):
                    continue  # somebody else's file of that name
        return tuple(found)

    def samples(
        self,
        *,
        start: int | None = None,
        end: int | None = None,
        ports: Collection[str] | None = None,
        order: Literal["time", "file"] = "time",
    ) -> Iterator[RecordedSample]:
        """Samples in the order of their log time, those of equal time as they were written; chunk by chunk.

        Args:
            start: the first log time in ns that is wanted.
            end: the first that is not wanted any more.
            ports: names; None is all. RecordingError for one that is not there.
            order: "file" gives them as they lie in the file.

        Raises:
            DamagedError: octets are not what was written; everything before was given.
        """
        wanted = self._wanted(ports)
        first, last = start if start is not None else -1, end if end is not None else 2**64
        hole = self.damage[0].offset if self.damage else self.octets
        pieces = [piece for piece in self._pieces if piece.end >= first and piece.start < last]
        whole = [piece for piece in pieces if piece.offset < hole]
        cls, new, count = RecordedSample, tuple.__new__, 0
        for message in merged(whole, self._load, self._source.limits.overlap, order == "time"):
            channel, sequence, log_time, publish_time, data = message
            count += 1
            if first <= log_time < last and (port := wanted.get(channel)) is not None:
                yield new(cls, (port, log_time, publish_time, sequence, data))
        if self.damage and (last == 2**64 or len(whole) < len(pieces)):
            raise self._damaged(hole, BadOctets(self.damage[0].why))
        if len(whole) == len(self._pieces) and count != self.count:
            raise self._damaged(0, BadOctets(f"its index counts {self.count} samples, there are {count}"))

    def records(self, **chosen: Any) -> Iterator[tuple[str, int, Any]]:
        """Port, log time and record of each sample; arguments and errors as of `samples`.

        Raises:
            RecordingError: the type of one of the ports is not known here.
            DamagedError: a sample is none of its type.
        """
        for sample in self.samples(**chosen):
            try:
                yield sample.port.name, sample.log_time, sample.port.decode(sample.data)
            except WireError as error:
                raise DamagedError(f"{self.path}: port {sample.port.name}: {error}") from None

    def resume(self) -> tuple[Summary, int]:
        """For who continues the file: what is in it, and where the data end. DamagedError when that cannot be told."""
        found, source = self._summary, self._source
        try:
            if not found.chunks:
                found.chunks = [source.place(piece) for piece in self._pieces]
            found.attachments = [(at, size, source.attachment(at, size)) for at, size, _ in found.attachments]
        except BadOctets as error:
            raise self._damaged(source.begin, error) from None
        return found, self._stop

    def check(self) -> tuple[Gap, ...]:
        """Read everything; what is damaged, the torn end of a file that was not closed among it."""
        found = survey(self._source)
        gaps = [*found.damage, *([found.torn] if found.torn else [])]
        if not gaps and {piece.offset for piece in found.pieces} != {piece.offset for piece in self._pieces}:
            gaps.append(Gap(0, 0, "the index does not name every chunk"))
        if not gaps and found.summary.counts != {k: v for k, v in self._summary.counts.items() if v}:
            gaps.append(Gap(0, 0, "the index counts other samples than there are"))
        return tuple(gaps)

    def _wanted(self, names: Collection[str] | None) -> dict[int, RecordedPort]:
        if names is None:
            return self._ports
        if missing := [name for name in names if name not in self.ports]:
            there = ", ".join(list(self.ports)[:20]) or "none"
            raise RecordingError(f"{self.path}: no port {missing[0][:60]!r}; there are {there}")
        return {self.ports[name].id: self.ports[name] for name in names}

    def _load(self, piece: Piece) -> list[Message] | Messages:
        try:
            content = self._source.load(piece)
            for schema in content.schemas:
                self._summary.define(schema)
            for channel in content.channels:
                self._summary.define(channel=channel)
            messages = content.messages
            used = messages.channels() if isinstance(messages, Messages) else {message[0] for message in messages}
            if unknown := used - self._ports.keys():
                raise BadOctets(f"a message of channel {min(unknown)}, which nothing defines")
        except BadOctets as error:
            raise self._damaged(piece.offset, error) from None
        return messages

    def _damaged(self, offset: int, error: BadOctets) -> DamagedError:
        text = f"{self.path}: damaged at octet {offset}: {error}; aiorts log salvage gets what is whole"
        return DamagedError(text, offset)
