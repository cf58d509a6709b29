"""The flat text file of the Flexi paper, one sample on a line, written so that it can be replayed and continued.

    # aiorts text recording 1.0, aiorts 0.1.0
    # {"port": "pid0.command", "type": "TimedDouble", "metadata": {"unit": "m/s"}}
    pid0.command<TAB>TimedDouble<TAB>1700000000.000000005<TAB>{"tm": 1700000000000000000, "data": 1.5}
    # {"end": {"why": "closed", "stored": 1}, "samples": 1}

Port, type, log time in seconds with nine digits, and the record as the JSON of `aiorts.types.to_plain` (a bare value is
`{"value": 5}`). Whatever does not print is escaped as JSON does it, in names, too; a name cannot begin a comment.
Without the first line, as after `grep`, it is read as well. Text has no checksums; a NaN is any NaN.
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
from pathlib import Path
from typing import Any, ClassVar, Final

import aiorts
from aiorts.errors import AiortsError, RecordError
from aiorts.types import describe, to_plain
from aiorts.wire import json_text
from aiorts_log.columns import columns_of
from aiorts_log.errors import RecordingError
from aiorts_log.file import Existing, LogFile
from aiorts_log.flat import LONGEST, FlatReader, Head
from aiorts_log.form import Attachment, BadOctets, Channel, Schema
from aiorts_log.outfile import OutFile
from aiorts_log.reader import END_NAME, METADATA_NAME
from aiorts_log.writer import RecordingWriter

__all__ = ("FIRST", "TextFile", "TextReader", "TextWriter", "looks_like_text", "text_encode")

MAJOR: Final = 1
MINOR: Final = 0
FIRST: Final = b"# aiorts text recording "
_VERSION: Final = re.compile(rb"# aiorts text recording (\d{1,9})\.(\d{1,9})")
_TIME: Final = re.compile(rb"\d{1,10}\.\d{9}")
_LINE: Final = re.compile(rb"[^\t\n#][^\t\n]*\t[^\t\n]+\t\d{1,10}\.\d{9}\t")
_TM: Final = re.compile(rb'\{"tm": ?(\d{1,19})[,}]')
_TM_TIME: Final = re.compile(rb'\{"tm": ?\{"sec": ?(\d{1,10}), ?"nsec": ?(\d{1,9})\}')
_LATEST: Final = 2**63
_FRONT: Final = 2**16
"""Octets of a line that are kept for what stands in front of the record."""
_PRINTED: Final = "# {}\n"


def text_encode(record: Any) -> bytes:
    """A record as it stands on a line. RecordError when it cannot."""
    cls = type(record)
    if cls not in _templates:
        _templates[cls] = _template_of(cls)
    template = _templates[cls]
    if template is not None:
        values = template[1](record)
        if all(map(math.isfinite, values)):
            return (template[0] % values).encode()
    plain = to_plain(record)
    octets = json_text(plain if hasattr(cls, "__dataclass_fields__") else {"value": plain}).encode()
    if len(octets) > LONGEST - _FRONT:
        raise RecordError(f"{cls.__name__}: a sample of {len(octets)} octets; a line has at most {LONGEST}")
    return octets


_templates: dict[type, tuple[str, Callable[[Any], tuple[Any, ...]]] | None] = {}


def _template_of(cls: type) -> tuple[str, Callable[[Any], tuple[Any, ...]]] | None:
    """What records that are nothing but numbers, checked when they were made, are put into."""
    if not hasattr(cls, "__dataclass_fields__"):
        return None
    columns = columns_of(cls)
    if len(columns) < 2 or not describe(cls).checked or any(one.form not in ("float", "int") for one in columns):
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
    """Whether a file that begins with these octets is a text recording."""
    if first.startswith(FIRST):
        return True
    begin = 0
    while first[begin : begin + 1] == b"#" and (end := first.find(b"\n", begin)) >= 0:
        begin = end + 1
    return _LINE.match(first, begin) is not None


class TextReader(FlatReader):
    """An open text recording. RecordingError when it is none, or of a newer version."""

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
        """Port, log time and record of a line. BadOctets for one that is no sample."""
        parts = line.split(b"\t", 3)
        if len(parts) != 4:
            raise BadOctets(f"expected PORT, TYPE, TIME and DATA with tabs between them, got {_shown(line)}")
        port, type_name, time, data = parts
        if not _TIME.fullmatch(time):
            raise BadOctets(f"expected a time as seconds with nine digits, got {_shown(time)}")
        log_time = int(time.replace(b".", b""))
        if log_time >= _LATEST or not type_name:
            raise BadOctets(f"expected PORT, TYPE, TIME and DATA, got {_shown(line)}")
        if not data.startswith(b"{") or not data.rstrip().endswith(b"}"):
            raise BadOctets(f"expected the JSON of a record, got {_shown(data)}")
        self._end_stands = False
        return Head((port, type_name), log_time, data)

    def named(self, key: Any) -> tuple[str, str]:
        """Port and type as they are. BadOctets when that is no text."""
        try:
            names = [json.loads(b'"' + part + b'"') for part in key]
        except ValueError:
            raise BadOctets(f"no name: {_shown(key[0])}") from None
        return names[0], names[1]

    def published(self, data: bytes, log_time: int) -> int:
        """The `tm` of a record; `log_time` when it has none."""
        if found := _TM.match(data):
            return int(found[1])
        if found := _TM_TIME.match(data):
            return int(found[1]) * 10**9 + int(found[2])
        return log_time

    def remark(self, line: bytes, number: int) -> None:
        """Take what is said of ports and of the system; all other comments are somebody's own."""
        if number == 1 and (found := _VERSION.match(line)):
            self._has_first = True
            if int(found[1]) > MAJOR:
                version = line[2:60].decode("ascii", "replace").rstrip()
                raise RecordingError(f"{self.path}: {version}; this reads <= {MAJOR}; install a newer aiorts")
        if not line.startswith(b"# {"):
            return
        try:
            said = json.loads(line[2:])
        except (ValueError, RecursionError):
            return
        if isinstance(said.get("port"), str) and isinstance(said.get("metadata"), dict):
            about = {str(key): str(value) for key, value in said["metadata"].items()}
            self._about[said["port"], str(said.get("type"))] = about
        elif "end" in said:
            self._end_stands = True
            self._documents["end"].append(said["end"])
            octets = json.dumps(said["end"], indent=1).encode()
            self._attachments.append(Attachment(0, 0, END_NAME, "application/json", octets))
            self._counted_wrong |= said.get("samples", self.count) != self.count
        elif isinstance(said.get("file"), str):
            self._take_file(said)

    def _take_file(self, said: dict[str, Any]) -> None:
        name, time = said["file"], said.get("time", 0)
        try:
            octets = base64.b64decode(said["base64"]) if "base64" in said else str(said.get("text", "")).encode()
        except (binascii.Error, ValueError, TypeError):
            return
        time = time if isinstance(time, int) and 0 <= time < _LATEST else 0
        self._attachments.append(Attachment(time, time, name, str(said.get("media", "")), octets))
        if name == METADATA_NAME:
            try:
                self._documents["metadata"].append(json.loads(octets))
            except (ValueError, RecursionError):
                return


def _shown(octets: bytes) -> str:
    text = octets[:40].decode("utf-8", "backslashreplace")
    return repr(text if len(octets) <= 40 else f"{text}...")


class _Builder:
    """Lines that are not yet in the file, with the face of a chunk that is being built."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.heads: dict[int, bytes] = {}
        self.begin()

    def begin(self) -> None:
        """Nothing is in it."""
        self.parts = []
        self._counts: dict[int, int] = {}
        self.count = self.octets = self.start = 0

    def say(self, line: str) -> None:
        """Put in a comment."""
        self.parts.append(_PRINTED.format(line).encode())
        self.octets += len(self.parts[-1])

    def add(self, channel: int, sequence: int, log_time: int, publish_time: int, data: bytes, more: bytes = b"") -> int:
        """Put in a sample. Returns how many octets there are now."""
        if not self.count:
            self.start = log_time
        line = b"%s%d.%09d\t%s\n" % (self.heads[channel], log_time // 10**9, log_time % 10**9, data + more)
        self.parts.append(line)
        self._counts[channel] = self._counts.get(channel, 0) + 1
        self.count += 1
        self.octets += len(line)
        return self.octets

    @property
    def is_empty(self) -> bool:
        """Whether there is no sample in it."""
        return not self.count

    def counts(self) -> dict[int, int]:
        """Samples by channel."""
        return self._counts


class TextFile(OutFile):
    """A text recording that is being written; arguments, attributes and errors as those of `OutFile`."""

    builder: Any

    def __init__(
        self, path: Path, existing: Existing = "refuse", min_free: int | None = None, kind: type[LogFile] = LogFile
    ) -> None:
        self.path = path
        self._file = kind(path, existing, min_free)
        self.builder = _Builder()
        self._channels: dict[tuple[str, str], Channel] = {}
        self._counts: dict[int, int] = {}
        self.floor = 0
        self.first: int | None = None
        self.begun_with = 0
        try:
            if self._file.size:
                self._continue()
            else:
                self._file.append([FIRST + f"{MAJOR}.{MINOR}, aiorts {aiorts.__version__}\n".encode()])
        except OSError as error:
            self._file.close()
            raise RecordingError(f"{path}: cannot be written: {error.strerror or error}") from None
        except BaseException:
            self._file.close()
            raise

    def _continue(self) -> None:
        if not looks_like_text(os.pread(self._file.descriptor, 4096, 0)):
            raise RecordingError(f"{self.path}: is no text recording and cannot be continued; name another file")
        with TextReader(self.path) as reader:
            if reader.damage:
                raise RecordingError(
                    f"{self.path}: {reader.fault}; aiorts log salvage makes a whole one, which can be continued"
                )
            for port in reader.ports.values():
                self._define(port.name, port.type_name)
            self._counts = {number: port.count for number, port in enumerate(reader.ports.values(), 1)}
            self.begun_with, self.floor = reader.count, reader.end
            if reader.torn is not None:
                self._file.cut(reader.torn.offset)
            elif not reader.complete:
                self._file.append([b"\n"])

    @property
    def counts(self) -> Mapping[int, int]:
        """Samples in the file, by channel."""
        return self._counts

    def channel_of(self, port: str, schema: Schema, encoding: str, metadata: Mapping[str, str]) -> Channel:
        """The channel for a port and type: the one that is in the file already, or a new one."""
        known = self._channels.get((port, schema.name))
        if known is None:
            known = self._define(port, schema.name)
            self.builder.say(json_text({"port": port, "type": schema.name, "metadata": dict(metadata)}))
        return known

    def _define(self, port: str, type_name: str) -> Channel:
        number = len(self._channels) + 1
        names = [json_text(name)[1:-1] for name in (port, type_name)]
        if names[0][:1] == "#":
            names[0] = f"\\u0023{names[0][1:]}"
        self.builder.heads[number] = "\t".join((*names, "")).encode()
        self._channels[port, type_name] = channel = Channel(number, number, port, "json", {})
        return channel

    def end_chunk(self) -> None:
        """Append what was collected. OSError when it cannot be; it is lost then."""
        builder = self.builder
        if not builder.octets:
            return
        if self.first is None and builder.count:
            self.first = builder.start
        parts, counts = builder.parts, builder.counts()
        builder.begin()
        self._file.append([b"".join(parts)])
        for channel, count in counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count

    def drop_chunk(self) -> None:
        """Give up what was collected; what follows is short, and may use what was to stay free."""
        self.builder.begin()
        self._file.use_reserve()

    def attach(self, one: Attachment) -> None:
        """Append a file within the file. OSError when it cannot be."""
        said: dict[str, Any] = {"file": one.name, "time": one.log_time, "media": one.media_type}
        try:
            said["text"] = one.data.decode()
        except UnicodeDecodeError:
            said["base64"] = base64.b64encode(one.data).decode("ascii")
        self._say(said)

    def attach_json(self, name: str, document: Any, time: int) -> None:
        """Append a document. OSError when it cannot be."""
        if name == END_NAME:
            self.end_chunk()
            plain = json.loads(json.dumps(document, default=str))
            self._say({"end": plain, "samples": sum(self._counts.values())})
        else:
            super().attach_json(name, document, time)

    def _say(self, said: dict[str, Any]) -> None:
        self.end_chunk()
        self._file.append([_PRINTED.format(json_text(said)).encode()])

    def finish(self) -> None:
        """Let the file go; its end was said already. OSError when the last lines cannot be written."""
        try:
            self.end_chunk()
        finally:
            self._file.close()


class TextWriter(RecordingWriter):
    """A text recording that is being made; everything as with `RecordingWriter`, and `encoding` is not used."""

    out = TextFile
    encoder = staticmethod(lambda encoding, cls=None: text_encode)
    splitter = staticmethod(lambda encoding, cls: None)
