"""`aiorts plan OLD NEW`: what would have to be done to make one system of another."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from aiorts import exits
from aiorts.cli.commands.unrun import catalogue_of, plugins_option, quietly
from aiorts.cli.console.choices_option import choices_options
from aiorts.cli.console.output import say, say_json
from aiorts.errors import SystemFileError
from aiorts.model.wanted.plan import plan
from aiorts.system import AS_WRITTEN, Choices, Wanted, load, prepare, wanted

_FILE: Final = click.Path(dir_okay=False, path_type=Path)


@click.command("plan", short_help="Show what makes one system of another.")
@click.argument("old", metavar="OLD.toml", type=_FILE)
@click.argument("new", metavar="NEW.toml", type=_FILE)
@click.option("--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="Set a parameter of NEW.")
@choices_options
@plugins_option
@click.option("--json", "as_json", is_flag=True, help="One JSON document: the steps, each with its text.")
def plan_command(
    old: Path, new: Path, changes: tuple[str, ...], choices: Choices, plugins: tuple[Path, ...], as_json: bool
) -> int:
    """List the steps that make the system of NEW of a running one of OLD, in order.

    What is new is made and connected first; then what changes is switched over; then the rest is disconnected and
    removed. What is equal in both is touched by no step. Component files and plugins are imported, no hook runs. Exit
    status: 0 when there is no difference, 1 when there is, 2 when it cannot be done while the system runs.
    """
    with quietly():
        found = plan(_wanted(old, (), AS_WRITTEN, plugins), _wanted(new, changes, choices, plugins))
    if as_json:
        say_json(found.to_plain())
    else:
        for step in found.steps:
            say(f"{step.sign} {step.text}")
    if found.refused:
        if not as_json:
            raise SystemFileError("; ".join(found.refused))
        return exits.REFUSED
    return exits.FAILED if found.steps else exits.DONE


def _wanted(file: Path, changes: tuple[str, ...], choices: Choices, plugins: tuple[Path, ...]) -> Wanted:
    system = load(file, changes, choices)
    return wanted(prepare(system, catalogue_of(system, plugins)))
