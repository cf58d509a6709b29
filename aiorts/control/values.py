"""The frozen plain values that several operations share as arguments or results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from aiorts.late import dataclass
from aiorts.model.lifecycle import OverdueHook
from aiorts.model.plain import empty


@dataclass(frozen=True, slots=True)
class Names:
    """The content of a kernel, by name: small enough for every command to ask for."""

    address: str
    state: str
    """"open", "closing" or "closed"."""
    components: Mapping[str, Mapping[str, str]] = field(default_factory=empty)
    """Lifecycle state by context, of each component."""
    contexts: Mapping[str, tuple[str, ...]] = field(default_factory=empty)
    """The members of each context, in order of execution."""
    connectors: Mapping[str, tuple[str, ...]] = field(default_factory=empty)
    """The ports of each connector, of service connectors too."""
    in_error: tuple[str, ...] = ()
    """Components that have failed, and were neither reset nor activated since."""
    finished: tuple[str, ...] = ()
    """Sources that have finished."""
    links: str = ""
    """The name by which links of other kernels reach this kernel; "" where they cannot."""
    notices: tuple[str, ...] = ()
    """Notices to show at once, such as that other hosts reach the kernel without certificates."""
    risks: tuple[str, ...] = ()
    """Risks of the kernel's settings, for `aiorts doctor`, each with its remedy after "; "."""
    lasting: str = ""
    """The name by which the kernel is known again after a restart, as in the profile."""
    assembled: bool | None = None
    """As `SystemProfile.assembled`."""
    pid: int = 0
    """The number of the kernel's process; 0 where it is not known."""
    overdue: Mapping[str, Mapping[str, OverdueHook]] = field(default_factory=empty)
    """The hooks that run longer than their deadlines by context, of each component that has one."""


@dataclass(frozen=True, slots=True)
class Done:
    """The result of an operation that was done."""

    text: str = ""
    """The text of the result, such as the name of a new component; "" where there is none."""


@dataclass(frozen=True, slots=True)
class Member:
    """A component, with the context that is meant where it is in several."""

    component: str
    context: str | None = None
    timeout: float | None = 5.0
    """Seconds of the kernel's clock; None waits without limit."""


@dataclass(frozen=True, slots=True)
class Stop:
    """The way in which a run ends."""

    status: int = 0
    """The exit status of the run."""
