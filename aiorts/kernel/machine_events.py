"""What the bus tells of state machines."""

from __future__ import annotations

from dataclasses import dataclass

from aiorts.kernel.bus import Event

__all__ = ("MachineChanged", "MachineAfter", "MachineBefore", "MachineEnded")


@dataclass(frozen=True, slots=True)
class MachineBefore(Event):
    """An action is about to run; one for each state and moment, also where there is no action."""

    component: str
    what: str
    """"init", "entry", "do", "exit", "transition" or "state_change"."""
    state: str
    """The state concerned; "" is the machine as a whole."""
    event: str
    """What set it off; "" where nothing did."""


@dataclass(frozen=True, slots=True)
class MachineAfter(Event):
    """It has run; `error` is what it raised."""

    component: str
    what: str
    state: str
    event: str
    error: BaseException | None = None


@dataclass(frozen=True, slots=True)
class MachineChanged(Event):
    """Other states are active than before an event."""

    component: str
    old: tuple[str, ...]
    new: tuple[str, ...]
    event: str


@dataclass(frozen=True, slots=True)
class MachineEnded(Event):
    """A machine entered a final state at its top; its component is deactivated."""

    component: str
