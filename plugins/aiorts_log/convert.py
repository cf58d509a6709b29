"""Makes a recording of another one: in another form, a part of it, or of several.

A recording that is damaged is refused with what gets the whole of it (`aiorts log salvage`), before a target is there;
one that was only not closed is taken to its last sample, and the report says so.
"""

from __future__ import annotations

import contextlib
import heapq
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from aiorts.errors import ConfigurationError
from aiorts_log.csv_form import TableOptions
from aiorts_log.csv_in import TableReader
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.form import Attachment
from aiorts_log.forms import Encoding
from aiorts_log.line_sinks import FolderSink, LinesSink, TableSink
from aiorts_log.opening import Recording, form_of, open_recording
from aiorts_log.progress import Step, progress
from aiorts_log.reader import RecordedPort, RecordedSample
from aiorts_log.sinks import McapSink, Sink, TextSink
from aiorts_log.whole import whole_file, whole_folder

__all__ = ("FORMS", "Converted", "Form", "convert", "cut", "form_by_name", "merge")

Form: TypeAlias = Literal["mcap", "text", "jsonl", "csv"]
FORMS: Final[tuple[Form, ...]] = ("mcap", "csv", "text", "jsonl")
_ENDINGS: Final[dict[str, Form]] = {
    ".mcap": "mcap",
    ".csv": "csv",
    ".tsv": "csv",
    ".txt": "text",
    ".log": "text",
    ".jsonl": "jsonl",
    ".ndjson": "jsonl",
}
_STEP: Final = 2048


@dataclass(frozen=True, slots=True)
class Converted:
    """What was written.

    Attributes:
        samples: by port.
        form: of the target.
        left_out: what its form cannot hold, in words.
        unused: columns of a table that nobody asked for.
        bad: rows of a table that were left out, as line number and reason.
        not_closed: recordings that were not closed, with how many octets at their end are of no use.
    """

    samples: dict[str, int] = field(default_factory=dict)
    form: Form = "mcap"
    left_out: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    bad: tuple[tuple[int, str], ...] = ()
    not_closed: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True)
class _Wanted:
    """How a target is to be written."""

    form: Form
    overwrite: bool
    encoding: Encoding | None = None
    options: TableOptions = field(default_factory=TableOptions)
    split: bool = False


def form_by_name(path: Path, option: str) -> Form:
    """The form that the ending of a name tells. ConfigurationError when it tells none."""
    form = _ENDINGS.get(path.suffix.lower())
    if form is None:
        raise ConfigurationError(f"{path}: its ending tells no form; {option} {' | '.join(FORMS)}")
    return form


def convert(
    source: Path,
    target: Path,
    *,
    source_form: Form | None = None,
    target_form: Form | None = None,
    ports: Collection[str] | None = None,
    table: TableOptions | None = None,
    encoding: Encoding | None = None,
    split: bool = False,
    overwrite: bool = False,
) -> Converted:
    """Write a recording in another form.

    Args:
        source_form: what the source is; None is a table when it is called .csv or .tsv, and else what it looks like.
        target_form: what the target is to be; None goes by its name.
        ports: of a recording, those that are wanted; None is all. What a table has is said by `table`.
        encoding: of the samples of an MCAP file; None keeps what the source has.
        split: write a folder with a table for each port.

    Raises:
        RecordingError: one of the files cannot be had, is damaged, or the target's form cannot hold the samples.
        ConfigurationError: the table's columns and ports do not go together.
    """
    options = table or TableOptions()
    if target_form is None:
        target_form = "csv" if split else form_by_name(target, "--to")
    wanted = _Wanted(target_form, overwrite, encoding, options, split)
    if source_form is None and source.suffix.lower() in (".csv", ".tsv"):
        source_form = "csv"
    if source_form == "csv":
        with TableReader(source, options) as reader, progress("converting", reader.octets) as step:
            made = _write(target, [source], wanted, reader.ports, (), _stepping(reader, step))
            return Converted(made.samples, made.form, made.left_out, reader.unused, tuple(reader.bad), ())
    if source_form is not None and form_of(source) != source_form:
        raise RecordingError(f"{source}: is {form_of(source)}, not {source_form}; leave out --from")
    return _copy(source, target, wanted, ports, None, None)


def cut(
    source: Path,
    target: Path,
    *,
    start: int | None = None,
    end: int | None = None,
    ports: Collection[str] | None = None,
    overwrite: bool = False,
) -> Converted:
    """Write a part of a recording: from `start` up to `end`, without it (log times in ns), of these ports.

    The form is that of the source unless the target's name tells another. Raises as `convert`.
    """
    form = _ENDINGS.get(target.suffix.lower()) or _form(source)
    return _copy(source, target, _Wanted(form, overwrite), ports, start, end)


def merge(
    sources: Sequence[Path],
    target: Path,
    *,
    prefixes: Sequence[str] | None = None,
    join: bool = False,
    overwrite: bool = False,
) -> Converted:
    """Write several recordings as one, in the order of their log times.

    Args:
        prefixes: what to put in front of the names of ports, for each of the sources; "" is nothing.
        join: ports of the same name and type become one.

    Raises:
        RecordingError: as `convert`; or a name stands for two ports.
    """
    if prefixes is not None and len(prefixes) != len(sources):
        raise ConfigurationError(f"--prefix: give one for each of the {len(sources)} files, '' for none")
    wanted = _Wanted(form_by_name(target, "--to"), overwrite)
    with contextlib.ExitStack() as stack:
        readers: list[Recording] = []
        for source in sources:
            readers.append(open_recording(source))
            stack.callback(readers[-1].close)
        ports: dict[str, RecordedPort] = {}
        fronts = list(prefixes or [""] * len(readers))
        for reader, front in zip(readers, fronts, strict=True):
            _refuse_damaged(reader)
            for name, port in reader.ports.items():
                _take_port(ports, f"{front}{name}", port, join, reader)
        unique = wanted.form == "csv"
        streams = [_named(reader, front, unique) for reader, front in zip(readers, fronts, strict=True)]
        samples = heapq.merge(*streams, key=lambda one: one[1].log_time)
        attachments = [one for reader in readers for one in reader.attachments()]
        with progress("merging", sum(reader.count for reader in readers)) as step:
            made = _write(target, sources, wanted, ports, attachments, _counting(samples, step))
        return Converted(made.samples, made.form, made.left_out, (), (), tuple(_not_closed(readers)))


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


def _form(source: Path) -> Form:
    found: Any = form_of(source)
    form: Form = found
    return form


def _copy(
    source: Path,
    target: Path,
    wanted: _Wanted,
    names: Collection[str] | None,
    start: int | None,
    end: int | None,
) -> Converted:
    with open_recording(source) as reader:
        _refuse_damaged(reader)
        if names is not None and (missing := [name for name in names if name not in reader.ports]):
            there = ", ".join(list(reader.ports)[:20]) or "none"
            raise RecordingError(f"{reader.path}: no port {missing[0][:60]!r}; there are {there}")
        ports = {name: port for name, port in reader.ports.items() if names is None or name in names}
        samples = _named(reader, "", wanted.form == "csv", start=start, end=end, ports=names)
        with progress("converting", reader.count) as step:
            made = _write(target, [source], wanted, ports, reader.attachments(), _counting(samples, step))
        return Converted(made.samples, made.form, made.left_out, (), (), tuple(_not_closed([reader])))


def _refuse_damaged(reader: Recording) -> None:
    if reader.damage:
        text = f"{reader.path}: damaged: {reader.fault}; aiorts log salvage gets what is whole"
        raise DamagedError(text, reader.damage[0].offset)


def _not_closed(readers: Iterable[Recording]) -> Iterator[tuple[str, int]]:
    for reader in readers:
        if not reader.clean:
            yield str(reader.path), reader.torn.length if reader.torn is not None else 0


def _named(reader: Recording, front: str, unique: bool, **chosen: Any) -> Iterator[tuple[str, RecordedSample]]:
    """The samples with the names of their ports; `unique` tells those of one name and several types apart."""
    known = {id(port): f"{front}{name if unique else port.name}" for name, port in reader.ports.items()}
    for sample in reader.samples(**chosen):
        yield known[id(sample.port)], sample


def _counting(samples: Iterable[tuple[str, RecordedSample]], step: Step) -> Iterator[tuple[str, RecordedSample]]:
    number = 0
    for number, one in enumerate(samples, 1):
        yield one
        if not number % _STEP:
            step(_STEP)
    step(number % _STEP)


def _stepping(reader: TableReader, step: Step) -> Iterator[tuple[str, RecordedSample]]:
    before = 0
    for number, sample in enumerate(reader.samples(), 1):
        yield sample.port.name, sample
        if not number % _STEP:
            step(reader.read - before)
            before = reader.read
    step(reader.octets - before)


def _write(
    target: Path,
    sources: Sequence[Path],
    wanted: _Wanted,
    ports: Mapping[str, RecordedPort],
    attachments: Iterable[Attachment],
    samples: Iterable[tuple[str, RecordedSample]],
) -> Converted:
    """Put all of it into the target, which is there when all went well."""
    place = whole_folder(target, sources) if wanted.split else whole_file(target, sources, wanted.overwrite)
    counts = dict.fromkeys(
        (name if wanted.form == "csv" else name.removesuffix(f"#{port.id}") for name, port in ports.items()), 0
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
    return Converted(counts, wanted.form, sink.left_out)


def _sink(part: Path, wanted: _Wanted, ports: Mapping[str, RecordedPort]) -> Sink:
    if wanted.split:
        if wanted.form != "csv":
            raise ConfigurationError("--split: writes tables; --to csv")
        return FolderSink(part, ports, wanted.options)
    if wanted.form == "mcap":
        return McapSink(part, wanted.encoding)
    if wanted.form == "csv":
        return TableSink(part, ports, wanted.options)
    return TextSink(part) if wanted.form == "text" else LinesSink(part)
