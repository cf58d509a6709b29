"""Loads what a system file names and checks each part by itself; it creates nothing and stops at no mistake.

`prepare` raises the first fault of a survey, `check` shows all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, Final

from aiorts.errors import AiortsError, ConfigurationError, PluginError, SystemFileError, WiringError
from aiorts.kernel.catalogue import Catalogue
from aiorts.kernel.component import Component
from aiorts.kernel.context import Context
from aiorts.kernel.offers import offer_from
from aiorts.model.options import connector_profile
from aiorts.model.profile import ConnectorProfile
from aiorts.system.context_args import arguments_of, needs_rate, unfit
from aiorts.system.load import component_type, context_type, parameters, setting
from aiorts.system.parse import spelled
from aiorts.system.places import Key
from aiorts.system.setting import Setting
from aiorts.system.values import ComponentEntry, ConnectionEntry, ContextEntry, SystemFile

__all__ = ("Fault", "Survey", "survey")

_TEXTS: Final = ("name", "empty", "stamp")
"""Options of a connection whose value a program may leave out as None, False or 0; in a file that says nothing."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that keeps the system from being built: where, and the error with what is to be done."""

    key: Key
    where: str
    error: AiortsError
    of_key: bool = False


@dataclass(slots=True)
class Survey:
    """What could be had of each part, and what is wrong with the others."""

    system: SystemFile
    catalogue: Catalogue
    types: dict[str, type[Component]] = field(default_factory=dict)
    settings: dict[str, Setting] = field(default_factory=dict)
    profiles: dict[int, tuple[ConnectorProfile, dict[str, Any]]] = field(default_factory=dict)
    """By the number of the connection: the options in force, and those that are about its ports."""
    contexts: dict[str, Context] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    bad_params: set[str] = field(default_factory=set)
    """Components with a parameter that is wrong: what their ports will be is not known."""

    def say(self, key: Key, error: AiortsError, where: str = "", *, of_key: bool = False) -> None:
        """Keep a fault; `where` in place of the key as it is written."""
        self.faults.append(Fault(key, where or spelled(key), error, of_key))


def survey(system: SystemFile, catalogue: Catalogue | None = None) -> Survey:
    """Everything that can be had of a system without creating anything; imports the files and plugins that it names."""
    if catalogue is None:
        catalogue = Catalogue((*Catalogue.default().folders, *system.plugin_paths))
    offer_from(catalogue)
    found = Survey(system, catalogue)
    for component in system.components.values():
        _component(found, component)
    for connection in system.connections:
        _connection(found, connection)
    for context in system.contexts.values():
        _context(found, context)
    return found


def _component(found: Survey, entry: ComponentEntry) -> None:
    key: Key = ("components", entry.name)
    try:
        cls = component_type(found.system, entry, found.catalogue)
    except (PluginError, SystemFileError) as error:
        found.say((*key, "type"), error)
        return
    found.types[entry.name] = cls
    checked, faults = parameters(found.system, entry, cls)
    found.settings[entry.name], more = setting(found.system, entry, cls, checked)
    for where, said, fault in (*faults, *more):
        found.bad_params.add(entry.name)
        found.say(where, fault, said, of_key="no such parameter" in str(fault))


def _connection(found: Survey, entry: ConnectionEntry) -> None:
    # One option after the other first, so that each that is wrong is named and marked.
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
    if wrong:
        return
    try:
        found.profiles[entry.number] = connector_profile("", entry.options, "", entry.ports)
    except WiringError as error:
        found.say(key, WiringError(str(error).removeprefix(": ")), of_key=True)


def _needed(option: str, value: Any) -> dict[str, Any]:
    """What an option cannot be without, so that it can be looked at alone."""
    return {"push_rate": 1.0} if value == "periodic" and not option.endswith("push_rate") else {}


def _context(found: Survey, entry: ContextEntry) -> None:
    key: Key = ("contexts", entry.name)
    try:
        cls = context_type(found.system, entry.kind, found.catalogue)
    except (PluginError, SystemFileError) as error:
        found.say((*key, "kind"), error)
        return
    arguments = arguments_of(cls)
    options = dict(entry.options)
    wrong = False
    for word, value in entry.options.items():
        if word not in arguments:
            del options[word]
            near = get_close_matches(word[:100], [*arguments, "kind", "members", "activate"], n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"a {entry.kind} context takes {', '.join(arguments)}"
            found.say((*key, word), SystemFileError(f"unknown key {word[:80]!r}; {hint}"), of_key=True)
        elif what := unfit(value, arguments[word]):
            wrong = True
            found.say((*key, word), ConfigurationError(f"{word}: {what}"))
        else:
            try:
                cls(**{word: value})
            except (ConfigurationError, TypeError, ValueError) as error:
                wrong = True
                found.say((*key, word), ConfigurationError(str(error)))
    if needs_rate(cls) and "rate" not in entry.options:
        what = f"a {entry.kind} context needs its rate in Hz; write rate = 100.0"
        found.say(key, SystemFileError(what), of_key=True)
    if wrong:
        return
    try:
        found.contexts[entry.name] = cls(name=entry.name, **options)
    except (ConfigurationError, TypeError, ValueError) as error:
        found.say(key, ConfigurationError(str(error)), of_key=True)
