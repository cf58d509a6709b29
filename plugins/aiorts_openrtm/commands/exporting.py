"""`aiorts export`: a profile of OpenRTM of a system file, or of another file of OpenRTM."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from aiorts import declaration_of
from aiorts.errors import AiortsError
from aiorts.layout import stored_places
from aiorts.system import Choices, SystemFile, load, prepare
from aiorts_openrtm.commands.output import check_free, tell, write
from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.markup.element import Element, indented
from aiorts_openrtm.notes import Note

if TYPE_CHECKING:
    from aiorts_openrtm.mapping.exporting import Ports

_FILE = click.Path(path_type=Path)


@click.command("export", short_help="Make a profile of OpenRTM of a system file.")
@click.argument("file", type=_FILE)
@click.option(
    "--format",
    "form",
    type=click.Choice(["rtsprofile", "yaml"]),
    default="rtsprofile",
    show_default=True,
    help="rtsprofile is XML.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, allow_dash=True),
    default="-",
    metavar="PROFILE",
    help="Write PROFILE; - is standard output, as by default.",
)
@click.option("--force", is_flag=True, help="Overwrite PROFILE.")
@click.option("--var", "variables", multiple=True, metavar="NAME=VALUE", help="Set a variable of the system file.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document: the text, and the notes.")
def export(
    file: Path,
    form: Literal["rtsprofile", "yaml"],
    output: str,
    force: bool,
    variables: tuple[str, ...],
    as_json: bool,
) -> int:
    """Make a profile of FILE, a system file or a file of OpenRTM, for RTSystemEditor and rtshell.

    What is not in a system file (ids, comments, properties of others) comes from the file that it was made of,
    which its table [openrtm] names; only what differs is changed in it. Where components stand comes from the layout
    file beside FILE (system.layout.json beside system.toml), if there is one. What a profile has no words for is kept
    in properties that begin with "aiorts.", or listed on standard error. The types of a system file are imported, for
    their ports.
    """
    check_free(output, force=force)
    notes: list[Note] = []
    element = _element(file, Choices(variables), notes)
    text = _text(element, form, notes)
    if output != "-":
        write(text, output, force=force)
    return tell(text, notes, output, as_json=as_json)


def _text(element: Element, form: str, notes: list[Note]) -> str:
    from aiorts_openrtm.markup.xml_out import xml_of_element
    from aiorts_openrtm.markup.yaml_out import yaml_of_element

    return xml_of_element(element) if form == "rtsprofile" else yaml_of_element(element, notes)


def _element(file: Path, choices: Choices, notes: list[Note]) -> Element:
    from aiorts_openrtm.mapping.exporting import exported
    from aiorts_openrtm.mapping.importing import imported
    from aiorts_openrtm.mapping.opening import opened
    from aiorts_openrtm.mapping.places import with_places
    from aiorts_openrtm.mapping.types import Types
    from aiorts_openrtm.markup.shapes import RTS
    from aiorts_openrtm.profiles.rts_profile import RtsProfile

    folder = Path(os.path.realpath(file)).parent
    types = Types((folder,), folder)
    if file.suffix != ".toml":
        found = opened(file, types)
        notes += found.notes
        root = found.profile.element
        return root if found.kind == "rtsprofile" else _dated(indented(root), found.kind)
    system = load(file, (), choices)
    origin = _origin(system, notes)
    if origin is None:
        profile = RtsProfile.of(_empty(file.stem))
    else:
        found = opened(origin, types)
        profile = found.profile
        if found.kind != "rtsprofile":
            profile = RtsProfile.of(_dated(indented(profile.element), found.kind))
    root = exported(profile, system, types, lambda: _ports(system, notes), notes).element
    places = stored_places(file, lambda path, why: notes.append(Note(str(path), why)))
    if places is not None and places.boxes:
        root = with_places(root, imported(RtsProfile.of(root), types).names, places)
    if root != profile.element and origin is not None:
        root = root.with_attribute("rts:updateDate", RTS, _now())
    return root if origin is not None else indented(root)


def _origin(system: SystemFile, notes: list[Note]) -> Path | None:
    """The file that a system file was made of; None where the system file names none, or the file is gone."""
    table = system.services.get("openrtm", {})
    stated = table.get("profile") if isinstance(table, Mapping) else None
    if stated is None:
        return None
    if not isinstance(stated, str):
        raise OpenRTMError(f"{system.at('openrtm', 'profile')}: openrtm.profile: expected the name of a file")
    path = system.folder_of(("openrtm",)) / stated
    if path.exists():
        return path
    where = system.at("openrtm", "profile")
    notes.append(Note(where, f"{stated} is not there: ids, layout and what else stood in it is made anew"))
    return None


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")


def _dated(root: Element, kind: str) -> Element:
    """Set the dates of a profile made of a file without dates to now."""
    if kind == "yaml":
        return root
    root = root.with_attribute("rts:creationDate", root.space, _now())
    return root.with_attribute("rts:updateDate", root.space, _now())


def _empty(name: str) -> Element:
    from aiorts_openrtm.markup.shapes import made_system

    return made_system(identity=f"RTSystem:aiorts:{name}:1.0.0", abstract=name, date=_now())


def _ports(system: SystemFile, notes: list[Note]) -> Ports:
    """The ports of the system's types, which are imported."""
    from aiorts_openrtm.mapping.exporting import Ports

    try:
        types = prepare(system).types
    except AiortsError as error:
        notes.append(Note(str(system.path), f"its types cannot be loaded, and ports are not known: {error}"))
        return Ports()
    data: dict[str, Mapping[str, str]] = {}
    services: dict[str, tuple[str, ...]] = {}
    for name, kind in types.items():
        ports = declaration_of(kind).ports
        data[name] = {one.name: one.type for one in ports if one.direction in ("in", "out")}
        services[name] = tuple(one.name for one in ports if one.direction not in ("in", "out"))
    return Ports(data, services)
