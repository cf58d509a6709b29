"""Operations on configurations: parameters and sets of one component, the configuration file of a whole kernel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Final

from aiorts.control.operation import Operation, Right
from aiorts.control.operations.known import absent, component_named, whose
from aiorts.control.session import Session
from aiorts.control.values import Done
from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts.model.configuration.configuration_profile import ConfigurationProfile
from aiorts.model.configuration.sets import DEFAULT
from aiorts.model.plain import empty


@dataclass(frozen=True, slots=True)
class Whose:
    """A component."""

    component: str


@dataclass(frozen=True, slots=True)
class Configuring:
    """A change of a component's configuration, put in force in one step or not at all."""

    component: str
    values: Mapping[str, Mapping[str, Any]] = field(default_factory=empty)
    """Values of parameters by set; the set "" means the active one. A text is read by the parameter's type."""
    add: tuple[str, ...] = ()
    """Sets to add, each empty but for its `values`."""
    remove: tuple[str, ...] = ()
    activate: str | None = None


@dataclass(frozen=True, slots=True)
class Chosen:
    """Components; an empty tuple is all that have parameters."""

    components: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Document:
    """A configuration file."""

    text: str


@dataclass(frozen=True, slots=True)
class Loading:
    """A configuration file to put in force."""

    parts: tuple[str, ...]
    """The text of the file, in parts of at most 65,536 bytes: no text of a request is longer."""
    name: str = "configuration"
    """The name of the file in messages."""


def _configuration(session: Session, given: Whose) -> ConfigurationProfile:
    return component_named(session, given.component).configuration.profile


async def _configure(session: Session, given: Configuring) -> Done:
    configuration = component_named(session, given.component).configuration
    owner, before = given.component, configuration.sets
    active = configuration.active
    for name in (*given.values, *given.remove, *((given.activate,) if given.activate else ())):
        if name and name not in before and name not in given.add:
            raise absent(f"{owner}: no set {name!r:.80}", name, before)
    changes: dict[str, dict[str, Any]] = {name: {} for name in given.add}
    for name, values in given.values.items():
        changes.setdefault(name or active, {}).update(values)
    for name in given.add:
        if name in before:
            raise ConfigurationError(f"{owner}: there is a set {name!r:.80} already; change it")
    merged = {
        name: values if name == DEFAULT else {**before.get(name, {}), **values} for name, values in changes.items()
    }
    if len(changes) == 1 and not given.add and given.activate is None:
        for name, values in changes.items():
            await configuration.change(name, values)
    elif merged:
        await configuration.merge(merged, given.activate)
    elif given.activate is not None:
        await configuration.activate(given.activate)
    for name in given.remove:
        await configuration.remove(name)
    return Done()


def _dump(session: Session, given: Chosen) -> Document:
    from aiorts.configuration import ConfigurationFiles  # late: few ask for it

    chosen = tuple(component_named(session, name) for name in dict.fromkeys(given.components))
    return Document(session.kernel.service(ConfigurationFiles).text(chosen))


async def _load(session: Session, given: Loading) -> Done:
    from aiorts.configuration import ConfigurationFiles  # late: few ask for it

    session.operates(await session.kernel.service(ConfigurationFiles).load_text("".join(given.parts), given.name))
    return Done()


ROWS: Final = (
    Operation(
        "configuration",
        "Parameters and sets of a component.",
        Whose,
        ConfigurationProfile,
        Right.VIEW,
        _configuration,
        idempotent=True,
    ),
    Operation("configure", "Change parameters and sets.", Configuring, Done, Right.OPERATE, _configure, changes=whose),
    Operation(
        "dump_configuration",
        "The configuration as the text of a file.",
        Chosen,
        Document,
        Right.VIEW,
        _dump,
        idempotent=True,
    ),
    Operation("load_configuration", "Put a configuration file in force, whole.", Loading, Done, Right.OPERATE, _load),
)
