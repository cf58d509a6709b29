"""Finds the ports a component will have, without a kernel: the component is made with its parameters, and no hook runs.

A component whose ports depend on its parameters makes its ports in a method `make_ports`, which its `on_initialize`
calls and which does nothing else; only that method is called here. A component that overrides `on_initialize` and has
no `make_ports` may make any ports there: then a port that is not declared may exist, or may not.
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
    """A component made only for its ports, which never belongs to a kernel."""

    component: Component | None
    ports: Mapping[str, Port[Any]]
    complete: bool
    """Whether `ports` has all ports of the component."""
    error: AiortsError | None = None
    """The reason why the component could not be made."""


def drafts_of(found: Survey, without: Collection[str] = ()) -> dict[str, Draft]:
    """The drafts of a system's components except `without`, as far as their ports are known.

    A component with a wrong parameter is made with the other parameters; if it has `make_ports`, it gets no draft.
    """
    made = {
        name: draft(cls, name, found.settings[name])
        for name, cls in found.types.items()
        if name not in without and not (name in found.bad_params and hasattr(cls, "make_ports"))
    }
    # An error of a component with a wrong parameter follows from that parameter, which has been reported.
    return {name: one for name, one in made.items() if one.error is None or name not in found.bad_params}


def draft(cls: type[Component], name: str, setting: Setting) -> Draft:
    """The draft of a component of this class with this configuration, which has been checked."""
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
    """The draft of a constructed component; that of a composite has the ports it exports from members."""
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
