"""`aiorts log import`: a recording of what another system recorded, and what could not be taken over."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

if TYPE_CHECKING:
    from aiorts_log.importing import ImportReport

__all__ = ("import_command",)

_FILE: Final = click.Path(path_type=Path)
_SHOWN: Final = 20


@click.command("import", short_help="Take over a recording of ROS 2, or an MCAP file of others.")
@click.argument("source", type=_FILE)
@click.argument("target", type=_FILE)
@click.option("--overwrite", is_flag=True, help="Replace TARGET when it is there.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def import_command(source: Path, target: Path, overwrite: bool, as_json: bool) -> None:
    """Write TARGET, a recording, from SOURCE: an MCAP file with messages of ROS 2 or in JSON, a ROS 2 bag (.db3), or a
    folder of them. Says what is left out, and why.

    ROS 2 messages need rosbags: pip install "aiorts[ros]".
    """
    from aiorts_log.importing import import_recording  # loads numpy, which no other command needs

    report = import_recording(source, target, existing="overwrite" if overwrite else "refuse")
    click.echo(json.dumps(_document(report), indent=1) if as_json else "\n".join(_lines(target, report)))


def _lines(target: Path, report: ImportReport) -> list[str]:
    total = sum(report.samples.values())
    lines = [f"{_shown(target)}: {_number(total, 'sample')} of {_number(len(report.ports), 'port')}"]
    for name, count in report.samples.items():
        lines.append(f"  {_shown(name)}: {_number(count, 'sample')} of {_shown(report.ports[name])}")
    lines += _few([f"  left out: {_shown(what)}: {_shown(why)}" for what, why in report.left.items()])
    lost = [(what, why, n) for what, reasons in report.lost.items() for why, n in reasons.items()]
    lines += _few([f"  lost of {_shown(what)}: {n} times: {_shown(why)}" for what, why, n in lost])
    return [*lines, *(f"  {_shown(note)}" for note in report.notes)]


def _few(lines: list[str]) -> list[str]:
    more = len(lines) - _SHOWN
    return [*lines[:_SHOWN], *([f"  and {more} more; --json tells all"] if more > 0 else [])]


def _document(report: ImportReport) -> dict[str, Any]:
    return {
        "samples": report.samples,
        "ports": report.ports,
        "left": report.left,
        "lost": report.lost,
        "notes": report.notes,
    }


def _shown(text: object) -> str:
    """Text of a file without anything that commands a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text)[:300])


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
