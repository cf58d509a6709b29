"""Interprets a chart: configuration, history, timers, queued events. It never waits, logs or reads a clock.

`Machine.handle` is a generator of the steps of one event: its driver performs the actions of each step before it asks
for the next. One event is carried out completely, with all that follows from it (events that actions raise, transitions
without event), before the next begins.

A state is active from before its entry action until after its exit action. When an action raises, the driver closes the
generator: the rest of the event is dropped, and `configuration` is exactly what was entered and not yet left, so that
`stop` runs the exit action of each of those states and of no other, and none twice.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from typing import Any, Final, NamedTuple, TypeAlias

from aiorts.errors import StateError
from aiorts.statemachines.charting import ALWAYS, Arc, Chart
from aiorts.statemachines.microstep import DO, ENTRY, EXIT, Plan, Step, beginning, chosen, defers, ending
from aiorts.statemachines.statechart import Act

Steps: TypeAlias = Generator[Step, None, None]
ENDLESS: Final = 1000
"""The most microsteps of one event; more count as an endless loop."""
DEFERRED: Final = 8192
"""The most deferred events that a machine keeps."""


class MachineEvent(NamedTuple):
    """An event for a machine."""

    name: str
    data: Any = None
    """Its data: a port's sample, or the argument of `send`."""
    is_own: bool = False
    """Whether the machine made the event: for a timer, or "done.state.<name>"; "*" does not match such events."""


class Machine:
    """One machine on a chart.

    Args:
        says_yes: evaluates a guard for the current event.
        delay_ns: the delay of an `After`, in nanoseconds.
        now_ns: the time, read when a state with timers is entered.
    """

    __slots__ = (
        "_delay_ns",
        "_internal",
        "_now_ns",
        "_says_yes",
        "_timed",
        "chart",
        "deferred",
        "ended",
        "event",
        "every",
        "history",
        "ignored",
        "states",
        "timers",
    )

    def __init__(
        self,
        chart: Chart,
        says_yes: Callable[[Act, MachineEvent | None], bool],
        delay_ns: Callable[[float | str], int] = lambda seconds: round(float(seconds) * 1e9),
        now_ns: Callable[[], int] = lambda: 0,
    ) -> None:
        self.chart = chart
        self.states = 0
        """The active states, as bits."""
        self.history: tuple[int, ...] = (0,) * len(chart.histories)
        self.event: MachineEvent | None = None
        """The event that is being carried out."""
        self.every = True
        """Whether steps without an action are yielded, too."""
        self.ended = False
        """Whether a final state at the top was entered."""
        self.ignored = 0
        """The number of events from outside, and of timers, without any effect."""
        self.deferred: deque[MachineEvent] = deque()
        """Events that are kept until no active state defers them."""
        self.timers: dict[int, tuple[int, int]] = {}
        """Transition -> the deadline and the number of its timer: timers due together fire in the order of numbers."""
        self._timed = 0
        self._internal: deque[MachineEvent] = deque()
        self._says_yes = says_yes
        self._delay_ns = delay_ns
        self._now_ns = now_ns

    @property
    def configuration(self) -> tuple[str, ...]:
        """The names of the active states, the outer before the inner."""
        return self.chart.names(self.states)

    def raise_event(self, event: MachineEvent) -> None:
        """Queue an event that comes before any event from outside."""
        if len(self._internal) >= ENDLESS:
            raise StateError(f"{event.name}: {ENDLESS} events were raised and not carried out")
        self._internal.append(event)

    # -- what happens ----------------------------------------------------------------------------------------------

    def start(self) -> Steps:
        """Enter the initial configuration, with what follows from it."""
        self._internal.clear()
        self.deferred.clear()
        self.timers.clear()
        self.states, self.ended, self.event = 0, False, None
        if not self.chart.keep_history:
            self.history = (0,) * len(self.chart.histories)
        yield from self._carry_out(beginning(self.chart, self.history))
        yield from self._settle()

    def handle(self, event: MachineEvent) -> Steps:
        """Carry out an event with all that follows; if no transition takes it, only transitions without event."""
        self.event = event
        plan = chosen(self.chart, self.states, self.history, event.name, self._guard, not event.is_own)
        if plan is not None:
            yield from self._carry_out(plan)
            yield from self._settle()
        else:
            self.ignored += not self._defer(event)
            if self.chart.restless:
                yield from self._settle()
        self.event = None

    def recalled(self) -> MachineEvent | None:
        """Remove and return the oldest deferred event that a transition takes now, or no active state defers any more.

        The caller handles it before any newer one. A state may both defer an event and have a transition for it whose
        guard was false before: the order of arrival is kept, as UML has it for the events in a machine's pool.
        """
        for place, event in enumerate(self.deferred):
            if not self.ended and (not defers(self.chart, self.states, event.name) or self._takes(event)):
                del self.deferred[place]
                return event
        return None

    def _takes(self, event: MachineEvent) -> bool:
        """Whether a transition would be taken for this event now."""
        now, self.event = self.event, event
        try:
            return chosen(self.chart, self.states, self.history, event.name, self._guard, True) is not None
        finally:
            self.event = now

    def look(self) -> Steps:
        """Take transitions without event whose guards have become true."""
        yield from self._settle()

    def do(self) -> Steps:
        """Run the actions that active states have for each cycle, the outer before the inner."""
        active = self.chart.doing & self.states
        if active:
            for node in self.chart.nodes:
                if active & self.states & node.bit:
                    yield Step(DO, node.index, node.do)
            yield from self._settle()

    def stop(self) -> Steps:
        """Leave all states, from the inside out."""
        self._internal.clear()
        self.ignored += len(self.deferred)
        self.deferred.clear()
        self.timers.clear()
        for step in ending(self.chart, self.states):
            try:
                yield step
            finally:
                self.states &= ~(1 << step.state)
        self.event = None

    def due(self, now_ns: int) -> MachineEvent | None:
        """Remove the first timer that is due, and return its event."""
        if not self.timers:
            return None
        (deadline, _), index = min((when, index) for index, when in self.timers.items())
        if deadline > now_ns:
            return None
        del self.timers[index]
        return MachineEvent(self.chart.arcs[index].event, is_own=True)

    @property
    def next_deadline(self) -> int | None:
        """The deadline of the next timer; None without one."""
        return min(self.timers.values())[0] if self.timers else None

    # -- one microstep after the other -----------------------------------------------------------------------------

    def _guard(self, arc: Arc) -> bool:
        return all(self._says_yes(guard, self.event) for guard in arc.asks)

    def _defer(self, event: MachineEvent) -> bool:
        """Keep an event that no transition takes if an active state defers it; return whether it is kept."""
        if event.is_own or not self.chart.deferring & self.states or not defers(self.chart, self.states, event.name):
            return False
        if len(self.deferred) >= DEFERRED:
            raise StateError(f"{event.name}: {DEFERRED} events are deferred; none more is kept")
        self.deferred.append(event)
        return True

    def _settle(self) -> Steps:
        """Carry out what follows without an event from outside."""
        chart, internal = self.chart, self._internal
        for _ in range(ENDLESS):
            if self.ended:
                return
            plan = None
            if chart.restless:
                plan = chosen(chart, self.states, self.history, ALWAYS, self._guard, False)
            if plan is None:
                if not internal:
                    return
                event = self.event = internal.popleft()
                plan = chosen(chart, self.states, self.history, event.name, self._guard, not event.is_own)
                if plan is None:
                    self._defer(event)
            if plan is not None:
                yield from self._carry_out(plan)
        raise StateError(
            f"{', '.join(self.configuration)}: {ENDLESS} transitions followed from one event; never settles"
        )

    def _carry_out(self, plan: Plan) -> Steps:
        for watch in self.chart.watchers:
            watch(plan)
        self.history = plan.history
        for step in plan.steps:
            what = step.what
            if what is ENTRY:
                self.states |= 1 << step.state
                self._arm(step.state)
                if step.acts or self.every:
                    yield step
                for name in step.raises:
                    self.raise_event(MachineEvent(name, is_own=True))
            elif what is EXIT:
                try:
                    if step.acts or self.every:
                        yield step
                finally:
                    self.states &= ~(1 << step.state)
                    if self.timers:
                        self._disarm(step.state)
            else:
                yield step
        self.ended = self.ended or plan.ends

    def _arm(self, state: int) -> None:
        for arc in self.chart.nodes[state].arcs:
            if arc.delay is not None:
                self._timed += 1
                # At least 1 ns: a timer that is due at once would be due again without end.
                self.timers[arc.index] = self._now_ns() + max(self._delay_ns(arc.delay), 1), self._timed

    def _disarm(self, state: int) -> None:
        for arc in self.chart.nodes[state].arcs:
            self.timers.pop(arc.index, None)
