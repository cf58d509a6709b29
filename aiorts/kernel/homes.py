"""Where the members of a composite were before they ran with it, and how they come back; and the order of a context."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from aiorts.errors import AiortsError, StateError
from aiorts.model.lifecycle import Event, LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.context import Context
    from aiorts.kernel.life import Done, Steps

__all__ = ("Home", "arrange", "go_home", "leave_home")

_LOG = logging.getLogger("aiorts.kernel")
_ACTIVE = LifeCycleState.ACTIVE


@dataclass(frozen=True, slots=True)
class Home:
    """Where a component was before it ran with a composite."""

    context: Context
    behind: tuple[Component, ...]
    """Who ran before it."""
    active: bool


def arrange(context: Context, line: Sequence[Component]) -> None:
    """Lay out the order: these one after the other, where the first of them stands; between two cycles only."""
    place = {component: index for index, component in enumerate(line)}
    members = context._members
    mine = [member for member in members if member.component in place]
    if not mine:
        return
    first = members.index(mine[0])
    mine.sort(key=lambda member: place[member.component])
    others = [member for member in members if member.component not in place]
    members[:] = [*others[:first], *mine, *others[first:]]
    for order, member in enumerate(members, 1):
        member.order = order
    context._order = len(members)


async def leave_home(component: Component, timeout: float | None) -> None:
    """Take a component out of the contexts it is in, to come back some day."""
    for context in component.contexts:
        line = context.members
        home = Home(context, line[: line.index(component)], context.state(component) is _ACTIVE)
        await context._ask([context._requests.leaving(context._member(component))], timeout)
        component._rt_homes = (*component._rt_homes, home)


async def go_home(component: Component, timeout: float | None) -> None:
    """Back to the contexts it came from, in its place there and active if it was; what cannot be is logged."""
    homes, component._rt_homes = component._rt_homes, ()
    for home in homes:
        context = home.context
        try:
            if context._driver is None or context._stopping:
                raise StateError(f"{context.name} runs no more")
            context._check_may_join(component)
            member = context._new_member(component)
            await context._ask([context._requests.joining(member)], timeout)
            behind = [other for other in context.members if other in home.behind]
            ahead = [other for other in context.members if other not in home.behind and other is not component]
            line = (*behind, component, *ahead)
            await context._ask([("lay out the order", partial(_order, context, line))], timeout)
            if home.active:
                await context._ask([context._requests.transition(member, Event.ACTIVATE)], timeout)
        except AiortsError as error:
            _LOG.warning("%s: could not go back to %s: %s", component.name, context.name, error)


def _order(context: Context, line: Sequence[Component], done: Done) -> Steps:
    arrange(context, line)
    done(None)
    yield from ()
