"""`aiorts log`: look at a recording, print it as JSON lines, get what is whole out of a damaged one."""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import click

from aiorts.errors import ConfigurationError, RecordError, WireError
from aiorts.wire import json_text, line_of
from aiorts_log.import_command import import_command
from aiorts_log.info import RecordingInfo, info_of
from aiorts_log.reader import RecordedSample, RecordingReader
from aiorts_log.salvage import SalvageReport
from aiorts_log.salvage import salvage as salvage_file
from aiorts_log.survey import Gap

__all__ = ("log",)

_FILE: Final = click.Path(path_type=Path)
_SHOWN: Final = 10
_BLOCK: Final = 512
_BROKEN_PIPE: Final = 141
_SECONDS: Final = re.compile(r"\+?\d{1,12}(\.\d{1,9})?", re.ASCII)


@click.group(short_help="Look at recordings, print and salvage them.")
def log() -> None:
    """Look at recordings (.mcap), print them as JSON lines, salvage damaged ones."""


@log.command()
@click.argument("file", type=_FILE)
@click.option("--check", is_flag=True, help="Read everything and hold it against its checksums.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def info(file: Path, check: bool, as_json: bool) -> int:
    """Show what a recording holds: ports, types, counts, rates, gaps, and whether it was closed.

    Exit status 1 with --check when something is damaged.
    """
    with RecordingReader(file) as reader:
        found = info_of(reader)
        gaps = reader.check() if check else ()
    if as_json:
        click.echo(json.dumps(_document(found, gaps if check else None), indent=1, allow_nan=False))
    else:
        click.echo("\n".join(_lines(found, gaps if check else None)))
    return 1 if gaps else 0


@log.command()
@click.argument("file", type=_FILE)
@click.option("--port", "ports", multiple=True, metavar="NAME", help="Only this port; may be given more than once.")
@click.option("--start", metavar="TIME", help="From there: +SECONDS after the first sample, or seconds since 1970.")
@click.option("--end", metavar="TIME", help="Up to there, without it; as --start.")
@click.option("--log-time", is_flag=True, help='Add "log_time", when it was recorded, in ns.')
def cat(file: Path, ports: tuple[str, ...], start: str | None, end: str | None, log_time: bool) -> int:
    """Print samples as JSON lines, in the order of their log time.

    The lines are those that filters read: aiorts log cat run.mcap | aiorts flexidump -p TimedDouble
    """
    with RecordingReader(file) as reader:
        first, last = _moment("--start", start, reader.start), _moment("--end", end, reader.start)
        samples = reader.samples(start=first, end=last, ports=ports or None)
        try:
            _write(_text_of(sample, log_time) for sample in samples)
        except BrokenPipeError:  # whoever read has gone: no error, and nothing to say on the way out
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stdout.fileno())
            os.close(nowhere)
            return _BROKEN_PIPE
        finally:
            samples.close()  # type: ignore[attr-defined]
    return 0


@log.command()
@click.argument("source", type=_FILE)
@click.argument("target", type=_FILE)
@click.option("--overwrite", is_flag=True, help="Replace TARGET when it is there.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def salvage(source: Path, target: Path, overwrite: bool, as_json: bool) -> None:
    """Write everything that is whole of SOURCE into TARGET, and say what is lost."""
    report = salvage_file(source, target, existing="overwrite" if overwrite else "refuse")
    if as_json:
        click.echo(json.dumps(_salvaged(report), indent=1))
        return
    total, lost = sum(report.samples.values()), sum(gap.length for gap in report.lost)
    click.echo(f"{_shown(target)}: {_number(total, 'sample')} of {_number(len(report.samples), 'port')}")
    for name, count in report.missing.items():
        click.echo(f"  lost of {_shown(name)}: {_number(count, 'sample')}")
    if report.lost:
        click.echo(f"  lost: {lost} octets in {_number(len(report.lost), 'place')}")
        for line in _gap_lines(report.lost):
            click.echo(f"    {line}")
    if not report.closed:
        click.echo("  the recording was not closed: what was not yet written when it ended is not in it")
    if not report.lost and report.closed:
        click.echo("  nothing is lost")


log.add_command(import_command)


def _write(lines: Iterator[str]) -> None:
    """Lines in blocks: one call for each would cost more than to read it."""
    stream = sys.stdout
    block: list[str] = []
    try:
        for line in lines:
            block.append(line)
            if len(block) == _BLOCK:
                text = "".join(block)
                block.clear()
                stream.write(text)
    finally:
        stream.write("".join(block))
        stream.flush()


def _text_of(sample: RecordedSample, log_time: bool) -> str:
    port = sample.port
    text = ""
    if not port.unknown:
        try:
            text = line_of(port.name, port.decode(sample.data))
        except (WireError, RecordError):
            text = ""  # told as the octets it is
    if not text:
        try:
            plain = _strict(port.plain(sample.data))
        except RecursionError:
            plain = None  # nested without end, by somebody who means no good
        text = json_text({"port": port.name, "type": port.type_name, "data": plain})
    return f'{text[:-1]}, "log_time": {sample.log_time}}}\n' if log_time else f"{text}\n"


def _strict(plain: Any) -> Any:
    """JSON made by others may hold numbers that are not finite, which are no JSON."""
    if isinstance(plain, float) and not math.isfinite(plain):
        return str(plain)
    if isinstance(plain, dict):
        return {str(key): _strict(value) for key, value in plain.items()}
    return [_strict(value) for value in plain] if isinstance(plain, list) else plain


def _moment(option: str, text: str | None, start: int) -> int | None:
    """A time of the command line in ns."""
    if text is None:
        return None
    if not _SECONDS.fullmatch(text):
        raise ConfigurationError(f"{option}: expected +SECONDS or seconds since 1970, got {text[:40]!r}").at(text, 0)
    whole, _, rest = text.removeprefix("+").partition(".")
    ns = int(whole) * 10**9 + int(rest.ljust(9, "0") or "0")
    return start + ns if text.startswith("+") else ns


def _lines(found: RecordingInfo, gaps: tuple[Gap, ...] | None) -> list[str]:
    lines = [
        f"{_shown(found.path)}: {_number(found.count, 'sample')} of {_number(len(found.ports), 'port')}, "
        f"{_size(found.octets)}, by {_shown(found.made_by) or 'somebody'}"
    ]
    if found.count:
        lines.append(f"  from {_date(found.start)} for {found.duration:.3f} s, in {_number(found.chunks, 'chunk')}")
    rows = [
        (_shown(p.name), _shown(p.type), str(p.count), "" if p.rate is None else f"{p.rate:.4g} Hz", _shown(p.unknown))
        for p in found.ports
    ]
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(4)]
    for name, kind, count, rate, unknown in rows:
        line = f"  {name:<{widths[0]}}  {kind:<{widths[1]}}  {count:>{widths[2]}}  {rate:>{widths[3]}}  {unknown}"
        lines.append(line.rstrip())
    for begin, end in found.gaps[:_SHOWN]:
        lines.append(f"  no sample for {(end - begin) / 1e9:.3f} s from +{(begin - found.start) / 1e9:.3f} s")
    if len(found.gaps) > _SHOWN:
        lines.append(f"  and {len(found.gaps) - _SHOWN} more such times")
    for name, drops in found.dropped.items():
        lines.append(f"  dropped of {_shown(name)}: {_number(drops, 'sample')} that found no room")
    if found.skipped:
        lines.append(f"  {_number(found.skipped, 'record')} of kinds that this version does not know")
    if not found.closed:
        torn = "" if found.torn is None else f"; {found.torn.length} octets at its end are of no use"
        lines.append(f"  not closed cleanly: {found.count} samples, lost: what was not yet written{torn}")
    if found.fault:
        lines.append(f"  damaged: {_shown(found.fault)}; aiorts log salvage gets what is whole")
    if gaps is not None:
        lines += [f"  damaged: {line}" for line in _gap_lines(gaps)] or ["  all checksums are right"]
    return lines


def _gap_lines(gaps: tuple[Gap, ...]) -> list[str]:
    lines = [f"{gap.length} octets from octet {gap.offset}: {_shown(gap.why)}" for gap in gaps[:_SHOWN]]
    return [*lines, *([f"and {len(gaps) - _SHOWN} more places"] if len(gaps) > _SHOWN else [])]


def _document(found: RecordingInfo, gaps: tuple[Gap, ...] | None) -> dict[str, Any]:
    document: dict[str, Any] = {
        "file": found.path,
        "octets": found.octets,
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
        "torn": None if found.torn is None else found.torn._asdict(),
        "fault": found.fault,
        "skipped": found.skipped,
        "metadata": _strict(list(found.metadata)),
    }
    return document if gaps is None else {**document, "damage": [gap._asdict() for gap in gaps]}


def _salvaged(report: SalvageReport) -> dict[str, Any]:
    return {
        "samples": report.samples,
        "missing": report.missing,
        "lost": [gap._asdict() for gap in report.lost],
        "closed": report.closed,
        "attachments": list(report.attachments),
    }


def _shown(text: object) -> str:
    """Text of a file without anything that commands a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text)[:300])


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _size(octets: int) -> str:
    return f"{octets} octets" if octets < 10_000 else f"{octets / 1e6:.2f} MB"


def _date(ns: int) -> str:
    try:
        moment = datetime.fromtimestamp(ns // 10**9, UTC)
    except (OverflowError, ValueError, OSError):
        return f"{ns} ns"
    return f"{moment:%Y-%m-%d %H:%M:%S}.{ns % 10**9 // 10**6:03d} UTC"
