"""`aiorts log convert`, `cut` and `merge`: another format, a part, or several recordings as one."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import click

from aiorts import exits
from aiorts.errors import ConfigurationError, UnknownTypeError
from aiorts.types import check_port_type, find_type
from aiorts_log.analysis import convert as work
from aiorts_log.analysis.convert import FORMATS, Converted, Format
from aiorts_log.commands.output import FILE, MOST_LINES, UNLIMITED, moment, number, safe, say_unclosed, span
from aiorts_log.commands.working import WritingCommand
from aiorts_log.mcap.source import Limits
from aiorts_log.text.csv_format import LOG_TIME, TableOptions, TimeUnit
from aiorts_log.text.opening import open_recording

_DELIMITERS: Final[dict[str, str]] = {"tab": "\t", "\\t": "\t", "comma": ",", "semicolon": ";", "space": " "}
_UNITS: Final[tuple[TimeUnit, ...]] = ("s", "ms", "us", "ns")
_OVERWRITE: Final = click.option("--overwrite", is_flag=True, help="Replace the target when it is there.")


@click.command(cls=WritingCommand, short_help="Convert between MCAP, CSV, text and JSON lines.")
@click.argument("source", type=FILE)
@click.argument("target", type=FILE)
@click.option(
    "--from", "source_format", type=click.Choice(FORMATS), help="Format of SOURCE, when its name does not show it."
)
@click.option(
    "--to", "target_format", type=click.Choice(FORMATS), help="Format of TARGET, when its name does not show it."
)
@click.option(
    "--port", "ports", multiple=True, metavar="NAME", help="Only this port; read from a table: one of its ports."
)
@click.option(
    "--type", "types", multiple=True, metavar="TYPE", help="Table read: once for each --port, in the same order."
)
@click.option("--map", "columns", multiple=True, metavar="COLUMN=FIELD", help="Table read: x=data.x, 4=gyro.data[0].")
@click.option("--set", "values", multiple=True, metavar="FIELD=VALUE", help="Table read: a field without a column.")
@click.option("--time", default=LOG_TIME, show_default=True, metavar="COLUMN", help="Table: the column of log times.")
@click.option(
    "--time-unit",
    "unit",
    type=click.Choice(_UNITS),
    default="ns",
    show_default=True,
    help="Table: unit of the log times.",
)
@click.option("--time-offset", "offset", default="0", metavar="SECONDS", help="Table read: to add to its times.")
@click.option("--delimiter", default=",", show_default=True, metavar="CHAR", help="Table: between cells; tab, too.")
@click.option("--no-header", is_flag=True, help="Table: no row of names; columns are 0, 1, 2, ...")
@click.option(
    "--comment", default="#", show_default=True, metavar="TEXT", help="Table read: begins a row to leave out."
)
@click.option(
    "--empty-nan", "empty_is_nan", is_flag=True, help="Table read: an empty cell is a NaN where a float stands."
)
@click.option("--skip-bad", is_flag=True, help="Table read: leave out rows that cannot be read, and list them.")
@click.option("--by-time", is_flag=True, help="Table written: samples of one time in one row.")
@click.option("--split", is_flag=True, help="Write a folder with a table for each port.")
@click.option("--json", "as_json", is_flag=True, help="MCAP written: JSON messages, which Foxglove shows as they are.")
@_OVERWRITE
@UNLIMITED
def convert(
    source: Path,
    target: Path,
    source_format: Format | None,
    target_format: Format | None,
    ports: tuple[str, ...],
    types: tuple[str, ...],
    columns: tuple[str, ...],
    values: tuple[str, ...],
    delimiter: str,
    no_header: bool,
    as_json: bool,
    split: bool,
    overwrite: bool,
    limits: Limits,
    **table: Any,
) -> int:
    """Convert between MCAP, CSV, text and JSON lines; the ending names the format: .mcap .csv .txt .jsonl.

    \b
      aiorts log convert run.mcap run.csv
      aiorts log convert imu.csv imu.mcap --port imu0.rate --type TimedAngularVelocity3D
        --time t --time-unit s --map wx=data.avx --map wy=data.avy --map wz=data.avz

    A table has one port, or columns PORT.FIELD for several; --port and --type are given once for each of them. Exit
    status 1 when samples were left out: rows with --skip-bad, or the end of a recording that was not closed.
    """
    if types and len(types) != len(ports):
        given = f"{number(len(types), 'type')} for {number(len(ports), 'port')}"
        raise ConfigurationError(f"--type: give --port NAME --type TYPE once for each port of the table, got {given}")
    made = work.convert(
        source,
        target,
        source_format=source_format,
        target_format=target_format,
        ports=ports or None,
        table=TableOptions(
            **table,
            delimiter=_DELIMITERS.get(delimiter, delimiter),
            header=not no_header,
            ports=tuple(_typed(ports, types)),
            columns=_pairs("--map", columns),
            values=_pairs("--set", values),
        ),
        encoding="json" if as_json else None,
        split=split,
        overwrite=overwrite,
        limits=limits,
    )
    return _report(target, made)


@click.command(cls=WritingCommand, short_help="Write a part of a recording.")
@click.argument("source", type=FILE)
@click.argument("target", type=FILE)
@click.option("--start", metavar="TIME", help="Begin there: +SECONDS after the first sample, or seconds since 1970.")
@click.option("--end", metavar="TIME", help="End before that time, given as for --start.")
@click.option("--port", "ports", multiple=True, metavar="NAME", help="Only this port; may be given more than once.")
@_OVERWRITE
@UNLIMITED
def cut(
    source: Path,
    target: Path,
    start: str | None,
    end: str | None,
    ports: tuple[str, ...],
    overwrite: bool,
    limits: Limits,
) -> int:
    """Write a part of a recording: some of its time, some of its ports. Samples go over as they are."""
    with open_recording(source, limits=limits) as reader:
        first, last = moment("--start", start, reader.start), moment("--end", end, reader.start)
        lasts = span(reader)
    if first is not None and last is not None and first >= last:
        raise ConfigurationError(f"--end: expected a time behind --start, got {end}")
    wanted: dict[str, Any] = {"start": first, "end": last, "ports": ports or None}
    made = work.cut(source, target, **wanted, overwrite=overwrite, limits=limits)
    if not any(made.samples.values()):
        click.echo(f"  no sample is there; {lasts}", err=True)
    return _report(target, made)


@click.command(cls=WritingCommand, short_help="Write several recordings as one.")
@click.argument("files", type=FILE, nargs=-1, required=True, metavar="FILE... TARGET")
@click.option("--prefix", "prefixes", multiple=True, metavar="TEXT", help="In front of port names, one for each FILE.")
@click.option("--join", is_flag=True, help="Ports of the same name and type become one.")
@_OVERWRITE
@UNLIMITED
def merge(files: tuple[Path, ...], prefixes: tuple[str, ...], join: bool, overwrite: bool, limits: Limits) -> int:
    """Write several recordings as one, in the order of their log times.

    A port that several of them have is refused, unless --prefix names them apart or --join makes them one.
    """
    if len(files) < 3:
        raise click.UsageError("expected at least two recordings and the TARGET")
    *sources, target = files
    how: dict[str, Any] = {"prefixes": prefixes or None, "join": join, "overwrite": overwrite, "limits": limits}
    return _report(target, work.merge(sources, target, **how))


def _typed(ports: tuple[str, ...], types: tuple[str, ...]) -> Iterable[tuple[str, type]]:
    for name, type_name in zip(ports, types, strict=False):
        try:
            cls = find_type(type_name)
        except UnknownTypeError as error:
            raise click.UsageError(f"--type: {error}") from error
        check_port_type(cls)
        yield name, cls


def _pairs(option: str, texts: tuple[str, ...]) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name or (option == "--map" and not value):
            what = "COLUMN=FIELD" if option == "--map" else "FIELD=VALUE"
            raise ConfigurationError(f"{option}: expected {what}, got {text[:40]!r}").at(text, 0)
        if name in found:
            raise ConfigurationError(f"{option}: {name[:40]} is given twice").at(text, 0)
        found[name] = value
    return found


def _report(target: Path, made: Converted) -> int:
    """Print what was written, and on standard error what was not; returns 1 when samples were left out."""
    count = sum(made.samples.values())
    click.echo(f"{safe(target)}: {number(count, 'sample')} of {number(len(made.samples), 'port')}")
    for text in made.left_out:
        click.echo(f"  not in it: {safe(text)}", err=True)
    if made.unused:
        click.echo(f"  columns not used: {safe(', '.join(made.unused))}", err=True)
    for line, why in made.bad[:MOST_LINES]:
        click.echo(f"  left out: line {line}: {safe(why)}", err=True)
    if len(made.bad) > MOST_LINES:
        click.echo(f"  left out: {len(made.bad) - MOST_LINES} more rows, up to line {made.bad[-1][0]}", err=True)
    torn = say_unclosed(made.not_closed)
    return exits.FAILED if made.bad or torn else exits.DONE
