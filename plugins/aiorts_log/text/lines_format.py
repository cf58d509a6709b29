"""Reads JSON lines, as filters write and `aiorts log cat` prints them, as a recording.

A line needs port, type and a time: `log_time`, as `aiorts log cat --log-time` writes it, or else its `tm`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import cached_property
from typing import Any, ClassVar, Final

from aiorts.errors import RecordError, UnknownTypeError, WireError
from aiorts.types import wire_name, wire_type
from aiorts.wire import LineReader
from aiorts_log.errors import RecordingError
from aiorts_log.mcap.format import BadBytes
from aiorts_log.text.flat import FlatPort, FlatReader, Head

_LATEST: Final = 2**63
_BEGIN: Final = re.compile(rb'\{"port": "((?:[^"\\]|\\.)*)", "type": "([^"\\]*)", ')
"""The beginning of a line written by aiorts; below, its end. A line of JSON that has both has that meaning."""
_END: Final = re.compile(rb', "log_time": (\d{1,19})\}\s*$')
_TM: Final = re.compile(rb'"tm": (\d{1,19}), "data": ')
_KEYS: Final = {"port", "type", "tm", "data", "log_time"}


def looks_like_lines(first: bytes) -> bool:
    """Whether a file that begins with these bytes has JSON lines with samples."""
    line, end, _ = first.lstrip().partition(b"\n")
    if not line.startswith(b"{"):
        return False
    try:
        plain = json.loads(line)
    except (ValueError, RecursionError):
        return not end and line.startswith(b'{"port"')  # a first line longer than what was looked at
    return isinstance(plain, dict) and "data" in plain


class _Port(FlatPort):
    """A port of JSON lines; the bytes of a sample are its line."""

    @cached_property
    def decode(self) -> Callable[[bytes], Any]:
        """A function that makes a record of a line; RecordingError when its type is not loaded."""
        if self.unknown:
            raise RecordingError(f"port {self.name!r}: {self.unknown}")
        reader = LineReader({self.name: self.type})

        def take(data: bytes) -> Any:
            if end := _END.search(data):
                try:
                    return reader.sample(f"{data[: end.start()].decode()}}}", int(end[1]))[1]
                except (RecordError, UnicodeDecodeError) as error:
                    raise WireError(str(error)) from None
            try:
                found = _parsed(data)
                log_time = found.pop("log_time", 0)
                return reader.sample(json.dumps(found), log_time)[1]
            except (BadBytes, RecordError) as error:
                raise WireError(str(error)) from None

        return take

    def plain(self, data: bytes) -> Any:
        """The data of a line as they are. WireError for a line without data."""
        try:
            return _parsed(data)["data"]
        except (BadBytes, KeyError) as error:
            raise WireError(f"no sample: {error}") from None


class LinesReader(FlatReader):
    """Open JSON lines. DamagedError, when samples are read, for a line that is no sample."""

    encoding: ClassVar[str] = "jsonl"
    port_kind = _Port
    made_by: ClassVar[str] = "JSON lines"

    def head(self, line: bytes) -> Head:
        """Port, type, time, and the line itself. BadBytes for a line that is no sample."""
        if (begin := _BEGIN.match(line)) and (end := _END.search(line, begin.end())) and int(end[1]) < _LATEST:
            return Head(begin[0], int(end[1]), line)
        found = _parsed(line)
        names = found.get("port"), found.get("type")
        time = _nanoseconds(found.get("log_time", found.get("tm")))
        if not all(isinstance(name, str) for name in names) or "data" not in found or found.keys() - _KEYS:
            raise BadBytes('expected {"port": NAME, "type": TYPE, "tm": TIME, "data": DATA}')
        if time is None or not 0 <= time < _LATEST:
            raise BadBytes("has no time: aiorts log cat --log-time writes one for types without tm")
        return Head(names, time, line)

    def named(self, key: Any) -> tuple[str, str]:
        """Port and type of a key; lines have the bare name of a user's type, which becomes the full one."""
        port, name = key if isinstance(key, tuple) else _names(key)
        try:
            cls = wire_type(name, bare=True)
        except UnknownTypeError:
            return port, name
        return port, name if cls is None else wire_name(cls)

    def published(self, data: bytes, log_time: int) -> int:
        """The `tm` of a line, or `log_time` without one; decoding the line reports a `tm` that is wrong."""
        if (begin := _BEGIN.match(data)) and (found := _TM.match(data, begin.end())):
            return int(found[1])
        try:
            tm = _nanoseconds(_parsed(data).get("tm"))
        except BadBytes:
            return log_time
        return log_time if tm is None or not 0 <= tm < _LATEST else tm


def _nanoseconds(time: Any) -> int | None:
    """A time of a line in ns, from a number or from seconds and nanoseconds; None for anything else."""
    if isinstance(time, dict) and set(time) == {"sec", "nsec"}:
        seconds, nanoseconds = time["sec"], time["nsec"]
        if type(seconds) is not int or type(nanoseconds) is not int:  # a text times 10**9 would fill the memory
            return None
        return seconds * 10**9 + nanoseconds
    return time if type(time) is int else None


def _names(begin: bytes) -> tuple[str, str]:
    try:
        found = json.loads(begin.rstrip(b", ") + b"}")
    except ValueError:
        raise BadBytes("no JSON") from None
    return found["port"], found["type"]


def _parsed(line: bytes) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise BadBytes(f"no JSON: {str(error)[:80]}") from None
    if not isinstance(found, dict):
        raise BadBytes("expected an object")
    return found
