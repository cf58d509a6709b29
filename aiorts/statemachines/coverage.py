"""Coverage of a chart by its machines: how often each state was entered, and each transition was taken."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import TYPE_CHECKING

from aiorts.statemachines.chart_structure import condition_of
from aiorts.statemachines.charting import ROOT, Arc, Chart
from aiorts.statemachines.microstep import ENTRY, Plan

if TYPE_CHECKING:
    from aiorts.statemachines.machine import StateMachineComponent


class ChartCoverage:
    """How often each state of a chart was entered and each transition was taken, by all machines on it."""

    def __init__(self, chart: Chart) -> None:
        self._chart = chart
        self._states = {
            node.index: 0 for node in chart.nodes if node.index != ROOT and node.index not in chart.histories
        }
        self._arcs = dict.fromkeys(chart.arcs, 0)

    def watch(self, plan: Plan) -> None:
        """Count the states that one microstep enters, and the transitions that it takes."""
        for step in plan.steps:
            if step.what is ENTRY and step.state != ROOT:
                self._states[step.state] += 1
        for arc in plan.arcs:
            self._arcs[arc] += 1

    @property
    def states(self) -> Mapping[str, int]:
        """How often each state was entered."""
        return MappingProxyType({self._chart.nodes[index].name: count for index, count in self._states.items()})

    @property
    def transitions(self) -> Mapping[str, int]:
        """How often each transition was taken, by its text, which `chart_paths` uses, too."""
        return MappingProxyType({transition_text(self._chart, arc): count for arc, count in self._arcs.items()})

    @property
    def missing(self) -> tuple[str, ...]:
        """The states that were never entered, then the transitions that were never taken."""
        counts = (*self.states.items(), *self.transitions.items())
        return tuple(what for what, count in counts if not count)

    def check(self) -> None:
        """Raise AssertionError with the missing states and transitions, if any are missing."""
        if missing := self.missing:
            whole = len(self._states) + len(self._arcs)
            lines = "".join(f"\n  {what}" for what in missing)
            raise AssertionError(f"{self._chart.name or 'chart'}: {len(missing)} of {whole} not reached:{lines}")


@contextmanager
def chart_coverage(chart: Chart | type[StateMachineComponent]) -> Iterator[ChartCoverage]:
    """Count what machines on a chart reach inside the `with`: `chart_coverage(Door)`, then `coverage.check()`."""
    chart = chart if isinstance(chart, Chart) else chart.chart
    coverage = ChartCoverage(chart)
    chart.watchers = (*chart.watchers, coverage.watch)
    try:
        yield coverage
    finally:
        chart.watchers = tuple(watch for watch in chart.watchers if watch != coverage.watch)


def transition_text(chart: Chart, arc: Arc) -> str:
    """The text of a transition, unique in its chart."""
    guards = condition_of(arc.guards)
    text = chart.describe(arc) + (f" [{guards}]" if guards else "")
    twins = [
        other for other in chart.arcs if chart.describe(other) == chart.describe(arc) and other.guards == arc.guards
    ]
    return text if len(twins) == 1 else f"{text} ({twins.index(arc) + 1})"
