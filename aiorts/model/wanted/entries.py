"""The parts of a wanted system as frozen values; nothing here reads, checks or runs anything."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts.model.declared import expected_of, option, options_of
from aiorts.model.policy import ErrorPolicy
from aiorts.model.wanted.restart_policy import Supervision
from aiorts.model.wanted.start_rules import StartRule
from aiorts.spelling import suggestion

_NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class ComponentEntry:
    """`[components.NAME]`: type, parameters and supervision of a component."""

    name: str
    type: str
    """`FILE.py:Class` below the system file's folder, `package.module:Class`, or the name of an installed type."""
    params: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    options: tuple[str, ...] = ()
    """Parameters as the component's command line has them: "-i", "TimedDouble"."""
    sets: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: _NOTHING)
    """Configuration sets: the values of each, by name."""
    active: str = ""
    """The active set; "" is the default one."""
    supervision: Supervision | None = option(
        None,
        "The recovery of the component when it fails, and the longest that each of its hooks may take.",
        changes=True,
    )
    start: StartRule | None = option(
        None, "The start of the component: it is activated once its conditions hold and its wait is over.", changes=True
    )
    exclusive: bool = option(
        False,
        "Whether the component holds a device that its replacement needs: when the running system is changed, it ends "
        "before anything is made.",
        changes=True,
    )
    on_link_lost: Literal["", "continue", "deactivate", "error"] = option(
        "",
        "The reaction of an active component to the loss of its operator's link: it goes on, is deactivated, or goes "
        "to error. By default what its class says.",
        changes=True,
    )
    isolation: Literal["", "process"] = option(
        "", "process: the component runs in a process of its own, in a context of its own."
    )
    limits: Mapping[str, Any] = option(_NOTHING, 'The limits of the component\'s process; with isolation = "process".')


CHANGED_BY_RULE: Final = tuple(key for key, one in options_of(ComponentEntry).items() if one.changes)
"""The keys of a component that are changed while its instance stays."""


def said_keys(entry: ComponentEntry | CompositeEntry | Supervision | StartRule) -> dict[str, Any]:
    """The declared keys of an entry, or of a table in one, whose values are not the default."""
    cls: type = type(entry)
    keys = options_of(cls).items()
    return {key: value for key, one in keys if (value := getattr(entry, key)) != one.default}


@dataclass(frozen=True, slots=True)
class CompositeEntry:
    """`[composites.NAME]`: components that look like one to all others."""

    name: str
    members: tuple[str, ...]
    """Components and composites, in order of execution."""
    order: Literal["stated", "dataflow"] = option("stated", "dataflow: writers run before their readers.")
    errors: ErrorPolicy = option(
        ErrorPolicy.STOP,
        "A member in error. stop: the composite is in error, all stop; report: others go on; isolate: the others go "
        "on, and the composite is in error once none is active.",
    )
    own_schedule: bool = option(False, "Inside another composite: run in a context of its own.")
    groups: tuple[tuple[str, ...], ...] = option((), '"a,b|c,d": what | parts runs side by side in each cycle.')
    exported: Mapping[str, str] = option(
        _NOTHING, 'Ports it shows: ["arm.force"], or names by pattern: {"*.out" = "{component}_out"}.'
    )
    named: bool = False
    """Whether `exported` is a table of names by pattern in the file, and no list."""

    def exported_key(self, number: int) -> str | int:
        """The key in the file of an exported pattern."""
        return tuple(self.exported)[number] if self.named else number


def with_option(entry: CompositeEntry, key: str, value: Any) -> CompositeEntry:
    """The composite with an option given as plain data. ConfigurationError: there is no such option or value."""
    known = options_of(CompositeEntry)
    if key not in known:
        raise ConfigurationError(f"{key:.60}: no option of a composite; {suggestion(key, known)}")
    if what := expected_of(CompositeEntry, key, value):
        raise ConfigurationError(f"{key} = {value!r:.60}: {what}")
    if key in _PLAIN and not _PLAIN[key][0](value):
        raise ConfigurationError(f"{key} = {value!r:.60}: expected {_PLAIN[key][1]}")
    changed: dict[str, Any] = {key: ErrorPolicy(value) if key == "errors" else value}
    return replace(entry, **changed)


def _are_texts(values: object) -> bool:
    return isinstance(values, Collection) and all(isinstance(one, str) for one in values)


_PLAIN: Final[Mapping[str, tuple[Callable[[Any], bool], str]]] = MappingProxyType(
    {
        "own_schedule": (lambda value: isinstance(value, bool), "true or false"),
        "groups": (
            lambda value: isinstance(value, list | tuple) and all(map(_are_texts, value)),
            'lists of members, such as [["a", "b"], ["c"]]',
        ),
        "exported": (
            lambda value: isinstance(value, Mapping) and _are_texts(value) and _are_texts(value.values()),
            'names by pattern, such as {"a.out": "{port}"}',
        ),
    }
)
"""The test of a plain value, and its form in words, of the options that are neither numbers nor words."""


@dataclass(frozen=True, slots=True)
class ConnectionEntry:
    """`[[connections]]`: the ports joined, and the options as `Kernel.connect` takes them."""

    ports: tuple[str, ...]
    """Paths such as "pid0.command": the one under `from`, then those under `to`."""
    options: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    number: int = 1
    """The connection's place in the file, counted from 1; for messages."""

    @property
    def place(self) -> str:
        """The name of the connection in messages."""
        return f"connections[{self.number}] ({self.ports[0]} to {', '.join(self.ports[1:])})"


@dataclass(frozen=True, slots=True)
class ContextEntry:
    """`[contexts.NAME]`: kind, members in order, and options of a context."""

    name: str
    kind: str
    members: tuple[str, ...]
    activate: bool = option(
        True,
        "Whether its members are activated once all contexts of the file run, each after those it sends to. A context "
        "with a rate has had its first cycle by then, at t0: a member's first on_execute is at t0 + 1/rate.",
    )
    options: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    """The options that the context's class takes: rate, overrun, deadline, ..."""


@dataclass(frozen=True, slots=True)
class ClockEntry:
    """`[clock]`: the passing of time, unless the command line sets another one."""

    kind: Literal["system", "scaled", "simulated"] = option(
        "system", "system, scaled (`speed` times as fast) or simulated."
    )
    speed: float | None = option(None, "Seconds of the system in one real second.", above=0)


@dataclass(frozen=True, slots=True)
class Wanted:
    """A whole wanted system.

    For a system file it has the file's contents; for a kernel, those of a file that would make it. The latter has one
    form: a type is the name by which an installed package offers it, "package.module:Class", or "FILE.py:Class" with
    the whole path of the file; parameters and options that are as declared are left out; a path is a whole `Path`; a
    connection has two ports, of components and not of composites.
    """

    components: Mapping[str, ComponentEntry] = field(default_factory=lambda: _NOTHING)
    connections: tuple[ConnectionEntry, ...] = ()
    contexts: Mapping[str, ContextEntry] = field(default_factory=lambda: _NOTHING)
    clock: ClockEntry = ClockEntry()
    composites: Mapping[str, CompositeEntry] = field(default_factory=lambda: _NOTHING)
    services: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: _NOTHING)
    """The tables of services, by name."""
    plugin_paths: tuple[Path, ...] = ()
    """Folders with plugins, and folders in which a system file's relative FILE.py is looked for."""
