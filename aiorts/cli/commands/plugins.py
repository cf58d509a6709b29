"""`aiorts plugins`: lists what packages and folders offer; with --check it imports each in a process of its own."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Final

import click

from aiorts import Catalogue, Extension, exits
from aiorts.cli.commands.offered import clashes
from aiorts.cli.console.plugins_option import catalogue_of
from aiorts.cli.console.report import printed, report
from aiorts.late import dataclass

_WORDS: Final = {"benches": "bench"}
_PLACE: Final = re.compile(r"\(\S+:\d+\)")
"""The place of a fault in the result of an import: another extension with the same result has the same fault."""


@dataclass(frozen=True, slots=True)
class _Finding:
    """One extension and the result of its import: "" when it was not tried, "ok", or its fault."""

    kind: str
    name: str
    target: str
    source: str
    verdict: str = ""
    file: str = ""
    """The file of the module, when it was tried."""


@click.command(short_help="List what plugins offer.")
@click.option("--check", is_flag=True, help="Import each in a process of its own, and show the result.")
@click.option("--limit", type=click.FloatRange(min=0.1), default=10.0, help="Seconds that an import may take.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def plugins(check: bool, limit: float, as_json: bool) -> int:
    """List the components, contexts, services, codecs, converters, describers and other things to be used.

    Nothing is imported, but with --check. Exit status 1 when something is broken, or a name is offered twice.
    """
    catalogue = catalogue_of()
    offers = [
        (one, several) for kind in Catalogue.KINDS for several in catalogue.extensions(kind).values() for one in several
    ]
    results = [("", "")] * len(offers)
    if check:
        from aiorts.cli.commands.plugin_check import verdicts

        results = [
            (_with_rivals(verdict, *offer), file)
            for (verdict, file), offer in zip(verdicts([one for one, _ in offers], limit), offers, strict=True)
        ]
    findings = [
        _Finding(one.kind, one.name, one.target, one.source, verdict, file)
        for (one, _), (verdict, file) in zip(offers, results, strict=True)
    ]
    problems = list(_problems(catalogue))
    broken = bool(problems) or any(finding.verdict not in ("", "ok") for finding in findings)
    if as_json:
        plain_problems = [{"source": source, "reason": reason} for source, reason in problems]
        click.echo(json.dumps({"extensions": [asdict(one) for one in findings], "problems": plain_problems}, indent=1))
    else:
        click.echo(_table(findings))
    for source, reason in problems:
        report("E-PLUGIN", f"{source}: {reason}")
    return exits.FAILED if broken else exits.DONE


def _with_rivals(verdict: str, extension: Extension, several: tuple[Extension, ...]) -> str:
    """The result, with the other plugins that offer the same name, which makes the name unusable."""
    if len(several) == 1:
        return verdict
    others = " and ".join(f"{one.target} ({one.source})" for one in several if one is not extension)
    rivals = f"the name is offered {len(several)} times, also by {others}"
    return rivals if verdict == "ok" else f"{verdict}; {rivals}"


def _problems(catalogue: Catalogue) -> Iterator[tuple[str, str]]:
    """The source and the fault of each plugin that could not be read, and of each name that cannot be used."""
    yield from ((problem.source, problem.reason) for problem in catalogue.problems)
    yield from clashes(catalogue, tuple(getattr(click.get_current_context().find_root().command, "own", ())))


def _result_cells(one: _Finding, first: _Finding) -> tuple[str, ...]:
    if one is not first and _PLACE.search(one.verdict):
        return (f"as {first.name} above",)
    shows_file = one.verdict not in ("", "ok") and one.file and one.file not in one.verdict
    return (f"{one.verdict} [{one.file}]" if shows_file else one.verdict,) if one.verdict else ()


def _table(findings: Iterable[_Finding]) -> str:
    first: dict[str, _Finding] = {}
    rows = [
        tuple(map(printed, (_WORDS.get(one.kind, one.kind[:-1]), one.name, one.target, one.source, *cells)))
        for one in findings
        for cells in [_result_cells(one, first.setdefault(one.verdict, one))]
    ]
    widths = [max((len(row[column]) for row in rows), default=0) for column in range(3)]
    return "\n".join(
        "  ".join(cell.ljust(widths[i] if i < len(widths) else 0) for i, cell in enumerate(row)).rstrip()
        for row in rows
    )
