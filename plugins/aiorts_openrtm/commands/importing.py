"""`aiorts import`: a system file of a file of OpenRTM."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import click

from aiorts.layout import layout_beside, text_of_places
from aiorts.system import parse, system_text
from aiorts_openrtm.commands.output import check_free, tell, write
from aiorts_openrtm.notes import Note

_FILE = click.Path(path_type=Path)


@click.command("import", short_help="Make a system file of a file of OpenRTM.")
@click.argument("file", type=_FILE)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, allow_dash=True),
    default="-",
    metavar="SYSTEM",
    help="Write the system file SYSTEM; - is standard output, as by default.",
)
@click.option(
    "--module-path",
    "module_paths",
    type=click.Path(file_okay=False, path_type=Path),
    multiple=True,
    metavar="DIR",
    help="Files below DIR may be named, besides those below the folder of FILE; repeatable.",
)
@click.option("--force", is_flag=True, help="Overwrite SYSTEM.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document: the text, and the notes.")
def import_(file: Path, output: str, module_paths: tuple[Path, ...], force: bool, as_json: bool) -> int:
    """Make a system file of FILE: an RtsProfile in XML or YAML, rtc.conf, the .conf of a component, or RTC.xml.

    Components, parameters and sets, connections, contexts, composites and the order of starting are carried over. What
    a system file has no words for stays in FILE, from which aiorts export takes it again; what nothing here acts on is
    listed with its line on standard error. Nothing of FILE is loaded or looked up in the environment.

    Where components stand in FILE goes into a layout file beside SYSTEM: system.layout.json beside system.toml.
    """
    from aiorts_openrtm.mapping.opening import read_placed_system

    check_free(output, force=force)
    folder = Path(os.path.realpath(".")) if output == "-" else Path(os.path.realpath(output)).parent
    wanted, found, places = read_placed_system(file, module_paths=module_paths, folder=folder)
    origin = os.path.relpath(os.path.realpath(file), folder)
    table = {"openrtm": MappingProxyType({"profile": Path(origin).as_posix()})}
    wanted = replace(wanted, services=MappingProxyType({**wanted.services, **table}))
    said: list[str] = []
    text = system_text(wanted, folder, said)
    parse(text, folder / "system.toml")
    notes = [*found, *(Note(str(file), one) for one in said)]
    if output != "-":
        write(text, output, force=force)
        if places.boxes:
            beside = str(layout_beside(Path(output)))
            if force or not os.path.lexists(beside):
                write(text_of_places("", places), beside, force=force)
            else:
                notes.append(Note(str(file), f"{beside} is there already and stays; --force overwrites it"))
    return tell(text, notes, output, as_json=as_json)
