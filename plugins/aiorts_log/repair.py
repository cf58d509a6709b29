"""`aiorts log salvage`: what is whole of a damaged recording, as a recording of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

import click

from aiorts_log.flat import FlatReader
from aiorts_log.opening import form_of, open_recording
from aiorts_log.salvage import SalvageReport
from aiorts_log.salvage import salvage as salvage_file
from aiorts_log.salvage_lines import salvage_lines
from aiorts_log.shown import FILE, gap_lines, number, shown
from aiorts_log.working import WritingCommand

__all__ = ("salvage",)


@click.command(cls=WritingCommand, short_help="Write what is whole of a damaged recording.")
@click.argument("source", type=FILE)
@click.argument("target", type=FILE)
@click.option("--overwrite", is_flag=True, help="Replace TARGET when it is there.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def salvage(source: Path, target: Path, overwrite: bool, as_json: bool) -> None:
    """Write everything that is whole of SOURCE into TARGET, and say what is lost."""
    if form_of(source) == "mcap":
        report = salvage_file(source, target, existing="overwrite" if overwrite else "refuse")
    else:
        with open_recording(source) as reader:
            report = salvage_lines(cast("FlatReader", reader), target, overwrite)
    if as_json:
        click.echo(json.dumps(_salvaged(report), indent=1))
        return
    total, lost = sum(report.samples.values()), sum(gap.length for gap in report.lost)
    click.echo(f"{shown(target)}: {number(total, 'sample')} of {number(len(report.samples), 'port')}")
    for name, count in report.missing.items():
        click.echo(f"  lost of {shown(name)}: {number(count, 'sample')}")
    if report.lost:
        click.echo(f"  lost: {lost} octets in {number(len(report.lost), 'place')}")
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
