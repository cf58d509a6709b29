"""`aiorts plan`: prints the steps that would change a system of a file, or a running one, into another."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import click

from aiorts import Catalogue, exits
from aiorts.cli.commands.live.showing import timeout_option
from aiorts.cli.commands.live.target import complete_kernels, kernels
from aiorts.cli.commands.unrun import catalogue_of, quietly
from aiorts.cli.console.choices_option import choices_options
from aiorts.cli.console.finding import text_of
from aiorts.cli.console.output import say, say_json
from aiorts.errors import LimitError, SystemFileError
from aiorts.model.wanted.carried import carried
from aiorts.model.wanted.plan import plan
from aiorts.planning import without_provenance
from aiorts.system import AS_WRITTEN, Choices, Wanted, check, load, prepare, wanted

_FILE: Final = click.Path(dir_okay=False, path_type=Path)
_PART: Final = 60_000
_MOST: Final = 500_000
"""Characters of the largest system that is sent (`_MOST`), and of each text into which it is divided (`_PART`)."""


@click.command("plan", short_help="Show the steps from one system to another.")
@click.argument("old", metavar="[OLD.toml]", type=_FILE)
@click.argument("new", metavar="NEW.toml", type=_FILE, required=False)
@click.option("--live", metavar="KERNEL", help="In place of OLD.toml: what runs.", shell_complete=complete_kernels)
@click.option("--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="Set a parameter of NEW.")
@choices_options
@timeout_option(8.0, "With --live wait S seconds")
@click.option("--json", "as_json", is_flag=True, help="One JSON document: the steps, each with its text.")
def plan_command(
    old: Path,
    new: Path | None,
    live: str | None,
    changes: tuple[str, ...],
    choices: Choices,
    timeout: float,
    as_json: bool,
) -> int:
    """List the steps that change a running system of OLD, or the one in KERNEL, into that of NEW, in order.

    What is new is made and connected first; then what changes is switched over; then the rest is disconnected and
    removed. What is equal in both is touched by no step. Component files and plugins are imported, no hook runs. Exit
    status: 0 when there is no difference, 1 when there is, 2 when it cannot be done while the system runs.
    """
    if live is not None and new is None:
        file = old
        parts = parts_of(wanted_of(file, changes, choices))
        with kernels(right="code") as running:
            found = running.kernel(live.rstrip("/")).client.call("plan", timeout, wanted=parts)
    elif live is None and new is not None:
        file = new
        both = wanted_of(old, (), AS_WRITTEN), wanted_of(file, changes, choices)
        found = plan(*(without_provenance(one, Catalogue(one.plugin_paths)) for one in both)).to_plain()
    else:
        raise click.UsageError("give two files, or one file and --live KERNEL")
    check_steps(found["steps"], file, changes, choices)
    return say_planned(found, as_json=as_json)


def check_steps(
    steps: Iterable[Mapping[str, Any]],
    file: Path,
    changes: tuple[str, ...],
    choices: Choices,
) -> None:
    """Check that the file can run at all, as `aiorts check` does, where the steps change more than parameters.

    Raises:
        SystemFileError: the first error of the check.
    """
    if all(step["step"] == "Configure" for step in steps):
        return
    with quietly():
        wrong = [one for one in check(file, changes, catalogue_of(None).folders, choices) if one.severity == "error"]
    if wrong:
        more = f" ({len(wrong) - 1} more, see aiorts check {file})" if wrong[1:] else ""
        raise SystemFileError(text_of(wrong[0]) + more)


def say_planned(found: Mapping[str, Any], *, as_json: bool) -> int:
    """Print steps; returns the exit status.

    Raises:
        SystemFileError: the change cannot be done while the system runs, and no JSON document is wanted.
    """
    if as_json:
        say_json(found)
    else:
        say_steps(found["steps"])
    if found["refused"]:
        if not as_json:
            raise SystemFileError("; ".join(found["refused"]))
        return exits.REFUSED
    return exits.FAILED if found["steps"] else exits.DONE


def say_steps(steps: Iterable[Mapping[str, Any]]) -> None:
    """Print steps, which are plain data, each as a line."""
    for step in steps:
        say(f"{step['sign']} {step['text']}")


def wanted_of(file: Path, changes: tuple[str, ...], choices: Choices) -> Wanted:
    """The system that a file describes."""
    with quietly():
        system = load(file, changes, choices)
        return wanted(prepare(system, catalogue_of(system)))


def parts_of(system: Wanted) -> tuple[str, ...]:
    """The system in the form of operations' arguments. LimitError when it is too large to be sent."""
    text = carried(system)
    if len(text) > _MOST:
        raise LimitError(f"the system is too large to be sent: {len(text)} characters, at most {_MOST}")
    return tuple(text[at : at + _PART] for at in range(0, len(text), _PART))
