"""`aiorts log plot`: a picture of chosen fields of a recording."""

from __future__ import annotations

from pathlib import Path

import click

from aiorts import exits
from aiorts.errors import ConfigurationError
from aiorts.progress import progress
from aiorts_log.analysis.plot import Picture, check_picture, draw_path, draw_times
from aiorts_log.analysis.series import Series, numeric_fields, read_series
from aiorts_log.commands.output import FILE, UNLIMITED, Finite, moment, number, safe, say_unclosed
from aiorts_log.commands.working import WritingCommand
from aiorts_log.errors import RecordingError
from aiorts_log.mcap.reader import not_closed
from aiorts_log.mcap.source import Limits
from aiorts_log.text.opening import open_recording
from aiorts_log.whole import whole_file


@click.command(cls=WritingCommand, short_help="Draw fields of a recording: PNG or SVG.")
@click.argument("file", type=FILE)
@click.argument("fields", nargs=-1, metavar="[PORT.FIELD]...")
@click.option("-o", "--output", type=FILE, required=True, metavar="FILE", help="The picture: FILE.png or FILE.svg.")
@click.option("--xy", nargs=2, metavar="X Y", help="Draw Y over X as a path, in equal axes.")
@click.option("--start", metavar="TIME", help="Begin there: +SECONDS after the first sample, or seconds since 1970.")
@click.option("--end", metavar="TIME", help="End before that time, given as for --start.")
@click.option("--title", default="", metavar="TEXT", help="Title of the picture; by default the name of the recording.")
@click.option("--size", type=Finite(1.0, 60.0), default=8.0, show_default=True, help="Width in inches.")
@click.option("--overwrite", is_flag=True, help="Replace the picture when it is there.")
@UNLIMITED
def plot(
    file: Path,
    fields: tuple[str, ...],
    output: Path,
    xy: tuple[str, str] | None,
    start: str | None,
    end: str | None,
    title: str,
    size: float,
    overwrite: bool,
    limits: Limits,
) -> int:
    """Draw fields of a recording over time, or one over the other as a path.

    \b
      aiorts log plot run.mcap -o all.png
      aiorts log plot run.mcap pid0.command motor0.speed.data -o run.png
      aiorts log plot run.mcap --xy odometry.pose.data.position.x odometry.pose.data.position.y -o path.svg

    Without fields all numbers of all ports are drawn, but for stamps and sequences of more than 16 items. A port
    without a field is its data; each item of a sequence is a curve, the first 16 unless others are
    named (scan.ranges[20]). An enumeration is its number. Long recordings are thinned so that no
    peak is lost. Needs matplotlib: pip install "aiorts[plot]".

    Exit status 1 when the end of the recording cannot be read.
    """
    file_type = check_picture(output)
    names = [*(xy or ()), *fields]
    if xy and fields:
        raise ConfigurationError("expected fields or --xy X Y, and not both")
    picture = Picture(title=safe(title or file.name), width=size)
    with open_recording(file, limits=limits) as reader:
        first, last = moment("--start", start, reader.start), moment("--end", end, reader.start)
        names = names or numeric_fields(reader, first, last)
        if not names:
            raise RecordingError(f"{file}: has no numbers there; nothing is drawn")
        with progress("reading", reader.count) as step:
            groups = read_series(reader, names, first, last, step)
        unclosed = tuple(not_closed([reader]))
    for name, group in zip(names, groups, strict=True):
        if not group:
            raise RecordingError(f"{file}: {name} has no sample there; nothing is drawn")
    with whole_file(output, [file], overwrite) as part:
        if xy:
            x, y = (_single(group) for group in groups)
            draw_path(part, file_type, x, y, picture)
        else:
            draw_times(part, file_type, groups, picture)
    for one in (one for group in groups for one in group if one.left_out):
        click.echo(f"  not in it: {safe(one.left_out)}", err=True)
    total = sum(len(one.times) for group in groups for one in group)
    click.echo(f"{safe(output)}: {number(total, 'value')} of {number(sum(map(len, groups)), 'curve')}")
    return exits.FAILED if say_unclosed(unclosed) else exits.DONE


def _single(group: list[Series]) -> Series:
    if len(group) > 1:
        raise ConfigurationError(f"--xy: {group[0].label} is one of {len(group)}; name one item")
    return group[0]
