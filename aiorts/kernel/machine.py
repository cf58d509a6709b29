"""A component that is a state machine: events come in through ports, actions are its methods, the table decides.

The interpreter is our own (`aiorts/model`: statechart, charting, microstep, interpreter; pure code). Compared before it
was written, on CPython 3.11, microseconds for one event, flat and three levels deep, in one interleaved run:

    ours (SCXML's order, regions, both histories, any clock)   1.4     1.8
    python-statemachine 3.2.2                                   79     115
    transitions 0.9.3                                          7.9      58
    sismic 1.6.14                                                -      76
    Automat 25.4                                               6.8       -

Through a port, the context and the component it is 3.4 in a cycle of many events and 10 in a cycle of its own.
python-statemachine has everything but a foreign clock: delays go by `time.monotonic` and a polling sleep, and it takes
60 ms to import; transitions has no history, timers by threads or `asyncio.sleep`; sismic takes any clock, but runs
actions as text through `exec`, has no `async` and needs three packages; Automat is flat. A timer that is not the
kernel's cannot be simulated, so none of them could be built on.
"""

from __future__ import annotations

import inspect
import threading
import time
import warnings
from collections.abc import Mapping
from typing import Any, ClassVar, Final, TypeVar

from aiorts.errors import DeclarationError
from aiorts.kernel.acts import check_acts, unawaited
from aiorts.kernel.component import Component
from aiorts.kernel.event_port import EventPort
from aiorts.kernel.ports import InPort
from aiorts.kernel.state_machine import Calls, StateMachine
from aiorts.model.charting import Chart, ChartWarning, hint
from aiorts.model.lifecycle import LifeCycleState

__all__ = ("EventPort", "StateMachine", "StateMachineComponent")

T = TypeVar("T")
_ACTIVE = LifeCycleState.ACTIVE
_PAUSE: Final = 0.001
"""Seconds that it lets its thread rest where no rate says when the next cycle is."""
_HOOKS: Final = ("on_activated", "on_deactivated", "on_execute")


class StateMachineComponent(Component):
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
    leaves everything from the inside out. In each cycle: the timers that are due, in the order of their deadlines;
    then the events that had come when it began, through ports and `machine.send`, in the order of arrival, each
    carried out completely; then the `do` of the active states. In a context with a rate a timer fires in the first
    cycle at or after its deadline, in an event context at the deadline.

    An action or guard that raises moves the component to error: the rest of that event does not happen, the exit
    actions of exactly the states that were entered and not left run, and the configuration is empty. Histories are
    forgotten at the next activation, unless the chart says `keep_history=True`.

    Actions are `async def` or plain `def` methods, with no argument or one: what came with the event (None for a
    timer). Guards are plain. Where all actions are plain the component runs in every context, threads included. The
    hooks `on_activated`, `on_deactivated` and `on_execute` are the machine's: `Chart(..., entry=, exit=, do=)` is the
    place for what belongs there.
    """

    chart: ClassVar[Chart]
    _rt_events: ClassVar[Mapping[str, str]] = {}
    """Port -> event, as the class declares them."""

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
            cls._rt_events = dict(cls._rt_events) | {
                port.name or attribute: port.event or port.name or attribute
                for attribute, port in vars(cls).items()
                if isinstance(port, EventPort)
            }
            awaits = check_acts(cls, cls.chart, cls._rt_events)
            for port, event in cls._rt_events.items():
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
        for port, event in self._rt_events.items():
            live = self.ports[port]
            if isinstance(live, InPort):
                self.machine._listen(live, event)

    def add_event_port(self, name: str, port: EventPort[T]) -> InPort[T]:
        """A live event port made after the declaration `port`, at any time; see `add_port`."""
        live: InPort[T] = self.add_port(name, port)
        self.machine._listen(live, port.event or name)
        return live

    # -- waking ----------------------------------------------------------------------------------------------------

    def _rt_own_thread(self) -> bool:
        return self._rt_host.thread_id == threading.get_ident()

    def _rt_trigger(self) -> None:
        """Something is to be done: an event context is told, others look in every cycle."""
        for member in self._rt_members:
            trigger = getattr(member.context, "trigger", None)
            if trigger is not None and member.state is _ACTIVE:
                trigger(self)

    def _rt_after(self) -> None:
        """The end of a hook of the machine's."""
        machine = self.machine
        if machine._core.timers or machine._wake is not None:
            machine._arm()
        if machine._arrivals and hasattr(self.context, "trigger"):
            # Sent by an action, or in the middle of the cycle; told once this one is over.
            self._rt_host.loop.call_soon(self._rt_trigger)

    def _rt_elsewhere(self) -> bool:
        """Whether another context has the component active: the machine is one, whoever runs it."""
        return any(member.state is _ACTIVE for member in self._rt_members)


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
    if not self._rt_elsewhere():
        _run(self.machine._begin())
        self._rt_after()


def _deactivated(self: StateMachineComponent) -> None:
    """Leave everything, whatever raises on the way."""
    if self._rt_elsewhere():
        return
    try:
        _run(self.machine._end())
    finally:
        if self.machine._core.states:
            _deactivated(self)
        self._rt_after()


def _execute(self: StateMachineComponent) -> None:
    """One cycle: timers, events, activities."""
    _run(self.machine._cycle())
    self._rt_after()
    if self._rt_host.threaded and not self._rt_host.realtime and getattr(self.context, "rate", None) is None:
        time.sleep(_PAUSE)


async def _activated_awaiting(self: StateMachineComponent) -> None:
    """Enter the initial configuration."""
    if not self._rt_elsewhere():
        await _run_awaiting(self.machine._begin())
        self._rt_after()


async def _deactivated_awaiting(self: StateMachineComponent) -> None:
    """Leave everything, whatever raises on the way."""
    if self._rt_elsewhere():
        return
    try:
        await _run_awaiting(self.machine._end())
    finally:
        if self.machine._core.states:
            await _deactivated_awaiting(self)
        self._rt_after()


async def _execute_awaiting(self: StateMachineComponent) -> None:
    """One cycle: timers, events, activities."""
    await _run_awaiting(self.machine._cycle())
    self._rt_after()


_PLAIN: Final = dict(zip(_HOOKS, (_activated, _deactivated, _execute), strict=True))
_AWAITING: Final = dict(zip(_HOOKS, (_activated_awaiting, _deactivated_awaiting, _execute_awaiting), strict=True))
_OURS: Final = frozenset((*_PLAIN.values(), *_AWAITING.values()))
"""The machine's hooks; what wraps one of them (`functools.wraps`) may stand in its place."""
