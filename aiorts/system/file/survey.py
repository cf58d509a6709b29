"""Loads the types and plugins of a system file and checks each part by itself; creates nothing, goes on after faults.

`prepare` raises the first fault of a survey, `check` shows all of them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import AiortsError, ConfigurationError, PluginError, SystemFileError, WiringError
from aiorts.kernel.component import Component
from aiorts.kernel.execution.context import Context
from aiorts.kernel.extensions.arguments import needs_rate, option_flag, path_settings, settings_faults, settings_of
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.extensions.finders import offer_from
from aiorts.kernel.service import ServicePlan, load_service
from aiorts.late import dataclass
from aiorts.model.declared import options_of
from aiorts.model.options import PortLimits, connector_profile, link_options
from aiorts.model.profile import ConnectorProfile
from aiorts.model.wanted.entries import ComponentEntry, ConnectionEntry, ContextEntry
from aiorts.planning import Setting
from aiorts.spelling import suggestion
from aiorts.system.file.load import check_inside, component_type, context_type, converter, parameters, setting
from aiorts.system.file.parse import TOP, spelled
from aiorts.system.file.values import SystemFile
from aiorts.system.text.places import Key

_TEXTS: Final = ("name", "empty", "stamp", "convert")
"""Options of a connection that a program may set to None, False or 0 for no value; in a file they have to be texts."""


_ENTRY: Final = re.compile(r"\[(\d+)\](?:\.([^:]+))?: ")
_FAILED: Final = " cannot be loaded: "


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault that keeps the system from being built: its place, and the error with the remedy."""

    key: Key
    where: str
    error: AiortsError
    of_key: bool = False


@dataclass(slots=True)
class Survey:
    """The loaded parts of a system, and the faults of the others."""

    system: SystemFile
    catalogue: Catalogue
    types: dict[str, type[Component]] = field(default_factory=dict)
    classes: dict[tuple[str, Path], type[Component]] = field(default_factory=dict)
    """Classes by the text of a type and the folder of its file: thousands of components have few types."""
    settings: dict[str, Setting] = field(default_factory=dict)
    profiles: dict[int, tuple[ConnectorProfile, PortLimits]] = field(default_factory=dict)
    """By the number of the connection: its options in force, and its options that concern ports."""
    contexts: dict[str, Context] = field(default_factory=dict)
    services: dict[str, ServicePlan] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    bad_params: set[str] = field(default_factory=set)
    """Components with a wrong parameter: only their declared ports are known, not ports that depend on parameters."""

    def say(self, key: Key, error: AiortsError, where: str = "", *, of_key: bool = False) -> None:
        """Add a fault; `where` is the text of its place, by default that of the key."""
        self.faults.append(Fault(key, where or spelled(key), error, of_key))


def survey(
    system: SystemFile,
    catalogue: Catalogue | None = None,
    services: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> Survey:
    """Load and check a system without creating anything; imports the files and plugins that it names.

    Args:
        services: settings by service, which win over those of the file.
    """
    if catalogue is None:
        catalogue = Catalogue((*Catalogue.default().folders, *system.plugin_paths))
    offer_from(catalogue)
    found = Survey(system, catalogue)
    for component in system.components.values():
        survey_component(found, component)
    for connection in system.connections:
        _connection(found, connection)
    for context in system.contexts.values():
        _context(found, context)
    for name in dict.fromkeys((*services, *system.services)):
        _service(found, name, system.services.get(name, {}), services.get(name, {}))
    return found


def survey_component(found: Survey, entry: ComponentEntry) -> None:
    """Load and check one component."""
    key: Key = ("components", entry.name)
    try:
        cls = _class(found, entry)
    except (PluginError, SystemFileError) as error:
        # A module that cannot be imported fails for all its classes: it is reported once.
        _, failed, cause = str(error).partition(_FAILED)
        if not failed or all(str(one.error).partition(_FAILED)[2] != cause for one in found.faults):
            found.say((*key, "type"), error)
        return
    found.types[entry.name] = cls
    checked, faults = parameters(found.system, entry, cls)
    found.settings[entry.name], more = setting(found.system, entry, cls, checked)
    for where, said, fault in (*faults, *more):
        found.bad_params.add(entry.name)
        found.say(where, fault, said, of_key="no such parameter" in str(fault))


def _class(found: Survey, entry: ComponentEntry) -> type[Component]:
    """The class of a component, loaded once for each text; after a failure it is tried again for each component."""
    asked = entry.type, found.system.folder_of(("components", entry.name, "type"))
    cls = found.classes.get(asked)
    if cls is None:
        cls = found.classes[asked] = component_type(found.system, entry, found.catalogue)
    return cls


def _connection(found: Survey, entry: ConnectionEntry) -> None:
    # Each option is checked alone first, so that each wrong one is named and marked.
    key: Key = ("connections", entry.number - 1)
    wrong = False
    for option, value in entry.options.items():
        if option in _TEXTS and not isinstance(value, str):
            wrong = True
            found.say((*key, option), WiringError(f"{option} = {value!r:.80}: expected text"), spelled(key))
            continue
        try:
            connector_profile("", {option: value, **_needed(option, value)}, "", entry.ports)
        except WiringError as error:
            wrong = True
            what = WiringError(str(error).removeprefix(": "))
            found.say((*key, *option.split(".")), what, spelled(key), of_key="unknown option" in str(error))
    options = dict(entry.options)
    if not wrong and "convert" in options:
        try:
            options["convert"] = converter(found.system, entry, found.catalogue)
        except (PluginError, SystemFileError) as error:
            wrong = True
            found.say((*key, "convert"), error)
    if wrong:
        return
    try:
        far = [path for path in entry.ports if found.system.is_elsewhere(path)]
        if far:
            # If the writer is in another kernel, options that only that kernel can implement are reported by `checks`.
            through = entry.ports[0] in far and len(far) > 1
            options = link_options("", options, from_reader=through, through=through)
        elif options.get("on_link_lost") is not None:
            raise WiringError("on_link_lost: both ports are in this kernel; there is no link that could be lost")
        found.profiles[entry.number] = connector_profile("", options, "", entry.ports)
    except WiringError as error:
        found.say(key, WiringError(str(error).removeprefix(": ")), of_key=True)


def _needed(option: str, value: Any) -> dict[str, Any]:
    """The options that a given option requires, so that this option can be checked alone."""
    periodic = str(value).strip().lower() == "periodic"
    return {"push_rate": 1.0} if periodic and not option.endswith("push_rate") else {}


def _context(found: Survey, entry: ContextEntry) -> None:
    key: Key = ("contexts", entry.name)
    try:
        cls = context_type(found.system, entry.kind, found.catalogue)
    except (PluginError, SystemFileError) as error:
        found.say((*key, "kind"), error)
        return
    faults = list(settings_faults(cls, entry.options, ("kind", "members", "activate")))
    for word, what, of_key in faults:
        kind = SystemFileError if word and of_key else ConfigurationError
        found.say((*key, word) if word else key, kind(what), of_key=of_key)
    if needs_rate(cls) and "rate" not in entry.options:
        what = f"a {entry.kind} context needs its rate in Hz; write rate = 100.0"
        found.say(key, SystemFileError(what), of_key=True)
    if not faults:
        found.contexts[entry.name] = settings_of(cls, {"name": entry.name, **entry.options})


def _service(found: Survey, name: str, table: Mapping[str, Any], chosen: Mapping[str, Any]) -> None:
    """Load a service and check its settings: those of its table, and `chosen` ones, which win."""
    offers = found.catalogue.extensions("services")
    if name not in offers:
        what = f"unknown key {name[:80]!r}; {suggestion(name, (*TOP, *offers))}"
        found.say((name,), SystemFileError(what), of_key=True)
        return
    try:
        extension = found.catalogue.find("services", name)
        check_inside(found.system, extension)
        kind = load_service(extension)
    except (PluginError, SystemFileError) as error:
        found.say((name,), error, of_key=True)
        return
    settings: type = kind.settings
    declared = options_of(settings)
    own = _in_folder(found.system.folder_of((name,)), kind.settings, table)
    given = {**own, **chosen}
    faults = list(settings_faults(kind.settings, given))
    for key, what, of_key in faults:
        option = option_flag(name, key, declared[key]) if key in chosen and key in declared else ""
        where, what = _listed(name, what) if key == name else ((name, key) if key else (name,), what)
        found.say(where, SystemFileError(what), option, of_key=of_key)
    if not faults:
        said = own if name in found.system.services else None
        found.services[name] = ServicePlan(kind, settings_of(kind.settings, given), said)


def _listed(name: str, what: str) -> tuple[Key, str]:
    """Split a service's message "[NUMBER].KEY: ..." into the place in `[[NAME]]` that it begins with, and the rest."""
    place = _ENTRY.match(what)
    if place is None:
        return (name,), what
    entry: Key = (name, int(place[1]) - 1)
    return (*entry, place[2]) if place[2] else entry, what[place.end() :]


def _in_folder(folder: Path, settings: type, table: Mapping[str, Any]) -> dict[str, Any]:
    """A service's table in which each relative path is joined to the folder of the file."""
    paths = path_settings(settings)
    return {
        key: str(folder / value) if key in paths and isinstance(value, str) and value else value
        for key, value in table.items()
    }
