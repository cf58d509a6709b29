"""`aiorts graph SYSTEM.toml|KERNEL`: prints a drawing of a system, or writes it to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from aiorts import exits
from aiorts.cli.commands.live.look.reading import is_live, profiles_of, tell_of
from aiorts.cli.commands.live.target import complete_systems
from aiorts.cli.commands.unrun import catalogue_of, quietly
from aiorts.cli.commands.written import give
from aiorts.cli.console.choices_option import choices_options
from aiorts.cli.console.finding import below, line_of
from aiorts.layout import stored_places
from aiorts.system import AS_WRITTEN, GRAPH_FORMATS, Choices, check, graph, load, running_graph

_ENDINGS: Final = {
    "": "mermaid",
    ".mmd": "mermaid",
    ".mermaid": "mermaid",
    ".md": "mermaid",
    ".svg": "svg",
    ".dot": "dot",
    ".gv": "dot",
}


@click.command("graph", short_help="Draw a system file, or what runs.")
@click.argument("file", metavar="SYSTEM.toml|KERNEL", type=click.Path(), shell_complete=complete_systems)
@click.option(
    "--format",
    "language",
    type=click.Choice(GRAPH_FORMATS),
    help="The language; by default what FILE of -o ends in, else mermaid.",
)
@click.option(
    "-o", "--output", metavar="FILE", type=click.Path(), help="Write the drawing there, not to standard output."
)
@click.option(
    "--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="Set a parameter of the drawn system."
)
@choices_options
def graph_command(
    file: str,
    language: str | None,
    output: str | None,
    changes: tuple[str, ...],
    choices: Choices,
) -> int:
    """Draw the system that SYSTEM.toml describes: its components by context, their ports, and the connectors.

    A word that is no file is a kernel that runs: it is drawn as it is now, with states, rates and what was dropped.

    mermaid is shown by GitHub and many editors, dot is for Graphviz, svg needs no other program. In an svg the boxes
    stand as in the studio, where its layout file lies beside SYSTEM.toml: system.layout.json. Nothing is run. What
    `aiorts check` reports as an error is printed on standard error; the rest is drawn, and the exit status is 2.
    """
    language = language or _language_of(output)
    if is_live(file):
        if changes:
            raise click.UsageError(f"--set is of a system file, and {file} is none; see aiorts conf")
        if choices != AS_WRITTEN:
            raise click.UsageError(f"--var and --remap are of a system file, and {file} is none")
        earlier, later = profiles_of(file, 2)[1]
        give(output, running_graph(later, language, earlier))
        return exits.DONE
    system = load(file, changes, choices)
    with quietly():
        catalogue = catalogue_of(system)
        text = graph(system, language, catalogue, stored_places(Path(file), _say_unused) if language == "svg" else None)
        wrong = [one for one in check(file, changes, catalogue.folders, choices) if one.severity == "error"]
    give(output, text)
    tell_of(file, "graph")
    for one in wrong:
        click.echo("\n".join((line_of(one), *below(one))), err=True)
    return exits.REFUSED if wrong else exits.DONE


def _say_unused(path: Path, why: str) -> None:
    click.echo(f"aiorts: {path}: {why}", err=True)


def _language_of(output: str | None) -> str:
    ending = Path(output).suffix.lower() if output else ""
    if ending not in _ENDINGS and not (output and Path(output).exists() and not Path(output).is_file()):
        there = ", ".join(filter(None, _ENDINGS))
        raise click.UsageError(f"-o {output}: no drawing ends in {ending}; there are {there}; or give --format")
    return _ENDINGS.get(ending, "mermaid")
