"""Finds a shortest path to each transition of a chart, for tests: a search in breadth with the interpreter itself."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from aiorts.clock import to_ns
from aiorts.errors import DeclarationError, StateError
from aiorts.kernel.declarations import declarations
from aiorts.late import dataclass
from aiorts.statemachines.chart_structure import condition_of
from aiorts.statemachines.charting import Arc, Chart
from aiorts.statemachines.coverage import transition_text
from aiorts.statemachines.interpreter import Machine, MachineEvent, Steps

if TYPE_CHECKING:
    from aiorts.statemachines.machine import StateMachineComponent

_NONE: Final[Mapping[str, bool]] = MappingProxyType({})
_ANY: Final = "any"
"""An event that only a transition for "*" takes."""


@dataclass(frozen=True, slots=True)
class Move:
    """One step of a path: send an event, let time pass, or, with neither, run a cycle."""

    event: str = ""
    """The event sent to the machine; "" for none."""
    seconds: float = 0.0
    """Seconds until the next timer of the machine is due."""
    guards: Mapping[str, bool] = field(default_factory=lambda: _NONE)
    """The answers that guards must give in this move, by name."""

    def __str__(self) -> str:
        what = self.event or (f"{self.seconds:g} s" if self.seconds else "cycle")
        answers = ", ".join(f"{name}={answer}" for name, answer in self.guards.items())
        return f"{what} [{answers}]" if answers else what


@dataclass(frozen=True, slots=True)
class ChartPath:
    """The shortest way from activation to a transition; its last move takes it."""

    transition: str
    """The transition in words, such as "closed button -> open"."""
    moves: tuple[Move, ...]
    """The moves; empty where the transition is taken in the activation itself."""
    guards: Mapping[str, bool]
    """The answers that guards must give in the activation, by name."""

    def __str__(self) -> str:
        return self.transition


@dataclass(frozen=True, slots=True)
class ChartPaths:
    """A path to each transition of a chart, in the order of writing."""

    paths: tuple[ChartPath, ...]
    unreached: tuple[str, ...]
    """Transitions to which no path was found."""


def chart_paths(
    chart: Chart | type[StateMachineComponent], *, delays: Mapping[str, float] | None = None, limit: int = 10_000
) -> ChartPaths:
    """A shortest path to each transition, found by trying every event, timer and answer of a guard.

    Actions are not run: no path knows what they send or change. The same chart gives the same paths.

    Args:
        chart: a chart, or a component class with one; then delays that are parameters have their defaults.
        delays: seconds of delays that are parameters.
        limit: moves that are tried before the rest counts as unreached.

    Raises:
        DeclarationError: a delay is a parameter whose value is not known.
    """
    known: dict[str, Any] = {}
    if not isinstance(chart, Chart):
        known = {name: spec.default for name, spec in declarations(chart).parameters.items()}
        chart = chart.chart
    search = _Search(chart, {**known, **(delays or {})}, limit)
    found = search.run()
    texts = {arc: transition_text(chart, arc) for arc in chart.arcs}
    return ChartPaths(
        tuple(ChartPath(text, found[arc][1], found[arc][0]) for arc, text in texts.items() if arc in found),
        tuple(text for arc, text in texts.items() if arc not in found),
    )


class _Situation(NamedTuple):
    """All that decides what a machine does next; times count from now."""

    states: int
    history: tuple[int, ...]
    timers: tuple[tuple[int, int], ...]
    """Transition and nanoseconds that are left, in the order of deadlines."""
    deferred: tuple[str, ...]


class _Unanswered(Exception):
    """A guard is asked for which this try has no answer."""


class _Search:
    """A search in breadth over the situations of a machine."""

    def __init__(self, chart: Chart, delays: Mapping[str, Any], limit: int) -> None:
        self._chart = chart
        self._delays = delays
        self._left = limit
        self._found: dict[Arc, tuple[Mapping[str, bool], tuple[Move, ...]]] = {}
        # The machine itself raises done.state when a final state is entered.
        self._events = sorted(event for event in chart.events if not event.startswith("done.state"))
        if any(arc.event == "*" for arc in chart.arcs):
            self._events.append(_ANY)

    def run(self) -> dict[Arc, tuple[Mapping[str, bool], tuple[Move, ...]]]:
        """Each transition that was reached: answers in the activation, and the moves."""
        todo: deque[tuple[_Situation, Mapping[str, bool], tuple[Move, ...]]] = deque()
        seen: set[_Situation] = set()
        nothing = _Situation(0, (0,) * len(self._chart.histories), (), ())

        def reached(answers: Mapping[str, bool], moves: tuple[Move, ...], now: _Situation | None) -> None:
            if now is not None and now not in seen:
                seen.add(now)
                todo.append((now, answers, moves))

        for answers, arcs, now in self._tries(nothing, None):
            self._note(arcs, answers, ())
            reached(answers, (), now)
        while todo and self._left > 0 and len(self._found) < len(self._chart.arcs):
            situation, first, before = todo.popleft()
            for move in self._moves(situation):
                for answers, arcs, now in self._tries(situation, move):
                    moves = (*before, Move(move.event, move.seconds, answers))
                    self._note(arcs, first, moves)
                    reached(first, moves, now)
        return self._found

    def _note(self, arcs: list[Arc], answers: Mapping[str, bool], moves: tuple[Move, ...]) -> None:
        for arc in arcs:
            self._found.setdefault(arc, (answers, moves))

    def _moves(self, situation: _Situation) -> Iterator[Move]:
        if self._chart.restless:
            yield Move()
        for event in self._events:
            yield Move(event)
        if situation.timers:
            yield Move(seconds=situation.timers[0][1] / 1e9)

    def _tries(
        self, situation: _Situation, move: Move | None
    ) -> Iterator[tuple[Mapping[str, bool], list[Arc], _Situation | None]]:
        """The outcome of a move for each set of answers that guards may give; None: the machine has ended."""
        todo: list[dict[str, bool]] = [{}]
        while todo and self._left > 0:
            self._left -= 1
            answers = todo.pop()
            arcs: list[Arc] = []
            try:
                now = self._tried(situation, move, answers, arcs)
            except _Unanswered as asked:
                todo += [{**answers, str(asked): answer} for answer in (False, True)]
                continue
            except StateError:
                continue  # it would never settle
            yield MappingProxyType(answers), arcs, now

    def _tried(
        self, situation: _Situation, move: Move | None, answers: Mapping[str, bool], arcs: list[Arc]
    ) -> _Situation | None:
        now_ns = 0

        def says_yes(guard: Any, _event: object) -> bool:
            name = condition_of((guard,)) or ""
            if name not in answers:
                raise _Unanswered(name)
            return answers[name]

        machine = Machine(self._chart, says_yes, self._delay_ns, lambda: now_ns)
        machine.states, machine.history = situation.states, situation.history
        count = len(situation.timers)
        machine.timers = {arc: (left, number - count) for number, (arc, left) in enumerate(situation.timers)}
        machine.deferred.extend(map(MachineEvent, situation.deferred))

        def carry_out(steps: Steps) -> None:
            for _ in steps:
                pass
            while (event := machine.recalled()) is not None:
                for _ in machine.handle(event):
                    pass

        watchers = self._chart.watchers
        self._chart.watchers = (lambda plan: arcs.extend(plan.arcs),)
        try:
            if move is None:
                carry_out(machine.start())
            elif move.event:
                carry_out(machine.handle(MachineEvent(move.event)))
            elif move.seconds:
                now_ns = situation.timers[0][1]
                event = machine.due(now_ns)
                assert event is not None  # noqa: S101 - it is when the first timer is due
                carry_out(machine.handle(event))
            else:
                carry_out(machine.look())
        finally:
            self._chart.watchers = watchers
        if machine.ended:
            return None
        timers = sorted((when, number, arc) for arc, (when, number) in machine.timers.items())
        left = tuple((arc, when - now_ns) for when, _, arc in timers)
        return _Situation(machine.states, machine.history, left, tuple(event.name for event in machine.deferred))

    def _delay_ns(self, delay: float | str) -> int:
        if not isinstance(delay, str):
            return to_ns(delay)
        if delay not in self._delays:
            raise DeclarationError(f"{self._chart.name or 'chart'}: After({delay!r}): say its seconds in delays=")
        return to_ns(float(self._delays[delay]))
