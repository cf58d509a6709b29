"""Keeps the contexts that members had before they ran with their composite, and restores them; orders a context."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from aiorts.errors import AiortsError, StateError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.late import dataclass
from aiorts.model.lifecycle import Event, LifecycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.cell import ComponentSide
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Done, Steps

_LOG = KernelLog()
_ACTIVE = LifecycleState.ACTIVE


@dataclass(frozen=True, slots=True)
class PreviousPlacement:
    """The contexts of a component before it ran with a composite."""

    context: Context
    behind: tuple[ComponentSide, ...]
    """The components that ran before it."""
    active: bool


async def leave_contexts(component: Component, timeout: float | None) -> None:
    """Take a component out of its contexts, keeping them for its return."""
    for context in component.contexts:
        line = context.members
        placement = PreviousPlacement(context, line[: line.index(component)], context.state(component) is _ACTIVE)
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
            behind = [other for other in context.members if other in placement.behind]
            ahead = [other for other in context.members if other not in placement.behind and other is not component]
            line = (*behind, component, *ahead)
            await context.runner.ask([("lay out the order", partial(_order, context, line))], timeout)
            if placement.active:
                await context.runner.ask([context.runner.transition(member, Event.ACTIVATE)], timeout)
        except AiortsError as error:
            _LOG.warning("%s: could not go back to %s: %s", component.name, context.name, error)


def _order(context: Context, line: Sequence[ComponentSide], done: Done) -> Steps:
    context.runner.arrange(line)
    done(None)
    yield from ()
