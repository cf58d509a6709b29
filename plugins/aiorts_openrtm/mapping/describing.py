"""Reads the description that `aiorts new --from RTC.xml` makes a component of."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from aiorts.description import ComponentDescription, ParameterDescription, PortDescription, ServiceDescription
from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.mapping.context_kinds import kind_of
from aiorts_openrtm.mapping.values import kind_of_word, typed
from aiorts_openrtm.profiles.rtc_profile import RtcParameter, RtcProfile, RtcServicePort

_VECTOR: Final = re.compile(r"(?:std::)?vector<\s*([\w: ]+?)\s*>")


def description(path: Path) -> ComponentDescription:
    """The component type that an `RTC.xml` describes.

    Raises:
        OpenRTMError: it cannot be read, or describes what no component can have; the message has the line.
        MissingExtra: the reader of XML is not installed.
    """
    profile = RtcProfile.read(path)
    notes: list[str] = []
    parameters = tuple(_parameter(one, notes) for one in profile.parameters)
    found = ComponentDescription(
        profile.name,
        profile.description,
        tuple(
            PortDescription(one.name, direction, one.record, one.unit, one.doc, one.where)
            for one in profile.data_ports
            if (direction := one.direction) != "event"
        ),
        parameters,
        tuple(service for port in profile.service_ports for service in _services(port)),
        profile.rate,
        (*notes, *_notes(profile)),
    )
    _check_distinct(found)
    return found


def _check_distinct(found: ComponentDescription) -> None:
    """Raise OpenRTMError, with both lines, for two parameters, ports of one direction, or services of one name."""
    lines: dict[tuple[str, str], str] = {}
    for sort, name, where in (
        *((one.direction, one.name, one.where) for one in found.ports),
        *(("parameter", one.name, one.where) for one in found.parameters),
        *(("service", f"{one.port}.{one.name}", one.where) for one in found.services),
    ):
        if (sort, name) in lines:
            raise OpenRTMError(
                f"{where}: {name.rpartition('.')[2]}: is given twice (first in line {lines[sort, name]})"
            )
        lines[sort, name] = where.rpartition(":")[2]


def _parameter(one: RtcParameter, notes: list[str]) -> ParameterDescription:
    value = _value(one, notes)
    return ParameterDescription(one.name, value, one.unit, one.doc, one.constraint, one.widget, one.where)


def _value(one: RtcParameter, notes: list[str]) -> Any:
    """The default as a value of the parameter's type; for an unknown type its text, as OpenRTM has it."""
    if (vector := _VECTOR.fullmatch(one.type.strip())) and one.default.strip():
        return tuple(_plain(one, vector[1], part, notes) for part in one.default.split(","))
    return _plain(one, one.type, one.default, notes)


def _plain(one: RtcParameter, kind: str, text: str, notes: list[str]) -> Any:
    here = kind_of_word(kind)
    value = typed(text, kind)
    if here is None or not isinstance(value, str):
        return value
    if text.strip():
        notes.append(f"{one.where}: {one.name}: default {text.strip()!r:.80} is no {kind}; it is {here()} here")
    return here()


def _services(port: RtcServicePort) -> Iterator[ServiceDescription]:
    for one in port.interfaces:
        name, doc = port.name if len(port.interfaces) == 1 else one.name, one.type
        yield ServiceDescription(name, not one.provided, port.name, doc, one.where)


def _notes(profile: RtcProfile) -> Iterator[str]:
    for port in profile.data_ports:
        if port.direction == "event":
            yield f"{port.where}: event port {port.name!r}: a component with a state chart has it; write it by hand"
    for service in profile.service_ports:
        if service.interfaces:
            yield f"{service.where}: service port {service.name!r}: its methods are in IDL; write them by hand"
        else:
            yield f"{service.where}: service port {service.name!r} has no interface; left out"
    if profile.context and kind_of(profile.context) != "periodic":
        where = profile.element.where
        yield f"{where}: executionType {profile.context!r:.60}: the new system's context is periodic"
