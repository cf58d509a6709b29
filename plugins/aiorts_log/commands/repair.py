"""`aiorts log salvage`: copies what is whole of a damaged recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, cast

import click

from aiorts.progress import progress
from aiorts_log.commands.output import FILE, UNLIMITED, gap_lines, number, safe
from aiorts_log.commands.working import WritingCommand
from aiorts_log.mcap.salvage import SalvageReport
from aiorts_log.mcap.salvage import salvage as salvage_file
from aiorts_log.mcap.source import Limits
from aiorts_log.text.flat import FlatReader
from aiorts_log.text.opening import format_of, open_recording
from aiorts_log.text.salvage_lines import salvage_lines


@click.command(cls=WritingCommand, short_help="Write what is whole of a damaged recording.")
@click.argument("source", type=FILE)
@click.argument("target", type=FILE)
@click.option("--overwrite", is_flag=True, help="Replace TARGET when it is there.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
@UNLIMITED
def salvage(source: Path, target: Path, overwrite: bool, as_json: bool, limits: Limits) -> None:
    """Write everything that is whole of SOURCE into TARGET, and report what is lost."""
    if format_of(source) == "mcap":
        existing: Literal["overwrite", "refuse"] = "overwrite" if overwrite else "refuse"
        with progress("salvaging", source.stat().st_size) as step:
            report = salvage_file(source, target, existing=existing, limits=limits, step=step)
    else:
        with open_recording(source) as reader, progress("salvaging", reader.size) as step:
            report = salvage_lines(cast("FlatReader", reader), target, overwrite, step)
    if as_json:
        click.echo(json.dumps(_salvaged(report), indent=1))
        return
    total, lost = sum(report.samples.values()), sum(gap.length for gap in report.lost)
    click.echo(f"{safe(target)}: {number(total, 'sample')} of {number(len(report.samples), 'port')}")
    for name, count in report.missing.items():
        click.echo(f"  lost of {safe(name)}: {number(count, 'sample')}")
    if report.lost:
        click.echo(f"  lost: {lost} bytes in {number(len(report.lost), 'place')}")
        for line in gap_lines(report.lost):
            click.echo(f"    {line}")
    if not report.closed:
        click.echo("  the recording was not closed: what was not yet written when it ended is not in it")
    if not report.lost and report.closed:
        click.echo("  nothing is lost")


def _salvaged(report: SalvageReport) -> dict[str, Any]:
    return {
        "samples": report.samples,
        "missing": report.missing,
        "lost": [gap._asdict() for gap in report.lost],
        "closed": report.closed,
        "attachments": list(report.attachments),
    }
