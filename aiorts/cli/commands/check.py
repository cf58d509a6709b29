"""`aiorts check FILE...`: prints the findings of `aiorts.system.checks` for system files and running kernels."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Sequence
from difflib import unified_diff
from functools import partial
from pathlib import Path
from typing import Final

import click

from aiorts import exits
from aiorts.cli.commands.live.look.reading import is_live, profiles_of, tell_of
from aiorts.cli.commands.live.target import complete_systems
from aiorts.cli.commands.unrun import catalogue_of, quietly
from aiorts.cli.console.choices_option import choices_options
from aiorts.cli.console.finding import below, line_of
from aiorts.cli.console.report import has_colours, painted, printed
from aiorts.configuration import replace_text
from aiorts.system import Choices, Finding, check, check_running, check_text
from aiorts.system.checks.fixing import fixed
from aiorts.system.text.toml import read_text

_WORDS: Final = {"error": "E", "warning": "W", "note": "N"}
_GITHUB: Final = {"error": "error", "warning": "warning", "note": "notice"}


@click.command("check", short_help="Check system files without running them, or what runs.")
@click.argument(
    "files",
    metavar="SYSTEM.toml|KERNEL...",
    nargs=-1,
    required=True,
    type=click.Path(),
    shell_complete=complete_systems,
)
@click.option(
    "--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="Set a parameter of the checked system."
)
@click.option(
    "--format",
    "layout",
    type=click.Choice(["text", "json", "github"]),
    default="text",
    help="text for people, json one object for each file in a line, github for its annotations.",
)
@click.option("--json", "layout", flag_value="json", help="The same as --format json.")
@choices_options
@click.option("--strict", is_flag=True, help="Exit status 1 when there are warnings and no errors.")
@click.option("--fix", is_flag=True, help="Print the difference that mends what has one answer, and what is left.")
@click.option("--write", is_flag=True, help="With --fix: replace the files, whole.")
@click.option("-q", "--quiet", is_flag=True, help="Leave notes out.")
def check_command(
    files: tuple[str, ...],
    changes: tuple[str, ...],
    choices: Choices,
    layout: str,
    strict: bool,
    fix: bool,
    write: bool,
    quiet: bool,
) -> int:
    """Find everything wrong with system files that can be found without running them.

    A word that is no file is a kernel that runs: what failed, is lost or late in it, or never runs.

    Component files and plugins are imported, as running would; no hook runs and nothing is opened. Exit status: 0 when
    nothing is wrong, 2 when there are errors; warnings change it to 1, only with --strict.

    --fix mends the text of each file where there is one answer: a name for which a similar one is meant; a member with
    a process of its own among others, which gets a context of its own. All else stays, comments too. The difference is
    printed, and what is found after it on standard error; --write puts it into the file, in one step. Exit status: 2
    when errors are left, 1 when there is a difference and no --write, or warnings are left with --strict, else 0.
    """
    if write and not fix:
        raise click.UsageError("--write is for --fix: it writes what that has mended")
    if fix:
        if layout != "text":
            raise click.UsageError(f"--fix prints a difference, and goes not with --format {layout}")
        return _fix(files, changes, catalogue_of(None).folders, choices, write=write, strict=strict, quiet=quiet)
    counts: Counter[str] = Counter()
    folders = catalogue_of(None).folders
    for file in files:
        found: Sequence[Finding]
        if is_live(file):
            file, (profile,) = profiles_of(file)
            found = check_running(profile, file)
        else:
            with quietly():
                found = check(file, changes, folders, choices)
            tell_of(file, "check")
        findings = _wanted(found, quiet=quiet)
        counts.update(one.severity for one in findings)
        _PRINTERS[layout](file, findings)
    return _status(counts, strict=strict)


def _wanted(found: Sequence[Finding], *, quiet: bool) -> list[Finding]:
    return [one for one in found if not (quiet and one.severity == "note")]


def _status(counts: Counter[str], *, strict: bool) -> int:
    if counts["error"]:
        return exits.REFUSED
    return exits.FAILED if strict and counts["warning"] else exits.DONE


def _fix(
    files: Sequence[str],
    changes: Sequence[str],
    folders: Sequence[Path],
    choices: Choices,
    *,
    write: bool,
    strict: bool,
    quiet: bool,
) -> int:
    """Mend files, or show the difference; returns the exit status."""
    status = exits.DONE
    for file in files:
        if is_live(file):
            raise click.UsageError(f"--fix mends system files, and {file} is none")
        path = Path(file)
        with quietly():
            text = read_text(path)
            new, left = fixed(
                text, path, partial(check_text, path=path, overrides=changes, plugins=folders, choices=choices)
            )
        lines = unified_diff(text.splitlines(keepends=True), new.splitlines(keepends=True), file, file)
        click.echo("".join(one if one.endswith("\n") else f"{one}\n" for one in lines), nl=False)
        for one in _wanted(left, quiet=quiet):
            click.echo("\n".join((line_of(one), *below(one))), err=True)
        if write and new != text:
            replace_text(path, new)
        of_left = _status(Counter(one.severity for one in left), strict=strict)
        status = max(status, of_left, exits.FAILED if new != text and not write else exits.DONE)
    return status


def _text(file: str, findings: Sequence[Finding]) -> None:
    coloured = has_colours(sys.stdout)
    for one in findings:
        lines = (line_of(one), *below(one))
        click.echo("\n".join(map(painted, lines) if coloured else lines), color=coloured)
    counts = Counter(one.severity for one in findings)
    summary = ", ".join(f"{counts[word]} {word}{'s' * (counts[word] != 1)}" for word in _WORDS if counts[word])
    runs = "" if counts["error"] or file.endswith("/") else ", it can run"
    click.echo(printed(f"{file}: {summary or 'no findings'}{runs}"))


def _json(file: str, findings: Sequence[Finding]) -> None:
    counts = Counter(one.severity for one in findings)
    numbers = {f"{word}s": counts[word] for word in _WORDS}
    click.echo(json.dumps({"file": file, **numbers, "findings": [one.plain() for one in findings]}))


def _github(file: str, findings: Sequence[Finding]) -> None:
    for one in findings:
        place = f",line={one.line},col={one.column},endColumn={one.column + one.width}" if one.line else ""
        where = f"{one.where}: " if one.where else ""
        click.echo(
            f"::{_GITHUB[one.severity]} file={_escaped(str(one.path))}{place},title={_escaped(one.code)}::"
            f"{_data(printed(where + one.message) + (chr(10) + one.suggestion if one.suggestion else ''))}"
        )


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _escaped(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


_PRINTERS: Final = {"text": _text, "json": _json, "github": _github}
