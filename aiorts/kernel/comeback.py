"""Who is deactivated because a member of a composite failed, and how they come back once it was helped.

Each member knows for whose error it was stopped; what somebody deactivates on purpose knows of none and stays off.
Everything here runs between two cycles, in the thread of the context.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

from aiorts.errors import AiortsError
from aiorts.kernel.life import Action
from aiorts.model.composition import ErrorPolicy
from aiorts.model.lifecycle import Event, LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.composed import Composed
    from aiorts.kernel.context import Context
    from aiorts.kernel.life import Done, Steps

__all__ = ("bring_back", "stop_the_others", "stopped_with")

_ERROR, _INACTIVE = LifeCycleState.ERROR, LifeCycleState.INACTIVE


def stop_the_others(composite: Composed, context: Context, failed: str) -> None:
    """A member is in error: deactivate the others before the next cycle; in the thread of the context."""
    context._submit(Action(lambda: _stop(composite, failed)))


def _stop(composite: Composed, failed: str) -> Steps:
    for member in tuple(m for part in reversed(composite.parts) for m in part._rt_members):
        if member.active and not member.left:
            if not member.finishing:  # a source that is done does not begin anew
                member.stopped_for = frozenset((failed,))
            yield from member.context._life._deactivate(member)


async def bring_back(component: Component) -> tuple[str, ...]:
    """A component was helped: activate those again that were stopped for it; their names, in order of execution.

    They stay off while another member is in error, and come back when the last of them was helped.
    """
    back: list[str] = []
    names = frozenset(leaf.name for leaf in component._rt_leaves())
    for context in component.contexts:
        if any(names & member.stopped_for for member in context._members):
            steps = partial(_back, context, names, back)
            try:
                await context._ask([(f"bring back who stopped with {component.name}", steps)], None)
            except AiortsError:
                continue  # the context ends
    return tuple(back)


def _back(context: Context, names: frozenset[str], back: list[str], done: Done) -> Steps:
    helped = frozenset(member.component.name for member in context._members if member.active) & names
    for member in tuple(context._members):
        if member.left or not member.stopped_for & helped:
            continue
        if any(composite.state is _ERROR for composite in _stopping(member.component)):
            failing = (other.component.name for other in context._members if other.state is _ERROR)
            member.stopped_for = member.stopped_for.union(failing)
            continue
        member.stopped_for = frozenset()
        if member.state is _INACTIVE:
            outcome: list[BaseException | None] = []
            yield from context._life.request(member, Event.ACTIVATE, outcome.append)
            if outcome == [None]:
                back.append(member.component.name)
    done(None)


def stopped_with(component: Component, composite: Composed | None) -> str:
    """The outermost composite that a component's error stopped; "" where it stopped none."""
    names = frozenset(leaf.name for leaf in component._rt_leaves())
    stopped = ""
    for outer in _line(composite):
        if outer.errors is ErrorPolicy.STOP and any(
            names & member.stopped_for for part in outer.parts for member in part._rt_members
        ):
            stopped = outer.name
    return stopped


def _stopping(component: Component) -> Iterator[Composed]:
    """The composites round a component that stop as a whole."""
    return (composite for composite in _line(component._rt_composite) if composite.errors is ErrorPolicy.STOP)


def _line(composite: Composed | None) -> Iterator[Composed]:
    """A composite and those it runs with, from the innermost out."""
    while composite is not None:
        yield composite
        composite = None if composite.own_schedule else composite._rt_composite
