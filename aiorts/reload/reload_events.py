"""Events of a reload: on the bus for each component, and the report for the caller; all of it plain data."""

from __future__ import annotations

from pathlib import Path

from aiorts.kernel.loop.bus import Event
from aiorts.late import dataclass


@dataclass(frozen=True, slots=True)
class Dropped:
    """A part of a component that its new code no longer has."""

    what: str
    """"port", "interface" (of a service port), "parameter" or "task"."""
    name: str
    why: str
    connectors: tuple[str, ...] = ()
    """The connectors that ended with a port."""
    unread: int = 0
    """The samples that were unread at a port; they are counted as disconnected."""


@dataclass(frozen=True, slots=True)
class ComponentReloaded(Event):
    """The code of a component was replaced while it stayed where it was, and has proved itself."""

    component: str
    kind: str
    """File and class, as "pid.py:Pid"."""
    old: int
    """The number of the reading of the file from which the old code came; 0 is the first."""
    new: int
    kept: tuple[str, ...]
    """Ports with their connectors and unread samples, and parameters with their values."""
    dropped: tuple[Dropped, ...]
    added: tuple[str, ...]
    """Ports that the old instance did not have."""


@dataclass(frozen=True, slots=True)
class Reloaded:
    """The result of a reload."""

    kind: str
    """File and class, as "pid.py:Pid"."""
    file: Path
    components: tuple[ComponentReloaded, ...]
    """One for each instance, in order of creation."""
