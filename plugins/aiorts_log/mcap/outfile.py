"""Writes one file of a recording: definitions, chunks, attachments, and the index at its end.

Synchronous, for one thread. The file is whole at any moment: a chunk is appended in one piece, or not at all.

No library writes the file. Measured with chunks of 64 KiB, with checksums, without compression (microseconds for a
message of 30, 100 bytes and 1 MiB): mcap 1.6.0 9.5, 8.1, 4606; foxglove-sdk 0.30.3 1.8, 1.4, 1075; this module with
`struct` 0.6, 0.6, 1542. What they cannot do counts more than speed. `mcap` closes a chunk when it is full, never by its
age: killed after 60 messages in 1.2 s, it had written nothing. foxglove-sdk writes the open chunk with the length
2**64-1 until it is closed, and when the disk is full it logs that and goes on. Neither continues a file, or tells when
data are on the disk. The tests read these files by `mcap` with all its checks.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import aiorts
from aiorts_log.errors import RecordingError, UnwrittenError
from aiorts_log.mcap.chunks import ChunkBuilder
from aiorts_log.mcap.format import (
    HEADER,
    MAGIC,
    Attachment,
    Channel,
    Schema,
    record,
    text,
)
from aiorts_log.mcap.locked_file import Existing, LockedFile
from aiorts_log.mcap.reader import RecordingReader
from aiorts_log.mcap.source import MAJOR, MINOR
from aiorts_log.mcap.summary import Summary

_REPEAT: Final = 2**22
"""Bytes after which all definitions are written again, so that no single damage can take them all."""


def beginning() -> bytes:
    """The first bytes of a recording made by this version."""
    library = f"aiorts {aiorts.__version__}, recording format {MAJOR}.{MINOR}"
    return MAGIC + record(HEADER, text("aiorts"), text(library))


def continued(path: Path) -> tuple[Summary, int, int]:
    """The content of a recording that is to be continued, where its data end, and its last log time.

    Raises:
        RecordingError: aiorts did not make it, or it is damaged.
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
        existing: what to do when it exists.
        min_free: bytes of the disk to leave free.
        kind: the class that writes; tests give one that fails.

    Attributes:
        floor: the last log time in it when it was opened.
        first: the first log time written since then.
        counts: samples in it, by channel.

    Raises:
        RecordingError: it cannot be opened or continued.
    """

    can_sync = True
    """False after a wait for the disk has failed: the next one would succeed without the data being there."""

    def __init__(
        self,
        path: Path,
        existing: Existing = "refuse",
        min_free: int | None = None,
        kind: type[LockedFile] = LockedFile,
    ) -> None:
        self.path = path
        self._file = kind(path, existing, min_free)
        self.floor = 0
        self.first: int | None = None
        self.counts: dict[int, int] = {}
        try:
            self._begin()
        except OSError as error:
            self._file.give_up()
            raise UnwrittenError(f"{path}: cannot be written: {error.strerror or error}") from None
        except BaseException:
            self._file.give_up()
            raise

    def _begin(self) -> None:
        """Write the head of a new file, or read the content of one that is continued."""
        self.builder = ChunkBuilder()
        self._summary, self._defined_at = Summary(), 0
        if self._file.size:
            self._summary, self._defined_at, self.floor = continued(self.path)
            self._file.cut(self._defined_at)
        else:
            self._file.append([beginning()])
        self.counts = self._summary.counts

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._file.size

    @property
    def displaced(self) -> str:
        """The present state of the file's name, see `LockedFile`."""
        return self._file.displaced

    def channel_of(self, port: str, schema: Schema, encoding: str, metadata: Mapping[str, str]) -> Channel:
        """The channel for a port and type: the one that the file has, or a new one."""
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
        """Append the samples collected. OSError when that fails; they are lost then."""
        builder = self.builder
        if not builder.size:
            return
        if self.first is None and not builder.is_empty:
            self.first = builder.start
        counts = builder.counts()
        self._append_chunk()
        for channel, count in counts.items():
            self.counts[channel] = self.counts.get(channel, 0) + count

    def _append_chunk(self) -> None:
        file = self._file
        parts, place = self.builder.take(file.size)
        file.append(parts)
        self._summary.chunks.append(place)
        if file.size - self._defined_at > _REPEAT:
            self._defined_at = file.size
            self.define_all()

    def drop_chunk(self) -> None:
        """Drop the samples collected, and let the short records that follow use the reserved space."""
        self.builder = ChunkBuilder()
        self._file.use_reserve()

    def define_all(self) -> None:
        """Put all definitions into the next chunk."""
        for schema in self._summary.schemas.values():
            self.builder.define(schema)
        for channel in self._summary.channels.values():
            self.builder.define(channel)

    def take_definitions(self, schemas: Mapping[int, Schema], channels: Mapping[int, Channel]) -> None:
        """Use the schemas and channels of another file, with their numbers."""
        self._summary.schemas, self._summary.channels = dict(schemas), dict(channels)
        self.define_all()

    def attach(self, one: Attachment) -> None:
        """Append an attachment. OSError when that fails."""
        self.end_chunk()
        data, at = one.put(), self._file.size
        self._file.append([data])
        self._summary.attachments.append((at, len(data), one))

    def attach_json(self, name: str, document: Any, time: int) -> None:
        """Append a JSON document. OSError when that fails."""
        data = json.dumps(document, indent=1, default=str).encode()
        self.attach(Attachment(time, time, name, "application/json", data))

    def sync(self) -> None:
        """Wait until the whole file is on the disk. OSError when it may not be."""
        self.can_sync = False
        self._file.sync()
        self.can_sync = True

    def finish(self) -> None:
        """Write the index and close the file. OSError when the index cannot be written; the samples are in the file."""
        try:
            self.end_chunk()
            self._file.append(self._summary.put(self._file.size))
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._file.close()
