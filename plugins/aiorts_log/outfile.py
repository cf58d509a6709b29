"""One file of a recording while it is written: definitions, chunks, attachments, and the index at its end.

Synchronous, for one thread. Whatever is in the file at any moment is whole: a chunk is appended in one piece, or not
at all.

Why no library writes the file. Measured with chunks of 64 KiB, their sums, no compression (microseconds for a message
of 30, 100 octets and 1 MiB): mcap 1.6.0 9.5, 8.1, 4606; foxglove-sdk 0.30.3 1.8, 1.4, 1075; this form written out with
`struct` 0.6, 0.6, 1542. More than speed counts what they cannot do. `mcap` closes a chunk when it is full and offers
nothing to close it by age: killed after 60 messages in 1.2 s, it had written nothing. foxglove-sdk writes the open
chunk with the length 2**64-1 until it is closed, and refuses no message when the disk is full: it only logs that, and
goes on. Neither continues a file, or says when what it has taken is on the disk. `mcap` reads what is made here, with
all its checks, in the tests.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import aiorts
from aiorts_log.chunks import ChunkBuilder
from aiorts_log.errors import RecordingError
from aiorts_log.file import Existing, LogFile
from aiorts_log.form import (
    HEADER,
    MAGIC,
    Attachment,
    Channel,
    Schema,
    record,
    text,
)
from aiorts_log.reader import RecordingReader
from aiorts_log.source import MAJOR, MINOR
from aiorts_log.summary import Summary

__all__ = ("OutFile", "beginning", "continued")

_REPEAT: Final = 2**22
"""Octets after which all definitions stand in the file again, so that no damage can take them all."""


def beginning() -> bytes:
    """The first octets of a recording made here."""
    library = f"aiorts {aiorts.__version__}, recording format {MAJOR}.{MINOR}"
    return MAGIC + record(HEADER, text("aiorts"), text(library))


def continued(path: Path) -> tuple[Summary, int, int]:
    """What is in a recording that is to be continued, where its data end, and its last log time.

    Raises:
        RecordingError: it is no recording made here, or damaged.
    """
    with RecordingReader(path) as reader:
        if reader.header.profile != "aiorts":
            raise RecordingError(f"{path}: was not made by aiorts and cannot be continued; name another file")
        if reader.damage:
            raise RecordingError(
                f"{path}: {reader.fault}; aiorts log salvage makes a whole one, which can be continued"
            )
        return (*reader.resume(), reader.end)


class OutFile:
    """A file that is being written.

    Args:
        path: of the file.
        existing: what is to happen when it is there.
        min_free: octets of the disk that are to stay free.
        kind: the class that writes; tests give one that fails.

    Attributes:
        floor: the last log time of what is in it already.
        counts: samples in it, by channel.

    Raises:
        RecordingError: it cannot be had or continued.
    """

    can_sync = True
    """Whether no wait for the disk has failed: the next one would say that all is well, which it is not."""

    def __init__(
        self, path: Path, existing: Existing = "refuse", min_free: int | None = None, kind: type[LogFile] = LogFile
    ) -> None:
        self.path = path
        self._file = kind(path, existing, min_free)
        self._summary = Summary()
        self._defined_at = 0
        self.builder = ChunkBuilder()
        self.floor = 0
        self.first: int | None = None
        self.begun_with = 0
        """Samples that were in it already."""
        try:
            if self._file.size:
                self._summary, end, self.floor = continued(path)
                self.begun_with = sum(self._summary.counts.values())
                self._defined_at = end
                self._file.cut(end)
            else:
                self._file.append([beginning()])
        except OSError as error:
            self._file.give_up()
            raise RecordingError(f"{path}: cannot be written: {error.strerror or error}") from None
        except BaseException:
            self._file.give_up()
            raise

    @property
    def size(self) -> int:
        """Octets in the file."""
        return self._file.size

    @property
    def displaced(self) -> str:
        """What became of its name, see `LogFile`."""
        return self._file.displaced

    @property
    def counts(self) -> Mapping[int, int]:
        """Samples in the file, by channel."""
        return self._summary.counts

    def channel_of(self, port: str, schema: Schema, encoding: str, metadata: Mapping[str, str]) -> Channel:
        """The channel for a port and type: the one that is in the file already, or a new one."""
        summary = self._summary
        known = (s for s in summary.schemas.values() if s[1:] == schema[1:])
        schema = next(known, schema._replace(id=max(summary.schemas, default=0) + 1))
        for channel in summary.channels.values():
            if (channel.schema, channel.topic, channel.encoding) == (schema.id, port, encoding):
                return channel
        channel = Channel(max(summary.channels, default=0) + 1, schema.id, port, encoding, dict(metadata))
        if max(channel.id, schema.id) >= 2**16:
            raise RecordingError(f"{self.path}: a recording has at most 65535 ports")
        if schema.id not in summary.schemas:
            self.builder.define(schema)
        self.builder.define(channel)
        summary.define(schema, channel)
        return channel

    def end_chunk(self) -> None:
        """Append what was collected. OSError when it cannot be; it is lost then."""
        builder, file, summary = self.builder, self._file, self._summary
        if not builder.octets:
            return
        if self.first is None and not builder.is_empty:
            self.first = builder.start
        counts = builder.counts()
        parts, place = builder.take(file.size)
        file.append(parts)
        summary.chunks.append(place)
        for channel, count in counts.items():
            summary.counts[channel] = summary.counts.get(channel, 0) + count
        if file.size - self._defined_at > _REPEAT:
            self._defined_at = file.size
            self.define_all()

    def drop_chunk(self) -> None:
        """Give up what was collected; what follows is short, and may use what was to stay free."""
        self.builder = ChunkBuilder()
        self._file.use_reserve()

    def define_all(self) -> None:
        """Put all definitions into the next chunk."""
        for schema in self._summary.schemas.values():
            self.builder.define(schema)
        for channel in self._summary.channels.values():
            self.builder.define(channel)

    def take_definitions(self, schemas: Mapping[int, Schema], channels: Mapping[int, Channel]) -> None:
        """Use the numbers of another file."""
        self._summary.schemas, self._summary.channels = dict(schemas), dict(channels)
        self.define_all()

    def attach(self, one: Attachment) -> None:
        """Append a file within the file. OSError when it cannot be."""
        self.end_chunk()
        octets, at = one.put(), self._file.size
        self._file.append([octets])
        self._summary.attachments.append((at, len(octets), one))

    def attach_json(self, name: str, document: Any, time: int) -> None:
        """Append a document. OSError when it cannot be."""
        octets = json.dumps(document, indent=1, default=str).encode()
        self.attach(Attachment(time, time, name, "application/json", octets))

    def sync(self) -> None:
        """Wait until all of it is on the disk. OSError when it may not be."""
        self.can_sync = False
        self._file.sync()
        self.can_sync = True

    def sync_folder(self) -> None:
        """Wait until the disk knows that there is the file. OSError when it may not."""
        folder = os.open(self.path.absolute().parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def finish(self) -> None:
        """Write the index and let the file go. OSError when the index cannot be written; the samples are there."""
        try:
            self.end_chunk()
            self._file.append(self._summary.put(self._file.size))
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Let the file go as it is."""
        self._file.close()
