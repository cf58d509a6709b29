"""The command `aiorts new`: writes a plugin with one component into a folder of its own."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from aiorts import Catalogue, exits
from aiorts.cli.console.output import say
from aiorts.cli.console.report import printed
from aiorts.errors import ConfigurationError


def _types(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    from aiorts.cli.console.completion import items
    from aiorts.types import all_types

    port, sign, _ = incomplete.partition(":")
    return items((f"{port}:{name}" for name in all_types()), incomplete) if sign else []


@click.command(short_help="Write a plugin with a new component, to begin with.")
@click.argument("name")
@click.option(
    "--from",
    "source",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Ports, parameters and services of a file that a plugin reads, such as OpenRTM's RTC.xml.",
)
@click.option("--in", "ins", multiple=True, metavar="PORT:TYPE", shell_complete=_types, help="An in-port; repeatable.")
@click.option("--out", "outs", multiple=True, metavar="PORT:TYPE", shell_complete=_types, help="An out-port.")
@click.option("--param", "params", multiple=True, metavar="NAME[:KIND][=VALUE]", help="KIND: bool, int, float, str.")
@click.option("--service", "services", multiple=True, metavar="NAME[:required]", help="A port of calls; provided.")
@click.option("--flexi", is_flag=True, help="Its ports follow from a parameter, and change while it runs.")
@click.option("--folder", type=click.Path(path_type=Path), default=".", metavar="DIR", help="Write NAME into DIR.")
def new(
    name: str,
    source: Path | None,
    ins: tuple[str, ...],
    outs: tuple[str, ...],
    params: tuple[str, ...],
    services: tuple[str, ...],
    flexi: bool,
    folder: Path,
) -> int:
    """Write the folder NAME: a plugin with one component, a system that it runs in, and its test.

    What it does at first: samples of an in-port go to the out-ports of the same type, the other out-ports write a
    default value at each cycle. An existing folder is not touched.

    \b
      aiorts new cart --in command:TimedDouble --out position:TimedDouble --param mass:float=2.0
      aiorts run cart/system.toml --for 2
      aiorts new arm --from RTC.xml
    """
    from aiorts.cli.new.design import design
    from aiorts.cli.new.project import files_of

    described, notes = None, list[str]()
    if source is not None:
        from aiorts.cli.new.described import design_of, read

        described, notes = design_of(read(source, Catalogue.default()), name)
    made = design(name, ins, outs, params, services, flexi=flexi, described=described)
    place = folder / made.name
    _write(place, files_of(made))
    for note in notes:
        click.echo(f"aiorts: note: {printed(note)}", err=True)
    say(f"{made.cls} is in {place}. Try:\n")
    say(f"  aiorts run {place / 'system.toml'} --for 2")
    say(f"  aiorts --plugins {place} inspect {made.type}")
    say(f'  python -m pytest {place}      (pip install "aiorts[test]" first)')
    return exits.DONE


def _write(place: Path, texts: Mapping[str, str]) -> None:
    """Write the folder as a whole or not at all."""
    if place.exists() or place.is_symlink():
        raise ConfigurationError(f"{place}: is there already; nothing was written, choose another name")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        half = Path(tempfile.mkdtemp(prefix=f".{place.name}-", dir=place.parent))
        try:
            for path, text in texts.items():
                (half / path).parent.mkdir(exist_ok=True)
                (half / path).write_text(text, encoding="utf-8", newline="\n")
            half.chmod(0o755)
            half.rename(place)
        except BaseException:
            shutil.rmtree(half, ignore_errors=True)
            raise
    except OSError as error:
        raise ConfigurationError(f"{place}: cannot be written: {error.strerror or error}") from None
