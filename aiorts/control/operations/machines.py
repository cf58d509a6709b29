"""Operations on state machines and modes.

For a component in a process of its own, or in another kernel, the operation is passed on to that process or kernel.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from aiorts.control.operation import Operation, Right
from aiorts.control.operations.configuration import Whose
from aiorts.control.operations.known import absent, component_named, whose
from aiorts.control.session import Session
from aiorts.control.values import Done
from aiorts.errors import StateError
from aiorts.kernel.component import Elsewhere
from aiorts.kernel.declarations import kinds_of
from aiorts.late import dataclass
from aiorts.model.reading import from_plain
from aiorts.observe import MachineReport, ModeReport

if TYPE_CHECKING:
    from aiorts.statemachines import StateStructure

_ELSEWHERE: Final = 4.0
"""Seconds that a change of mode may take in another process or kernel, so that its answer comes in time."""


@dataclass(frozen=True, slots=True)
class ChartState:
    """A state of a chart, for a drawing."""

    name: str
    inside: str
    """The enclosing state; "" at the top."""
    kind: str
    """"state", "parallel", "final", "history" or "deep"."""
    initial: bool
    """Whether it is the initial state of its enclosing state."""
    ways: tuple[tuple[str, str], ...]
    """The transitions: the trigger in words, and the target state; "" where only actions run."""


@dataclass(frozen=True, slots=True)
class Shown:
    """The state machine and the modes of a component; None where it has none."""

    machine: MachineReport | None = None
    modes: ModeReport | None = None
    events: tuple[str, ...] = ()
    """The events that the machine knows."""
    chart: tuple[ChartState, ...] = ()
    """The states of the machine, the outer before the inner."""


@dataclass(frozen=True, slots=True)
class Sending:
    """An event for a state machine."""

    component: str
    event: str
    data: Any = None
    """The data of the event."""


@dataclass(frozen=True, slots=True)
class Mode:
    """A new mode for a component."""

    component: str
    mode: str
    timeout: float | None = 5.0
    """Seconds of the kernel's clock; None: no limit, or 4 s for a component in another process or kernel."""


async def _machine(session: Session, given: Whose) -> Shown:
    from aiorts.statemachines import MultiModeComponent, StateMachineComponent  # late: most systems have none

    component = component_named(session, given.component)
    if isinstance(component, Elsewhere):
        return from_plain(Shown, await component.ask("machine", component=given.component))
    reports: dict[str, Any] = {}
    for kind in kinds_of(component):
        reports.update(kind.reports(component))
    events: tuple[str, ...] = ()
    chart: tuple[ChartState, ...] = ()
    if isinstance(component, StateMachineComponent):
        events = tuple(sorted(component.machine.chart.events))
        chart = tuple(_inside(component.machine.chart.structure, ""))
    elif not isinstance(component, MultiModeComponent):
        raise StateError(f"{given.component}: has no state machine and no modes; it is a {type(component).__name__}")
    return Shown(reports.get("machine"), reports.get("modes"), events, chart)


def _inside(around: StateStructure, name: str) -> Iterator[ChartState]:
    for state in around.states:
        ways = tuple((way.label, way.target or "") for way in state.transitions)
        yield ChartState(state.name, name, state.kind, state.name in around.initial, ways)
        yield from _inside(state, state.name)


async def _send(session: Session, given: Sending) -> Done:
    from aiorts.statemachines import StateMachineComponent  # late: most systems have none

    component = component_named(session, given.component)
    if isinstance(component, Elsewhere):
        await component.ask("send_event", component=given.component, event=given.event, data=given.data)
        return Done()
    if not isinstance(component, StateMachineComponent):
        raise StateError(f"{given.component}: has no state machine; it is a {type(component).__name__}")
    chart = component.machine.chart
    if not chart.knows(given.event):
        raise absent(f"{given.component}: no transition is for event {given.event!r:.80}", given.event, chart.events)
    component.machine.send(given.event, given.data)
    return Done()


async def _set_mode(session: Session, given: Mode) -> Done:
    from aiorts.statemachines import MultiModeComponent  # late: most systems have none

    component = component_named(session, given.component)
    if isinstance(component, Elsewhere):
        timeout = _ELSEWHERE if given.timeout is None else min(given.timeout, _ELSEWHERE)
        await component.ask("set_mode", component=given.component, mode=given.mode, timeout=timeout)
        return Done()
    if not isinstance(component, MultiModeComponent):
        raise StateError(f"{given.component}: has no modes; it is a {type(component).__name__}")
    if given.mode not in component.modes:
        raise absent(f"{given.component}: no mode {given.mode!r:.80}", given.mode, component.modes)
    await component.set_mode(given.mode, given.timeout)
    return Done()


ROWS: Final = (
    Operation("machine", "The state machine and modes.", Whose, Shown, Right.VIEW, _machine, idempotent=True),
    Operation("send_event", "Send an event to a state machine.", Sending, Done, Right.OPERATE, _send, changes=whose),
    Operation("set_mode", "Change the mode.", Mode, Done, Right.OPERATE, _set_mode, idempotent=True, changes=whose),
)
