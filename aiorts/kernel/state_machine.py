"""The machine of one component: what is active now, a way to send it an event, and what it does in a cycle.

It says what is to be called, one action after the other (`Calls`); the hooks in `machine.py` call it, with or without
awaiting.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts.errors import DeclarationError, StateError
from aiorts.kernel.acts import Acting, acting
from aiorts.kernel.bus import Event
from aiorts.kernel.event_port import event_of
from aiorts.kernel.machine_events import MachineAfter, MachineBefore, MachineChanged, MachineEnded
from aiorts.kernel.ports import InPort
from aiorts.model.charting import Chart, hint
from aiorts.model.interpreter import Machine, MachineEvent, Steps
from aiorts.model.microstep import ENTRY, EXIT
from aiorts.model.statechart import Act

if TYPE_CHECKING:
    from aiorts.kernel.host import Cancellable
    from aiorts.kernel.machine import StateMachineComponent
    from aiorts.kernel.modes import Participant
    from aiorts.model.chart_structure import StateStructure

__all__ = ("Calls", "StateMachine")

Calls: TypeAlias = Generator[tuple[Callable[..., Any], tuple[Any, ...]], None, None]
"""What is to be called, one after the other, each with its arguments."""
_QUEUED: Final = 8192
"""Events that `send` takes while none is carried out, and arrivals at ports whose order is kept."""
_CHANGING: Final = (ENTRY, EXIT)


class StateMachine:
    """The machine of one component: what is active now, and a way to send it an event."""

    __slots__ = (
        "_acting",
        "_arrivals",
        "_component",
        "_core",
        "_events",
        "_known",
        "_naming",
        "_participants",
        "_wake",
        "_watched",
    )

    def __init__(self, component: StateMachineComponent, chart: Chart) -> None:
        self._component = component
        self._core = Machine(chart, self._says_yes, self._delay_ns, self._now_ns)
        self._acting: dict[Act, Acting] = {}
        self._events: dict[InPort[Any], str] = {}
        self._arrivals: deque[InPort[Any] | MachineEvent] = deque()
        self._wake: tuple[int, Cancellable] | None = None
        self._known = chart.events
        """Events that were looked at already: of one that nobody cares for it is said once."""
        self._naming: set[InPort[Any]] = set()
        self._watched = False
        self._participants: tuple[Participant, ...] = ()

    # -- what anybody may ask --------------------------------------------------------------------------------------

    @property
    def chart(self) -> Chart:
        """The table that runs."""
        return self._core.chart

    @property
    def configuration(self) -> tuple[str, ...]:
        """The names of the active states, the outer before the inner; empty while the component is not active.

        While an action runs: what was entered and not yet left.
        """
        return self._core.configuration

    @property
    def structure(self) -> StateStructure:
        """The table that runs, frozen: states, transitions, actions, timers."""
        return self.chart.structure

    def to_mermaid(self) -> str:
        """The diagram of the table that runs, what is active now marked."""
        return self.chart.to_mermaid(self.configuration)

    def _repr_markdown_(self) -> str:
        return f"```mermaid\n{self.to_mermaid()}```\n"

    @property
    def event(self) -> str:
        """The name of the event that is being carried out; "" where there is none."""
        return "" if self._core.event is None else self._core.event.name

    @property
    def ignored(self) -> int:
        """Events that led to nothing."""
        return self._core.ignored

    @property
    def timers(self) -> Mapping[str, int]:
        """Each timer that runs, as "after.<state>.<n>", and when it is due on the clock's `monotonic_ns`."""
        return {self.chart.arcs[index].event: when for index, (when, _) in dict(self._core.timers).items()}

    def is_in(self, state: str) -> bool:
        """Whether a state is active; DeclarationError where the chart has none of that name."""
        return bool(self._core.states >> self.chart.number(state) & 1)

    def send(self, event: str, data: Any = None) -> None:
        """Queue an event behind those that have come already. Outside of hooks it wakes an event context.

        Raises:
            StateError: the component is not active, or 8192 events wait.
        """
        component = self._component
        if component._rt_kernel is not None and not component._rt_own_thread():
            component._rt_kernel.check_thread(f"{component.name}: send")
        self._check(event)
        if not self._core.states:
            raise StateError(f"{component.name}: send({event!r}): the machine does not run; activate the component")
        if len(self._arrivals) >= _QUEUED:
            raise StateError(f"{component.name}: send({event!r}): {_QUEUED} events wait already")
        self._arrivals.append(MachineEvent(event, data))
        if component._rt_running is None:
            component._rt_trigger()

    def raise_event(self, event: str, data: Any = None) -> None:
        """From an action: an event to be carried out as part of this one, before any other.

        Raises:
            StateError: no action of this machine runs.
        """
        self._check(event)
        if self._component._rt_running is None or not self._core.states:
            raise StateError(f"{self._component.name}: raise_event({event!r}): only an action can; use send")
        self._core.raise_event(MachineEvent(event, data))

    def add_participant(self, component: Participant) -> None:
        """Have the component's `on_action` run, in its own context, after each change of the configuration.

        Until it is removed; made anew by supervision it is told as before. DeclarationError: not a `Participant`.
        """
        if not hasattr(component, "_rt_machines"):
            raise DeclarationError(f"{self._component.name}: expected a Participant, got {component!r:.80}")
        if component not in self._participants:
            self._participants = (*self._participants, component)
            component._rt_machines = (*component._rt_machines, self)

    def remove_participant(self, component: Participant) -> None:
        """Tell it no more; nothing where it was not told."""
        self._participants = tuple(one for one in self._participants if one is not component)
        component._rt_machines = tuple(one for one in component._rt_machines if one is not self)

    def _check(self, event: str) -> None:
        if not self.chart.knows(event):
            raise DeclarationError(
                f"{self._component.name}: no transition is for event {event!r}{hint(event, self.chart.events)}"
            )

    def __repr__(self) -> str:
        return f"<StateMachine {self._component.name} {' '.join(self.configuration) or 'not running'}>"

    # -- what the interpreter asks ---------------------------------------------------------------------------------

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
        return round(float(value) * 1e9)

    def _now_ns(self) -> int:
        return self._component.clock.monotonic_ns()

    # -- what a cycle does -----------------------------------------------------------------------------------------

    def _begin(self) -> Calls:
        self._arrivals.clear()
        self._watched = self._look_who_watches()
        yield from self._perform(self._core.start(), "")

    def _end(self) -> Calls:
        self._watched = self._look_who_watches()
        yield from self._perform(self._core.stop(), "")

    def _cycle(self) -> Calls:
        core = self._core
        if not core.states:
            return
        self._watched = self._look_who_watches()
        now_ns = self._now_ns() if core.timers else 0
        while (event := core.due(now_ns)) is not None and not core.ended:
            yield from self._perform(core.handle(event), event.name)
        for event in self._taken():
            yield from self._perform(core.handle(event), event.name)
            if core.ended:
                break
        if core.chart.doing & core.states and not core.ended:
            yield from self._perform(core.do(), "")

    def _taken(self) -> Iterator[MachineEvent]:
        """The events that had come when the cycle began, in the order of arrival: what comes meanwhile is for the
        next, so that every cycle ends."""
        arrivals, events = self._arrivals, self._events
        # Most connectors name no event: then it is not asked which of them a sample came through.
        self._naming = {port for port in events if any(each.profile.extra for each in port.connectors)}
        left = {port: sum(each.unread for each in port.connectors) or 1 for port in events if port.is_new}
        for _ in range(len(arrivals)):
            item = arrivals.popleft()
            if isinstance(item, MachineEvent):
                yield item
            elif item in left:
                left[item] -= 1
                if item.is_new:
                    yield self._read(item)
        for port, count in left.items():
            # What another thread wrote may have been told of together; a pull connector tells nothing.
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

    def _arrived(self, port: InPort[Any]) -> None:
        """Note who came when: between ports, too, the machine takes events in the order of arrival."""
        port._armed = True
        if len(self._arrivals) < _QUEUED:
            self._arrivals.append(port)

    def _listen(self, port: InPort[Any], event: str) -> None:
        self._events[port] = event
        port._wakes += (self._arrived,)
        port._arm()

    # -- the actions of a step, and who is told --------------------------------------------------------------------

    def _perform(self, steps: Steps, event: str) -> Calls:
        """Carry out steps: their actions are called by whoever drives this, one after the other."""
        core = self._core
        before = core.states
        try:
            if self._watched:
                yield from self._perform_watched(steps, event)
            else:
                for step in steps:
                    for act in step.acts:
                        function, takes = self._act(act)
                        yield function, ((None if core.event is None else core.event.data,) if takes else ())
        finally:
            # Not left to whoever collects it: what was being left has now been left.
            steps.close()
            if core.states != before:
                self._changed(before, event)
        if core.ended and core.states:
            yield from self._perform(core.stop(), event)
            self._publish(MachineEnded(self._component.name))
            self._component.finish()

    def _perform_watched(self, steps: Steps, event: str) -> Calls:
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
                kernel._on_loop(partial(one._rt_told, change))

    def _look_who_watches(self) -> bool:
        bus = self._component.kernel.bus
        self._core.every = watched = bus.wants(MachineBefore) or bus.wants(MachineAfter)
        return watched

    def _publish(self, event: Event) -> None:
        self._component.context._publish(event)

    # -- timers in a context that sleeps until somebody wakes it ----------------------------------------------------

    def _arm(self) -> None:
        """Have the context woken when the next timer is due."""
        deadline = self._core.next_deadline
        wake = self._wake
        if wake is not None:
            if wake[0] == deadline:
                return
            wake[1].cancel()
            self._wake = None
        if deadline is not None and hasattr(self._component.context, "trigger"):
            self._wake = deadline, self._component.kernel._call_at(deadline, self._component._rt_trigger)
