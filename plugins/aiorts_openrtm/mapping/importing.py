"""Makes `Wanted` of a profile. Content that a system file has no words for stays in the profile, and is noted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from aiorts import StartRule, Supervision
from aiorts.errors import AiortsError, ConfigurationError
from aiorts.system import ComponentEntry, CompositeEntry, ConnectionEntry, ContextEntry, Wanted, with_option
from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.mapping.connections import options_of
from aiorts_openrtm.mapping.context_kinds import kind_of
from aiorts_openrtm.mapping.extras import extra, frozen
from aiorts_openrtm.mapping.names import is_name, named
from aiorts_openrtm.mapping.sequences import rules_of
from aiorts_openrtm.mapping.types import Types
from aiorts_openrtm.mapping.values import against, typed
from aiorts_openrtm.notes import Note
from aiorts_openrtm.profiles.rts_profile import COMPOSITES, ConfigurationSet, RtsComponent, RtsContext, RtsProfile

DEFAULT: Final = "default"
_USUAL_RATE: Final = 1000.0
"""OpenRTM's rate in Hz where none is stated."""
_FASTEST: Final = 10_000.0
_ABOUT: Final = ("__widget__", "__constraints__", "__type__")
_OF_COMPOSITES: Final = ("members", "exported_ports")


@dataclass(frozen=True)
class Imported:
    """A profile as a system, and the place in the profile of each thing."""

    wanted: Wanted
    names: Mapping[str, str]
    """The name here of each component and composite, by its name in the profile."""
    contexts: Mapping[str, tuple[str, int]]
    """The component in the profile that owns each context, and the context's number there, by the context's name."""
    connections: tuple[tuple[int, ConnectionEntry], ...]
    """Each connection with the number of its connector in the profile."""
    notes: list[Note] = field(default_factory=list)


def imported(profile: RtsProfile, types: Types, files: Mapping[str, list[Path]] = MappingProxyType({})) -> Imported:
    """The system that a profile describes.

    Args:
        files: the files in which the class of a type may stand, by the type's name.
    """
    return _Importer(profile, types, files).whole()


class _Importer:
    """Makes one system of one profile."""

    def __init__(self, profile: RtsProfile, types: Types, files: Mapping[str, list[Path]]) -> None:
        self._profile = profile
        self._types = types
        self._files = files
        self._notes: list[Note] = []
        self._names: dict[str, str] = {}
        self._said: set[str] = set()
        """The notes that were given on types; each is given once, at the first component of the type."""
        taken: set[str] = set()
        for one in profile.components:
            name = self._names[one.name] = named(one.name, taken)
            taken.add(name)
            if name != one.name:
                self._notes.append(Note(one.where, f"the component {one.name!r:.80} is {name!r} here"))
        self._composites = {one.name: one for one in profile.components if self._is_composite(one)}
        self._members = {member: one.name for one in self._composites.values() for member in self._members_of(one)}

    def whole(self) -> Imported:
        """The whole system that the profile describes."""
        profile = self._profile
        rules = self._rules()
        single = [one for one in profile.components if one.name not in self._composites]
        components = {self._names[one.name]: self._component(one, rules) for one in single}
        composites = {entry.name: entry for one in self._composites.values() if (entry := self._composite(one)).members}
        contexts, places = self._contexts()
        order = extra(profile.properties, "contexts", list, profile.element.where, self._notes) or []
        contexts = {name: contexts[name] for name in dict.fromkeys([*map(str, order), *contexts]) if name in contexts}
        connections = self._connections({**components, **composites})
        for group in profile.groups:
            self._notes.append(Note(profile.element.where, f"the group {group!r:.60} of tools stays in the profile"))
        wanted = Wanted(
            components=MappingProxyType(components),
            connections=tuple(entry for _, entry in connections),
            contexts=MappingProxyType(contexts),
            composites=MappingProxyType(composites),
        )
        return Imported(wanted, MappingProxyType(self._names), MappingProxyType(places), connections, self._notes)

    # -- components ------------------------------------------------------------------------------------------------

    def _component(self, one: RtsComponent, rules: Mapping[str, StartRule]) -> ComponentEntry:
        name = self._names[one.name]
        if not one.required:
            self._notes.append(Note(one.where, f"{name}: is not required there; a system file makes all that it names"))
        params, sets = self._sets(one)
        active = one.active if one.active not in ("", DEFAULT) else ""
        if active and active not in sets:
            what = f"no configuration set {active!r:.60} stands here, which is to be active; its class has to have it"
            self._notes.append(Note(one.where, f"{name}: {what}"))
        supervision = extra(one.properties, "supervision", dict, one.where, self._notes)
        options = extra(one.properties, "options", list, one.where, self._notes) or []
        return ComponentEntry(
            name,
            self._type(one),
            MappingProxyType(params),
            tuple(map(str, options)),
            MappingProxyType(sets),
            active,
            None if supervision is None else self._made(Supervision, supervision, one.where),
            rules.get(name),
        )

    def _made(self, kind: Any, given: Mapping[str, Any], where: str) -> Any:
        try:
            return kind(**frozen(given))
        except (AiortsError, TypeError) as error:
            self._notes.append(Note(where, f"{kind.__name__}: {error}; it is left out"))
            return None

    def _type(self, one: RtsComponent) -> str:
        stated = extra(one.properties, "type", str, one.where, self._notes)
        if stated is not None:
            if found := self._types.stated(stated):
                return found
            what = f"the type {stated!r:.80} is not below a folder that may be named (--module-path)"
            self._notes.append(Note(one.where, f"{self._names[one.name]}: {what}"))
        kind = one.id_parts[2] or one.name.rstrip("0123456789")
        text, note = self._types.find(kind, self._files.get(kind, ()))
        if note and note not in self._said:
            self._said.add(note)
            self._notes.append(Note(one.where, f"{self._names[one.name]}: {note}"))
        return text

    def _sets(self, one: RtsComponent) -> tuple[dict[str, Any], dict[str, Mapping[str, Any]]]:
        kinds = one.named_set("__type__")
        constraints = one.named_set("__constraints__") or one.named_set("__constraint__")
        others = extra(one.properties, "values", dict, one.where, self._notes) or {}
        params: dict[str, Any] = {}
        sets: dict[str, Mapping[str, Any]] = {}
        for values in one.sets:
            if values.name.startswith("_"):
                if values.name not in (*_ABOUT, "__constraint__"):
                    self._notes.append(Note(one.where, f"{one.name}: the set {values.name!r:.60} stays in the profile"))
                continue
            found = {}
            for key, text in values.values.items():
                where = values.places[key]
                if not key.isidentifier():
                    self._notes.append(Note(where, f"{one.name}: {key!r:.80} can be no parameter, and is left out"))
                    continue
                found[key] = typed(text, "" if kinds is None else kinds.values.get(key, ""))
                if constraints is not None and (rule := constraints.values.get(key)):
                    self._check(found[key], rule, where, f"{one.name}.{key}")
            stated = others.get(values.name)
            found.update({key: frozen(stated[key]) for key in found if isinstance(stated, dict) and key in stated})
            if values.name == DEFAULT:
                params = found
            elif is_name(values.name):
                sets[values.name] = MappingProxyType(found)
            else:
                self._notes.append(Note(one.where, f"{one.name}: no set can be called {values.name!r:.60}"))
        return params, sets

    def _check(self, value: Any, constraint: str, where: str, name: str) -> None:
        what = against(value, constraint)
        if what:
            self._notes.append(
                Note(where, f"{name} = {value!r:.60} and its constraint {constraint!r:.60}: {what:.200}")
            )

    # -- composites ------------------------------------------------------------------------------------------------

    def _is_composite(self, one: RtsComponent) -> bool:
        if one.composite in ("None", ""):
            return False
        if one.composite not in COMPOSITES:
            raise OpenRTMError(
                f"{one.where}: compositeType = {one.composite!r:.60}: expected None, {', '.join(COMPOSITES)}"
            )
        # Old tools write compositeType at the members, too, although members have no members of their own.
        return bool(self._members_of(one))

    def _members_of(self, one: RtsComponent) -> tuple[str, ...]:
        if one.members:
            return one.members
        default = one.named_set(DEFAULT)
        return () if default is None else _listed(default.values.get("members", ""))

    def _composite(self, one: RtsComponent) -> CompositeEntry:
        name = self._names[one.name]
        members = []
        for member in self._members_of(one):
            if self._names.get(member) is None:
                self._notes.append(Note(one.where, f"{name}: its member {member!r:.80} is not in the profile"))
            else:
                members.append(self._names[member])
        if one.composite != "PeriodicECShared":
            self._notes.append(Note(one.where, f"{name}: {one.composite}: here members of a composite share a context"))
        default = one.named_set(DEFAULT) or ConfigurationSet(DEFAULT, {}, {})
        exported = []
        for port in _listed(default.values.get("exported_ports", "")):
            owner, _, word = port.rpartition(".")
            if owner in self._names:
                exported.append(f"{self._names[owner]}.{word}")
            else:
                self._notes.append(Note(one.where, f"{name}: exported port {port!r:.80}: no such component"))
        for key in default.values:
            if key not in _OF_COMPOSITES:
                self._notes.append(Note(one.where, f"{name}: the parameter {key!r:.60} of a composite stays there"))
        entry = CompositeEntry(name, tuple(members), exported=dict.fromkeys(exported, "{port}"))
        given = frozen(extra(one.properties, "options", dict, one.where, self._notes) or {})
        for key, value in given.items():
            try:
                entry = with_option(entry, key, value)
            except ConfigurationError as error:
                self._notes.append(Note(one.where, f"{name}: aiorts.options: {error}"))
        return entry

    # -- contexts --------------------------------------------------------------------------------------------------

    def _contexts(self) -> tuple[dict[str, ContextEntry], dict[str, tuple[str, int]]]:
        found: dict[str, ContextEntry] = {}
        places: dict[str, tuple[str, int]] = {}
        run: set[str] = set()
        for one in self._profile.components:
            if one.name in self._members:
                continue
            for number, context in enumerate(one.contexts):
                entry = self._context(one, context, found)
                found[entry.name] = entry
                places[entry.name] = one.name, number
                run.update(entry.members)
        for one in self._profile.components:
            if one.name not in self._members and self._names[one.name] not in run:
                self._notes.append(Note(one.where, f"{one.name}: has no execution context, and never runs"))
        return found, places

    def _context(self, one: RtsComponent, context: RtsContext, taken: Mapping[str, Any]) -> ContextEntry:
        properties, where = context.properties, context.where
        name = extra(properties, "name", str, where, self._notes) or f"{self._names[one.name]}_ec{context.id or 0}"
        name = named(name, taken)
        stated = extra(properties, "kind", str, where, self._notes)
        kind = stated or kind_of(context.kind)
        if not kind:
            self._notes.append(Note(where, f"{name}: kind {context.kind!r:.60} is not known; it is periodic here"))
            kind = "periodic"
        options: dict[str, Any] = {}
        if kind in ("periodic", "realtime") or (kind == "thread" and context.rate):
            if not context.rate:
                self._notes.append(Note(where, f"{name}: no rate; it is {_USUAL_RATE:g} Hz here"))
            options["rate"] = context.rate or _USUAL_RATE
            if options["rate"] > _FASTEST:
                options["max_rate"] = options["rate"]
        options.update(frozen(extra(properties, "options", dict, where, self._notes) or {}))
        listed = extra(properties, "members", list, where, self._notes)
        others = listed if listed is not None else [one.name, *context.participants]
        members = []
        for other in others:
            if other not in self._names or other in self._members:
                self._notes.append(Note(where, f"{name}: {other!r:.80} is no component that may run in a context"))
            else:
                members.append(self._names[other])
        activate = extra(properties, "activate", bool, where, self._notes)
        return ContextEntry(name, kind, tuple(dict.fromkeys(members)), activate is not False, MappingProxyType(options))

    # -- connections and order -------------------------------------------------------------------------------------

    def _connections(self, known: Mapping[str, Any]) -> tuple[tuple[int, ConnectionEntry], ...]:
        found: list[tuple[int, ConnectionEntry]] = []
        names: set[str] = set()
        pairs: set[frozenset[str]] = set()
        for place, one in enumerate(self._profile.connectors):
            ends = [self._end(component, port) for component, port in (one.source, one.target)]
            gone = [component for (component, _), end in zip((one.source, one.target), ends, strict=True) if not end]
            options = options_of(one, self._notes)
            if gone:
                self._notes.append(Note(one.where, f"connection of {gone[0]!r:.80}: no such component or port"))
                continue
            if options.get("name") in names:
                del options["name"]
            names.add(options.get("name", ""))
            if (pair := frozenset(ends)) in pairs:
                options["allow_duplicate"] = True
                self._notes.append(
                    Note(one.where, f"{' and '.join(ends)} are connected twice; allow_duplicate keeps both")
                )
            pairs.add(pair)
            found.append((place, ConnectionEntry(tuple(ends), MappingProxyType(options), len(found) + 1)))
        return tuple(found)

    def _end(self, component: str, port: str) -> str:
        """The path of a port; a port that a composite exports has the member's path. "" where there is no such port."""
        owner, dot, word = port.rpartition(".")
        if component in self._composites and dot and owner in self._names:
            return f"{self._names[owner]}.{word}"
        if component not in self._names:
            return ""
        name = named(word if dot and owner == component else port)
        if name != port:
            self._notes.append(Note(component, f"the port {port!r:.80} is {name!r} here"))
        return f"{self._names[component]}.{name}"

    def _rules(self) -> dict[str, StartRule]:
        profile = self._profile
        may = {name: self._names[name] for name in self._names if name not in self._composites}
        rules = rules_of(profile.sequences, may, self._notes)
        for one in profile.components:
            given = extra(one.properties, "start", dict, one.where, self._notes)
            if given is not None:
                rule = self._made(StartRule, {"component": self._names[one.name], **given}, one.where)
                rules.update({} if rule is None else {rule.component: rule})
        return rules


def _listed(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())
