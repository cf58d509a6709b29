"""A snapshot of a kernel before a plan: objects, their order, states, configurations, and the rules kept on them.

The reverse steps of a plan put back what its steps are about. `Snapshot.restore` puts back what no step is about, such
as the order of connectors or a component that the plan has led into error, and says what is different all the same.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, format_error
from aiorts.kernel.between_cycles import PATIENCE
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.service import owned_by
from aiorts.kernel.start_context import arrange_contexts
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.ordering import ordered
from aiorts.planning.component_rows import stores
from aiorts.supervision import ContextPlace

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.member import Member
    from aiorts.model.configuration.sets import ConfigurationState
    from aiorts.planning.planning import Planning

_ACTIVE: Final = LifecycleState.ACTIVE
_ERROR: Final = LifecycleState.ERROR
_INACTIVE: Final = LifecycleState.INACTIVE


class Snapshot:
    """The system of one kernel at the moment at which this is made."""

    def __init__(self, planning: Planning) -> None:
        kernel = self._kernel = planning.kernel
        self.components: Final = dict(kernel.components)
        self.contexts: Final = dict(kernel.contexts)
        self._connectors = dict(kernel.connectors)
        self._services = tuple(kernel.service_connectors)
        self._members = {name: [one.name for one in context.members] for name, context in self.contexts.items()}
        self._at_ports = {port: port.connectors for one in self.components.values() for port in one.ports.values()}
        self._states = {
            (context.name, member.component.name): ContextPlace.of(member)
            for context in self.contexts.values()
            for member in context.runner.members
        }
        self._configurations = {name: cell(one).configuration for name, one in self.components.items()}
        self._placements = {name: cell(one).previous_placements for name, one in self.components.items()}
        self._kept: tuple[tuple[Any, Any], ...] = tuple((kept, kept.copy()) for kept in stores(kernel))
        """The stores of values by components' names, each with a copy of its former content."""

    def was_active(self, context: str, component: str) -> bool:
        """Whether a component was active in a context."""
        place = self._states.get((context, component))
        return place is not None and place.state is _ACTIVE

    def was_active_somewhere(self, component: str) -> bool:
        """Whether a component was active in any context."""
        return any(self.was_active(context, name) for context, name in self._states if name == component)

    def ended(self) -> frozenset[str]:
        """The components that a context ran then, and that no context runs now."""
        running = {member.component.name for one in self._kernel.contexts.values() for member in one.runner.members}
        return frozenset(name for _, name in self._states if name not in running)

    def configuration(self, name: str) -> ConfigurationState | None:
        """The configuration of a component; None where there was none of this name."""
        return self._configurations.get(name)

    async def restore(self, said: Collection[str], exchanged: Collection[str] = ()) -> list[str]:
        """Put back what no step is about.

        Args:
            said: components that are known as not made again.
            exchanged: components that were in another process meanwhile.

        Returns:
            What is not as it was, and why, one sentence each.
        """
        kernel = self._kernel
        for kept, copied in self._kept:
            kept.clear()
            kept.update(copied)
        for name, placements in self._placements.items():
            if name in kernel.components:
                cell(kernel.components[name]).previous_placements = tuple(
                    replace(one, context=kernel.contexts.get(one.context.name, one.context)) for one in placements
                )
        kernel.registry.arrange(self.components)
        kernel.connections.arrange((*self._connectors, *self._services), self._at_ports)
        arrange_contexts(kernel, self.contexts)
        notes = list(self._other_objects(said, exchanged))
        for (context, name), before in self._states.items():
            there = kernel.contexts.get(context), kernel.components.get(name)
            if there[0] is not None and there[1] is not None:
                notes += await _restore_state(there[0], there[1], before)
        for name, line in self._members.items():
            if name in kernel.contexts:
                await _arrange(kernel.contexts[name], line)
        return notes

    def _other_objects(self, said: Collection[str], exchanged: Collection[str]) -> Iterator[str]:
        kernel = self._kernel
        anew = set(said)
        for name, component in self.components.items():
            now = kernel.components.get(name)
            if now is not component:
                anew.add(name)
            if now is not component and name not in said:
                held = (
                    "has its attributes; take the new handle"
                    if name in exchanged
                    else "what it held in attributes is lost"
                )
                yield f"{name}: " + ("is gone" if now is None else f"was made anew: {held}")
        for name, context in self.contexts.items():
            now_there = kernel.contexts.get(name)
            if now_there is not None and now_there is not context:
                yield f"{name}: is another context, which counts from 0"
        owned = owned_by(kernel.services)
        for name, connector in self._connectors.items():
            ends = {path.partition(".")[0] for path in connector.profile.ports}
            if kernel.connectors.get(name) is connector or ends & anew or (owned is not None and owned(connector)):
                continue
            yield f"{name}: " + ("is gone" if name not in kernel.connectors else "was made anew, and counts from 0")


async def _restore_state(context: Context, component: Component, before: ContextPlace) -> tuple[str, ...]:
    """Put a component back into its state in a context; the texts say why it is not in that state.

    A component that the plan has not taken out of the context, and that was activated or deactivated meanwhile, stays
    as it is.
    """
    state = before.state
    where = f"{component.name}: was {state} in {context.name}"
    member = _member(context, component)
    if member is None:
        return (f"{where}, and is not in it",)
    by_plan = member is not before.member
    try:
        if member.state is _ERROR and state is not _ERROR:
            await context.reset(component)
            by_plan = True
        if member.state is _INACTIVE and state is _ACTIVE and (by_plan or member.stopped_for):
            await context.activate(component)
        elif member.state is _ACTIVE and state is _INACTIVE and by_plan:
            await context.deactivate(component)
    except AiortsError as error:
        return (f"{where}, and is {member.state}: {format_error(error)}",)
    if member.state is not state:
        return (f"{where}, and is {member.state}",)
    if before.finishing and state is _INACTIVE:
        member.finishing = True
    return ()


async def _arrange(context: Context, names: list[str]) -> None:
    """Put the members of a context in this order, between two cycles."""
    there = {one.name: one for one in context.members}
    line = [there[name] for name in ordered(there, names)]
    if line != list(context.members):
        await context.runner.ask([context.runner.arranging(line)], PATIENCE)


def _member(context: Context, component: Any) -> Member | None:
    return next((one for one in cell(component).members if one.context is context), None)
