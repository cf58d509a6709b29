"""What several operations take and give, as frozen plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from aiorts.late import dataclass
from aiorts.model.lifecycle import OverdueHook
from aiorts.model.plain import empty


@dataclass(frozen=True, slots=True)
class Names:
    """What is in a kernel, by name: little enough to be asked for by every command."""

    address: str
    state: str
    """"open", "closing" or "closed"."""
    components: Mapping[str, Mapping[str, str]] = field(default_factory=empty)
    """Lifecycle state by context, of each component."""
    contexts: Mapping[str, tuple[str, ...]] = field(default_factory=empty)
    """The members of each context, in order of execution."""
    connectors: Mapping[str, tuple[str, ...]] = field(default_factory=empty)
    """The ports of each connector, those of service ports too."""
    in_error: tuple[str, ...] = ()
    """Components that have failed, and were neither reset nor activated since."""
    finished: tuple[str, ...] = ()
    """Sources that have nothing more."""
    links: str = ""
    """The name by which links of other kernels reach it; "" where they cannot."""
    notices: tuple[str, ...] = ()
    """What is to be seen of it at once, such as that others reach it without certificates."""
    risks: tuple[str, ...] = ()
    """Risks of its settings, for `aiorts doctor`, each with its remedy behind "; "."""
    lasting: str = ""
    """The name by which it is known again after a restart, as the profile has it."""
    assembled: bool | None = None
    """As the profile has it."""
    pid: int = 0
    """Of its process; 0 where it is not said."""
    overdue: Mapping[str, Mapping[str, OverdueHook]] = field(default_factory=empty)
    """The hooks that run longer than their deadlines by context, of each component that has one."""


@dataclass(frozen=True, slots=True)
class Done:
    """It was done."""

    text: str = ""
    """What there is to say of it."""


@dataclass(frozen=True, slots=True)
class Member:
    """A component, in the context that is meant where it is in several."""

    component: str
    context: str | None = None
    timeout: float | None = 5.0
    """Seconds of the kernel's clock; None waits forever."""


@dataclass(frozen=True, slots=True)
class Stop:
    """How a run is to end."""

    status: int = 0
    """Its exit status."""
