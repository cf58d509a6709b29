"""Finds the ports that composites of a system file will show, from their members' drafts; no composite is made."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any

from aiorts.composites import exports, shown
from aiorts.errors import AiortsError, SystemFileError, WiringError
from aiorts.kernel.ports import Port
from aiorts.late import dataclass
from aiorts.model.names import names_kernel
from aiorts.model.wanted.entries import CompositeEntry
from aiorts.spelling import nearest, suggestion
from aiorts.system.checks.draft import Draft
from aiorts.system.checks.findings import Said
from aiorts.system.file.families import inner_first
from aiorts.system.file.values import SystemFile
from aiorts.system.text.places import Key


@dataclass(frozen=True, slots=True)
class Composition:
    """The drafts of a system's composites, and the findings about them."""

    drafts: Mapping[str, Draft]
    """The composites by name, with their exported ports, which are the members' own ports."""
    said: tuple[Said, ...]


def compositions(system: SystemFile, drafts: Mapping[str, Draft], broken: Collection[str] = ()) -> Composition:
    """The drafts of the composites, made from those of their members, inner ones first; `broken` ones get no ports."""
    found: dict[str, Draft] = {}
    said: list[Said] = []
    for entry in inner_first(system.composites):
        far = {name: Draft(None, {}, complete=False) for name in entry.members if names_kernel(name)}
        known = {**drafts, **found, **far}
        if entry.name in broken or any(name not in known or known[name].error for name in entry.members):
            found[entry.name] = Draft(None, {}, complete=False, error=SystemFileError("has been said of it"))
            continue
        members = {name.rpartition("/")[2]: known[name] for name in entry.members}
        complete = all(one.complete for one in members.values())
        said += _strangers(entry, members, complete=complete)
        found[entry.name] = _draft(entry, members, said, complete=complete)
    return Composition(found, tuple(said))


def leaf_paths(system: SystemFile, drafts: Mapping[str, Draft]) -> SystemFile:
    """The system with connections of the members' own ports, as far as known, in the place of the composites' ports."""
    if not system.composites:
        return system
    own = {
        port: f"{name}.{shown_as}" if entry.isolation else port.path  # an isolated one's members are in its process
        for name, entry in system.components.items()
        if name in drafts
        for shown_as, port in drafts[name].ports.items()
    }

    def leaf(path: str) -> str:
        name, _, port = path.partition(".")
        there = drafts[name].ports.get(port) if name in system.composites and name in drafts else None
        return path if there is None else own.get(there, path)

    connections = tuple(replace(one, ports=tuple(leaf(path) for path in one.ports)) for one in system.connections)
    return replace(system, connections=connections)


def _draft(entry: CompositeEntry, members: Mapping[str, Draft], said: list[Said], *, complete: bool) -> Draft:
    rules = exports(entry.exported, entry.name)
    every: dict[tuple[str, str], Port[Any]] = {
        (name, port): made for name, one in members.items() for port, made in one.ports.items()
    }
    try:
        names = shown(rules, every, entry.name)
    except AiortsError as error:
        text = str(error).removeprefix(f"{entry.name}: ")
        said.append(Said("error", error.code, ("composites", entry.name, "exported"), text))
        return Draft(None, {}, complete=False, error=error)
    return Draft(None, {name: every[place] for name, place in names.items()}, complete=complete)


def _strangers(entry: CompositeEntry, members: Mapping[str, Draft], *, complete: bool) -> Iterator[Said]:
    """The findings about `exported` entries for a port that does not exist, and patterns that match no port."""
    ports = [f"{name}.{port}" for name, one in members.items() for port in one.ports]
    for number, pattern in enumerate(entry.exported):
        rule = exports([pattern], entry.name)[0]
        if any(rule.fits(*path.split(".")) for path in ports):
            continue
        unsure = not complete and (rule.component not in members or not members[rule.component].complete)
        whose = members.get(rule.component)
        if unsure and (not nearest(pattern, ports) or (whose is not None and not whose.ports)):
            continue
        key: Key = ("composites", entry.name, "exported", entry.exported_key(number))
        text = f"no member has a port {pattern!r}; {suggestion(pattern, ports)}"
        yield Said("error" if rule.literal else "warning", WiringError.code if rule.literal else "W-EXPORT", key, text)
