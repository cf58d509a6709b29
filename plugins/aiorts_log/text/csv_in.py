"""Reads a table (CSV) as samples: each row has a sample of each port, or one of the port that it names.

Log times must not go back from row to row: a table is read once, from its beginning, in constant memory. An error names
the line.
"""

from __future__ import annotations

import csv
import os
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple, TextIO

from aiorts.errors import AiortsError, ConfigurationError, RecordError
from aiorts.types import has_tm
from aiorts.wire import MsgpackCodec
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.mcap.encodings import schema_of
from aiorts_log.mcap.format import Channel
from aiorts_log.mcap.reader import RecordedPort, RecordedSample
from aiorts_log.mcap.source import open_regular
from aiorts_log.text.columns import columns_of, taker_of
from aiorts_log.text.csv_format import LOG_TIME, PORT, TableOptions, original, time_of
from aiorts_log.text.flat import LONGEST

_QUOTED: Final = 60
_LOOKED: Final = 100_000
"""Rows that are searched for the names of ports."""


class _Port(NamedTuple):
    """A port of a table: its cells, and the function that makes a record of them."""

    port: RecordedPort
    numbers: tuple[int, ...]
    texts: tuple[int, ...]
    take: Callable[[Sequence[str], int], Any]
    stamped: bool

    def is_in(self, row: Sequence[str]) -> bool:
        """Whether one of its cells is not empty; blanks are a text, but no number."""
        if not (self.numbers or self.texts):
            return True
        return any(row[cell] for cell in self.texts) or any(row[cell].strip() for cell in self.numbers)


class TableReader:
    """An open table.

    Attributes:
        ports: the ports of its samples, by name.
        columns: the names of its columns; unused: columns that no field is read from.
        bad: the rows left out with `skip_bad`, as line number and reason.

    Args:
        target: the file to convert into, for the command that an error shows.
        ports: names that were given without a type.

    Raises:
        RecordingError: it cannot be read.
        ConfigurationError: columns and ports do not match.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        options: TableOptions,
        *,
        target: Path | None = None,
        ports: Sequence[str] = (),
    ) -> None:
        self.path = Path(path)
        self.options = options
        self.bad: list[tuple[int, str]] = []
        file, self.size = open_regular(self.path)
        # utf-8-sig: spreadsheets begin a file with a byte order mark.
        self._stream: TextIO = os.fdopen(file, encoding="utf-8-sig", newline="")
        self._before = csv.field_size_limit(LONGEST)  # of the whole process, by default 131072
        try:
            self._begin(target, ports)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        if not self._stream.closed:
            csv.field_size_limit(self._before)
            self._stream.close()

    def __enter__(self) -> TableReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def read(self) -> int:
        """Bytes read so far, approximately."""
        return self._stream.buffer.tell()

    def _begin(self, target: Path | None, ports: Sequence[str]) -> None:
        options = self.options
        lines = iter(self._line, "")
        self._rows = self._numbered(csv.reader(lines, delimiter=options.delimiter, strict=True))
        self._first: tuple[int, list[str]] | None = next(self._rows, None)
        first = self._first[1] if self._first is not None else []
        if options.header:
            self.columns = tuple(map(original, first))
            if self.columns and all(re.fullmatch(r"[+-]?[\d.]+([eE][+-]?\d+)?", name.strip()) for name in self.columns):
                raise ConfigurationError(
                    f"{self.path}: its first row has numbers alone; --no-header if it is no header"
                )
            if doubled := [name for name in self.columns if self.columns.count(name) > 1]:
                raise ConfigurationError(
                    f"{self.path}: two columns are called {doubled[0][:_QUOTED]!r}; name them apart"
                )
            self._first = None
        else:
            self.columns = tuple(map(str, range(len(first))))
        self._width = len(self.columns)
        if not options.ports and (self.columns != (LOG_TIME,) or next(self._rows, None) is not None):
            # The table of an empty recording needs no types.
            raise ConfigurationError(
                f"a table does not have the types of its columns; give --port NAME --type TYPE once for each port: "
                f"aiorts log convert {self._command(target, ports or self._named())}"
            )
        self._time = self._column(options.time, "--time")
        names = dict(options.ports)
        self._chooser = self.columns.index(PORT) if self._is_ours() else None
        self._constants = list(options.values.values())
        targets = self._targets(names)
        self._ports = {name: self._port(name, cls, targets[name]) for name, cls in options.ports}
        self.ports = {name: one.port for name, one in self._ports.items()}
        used = {self._time, self._chooser, *(cell for fields in targets.values() for cell in fields.values())}
        self.unused = tuple(name for number, name in enumerate(self.columns) if number not in used)

    def _command(self, target: Path | None, ports: Sequence[str]) -> str:
        """The arguments of a command with types, which the user has to fill in."""
        named = [word for name in ports or ("NAME",) for word in ("--port", name, "--type", "TYPE")]
        more = "" if self.options == TableOptions() else ", and your other options"
        return shlex.join([str(self.path), str(target or "TARGET"), *named]) + more

    def _named(self) -> tuple[str, ...]:
        """The ports that a table of several ports names; empty where there may be others."""
        if self.columns[:2] == (LOG_TIME, PORT):
            found = {original(row[1]): None for _, row in islice(self._rows, _LOOKED) if len(row) > 1}
            columns = self.columns[2:]
        else:
            found = {name.removesuffix(".tm"): None for name in self.columns if name.endswith(".tm")}
            columns = tuple(name for name in self.columns if name != self.options.time)
        known = all(any(column.startswith(f"{port}.") for port in found) for column in columns)
        return tuple(found) if known else ()

    def _is_ours(self) -> bool:
        """Whether the table is one of several ports as aiorts writes them."""
        return self.columns[:2] == (LOG_TIME, PORT) and PORT not in self.options.columns

    def _column(self, name: str, option: str) -> int:
        number = self._number(name)
        if number >= 0:
            return number
        there = ", ".join(self.columns[:20]) or "none"
        raise ConfigurationError(f"{option}: {self.path} has no column {name[:_QUOTED]!r}; it has {there}")

    def _number(self, name: str) -> int:
        """The number of the column of that name, else of the only column with that name between blanks; -1 for none."""
        if name in self.columns:
            return self.columns.index(name)
        found = [number for number, column in enumerate(self.columns) if column.strip() == name]
        return found[0] if len(found) == 1 else -1

    def _targets(self, names: dict[str, type]) -> dict[str, dict[str, int]]:
        """For each port, the number of the cell of each field path; constants follow the cells of a row."""
        found: dict[str, dict[str, int]] = {name: {} for name in names}
        requested = [(self._column(column, "--map"), target) for column, target in self.options.columns.items()]
        requested += [(self._width + number, target) for number, target in enumerate(self.options.values)]
        for cell, target in requested:
            port, path = self._split(target, names)
            if path in found[port]:
                raise ConfigurationError(f"--map: {target[:_QUOTED]} is given twice")
            found[port][path] = cell
        mapped = {cell for cell, _ in requested}
        for name, cls in names.items():
            fronts = (f"{name}.",) if len(names) > 1 or self._chooser is not None else (f"{name}.", "")
            for column in columns_of(cls):
                if any(path == column.path or path.startswith(f"{column.path}[") for path in found[name]):
                    continue
                for front in fronts:
                    cell = self._number(front + column.path)
                    if cell >= 0 and cell not in mapped and (cell != self._time or column.path == "tm"):
                        found[name].setdefault(column.path, cell)
        return found

    def _split(self, target: str, names: dict[str, type]) -> tuple[str, str]:
        for name in sorted(names, key=len, reverse=True):
            if target.startswith(f"{name}."):
                return name, target[len(name) + 1 :]
        if len(names) == 1:
            return next(iter(names)), target
        raise ConfigurationError(
            f"--map: expected COLUMN=PORT.FIELD, got {target[:_QUOTED]!r}; ports: {', '.join(names)}"
        )

    def _port(self, name: str, cls: type, fields: dict[str, int]) -> _Port:
        try:
            take = taker_of(cls, fields, self.options.empty_is_nan)
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.path}: port {name}: {error}") from None
        port = RecordedPort(Channel(0, 0, name, "msgpack", {}), schema_of(0, cls, "msgpack"), 0)
        contents = {column.path: column.content for column in columns_of(cls)}
        texts = tuple(cell for path, cell in fields.items() if cell < self._width and contents.get(path) == "text")
        numbers = tuple(cell for cell in fields.values() if cell < self._width and cell not in texts)
        return _Port(port, numbers, texts, take, has_tm(cls))

    def _line(self) -> str:
        """The next line; a line longer than allowed is an error."""
        try:
            line = self._stream.readline(LONGEST)
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror or error}") from None
        if len(line) == LONGEST:
            raise DamagedError(f"{self.path}: a line has more than the {LONGEST} characters that are allowed")
        return line

    def _numbered(self, rows: Any) -> Iterator[tuple[int, list[str]]]:
        """Rows that are no comments, with the number of the line where each begins."""
        line, comment = 1, self.options.comment
        try:
            for row in rows:
                if row and not (comment and row[0].startswith(comment)):
                    yield line, row
                line = rows.line_num + 1
        except csv.Error as error:
            raise DamagedError(f"{self.path}: line {line}: no table: {error}") from None
        except UnicodeDecodeError as error:
            raise DamagedError(
                f"{self.path}: behind line {line - 1}: no UTF-8: byte {error.object[error.start]}"
            ) from None

    def samples(self) -> Iterator[RecordedSample]:
        """Read the samples of each row, in the order of the rows and ports.

        Raises:
            DamagedError: a row cannot be read (unless `skip_bad`); the message has its line.
        """
        last, encode = 0, MsgpackCodec().encode
        numbers = dict.fromkeys(self.ports, 0)
        for line, row in self._all_rows():
            try:
                if len(row) != self._width:
                    raise RecordError(f"expected {self._width} cells, got {len(row)}")
                time = time_of(row[self._time], self.options.unit, self.options.offset)
                if time < last:
                    raise RecordError(f"its time is {last - time} ns before the row in front of it; sort the table")
                found = []
                for one in self._of_row(row):
                    record = one.take(row + self._constants, time)
                    tm: Any = record.tm if one.stamped else time
                    found.append((one, tm if type(tm) is int else tm.ns, encode(record)))
            except AiortsError as error:
                if not self.options.skip_bad:
                    raise DamagedError(f"{self.path}: line {line}: {error}; --skip-bad leaves such rows out") from None
                self.bad.append((line, str(error)))
                continue
            last = time
            for one, tm, data in found:
                number = numbers[one.port.name]
                numbers[one.port.name] += 1
                yield RecordedSample(one.port, time, tm, number, data)

    def _all_rows(self) -> Iterator[tuple[int, list[str]]]:
        if self._first is not None:
            yield self._first
        yield from self._rows

    def _of_row(self, row: Sequence[str]) -> Sequence[_Port]:
        """The ports that have a sample in a row: the one that it names, or those with a cell that is not empty."""
        if self._chooser is not None:
            one = self._ports.get(original(row[self._chooser]))
            if one is None:
                there = ", ".join(self._ports)
                raise RecordError(f"no port {row[self._chooser][:_QUOTED]!r} was named by --port; there are {there}")
            return (one,)
        if len(self._ports) == 1:
            return tuple(self._ports.values())
        return [one for one in self._ports.values() if one.is_in(row)]
