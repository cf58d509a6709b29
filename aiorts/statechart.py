"""The words a state chart is written in: `chart = Chart(State("shut", On(Open, to="open")), ...)`.

A component with a chart is an `aiorts.StateMachineComponent`.
"""

from __future__ import annotations

from aiorts.late import late as _late

TYPE_CHECKING = False

if TYPE_CHECKING:
    from aiorts.model.charting import Chart, ChartWarning
    from aiorts.model.statechart import After, Always, End, History, On, Parallel, State

__all__ = (
    "After",
    "Always",
    "Chart",
    "ChartWarning",
    "End",
    "History",
    "On",
    "Parallel",
    "State",
)

_HOMES = {
    "aiorts.model.charting": (
        "Chart",
        "ChartWarning",
    ),
    "aiorts.model.statechart": (
        "After",
        "Always",
        "End",
        "History",
        "On",
        "Parallel",
        "State",
    ),
}
"""Where each name lives; imported when it is first used."""

# Hidden from type checkers, which would otherwise believe in every name.
if not TYPE_CHECKING:
    __getattr__ = _late(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
