"""Puts a FlexiFilter between ports of a system file that do not fit, if their connection has `adapt = true`.

The filter is then a component like any other: it is checked, drawn, planned, built and saved with the system.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Literal

from aiorts.adapting import FILTER, Between, filter_name, first_half, is_accepted, numbered, plain_between
from aiorts.errors import AiortsError, PluginError, StateError, WiringError
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.ports.wiring import pair_faults
from aiorts.late import dataclass
from aiorts.model.wanted.entries import ComponentEntry, ConnectionEntry
from aiorts.system.checks.composed_drafts import compositions
from aiorts.system.checks.draft import Draft, draft, drafts_of
from aiorts.system.checks.findings import Said
from aiorts.system.file.families import root
from aiorts.system.file.survey import Survey, survey_component
from aiorts.system.text.places import Key


@dataclass(frozen=True, slots=True)
class Adapted:
    """The FlexiFilters that adapting inserted."""

    drafts: Mapping[str, Draft]
    """The inserted components."""
    said: tuple[Said, ...]
    """The findings that report each inserted filter and its place."""


_NONE = Adapted(MappingProxyType({}), ())


def adapted(found: Survey, drafts: Mapping[str, Draft] | None = None) -> Adapted:
    """Add the filters to the system of the survey; a connection that cannot have one becomes a fault of the survey.

    Args:
        drafts: the drafts of the system's components and composites; made here by default, if a filter is needed.
    """
    wanting = {one.number for one in found.system.connections if _wants(found, one)}
    if not wanting:
        return _NONE
    if drafts is None:
        own = drafts_of(found)
        drafts = {**own, **compositions(found.system, own).drafts}
    work = _Work(found, dict(drafts))
    connections: list[ConnectionEntry] = []
    for one in found.system.connections:
        connections += work.connection(one) if one.number in wanting else (one,)
    found.system = replace(found.system, connections=tuple(connections))
    return Adapted({name: work.drafts[name] for name in work.drafts if name not in drafts}, tuple(work.said))


def _wants(found: Survey, connection: ConnectionEntry) -> bool:
    known = found.profiles.get(connection.number)
    return known is not None and bool(known[1].adapt)


class _Work:
    """Inserts filters into the connections of one survey."""

    def __init__(self, found: Survey, drafts: dict[str, Draft]) -> None:
        self._found = found
        self.drafts = drafts
        self.said: list[Said] = []

    def connection(self, entry: ConnectionEntry) -> Iterator[ConnectionEntry]:
        """The connections, to filters and from them, that replace this one."""
        options = {word: value for word, value in entry.options.items() if word != "adapt"}
        plain = replace(entry, options=MappingProxyType(options))
        try:
            pairs = self._pairs(plain)
            adapt = self._found.profiles[entry.number][1].adapt
            filters = [self._filter(out, in_, adapt) for (_, out), (_, in_) in pairs]
        except AiortsError as error:
            self._refuse(entry, error)
            return
        if not any(filters):
            yield plain
            return
        for number, (((source, out), (target, in_)), between) in enumerate(zip(pairs, filters, strict=True), 1):
            second = MappingProxyType(dict(numbered(options, number)))
            if between is None:
                yield replace(entry, ports=(source, target), options=second)
                continue
            try:
                name = self._insert(between, out, in_)
            except AiortsError as error:
                self._refuse(entry, error)
                continue
            said = f"{name!r} is put between {source} and {target}: {between.said}"
            self.said.append(Said("note", "N-ADAPT", self._key(entry), said, of_key=True))
            yield replace(entry, ports=(source, f"{name}.input0"), options=MappingProxyType(first_half(options)))
            yield replace(entry, ports=(f"{name}.output0", target), options=second)

    def _key(self, entry: ConnectionEntry) -> Key:
        return ("connections", entry.number - 1, "adapt")

    def _refuse(self, entry: ConnectionEntry, error: AiortsError) -> None:
        text = str(error).partition(": adapt: ")[2] or str(error)
        self._found.say(self._key(entry), type(error)(text), of_key=True)

    def _pairs(self, entry: ConnectionEntry) -> list[tuple[tuple[str, OutPort[Any]], tuple[str, InPort[Any]]]]:
        """Each out-port with each in-port; no pair if another check reports a fault of these ports."""
        if entry.options.get("convert"):
            raise WiringError("convert makes them fit already; take one of the two away")
        ports = {path: self._port(path) for path in entry.ports}
        outs = [(path, port) for path, port in ports.items() if isinstance(port, OutPort)]
        ins = [(path, port) for path, port in ports.items() if isinstance(port, InPort)]
        return [(out, in_) for out in outs for in_ in ins] if len(outs) + len(ins) == len(entry.ports) else []

    def _port(self, path: str) -> Any:
        name, _, port = path.partition(".")
        known = self.drafts.get(name)
        if known is None or known.error is not None or port in known.ports or known.complete:
            return None if known is None else known.ports.get(port)
        raise WiringError(f"the ports of {name} are known only when it runs; put a {FILTER} of your own between them")

    def _filter(self, out: OutPort[Any], in_: InPort[Any], adapt: bool | Literal["text"]) -> Between | None:
        """The filter to put between two ports; None if the ports fit, or no known filter joins them."""
        if next(pair_faults(out, in_), None) is None:
            return None
        if FILTER not in self._found.catalogue.extensions("components"):
            raise PluginError(f"no plugin offers the type {FILTER!r}, which joins them; install a plugin that does")
        between = plain_between(out, in_, adapt)
        return between if between is not None and is_accepted(self._found.catalogue, between) else None

    def _insert(self, between: Between, out: OutPort[Any], in_: InPort[Any]) -> str:
        """Add the filter as a component, before its reader in the reader's context; returns its name."""
        found = self._found
        system = found.system
        reader = in_.path.partition(".")[0]
        top = root(system.composites, reader)
        home = next((one for one in system.contexts.values() if top in one.members), None)
        if home is None:
            raise WiringError(
                f"{reader} is in no context, where its {FILTER} could run; name it among the members of one"
            )
        name = filter_name(out.path, in_.path, {*system.components, *system.composites})
        entry = ComponentEntry(name, FILTER, options=between.options)
        survey_component(found, entry)
        made = draft(found.types[name], name, found.settings[name])
        if home.name in found.contexts and made.component is not None:
            try:
                found.contexts[home.name].runner.check_can_add(made.component)
            except StateError as error:
                del found.types[name], found.settings[name]
                raise WiringError(f"{reader} runs in {home.name}, which cannot run a {FILTER}: {error}") from error
        self.drafts[name] = made
        place = home.members.index(top)
        members = (*home.members[:place], name, *home.members[place:])
        found.system = replace(
            system,
            components=MappingProxyType({**system.components, name: entry}),
            contexts=MappingProxyType({**system.contexts, home.name: replace(home, members=members)}),
        )
        return name
