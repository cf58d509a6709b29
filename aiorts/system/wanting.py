"""Makes the `Wanted` of a system file, in the form of one read from a kernel; makes components, runs no hook."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from aiorts.composites import exports
from aiorts.errors import WiringError
from aiorts.kernel.declarations import declarations
from aiorts.kernel.ports import InPort, OutPort
from aiorts.model.names import names_kernel
from aiorts.model.options import connector_profile, link_options
from aiorts.model.wanted.entries import ComponentEntry, CompositeEntry, ConnectionEntry, ContextEntry, Wanted, said_keys
from aiorts.planning import Canon, service_connection, table, whole
from aiorts.services import ServicePort, pairs_of
from aiorts.system.blueprint import Blueprint, prepare
from aiorts.system.checks.composed_drafts import compositions, leaf_paths
from aiorts.system.checks.draft import Draft, draft
from aiorts.system.file.pairs import ConnectedPairs
from aiorts.system.file.values import SystemFile


def wanted(system: SystemFile | Blueprint, notes: list[str] | None = None) -> Wanted:
    """The system that a file describes.

    Args:
        notes: gets the parts that no file can have.

    Raises:
        AiortsError: an error of `prepare`.
        SystemFileError: a port of a component cannot be known without running it.
        WiringError: two ports are connected twice.
    """
    return _Reader(
        prepare(system) if isinstance(system, SystemFile) else system, [] if notes is None else notes
    ).wanted()


class _Reader:
    """Reads one prepared file."""

    def __init__(self, plan: Blueprint, notes: list[str]) -> None:
        self._plan = plan
        self._canon = Canon(plan.catalogue, notes)
        drafts = {name: draft(cls, name, plan.settings[name]) for name, cls in plan.types.items()}
        self._drafts: Mapping[str, Draft] = {**drafts, **compositions(plan.system, drafts).drafts}
        self._system = leaf_paths(plan.system, self._drafts)

    def wanted(self) -> Wanted:
        system, plan = self._system, self._plan
        made = Wanted(
            components=_frozen({name: self._component(one) for name, one in system.components.items()}),
            connections=tuple(self._connections()),
            contexts=_frozen({name: self._context(one) for name, one in system.contexts.items()}),
            clock=system.clock,
            composites=_frozen({name: _composite(one) for name, one in system.composites.items()}),
            services=_frozen(
                {
                    name: table(one.kind.settings, one.table)
                    for name, one in plan.services.items()
                    if one.table is not None
                }
            ),
            plugin_paths=tuple(map(whole, system.plugin_paths)),
        )
        self._canon.check()
        return made

    def _component(self, entry: ComponentEntry) -> ComponentEntry:
        cls = self._plan.types[entry.name]
        state = self._plan.settings[entry.name].merged(declarations(cls).configuration, entry.name)
        return self._canon.component(
            entry.name,
            cls,
            state,
            said_keys(entry),
        )

    def _context(self, entry: ContextEntry) -> ContextEntry:
        return replace(entry, options=self._canon.context_options(self._plan.contexts[entry.name]))

    def _connections(self) -> Iterator[ConnectionEntry]:
        """The connections, those of data ports first, as a kernel has them."""
        services: list[ConnectionEntry] = []
        joined = ConnectedPairs()
        number = 0
        for entry in self._system.connections:
            ports = [self._port(path) for path in entry.ports]
            if any(isinstance(port, ServicePort) for port in ports):
                services += _of_services([port for port in ports if isinstance(port, ServicePort)], entry.options)
                continue
            text = self._plan.converters.get(entry.number)
            options = entry.options if text is None else {**entry.options, "convert": text}
            pairs = list(_pairs(entry.ports, ports))
            for at, (out, in_, length) in enumerate(pairs):
                number += 1
                said, elsewhere = options, self._system.is_elsewhere
                if elsewhere(out) or elsewhere(in_):
                    said = link_options("", options, from_reader=names_kernel(out))
                profile, limits = connector_profile("", said, "", (out, in_), 8 if length is None else length)
                if (fault := joined.fault(out, in_, entry.number, limits)) is not None:
                    place = self._system.at("connections", entry.number - 1, of_key=True)
                    raise WiringError(f"{place}: connections[{entry.number}]: {fault}")
                name = f"{profile.name}-{at + 1}" if at and profile.name else profile.name
                yield self._canon.connection((out, in_), replace(profile, name=name), length, number)
        for entry in services:
            number += 1
            yield replace(entry, number=number)

    def _port(self, path: str) -> Any:
        """The port, as far as it is known without running the component."""
        name, _, port = path.partition(".")
        return self._drafts[name].ports.get(port) if name in self._drafts else None


def _pairs(paths: Sequence[str], ports: Sequence[Any]) -> Iterator[tuple[str, str, int | None]]:
    """Each out-port with each in-port; an unknown port counts as an out-port if it comes first, else as an in-port."""
    outs, ins = [], []
    for number, (path, port) in enumerate(zip(paths, ports, strict=True)):
        if isinstance(port, OutPort) or (port is None and number == 0):
            outs.append(path)
        else:
            ins.append((path, port.length if isinstance(port, InPort) else None))
    return ((out, in_, length) for out in outs for in_, length in ins)


def _of_services(ports: Sequence[ServicePort], options: Mapping[str, Any]) -> Iterator[ConnectionEntry]:
    found: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for required, provided in pairs_of(ports, options):
        ends = (".".join(required.split(".")[:2]), ".".join(provided.split(".")[:2]))
        known = next((pair for pair in found if set(pair) == set(ends)), ends)
        found.setdefault(known, []).append((required, provided))
    by_path = {port.path: port for port in ports}
    for pair, mapping in found.items():
        strict = bool(options.get("strict", True))
        name = str(options.get("name", ""))
        yield service_connection(name, pair, [by_path[path] for path in pair], mapping, strict=strict)


def _composite(entry: CompositeEntry) -> CompositeEntry:
    exported = {rule.pattern: rule.name for rule in exports(entry.exported, entry.name)}
    return replace(entry, exported=_frozen(exported), named=True)


def _frozen(found: dict[str, Any]) -> Mapping[str, Any]:
    return MappingProxyType(found)
