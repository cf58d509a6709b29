"""`Wanted` as a profile: an old one in which only differences are changed, or a new one."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final

from aiorts import StartRule
from aiorts.system import ComponentEntry, CompositeEntry, ConnectionEntry, ContextEntry, Wanted
from aiorts_openrtm.mapping.component_elements import change_component, change_contexts, new_component, with_property
from aiorts_openrtm.mapping.connections import attributes_of, properties_of, spellings
from aiorts_openrtm.mapping.extras import MARK
from aiorts_openrtm.mapping.importing import Imported, imported
from aiorts_openrtm.mapping.sequences import chosen_sequence, is_sayable, sequence_of
from aiorts_openrtm.mapping.types import Types, word_of
from aiorts_openrtm.markup.element import Element
from aiorts_openrtm.markup.shapes import before, made
from aiorts_openrtm.notes import Note
from aiorts_openrtm.profiles.rts_profile import RtsProfile

_SPACE: Final = uuid.UUID("6f1d5a2e-4b0c-5a53-9b0e-0d1f5c1b7a11")
"""The name space in which ids of connectors are made of their ports: the same system has the same ids."""
_CONNECTORS: Final = ("DataPortConnectors", "ServicePortConnectors")


@dataclass(frozen=True, slots=True)
class Ports:
    """The ports of components, as far as they are known."""

    data: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """The data ports of each component, with the names of their record types."""
    services: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """The service ports of each component."""

    def is_service(self, path: str) -> bool:
        """Whether a path names a service port."""
        component, _, port = path.partition(".")
        return port in self.services.get(component, ())

    def record(self, path: str) -> str:
        """The record type of a data port; "" where it is not known."""
        component, _, port = path.partition(".")
        return self.data.get(component, {}).get(port, "")


def exported(
    profile: RtsProfile, wanted: Wanted, types: Types, ports: Callable[[], Ports], notes: list[Note]
) -> RtsProfile:
    """The profile of a wanted system.

    Args:
        profile: an old profile, in which all that does not differ stays; or an empty profile.
        ports: called when ports have to be known, since something is new.
        notes: gets a note on each thing that a profile cannot state.
    """
    return _Exporter(profile, wanted, types, ports, notes).whole()


class _Exporter:
    """Makes the changes to one profile."""

    def __init__(
        self, profile: RtsProfile, wanted: Wanted, types: Types, ports: Callable[[], Ports], notes: list[Note]
    ) -> None:
        self._old: Imported = imported(profile, types)
        self._profile = profile
        self._given = profile.element
        self._types = types
        self._wanted = wanted
        self._find_ports = ports
        self._notes = notes
        self._theirs = {ours: theirs for theirs, ours in self._old.names.items()}
        """The name of each component in the profile, by its name here."""
        self._ids: dict[str, str] = {}
        """The id of each component of the changed profile, by its name there."""
        self._removed: Set[str] = set()
        self._unknown: list[str] = []
        """New connections of ports that are not known."""

    def whole(self) -> RtsProfile:
        """The changed profile."""
        self._note_what_cannot_be_said()
        changed = RtsProfile.of(self._components(self._profile.element))
        self._profile = changed
        self._removed = self._old.names.keys() - {one.name for one in changed.components}
        self._ids = {one.name: one.id for one in changed.components}
        root = self._connections(changed.element)
        root = self._order(root)
        if self._unknown:
            more = f" and {len(self._unknown) - 1} more" if len(self._unknown) > 1 else ""
            what = "the ports are not known: written as data ports of IDL:RTC/Unknown:1.0"
            self._notes.append(Note(f"{self._unknown[0]}{more}", what))
        made = RtsProfile.of(root)
        return made if root is self._given else self._with_order_of_contexts(made)

    def _with_order_of_contexts(self, made: RtsProfile) -> RtsProfile:
        """The profile with the order in which contexts start, if it differs from the order of their owners."""
        root = with_property(made.element, f"{MARK}contexts", None)
        made = made if root is made.element else RtsProfile.of(root)
        found = list(imported(made, self._types).wanted.contexts)
        order = [name for name in self._wanted.contexts if name in found]
        return made if order == found else RtsProfile.of(with_property(root, f"{MARK}contexts", order))

    @cached_property
    def _ports(self) -> Ports:
        return self._find_ports()

    def _note_what_cannot_be_said(self) -> None:
        wanted = self._wanted
        for name in wanted.services:
            if name != "openrtm":
                self._notes.append(Note(name, f"the table [{name}] has no place in a profile"))
        if wanted.clock.kind != "system":
            self._notes.append(Note("clock", "the table [clock] has no place in a profile"))

    # -- components and contexts -----------------------------------------------------------------------------------

    def _components(self, root: Element) -> Element:
        wanted, old = self._wanted, self._old.wanted
        kept: set[str] = set()
        contexts = self._by_owner(wanted.contexts)
        contexts_before = self._by_owner(old.contexts)

        def change(child: Element) -> Element | None:
            if child.local != "Components":
                return child
            name = self._old.names[_name(child)]
            entry, there = _entry(wanted, name), _entry(old, name)
            if entry is None or type(entry) is not type(there):
                return None
            kept.add(name)
            child = _changed(child, there, entry)
            if contexts.get(name, []) != contexts_before.get(name, []):
                child = change_contexts(child, self._with_names(contexts.get(name, [])))
            return child

        root = root.edited(change)
        added = []
        for name in (*wanted.components, *wanted.composites):
            if name not in kept:
                entry = wanted.components.get(name) or wanted.composites[name]
                ports = self._ports
                element = new_component(entry, ports.data.get(name, {}), ports.services.get(name, ()))
                added.append((before("Components"), change_contexts(element, self._with_names(contexts.get(name, [])))))
                self._theirs[name] = name
        return root.edited(added=added)

    def _by_owner(self, contexts: Mapping[str, ContextEntry]) -> dict[str, list[ContextEntry]]:
        """The contexts by the component that has them in a profile: the first of their members."""
        found: dict[str, list[ContextEntry]] = {}
        for entry in contexts.values():
            if not entry.members:
                self._notes.append(Note(entry.name, "a context without members has no place in a profile"))
                continue
            place = self._old.contexts.get(entry.name)
            owner = entry.members[0] if place is None else self._old.names[place[0]]
            found.setdefault(owner if owner in entry.members else entry.members[0], []).append(entry)
        return found

    def _with_names(self, contexts: Sequence[ContextEntry]) -> list[ContextEntry]:
        """The contexts with the names of members in the profile."""
        return [
            replace(one, members=tuple(self._theirs.get(member, member) for member in one.members)) for one in contexts
        ]

    # -- connections -----------------------------------------------------------------------------------------------

    def _connections(self, root: Element) -> Element:
        left: dict[tuple[str, ...], list[ConnectionEntry]] = {}
        pairs = list(self._pairs())
        for pair in pairs:
            left.setdefault(pair.ports, []).append(pair)
        keep: dict[int, tuple[ConnectionEntry, ConnectionEntry]] = {}
        for with_options in (True, False):
            for place, entry in self._old.connections:
                several = left.get(entry.ports, []) if place not in keep else []
                same = [one for one in several if not with_options or one.options == entry.options]
                if same:
                    several.remove(same[0])
                    keep[place] = entry, same[0]
        lost = {place for place, _ in self._old.connections} - keep.keys()
        places = iter(range(len(self._profile.connectors)))

        def change(child: Element) -> Element | None:
            if child.local not in _CONNECTORS:
                return child
            place = next(places)
            if place in lost:
                return None
            if place in keep:
                old, new = keep[place]
                return child if old.options == new.options else _with_options(child, old.options, new.options)
            ends = [next(child.elements(child.space, end), None) for end in _ends(child.local)]
            gone = [end for end in ends if end is not None and _name(end) in self._removed]
            return None if gone else child

        root = root.edited(change)
        new = {id(one) for several in left.values() for one in several}
        added = [self._connector(one) for one in pairs if id(one) in new]
        return root.edited(added=[(before(one.local), one) for one in added])

    def _pairs(self) -> Iterator[ConnectionEntry]:
        """The connections, each of two ports."""
        for entry in self._wanted.connections:
            source, *targets = entry.ports
            for number, target in enumerate(targets):
                options = {key: value for key, value in entry.options.items() if key != "name" or not number}
                yield ConnectionEntry((source, target), MappingProxyType(options), entry.number)

    def _connector(self, entry: ConnectionEntry) -> Element:
        source, target = entry.ports
        service = self._ports.is_service(source) or self._ports.is_service(target)
        local = _CONNECTORS[service]
        ends = []
        for end, path in zip(_ends(local), entry.ports, strict=True):
            ours, _, port = path.partition(".")
            theirs = self._theirs.get(ours, ours)
            ends.append(
                made(end, componentId=self._ids.get(theirs, ""), instanceName=theirs, portName=f"{theirs}.{port}")
            )
        record = self._ports.record(source) or self._ports.record(target)
        if not service and not record:
            self._unknown.append(f"{source} -> {target}")
        new = made(
            local,
            *ends,
            connectorId=str(uuid.uuid5(_SPACE, f"{source}>{target}>{entry.number}")),
            name=str(entry.options.get("name") or f"{source.replace('.', '_')}_{target.replace('.', '_')}"),
            dataType=None if service else f"IDL:RTC/{record or 'Unknown'}:1.0",
            interfaceType=None if service else "corba_cdr",
        )
        return _with_options(new, {}, entry.options, is_new=True)

    # -- order -----------------------------------------------------------------------------------------------------

    def _order(self, root: Element) -> Element:
        rules = {name: one.start for name, one in self._wanted.components.items() if one.start is not None}
        old = {name: one.start for name, one in self._old.wanted.components.items() if one.start is not None}
        if rules == old:
            return root
        word = chosen_sequence(self._profile.sequences) or "Activation"
        components = {self._ours(one.name): one for one in self._profile.components}
        there = next((one for one in root.elements() if one.local == word), None)
        new = sequence_of(word, _in_order(rules), components, there) if rules else None
        if there is not None:
            root = root.edited(lambda child: new if child is there else child)
        elif new is not None:
            root = root.edited(added=[(before(word), new)])

        def change(child: Element) -> Element:
            if child.local != "Components":
                return child
            rule = rules.get(self._ours(_name(child)))
            value = None if rule is None or is_sayable(rule) else _said(rule)
            return with_property(child, f"{MARK}start", value)

        return root.edited(change)

    def _ours(self, theirs: str) -> str:
        return self._old.names.get(theirs, theirs)


def _entry(wanted: Wanted, name: str) -> ComponentEntry | CompositeEntry | None:
    return wanted.components.get(name) or wanted.composites.get(name)


def _changed(child: Element, old: Any, entry: ComponentEntry | CompositeEntry) -> Element:
    """A component with all differences changed, except rules of starting; types are compared by their class name."""
    if isinstance(entry, ComponentEntry) and isinstance(old, ComponentEntry):
        same_type = word_of(old.type) == word_of(entry.type)
        old = replace(old, start=None, type=entry.type if same_type else old.type)
        entry = replace(entry, start=None)
    return child if old == entry else change_component(child, old, entry)


def _with_options(element: Element, old: Mapping[str, Any], new: Mapping[str, Any], *, is_new: bool = False) -> Element:
    """A connector with other options; properties of options that do not differ stay."""
    differ = [key for key in {**old, **new} if old.get(key) != new.get(key) or is_new]
    gone = {word for key in differ for word in spellings(key)}
    places = [one for one in element.elements() if one.local == "Properties"]

    def change(child: Element) -> Element | None:
        return None if child in places and child.get(child.space, "name") in gone else child

    element = element.edited(change)
    said = properties_of({key: new[key] for key in differ if key in new})
    if element.local == "DataPortConnectors":
        usual = {"dataflow": "push", "subscription": "flush"}
        again = {key: value for key, value in usual.items() if is_new or (key in differ and key not in new)}
        said = {**properties_of(again), **said}
        for key, value in attributes_of(new).items():
            if value is not None or element.has(element.space, key):
                element = element.with_attribute(f"rts:{key}", element.space, value)
    if not is_new and new.get("name") and "name" in differ:
        element = element.with_attribute("rts:name", element.space, str(new["name"]))
    if is_new and element.local == "DataPortConnectors":
        data_type = element.get(element.space, "dataType")
        said = {**said, "dataport.interface_type": "corba_cdr", "dataport.data_type": data_type}
    added = [made("Properties", ext=True, name=key, value=value) for key, value in said.items()]
    return element.edited(added=[(before("Properties"), one) for one in added])


def _ends(local: str) -> tuple[str, str]:
    kind = "Data" if local == "DataPortConnectors" else "Service"
    return f"source{kind}Port", f"target{kind}Port"


def _name(element: Element) -> str:
    return element.get(element.space, "instanceName") or element.get("", "instanceName")


def _said(rule: StartRule) -> dict[str, Any]:
    return {"after": list(rule.after), "wait": rule.wait, "timeout": rule.timeout}


def _in_order(rules: Mapping[str, StartRule]) -> list[StartRule]:
    """The rules, each after the rules of components that it waits for."""
    left = dict(rules)
    found: list[StartRule] = []
    while left:
        free = [name for name, one in left.items() if not any(c.component in left for c in one.conditions)]
        found += [left.pop(name) for name in free or list(left)]
    return found
