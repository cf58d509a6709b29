"""Writes recordings as JSON lines or tables; `left_out` names the user's content that they cannot hold."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, TextIO

from aiorts.wire import LineWriter
from aiorts_log.errors import RecordingError
from aiorts_log.mcap.format import Attachment
from aiorts_log.mcap.reader import END_NAME, METADATA_NAME, RecordedPort, RecordedSample
from aiorts_log.text.columns import cells_of, columns_of
from aiorts_log.text.csv_format import PORT, TableOptions, defused, quoted, time_cell
from aiorts_log.text.flat import LONGEST
from aiorts_log.text.sinks import known, record_of

_BLOCK: Final = 512
_OWN_FILES: Final = (METADATA_NAME, END_NAME, "system.toml")
"""Files that aiorts puts into each recording: a table without them lacks nothing of the user's."""
_OWN_METADATA: Final = {"unit"}


def _is_of_user(one: Attachment) -> bool:
    return one.name not in _OWN_FILES


class _TextSink:
    """The common part of JSON lines and tables: lines written in blocks, and what they cannot hold."""

    def __init__(self, path: Path) -> None:
        self._stream: TextIO = path.open("x", encoding="utf-8", newline="")
        self._lines: list[str] = []
        self._files = 0
        self._metadata: set[str] = set()

    @property
    def left_out(self) -> tuple[str, ...]:
        """The content that the format cannot hold, in words."""
        units = (f"metadata of {name}" for name in sorted(self._metadata))
        files = f"{self._files} file{'' if self._files == 1 else 's'} within the recording"
        return (*([files] if self._files else ()), *units)

    def attach(self, one: Attachment) -> None:
        """Count a file of the user, which the format cannot hold."""
        self._files += _is_of_user(one)

    def _write_line(self, line: str) -> None:
        # A character has at most 4 bytes in UTF-8: a shorter line need not be encoded to be measured.
        if len(line) > LONGEST // 4 and len(line.encode()) > LONGEST:
            raise RecordingError(f"a sample of {len(line)} characters: a line has at most {LONGEST} bytes")
        self._lines.append(line)
        if len(self._lines) >= _BLOCK:
            self._flush()

    def _flush(self) -> None:
        text = "".join(self._lines)
        self._lines.clear()
        self._stream.write(text)

    def finish(self) -> None:
        """Write what is left and close the file."""
        self._flush()
        self._stream.close()

    def abandon(self) -> None:
        """Close the file."""
        self._stream.close()


class LinesSink(_TextSink):
    """Writes JSON lines with log times."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._writers: dict[tuple[str, int], tuple[RecordedPort, LineWriter]] = {}

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a sample."""
        found = self._writers.get((name, id(sample.port)))
        if found is None:
            known(sample.port)
            found = self._writers[name, id(sample.port)] = sample.port, LineWriter(name, sample.port.type)
            if sample.port.metadata.keys() - _OWN_METADATA:
                self._metadata.add(name)
        self._write_line(f'{found[1].line(record_of(sample))[:-1]}, "log_time": {sample.log_time}}}\n')


class _Columns(NamedTuple):
    """The cells of a port in a row: the port's type, the function that makes them, the cells before, their number."""

    cls: type
    cells: Callable[[Any], list[str]]
    before: int
    many: int


class TableSink(_TextSink):
    """Writes one table: `log_time`, then the fields; with several ports `log_time`, `port`, then `PORT.FIELD`.

    With `by_time` there is no `port`, and samples of different ports with equal time are in one row.

    Args:
        ports: the ports that get columns; RecordingError for a type that is not loaded.
    """

    def __init__(self, path: Path, ports: Mapping[str, RecordedPort], options: TableOptions) -> None:
        self._options = options
        self._of: dict[str, _Columns] = {}
        several = len(ports) > 1
        self._names_port = several and not options.by_time
        columns: list[str] = []
        for name, port in ports.items():
            known(port)
            own = [f"{name}.{column.path}" if several else column.path for column in columns_of(port.type)]
            self._of[name] = _Columns(port.type, cells_of(port.type), len(columns), len(own))
            columns += own
        self._width = len(columns)
        header = [options.time, *([PORT] if self._names_port else []), *columns]
        if len(set(header)) != len(header):
            twice = next(name for name in header if header.count(name) > 1)
            raise RecordingError(f"two columns would be called {twice[:60]!r}; --split writes one table for each port")
        super().__init__(path)
        self._metadata = {name for name, port in ports.items() if port.metadata.keys() - _OWN_METADATA}
        self._time = 0
        self._row: dict[str, list[str]] = {}
        if options.header:
            self._write_line(options.delimiter.join(quoted(defused(name), options.delimiter) for name in header) + "\n")

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a sample into a row of its own, or into the row of its time."""
        record, comma, of = record_of(sample), self._options.delimiter, self._of[name]
        if sample.port.type is not of.cls:
            raise RecordingError(f"port {name!r} has samples of several types; a table cannot hold them")
        cells = [quoted(cell, comma) for cell in of.cells(record)]
        if not self._options.by_time:
            front = f"{quoted(defused(name), comma)}{comma}" if self._names_port else ""
            behind = comma * (self._width - of.before - of.many)
            time = time_cell(sample.log_time, self._options.unit)
            self._write_line(f"{time}{comma}{front}{comma * of.before}{comma.join(cells)}{behind}\n")
            return
        if len(self._of) > 1 and not any(cells):
            raise RecordingError(f"port {name!r}: an empty text would be no sample in such a row; leave out --by-time")
        if sample.log_time != self._time or name in self._row:
            self._end_row()
            self._time = sample.log_time
        self._row[name] = cells

    def _end_row(self) -> None:
        if not self._row:
            return
        row = [""] * self._width
        for name, cells in self._row.items():
            of = self._of[name]
            row[of.before : of.before + of.many] = cells
        self._row.clear()
        comma = self._options.delimiter
        self._write_line(f"{time_cell(self._time, self._options.unit)}{comma}{comma.join(row)}\n")

    def finish(self) -> None:
        """Write what is left and close the file."""
        self._end_row()
        super().finish()


class FolderSink:
    """Writes a folder with a table for each port."""

    def __init__(self, path: Path, ports: Mapping[str, RecordedPort], options: TableOptions) -> None:
        self._sinks: dict[str, TableSink] = {}
        names = file_names(ports)
        for name, port in ports.items():
            self._sinks[name] = TableSink(path / names[name], {name: port}, options)
        self._files = 0

    @property
    def left_out(self) -> tuple[str, ...]:
        """The content that tables cannot hold, in words."""
        found = [text for sink in self._sinks.values() for text in sink.left_out]
        files = f"{self._files} file{'' if self._files == 1 else 's'} within the recording"
        return (*([files] if self._files else ()), *found)

    def put(self, name: str, sample: RecordedSample) -> None:
        """Write a row into the table of its port."""
        self._sinks[name].put(name, sample)

    def attach(self, one: Attachment) -> None:
        """Count a file of the user, which tables cannot hold."""
        self._files += _is_of_user(one)

    def finish(self) -> None:
        """Write what is left and close the files."""
        for sink in self._sinks.values():
            sink.finish()

    def abandon(self) -> None:
        """Close the files."""
        for sink in self._sinks.values():
            sink.abandon()


def file_names(names: Iterable[str]) -> dict[str, str]:
    """A file name for each port, without path separators, each different. RecordingError when two clash."""
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
