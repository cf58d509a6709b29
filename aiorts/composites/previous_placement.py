"""Keeps the contexts that members had before they ran with their composite, and restores them; orders a context."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.errors import AiortsError, StateError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.late import dataclass
from aiorts.model.lifecycle import Event, LifecycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context

_LOG = KernelLog()
_ACTIVE = LifecycleState.ACTIVE


@dataclass(frozen=True, slots=True)
class PreviousPlacement:
    """The contexts of a component before it ran with a composite."""

    context: Context
    behind: tuple[str, ...]
    """The names of the components that ran before it, so that instances may be replaced meanwhile."""
    active: bool


async def leave_contexts(component: Component, timeout: float | None) -> None:
    """Take a component out of its contexts, keeping them for its return."""
    for context in component.contexts:
        line = context.members
        behind = tuple(other.name for other in line[: line.index(component)])
        placement = PreviousPlacement(context, behind, context.state(component) is _ACTIVE)
        await context.runner.ask([context.runner.leaving(context.runner.member(component))], timeout)
        cell(component).previous_placements = (*cell(component).previous_placements, placement)


async def return_to_contexts(component: Component, timeout: float | None) -> None:
    """Return a component to its former contexts, in its place there and active if it was; failures are logged."""
    placements, cell(component).previous_placements = cell(component).previous_placements, ()
    for placement in placements:
        context = placement.context
        try:
            if not context.running or context.runner.stopping:
                raise StateError(f"{context.name} runs no more")
            context.runner.check_may_join(component)
            member = context.runner.new_member(component)
            await context.runner.ask([context.runner.joining(member)], timeout)
            behind = [other for other in context.members if other.name in placement.behind]
            ahead = [other for other in context.members if other not in behind and other is not component]
            await context.runner.ask([context.runner.arranging((*behind, component, *ahead))], timeout)
            if placement.active:
                await context.runner.ask([context.runner.transition(member, Event.ACTIVATE)], timeout)
        except AiortsError as error:
            _LOG.warning("%s: could not go back to %s: %s", component.name, context.name, error)
