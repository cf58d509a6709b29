"""Converts recordings: into another format, a part of one, or several into one.

A damaged recording is refused before the target exists, with the way to salvage it. A recording
that was not closed, but is whole otherwise, is converted up to its last sample; the report says so.
"""

from __future__ import annotations

import contextlib
import heapq
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from aiorts.errors import ConfigurationError
from aiorts.progress import Step, progress
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.mcap.encodings import Encoding
from aiorts_log.mcap.format import Attachment
from aiorts_log.mcap.reader import RecordedPort, RecordedSample, Recording, counted, not_closed
from aiorts_log.mcap.source import Limits
from aiorts_log.text.csv_format import TableOptions
from aiorts_log.text.csv_in import TableReader
from aiorts_log.text.line_sinks import FolderSink, LinesSink, TableSink
from aiorts_log.text.opening import LINES_ENDINGS, format_of, open_recording
from aiorts_log.text.sinks import McapSink, Sink, TextSink
from aiorts_log.whole import whole_file, whole_folder

Format: TypeAlias = Literal["mcap", "text", "jsonl", "csv"]
FORMATS: Final[tuple[Format, ...]] = ("mcap", "csv", "text", "jsonl")
_ENDINGS: Final[dict[str, Format]] = {
    ".mcap": "mcap",
    ".csv": "csv",
    ".tsv": "csv",
    ".txt": "text",
    ".log": "text",
    **dict.fromkeys(LINES_ENDINGS, "jsonl"),
}
_STEP: Final = 2048


@dataclass(frozen=True, slots=True)
class Converted:
    """The result of a conversion.

    Attributes:
        samples: their number, by port.
        format: the target's format.
        left_out: the content that its format cannot hold, in words.
        unused: columns of a table that no field was read from.
        bad: rows of a table that were left out, as line number and reason.
        not_closed: recordings that were not closed, with the number of unusable bytes at their end.
    """

    samples: dict[str, int] = field(default_factory=dict)
    format: Format = "mcap"
    left_out: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    bad: tuple[tuple[int, str], ...] = ()
    not_closed: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True)
class _Wanted:
    """The options of the target that is written."""

    format: Format
    overwrite: bool
    encoding: Encoding | None = None
    options: TableOptions = field(default_factory=TableOptions)
    split: bool = False


def format_by_name(path: Path, option: str) -> Format:
    """The format that the ending of a name stands for. ConfigurationError for another ending."""
    chosen_format = _ENDINGS.get(path.suffix.lower())
    if chosen_format is None:
        raise ConfigurationError(f"{path}: unknown ending; {option} {' | '.join(FORMATS)}")
    return chosen_format


def convert(
    source: Path,
    target: Path,
    *,
    source_format: Format | None = None,
    target_format: Format | None = None,
    ports: Collection[str] | None = None,
    table: TableOptions | None = None,
    encoding: Encoding | None = None,
    split: bool = False,
    overwrite: bool = False,
    limits: Limits | None = None,
) -> Converted:
    """Write a recording in another format.

    Args:
        source_format: the source's format; None takes .csv and .tsv for a table, and recognises the others.
        target_format: the target's format; None goes by its name.
        ports: the wanted ports of a recording; None is all. `table` has the ports of a table.
        encoding: of the samples of an MCAP file; None keeps that of the source.
        split: write a folder with a table for each port.

    Raises:
        RecordingError: one of the files cannot be used, is damaged, or the target's format cannot hold the samples.
        ConfigurationError: the table's columns and ports do not match.
    """
    options = table or TableOptions()
    if target_format is None:
        target_format = "csv" if split else format_by_name(target, "--to")
    wanted = _Wanted(target_format, overwrite, encoding, options, split)
    if source_format is None and source.suffix.lower() in (".csv", ".tsv"):
        source_format = "csv"
    if source_format == "csv":
        with (
            TableReader(source, options, target=target, ports=tuple(ports or ())) as reader,
            progress("converting", reader.size) as step,
        ):
            made = _write(target, [source], wanted, reader.ports, (), _stepping(reader, step))
            return Converted(made.samples, made.format, made.left_out, reader.unused, tuple(reader.bad), ())
    if source_format is not None and format_of(source) != source_format:
        raise RecordingError(f"{source}: is {format_of(source)}, not {source_format}; leave out --from")
    return _copy(source, target, wanted, ports, None, None, limits)


def cut(
    source: Path,
    target: Path,
    *,
    start: int | None = None,
    end: int | None = None,
    ports: Collection[str] | None = None,
    overwrite: bool = False,
    limits: Limits | None = None,
) -> Converted:
    """Write a part of a recording: these ports, from `start` up to and without `end` (log times in ns).

    The format is that of the source unless the target's name has another ending. Raises as `convert`.
    """
    chosen_format = _ENDINGS.get(target.suffix.lower()) or format_of(source)
    return _copy(source, target, _Wanted(chosen_format, overwrite), ports, start, end, limits)


def merge(
    sources: Sequence[Path],
    target: Path,
    *,
    prefixes: Sequence[str] | None = None,
    join: bool = False,
    overwrite: bool = False,
    limits: Limits | None = None,
) -> Converted:
    """Write several recordings as one, in the order of their log times.

    Args:
        prefixes: texts in front of the names of ports, one for each source; "" is none.
        join: merge ports of the same name and type.

    Raises:
        RecordingError: as `convert`; or two sources have a port of the same name.
    """
    if prefixes is not None and len(prefixes) != len(sources):
        raise ConfigurationError(f"--prefix: give one for each of the {len(sources)} files, '' for none")
    wanted = _Wanted(format_by_name(target, "--to"), overwrite)
    with contextlib.ExitStack() as stack:
        readers: list[Recording] = []
        for source in sources:
            readers.append(open_recording(source, limits=limits))
            stack.callback(readers[-1].close)
        ports: dict[str, RecordedPort] = {}
        fronts = list(prefixes or [""] * len(readers))
        for reader, front in zip(readers, fronts, strict=True):
            refuse_damaged(reader)
            for name, port in filled(reader).items():
                _take_port(ports, f"{front}{name}", port, join, reader)
        unique = wanted.format == "csv"
        streams = [_named(reader, front, unique) for reader, front in zip(readers, fronts, strict=True)]
        samples = heapq.merge(*streams, key=lambda one: one[1].log_time)
        attachments = [one for reader in readers for one in reader.attachments()]
        with progress("merging", sum(reader.count for reader in readers)) as step:
            made = _write(target, sources, wanted, ports, attachments, counted(samples, step))
        return Converted(made.samples, made.format, made.left_out, (), (), tuple(not_closed(readers)))


def _take_port(ports: dict[str, RecordedPort], name: str, port: RecordedPort, join: bool, reader: Recording) -> None:
    there = ports.get(name)
    if there is None:
        ports[name] = port
        return
    if there.type_name != port.type_name or (there.encoding == port.encoding and _fields(there) != _fields(port)):
        raise RecordingError(
            f"{reader.path}: port {name[:60]!r} is {port.type_name}, and {there.type_name} in another file; --prefix"
        )
    if not join:
        raise RecordingError(
            f"{reader.path}: port {name[:60]!r} is in another file, too; --prefix renames, --join makes them one"
        )


def _fields(port: RecordedPort) -> bytes:
    return port.schema.data if port.schema is not None else b""


def _copy(
    source: Path,
    target: Path,
    wanted: _Wanted,
    names: Collection[str] | None,
    start: int | None,
    end: int | None,
    limits: Limits | None,
) -> Converted:
    with open_recording(source, limits=limits) as reader:
        refuse_damaged(reader)
        ports = filled(reader) if names is None else reader.chosen(names)
        samples = _named(reader, "", wanted.format == "csv", start=start, end=end, ports=names)
        with progress("converting", reader.count) as step:
            made = _write(target, [source], wanted, ports, reader.attachments(), counted(samples, step))
        return Converted(made.samples, made.format, made.left_out, (), (), tuple(not_closed([reader])))


def filled(reader: Recording) -> dict[str, RecordedPort]:
    """The ports that have samples: others would be empty columns of a table."""
    return {name: port for name, port in reader.ports.items() if port.count}


def refuse_damaged(reader: Recording) -> None:
    """Raise DamagedError, with the way to salvage it, for a recording that is broken between its samples."""
    if reader.damage:
        text = f"{reader.path}: damaged: {reader.fault}; aiorts log salvage copies what is whole"
        raise DamagedError(text, reader.damage[0].offset)


def _named(reader: Recording, front: str, unique: bool, **chosen: Any) -> Iterator[tuple[str, RecordedSample]]:
    """The samples with the names of their ports; `unique` numbers ports that have one name and several types."""
    known = {id(port): f"{front}{name if unique else port.name}" for name, port in reader.ports.items()}
    for sample in reader.samples(**chosen):
        yield known[id(sample.port)], sample


def _stepping(reader: TableReader, step: Step) -> Iterator[tuple[str, RecordedSample]]:
    before = 0
    for number, sample in enumerate(reader.samples(), 1):
        yield sample.port.name, sample
        if not number % _STEP:
            step(reader.read - before)
            before = reader.read
    step(reader.size - before)


def _write(
    target: Path,
    sources: Sequence[Path],
    wanted: _Wanted,
    ports: Mapping[str, RecordedPort],
    attachments: Iterable[Attachment],
    samples: Iterable[tuple[str, RecordedSample]],
) -> Converted:
    """Write everything into the target, which appears when that has succeeded."""
    place = whole_folder(target, sources) if wanted.split else whole_file(target, sources, wanted.overwrite)
    counts = dict.fromkeys(
        (name if wanted.format == "csv" else name.removesuffix(f"#{port.id}") for name, port in ports.items()), 0
    )
    with place as part:
        sink = _sink(part, wanted, ports)
        try:
            for one in attachments:
                sink.attach(one)
            put = sink.put
            for name, sample in samples:
                put(name, sample)
                counts[name] += 1
            sink.finish()
        finally:
            sink.abandon()
    return Converted(counts, wanted.format, sink.left_out)


def _sink(part: Path, wanted: _Wanted, ports: Mapping[str, RecordedPort]) -> Sink:
    if wanted.split:
        if wanted.format != "csv":
            raise ConfigurationError("--split: writes tables; --to csv")
        return FolderSink(part, ports, wanted.options)
    if wanted.format == "mcap":
        return McapSink(part, wanted.encoding)
    if wanted.format == "csv":
        return TableSink(part, ports, wanted.options)
    return TextSink(part) if wanted.format == "text" else LinesSink(part)
