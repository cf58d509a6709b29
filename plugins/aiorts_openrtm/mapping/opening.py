"""Reads a file of OpenRTM of any kind, and says which kind it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from aiorts.layout import Places
from aiorts.system import Wanted
from aiorts_openrtm.conf.properties import Conf
from aiorts_openrtm.mapping.conf_system import system_of_conf
from aiorts_openrtm.mapping.importing import imported
from aiorts_openrtm.mapping.places import located
from aiorts_openrtm.mapping.rtc_system import system_of_type
from aiorts_openrtm.mapping.types import Types
from aiorts_openrtm.markup.source import decoded, read_bytes
from aiorts_openrtm.markup.xml_in import element_of_xml
from aiorts_openrtm.markup.yaml_in import element_of_yaml
from aiorts_openrtm.notes import Note
from aiorts_openrtm.profiles.rtc_profile import RtcProfile
from aiorts_openrtm.profiles.rts_profile import RtsProfile

Kind = Literal["rtsprofile", "yaml", "conf", "rtc"]


@dataclass(frozen=True, slots=True)
class Opened:
    """A file of OpenRTM as the profile of a system."""

    kind: Kind
    profile: RtsProfile
    files: Mapping[str, list[Path]]
    """The files in which the class of a type may stand, by the type's name."""
    notes: list[Note]


def opened(path: Path, types: Types) -> Opened:
    """Read a file: a profile of a system in XML or YAML, `rtc.conf`, the `.conf` of a component, or `RTC.xml`.

    Raises:
        OpenRTMError: the file is none of these, or has a fault; the message has the line.
        MissingExtra: the reader of its format is not installed.
    """
    kind = _kind(path)
    if kind == "conf":
        system = system_of_conf(Conf.read(path), types)
        return Opened(kind, RtsProfile.of(system.element), system.files, system.notes)
    text = decoded(read_bytes(path), path)
    if kind == "yaml":
        return Opened(kind, RtsProfile.of(element_of_yaml(text, path)), {}, [])
    root = element_of_xml(text, path)
    if root.local == "RtcProfile":
        return Opened("rtc", RtsProfile.of(system_of_type(RtcProfile.of(root))), {}, [])
    return Opened(kind, RtsProfile.of(root), {}, [])


def read_system(
    path: Path, *, module_paths: Sequence[Path] = (), folder: Path | None = None
) -> tuple[Wanted, tuple[Note, ...]]:
    """The system that a file of OpenRTM describes, and notes on what could not be carried over.

    Args:
        module_paths: folders below which files may be named, besides that of the file.
        folder: the future folder of the system file that is made of it; the current one by default.

    Raises:
        OpenRTMError, MissingExtra: as `opened`.
    """
    wanted, notes, _ = read_placed_system(path, module_paths=module_paths, folder=folder)
    return wanted, notes


def read_placed_system(
    path: Path, *, module_paths: Sequence[Path] = (), folder: Path | None = None
) -> tuple[Wanted, tuple[Note, ...], Places]:
    """As `read_system`, with the places of the components in the tools that wrote the file."""
    types = Types((path.parent, *module_paths), folder or Path.cwd())
    found = opened(path, types)
    made = imported(found.profile, types, found.files)
    return made.wanted, (*found.notes, *made.notes), located(found.profile.element, made.names, made.wanted)


def _kind(path: Path) -> Kind:
    suffix = path.suffix.lower()
    if suffix in (".conf", ".cfg"):
        return "conf"
    if suffix in (".yaml", ".yml"):
        return "yaml"
    head = read_bytes(path)[:4096].replace(b"\0", b"").lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n")
    if suffix == ".xml" or head.startswith(b"<"):
        return "rtsprofile"
    return "yaml" if b"rtsProfile" in head else "conf"
