"""`aiorts plugins`: what packages and folders offer; with --check each is imported in a process of its own."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import click

from aiorts import Catalogue, Extension
from aiorts.cli.offered import clashes
from aiorts.cli.plugins_option import catalogue_of
from aiorts.cli.report import printed, report

__all__ = ("plugins",)

_WORDS: Final = {"benches": "bench"}


@dataclass(frozen=True, slots=True)
class _Finding:
    """One extension, and what became of its import: "" when it was not tried, "ok", or what is wrong."""

    kind: str
    name: str
    target: str
    source: str
    verdict: str = ""
    file: str = ""
    """The file of the module, when it was tried."""


@click.command(short_help="List what plugins offer.")
@click.option("--check", is_flag=True, help="Import each in a process of its own, and say what happened.")
@click.option("--plugins", "folders", multiple=True, type=click.Path(path_type=Path), help="A folder with plugins.")
@click.option("--limit", type=click.FloatRange(min=0.1), default=10.0, help="Seconds that an import may take.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def plugins(check: bool, folders: tuple[Path, ...], limit: float, as_json: bool) -> int:
    """List the components, contexts, codecs, transports, commands, benches and types that can be used.

    Nothing is imported, but with --check. Exit status 1 when something is broken, or a name is offered twice.
    """
    catalogue = catalogue_of(folders)
    offers = [
        (one, several) for kind in Catalogue.KINDS for several in catalogue.extensions(kind).values() for one in several
    ]
    told = [("", "")] * len(offers)
    if check:
        from aiorts.cli.plugin_check import verdicts

        told = [
            (_with_rivals(verdict, *offer), file)
            for (verdict, file), offer in zip(verdicts([one for one, _ in offers], limit), offers, strict=True)
        ]
    findings = [
        _Finding(one.kind, one.name, one.target, one.source, verdict, file)
        for (one, _), (verdict, file) in zip(offers, told, strict=True)
    ]
    problems = list(_problems(catalogue))
    broken = bool(problems) or any(finding.verdict not in ("", "ok") for finding in findings)
    if as_json:
        told_problems = [{"source": source, "reason": reason} for source, reason in problems]
        click.echo(json.dumps({"extensions": [asdict(one) for one in findings], "problems": told_problems}, indent=1))
    else:
        click.echo(_table(findings))
    for source, reason in problems:
        report("E-PLUGIN", f"{source}: {reason}")
    return int(broken)


def _with_rivals(verdict: str, extension: Extension, several: tuple[Extension, ...]) -> str:
    """The verdict, and who else offers the name, which makes it nobody's."""
    if len(several) == 1:
        return verdict
    others = " and ".join(f"{one.target} ({one.source})" for one in several if one is not extension)
    rivals = f"the name is offered {len(several)} times, also by {others}"
    return rivals if verdict == "ok" else f"{verdict}; {rivals}"


def _problems(catalogue: Catalogue) -> Iterator[tuple[str, str]]:
    """Source and fault of what could not be read, and of each name that cannot be used."""
    yield from ((problem.source, problem.reason) for problem in catalogue.problems)
    from aiorts.cli.app import own_commands  # late: it is what has imported us

    yield from clashes(catalogue, own_commands())
    own = importlib.import_module("aiorts.bench.registry").OWN if catalogue.extensions("benches") else ()
    for name, several in catalogue.extensions("benches").items():
        if name in own:
            yield several[0].source, f"bench {name!r}: aiorts has a bench of that name, which comes first; rename yours"


def _told(one: _Finding) -> tuple[str, ...]:
    if one.verdict in ("", "ok"):
        return (one.verdict,) if one.verdict else ()
    return (f"{one.verdict} [{one.file}]" if one.file and one.file not in one.verdict else one.verdict,)


def _table(findings: Iterable[_Finding]) -> str:
    rows = [
        tuple(
            map(
                printed,
                (_WORDS.get(one.kind, one.kind[:-1]), one.name, one.target, one.source, *_told(one)),
            )
        )
        for one in findings
    ]
    widths = [max((len(row[column]) for row in rows), default=0) for column in range(3)]
    return "\n".join(
        "  ".join(cell.ljust(widths[i] if i < len(widths) else 0) for i, cell in enumerate(row)).rstrip()
        for row in rows
    )
