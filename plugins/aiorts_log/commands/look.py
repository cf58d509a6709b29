"""`aiorts log info` and `cat`: the figures of a recording, and its samples as JSON lines."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import click

from aiorts import exits
from aiorts.errors import RecordError, WireError
from aiorts.system import standard_output
from aiorts.wire import json_text, line_of
from aiorts_log.analysis.info import RecordingInfo, info_of
from aiorts_log.commands.output import (
    FILE,
    MOST_LINES,
    UNLIMITED,
    date,
    gap_lines,
    moment,
    number,
    safe,
    say_unclosed,
    size,
    span,
    strict,
)
from aiorts_log.mcap.reader import RecordedSample, RecordingReader, not_closed
from aiorts_log.mcap.source import Limits
from aiorts_log.mcap.survey import Gap
from aiorts_log.text.opening import open_recording

_BLOCK: Final = 512


@click.command(short_help="Show what a recording holds.")
@click.argument("file", type=FILE)
@click.option("--check", is_flag=True, help="Read everything and hold it against its checksums.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
@UNLIMITED
def info(file: Path, check: bool, as_json: bool, limits: Limits) -> int:
    """Show what a recording holds: ports, types, counts, rates, gaps, and whether it was closed.

    Exit status 1 with --check when something is damaged.
    """
    with open_recording(file, limits=limits) as reader:
        found = info_of(reader)
        gaps = reader.check() if check else ()
        whole = "all checksums are right" if isinstance(reader, RecordingReader) else "all of it can be read"
    if as_json:
        click.echo(json.dumps(_document(found, gaps if check else None), indent=1, allow_nan=False))
    else:
        lines = _lines(found, gaps if check else None)
        click.echo("\n".join([*lines, *([f"  {whole}"] if check and not gaps else [])]))
    return exits.FAILED if gaps else exits.DONE


@click.command(short_help="Print samples as JSON lines.")
@click.argument("file", type=FILE)
@click.option("--port", "ports", multiple=True, metavar="NAME", help="Only this port; may be given more than once.")
@click.option("--start", metavar="TIME", help="Begin there: +SECONDS after the first sample, or seconds since 1970.")
@click.option("--end", metavar="TIME", help="End before that time, given as for --start.")
@click.option("--log-time", is_flag=True, help='Add "log_time", when it was recorded, in ns.')
@UNLIMITED
def cat(file: Path, ports: tuple[str, ...], start: str | None, end: str | None, log_time: bool, limits: Limits) -> int:
    """Print samples as JSON lines, in the order of their log time.

    The lines are those that filters read: aiorts log cat run.mcap | aiorts flexidump -p TimedDouble

    Exit status 1 when the end of the recording cannot be read.
    """
    with open_recording(file, limits=limits) as reader:
        first, last = moment("--start", start, reader.start), moment("--end", end, reader.start)
        samples = reader.samples(start=first, end=last, ports=ports or None)
        try:
            if not _write(_text_of(sample, log_time) for sample in samples) and (start or end or ports):
                click.echo(f"  no sample is there; {span(reader)}", err=True)
        finally:
            samples.close()  # type: ignore[attr-defined]
        return exits.FAILED if say_unclosed(not_closed([reader])) else exits.DONE


def _write(lines: Iterator[str]) -> int:
    """Print lines in blocks, and return their number: one call for each line would cost more than reading it."""
    stream = standard_output()
    block: list[str] = []
    printed = 0
    try:
        for line in lines:
            block.append(line)
            if len(block) == _BLOCK:
                text = "".join(block)
                printed += _BLOCK
                block.clear()
                stream.write(text)
    finally:
        stream.write("".join(block))
        stream.flush()
    return printed + len(block)


def _text_of(sample: RecordedSample, log_time: bool) -> str:
    port = sample.port
    text = ""
    if not port.unknown:
        try:
            text = line_of(port.name, port.decode(sample.data))
        except (WireError, RecordError):
            text = ""  # printed as plain data, or its bytes
    if not text:
        try:
            plain = strict(port.plain(sample.data))
        except RecursionError:
            plain = None  # nested without end, on purpose
        text = json_text({"port": port.name, "type": port.type_name, "data": plain})
    return f'{text[:-1]}, "log_time": {sample.log_time}}}\n' if log_time else f"{text}\n"


def _lines(found: RecordingInfo, gaps: tuple[Gap, ...] | None) -> list[str]:
    lines = [
        f"{safe(found.path)}: {number(found.count, 'sample')} of {number(len(found.ports), 'port')}, "
        f"{size(found.size)}, by {safe(found.made_by) or 'an unknown program'}"
    ]
    if found.count:
        lines.append(f"  from {date(found.start)} for {found.duration:.3f} s, in {number(found.chunks, 'chunk')}")
    rows = [
        (
            safe(p.name),
            safe(p.type),
            str(p.count),
            "" if p.rate is None else f"{p.rate:.4g} Hz",
            safe(p.unknown),
        )
        for p in found.ports
    ]
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(4)]
    for name, kind, count, rate, unknown in rows:
        line = f"  {name:<{widths[0]}}  {kind:<{widths[1]}}  {count:>{widths[2]}}  {rate:>{widths[3]}}  {unknown}"
        lines.append(line.rstrip())
    for begin, end in found.gaps[:MOST_LINES]:
        lines.append(f"  no sample for {(end - begin) / 1e9:.3f} s from +{(begin - found.start) / 1e9:.3f} s")
    if len(found.gaps) > MOST_LINES:
        lines.append(f"  and {len(found.gaps) - MOST_LINES} more such times")
    for name, drops in found.dropped.items():
        lines.append(f"  dropped of {safe(name)}: {number(drops, 'sample')} that found no room")
    for name, reasons in found.refused.items():
        lines += [
            f"  refused of {safe(name)}: {number(n, 'sample')}{f': {safe(why)}' if why else ''}"
            for why, n in reasons.items()
        ]
    if found.skipped:
        lines.append(f"  {number(found.skipped, 'record')} of kinds that this version does not know")
    if not found.closed:
        torn = "" if found.torn is None else f"; {found.torn.length} bytes at its end are unusable"
        lines.append(f"  not closed cleanly: {found.count} samples, lost: what was not yet written{torn}")
    if found.fault:
        lines.append(f"  damaged: {safe(found.fault)}; aiorts log salvage copies what is whole")
    if gaps is not None:
        lines += [f"  damaged: {line}" for line in gap_lines(gaps)]
    return lines


def _document(found: RecordingInfo, gaps: tuple[Gap, ...] | None) -> dict[str, Any]:
    document: dict[str, Any] = {
        "file": found.path,
        "bytes": found.size,
        "made_by": found.made_by,
        "closed": found.closed,
        "samples": found.count,
        "start": found.start,
        "end": found.end,
        "seconds": found.duration,
        "chunks": found.chunks,
        "ports": [
            {
                "name": port.name,
                "type": port.type,
                "encoding": port.encoding,
                "samples": port.count,
                "rate": port.rate,
                "unknown": port.unknown,
            }
            for port in found.ports
        ],
        "gaps": [list(gap) for gap in found.gaps],
        "dropped": found.dropped,
        "refused": found.refused,
        "torn": None if found.torn is None else found.torn._asdict(),
        "fault": found.fault,
        "skipped": found.skipped,
        "metadata": strict(list(found.metadata)),
    }
    return document if gaps is None else {**document, "damage": [gap._asdict() for gap in gaps]}
