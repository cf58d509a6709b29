"""Ends the components of a kernel that closes, one after the other, while all ports still work.

Each one leaves between two cycles of its contexts: its running cycle is finished, and what it calls, reads or writes is
still there. `execution/ending_order.py` says who comes first. A hook over its deadline does not hold up the others.
"""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from aiorts.kernel.execution.ending_order import Edges, ending_order

if TYPE_CHECKING:
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.microkernel import Microkernel


async def end_members(kernel: Microkernel, budget: StopBudget) -> None:
    """Deactivate and shut down every component, in order, within the budget; contexts run on until they are stopped.

    Calls are answered until the last one has ended.
    """
    members: dict[str, list[Member]] = {}
    for context in kernel.contexts.values():
        for member in context.runner.members:
            members.setdefault(member.component.name, []).append(member)
    for names in ending_order(tuple(members), *_edges(kernel)):
        turns = [member for name in names for member in members[name]]
        paused = []
        if len(names) > 1:  # a circle of calls has no first: all finish their cycles before one ends
            contexts = dict.fromkeys(member.context for member in turns)
            paused = [await context.runner.pause(budget) for context in contexts]
        for context, those in groupby(turns, key=lambda member: member.context):
            await kernel.registry.through(context.runner.retire(tuple(those), budget))
        for resume in paused:
            resume()
    for component in kernel.components.values():
        kernel.registry.vacate(component)


def _edges(kernel: Microkernel) -> tuple[Edges, Edges]:
    """The edges of the order: the components that each one calls, and those that read what it writes."""
    calls: dict[str, set[str]] = {}
    for connector in kernel.connections.service_connectors.values():
        for required, provided in connector.profile.mapping:
            calls.setdefault(_owner(required), set()).add(_owner(provided))
    data: dict[str, set[str]] = {}
    for connector in kernel.connections.connectors.values():
        data.setdefault(_owner(connector.out.path), set()).add(_owner(connector.in_.path))
    return calls, data


def _owner(path: str) -> str:
    return path.partition(".")[0]
