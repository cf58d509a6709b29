"""A design from a foreign file, which a plugin reads: `aiorts new NAME --from FILE`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from typing import Any, Final

from aiorts import Catalogue
from aiorts.cli.new.design import IMPORTED, Design, Parameter, Port, Service, attribute, pascal
from aiorts.description import ComponentDescription, ParameterDescription, PortDescription
from aiorts.errors import AiortsError, ConfigurationError, DeclarationError, PluginError
from aiorts.types import find_type, has_tm

_KIND: Final = "describers"
_OFFERED: Final = re.compile(r"[A-Za-z][\w-]*", re.ASCII)
_LABEL: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,99}")
_RATES: Final = (0.001, 10_000.0)
_USUAL: Final = 10.0
_LONGEST_DOC: Final = 1000


def read(path: Path, catalogue: Catalogue) -> ComponentDescription:
    """Read the description in a file with the plugin that offers to read files of its ending.

    Raises:
        PluginError: no plugin offers this, or the plugin cannot be loaded or returns something else.
        AiortsError: the file cannot be read, or is wrong.
    """
    ending = path.suffix.removeprefix(".").lower()
    offered = catalogue.extensions(_KIND)
    if ending not in offered:
        known = f"; there are {', '.join(f'.{one}' for one in offered)}" if offered else ""
        what = f"that end in .{ending}" if ending else "without an ending"
        raise PluginError(
            f"--from {path}: no plugin that is installed reads files {what}{known}; "
            "install one that offers this, as aiorts_openrtm does for RTC.xml"
        )
    found = catalogue.find(_KIND, ending).load()(path)
    if not isinstance(found, ComponentDescription):
        raise PluginError(f"--from {path}: its reader returned {type(found).__name__}, no ComponentDescription")
    return found


def design_of(found: ComponentDescription, name: str) -> tuple[Design, list[str]]:
    """Make the design of a described component, under a name; returns it with notes on all that is left out.

    Raises:
        ConfigurationError: the description has something that no component can have; the text says where.
    """
    notes = list(found.notes)
    used = {*IMPORTED, pascal(name), *(one.name for one in found.parameters)}
    ports = [_port(one, used, notes) for one in _told_apart(found.ports, notes)]
    used |= {one.type for _, one in ports}
    params = tuple(_parameter(one, notes) for one in found.parameters)
    used |= {one.name for one in params}
    services = []
    for one in found.services:
        own = _attribute(one.name, "service", used)
        label = _label(one.port or one.name, own, one.where, notes)
        interface = pascal(own)
        interface = f"{interface}Service" if interface in used else interface
        used.add(interface)
        role = "required" if one.required else "provided"
        services.append(Service(own, role, interface, label, _line(one.doc)))
    offered = found.name if _OFFERED.fullmatch(found.name) else ""
    if not offered:
        notes.append(f"{found.name!r:.80} is no name for a component here; it is found as {pascal(name)}")
    rate = found.rate or _USUAL
    if not _RATES[0] <= rate <= _RATES[1]:
        notes.append(f"a rate of {rate} Hz is none for a context here, which has 0.001 to 10000; it is {_USUAL}")
        rate = _USUAL
    made = Design(
        name,
        tuple(port for direction, port in ports if direction == "in"),
        tuple(port for direction, port in ports if direction == "out"),
        params,
        tuple(services),
        doc=_docstring(found.doc),
        offered=offered,
        rate=rate,
    )
    return made, notes


def _told_apart(ports: Sequence[PortDescription], notes: list[str]) -> Iterator[PortDescription]:
    """The ports; an out-port with the name of an in-port is renamed, since a component's ports need different names."""
    ins = {one.name for one in ports if one.direction == "in"}
    taken = {one.name for one in ports}
    for one in ports:
        if one.direction == "out" and one.name in ins:
            words = chain(("_out",), (f"_out{number}" for number in count(2)))
            name = next(other for word in words if (other := one.name + word) not in taken)
            taken.add(name)
            notes.append(f"{one.where}: there is an in-port {one.name!r:.80}, too; the out-port is {name!r:.90} here")
            yield replace(one, name=name)
        else:
            yield one


def _port(one: PortDescription, used: set[str], notes: list[str]) -> tuple[str, Port]:
    try:
        cls = find_type(one.type)
        has_tm(cls)  # raises where the type is no record
    except AiortsError as error:
        raise ConfigurationError(
            f"{one.where}: port {one.name}: {error}; a plugin (--plugins) can offer a record type of this name"
        ) from None
    name = _attribute(one.name, "port", {*used, one.type})
    return one.direction, Port(name, cls, _label(one.name, name, one.where, notes), _line(one.unit), _line(one.doc))


def _parameter(one: ParameterDescription, notes: list[str]) -> Parameter:
    try:
        name = attribute("parameter", one.name)
        if name in IMPORTED:
            raise ConfigurationError(f"parameter {name}: is the name of a class that is used; choose another")
        made = Parameter(name, one.default, _line(one.unit), _line(one.doc), one.constraint)
        try:
            made.declared()
        except DeclarationError as error:
            if not one.constraint:
                raise
            notes.append(f"{one.where}: {_cause(error)}; its constraint is left out")
            made = replace(made, constraint="")
            made.declared()
        if one.widget:
            shown = replace(made, widget=one.widget)
            try:
                shown.declared()
                made = shown
            except DeclarationError as error:
                notes.append(f"{one.where}: {_cause(error)}; it is left out")
    except AiortsError as error:
        raise ConfigurationError(f"{one.where}: {_cause(error)}") from None
    return made


def _attribute(label: str, fallback: str, used: set[str]) -> str:
    """A free name for an attribute, as near to the label as possible."""
    plain = re.sub(r"\W+", "_", label, flags=re.ASCII).strip("_") or fallback
    for own in (label, plain, f"{plain}_", f"{fallback}_{plain}"):
        try:
            found = attribute(fallback, own)
        except ConfigurationError:
            continue
        if found not in used:
            used.add(found)
            return found
    number = next(number for number in range(1, len(used) + 2) if f"{fallback}{number}" not in used)
    used.add(f"{fallback}{number}")
    return f"{fallback}{number}"


def _label(label: str, own: str, where: str, notes: list[str]) -> str:
    """The name of a port where it differs from its attribute's, else ""."""
    if _LABEL.fullmatch(label):
        return "" if label == own else label
    notes.append(f"{where}: a port cannot be called {label!r:.80} here; it is {own}")
    return ""


def _docstring(text: str) -> str:
    """The text on one line, escaped for a docstring."""
    return _line(text).replace("\\", "\\\\").replace('"', "'")


def _line(text: str) -> str:
    words = " ".join(text.split())
    return "".join(one for one in words if one.isprintable())[:_LONGEST_DOC].strip()


def _cause(error: Any) -> str:
    return " ".join(str(error).split()).removeprefix("Checked.")
