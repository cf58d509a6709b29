"""`aiorts check FILE...`: prints what is to be said of system files; what that is, `aiorts.system` knows."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import click

from aiorts.cli.report import cut, printed
from aiorts.cli.unrun import catalogue_of, plugins_option, quietly
from aiorts.system import Finding, check

__all__ = ("check_command",)

_WORDS: Final = {"error": "E", "warning": "W", "note": "N"}
_SHOWN: Final = 100
"""Characters of a line that are quoted."""
_GITHUB: Final = {"error": "error", "warning": "warning", "note": "notice"}


@click.command("check", short_help="Check system files without running them.")
@click.argument("files", metavar="SYSTEM.toml...", nargs=-1, required=True, type=click.Path())
@click.option("--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="Check with this parameter.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", "json", "github"]),
    default="text",
    help="text for people, json one object for each file in a line, github for its annotations.",
)
@plugins_option
@click.option("--strict", is_flag=True, help="Exit status 1 when there are warnings and no errors.")
@click.option("-q", "--quiet", is_flag=True, help="Leave notes out.")
def check_command(
    files: tuple[str, ...],
    changes: tuple[str, ...],
    form: str,
    plugins: tuple[Path, ...],
    strict: bool,
    quiet: bool,
) -> int:
    """Say all that can be known of system files without running them.

    Component files and plugins are imported, as running would; no hook runs and nothing is opened. Exit status: 0 when
    nothing is wrong, 2 when there are errors; warnings change it with --strict alone, to 1.
    """
    counts: Counter[str] = Counter()
    folders = catalogue_of(None, plugins).folders
    for file in files:
        with quietly():
            findings = [one for one in check(file, changes, folders) if not (quiet and one.severity == "note")]
        counts.update(one.severity for one in findings)
        _PRINTERS[form](file, findings)
    if counts["error"]:
        return 2
    return 1 if strict and counts["warning"] else 0


def _text(file: str, findings: Sequence[Finding]) -> None:
    for one in findings:
        click.echo(_line(one))
        if one.quote:
            click.echo(_quoted(one))
        if one.suggestion:
            click.echo("".join(f"    {line}".rstrip() + "\n" for line in one.suggestion.splitlines()))
    counts = Counter(one.severity for one in findings)
    said = ", ".join(f"{counts[word]} {word}{'s' * (counts[word] != 1)}" for word in _WORDS if counts[word])
    runs = "" if counts["error"] else ", it can run"
    click.echo(printed(f"{file}: {said or 'nothing to say'}{runs}"))


def _line(one: Finding) -> str:
    where = f"{one.where}: " if one.where else ""
    start = f"aiorts: {one.code}: {one.place}: {where}"
    return cut(printed(f"{start}{one.message}"))


def _quoted(one: Finding) -> str:
    """The line of the file round the place, and a mark under the place."""
    first = max(0, one.column - 1 - _SHOWN // 2) if len(one.quote) > _SHOWN else 0
    shown = "".join(c if c.isprintable() else " " if c == "\t" else "?" for c in one.quote[first : first + _SHOWN])
    before = one.column - 1 - first
    width = max(1, min(one.width, len(shown) - before))
    return f"  {shown}\n  {' ' * before}{'^' * width}"


def _json(file: str, findings: Sequence[Finding]) -> None:
    counts = Counter(one.severity for one in findings)
    numbers = {f"{word}s": counts[word] for word in _WORDS}
    click.echo(json.dumps({"file": file, **numbers, "findings": [one.plain() for one in findings]}))


def _github(file: str, findings: Sequence[Finding]) -> None:
    for one in findings:
        place = f",line={one.line},col={one.column},endColumn={one.column + one.width}" if one.line else ""
        where = f"{one.where}: " if one.where else ""
        title = f",title={_escaped(one.code)}"
        click.echo(
            f"::{_GITHUB[one.severity]} file={_escaped(str(one.path))}{place}{title}::"
            f"{_data(printed(where + one.message) + (chr(10) + one.suggestion if one.suggestion else ''))}"
        )


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _escaped(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


_PRINTERS: Final = {"text": _text, "json": _json, "github": _github}
