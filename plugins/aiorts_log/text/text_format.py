"""The flat text file of the Flexi paper, one sample on a line, written so that it can be replayed and continued.

    # aiorts text recording 1.0, aiorts 0.1.0
    # {"port": "pid0.command", "type": "TimedDouble", "metadata": {"unit": "m/s"}}
    pid0.command<TAB>TimedDouble<TAB>1700000000.000000005<TAB>{"tm": 1700000000000000000, "data": 1.5}
    # {"end": {"why": "closed", "stored": 1}, "samples": 1}

Port, type, log time in seconds with nine digits, and the record as the JSON of `aiorts.types.to_plain` (a bare value is
`{"value": 5}`, and a field that is None, as it is by default, is left out). Characters that do not print are escaped
as in JSON, in names, too; a name cannot begin a comment. A file without the first line, as after `grep`, is read as
well. Text has no checksums; a NaN is any NaN.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import os
import re
from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any, ClassVar, Final

import aiorts
from aiorts.errors import AiortsError, RecordError
from aiorts.types import describe, to_plain
from aiorts.wire import json_message, json_text
from aiorts_log.errors import RecordingError
from aiorts_log.mcap.format import Attachment, BadBytes, Channel, Schema
from aiorts_log.mcap.outfile import OutFile
from aiorts_log.mcap.reader import END_NAME
from aiorts_log.recorder.writer import RecordingWriter
from aiorts_log.text.columns import columns_of, is_numbers
from aiorts_log.text.flat import LONGEST, FlatReader, Head

MAJOR: Final = 1
MINOR: Final = 0
FIRST: Final = b"# aiorts text recording "
_VERSION: Final = re.compile(rb"# aiorts text recording (\d{1,9})\.(\d{1,9})")
_TIME: Final = re.compile(rb"\d{1,10}\.\d{9}")
_LINE: Final = re.compile(rb"[^\t\n#][^\t\n]*\t[^\t\n]+\t\d{1,10}\.\d{9}\t")
_TM: Final = re.compile(rb'\{"tm": ?(\d{1,19})[,}]')
_TM_TIME: Final = re.compile(rb'\{"tm": ?\{"sec": ?(\d{1,10}), ?"nsec": ?(\d{1,9})\}')
_HEADER: Final = re.compile(rb'\{"header": ?\{"stamp": ?\{"sec": ?(-?\d{1,10}), ?"nanosec": ?(\d{1,10})\}')
_LATEST: Final = 2**63
_FRONT: Final = 2**16
"""Bytes of a line reserved for what precedes the record."""
_PRINTED: Final = "# {}\n"


def text_encode(record: Any) -> bytes:
    """Encode a record for a line. RecordError when the record cannot be encoded."""
    cls = type(record)
    if cls not in _templates:
        _templates[cls] = _template_of(cls)
    template = _templates[cls]
    if template is not None:
        values = template[1](record)
        if all(map(math.isfinite, values)):
            return (template[0] % values).encode()
    data = json_text(json_message(record)).encode()
    if len(data) > LONGEST - _FRONT:
        raise RecordError(f"{cls.__name__}: a sample of {len(data)} bytes; a line has at most {LONGEST}")
    return data


_templates: dict[type, tuple[str, Callable[[Any], tuple[Any, ...]]] | None] = {}


def _template_of(cls: type) -> tuple[str, Callable[[Any], tuple[Any, ...]]] | None:
    """A template for records of numbers alone whose constructor checks them; None for all others."""
    if not hasattr(cls, "__dataclass_fields__"):
        return None
    columns = columns_of(cls)
    if not is_numbers(columns) or not describe(cls).checked:
        return None
    try:
        shape = to_plain(cls())
    except (AiortsError, TypeError):
        return None  # it has no defaults
    if not isinstance(shape, dict) or _leaves(shape) != len(columns):
        return None
    return _template(shape), attrgetter(*(column.path for column in columns))


def _leaves(shape: Any) -> int:
    return sum(map(_leaves, shape.values())) if isinstance(shape, dict) else 1


def _template(shape: Any) -> str:
    if not isinstance(shape, dict):
        return "%r"
    inner = ", ".join(f"{json.dumps(name)}: {_template(value)}" for name, value in shape.items())
    return f"{{{inner}}}"


def looks_like_text(first: bytes) -> bool:
    """Whether a file that begins with these bytes is a text recording."""
    if first.startswith(FIRST):
        return True
    begin = 0
    while first[begin : begin + 1] == b"#" and (end := first.find(b"\n", begin)) >= 0:
        begin = end + 1
    return _LINE.match(first, begin) is not None


class TextReader(FlatReader):
    """An open text recording. RecordingError when the file is none, or of a newer version."""

    made_by: ClassVar[str] = "text recording"

    def _scan(self) -> None:
        self._has_first = False
        self._end_stands = self._counted_wrong = False
        super()._scan()
        if self._counted_wrong and not self.fault:
            self.fault = "its end counts other samples than there are: lines were taken out, or put in"
        if self._has_first and not self._end_stands:
            self.clean = False

    def head(self, line: bytes) -> Head:
        """Port, log time and record of a line. BadBytes for a line that is no sample."""
        parts = line.split(b"\t", 3)
        if len(parts) != 4:
            raise BadBytes(f"expected PORT, TYPE, TIME and DATA with tabs between them, got {_quoted(line)}")
        port, type_name, time, data = parts
        if not _TIME.fullmatch(time):
            raise BadBytes(f"expected a time as seconds with nine digits, got {_quoted(time)}")
        log_time = int(time.replace(b".", b""))
        if log_time >= _LATEST or not type_name:
            raise BadBytes(f"expected PORT, TYPE, TIME and DATA, got {_quoted(line)}")
        if not data.startswith(b"{") or not data.rstrip().endswith(b"}"):
            raise BadBytes(f"expected the JSON of a record, got {_quoted(data)}")
        self._end_stands = False
        return Head((port, type_name), log_time, data)

    def named(self, key: Any) -> tuple[str, str]:
        """Port and type of a key. BadBytes when they are no text."""
        try:
            names = [json.loads(b'"' + part + b'"') for part in key]
        except ValueError:
            raise BadBytes(f"no name: {_quoted(key[0])}") from None
        return names[0], names[1]

    def published(self, data: bytes, log_time: int) -> int:
        """The `tm` of a record; `log_time` without one."""
        if found := _TM.match(data):
            return int(found[1])
        if found := _TM_TIME.match(data) or _HEADER.match(data):
            return max(0, int(found[1]) * 10**9 + int(found[2]))
        return log_time

    def remark(self, line: bytes, number: int) -> None:
        """Read comments that aiorts wrote, on ports, the system and the end; all others are passed over."""
        if number == 1 and (found := _VERSION.match(line)):
            self._has_first = True
            if int(found[1]) > MAJOR:
                version = line[2:60].decode("ascii", "replace").rstrip()
                raise RecordingError(f"{self.path}: {version}; this reads <= {MAJOR}; install a newer aiorts")
        if not line.startswith(b"# {"):
            return
        try:
            entry = json.loads(line[2:])
        except (ValueError, RecursionError):
            return
        if isinstance(entry.get("port"), str) and isinstance(entry.get("metadata"), dict):
            about = {str(key): str(value) for key, value in entry["metadata"].items()}
            self._about[entry["port"], str(entry.get("type"))] = about
        elif "end" in entry:
            self._end_stands = True
            data = json.dumps(entry["end"], indent=1).encode()
            self._attachments.append(Attachment(0, 0, END_NAME, "application/json", data))
            self._counted_wrong |= entry.get("samples", self.count) != self.count
        elif isinstance(entry.get("file"), str):
            self._take_file(entry)

    def _take_file(self, entry: dict[str, Any]) -> None:
        name, time = entry["file"], entry.get("time", 0)
        try:
            data = base64.b64decode(entry["base64"]) if "base64" in entry else str(entry.get("text", "")).encode()
        except (binascii.Error, ValueError, TypeError):
            return
        time = time if isinstance(time, int) and 0 <= time < _LATEST else 0
        self._attachments.append(Attachment(time, time, name, str(entry.get("media", "")), data))


def _quoted(data: bytes) -> str:
    text = data[:40].decode("utf-8", "backslashreplace")
    return repr(text if len(data) <= 40 else f"{text}...")


class _Builder:
    """Collects lines for the file, with the interface of `ChunkBuilder`."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.heads: dict[int, bytes] = {}
        self.begin()

    def begin(self) -> None:
        """Empty the builder."""
        self.parts = []
        self._counts: dict[int, int] = {}
        self.count = self.size = self.start = 0

    def comment(self, line: str) -> None:
        """Add a comment."""
        self.parts.append(_PRINTED.format(line).encode())
        self.size += len(self.parts[-1])

    def add(self, channel: int, sequence: int, log_time: int, publish_time: int, data: bytes, more: bytes = b"") -> int:
        """Add a sample. Returns the bytes collected."""
        if not self.count:
            self.start = log_time
        line = b"%s%d.%09d\t%s\n" % (self.heads[channel], log_time // 10**9, log_time % 10**9, data + more)
        self.parts.append(line)
        self._counts[channel] = self._counts.get(channel, 0) + 1
        self.count += 1
        self.size += len(line)
        return self.size

    @property
    def is_empty(self) -> bool:
        """Whether it has no sample."""
        return not self.count

    def counts(self) -> dict[int, int]:
        """Samples by channel."""
        return self._counts


class TextFile(OutFile):
    """A text recording that is being written; arguments, attributes and errors as those of `OutFile`."""

    builder: Any

    def _begin(self) -> None:
        self.builder = _Builder()
        self._channels: dict[tuple[str, str], Channel] = {}
        if not self._file.size:
            self._file.append([FIRST + f"{MAJOR}.{MINOR}, aiorts {aiorts.__version__}\n".encode()])
            return
        if not looks_like_text(os.pread(self._file.descriptor, 4096, 0)):
            raise RecordingError(f"{self.path}: is no text recording and cannot be continued; name another file")
        with TextReader(self.path) as reader:
            if reader.damage:
                raise RecordingError(
                    f"{self.path}: {reader.fault}; aiorts log salvage makes a whole one, which can be continued"
                )
            for port in reader.ports.values():
                self._define(port.name, port.type_name)
            self.counts = {number: port.count for number, port in enumerate(reader.ports.values(), 1)}
            self.floor = reader.end
            if reader.torn is not None:
                self._file.cut(reader.torn.offset)
            elif not reader.complete:
                self._file.append([b"\n"])

    def channel_of(self, port: str, schema: Schema, encoding: str, metadata: Mapping[str, str]) -> Channel:
        """The channel for a port and type: the one that the file has, or a new one."""
        known = self._channels.get((port, schema.name))
        if known is None:
            known = self._define(port, schema.name)
            self.builder.comment(json_text({"port": port, "type": schema.name, "metadata": dict(metadata)}))
        return known

    def _define(self, port: str, type_name: str) -> Channel:
        number = len(self._channels) + 1
        names = [json_text(name)[1:-1] for name in (port, type_name)]
        if names[0][:1] == "#":
            names[0] = f"\\u0023{names[0][1:]}"
        self.builder.heads[number] = "\t".join((*names, "")).encode()
        self._channels[port, type_name] = channel = Channel(number, number, port, "json", {})
        return channel

    def _append_chunk(self) -> None:
        parts = self.builder.parts
        self.builder.begin()
        self._file.append([b"".join(parts)])

    def drop_chunk(self) -> None:
        """Drop the samples collected, and let the short lines that follow use the reserved space."""
        self.builder.begin()
        self._file.use_reserve()

    def attach(self, one: Attachment) -> None:
        """Append a file within the file. OSError when that fails."""
        entry: dict[str, Any] = {"file": one.name, "time": one.log_time, "media": one.media_type}
        try:
            entry["text"] = one.data.decode()
        except UnicodeDecodeError:
            entry["base64"] = base64.b64encode(one.data).decode("ascii")
        self._append_comment(entry)

    def attach_json(self, name: str, document: Any, time: int) -> None:
        """Append a JSON document. OSError when that fails."""
        if name == END_NAME:
            self.end_chunk()
            plain = json.loads(json.dumps(document, default=str))
            self._append_comment({"end": plain, "samples": sum(self.counts.values())})
        else:
            super().attach_json(name, document, time)

    def _append_comment(self, entry: dict[str, Any]) -> None:
        self.end_chunk()
        self._file.append([_PRINTED.format(json_text(entry)).encode()])

    def finish(self) -> None:
        """Close the file, whose end report was written before. OSError when the last lines cannot be written."""
        try:
            self.end_chunk()
        finally:
            self._file.close()


class TextWriter(RecordingWriter):
    """A text recording that is being made; as `RecordingWriter`, without `encoding`."""

    out = TextFile
    encoder = staticmethod(lambda encoding, cls=None: text_encode)
    splitter = staticmethod(lambda encoding, cls: None)
