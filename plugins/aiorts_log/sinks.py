"""What a converted recording is written into: MCAP, text, JSON lines or tables; synchronous, one call for each sample.

Samples come in the order of their log time. What a form cannot hold is refused by name, or told by `left_out`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol, TextIO

from aiorts.errors import AiortsError
from aiorts.wire import LineWriter
from aiorts_log.columns import cells_of, columns_of
from aiorts_log.csv_form import PORT, TableOptions, quoted, time_cell
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.flat import LONGEST, FlatPort
from aiorts_log.form import Attachment
from aiorts_log.forms import Encoding, encoder, schema_of
from aiorts_log.info import GAP
from aiorts_log.outfile import OutFile
from aiorts_log.reader import END_NAME, RecordedPort, RecordedSample
from aiorts_log.text_form import TextFile, text_encode

__all__ = ("FolderSink", "LinesSink", "McapSink", "Sink", "TableSink", "TextSink", "record_of")

_CHUNK: Final = 2**16
_BLOCK: Final = 512


class Sink(Protocol):
    """Where samples go."""

    @property
    def left_out(self) -> tuple[str, ...]:
        """What the form cannot hold, in words."""

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a sample of the port `name`. RecordingError when its type cannot be written so."""

    def attach(self, one: Attachment) -> None:
        """Write a file within the recording."""

    def finish(self) -> None:
        """All is written. OSError when it could not be."""

    def abandon(self) -> None:
        """Let the file go."""


def record_of(sample: RecordedSample) -> Any:
    """The record of a sample. RecordingError when its type is not known here, DamagedError when it is none of it."""
    try:
        return sample.port.decode(sample.data)
    except RecordingError as error:
        raise RecordingError(f"{error}, or choose others with --port") from None
    except AiortsError as error:
        where = "line" if isinstance(sample.port, FlatPort) else "sample"
        raise DamagedError(f"port {sample.port.name!r}, {where} {sample.sequence}: {error}") from None


class _FileSink:
    """What MCAP and text share: a file that is built in chunks.

    Args:
        kind: of the file.
        encoding: of the samples; None keeps what an MCAP file has, and is msgpack for all others.
    """

    @property
    def left_out(self) -> tuple[str, ...]:
        """Nothing: these forms hold everything."""
        return ()

    def __init__(self, path: Path, kind: type[OutFile], encoding: Encoding | None = None) -> None:
        self._file = kind(path, "refuse", 0)
        self._encoding: Encoding | None = encoding
        self._puts: dict[tuple[str, int], tuple[int, Callable[[RecordedSample], bytes]]] = {}
        self._numbers: dict[int, int] = {}
        self._last = 0
        self._kept: list[Any] = []

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a sample."""
        port = sample.port
        key = name, id(port)
        put = self._puts.get(key)
        if put is None:
            put = self._puts[key] = self._new(name, port)
            self._kept.append(port)  # so that its id is its own
        channel, octets_of = put
        data = octets_of(sample)
        number = self._numbers[channel] = self._numbers.get(channel, -1) + 1
        builder = self._file.builder
        if builder.count and sample.log_time - self._last >= GAP:
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
        """Let the file go."""
        self._file.abandon()


class McapSink(_FileSink):
    """MCAP. Samples of an MCAP file go over as they are, whether their type is known here or not."""

    def __init__(self, path: Path, encoding: Encoding | None = None) -> None:
        super().__init__(path, OutFile, encoding)

    def _new(self, name: str, port: RecordedPort) -> tuple[int, Callable[[RecordedSample], bytes]]:
        schema = port.schema
        if schema is not None and not isinstance(port, FlatPort) and self._encoding in (None, port.encoding):
            return self._file.channel_of(name, schema, port.encoding, port.metadata).id, lambda sample: sample.data
        if schema is None and self._encoding is None:
            raise RecordingError(f"port {name!r}: nothing explains its messages; choose others with --port")
        _known(port)
        encoding = self._encoding or "msgpack"
        encode = encoder(encoding)
        channel = self._file.channel_of(name, schema_of(0, port.type, encoding), encoding, port.metadata)
        return channel.id, _encoding(port, encode)


def _is_document(octets: bytes) -> bool:
    try:
        return isinstance(json.loads(octets), dict)
    except (ValueError, RecursionError):
        return False


class TextSink(_FileSink):
    """The flat text file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, TextFile)
        self._ends: list[Attachment] = []

    def _new(self, name: str, port: RecordedPort) -> tuple[int, Callable[[RecordedSample], bytes]]:
        _known(port)
        channel = self._file.channel_of(name, schema_of(0, port.type, "json"), "json", port.metadata)
        return channel.id, _encoding(port, text_encode)

    def attach(self, one: Attachment) -> None:
        """Write a file within the recording; what the writer said at the end stands at the end here, too."""
        if one.name == END_NAME and _is_document(one.data):
            self._ends.append(one)
        else:
            self._file.attach(one)

    def finish(self) -> None:
        """Write what is left, and that this is the end."""
        documents = [json.loads(one.data) for one in self._ends]
        for document in documents or [{"why": "closed", "stored": sum(self._file.counts.values())}]:
            self._file.attach_json(END_NAME, document, 0)
        super().finish()


def _encoding(port: RecordedPort, encode: Callable[[Any], bytes]) -> Callable[[RecordedSample], bytes]:
    def octets_of(sample: RecordedSample) -> bytes:
        record = record_of(sample)
        try:
            return encode(record)
        except AiortsError as error:
            raise RecordingError(f"port {port.name!r}: {error}") from None

    return octets_of


def _known(port: RecordedPort) -> None:
    if port.unknown:
        raise RecordingError(f"port {port.name!r}: {port.unknown}, or choose others with --port")


class _TextSink:
    """What JSON lines and tables share: lines in blocks, and what they cannot hold."""

    def __init__(self, path: Path) -> None:
        self._stream: TextIO = path.open("x", encoding="utf-8", newline="")
        self._lines: list[str] = []
        self._files = 0
        self._metadata: set[str] = set()

    @property
    def left_out(self) -> tuple[str, ...]:
        """What the form cannot hold."""
        units = (f"metadata of {name}" for name in sorted(self._metadata))
        files = f"{self._files} file{'' if self._files == 1 else 's'} within the recording"
        return (*([files] if self._files else ()), *units)

    def attach(self, one: Attachment) -> None:
        """Only count it."""
        self._files += 1

    def _say(self, line: str) -> None:
        if len(line) > LONGEST // 4 and len(line.encode()) > LONGEST:
            raise RecordingError(f"a sample of {len(line)} characters: a line has at most {LONGEST} octets")
        self._lines.append(line)
        if len(self._lines) >= _BLOCK:
            self._flush()

    def _flush(self) -> None:
        text = "".join(self._lines)
        self._lines.clear()
        self._stream.write(text)

    def finish(self) -> None:
        """Write what is left."""
        self._flush()
        self._stream.close()

    def abandon(self) -> None:
        """Let the file go."""
        self._stream.close()


class LinesSink(_TextSink):
    """JSON lines with log times."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._writers: dict[tuple[str, int], tuple[RecordedPort, LineWriter]] = {}

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a sample."""
        found = self._writers.get((name, id(sample.port)))
        if found is None:
            _known(sample.port)
            found = self._writers[name, id(sample.port)] = sample.port, LineWriter(name, sample.port.type)
            if sample.port.metadata:
                self._metadata.add(name)
        self._say(f'{found[1].line(record_of(sample))[:-1]}, "log_time": {sample.log_time}}}\n')


class TableSink(_TextSink):
    """One table: `log_time`, then the fields; with several ports `log_time`, `port`, then `PORT.FIELD`.

    Args:
        ports: that it is to have columns for; RecordingError for a type that is not known here.
    """

    def __init__(self, path: Path, ports: Mapping[str, RecordedPort], options: TableOptions) -> None:
        self._options = options
        self._cells: dict[str, tuple[type, Callable[[Any], list[str]], str, str]] = {}
        several = len(ports) > 1
        header = [options.time, *([PORT] if several else [])]
        counts: dict[str, int] = {}
        for name, port in ports.items():
            _known(port)
            columns = [f"{name}.{column.path}" if several else column.path for column in columns_of(port.type)]
            counts[name] = len(columns)
            header += columns
        if len(set(header)) != len(header):
            twice = next(name for name in header if header.count(name) > 1)
            raise RecordingError(f"two columns would be called {twice[:60]!r}; --split writes one table for each port")
        before, total, comma = 0, sum(counts.values()), options.delimiter
        for name, port in ports.items():
            front = f"{quoted(name, comma)}{comma}" if several else ""
            empty = before, total - before - counts[name]
            before += counts[name]
            self._cells[name] = port.type, cells_of(port.type), front + comma * empty[0], comma * empty[1]
        super().__init__(path)
        self._metadata = {name for name, port in ports.items() if port.metadata}
        if options.header:
            self._say(comma.join(quoted(name, comma) for name in header) + "\n")

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a row."""
        comma = self._options.delimiter
        record = record_of(sample)
        cls, cells, front, behind = self._cells[name]
        if sample.port.type is not cls:
            raise RecordingError(f"port {name!r} has samples of several types; a table cannot hold them")
        row = comma.join([quoted(cell, comma) for cell in cells(record)])
        self._say(f"{time_cell(sample.log_time, self._options.unit)}{comma}{front}{row}{behind}\n")


class FolderSink:
    """A folder with a table for each port."""

    def __init__(self, path: Path, ports: Mapping[str, RecordedPort], options: TableOptions) -> None:
        self._sinks: dict[str, TableSink] = {}
        names = file_names(ports)
        for name, port in ports.items():
            self._sinks[name] = TableSink(path / names[name], {name: port}, options)
        self._files = 0

    @property
    def left_out(self) -> tuple[str, ...]:
        """What tables cannot hold."""
        found = [text for sink in self._sinks.values() for text in sink.left_out]
        files = f"{self._files} file{'' if self._files == 1 else 's'} within the recording"
        return (*([files] if self._files else ()), *found)

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a row into the table of its port."""
        self._sinks[name].put(name, sample)

    def attach(self, one: Attachment) -> None:
        """Only count it."""
        self._files += 1

    def finish(self) -> None:
        """Write what is left."""
        for sink in self._sinks.values():
            sink.finish()

    def abandon(self) -> None:
        """Let the files go."""
        for sink in self._sinks.values():
            sink.abandon()


def file_names(names: Iterable[str]) -> dict[str, str]:
    """A file's name for each port, which leads nowhere else and is no other port's. RecordingError when two clash."""
    found: dict[str, str] = {}
    for name in names:
        safe = re.sub(r"[^\w.-]", "_", name).lstrip(".") or "_"
        file = f"{safe[:120]}.csv"
        if file.lower() in (other.lower() for other in found.values()):
            raise RecordingError(
                f"port {name[:60]!r}: another port's table would be called {file}, too; choose with --port"
            )
        found[name] = file
    return found
