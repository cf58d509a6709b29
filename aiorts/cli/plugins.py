"""`aiorts plugins`: what packages and folders offer; with --check each is imported in a process of its own."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from aiorts import Catalogue, Extension
from aiorts.cli.report import printed, report

__all__ = ("plugins",)


@dataclass(frozen=True, slots=True)
class _Finding:
    """One extension, and what became of its import: "" when it was not tried, "ok", or what is wrong."""

    kind: str
    name: str
    target: str
    source: str
    verdict: str = ""


@click.command(short_help="List what plugins offer.")
@click.option("--check", is_flag=True, help="Import each in a process of its own, and say what happened.")
@click.option("--plugins", "folders", multiple=True, type=click.Path(path_type=Path), help="A folder with plugins.")
@click.option("--limit", type=click.FloatRange(min=0.1), default=10.0, help="Seconds that an import may take.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def plugins(check: bool, folders: tuple[Path, ...], limit: float, as_json: bool) -> int:
    """List the components, contexts, codecs, transports, commands, benches and types that can be used.

    Nothing is imported, but with --check. Exit status 1 when something is broken.
    """
    catalogue = Catalogue(folders)
    findings = [
        _Finding(kind, name, one.target, one.source, _verdict(one, len(offers), limit) if check else "")
        for kind in Catalogue.KINDS
        for name, offers in catalogue.extensions(kind).items()
        for one in offers
    ]
    broken = bool(catalogue.problems) or any(finding.verdict not in ("", "ok") for finding in findings)
    if as_json:
        problems = [asdict(problem) for problem in catalogue.problems]
        click.echo(json.dumps({"extensions": [asdict(one) for one in findings], "problems": problems}, indent=1))
    else:
        click.echo(_table(findings))
    for problem in catalogue.problems:
        report("E-PLUGIN", f"{problem.source}: {problem.reason}")
    return int(broken)


def _table(findings: Iterable[_Finding]) -> str:
    rows = [
        (one.kind.removesuffix("s"), one.name, one.target, one.source, *((one.verdict,) if one.verdict else ()))
        for one in findings
    ]
    widths = [max((len(row[column]) for row in rows), default=0) for column in range(3)]
    return "\n".join(
        "  ".join(printed(cell).ljust(widths[i] if i < len(widths) else 0) for i, cell in enumerate(row)).rstrip()
        for row in rows
    )


def _verdict(extension: Extension, offers: int, limit: float) -> str:
    asked = json.dumps(
        [extension.kind, extension.name, extension.target, extension.source, str(extension.folder or "")]
    )
    child = subprocess.Popen(  # noqa: S603 - this interpreter; what it imports is the user's own wish
        [sys.executable, "-m", "aiorts.cli.plugin_child", asked],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        said, _ = child.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        child.kill()
        child.communicate()
        return f"still being imported after {limit:g} s"
    if child.returncode < 0:
        return f"ended the interpreter by {signal.Signals(-child.returncode).name}"
    try:
        faults = list(json.loads(said))
    except ValueError:
        return f"ended the interpreter with status {child.returncode}"
    if offers > 1:
        faults.append(f"the name is offered {offers} times")
    return "; ".join(faults) or "ok"
