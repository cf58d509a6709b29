"""Reads a kernel into `Wanted`: the content of a system file from which this system would be made.

Only what was chosen is in it: what is as a class declares it, or as an option is by default, is left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Generator, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import SimulatedClock
from aiorts.composites import Composite, group_of, outer_of
from aiorts.isolation import given_of
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.service import owned_by
from aiorts.model.declared import options_of
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.wanted.entries import (
    ClockEntry,
    ComponentEntry,
    CompositeEntry,
    ConnectionEntry,
    ContextEntry,
    Wanted,
)
from aiorts.model.wanted.stepwise import finished
from aiorts.planning.canon import Canon, service_connection, table, whole
from aiorts.planning.component_rows import ROWS
from aiorts.planning.planning import Planning
from aiorts.planning.shown import shown_name, shown_path
from aiorts.planning.switching import tops
from aiorts.supervision import Supervising

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel

_SHOWN: Final = 20
_MISSING: Final = object()
_NO_RULES: Final[Mapping[str, Any]] = MappingProxyType({})


def wanted_of(kernel: Microkernel, notes: list[str] | None = None) -> Wanted:
    """The system of a kernel at this moment.

    Args:
        notes: gets the parts of the system that no system file can have, which are left out.

    Raises:
        SystemFileError: names each component, converter and context of which a system file cannot be made.
    """
    return finished(reading(kernel, [] if notes is None else notes))


def reading(kernel: Microkernel, notes: list[str]) -> Generator[None, None, Wanted]:
    """Read a kernel a little at a time: the result is of no single moment where the system changes in between."""
    return _Reader(kernel, notes).wanted()


class _Reader:
    """Reads one kernel once."""

    def __init__(self, kernel: Microkernel, notes: list[str]) -> None:
        self._kernel = kernel
        self._canon = Canon(kernel.plugins, notes)
        supervising = kernel.attached(Supervising)
        self._rules = _NO_RULES if supervising is None else supervising.rules

    def wanted(self) -> Generator[None, None, Wanted]:
        """Read the kernel, one thing at each step."""
        kernel = self._kernel
        composites: list[Composite] = []
        components: dict[str, ComponentEntry] = {}
        for one in tuple(kernel.components.values()):
            outer = outer_of(one)
            if isinstance(one, Composite):
                composites.append(one)
            elif outer is not None and one in outer.brought:
                continue  # it stands for one of another kernel, and comes with the composite
            elif not kernel.registry.is_arriving(one):
                components[one.name] = self._component(one)
                yield
        connections: list[ConnectionEntry] = []
        for entry in self._connections():
            connections.append(entry)
            yield
        contexts: dict[str, ContextEntry] = {}
        for name, context in tuple(kernel.contexts.items()):
            contexts[name] = self._context(context)
            yield
        made = Wanted(
            components=MappingProxyType(components),
            connections=tuple(connections),
            contexts=MappingProxyType(contexts),
            clock=self._clock(),
            composites=MappingProxyType(
                {one.name: self._composite(one) for one in composites if not kernel.registry.is_arriving(one)}
            ),
            services=MappingProxyType(dict(self._services())),
            plugin_paths=tuple(whole(folder) for folder in kernel.plugins.folders),
        )
        self._canon.check()
        return made

    # -- components ------------------------------------------------------------------------------------------------

    def _component(self, component: Component) -> ComponentEntry:
        keys = {key: row.read(self._kernel, component) for key, row in ROWS.items()}
        return self._canon.component(component.name, type(component), cell(component).configuration, keys)

    # -- composites and contexts -----------------------------------------------------------------------------------

    def _composite(self, composite: Composite) -> CompositeEntry:
        if type(composite) is not Composite:
            what = f"a composite of a class of its own, {type(composite).__qualname__}"
            self._canon.faults.append(f"{composite.name}: is {what}; make it of Composite")
        group = group_of(composite)
        keys = {key: getattr(composite, key) for key in options_of(CompositeEntry) if key != "exported"}
        exports = () if group is None else group.exports
        brought = {} if group is None else group.brought
        members = tuple(brought.get(member, member.name) for member in composite.members)
        exported = MappingProxyType({rule.pattern: rule.name for rule in exports})
        return CompositeEntry(composite.name, members, exported=exported, named=True, **keys)

    def _context(self, context: Context) -> ContextEntry:
        name = context.name
        members = context.runner.members
        shown = tuple(one.name for one in tops(context))
        own = [one for one in members if one.component.name not in self._rules]
        idle = [
            one.component.name
            for one in own
            if one.state is LifecycleState.INACTIVE and not one.component.has_finished  # type: ignore[attr-defined]
        ]
        activate = not own or len(idle) < len(own)
        if activate and idle:
            names = ", ".join(idle[:_SHOWN])
            self._canon.notes.append(f"{name}: {names}: not active, and active in the saved system with the others")
        return ContextEntry(name, context.kind, shown, activate, self._canon.context_options(given_of(context)))

    # -- connections -----------------------------------------------------------------------------------------------

    def _connections(self) -> Iterator[ConnectionEntry]:
        number = 0
        owned = owned_by(self._kernel.services)
        for connector in tuple(self._kernel.connectors.values()):
            if owned is not None and owned(connector):
                continue
            number += 1
            ports = (shown_path(self._kernel, connector.out.path), shown_path(self._kernel, connector.in_.path))
            profile, name = connector.profile, shown_name(self._kernel, connector)
            if name != profile.name:
                profile = dataclasses.replace(profile, name=name)
            yield self._canon.connection(ports, profile, connector.in_.length, number)
        for service in tuple(self._kernel.service_connectors.values()):
            number += 1
            one = service.profile
            ports = (one.ports[0], one.ports[1])
            entry = service_connection(one.name, ports, service.ports, one.mapping, strict=one.strict)
            yield dataclasses.replace(entry, number=number)

    # -- the whole -------------------------------------------------------------------------------------------------

    def _services(self) -> Iterator[tuple[str, Mapping[str, Any]]]:
        for service in self._kernel.services:
            if service.table is not None and service.name:
                yield service.name, table(type(service).settings, service.table)

    def _clock(self) -> ClockEntry:
        planning, clock = self._kernel.attached(Planning), self._kernel.clock
        if planning is not None and planning.clock is not None:
            return planning.clock
        if isinstance(clock, SimulatedClock):
            return ClockEntry("simulated")
        return ClockEntry() if clock.speed == 1.0 else ClockEntry("scaled", clock.speed)
