"""The structure of a chart as frozen values of names and numbers, to be compared, shown and written."""

from __future__ import annotations

from typing import Any

from aiorts.late import dataclass
from aiorts.statemachines.charting import ALWAYS, ROOT, Arc, Chart, Node
from aiorts.statemachines.statechart import Act, Guard, In


@dataclass(frozen=True, slots=True)
class TransitionStructure:
    """One transition."""

    event: str
    """The event that triggers the transition; "" for none, "after.<state>.<n>" for a timer."""
    target: str | None
    """The state that the transition leads to; None if it only runs actions."""
    guard: str | None
    """The transition's guards as a condition of SCXML, such as "In('open') && is_near"."""
    actions: tuple[str, ...]
    local: bool
    delay: float | str | None
    """Seconds of a timer, or the name of the parameter with the seconds."""

    @property
    def label(self) -> str:
        """Event, guard and actions, as diagrams write them: "after 2 s [is_near] / halt"."""
        event = self.event
        if self.delay is not None:
            event = f"after {self.delay}" if isinstance(self.delay, str) else f"after {self.delay:g} s"
        guard = f"[{self.guard}]" if self.guard else ""
        acts = f"/ {', '.join(self.actions)}" if self.actions else ""
        return " ".join(part for part in (event, guard, acts) if part)


@dataclass(frozen=True, slots=True)
class StateStructure:
    """One state with everything inside it."""

    name: str
    kind: str
    """"state", "parallel", "final", "history" or "deep"."""
    initial: tuple[str, ...]
    """The state entered by default; for a history, the state entered while it remembers nothing yet."""
    entry: tuple[str, ...]
    init: tuple[str, ...]
    exit: tuple[str, ...]
    do: tuple[str, ...]
    defer: tuple[str, ...]
    transitions: tuple[TransitionStructure, ...]
    states: tuple[StateStructure, ...]


def structure_of(chart: Chart) -> StateStructure:
    """The structure of the whole chart: its root."""
    return _state(chart, chart.nodes[ROOT])


def _state(chart: Chart, node: Node) -> StateStructure:
    nodes = chart.nodes
    if node.kind in ("history", "deep"):
        parent = nodes[node.parent]
        initial = parent.children if node.initial == parent.index else [node.initial]
    else:
        initial = [node.initial] if node.compound else []
    return StateStructure(
        node.name,
        node.kind,
        tuple(nodes[index].name for index in initial),
        _names(node.entry),
        _names(node.init),
        _names(node.exit),
        _names(node.do),
        node.defer,
        tuple(_transition(chart, arc) for arc in node.arcs),
        tuple(_state(chart, nodes[index]) for index in sorted([*node.children, *node.histories])),
    )


def _transition(chart: Chart, arc: Arc) -> TransitionStructure:
    return TransitionStructure(
        arc.event or ALWAYS,
        None if arc.target is None else chart.nodes[arc.target].name,
        condition_of(arc.guards),
        _names(arc.acts),
        arc.local,
        arc.delay,
    )


def condition_of(guards: tuple[Guard, ...]) -> str | None:
    """Guards as a condition of SCXML; None without guards."""
    return " && ".join(str(guard) if isinstance(guard, In) else _name(guard) for guard in guards) or None


def _names(acts: tuple[Act, ...]) -> tuple[str, ...]:
    return tuple(map(_name, acts))


def _name(act: Act) -> str:
    name: Any = act if isinstance(act, str) else getattr(act, "__name__", type(act).__name__)
    return str(name)
