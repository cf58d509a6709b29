"""`aiorts log import`: makes a recording of another system's recording, and reports what could not be imported."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import click

from aiorts import exits
from aiorts_log.commands.output import FILE, UNLIMITED, number, safe, say_unclosed
from aiorts_log.mcap.source import Limits

if TYPE_CHECKING:
    from aiorts_log.foreign.importing import ImportReport, MessageCounts

_MOST_LINES: Final = 20


@click.command("import", short_help="Take over a recording of ROS 2, or an MCAP file of others.")
@click.argument("source", type=FILE)
@click.argument("target", type=FILE)
@click.option("--parts", is_flag=True, help="A port for each field, also of messages with a record of their own.")
@click.option("--overwrite", is_flag=True, help="Replace TARGET when it is there.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
@UNLIMITED
def import_command(source: Path, target: Path, parts: bool, overwrite: bool, as_json: bool, limits: Limits) -> int:
    """Write TARGET, a recording, from SOURCE: an MCAP file with messages of ROS 2 or in JSON, a ROS 2 bag (.db3), or a
    folder of them. Prints what is left out, and why.

    A ROS 2 message of a type that `aiorts types --group ros` lists becomes that record; of any other, and of all with
    --parts, each field becomes a port of its own. They need rosbags: pip install "aiorts[ros]".

    Exit status 1 when messages, or values of them, are lost; what is left out for its kind is no loss.
    """
    from aiorts_log.foreign.importing import import_recording  # loads numpy, which no other command needs

    existing: Literal["refuse", "overwrite"] = "overwrite" if overwrite else "refuse"
    report = import_recording(source, target, whole=not parts, existing=existing, limits=limits)
    click.echo(json.dumps(asdict(report), indent=1) if as_json else "\n".join(_lines(target, report)))
    say_unclosed(report.not_closed)
    return exits.DONE if report.whole else exits.FAILED


def _lines(target: Path, report: ImportReport) -> list[str]:
    total = sum(report.samples.values())
    lines = [f"{safe(target)}: {number(total, 'sample')} of {number(len(report.ports), 'port')}"]
    for name, count in report.samples.items():
        lines.append(f"  {safe(name)}: {number(count, 'sample')} of {safe(report.ports[name])}")
    lines += _few([f"  read of {safe(topic)}: {_counts(found)}" for topic, found in report.messages.items()])
    lines += _few([f"  left out: {safe(what)}: {safe(why)}" for what, why in report.left.items()])
    lost = [(what, why, n) for what, reasons in report.lost.items() for why, n in reasons.items()]
    return lines + _few([f"  lost of {safe(what)}: {n} times: {safe(why)}" for what, why, n in lost])


def _counts(found: MessageCounts) -> str:
    fates = {"taken": found.taken, "left out": found.left_out, "lost": found.lost}
    return f"{number(found.read, 'message')}: {', '.join(f'{n} {fate}' for fate, n in fates.items() if n)}".rstrip(": ")


def _few(lines: list[str]) -> list[str]:
    more = len(lines) - _MOST_LINES
    return [*lines[:_MOST_LINES], *([f"  and {more} more; --json has all"] if more > 0 else [])]
