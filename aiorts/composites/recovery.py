"""Deactivates the other members when one fails, and activates them again after its recovery.

Each member keeps the errors for which it was stopped; a member deactivated on purpose has none and stays off.
Everything here runs between two cycles, in the thread of the context.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING

from aiorts.composites.composition_check import leaves_of, outer_of
from aiorts.errors import AiortsError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.cycle import Action
from aiorts.model.lifecycle import Event, LifecycleState
from aiorts.model.policy import ErrorPolicy

if TYPE_CHECKING:
    from aiorts.composites.group import CompositeGroup
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.cell import ComponentSide
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Done, Steps

_ERROR, _INACTIVE = LifecycleState.ERROR, LifecycleState.INACTIVE


def stop_the_others(composite: CompositeGroup, context: Context, failed: str) -> None:
    """Deactivate the other members before the next cycle, since one member is in error; in the thread of the context.

    Members with schedules of their own are stopped soon after it.
    """
    if composite.is_spread:
        composite.kernel.call_on_loop(partial(_stop_groups, composite, failed))
    else:
        context.runner.submit(Action(lambda: _stop(composite, failed)))


def _stop_groups(composite: CompositeGroup, failed: str) -> None:
    for group in composite.inner:
        if group.is_spread:
            _stop_groups(group, failed)
        elif (context := group.context) is not None:
            stop_the_others(group, context, failed)


def _stop(composite: CompositeGroup, failed: str) -> Steps:
    for member in tuple(m for part in reversed(composite.parts) for m in cell(part).members):
        if member.active and not member.left:
            if not member.finishing:  # a finished source does not begin again
                member.stopped_for = frozenset((failed,))
            yield from member.context.runner.life.deactivate(member)


async def bring_back(component: Component) -> tuple[str, ...]:
    """Activate the members again that were stopped for the component, after its recovery; return their names, in order.

    They stay off while another member is in error, and come back after the last recovery.
    """
    back: list[str] = []
    leaves = leaves_of((component,))
    names = frozenset(leaf.name for leaf in leaves)
    contexts = dict.fromkeys(component.contexts)
    for outer in filter(lambda one: one.is_spread, _line(outer_of(component))):
        contexts |= dict.fromkeys(member.context for leaf in leaves_of(outer.members) for member in cell(leaf).members)
    for context in contexts:
        if any(names & member.stopped_for for member in context.runner.members):
            steps = partial(_back, context, leaves, back)
            try:
                await context.runner.ask([(f"bring back who stopped with {component.name}", steps)], None)
            except AiortsError:
                continue  # the context ends
    return tuple(back)


def _back(context: Context, leaves: Iterable[Component], back: list[str], done: Done) -> Steps:
    helped = frozenset(leaf.name for leaf in leaves if _is_active(leaf, context))
    for member in tuple(context.runner.members):
        if member.left or not member.stopped_for & helped:
            continue
        in_error = [composite for composite in _stopping(member.component) if composite.state is _ERROR]
        if in_error:
            others = leaves_of(part for composite in in_error for part in composite.members)
            failing = (leaf.name for leaf in others if any(m.state is _ERROR for m in cell(leaf).members))
            member.stopped_for = member.stopped_for.union(failing)
            continue
        member.stopped_for = frozenset()
        if member.state is _INACTIVE:
            outcome: list[BaseException | None] = []
            yield from context.runner.life.request(member, Event.ACTIVATE, outcome.append)
            if outcome == [None]:
                back.append(member.component.name)
    done(None)


def _is_active(component: Component, context: Context) -> bool:
    """Whether a component is active in this context or, if it is not in this context, in those where it runs."""
    members = cell(component).members
    return any(member.active for member in [one for one in members if one.context is context] or members)


def stopped_with(component: Component, composite: CompositeGroup | None) -> str:
    """The outermost composite that a component's error stopped; "" for none."""
    names = frozenset(leaf.name for leaf in leaves_of((component,)))
    stopped = ""
    for outer in _line(composite):
        if outer.errors is ErrorPolicy.STOP and any(
            names & member.stopped_for for part in leaves_of(outer.members) for member in cell(part).members
        ):
            stopped = outer.name
    return stopped


def _stopping(component: ComponentSide) -> Iterator[CompositeGroup]:
    """The composites around a component that stop as a whole."""
    return (composite for composite in _line(outer_of(component)) if composite.errors is ErrorPolicy.STOP)


def _line(composite: CompositeGroup | None) -> Iterator[CompositeGroup]:
    """A composite and those that an error of it concerns, from the innermost out."""
    while composite is not None:
        yield composite
        composite = composite.next_out
