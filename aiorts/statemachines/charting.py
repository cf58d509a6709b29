"""Compiles a declared chart into the table that machines run, and finds every error that can be known beforehand.

States get numbers in the order of writing, the root is 0: a set of states is one integer with a bit for each, and
SCXML's document order is the order of numbers.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator
from dataclasses import field
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import DeclarationError
from aiorts.late import dataclass
from aiorts.spelling import suggestion
from aiorts.statemachines.statechart import (
    Act,
    Acts,
    After,
    Always,
    Guard,
    History,
    In,
    On,
    State,
    Way,
    acts_of,
    guards_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.statemachines.chart_structure import StateStructure
    from aiorts.statemachines.microstep import Plan

ROOT: Final = 0
ALWAYS: Final = ""
"""The event name of transitions that need no event."""
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,99}")


class ChartWarning(UserWarning):
    """A part of a chart that can never be reached."""


@dataclass(frozen=True, slots=True, eq=False)
class Arc:
    """One transition of the table that runs."""

    index: int
    source: int
    event: str
    """The event that triggers the transition; `ALWAYS` for none, "after.<state>.<n>" for a timer."""
    target: int | None
    guards: tuple[Guard, ...]
    """The guards as declared; guards about active states come first."""
    asks: tuple[Act, ...]
    """The guards that are methods or functions of the owner."""
    wants: int
    """States that must be active, as bits."""
    bars: int
    """States that must not be active, as bits."""
    acts: tuple[Act, ...]
    local: bool
    delay: float | str | None = None
    """Seconds of a timer, or the name of the parameter with the seconds."""


@dataclass(slots=True, eq=False)
class Node:
    """One state of the table that runs."""

    index: int
    name: str
    kind: str
    """"state", "parallel", "final", "history" or "deep"."""
    parent: int
    entry: tuple[Act, ...] = ()
    init: tuple[Act, ...] = ()
    exit: tuple[Act, ...] = ()
    do: tuple[Act, ...] = ()
    children: list[int] = field(default_factory=list)
    """States inside, without histories."""
    histories: list[int] = field(default_factory=list)
    initial: int = ROOT
    """For a state of which one inner state is active: the one entered by default; for a history: its default."""
    inside: int = 0
    """All states inside, as bits."""
    arcs: list[Arc] = field(default_factory=list)
    defer: tuple[str, ...] = ()
    """Events that are deferred while this state is active."""

    @property
    def bit(self) -> int:
        """This state as a set."""
        return 1 << self.index

    @property
    def compound(self) -> bool:
        """Whether exactly one of the states inside is active while this state is active."""
        return self.kind == "state" and bool(self.children)


class Chart:
    """A checked table of states and transitions, to be written in the body of a `StateMachineComponent`.

    Args:
        states: at the top, one of them initial.
        entry, init, exit, do: actions of the machine as a whole: run when the component is activated, and so on.
        keep_history: whether histories outlast a deactivation; else each activation begins without them.

    Raises:
        DeclarationError: the message has the state or transition, and what was expected.
    """

    def __init__(
        self,
        *states: State | History | Way,
        entry: Acts = None,
        init: Acts = None,
        exit: Acts = None,  # noqa: A002 - the word users expect
        do: Acts = None,
        keep_history: bool = False,
        name: str = "",
    ) -> None:
        self.name = name
        self.keep_history = keep_history
        self.states = states
        self.nodes: list[Node] = []
        self.arcs: list[Arc] = []
        self._numbers: dict[str, int] = {}
        self._written: list[tuple[Node, list[Way]]] = []
        self._defaults: list[tuple[int, str | None]] = []
        self._lay(State("root", *states, entry=entry, init=init, exit=exit, do=do), ROOT)
        self._connect()
        for node in self.nodes:
            _check_twins(node)
        self.histories: tuple[int, ...] = tuple(node.index for node in self.nodes if node.kind in _HISTORIES)
        self.doing: int = sum(node.bit for node in self.nodes if node.do)
        """The states with `do` actions for each cycle, as bits."""
        self.deferring: int = sum(node.bit for node in self.nodes if node.defer)
        """The states that defer events, as bits."""
        self.watchers: tuple[Callable[[Plan], object], ...] = ()
        """Functions called with each microstep of every machine on this chart, before it is carried out."""
        self.restless: bool = any(arc.event == ALWAYS for arc in self.arcs)
        """Whether there are transitions that need no event."""
        self.events: frozenset[str] = frozenset(arc.event for arc in self.arcs if arc.delay is None) - {ALWAYS, "*"}
        """The events that transitions name."""
        self.plans: dict[Any, Any] = {}
        """The plans that `microstep.py` has worked out already."""

    def __repr__(self) -> str:
        return f"<Chart {self.name} {len(self.nodes) - 1} states {len(self.arcs)} transitions>".replace("  ", " ")

    # -- for tools -------------------------------------------------------------------------------------------------

    def number(self, name: str) -> int:
        """A state's number; DeclarationError when there is no state of that name."""
        found = self._numbers.get(name)
        if found is None:
            raise DeclarationError(f"{name!r}: no such state{hint(name, self._numbers)}")
        return found

    def knows(self, event: str) -> bool:
        """Whether any transition has this event."""
        return event in self.events or any(arc.event == "*" or means(arc.event, event) for arc in self.arcs)

    def names(self, states: int) -> tuple[str, ...]:
        """The names of a set of states, in order, without the root."""
        return tuple(self.nodes[index].name for index in bits(states & ~1))

    @property
    def structure(self) -> StateStructure:
        """The chart's table as frozen values: its root with everything inside."""
        from aiorts.statemachines.chart_structure import structure_of

        return structure_of(self)

    def to_mermaid(self, active: tuple[str, ...] = ()) -> str:
        """The diagram of the table, for Mermaid; `active` states are marked."""
        from aiorts.statemachines.mermaid import write_mermaid

        return write_mermaid(self, active)

    def to_scxml(self) -> str:
        """The table as an SCXML document."""
        from aiorts.statemachines.scxml import write_scxml

        return write_scxml(self)

    @staticmethod
    def from_scxml(text: str) -> Chart:
        """The chart of an SCXML document; DeclarationError for parts that charts do not support."""
        from aiorts.statemachines.scxml import read_scxml

        return read_scxml(text)

    @property
    def acts(self) -> Iterator[tuple[str, Act, str]]:
        """Place, action, and event ("" for any) of every action that the table names."""
        for node in self.nodes:
            for what in ("entry", "init", "exit", "do"):
                for act in getattr(node, what):
                    yield f"{node.name if node.index else 'the chart'}, {what}", act, ""
            for arc in node.arcs:
                for act in arc.acts:
                    yield self.describe(arc), act, arc.event

    def describe(self, arc: Arc) -> str:
        """A transition in words."""
        source = self.nodes[arc.source].name
        how = "" if arc.event == ALWAYS else f" {arc.event}"
        return f"{source}{how} -> {source if arc.target is None else self.nodes[arc.target].name}"

    # -- laying out ------------------------------------------------------------------------------------------------

    def _lay(self, state: State, parent: int) -> Node:
        index = len(self.nodes)
        entry, init, leave, do = map(acts_of, (state.entry, state.init, state.exit, state.do))
        node = Node(index, self._named(state.name, index), state.kind, parent, entry, init, leave, do)
        node.defer = state.defer
        self.nodes.append(node)
        chosen = []
        for part in state.parts:
            if isinstance(part, History):
                self._lay_history(part, node)
            elif isinstance(part, State):
                child = self._lay(part, index)
                node.children.append(child.index)
                node.inside |= child.bit | child.inside
                if part.initial:
                    chosen.append(child)
            elif not isinstance(part, On | After | Always):
                raise DeclarationError(f"{state.name}: expected states and transitions, got {part!r}")
        where = "the chart" if index == ROOT else repr(state.name)
        if not node.children and (index == ROOT or node.kind == "parallel"):
            raise DeclarationError(f"{where}: has no state inside; expected at least one")
        if node.kind == "parallel" and chosen:
            raise DeclarationError(f"{where}: all of its regions are active at once; {chosen[0].name!r} is not initial")
        if node.kind == "state" and node.children:
            if len(node.children) == 1:
                chosen = [self.nodes[node.children[0]]]
            if len(chosen) != 1:
                names = ", ".join(self.nodes[child].name for child in node.children)
                given = " and ".join(repr(child.name) for child in chosen) or "none of them"
                raise DeclarationError(f"{where}: one of {names} needs initial=True; it says {given}")
            node.initial = chosen[0].index
        self._written.append((node, [part for part in state.parts if isinstance(part, On | After | Always)]))
        return node

    def _lay_history(self, history: History, parent: Node) -> None:
        index = len(self.nodes)
        name = self._named(history.name, index)
        self.nodes.append(Node(index, name, "deep" if history.deep else "history", parent.index))
        parent.histories.append(index)
        self._defaults.append((index, history.to))

    def _named(self, name: str, index: int) -> str:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise DeclarationError(f"state {name!r}: expected a name of letters, digits, '_' and '-'")
        if name in self._numbers or (name == "root" and index != ROOT):
            raise DeclarationError(
                f"state {name!r}: there is a state of that name already; names are unique in a chart"
            )
        if index != ROOT:
            self._numbers[name] = index
        return name

    def _connect(self) -> None:
        for index, to in self._defaults:
            node = self.nodes[index]
            parent = self.nodes[node.parent]
            if to is not None:
                node.initial = self._target(f"history {node.name!r}", to)
                fits = parent.children if node.kind == "history" else list(bits(parent.inside))
                if node.initial not in fits or self.nodes[node.initial].kind in _HISTORIES:
                    raise DeclarationError(f"history {node.name!r}: its default {to!r} is not inside {parent.name!r}")
            else:
                # A parallel state's own number stands for all of its regions.
                node.initial = parent.initial if parent.compound else parent.index
                if not parent.children:
                    raise DeclarationError(f"history {node.name!r}: {parent.name!r} has no state inside to remember")
        for node, _ in self._written:
            for event in node.defer:
                _check_event(f"{node.name!r}: defer", event)
        for node, ways in sorted(self._written, key=lambda pair: pair[0].index):
            timers = 0
            for way in ways:
                timers += isinstance(way, After)
                self._add_arc(node, way, timers)
        del self._written, self._defaults

    def _add_arc(self, node: Node, way: Way, timers: int) -> None:
        if node.index == ROOT and not isinstance(way, On):
            raise DeclarationError(f"the chart: {way!r}: stands outside of every state; put it into one")
        if node.kind == "final":
            raise DeclarationError(f"{node.name!r}: is final; nothing leads out of it")
        delay, event = None, ALWAYS
        if isinstance(way, After):
            delay, event = _delay(node.name, way.seconds), f"after.{node.name}.{timers}"
        elif isinstance(way, On):
            event = way.event
            _check_event(f"{node.name!r}: {way!r}", event)
            if event.startswith("done.state."):
                self.number(event.removeprefix("done.state."))
        where = f"{node.name!r}: {way!r}"
        target = None if way.to is None else self._target(where, way.to)
        if way.local and (target is None or not node.inside >> target & 1):
            raise DeclarationError(f"{where}: local=True is for a target inside {node.name!r}")
        if node.index == ROOT and target is not None and not way.local:
            way_to = f"On({event!r}, to={way.to!r}, local=True)"
            raise DeclarationError(f"{where}: the chart itself is never left and entered; write {way_to}")
        guards = guards_of(way.guard)
        asks = tuple(guard for guard in guards if not isinstance(guard, In))
        if isinstance(way, Always) and not asks and target is None:
            what = "a target or a guard" if not guards else "a target, or a guard that is no state alone"
            raise DeclarationError(f"{where}: would happen without end; it needs {what}")
        wants = self._looked_at(where, guards, active=True)
        bars = self._looked_at(where, guards, active=False)
        if wants & bars:
            raise DeclarationError(f"{where}: its guards are never true together")
        acts = acts_of(way.action)
        arc = Arc(len(self.arcs), node.index, event, target, guards, asks, wants, bars, acts, way.local, delay)
        self.arcs.append(arc)
        node.arcs.append(arc)

    def _looked_at(self, where: str, guards: tuple[Guard, ...], *, active: bool) -> int:
        """The states that must be active, or must not be, for these guards to be true."""
        states = 0
        for guard in guards:
            if isinstance(guard, In) and guard.active is active:
                index = self._target(where, guard.state)
                if self.nodes[index].kind in _HISTORIES:
                    raise DeclarationError(f"{where}: {guard.state!r} is a history, which is never active")
                states |= self.nodes[index].bit
        return states

    def _target(self, where: str, name: str) -> int:
        found = self._numbers.get(name)
        if found is None:
            raise DeclarationError(f"{where}: no state {name!r}{hint(name, self._numbers)}")
        return found

    # -- what can never happen -------------------------------------------------------------------------------------

    def warn_unreachable(self, stacklevel: int) -> None:
        """Warn of each state that no transition leads to, and of deferred events that no transition takes."""
        for node in self.nodes:
            for event in node.defer:
                if event != "*" and not self.knows(event) and not any(means(event, arc.event) for arc in self.arcs):
                    text = f"{self.name or 'chart'}: {node.name!r} defers {event!r}, for which there is no transition"
                    warnings.warn(ChartWarning(text + hint(event, self.events)), stacklevel=stacklevel)
        reached = self._reachable()
        lost = [node for node in self.nodes if not reached >> node.index & 1]
        for node in lost:
            if reached >> node.parent & 1:
                text = f"{self.name or 'chart'}: nothing leads to state {node.name!r}"
                warnings.warn(ChartWarning(text), stacklevel=stacklevel)

    def _reachable(self) -> int:
        reached = 0
        todo = [ROOT]
        while todo:
            index = todo.pop()
            if reached >> index & 1:
                continue
            reached |= 1 << index
            node = self.nodes[index]
            todo.append(node.parent)
            if node.kind in _HISTORIES or node.compound:
                todo.append(node.initial)
            else:
                todo += node.children
            todo += [arc.target for arc in node.arcs if arc.target is not None]
        return reached


_HISTORIES: Final = ("history", "deep")


def _delay(where: str, seconds: float | str) -> float | str:
    if isinstance(seconds, str):
        return seconds
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not 0 < seconds < math.inf:
        raise DeclarationError(f"{where!r}: After({seconds!r}): expected seconds, more than 0, or a parameter's name")
    return float(seconds)


def _check_twins(node: Node) -> None:
    """Refuse two transitions of one state for one event when the second can never be taken."""
    for number, arc in enumerate(node.arcs):
        for other in node.arcs[:number]:
            same = means(other.event, arc.event) or (arc.delay is not None and other.delay == arc.delay)
            if same and set(other.guards) <= set(arc.guards):
                what = (
                    "at once" if arc.event == ALWAYS else f"after {arc.delay} s" if arc.delay else f"on {arc.event!r}"
                )
                raise DeclarationError(
                    f"{node.name!r}: two transitions {what} cannot be told apart: the first is always taken; "
                    f"{'write it after the other' if other.event != arc.event else 'give it a guard of its own'}"
                )


def _check_event(where: str, event: Any) -> None:
    """Refuse a text that is no name for an event from outside."""
    if not isinstance(event, str) or not event or means("after", event) or re.search(r"\s", event):
        raise DeclarationError(f"{where}: expected an event's name, got {event!r}")
    if event.endswith((".", ".*")):
        whole = event.rstrip(".*")
        raise DeclarationError(f"{where}: {whole!r} takes all that begins with it and a dot; write {whole!r}")


def means(name: str, event: str) -> bool:
    """Whether a transition for `name` takes `event`: it is `name`, or begins with `name` and a dot."""
    return name == event or (name != ALWAYS and event.startswith(name) and event[len(name)] == ".")


def bits(states: int) -> Iterator[int]:
    """The numbers in a set, the lowest first."""
    while states:
        low = states & -states
        yield low.bit_length() - 1
        states ^= low


def hint(name: str, known: Any) -> str:
    """A hint at a similar name, or at all known names."""
    return f"; {suggestion(name, known)}"
