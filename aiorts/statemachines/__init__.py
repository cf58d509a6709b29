"""State machines and modes: components whose behaviour is a table of states and transitions.

The interpreter is pure and follows SCXML's order; `machine.py` runs it in a component's hooks. To the kernel these are
components like any other.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.statemachines.chart_structure import StateStructure
    from aiorts.statemachines.charting import Chart, ChartWarning
    from aiorts.statemachines.coverage import ChartCoverage, chart_coverage
    from aiorts.statemachines.machine import EventPort, StateMachine, StateMachineComponent
    from aiorts.statemachines.machine_events import MachineAfter, MachineBefore, MachineChanged, MachineEnded
    from aiorts.statemachines.modes import ModeChanged, MultiModeComponent, Participant
    from aiorts.statemachines.paths import ChartPath, ChartPaths, Move, chart_paths
    from aiorts.statemachines.statechart import After, Always, End, History, In, On, Parallel, State

late()
