"""`aiorts graph SYSTEM.toml`: prints a drawing of a system, or writes it to a file."""

from __future__ import annotations

import os
from pathlib import Path

import click

from aiorts.cli.unrun import catalogue_of, plugins_option, quietly
from aiorts.errors import ConfigurationError
from aiorts.system import GRAPH_FORMATS, graph, load

__all__ = ("graph_command",)


@click.command("graph", short_help="Draw a system file.")
@click.argument("file", metavar="SYSTEM.toml", type=click.Path(dir_okay=False))
@click.option("--format", "form", type=click.Choice(GRAPH_FORMATS), help="Default: what -o ends in, else mermaid.")
@click.option("-o", "--output", metavar="FILE", type=click.Path(), help="Write it there and not to standard output.")
@click.option("--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="Draw it with this parameter.")
@plugins_option
def graph_command(
    file: str, form: str | None, output: str | None, changes: tuple[str, ...], plugins: tuple[Path, ...]
) -> int:
    """Draw the system that SYSTEM.toml describes: its components by context, their ports, and the connectors.

    mermaid is shown by GitHub and many editors, dot is for Graphviz, svg needs no other program. Nothing is run.
    """
    system = load(file, changes)
    with quietly():
        text = graph(system, form or _form_of(output), catalogue_of(system, plugins))
    if output is None or output == "-":
        click.echo(text, nl=False)
        return 0
    _write(Path(output), text)
    return 0


def _form_of(output: str | None) -> str:
    ending = Path(output).suffix.lower() if output else ""
    return {".svg": "svg", ".dot": "dot", ".gv": "dot"}.get(ending, "mermaid")


def _write(path: Path, text: str) -> None:
    """The whole text or nothing: a file that was there stays until the new one is complete."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.exists() and not path.is_file():
            path.write_text(text, encoding="utf-8")  # a device, a pipe
            return
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise ConfigurationError(f"-o {path}: cannot be written: {error.strerror or error}") from None
