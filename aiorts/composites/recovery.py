"""Deactivates the other members when one fails, and activates them again after its recovery.

Each member knows for whose error it was stopped; one that was deactivated on purpose has no such mark and stays off.
Everything here runs between two cycles, in the thread of the context.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

from aiorts.composites.composition import ErrorPolicy
from aiorts.composites.composition_check import leaves_of, outer_of
from aiorts.errors import AiortsError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.cycle import Action
from aiorts.model.lifecycle import Event, LifecycleState

if TYPE_CHECKING:
    from aiorts.composites.group import CompositeGroup
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.cell import ComponentSide
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Done, Steps

_ERROR, _INACTIVE = LifecycleState.ERROR, LifecycleState.INACTIVE


def stop_the_others(composite: CompositeGroup, context: Context, failed: str) -> None:
    """Deactivate the other members before the next cycle, since one is in error; in the thread of the context."""
    context.runner.submit(Action(lambda: _stop(composite, failed)))


def _stop(composite: CompositeGroup, failed: str) -> Steps:
    for member in tuple(m for part in reversed(composite.parts) for m in cell(part).members):
        if member.active and not member.left:
            if not member.finishing:  # a finished source does not begin again
                member.stopped_for = frozenset((failed,))
            yield from member.context.runner.life.deactivate(member)


async def bring_back(component: Component) -> tuple[str, ...]:
    """Activate the members again that were stopped for the component, after its recovery; their names, in order.

    They stay off while another member is in error, and come back after the last recovery.
    """
    back: list[str] = []
    names = frozenset(leaf.name for leaf in leaves_of((component,)))
    for context in component.contexts:
        if any(names & member.stopped_for for member in context.runner.members):
            steps = partial(_back, context, names, back)
            try:
                await context.runner.ask([(f"bring back who stopped with {component.name}", steps)], None)
            except AiortsError:
                continue  # the context ends
    return tuple(back)


def _back(context: Context, names: frozenset[str], back: list[str], done: Done) -> Steps:
    helped = frozenset(member.component.name for member in context.runner.members if member.active) & names
    for member in tuple(context.runner.members):
        if member.left or not member.stopped_for & helped:
            continue
        if any(composite.state is _ERROR for composite in _stopping(member.component)):
            failing = (other.component.name for other in context.runner.members if other.state is _ERROR)
            member.stopped_for = member.stopped_for.union(failing)
            continue
        member.stopped_for = frozenset()
        if member.state is _INACTIVE:
            outcome: list[BaseException | None] = []
            yield from context.runner.life.request(member, Event.ACTIVATE, outcome.append)
            if outcome == [None]:
                back.append(member.component.name)
    done(None)


def stopped_with(component: Component, composite: CompositeGroup | None) -> str:
    """The outermost composite that a component's error stopped; "" for none."""
    names = frozenset(leaf.name for leaf in leaves_of((component,)))
    stopped = ""
    for outer in _line(composite):
        if outer.errors is ErrorPolicy.STOP and any(
            names & member.stopped_for for part in outer.parts for member in cell(part).members
        ):
            stopped = outer.name
    return stopped


def _stopping(component: ComponentSide) -> Iterator[CompositeGroup]:
    """The composites around a component that stop as a whole."""
    return (composite for composite in _line(outer_of(component)) if composite.errors is ErrorPolicy.STOP)


def _line(composite: CompositeGroup | None) -> Iterator[CompositeGroup]:
    """A composite and those it runs with, from the innermost out."""
    while composite is not None:
        yield composite
        composite = None if composite.own_schedule else composite.outer
