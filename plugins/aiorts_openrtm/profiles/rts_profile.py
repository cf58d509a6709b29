"""`RtsProfile`: a whole OpenRTM system, read from the tree of its XML or YAML, which it keeps whole."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.markup.element import Element
from aiorts_openrtm.markup.shapes import ROOT, RTS, RTS_EXT, SEQUENCES

COMPOSITES: Final = ("PeriodicECShared", "PeriodicStateShared", "Grouping", "FsmECShared", "FsmStateShared")
MOST: Final = 10_000
"""The most components of a profile."""
_LONGEST: Final = 200


@dataclass(frozen=True, slots=True)
class ConfigurationSet:
    """A named set of parameters; a set whose name begins with "__" is about parameters, such as their types."""

    name: str
    values: Mapping[str, str]
    places: Mapping[str, str]
    """FILE:LINE of each value."""


@dataclass(frozen=True, slots=True)
class RtsContext:
    """An execution context that a component owns."""

    id: str
    kind: str
    rate: float
    """The rate in Hz; 0 where none is stated."""
    participants: tuple[str, ...]
    """The names of other components that take part."""
    properties: Mapping[str, str]
    where: str


@dataclass(frozen=True, slots=True)
class RtsComponent:
    """One component of a system."""

    name: str
    """The component's instance name."""
    id: str
    """"RTC:vendor:category:type:version"."""
    path: str
    """The component's path in name servers."""
    composite: str
    """"None", or the kind of the composite."""
    active: str
    """The active configuration set."""
    required: bool
    data_ports: tuple[str, ...]
    service_ports: tuple[str, ...]
    sets: tuple[ConfigurationSet, ...]
    contexts: tuple[RtsContext, ...]
    members: tuple[str, ...]
    """The instance names of a composite's members."""
    properties: Mapping[str, str]
    where: str

    @property
    def id_parts(self) -> tuple[str, str, str, str]:
        """Vendor, category, type and version; "" for a part that is not stated."""
        parts = self.id.removeprefix("RTC:").split(":")
        if len(parts) in (1, 2):  # as old tools write it: "RTC:vendor.category.type:version"
            dotted = parts[0].rsplit(".", 2)
            parts = [*[""] * (3 - len(dotted)), *dotted, *(parts[1:] or [""])]
        return parts[0], parts[1], parts[2], parts[-1] if len(parts) > 3 else ""

    def named_set(self, name: str) -> ConfigurationSet | None:
        """The set of this name."""
        return next((one for one in self.sets if one.name == name), None)


@dataclass(frozen=True, slots=True)
class RtsConnector:
    """One connection of two ports."""

    id: str
    name: str
    source: tuple[str, str]
    """The component and the port of the first end."""
    target: tuple[str, str]
    is_data: bool
    values: Mapping[str, str]
    """dataType, interfaceType, dataflowType, subscriptionType and pushInterval of data ports, transMethod of others."""
    properties: Mapping[str, str]
    where: str


@dataclass(frozen=True, slots=True)
class RtsTarget:
    """One step of a sequence."""

    sequence: int
    component: str
    context: str
    """The id of the execution context."""
    wait: float
    """Seconds."""
    preceding: tuple[str, ...]
    timing: str
    """"SYNC" or "ASYNC"; "" where neither is stated."""
    timeout: float
    """Seconds; 0 where none is stated."""
    where: str


@dataclass(frozen=True, slots=True)
class RtsProfile:
    """A whole system as OpenRTM's tools save it."""

    id: str
    abstract: str
    version: str
    components: tuple[RtsComponent, ...]
    connectors: tuple[RtsConnector, ...]
    """The connectors, in the order of the file."""
    sequences: Mapping[str, tuple[RtsTarget, ...]]
    """The sequences of the profile, by their names: "StartUp", "Activation", ..."""
    groups: tuple[str, ...]
    properties: Mapping[str, str]
    element: Element
    """The whole content of the file."""

    @classmethod
    def of(cls, root: Element) -> RtsProfile:
        """The profile that a tree holds.

        Raises:
            OpenRTMError: the tree is no profile, or a value is impossible; the message has the line.
        """
        if (root.space, root.local) not in ((RTS, ROOT), ("", ROOT)):
            raise OpenRTMError(f"{root.where}: expected an RtsProfile of {RTS}, got {root.name!r:.80}")
        parts = list(_below(root, "Components"))
        if len(parts) > MOST:
            raise OpenRTMError(f"{parts[MOST].where}: more than {MOST} components have no place in a profile")
        components = tuple(_component(one) for one in parts)
        seen: dict[str, str] = {}
        for one in components:
            if one.name in seen:
                raise OpenRTMError(
                    f"{one.where}: a second component {one.name!r:.80}; the first is at {seen[one.name]}"
                )
            seen[one.name] = one.where
        return cls(
            _value(root, "id"),
            _value(root, "abstract"),
            _value(root, "version"),
            components,
            tuple(
                _connector(one)
                for one in root.elements()
                if one.local in ("DataPortConnectors", "ServicePortConnectors") and one.space in (RTS, "")
            ),
            MappingProxyType({one.local: tuple(_targets(one)) for one in root.elements() if one.local in SEQUENCES}),
            tuple(_value(one, "groupId") or _value(one, "groupID") for one in _below(root, "Groups")),
            _properties(root),
            root,
        )


def _component(element: Element) -> RtsComponent:
    sets = tuple(_set(one) for one in _below(element, "ConfigurationSets"))
    members = [_target(part) for one in _below(element, "Participants") for part in _below(one, "Participant")]
    return RtsComponent(
        _needed(element, "instanceName"),
        _value(element, "id"),
        _value(element, "pathUri"),
        _value(element, "compositeType") or "None",
        _value(element, "activeConfigurationSet"),
        _value(element, "isRequired").lower() in ("true", "1"),
        tuple(_needed(one, "name") for one in _below(element, "DataPorts")),
        tuple(_needed(one, "name") for one in _below(element, "ServicePorts")),
        sets,
        tuple(_context(one) for one in _below(element, "ExecutionContexts")),
        tuple(members),
        _properties(element),
        element.where,
    )


def _set(element: Element) -> ConfigurationSet:
    data = {_needed(one, "name"): one for one in _below(element, "ConfigurationData")}
    return ConfigurationSet(
        _needed(element, "id"),
        MappingProxyType({name: _value(one, "data") for name, one in data.items()}),
        MappingProxyType({name: one.where for name, one in data.items()}),
    )


def _context(element: Element) -> RtsContext:
    participants = tuple(_target(one) for one in _below(element, "Participants"))
    rate = _number(element, "rate", 0.0)
    return RtsContext(
        _value(element, "id"), _value(element, "kind"), rate, participants, _properties(element), element.where
    )


def _connector(element: Element) -> RtsConnector:
    is_data = element.local == "DataPortConnectors"
    kind = "Data" if is_data else "Service"
    ends = []
    for side in ("source", "target"):
        found = list(_below(element, f"{side}{kind}Port"))
        if len(found) != 1:
            raise OpenRTMError(f"{element.where}: {element.local}: expected one {side}{kind}Port, got {len(found)}")
        component = _target(found[0])
        ends.append((component, _needed(found[0], "portName").removeprefix(f"{component}.")))
    words = ("dataType", "interfaceType", "dataflowType", "subscriptionType", "pushInterval", "transMethod")
    if _value(element, "pushInterval"):
        _number(element, "pushInterval", 0.0)
    return RtsConnector(
        _value(element, "connectorId"),
        _value(element, "name"),
        ends[0],
        ends[1],
        is_data,
        MappingProxyType({word: value for word in words if (value := _value(element, word))}),
        _properties(element),
        element.where,
    )


def _targets(element: Element) -> Iterator[RtsTarget]:
    for one in _below(element, "targets"):
        component = next(_below(one, "TargetComponent"), None)
        if component is None:
            raise OpenRTMError(f"{one.where}: targets of {element.local}: expected a TargetComponent")
        wait = next(_below(one, "WaitTime"), None)
        preceding = next(_below(one, "Preceding"), None)
        before = () if preceding is None else tuple(map(_target, _below(preceding, "PrecedingComponents")))
        yield RtsTarget(
            int(_number(one, "sequence", 0.0)),
            _target(component),
            _value(component, "id"),
            0.0 if wait is None else _number(wait, "waitTime", 0.0) / 1000,
            before,
            "" if preceding is None else _value(preceding, "sendingTiming").upper(),
            0.0 if preceding is None else _number(preceding, "timeout", 0.0) / 1000,
            one.where,
        )


def _below(element: Element, local: str) -> Iterator[Element]:
    return (one for one in element.elements() if one.local == local and one.space in (RTS, ""))


def _value(element: Element, local: str) -> str:
    return element.get(RTS, local) or element.get("", local)


def _needed(element: Element, local: str) -> str:
    value = _value(element, local)
    if not value:
        raise OpenRTMError(f"{element.where}: {element.local}: {local} is missing")
    return value


def _target(element: Element) -> str:
    return _needed(element, "instanceName")


def _number(element: Element, local: str, default: float) -> float:
    text = _value(element, local).strip()
    try:
        number = float(text[:_LONGEST]) if text else default
    except ValueError:
        number = math.nan
    if not 0 <= number < math.inf:
        raise OpenRTMError(f"{element.where}: {element.local}: {local} = {text!r:.80}: expected a number from 0 on")
    return number


def _properties(element: Element) -> Mapping[str, str]:
    found = {}
    for one in element.elements():
        if one.local == "Properties" and one.space in (RTS_EXT, RTS, ""):
            name = one.get(one.space, "name") or one.get("", "name")
            found[name] = one.get(one.space, "value") or one.get("", "value")
    return MappingProxyType(found)
