"""The forms of one profile in XML and in YAML: names, lists, types; one table for both directions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from aiorts_openrtm.markup.element import XMLNS, Attribute, Element

RTS: Final = "http://www.openrtp.org/namespaces/rts"
RTS_EXT: Final = "http://www.openrtp.org/namespaces/rts_ext"
XSI: Final = "http://www.w3.org/2001/XMLSchema-instance"
ROOT: Final = "RtsProfile"
EXT_MARK: Final = "rtsExt::"
"""The beginning of YAML keys that are not of the basic profile."""

LISTS: Final = frozenset(
    {
        *("Components", "Groups", "DataPortConnectors", "ServicePortConnectors", "Members", "Participants"),
        *("DataPorts", "ServicePorts", "ConfigurationSets", "ConfigurationData", "ExecutionContexts", "targets"),
        *("PrecedingComponents", "Properties", "VersionUpLog", "VersionUpLogs", "Systems"),
    }
)
"""Elements that are written as a list in YAML, even where there is only one."""
LOWER: Final = frozenset(
    {"targets", "sourceDataPort", "targetDataPort", "sourceServicePort", "targetServicePort"},
)
"""Elements whose name begins with a small letter."""
SEQUENCES: Final = ("StartUp", "ShutDown", "Activation", "Deactivation", "Resetting", "Initializing", "Finalizing")
"""The operations that sequences do to components in an order."""
_ORDER: Final = (
    *("TargetComponent", "WaitTime", "Preceding"),
    *("sourceDataPort", "targetDataPort", "sourceServicePort", "targetServicePort"),
    *("DataPorts", "ServicePorts", "ConfigurationSets", "ExecutionContexts", "Participants", "Location"),
    *("Components", "Groups", "DataPortConnectors", "ServicePortConnectors", *SEQUENCES),
    *("VersionUpLogs", "VersionUpLog", "Properties", "Systems"),
)
CONDITIONS: Final = ("WaitTime", "Preceding")
"""Elements that stand under `condition` in YAML, and directly in `targets` in XML."""
DATES: Final = frozenset({"creationDate", "updateDate"})
DATE_PARTS: Final = ("year", "month", "day", "hour", "minute", "second")
BOOLEANS: Final = frozenset({"isRequired", "visible"})
WHOLE: Final = frozenset({"sequence", "waitTime", "timeout", "x", "y", "width", "height"})
NUMBERS: Final = frozenset({"rate", "pushInterval"})

TYPES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "Components": "component_ext",
        "DataPorts": "dataport_ext",
        "ServicePorts": "serviceport_ext",
        "ExecutionContexts": "execution_context_ext",
        "DataPortConnectors": "dataport_connector_ext",
        "ServicePortConnectors": "serviceport_connector_ext",
        "sourceDataPort": "target_port_ext",
        "targetDataPort": "target_port_ext",
        "sourceServicePort": "target_port_ext",
        "targetServicePort": "target_port_ext",
        "targets": "condition_ext",
    }
)
"""The `xsi:type` of an element, as OpenRTM's tools write it."""
_NEVER: Final = "1970-01-01T00:00:00"
_SPACES: Final = (("rts", RTS), ("rtsExt", RTS_EXT), ("xsi", XSI))


def before(local: str) -> tuple[str, ...]:
    """The elements after which an element stands among its siblings, itself included."""
    return _ORDER[: _ORDER.index(local) + 1] if local in _ORDER else _ORDER


def in_order(elements: Iterable[Element]) -> tuple[Element, ...]:
    """Siblings in the order of the schema; unknown elements at the end."""
    return tuple(sorted(elements, key=lambda one: len(before(one.local))))


def made(local: str, *children: Element | str, ext: bool = False, where: str = "", **values: str | None) -> Element:
    """A new element of a profile; `ext_` before an attribute's name marks the extended profile.

    A value that is None is left out.
    """
    attributes = []
    if not ext and local in TYPES:
        attributes.append(Attribute("xsi:type", XSI, "type", f"rtsExt:{TYPES[local]}"))
    for key, value in values.items():
        if value is not None:
            attributes.append(attribute(key.removeprefix("ext_"), value, ext=ext or key.startswith("ext_")))
    prefix, space = ("rtsExt", RTS_EXT) if ext else ("rts", RTS)
    return Element(f"{prefix}:{local}", space, local, tuple(attributes), tuple(children), where)


def attribute(local: str, value: str, *, ext: bool = False) -> Attribute:
    """A new attribute of a profile."""
    return Attribute(f"{'rtsExt' if ext else 'rts'}:{local}", RTS_EXT if ext else RTS, local, value)


def made_root(*children: Element, where: str = "", **values: str) -> Element:
    """A new root of a profile."""
    root = made(ROOT, *children, where=where)
    root = replace(root, attributes=tuple(attribute(key, value) for key, value in values.items()))
    spaces = tuple(Attribute(f"xmlns:{prefix}", XMLNS, prefix, space) for prefix, space in _SPACES)
    return Element(root.name, root.space, root.local, (*spaces, *root.attributes), root.children, where)


def made_system(*children: Element, identity: str, abstract: str = "", date: str = _NEVER, where: str = "") -> Element:
    """A new root with the attributes that every profile has."""
    return made_root(
        *children, id=identity, abstract=abstract, creationDate=date, updateDate=date, version="0.2", where=where
    )


def made_component(
    name: str,
    identity: str,
    parts: Iterable[Element],
    *,
    path: str = "",
    active: str = "default",
    composite: str = "None",
    where: str = "",
) -> Element:
    """A new component of a profile, with the attributes that every component has."""
    return made(
        "Components",
        *parts,
        made("Location", ext=True, x="0", y="0", height="0", width="0", direction="down"),
        id=identity,
        pathUri=f"localhost/{path or f'{name}.rtc'}",
        activeConfigurationSet=active,
        instanceName=name,
        compositeType=composite,
        isRequired="true",
        ext_visible="true",
        where=where,
    )


def made_set(name: str, data: Mapping[str, tuple[str, str]], where: str) -> Element:
    """A new configuration set with these values, and the place of each."""
    values = (made("ConfigurationData", name=key, data=value, where=place) for key, (value, place) in data.items())
    return made("ConfigurationSets", *values, id=name, where=where)


def of_key(key: str) -> tuple[str, bool]:
    """The name of the element that a key of YAML stands for, and whether it is of the extended profile."""
    ext = key.startswith(EXT_MARK)
    word = key.removeprefix(EXT_MARK)
    if word in LOWER or not word:
        return word, ext
    return word[0].upper() + word[1:], ext


def key_of(local: str, *, ext: bool) -> str:
    """The key of YAML that an element or attribute has."""
    word = "versionUpLogs" if local == "VersionUpLog" else local[:1].lower() + local[1:]
    return f"{EXT_MARK if ext else ''}{word}"
