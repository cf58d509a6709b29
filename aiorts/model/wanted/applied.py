"""The outcome of a plan."""

from __future__ import annotations

from typing import Any

from aiorts.late import dataclass
from aiorts.model.wanted.plan import Plan


@dataclass(frozen=True, slots=True)
class Applied:
    """The outcome of a plan that was carried out, or would have been.

    Attributes:
        plan: the steps, in order.
        done: whether the system is the wanted one now; False for a dry run, and when it was rolled back.
        rolled_back: the figure that the system was rolled back for, and its edge, component or context; "" when the
            change was kept.
        notes: deviations from the plan, or from its reverse.
    """

    plan: Plan
    done: bool = True
    rolled_back: str = ""
    notes: tuple[str, ...] = ()

    def to_plain(self) -> dict[str, Any]:
        """The outcome as JSON has it."""
        return {
            **self.plan.to_plain(),
            "done": self.done,
            "rolled_back": self.rolled_back,
            "notes": list(self.notes),
        }
