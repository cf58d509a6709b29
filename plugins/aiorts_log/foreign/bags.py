"""Reads recordings of other systems as streams of messages: MCAP files, ROS 2 bags (.db3), and folders of both.

A bag's `metadata.yaml` is never read: the files themselves hold all its content, and YAML can demand more than data.
"""

from __future__ import annotations

import contextlib
import heapq
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.mcap.reader import RecordingReader, not_closed
from aiorts_log.mcap.source import Limits

_SQLITE: Final = b"SQLite format 3\0"
_LARGEST: Final = 64 * 2**20
"""Bytes of one message or definition."""
_TABLES: Final = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"topic_id", "timestamp", "data"},
}
_PACKED_WHOLE: Final = (".db3.zstd", ".mcap.zstd")


class Stream(NamedTuple):
    """The properties of a topic's messages.

    `encoding` is the messages' ("cdr", "json"); `schema_format` and `definition` explain them, "" when nothing does.
    """

    topic: str
    type: str
    encoding: str
    schema_format: str
    definition: str


Sample = tuple[int, Stream, bytes]
"""Log time in ns, stream, bytes."""


class Bag:
    """The open files of one recording; `samples` gives all messages in the order of their log time.

    Attributes:
        streams: the topics in it.
        not_closed: the files that were not closed, with the number of unusable bytes at the end of each.
    """

    def __init__(self, parts: list[_Mcap | _Database]) -> None:
        self._parts = parts
        self.streams: tuple[Stream, ...] = tuple(dict.fromkeys(stream for part in parts for stream in part.streams))
        self.not_closed: tuple[tuple[str, int], ...] = tuple(one for part in parts for one in part.not_closed)
        self.count = sum(part.count for part in parts)

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        for part in self._parts:
            part.close()

    def samples(self) -> Iterator[Sample]:
        """All messages; those of equal time in the order of the files. Raises RecordingError or DamagedError."""
        parts = [part.samples() for part in self._parts]
        yield from parts[0] if len(parts) == 1 else heapq.merge(*parts, key=lambda sample: sample[0])


def open_bag(path: str | os.PathLike[str], *, limits: Limits | None = None) -> Bag:
    """Open a recording of another system: a file, or a folder of them.

    Raises:
        RecordingError: it is no recording, or was made by aiorts.
    """
    path = Path(path)
    files = _files(path) if path.is_dir() else [path]
    if packed := [file for file in files if file.name.endswith(_PACKED_WHOLE)]:
        raise RecordingError(f"{packed[0]}: is compressed as a whole; unpack it first with unzstd")
    with contextlib.ExitStack() as stack:
        parts: list[_Mcap | _Database] = []
        for file in files:
            parts.append(_Database(file) if _is_database(file) else _Mcap(file, limits))
            stack.callback(parts[-1].close)
        stack.pop_all()
    return Bag(parts)


def _files(folder: Path) -> list[Path]:
    """The files of a bag, in the order of their numbers."""
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be read: {error.strerror}") from None
    found = [folder / name for name in names if name.endswith((".mcap", ".db3", *_PACKED_WHOLE))]
    if not found:
        raise RecordingError(f"{folder}: no recording: there is no .mcap or .db3 file in it")
    return sorted(found, key=lambda one: (len(one.name), one.name))


def _is_database(path: Path) -> bool:
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
    except (OSError, ValueError):
        return False  # `RecordingReader` raises the error
    try:
        return os.read(descriptor, len(_SQLITE)) == _SQLITE
    except OSError:
        return False
    finally:
        os.close(descriptor)


class _Mcap:
    """An MCAP file, read with all checks of `RecordingReader`."""

    def __init__(self, path: Path, limits: Limits | None) -> None:
        self._reader = reader = RecordingReader(path, limits=limits)
        if reader.header.profile == "aiorts":
            reader.close()
            raise RecordingError(f"{path}: was made by aiorts and needs no import; aiorts log info shows it")
        self._of: dict[int, Stream] = {}
        for port in reader.ports.values():
            schema = port.schema
            schema_format, text = (
                ("", "") if schema is None else (schema.encoding, schema.data.decode("utf-8", "replace"))
            )
            self._of[port.id] = Stream(port.name, port.type_name, port.encoding, schema_format, text)
        self.streams = tuple(self._of.values())
        self.count = reader.count
        self.not_closed = tuple(not_closed([reader]))

    def samples(self) -> Iterator[Sample]:
        of = self._of
        for sample in self._reader.samples():
            yield sample.log_time, of[sample.port.id], sample.data

    def close(self) -> None:
        self._reader.close()


class _Database:
    """A .db3 file of ROS 2, opened read-only."""

    def __init__(self, path: Path) -> None:
        self._path = path
        for journal in (f"{path}-wal", f"{path}-journal"):
            if os.path.exists(journal) and os.path.getsize(journal):
                raise RecordingError(
                    f"{path}: its recorder did not close it: {Path(journal).name} holds more; open it once with sqlite3"
                )
        self._database = self._opened()
        try:
            self._read()
        except sqlite3.Error as error:
            raise self._damaged(error) from None
        except BaseException:
            self._database.close()
            raise

    def _opened(self) -> sqlite3.Connection:
        try:
            # immutable: no lock file and no journal are made next to a file that is only read.
            found = sqlite3.connect(f"{self._path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        except sqlite3.Error as error:
            raise self._damaged(error) from None
        found.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST)
        found.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        return found

    def _read(self) -> None:
        query = self._database.execute
        # Functions and virtual tables that the file's schema names are not run.
        query("PRAGMA trusted_schema=OFF")
        tables = {name for (name,) in query("SELECT name FROM sqlite_master WHERE type='table'")}
        for table, needed in _TABLES.items():
            columns = {row[1] for row in query(f"PRAGMA table_info({table})")}
            if table not in tables or needed - columns:
                raise RecordingError(f"{self._path}: no ROS 2 bag: its database has no table {table} as bags have it")
        texts: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            rows = query("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            texts = {str(kind): (str(schema_format), str(text)) for kind, schema_format, text in rows}
        self._of = {
            number: Stream(str(topic), str(kind), str(schema_format), *texts.get(str(kind), ("", "")))
            for number, topic, kind, schema_format in query("SELECT id, name, type, serialization_format FROM topics")
        }
        self.streams = tuple(self._of.values())
        self.count = int(query("SELECT count(*) FROM messages").fetchone()[0])
        self.not_closed: tuple[tuple[str, int], ...] = ()

    def samples(self) -> Iterator[Sample]:
        of = self._of
        try:
            rows = self._database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, rowid")
            for topic, time, data in rows:
                if topic not in of or type(time) is not int or not 0 <= time < 2**63 or type(data) is not bytes:
                    raise DamagedError(f"{self._path}: damaged: a message of topic {topic!r} at {time!r} is none")
                yield time, of[topic], data
        except sqlite3.Error as error:
            raise self._damaged(error) from None

    def _damaged(self, error: Any) -> DamagedError:
        return DamagedError(f"{self._path}: damaged: {str(error)[:100]}")

    def close(self) -> None:
        self._database.close()
