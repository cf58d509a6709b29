"""The targets of a conversion: MCAP and text. Synchronous, one call for each sample.

Samples come in the order of their log time. Content that a format cannot hold is an error that names it, or is in
`left_out`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol

from aiorts.errors import AiortsError
from aiorts.wire import MsgpackCodec
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.mcap.encodings import Encoding, schema_of
from aiorts_log.mcap.format import Attachment
from aiorts_log.mcap.outfile import OutFile
from aiorts_log.mcap.reader import END_NAME, RecordedPort, RecordedSample
from aiorts_log.mcap.survey import GAP
from aiorts_log.text.flat import FlatPort
from aiorts_log.text.text_format import TextFile, text_encode

_CHUNK: Final = 2**16


class Sink(Protocol):
    """The target of samples."""

    @property
    def left_out(self) -> tuple[str, ...]:
        """The content that the format cannot hold, in words."""
        ...

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a sample of the port `name`. RecordingError when the format cannot hold its type."""

    def attach(self, one: Attachment) -> None:
        """Write a file within the recording."""

    def finish(self) -> None:
        """Complete and close the file. OSError when that fails."""

    def abandon(self) -> None:
        """Close the file as it is."""


def record_of(sample: RecordedSample) -> Any:
    """Decode a sample. RecordingError when its type is not loaded, DamagedError when the bytes are not of it."""
    try:
        return sample.port.decode(sample.data)
    except RecordingError as error:
        raise RecordingError(f"{error}, or choose others with --port") from None
    except AiortsError as error:
        where = "line" if isinstance(sample.port, FlatPort) else "sample"
        raise DamagedError(f"port {sample.port.name!r}, {where} {sample.sequence}: {error}") from None


class _FileSink:
    """The common part of MCAP and text: a file that is written in chunks.

    Args:
        kind: class of the file.
        encoding: of the samples; None keeps that of an MCAP source, and is msgpack for all others.
    """

    @property
    def left_out(self) -> tuple[str, ...]:
        """Empty: these formats hold everything."""
        return ()

    def __init__(self, path: Path, kind: type[OutFile], encoding: Encoding | None = None) -> None:
        self._file = kind(path, "refuse", 0)
        self._encoding: Encoding | None = encoding
        self._puts: dict[tuple[str, int], tuple[int, Callable[[RecordedSample], bytes]]] = {}
        self._numbers: dict[int, int] = {}
        self._last = -1
        self._kept: list[Any] = []

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a sample."""
        port = sample.port
        key = name, id(port)
        put = self._puts.get(key)
        if put is None:
            put = self._puts[key] = self._new(name, port)
            self._kept.append(port)  # so that its id is not used again
        channel, bytes_of = put
        data = bytes_of(sample)
        number = self._numbers[channel] = self._numbers.get(channel, -1) + 1
        if 0 <= self._last <= sample.log_time - GAP:
            self._file.end_chunk()  # so that the index shows the gap
        self._last = sample.log_time
        if self._file.builder.add(channel, number, sample.log_time, sample.publish_time, data) >= _CHUNK:
            self._file.end_chunk()

    def _new(self, name: str, port: RecordedPort) -> tuple[int, Callable[[RecordedSample], bytes]]:
        raise NotImplementedError

    def attach(self, one: Attachment) -> None:
        """Write a file within the recording."""
        self._file.attach(one)

    def finish(self) -> None:
        """Write what is left, and the index."""
        self._file.finish()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._file.abandon()


class McapSink(_FileSink):
    """Writes MCAP. Samples of an MCAP source are copied as they are, whether their type is loaded or not."""

    def __init__(self, path: Path, encoding: Encoding | None = None) -> None:
        super().__init__(path, OutFile, encoding)

    def _new(self, name: str, port: RecordedPort) -> tuple[int, Callable[[RecordedSample], bytes]]:
        schema = port.schema
        if schema is not None and not isinstance(port, FlatPort) and self._encoding in (None, port.encoding):
            return self._file.channel_of(name, schema, port.encoding, port.metadata).id, lambda sample: sample.data
        if schema is None and self._encoding is None:
            raise RecordingError(f"port {name!r}: nothing explains its messages; choose others with --port")
        known(port)
        encoding = self._encoding or "msgpack"
        encode = text_encode if encoding == "json" else MsgpackCodec().encode
        channel = self._file.channel_of(name, schema_of(0, port.type, encoding), encoding, port.metadata)
        return channel.id, _encoding(port, encode)


def _is_document(data: bytes) -> bool:
    try:
        return isinstance(json.loads(data), dict)
    except (ValueError, RecursionError):
        return False


class TextSink(_FileSink):
    """Writes flat text."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, TextFile)
        self._ends: list[Attachment] = []

    def _new(self, name: str, port: RecordedPort) -> tuple[int, Callable[[RecordedSample], bytes]]:
        known(port)
        channel = self._file.channel_of(name, schema_of(0, port.type, "json"), "json", port.metadata)
        return channel.id, _encoding(port, text_encode)

    def attach(self, one: Attachment) -> None:
        """Write a file within the recording; a writer's end report goes to the end of the file."""
        if one.name == END_NAME and _is_document(one.data):
            self._ends.append(one)
        else:
            self._file.attach(one)

    def finish(self) -> None:
        """Write what is left, and the end report."""
        documents = [json.loads(one.data) for one in self._ends]
        for document in documents or [{"why": "closed", "stored": sum(self._file.counts.values())}]:
            self._file.attach_json(END_NAME, document, 0)
        super().finish()


def _encoding(port: RecordedPort, encode: Callable[[Any], bytes]) -> Callable[[RecordedSample], bytes]:
    def bytes_of(sample: RecordedSample) -> bytes:
        record = record_of(sample)
        try:
            return encode(record)
        except AiortsError as error:
            raise RecordingError(f"port {port.name!r}: {error}") from None

    return bytes_of


def known(port: RecordedPort) -> None:
    if port.unknown:
        raise RecordingError(f"port {port.name!r}: {port.unknown}, or choose others with --port")
