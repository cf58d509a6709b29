"""`RtcProfile`: the description of a component type that RTCBuilder keeps in `RTC.xml`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.markup.element import Element
from aiorts_openrtm.markup.source import decoded, read_bytes
from aiorts_openrtm.markup.xml_in import element_of_xml
from aiorts_openrtm.profiles.constraint_elements import constraint_text

RTC: Final = "http://www.openrtp.org/namespaces/rtc"
_DIRECTIONS: Final[dict[str, Literal["in", "out", "event"]]] = {
    "datainport": "in",
    "dataoutport": "out",
    "eventport": "event",
    "in": "in",
    "out": "out",
}


@dataclass(frozen=True, slots=True)
class RtcParameter:
    """A configuration parameter."""

    name: str
    type: str
    """The type as it is written: "double", "string", "std::vector<int>"."""
    default: str
    unit: str
    constraint: str
    """The constraint in the grammar of aiorts and OpenRTM; "" for none."""
    widget: str
    doc: str
    where: str


@dataclass(frozen=True, slots=True)
class RtcDataPort:
    """A data port."""

    name: str
    direction: Literal["in", "out", "event"]
    type: str
    """The type as it is written: "RTC::TimedPose3D"."""
    unit: str
    doc: str
    where: str

    @property
    def record(self) -> str:
        """The name of the record type: "TimedPose3D"."""
        return self.type.rpartition("::")[2]


@dataclass(frozen=True, slots=True)
class RtcInterface:
    """An interface of a service port."""

    name: str
    type: str
    provided: bool
    where: str


@dataclass(frozen=True, slots=True)
class RtcServicePort:
    """A service port."""

    name: str
    interfaces: tuple[RtcInterface, ...]
    where: str


@dataclass(frozen=True, slots=True)
class RtcProfile:
    """A component type as RTCBuilder describes it."""

    name: str
    vendor: str
    category: str
    version: str
    description: str
    kind: str
    """"DataFlowComponent", "FiniteStateMachineComponent", ..."""
    activity: str
    """"PERIODIC", "SPORADIC" or "EVENTDRIVEN"."""
    context: str
    """The kind of its execution context: "PeriodicExecutionContext", ..."""
    rate: float
    """The rate in Hz; 0 where none is stated."""
    most: int
    """The most instances; 0 is any number."""
    language: str
    hooks: tuple[str, ...]
    """The hooks that are implemented, as aiorts calls them: "on_execute"."""
    parameters: tuple[RtcParameter, ...]
    data_ports: tuple[RtcDataPort, ...]
    service_ports: tuple[RtcServicePort, ...]
    element: Element
    """The whole content of the file."""

    @property
    def id(self) -> str:
        """The id in a system's profile: "RTC:vendor:category:type:version"."""
        return f"RTC:{self.vendor}:{self.category}:{self.name}:{self.version}"

    @classmethod
    def read(cls, path: Path) -> RtcProfile:
        """Read a file.

        Raises:
            OpenRTMError: it cannot be read, or is no such profile; the message has the line.
        """
        return cls.of(element_of_xml(decoded(read_bytes(path), path), path))

    @classmethod
    def of(cls, root: Element) -> RtcProfile:
        """The profile that a tree holds; raises as `read` does."""
        if (root.space, root.local) != (RTC, "RtcProfile"):
            raise OpenRTMError(f"{root.where}: expected an RtcProfile of {RTC}, got {root.name!r:.80}")
        basic = next(_below(root, "BasicInfo"), None)
        if basic is None:
            raise OpenRTMError(f"{root.where}: BasicInfo is missing: it has the name of the component")
        rate = _number(basic, "executionRate")
        actions = [one for part in _below(root, "Actions") for one in part.elements()]
        configurations = [one for part in _below(root, "ConfigurationSet") for one in _below(part, "Configuration")]
        return cls(
            _needed(basic, "name"),
            basic.get(RTC, "vendor"),
            basic.get(RTC, "category"),
            basic.get(RTC, "version"),
            basic.get(RTC, "description"),
            basic.get(RTC, "componentKind"),
            basic.get(RTC, "activityType"),
            basic.get(RTC, "executionType"),
            rate,
            int(_number(basic, "maxInstances")),
            next((one.get(RTC, "kind") for one in _below(root, "Language")), ""),
            tuple(_hook(one.local) for one in actions if one.get(RTC, "implemented").lower() in ("true", "1")),
            tuple(_parameter(one) for one in configurations),
            tuple(_data_port(one) for one in _below(root, "DataPorts")),
            tuple(_service_port(one) for one in _below(root, "ServicePorts")),
            root,
        )


def _parameter(element: Element) -> RtcParameter:
    constraint = next(_below(element, "Constraint"), None)
    properties = {_any(one, "name"): _any(one, "value") for one in element.elements() if one.local == "Properties"}
    return RtcParameter(
        _needed(element, "name"),
        element.get(RTC, "type"),
        element.get(RTC, "defaultValue"),
        element.get(RTC, "unit"),
        "" if constraint is None else constraint_text(constraint),
        properties.get("__widget__", ""),
        _doc(element),
        element.where,
    )


def _data_port(element: Element) -> RtcDataPort:
    kind = _needed(element, "portType")
    if kind.lower() not in _DIRECTIONS:
        raise OpenRTMError(f"{element.where}: portType = {kind!r:.80}: expected DataInPort, DataOutPort or EventPort")
    return RtcDataPort(
        _needed(element, "name"),
        _DIRECTIONS[kind.lower()],
        element.get(RTC, "type"),
        element.get(RTC, "unit"),
        _doc(element),
        element.where,
    )


def _service_port(element: Element) -> RtcServicePort:
    interfaces = []
    for one in _below(element, "ServiceInterface"):
        direction = _needed(one, "direction")
        if direction.lower() not in ("provided", "required"):
            raise OpenRTMError(f"{one.where}: direction = {direction!r:.80}: expected Provided or Required")
        interfaces.append(
            RtcInterface(_needed(one, "name"), one.get(RTC, "type"), direction.lower() == "provided", one.where)
        )
    return RtcServicePort(_needed(element, "name"), tuple(interfaces), element.where)


def _below(element: Element, local: str) -> Iterator[Element]:
    return element.elements(RTC, local)


def _any(element: Element, local: str) -> str:
    return next((one.value for one in element.attributes if one.local == local), "")


def _doc(element: Element) -> str:
    return next((_any(one, "description") for one in element.elements() if one.local == "Doc"), "")


def _needed(element: Element, local: str) -> str:
    value = element.get(RTC, local)
    if not value:
        raise OpenRTMError(f"{element.where}: {element.local}: {local} is missing")
    return value


def _number(element: Element, local: str) -> float:
    text = element.get(RTC, local)
    try:
        number = float(text[:100] or 0)
    except ValueError:
        number = math.nan
    if not 0 <= number < math.inf:
        raise OpenRTMError(f"{element.where}: {local} = {text!r:.80}: expected a number from 0 on")
    return number


def _hook(action: str) -> str:
    """Turn "OnStateUpdate" into "on_state_update"."""
    return "".join(f"_{one.lower()}" if one.isupper() else one for one in action).lstrip("_")
