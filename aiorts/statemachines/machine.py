"""A component that is a state machine: events come in through ports, actions are its methods, the table decides.

The interpreter is our own (statechart, charting, microstep, interpreter; pure code). Compared before it was written, on
CPython 3.11, microseconds for one event, flat and three levels deep, in one interleaved run:

    ours (SCXML's order, regions, both histories, any clock)   1.4     1.8
    python-statemachine 3.2.2                                   79     115
    transitions 0.9.3                                          7.9      58
    sismic 1.6.14                                                -      76
    Automat 25.4                                               6.8       -

An event through a port, the context and the component takes 3.4 in a cycle of many events and 10 in its own cycle.
python-statemachine has everything but a foreign clock: delays go by `time.monotonic` and a polling sleep, and it takes
60 ms to import; transitions has no history, timers by threads or `asyncio.sleep`; sismic takes any clock, but runs
actions as text through `exec`, has no `async` and needs three packages; Automat is flat. A timer that is not the
kernel's cannot be simulated, so none of them could be built on.
"""

from __future__ import annotations

import inspect
import time
import warnings
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Final, TypeVar

from aiorts.errors import DeclarationError
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import Kind, declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.ports import InPort
from aiorts.model.lifecycle import LifecycleState
from aiorts.statemachines.actions import check_acts, unawaited
from aiorts.statemachines.charting import Chart, ChartWarning, hint
from aiorts.statemachines.event_port import EventPort
from aiorts.statemachines.state_machine import Calls, StateMachine

__all__ = ("EventPort", "StateMachine", "StateMachineComponent")

T = TypeVar("T")
_ACTIVE = LifecycleState.ACTIVE
_PAUSE: Final = 0.001
"""Seconds that the thread of a machine rests between cycles in a context without a rate."""
_HOOKS: Final = ("on_activated", "on_deactivated", "on_execute")


class MachineKind(Kind):
    """Describes components with a state machine for introspection."""

    def reports(self, component: StateMachineComponent) -> Mapping[str, Any]:
        """The active states and histories. A thread may run the machine meanwhile."""
        from aiorts.observe import MachineReport

        machine = component.machine
        core, chart = machine._core, machine.chart
        history = {
            chart.nodes[index].name: chart.names(states)
            for index, states in zip(chart.histories, core.history, strict=True)
            if states
        }
        report = MachineReport(
            chart.name,
            core.configuration,
            MappingProxyType(history),
            MappingProxyType(machine.timers),
            core.ignored,
            machine.deferred,
        )
        return {"machine": report}

    def keeps_code(self, component: StateMachineComponent) -> str:
        return "is a state machine that runs; deactivate it first" if _elsewhere(component) else ""

    def others_replaced(self, component: StateMachineComponent, pairs: Mapping[Component, Component]) -> None:
        component.machine.participants_replaced(pairs)

    def heritage(self, component: StateMachineComponent) -> Callable[[Component], None]:
        participants, kernel = component.machine._participants, component.kernel

        def hand_over(new: Component) -> None:
            if isinstance(new, StateMachineComponent):
                for one in participants:
                    if kernel.components.get(one.name) is one:
                        new.machine.add_participant(one)

        return hand_over


class StateMachineComponent(Component, kind=MachineKind()):
    """A component that is a state machine: derive from it, write a `chart`, its event ports, and the actions.

        class Door(StateMachineComponent):
            button = EventPort(TimedBoolean)
            lamp = OutPort(TimedBoolean)

            chart = Chart(
                State("closed", On("button", to="open"), initial=True),
                State("open", After(5.0, to="closed"), entry="lamp_on", exit="lamp_off"),
            )

            async def lamp_on(self) -> None: ...

    Activation enters the initial configuration and runs its entry actions; deactivation, also through a failure,
    leaves everything from the inside out. In each cycle: transitions that need no event (`Always`) and whose guard is
    true by now; then the timers that are due, in the order of their deadlines; then the events that had come when the
    cycle began, through ports and `machine.send`, in the order of arrival, each carried out completely; then the `do`
    of the active states. In a context with a rate a timer fires in the first cycle at or after its deadline, in an
    event context at the deadline.

    An action or guard that raises moves the component to error: the rest of that event does not happen, the exit
    actions of exactly the states that were entered and not left run, and the configuration is empty. Histories are
    forgotten at the next activation, unless the chart says `keep_history=True`.

    Actions are `async def` or plain `def` methods, with no argument or one: the data of the event (None for a timer).
    Guards are plain. Where all actions are plain the component runs in every context, threads included. The hooks
    `on_activated`, `on_deactivated` and `on_execute` are the machine's: `Chart(..., entry=, exit=, do=)` is the place
    for their actions.
    """

    chart: ClassVar[Chart]

    def __init_subclass__(cls, **options: Any) -> None:
        wrapped = [hook for hook in _HOOKS if inspect.unwrap(vars(cls).get(hook, _execute)) in _OURS]
        for hook in _HOOKS:
            if hook not in wrapped:
                where = {"on_activated": "entry", "on_deactivated": "exit", "on_execute": "do"}[hook]
                raise DeclarationError(
                    f"{cls.__qualname__}.{hook}: is where the machine runs; say Chart(..., {where}=...) with a method "
                    "of another name"
                )
        if "machine" in vars(cls):
            raise DeclarationError(f"{cls.__qualname__}.machine: is the component's state machine; choose another name")
        chart = cls.__dict__.get("chart")
        if chart is not None and not isinstance(chart, Chart):
            raise DeclarationError(f"{cls.__qualname__}.chart: expected Chart(...), got {chart!r:.60}")
        awaits = False
        if getattr(cls, "chart", None) is not None:
            events = _events({**declarations(cls).ports, **vars(cls)})
            awaits = check_acts(cls, cls.chart, events)
            for port, event in events.items():
                if not cls.chart.knows(event):
                    text = f"{cls.__qualname__}.{port}: no transition is for event {event!r}"
                    warnings.warn(ChartWarning(text + hint(event, cls.chart.events)), stacklevel=2)
            if chart is not None:
                cls.chart.name = cls.chart.name or cls.__name__
                cls.chart.warn_unreachable(stacklevel=3)
        for hook in _HOOKS:
            if hook not in vars(cls):
                setattr(cls, hook, (_AWAITING if awaits else _PLAIN)[hook])
        super().__init_subclass__(**options)

    def __init__(self, name: str = "") -> None:
        if getattr(self, "chart", None) is None:
            raise DeclarationError(f"{type(self).__qualname__}: has no chart; write chart = Chart(...) in the class")
        super().__init__(name)
        self.machine = StateMachine(self, self.chart)
        for port, event in _events(declarations(type(self)).ports).items():
            live = self.ports[port]
            if isinstance(live, InPort):
                self.machine._listen(live, event)

    def add_event_port(self, name: str, port: EventPort[T]) -> InPort[T]:
        """Add an event port made from the declaration `port`, at any time; see `add_port`."""
        live: InPort[T] = self.add_port(name, port)
        self.machine._listen(live, port.event or name)
        return live


def _events(declared: Mapping[str, object]) -> dict[str, str]:
    """The event of each event port that a class declares, by the port's name."""
    return {
        port.name or attribute: port.event or port.name or attribute
        for attribute, port in declared.items()
        if isinstance(port, EventPort)
    }


def _after(component: StateMachineComponent) -> None:
    """At the end of one of the machine's hooks, arm the next timer and notify the context of waiting events."""
    machine = component.machine
    if machine._core.timers or machine._wake is not None:
        machine._arm()
    if machine._arrivals and hasattr(component.context, "trigger"):
        # An action sent an event, or one came in the middle of the cycle: the context is notified after the cycle.
        cell(component).loop.call_soon(machine._trigger)


def _elsewhere(component: StateMachineComponent) -> bool:
    """Whether another context has the component active: there is one machine for all contexts."""
    return any(member.state is _ACTIVE for member in cell(component).members)


# -- the hooks, for machines with and without actions that wait --------------------------------------------------------


def _run(calls: Calls) -> None:
    for function, args in calls:
        try:
            result = function(*args)
            if result is not None and hasattr(result, "__await__"):
                raise unawaited(function, result)
        except BaseException as error:
            calls.throw(error)
            raise


async def _run_awaiting(calls: Calls) -> None:
    for function, args in calls:
        try:
            result = function(*args)
            if result is not None and hasattr(result, "__await__"):
                await result
        except BaseException as error:
            calls.throw(error)
            raise


def _activated(self: StateMachineComponent) -> None:
    """Enter the initial configuration."""
    if not _elsewhere(self):
        _run(self.machine._begin())
        _after(self)


def _deactivated(self: StateMachineComponent) -> None:
    """Leave all states, whatever raises meanwhile."""
    if _elsewhere(self):
        return
    try:
        _run(self.machine._end())
    finally:
        if self.machine._core.states:
            _deactivated(self)
        _after(self)


def _execute(self: StateMachineComponent) -> None:
    """Run one cycle: timers, events, activities."""
    _run(self.machine._cycle())
    _after(self)
    if cell(self).threaded and not cell(self).realtime and getattr(self.context, "rate", None) is None:
        time.sleep(_PAUSE)


async def _activated_awaiting(self: StateMachineComponent) -> None:
    """Enter the initial configuration."""
    if not _elsewhere(self):
        await _run_awaiting(self.machine._begin())
        _after(self)


async def _deactivated_awaiting(self: StateMachineComponent) -> None:
    """Leave all states, whatever raises meanwhile."""
    if _elsewhere(self):
        return
    try:
        await _run_awaiting(self.machine._end())
    finally:
        if self.machine._core.states:
            await _deactivated_awaiting(self)
        _after(self)


async def _execute_awaiting(self: StateMachineComponent) -> None:
    """Run one cycle: timers, events, activities."""
    await _run_awaiting(self.machine._cycle())
    _after(self)


_PLAIN: Final = dict(zip(_HOOKS, (_activated, _deactivated, _execute), strict=True))
_AWAITING: Final = dict(zip(_HOOKS, (_activated_awaiting, _deactivated_awaiting, _execute_awaiting), strict=True))
_OURS: Final = frozenset((*_PLAIN.values(), *_AWAITING.values()))
"""The machine's hooks; a wrapper (`functools.wraps`) of one of them is allowed in its place."""
