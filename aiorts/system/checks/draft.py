"""The ports a component will have, known without a kernel: it is constructed and given its parameters, no hook runs.

A component whose ports follow its parameters makes them in a method `make_ports`, which its `on_initialize` calls and
which does nothing else; here it is called alone. A component that overrides `on_initialize` without having one may make
ports there, so that a port that is not declared cannot be judged.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from aiorts.composites import group_of, shown
from aiorts.errors import AiortsError, ComponentError
from aiorts.kernel.component import Component
from aiorts.kernel.loop.origins import located
from aiorts.kernel.ports import Port
from aiorts.late import dataclass
from aiorts.planning import Setting
from aiorts.system.file.survey import Survey


@dataclass(frozen=True, slots=True)
class Draft:
    """A component that belongs to no kernel and never will."""

    component: Component | None
    ports: Mapping[str, Port[Any]]
    complete: bool
    """Whether `ports` has all ports of the component."""
    error: AiortsError | None = None
    """The reason why the component could not be made."""


def drafts_of(found: Survey, without: Collection[str] = ()) -> dict[str, Draft]:
    """The drafts of a system's components except `without`, as far as their ports are known.

    A component with a wrong parameter gets the others alone; its ports are not known where parameters make them.
    """
    made = {
        name: draft(cls, name, found.settings[name])
        for name, cls in found.types.items()
        if name not in without and not (name in found.bad_params and hasattr(cls, "make_ports"))
    }
    # Errors that follow from a wrong parameter have been reported with the parameter.
    return {name: one for name, one in made.items() if one.error is None or name not in found.bad_params}


def draft(cls: type[Component], name: str, setting: Setting) -> Draft:
    """A component of this class with this configuration, checked already, as a system will have it."""
    make = getattr(cls, "make_ports", None)
    try:
        component = setting.make(cls, name)
        if make is not None:
            make(component)
    except AiortsError as error:
        return Draft(None, {}, complete=False, error=error)
    except BaseException as error:  # a component's border: its `make_ports` is the user's
        if isinstance(error, KeyboardInterrupt):
            raise
        what = ComponentError(f"{cls.__name__} cannot be constructed: {located(error)}")
        return Draft(None, {}, complete=False, error=what)
    try:
        return _of(component)
    except AiortsError as error:
        return Draft(None, {}, complete=False, error=error)


def _of(component: Component) -> Draft:
    """The draft of a constructed component; a composite whose class makes its members will show ports of them."""
    cls = type(component)
    complete = hasattr(cls, "make_ports") or cls.on_initialize is Component.on_initialize
    group = group_of(component)
    if group is None:
        return Draft(component, dict(component.ports), complete=complete)
    members = {one.name: _of(one) for one in group.given if isinstance(one, Component)}
    every = {(name, port): made for name, one in members.items() for port, made in one.ports.items()}
    ports = {name: every[place] for name, place in shown(group.exports, every, component.name).items()}
    complete = complete and len(members) == len(group.given) and all(one.complete for one in members.values())
    return Draft(component, ports, complete=complete)
