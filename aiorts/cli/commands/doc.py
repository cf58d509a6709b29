"""`aiorts doc TYPE|FILE`: writes a page about components, from the data of `aiorts inspect`."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.doc_pages import Block, Drawing, Head, Table, Text, html_of, markdown_of
from aiorts.cli.commands.inspection import Drawn, draw, method_text
from aiorts.cli.commands.unrun import catalogue_of, quietly
from aiorts.cli.commands.written import give
from aiorts.cli.console.choices_option import choices_options
from aiorts.cli.console.completion import subjects
from aiorts.cli.console.report import printed
from aiorts.cli.console.subjects import Subject, find_subject
from aiorts.errors import ConfigurationError
from aiorts.statechart import Chart
from aiorts.statemachines import StateStructure
from aiorts.system import AS_WRITTEN, Choices, graph, load


@click.command("doc", short_help="Write a page about components: Markdown or HTML.")
@click.argument("name", metavar="TYPE|FILE", shell_complete=subjects)
@click.option(
    "--format",
    "language",
    type=click.Choice(("md", "html")),
    help="The language; by default html where FILE of -o ends in .html, else md.",
)
@click.option("-o", "--output", metavar="FILE", type=click.Path(), help="Write the page there, not to standard output.")
@click.option("--force", is_flag=True, help="Overwrite FILE.")
@choices_options
def doc(name: str, language: str | None, output: str | None, force: bool, choices: Choices) -> int:
    """Write a page about a component or a system: its text, ports, services, parameters, options and state machine.

    TYPE is an installed component, FILE.py:Class or package.module:Class; of FILE.py it is all its components, of a
    system file a drawing of the system and the types of its components. Nothing is run. HTML is one file that loads
    nothing from elsewhere.
    """
    with quietly():
        if name.endswith(".toml"):
            title, found, blocks = _system(name, choices)
        elif choices != AS_WRITTEN:
            raise click.UsageError("--var and --remap are for a system file, not for a component alone")
        else:
            found, blocks = list(_subjects(name)), []
            title = ", ".join(one.cls.__name__ for one in found)
        blocks += [block for one in found for block in _blocks(one, draw(one, (), name))]
    ending = Path(output).suffix.lower() if output else ""
    language = language or ("html" if ending in (".html", ".htm") else "md")
    give(output, html_of(title, blocks) if language == "html" else markdown_of(blocks), force=force)
    return exits.DONE


def _subjects(name: str) -> Iterator[Subject]:
    if not name.endswith(".py"):
        subject = find_subject(name)
        if not subject.is_component:
            raise ConfigurationError(f"{printed(name)}: is no component; aiorts inspect shows a record type")
        yield subject
        return
    try:
        tree = ast.parse(Path(name).read_bytes(), name)
    except OSError as error:
        raise ConfigurationError(f"{printed(name)}: cannot be read: {error.strerror or error}") from None
    except (SyntaxError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"{printed(name)}: is no Python: {error}") from None
    some = False
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            subject = find_subject(f"{name}:{node.name}")
            if subject.is_component:
                some = True
                yield subject
    if not some:
        raise ConfigurationError(f"{printed(name)}: has no component; a component is a class derived from Component")


def _blocks(subject: Subject, drawn: Drawn) -> Iterator[Block]:
    profile = drawn.profile
    yield Head(1, profile["type"])
    for paragraph in filter(None, profile["doc"].split("\n\n")):
        yield Text(paragraph)
    if subject.source.startswith("file "):  # its folder has a meaning on this machine only
        yield Text(f"`{Path(subject.source).name}:{subject.cls.__qualname__}`")
    else:
        yield Text(f"{profile['package']}, `{profile['class']}`")
    data = [one for one in profile["ports"] if one["direction"] != "service"]
    if drawn.missing or data:
        yield Head(2, "Ports")
    if drawn.missing:
        yield Text(profile["interface"] or "Its options make them.")
    elif data:
        rows = [
            (one["name"], one["direction"], one["type"], one["unit"] or "", _text(one["shape"]), one["doc"])
            for one in data
        ]
        yield Table(("Name", "Direction", "Type", "Unit", "Shape", "Meaning"), rows)
    yield from _services(profile["ports"])
    if profile["parameters"]:
        yield Head(2, "Parameters")
        keys = ("name", "type", "default", "unit", "constraint", "doc")
        values = [
            ['""' if key == "default" and one[key] == "" else _text(one[key]) for key in keys]
            for one in profile["parameters"]
        ]
        yield Table(("Name", "Type", "Default", "Unit", "Allowed", "Meaning"), values)
    if len(profile["sets"]) > 1:
        yield Head(2, "Configuration sets")
        held = [
            (key, ", ".join(f"{name} = {_text(one)}" for name, one in values.items()))
            for key, values in profile["sets"].items()
        ]
        yield Table(("Name", "Values"), held)
    if drawn.options:
        yield Head(2, "Options")
        options = [(", ".join(one.flags), one.param or "", one.help) for one in drawn.options]
        yield Table(("Option", "Sets", "Meaning"), options)
    if profile["modes"]:
        yield Head(2, "Modes")
        yield Text(", ".join(profile["modes"]))
    chart = getattr(subject.cls, "chart", None)
    if isinstance(chart, Chart):
        yield Head(2, "State machine")
        lines = [row for state in chart.structure.states for row in _transitions(state, "")]
        yield Table(("State", "On", "If", "Does", "Goes to"), lines)
    if profile["hooks"]:
        yield Head(2, "Hooks")
        yield Text(", ".join(profile["hooks"]))


def _transitions(state: StateStructure, inside: str) -> Iterator[tuple[str, ...]]:
    """The rows of the transitions of a state and its inner states; a state without transitions has a row, too."""
    name = f"{inside}{state.name}"
    for one in state.transitions:
        event = f"after {one.delay} s" if one.delay is not None else one.event
        yield name, event, one.guard or "", ", ".join(one.actions), one.target or ""
    if not state.transitions:
        yield name, "", "", "", ""
    for inner in state.states:
        yield from _transitions(inner, f"{name}.")


def _system(file: str, choices: Choices) -> tuple[str, list[Subject], list[Block]]:
    """The title of the page, the types of the components, and the blocks about the system itself."""
    system = load(file, (), choices)
    catalogue = catalogue_of(system)
    homes = {name: context.name for context in system.contexts.values() for name in context.members}
    rows = [(one.name, one.type, homes.get(one.name, "")) for one in system.components.values()]
    entries = system.components.values()
    types = dict.fromkeys(_named(one.type, system.folder_of(("components", one.name, "type"))) for one in entries)
    subjects = {one.cls: one for one in (find_subject(text, catalogue.folders) for text in types)}
    blocks: list[Block] = [
        Head(1, system.path.name),
        Drawing(graph(system, "mermaid", catalogue), graph(system, "svg", catalogue)),
        Table(("Component", "Type", "Context"), rows),
    ]
    return system.path.name, list(subjects.values()), blocks


def _named(text: str, folder: Path) -> str:
    """A type as on a command line: FILE.py is relative to the folder of the file that names it."""
    return str(folder / text) if ".py:" in text else text


def _services(ports: Iterable[dict[str, Any]]) -> Iterator[Block]:
    ends = [(port["name"], one) for port in ports for one in port["interfaces"]]
    if ends:
        yield Head(2, "Services")
    for name, one in ends:
        yield Head(3, f"{name}: {one['polarity']} {one['type']}")
        if one["doc"]:
            yield Text(one["doc"].partition("\n\n")[0])
        yield Table(("Method", "Meaning"), [method_text(method) for method in one["methods"]])


def _text(value: Any) -> str:
    return "" if value is None else str(value)
