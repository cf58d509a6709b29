"""The machine of one component: its active states, a way to send it events, and its work in a cycle.

It yields the calls to make, one action after the other (`Calls`); the hooks in `machine.py` make them, with or without
awaiting.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts.clock import to_ns
from aiorts.errors import DeclarationError, StateError
from aiorts.kernel.execution.cell import MadeByClass, cell
from aiorts.kernel.loop.bus import Event
from aiorts.kernel.ports import InPort
from aiorts.kernel.ports.connector import unread_at
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.model.lifecycle import LifecycleState
from aiorts.statemachines.actions import Acting, acting
from aiorts.statemachines.charting import Chart, hint
from aiorts.statemachines.event_port import event_of
from aiorts.statemachines.interpreter import Machine, MachineEvent, Steps
from aiorts.statemachines.machine_events import MachineAfter, MachineBefore, MachineChanged, MachineEnded
from aiorts.statemachines.microstep import ENTRY, EXIT
from aiorts.statemachines.modes import Participant, notifiers_of, notify, set_notifiers
from aiorts.statemachines.statechart import Act

if TYPE_CHECKING:
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.statemachines.chart_structure import StateStructure
    from aiorts.statemachines.machine import StateMachineComponent

Calls: TypeAlias = Generator[tuple[Callable[..., Any], tuple[Any, ...]], None, None]
"""Functions to call, one after the other, each with its arguments."""
QUEUED: Final = 8192
"""Events that `send` takes while none is carried out, arrivals at ports whose order is kept, and the default length
of a connector into an event port."""
_CHANGING: Final = (ENTRY, EXIT)


class StateMachine(MadeByClass):
    """The machine of one component: its active states, and a way to send it events."""

    __slots__ = (
        "_acting",
        "_arrivals",
        "_component",
        "_core",
        "_events",
        "_known",
        "_lost",
        "_naming",
        "_observed",
        "_participants",
        "_wake",
    )

    def __init__(self, component: StateMachineComponent, chart: Chart) -> None:
        self._component = component
        self._core = Machine(chart, self._says_yes, self._delay_ns, self._now_ns)
        self._acting: dict[Act, Acting] = {}
        self._events: dict[InPort[Any], str] = {}
        self._arrivals: deque[InPort[Any] | MachineEvent] = deque()
        self._wake: tuple[int, Cancellable] | None = None
        self._known = chart.events
        """Events seen before: one without any transition is logged once."""
        self._naming: set[InPort[Any]] = set()
        self._lost = 0
        """The number of events without room that have been logged."""
        self._observed = False
        self._participants: tuple[Participant, ...] = ()

    # -- for users -------------------------------------------------------------------------------------------------

    @property
    def chart(self) -> Chart:
        """The chart that the machine runs."""
        return self._core.chart

    @property
    def configuration(self) -> tuple[str, ...]:
        """The names of the active states, the outer before the inner; empty while the component is not active.

        While an action runs: the states entered and not yet left.
        """
        return self._core.configuration

    @property
    def structure(self) -> StateStructure:
        """The chart's table as frozen values: states, transitions, actions, timers."""
        return self.chart.structure

    def to_mermaid(self) -> str:
        """The diagram of the chart, with the active states marked."""
        return self.chart.to_mermaid(self.configuration)

    def _repr_markdown_(self) -> str:
        return f"```mermaid\n{self.to_mermaid()}```\n"

    @property
    def event(self) -> str:
        """The name of the event that is being carried out; "" when there is none."""
        return "" if self._core.event is None else self._core.event.name

    @property
    def ignored(self) -> int:
        """The number of events without effect."""
        return self._core.ignored

    @property
    def deferred(self) -> tuple[str, ...]:
        """The names of the events that active states defer, in the order of arrival."""
        return tuple(event.name for event in tuple(self._core.deferred))

    @property
    def timers(self) -> Mapping[str, int]:
        """Each running timer, as "after.<state>.<n>", and when it is due on the clock's `monotonic_ns`."""
        return {self.chart.arcs[index].event: when for index, (when, _) in dict(self._core.timers).items()}

    def is_in(self, state: str) -> bool:
        """Whether a state is active; DeclarationError when the chart has none of that name."""
        return bool(self._core.states >> self.chart.number(state) & 1)

    def send(self, event: str, data: Any = None) -> None:
        """Queue an event after those that have arrived. A call outside of hooks wakes an event context.

        Raises:
            StateError: the component is not active, or 8192 events wait.
            DeclarationError: the chart has no transition for this event.
        """
        component = self._component
        kernel = cell(component).kernel
        if kernel is not None and cell(component).thread_id != threading.get_ident():
            kernel.check_thread(f"{component.name}: send")
        self._check(event)
        if not self._core.states:
            raise StateError(f"{component.name}: send({event!r}): the machine does not run; activate the component")
        if len(self._arrivals) >= QUEUED:
            raise StateError(f"{component.name}: send({event!r}): {QUEUED} events wait already")
        self._arrivals.append(MachineEvent(event, data))
        if cell(component).running is None:
            self._trigger()

    def raise_event(self, event: str, data: Any = None) -> None:
        """Raise an event from an action: it is carried out as part of the current one, before any other.

        Raises:
            StateError: no action of this machine runs.
            DeclarationError: the chart has no transition for this event.
        """
        self._check(event)
        if cell(self._component).running is None or not self._core.states:
            raise StateError(f"{self._component.name}: raise_event({event!r}): only an action can; use send")
        self._core.raise_event(MachineEvent(event, data))

    def add_participant(self, component: Participant) -> None:
        """Run the component's `on_action`, in its own context, after each change of the configuration.

        It ends when the participant is removed; a new instance made by supervision takes its place. DeclarationError:
        `component` is no `Participant`.
        """
        if not isinstance(component, Participant):
            raise DeclarationError(f"{self._component.name}: expected a Participant, got {component!r:.80}")
        if component not in self._participants:
            self._participants = (*self._participants, component)
            set_notifiers(component, (*notifiers_of(component), self))

    def participants_replaced(self, pairs: Mapping[Any, Any]) -> None:
        """Notify new instances (the values) from now on, in place of the old ones."""
        self._participants = tuple(pairs.get(one, one) for one in self._participants)

    def remove_participant(self, component: Participant) -> None:
        """Stop notifying a participant; without effect for a component that is none."""
        self._participants = tuple(one for one in self._participants if one is not component)
        set_notifiers(component, tuple(one for one in notifiers_of(component) if one is not self))

    def _trigger(self) -> None:
        """Make the machine check for work: an event context is notified, others check in every cycle."""
        for member in cell(self._component).members:
            trigger = getattr(member.context, "trigger", None)
            if trigger is not None and member.state is LifecycleState.ACTIVE:
                trigger(self._component)

    def _check(self, event: str) -> None:
        if not self.chart.knows(event):
            raise DeclarationError(
                f"{self._component.name}: no transition is for event {event!r}{hint(event, self.chart.events)}"
            )

    def __repr__(self) -> str:
        return f"<StateMachine {self._component.name} {' '.join(self.configuration) or 'not running'}>"

    # -- for the interpreter ---------------------------------------------------------------------------------------

    def _act(self, act: Act) -> Acting:
        found = self._acting.get(act)
        if found is None:
            found = self._acting[act] = acting(self._component, act)
        return found

    def _says_yes(self, guard: Act, event: MachineEvent | None) -> bool:
        function, takes = self._act(guard)
        return bool(function(None if event is None else event.data) if takes else function())

    def _delay_ns(self, seconds: float | str) -> int:
        value = getattr(self._component, seconds) if isinstance(seconds, str) else seconds
        return to_ns(float(value))

    def _now_ns(self) -> int:
        return self._component.clock.monotonic_ns()

    # -- what a cycle does -----------------------------------------------------------------------------------------

    def _begin(self) -> Calls:
        self._arrivals.clear()
        self._observed = self._update_observed()
        yield from self._perform(self._core.start(), "")

    def _end(self) -> Calls:
        self._observed = self._update_observed()
        yield from self._perform(self._core.stop(), "")

    def _cycle(self) -> Calls:
        core = self._core
        if not core.states:
            return
        self._observed = self._update_observed()
        if core.chart.restless:
            yield from self._perform(core.look(), "")
            yield from self._recall()
        now_ns = self._now_ns() if core.timers else 0
        while (event := core.due(now_ns)) is not None and not core.ended:
            yield from self._perform(core.handle(event), event.name)
            yield from self._recall()
        if core.deferred:
            yield from self._recall()  # a guard may be true by now
        for event in self._taken():
            yield from self._perform(core.handle(event), event.name)
            if core.deferred:
                yield from self._recall()
            if core.ended:
                break
        if core.chart.doing & core.states and not core.ended:
            yield from self._perform(core.do(), "")
            yield from self._recall()

    def _recall(self) -> Calls:
        """Carry out the events that no state defers any more, before any newer event."""
        core = self._core
        while (event := core.recalled()) is not None:
            yield from self._perform(core.handle(event), event.name)

    def _taken(self) -> Iterator[MachineEvent]:
        """The events that had arrived when the cycle began, in order; later ones wait, so that each cycle ends."""
        arrivals, events = self._arrivals, self._events
        if len(arrivals) >= QUEUED:
            self._component.kernel.call_on_loop(self._report_lost)
        # Most connectors name no event; then the connector of a sample does not matter.
        self._naming = {port for port in events if any(each.profile.extra for each in port.connectors)}
        left = {port: unread_at(port) or 1 for port in events if port.is_new}
        for _ in range(len(arrivals)):
            item = arrivals.popleft()
            if isinstance(item, MachineEvent):
                yield item
            elif item in left:
                left[item] -= 1
                if item.is_new:
                    yield self._read(item)
        for port, count in left.items():
            # Writes of another thread may share one notification; a pull connector sends none.
            for _ in range(count):
                if not port.is_new:
                    break
                yield self._read(port)

    def _read(self, port: InPort[Any]) -> MachineEvent:
        sample = port.read_nowait()
        event = self._events[port]
        if port in self._naming:
            event = event_of(port.last_source, event)
        if event not in self._known:
            self._known |= {event}
            if not self.chart.knows(event):
                self._component.log.warning(
                    "%s: no transition is for event %r%s", port.name, event, hint(event, self.chart.events)
                )
        return MachineEvent(event, sample)

    def _arrived(self, port: InPort[Any]) -> bool:
        """Record an arrival at a port, so that the machine takes the events of all ports in the order of arrival."""
        if len(self._arrivals) < QUEUED:
            self._arrivals.append(port)
        return True

    def _report_lost(self) -> None:
        """Log how many events found no room since the last log entry; runs on the loop, where ledgers are read."""
        connectors = [each for port in self._events for each in port.connectors if each.profile.length == QUEUED]
        before, self._lost = self._lost, sum(each.statistics.dropped.get("overwritten", 0) for each in connectors)
        if self._lost > before:
            self._component.log.warning(
                "%d events were dropped: more than %d waited; run it more often, or connect with full='block'",
                self._lost - before,
                QUEUED,
            )

    def _listen(self, port: InPort[Any], event: str) -> None:
        self._events[port] = event
        if port.length is None:
            port.length = QUEUED  # no event is lost before the machine's own queue is full
        receiver_of(port).add_callback(self._arrived)

    # -- the actions of a step, and notifications ------------------------------------------------------------------

    def _perform(self, steps: Steps, event: str) -> Calls:
        """Carry out steps: the caller calls their actions one after the other."""
        core = self._core
        before = core.states
        try:
            if self._observed:
                yield from self._perform_observed(steps, event)
            else:
                for step in steps:
                    for act in step.acts:
                        function, takes = self._act(act)
                        yield function, ((None if core.event is None else core.event.data,) if takes else ())
        finally:
            # The generator is closed now, not by the garbage collector: states that an event was leaving count as left.
            steps.close()
            if core.states != before:
                self._changed(before, event)
        if core.ended and core.states:
            yield from self._perform(core.stop(), event)
            self._publish(MachineEnded(self._component.name))
            self._component.finish()

    def _perform_observed(self, steps: Steps, event: str) -> Calls:
        core, name = self._core, self._component.name
        changing = False
        what = state = ""
        try:
            for step in steps:
                what, state = step.what, core.chart.nodes[step.state].name if step.state else ""
                if not changing and what in _CHANGING:
                    changing = True
                    self._publish(MachineBefore(name, "state_change", "", event))
                self._publish(MachineBefore(name, what, state, event))
                for act in step.acts:
                    function, takes = self._act(act)
                    yield function, ((None if core.event is None else core.event.data,) if takes else ())
                self._publish(MachineAfter(name, what, state, event))
        except BaseException as error:
            self._publish(MachineAfter(name, what, state, event, error))
            if changing:
                self._publish(MachineAfter(name, "state_change", "", event, error))
            raise
        if changing:
            self._publish(MachineAfter(name, "state_change", "", event))

    def _changed(self, before: int, event: str) -> None:
        kernel = self._component.kernel
        if self._participants or kernel.bus.wants(MachineChanged):
            old = self.chart.names(before)
            change = MachineChanged(self._component.name, old, self.configuration, event)
            self._publish(change)
            for one in self._participants:
                kernel.call_on_loop(partial(notify, one, change))

    def _update_observed(self) -> bool:
        bus = self._component.kernel.bus
        self._core.every = observed = bus.wants(MachineBefore) or bus.wants(MachineAfter)
        return observed

    def _publish(self, event: Event) -> None:
        self._component.context.runner.publish(event)

    # -- timers in a context that sleeps until it is woken -----------------------------------------------------------

    def _arm(self) -> None:
        """Wake the context when the next timer is due."""
        deadline = self._core.next_deadline
        wake = self._wake
        if wake is not None:
            if wake[0] == deadline:
                return
            wake[1].cancel()
            self._wake = None
        if deadline is not None and hasattr(self._component.context, "trigger"):
            self._wake = deadline, self._component.kernel.call_at(deadline, self._trigger)
