"""Computes one microstep: the transitions taken in a configuration, and the states left and entered, in order.

The order is that of SCXML's appendix D: inner states come first, then the order of writing; of two transitions that
leave the same state the inner one is taken, else the first. States are left from the inside out and in reverse order,
then the actions of the transitions run, then states are entered in order. Results that depend only on configuration,
transitions and history are computed once and kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple, cast

from aiorts.statemachines.charting import ROOT, Arc, Chart, Node, bits, means
from aiorts.statemachines.statechart import Act

ENTRY: Final = "entry"
INIT: Final = "init"
EXIT: Final = "exit"
DO: Final = "do"
WAY: Final = "transition"

_KEPT: Final = 4096
"""The most plans that a chart keeps: a chart with many regions has more configurations than memory should hold."""


class Step(NamedTuple):
    """One step of an event: a state is left or entered, or the action of a transition runs."""

    what: str
    state: int
    acts: tuple[Act, ...]
    raises: tuple[str, ...] = ()
    """Events that the step raises for the machine itself."""


class Plan(NamedTuple):
    """One microstep."""

    steps: tuple[Step, ...]
    history: tuple[int, ...]
    """The states that each history stands for from now on, in the order of their numbers."""
    ends: bool
    """Whether a final state at the top was entered."""
    arcs: tuple[Arc, ...]


def chosen(
    chart: Chart, states: int, history: tuple[int, ...], event: str, says_yes: Callable[[Arc], bool], listed: bool
) -> Plan | None:
    """The microstep of `event` in a configuration, or None. `listed`: whether "*" matches it, too."""
    key = states, history, event, listed
    known = chart.plans.get(key, chart)
    if known is chart:
        ways = _candidates(chart, states, event, listed)
        plain = all(not arcs[0].asks for arcs in ways)
        known = _planned(chart, states, history, tuple(arcs[0] for arcs in ways)) if plain else ways
        _remember(chart, key, known)
    if not isinstance(known, list):
        return cast("Plan | None", known)
    taken = []
    for arcs in known:
        for arc in arcs:
            if not arc.asks or says_yes(arc):
                taken.append(arc)
                break
    return _planned(chart, states, history, tuple(taken))


def defers(chart: Chart, states: int, event: str) -> bool:
    """Whether an active state defers an event that no transition takes."""
    return any(_keeps(chart.nodes[index], event) for index in bits(chart.deferring & states))


def beginning(chart: Chart, history: tuple[int, ...]) -> Plan:
    """The microstep into the initial configuration; the root is entered, too."""
    entering = _Entering(chart, history)
    entering.down(ROOT)
    steps, ends = entering.steps(0)
    return Plan(steps, history, ends, ())


def ending(chart: Chart, states: int) -> tuple[Step, ...]:
    """The microstep that leaves all states, from the inside out."""
    return tuple(Step(EXIT, node.index, node.exit) for node in _backwards(chart, states))


def _keeps(node: Node, event: str) -> bool:
    return any(means(name, event) or name == "*" for name in node.defer)


def _remember(chart: Chart, key: object, value: object) -> None:
    if len(chart.plans) >= _KEPT:
        chart.plans.clear()
    chart.plans[key] = value


def _candidates(chart: Chart, states: int, event: str, listed: bool) -> list[tuple[Arc, ...]]:
    """For each innermost active state the transitions that `event` may trigger, in the order they are tried."""
    found: dict[tuple[Arc, ...], None] = {}
    for index in bits(states):
        node = chart.nodes[index]
        if node.inside & states:
            continue
        ways: list[Arc] = []
        while True:
            ways += [
                arc
                for arc in node.arcs
                if (means(arc.event, event) or (listed and arc.event == "*"))
                and not (arc.wants & ~states or arc.bars & states)
            ]
            # A state that defers the event hides the transitions of the states around it.
            if node.index == ROOT or (listed and node.defer and _keeps(node, event)):
                break
            node = chart.nodes[node.parent]
        if ways:
            found[tuple(ways)] = None
    return list(found)


def _planned(chart: Chart, states: int, history: tuple[int, ...], taken: tuple[Arc, ...]) -> Plan | None:
    """The microstep of these transitions, which are in the order of the states they were found from."""
    if not taken:
        return None
    key = states, history, taken
    plan: Plan | None = chart.plans.get(key)
    if plan is None:
        plan = _worked_out(chart, states, history, _without_conflicts(chart, states, history, taken))
        _remember(chart, key, plan)
    return plan


def _without_conflicts(chart: Chart, states: int, history: tuple[int, ...], taken: Sequence[Arc]) -> dict[Arc, int]:
    """The transitions that can be taken together, each with the states it leaves."""
    kept: dict[Arc, int] = {}
    for arc in dict.fromkeys(taken):
        leaves = _left(chart, states, history, arc)
        rivals = [other for other, left in kept.items() if left & leaves]
        if all(chart.nodes[other.source].inside >> arc.source & 1 for other in rivals):
            for other in rivals:
                del kept[other]
            kept[arc] = leaves
    return kept


def _left(chart: Chart, states: int, history: tuple[int, ...], arc: Arc) -> int:
    return 0 if arc.target is None else chart.nodes[_domain(chart, history, arc)].inside & states


def _domain(chart: Chart, history: tuple[int, ...], arc: Arc) -> int:
    """The state that stays active while states inside it are left and entered."""
    nodes = chart.nodes
    ends = 0
    for index in _meant(chart, history, arc.target):
        ends |= 1 << index
    source = nodes[arc.source]
    if arc.local and source.kind != "parallel" and not ends & ~source.inside:
        return arc.source
    index = source.parent
    ends |= source.bit
    while index != ROOT and (nodes[index].kind == "parallel" or ends & ~nodes[index].inside):
        index = nodes[index].parent
    return index


def _meant(chart: Chart, history: tuple[int, ...], target: int | None) -> tuple[int, ...]:
    """The states that a target stands for: itself, or those that a history remembers."""
    if target is None:
        return ()
    node = chart.nodes[target]
    if node.kind not in ("history", "deep"):
        return (target,)
    remembered = history[chart.histories.index(target)]
    if remembered:
        return tuple(bits(remembered))
    return tuple(chart.nodes[node.parent].children) if node.initial == node.parent else (node.initial,)


def _worked_out(chart: Chart, states: int, history: tuple[int, ...], taken: dict[Arc, int]) -> Plan:
    leaves = 0
    for left in taken.values():
        leaves |= left
    steps = [Step(EXIT, node.index, node.exit) for node in _backwards(chart, leaves)]
    after = _remembering(chart, states, history, leaves)
    steps += [Step(WAY, arc.source, arc.acts) for arc in taken if arc.acts]
    entering = _Entering(chart, after)
    for arc in taken:
        if arc.target is None:
            continue
        entering.target(arc.target)
        domain = _domain(chart, after, arc)
        for index in _meant(chart, after, arc.target):
            entering.up(index, domain)
    entered, ends = entering.steps(states & ~leaves)
    return Plan((*steps, *entered), after, ends, tuple(taken))


def _remembering(chart: Chart, states: int, history: tuple[int, ...], leaves: int) -> tuple[int, ...]:
    """The history after these states were left."""
    if not history or not leaves:
        return history
    found = list(history)
    for place, index in enumerate(chart.histories):
        node = chart.nodes[index]
        parent = chart.nodes[node.parent]
        if leaves & parent.bit:
            if node.kind == "deep":
                within = parent.inside & states
                found[place] = sum(1 << state for state in bits(within) if not chart.nodes[state].inside & states)
            else:
                found[place] = sum(1 << child for child in parent.children if states >> child & 1)
    return tuple(found)


def _backwards(chart: Chart, states: int) -> Iterator[Node]:
    return (chart.nodes[index] for index in reversed(list(bits(states))))


class _Entering:
    """Collects the states to enter: downwards from targets, and upwards to the state that stays active."""

    def __init__(self, chart: Chart, history: tuple[int, ...]) -> None:
        self._chart = chart
        self._history = history
        self._enter = 0
        self._by_itself = 0
        """States that enter their initial state by themselves."""

    def target(self, index: int) -> None:
        """Enter the states that a target stands for, and the states inside them."""
        node = self._chart.nodes[index]
        if node.kind in ("history", "deep"):
            meant = _meant(self._chart, self._history, index)
            for state in meant:
                self.target(state)
            for state in meant:
                self.up(state, node.parent)
        else:
            self.down(index)

    def down(self, index: int) -> None:
        """Enter a state and its initial states inside."""
        node = self._chart.nodes[index]
        self._enter |= node.bit
        if node.kind == "parallel":
            self._regions(node)
        elif node.compound:
            self._by_itself |= node.bit
            self.down(node.initial)

    def up(self, index: int, domain: int) -> None:
        """Enter the states between a state and `domain`, the state that stays active."""
        index = self._chart.nodes[index].parent
        while index != domain and index != ROOT:
            node = self._chart.nodes[index]
            self._enter |= node.bit
            if node.kind == "parallel":
                self._regions(node)
            index = node.parent

    def _regions(self, node: Node) -> None:
        for child in node.children:
            region = self._chart.nodes[child]
            if not self._enter & (region.bit | region.inside):
                self.down(child)

    def steps(self, states: int) -> tuple[tuple[Step, ...], bool]:
        """The steps that enter the collected states, while `states` are active; and whether the machine has ended."""
        found: list[Step] = []
        ends = False
        for index in bits(self._enter):
            node = self._chart.nodes[index]
            states |= node.bit
            raises: tuple[str, ...] = ()
            if node.kind == "final":
                ends = ends or node.parent == ROOT
                raises = tuple(self._done(node, states))
            found.append(Step(ENTRY, index, node.entry, raises))
            if self._by_itself & node.bit and node.init:
                found.append(Step(INIT, index, node.init))
        return tuple(found), ends

    def _done(self, node: Node, states: int) -> Iterator[str]:
        if node.parent == ROOT:
            return
        parent = self._chart.nodes[node.parent]
        yield f"done.state.{parent.name}"
        above = self._chart.nodes[parent.parent]
        if above.kind == "parallel" and self._is_done(above, states):
            yield f"done.state.{above.name}"

    def _is_done(self, node: Node, states: int) -> bool:
        nodes = [self._chart.nodes[child] for child in node.children]
        if node.kind == "parallel":
            return all(self._is_done(child, states) for child in nodes)
        return any(child.kind == "final" and states & child.bit for child in nodes)
