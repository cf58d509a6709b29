"""The words a state chart is written in: `chart = Chart(State("shut", On(Open, to="open")), ...)`.

A component with a chart is an `aiorts.StateMachineComponent`.
"""

from __future__ import annotations

from aiorts.statemachines import After, Always, Chart, ChartWarning, End, History, In, On, Parallel, State

__all__ = ("After", "Always", "Chart", "ChartWarning", "End", "History", "In", "On", "Parallel", "State")
