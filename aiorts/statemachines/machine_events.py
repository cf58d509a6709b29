"""The bus events of state machines."""

from __future__ import annotations

from aiorts.kernel.loop.bus import Event
from aiorts.late import dataclass


@dataclass(frozen=True, slots=True)
class MachineBefore(Event):
    """Published before an action runs; also once for each state and moment without an action."""

    component: str
    what: str
    """"init", "entry", "do", "exit", "transition" or "state_change"."""
    state: str
    """The state concerned; "" for the machine as a whole."""
    event: str
    """The event that caused the action; "" for none."""


@dataclass(frozen=True, slots=True)
class MachineAfter(Event):
    """Published after an action has run; `error` is the exception that it raised, or None."""

    component: str
    what: str
    state: str
    event: str
    error: BaseException | None = None


@dataclass(frozen=True, slots=True)
class MachineChanged(Event):
    """Published when other states are active than before an event."""

    component: str
    old: tuple[str, ...]
    new: tuple[str, ...]
    event: str


@dataclass(frozen=True, slots=True)
class MachineEnded(Event):
    """Published when a machine has entered a final state at its top; its component is deactivated."""

    component: str
