"""The events of a component's configuration, published once it is in force; values are as the parameters hold them.

The events of sets alone tell what every set holds at any moment, those of parameters what is in force: either feed is
complete.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from aiorts.kernel.loop.bus import Event, ParametersChanged
from aiorts.late import dataclass
from aiorts.model.configuration.sets import ConfigurationState, same

Pairs = tuple[tuple[str, Any], ...]


@dataclass(frozen=True, slots=True)
class ParameterAdded(Event):
    """A parameter was added at run time, at its default."""

    component: str
    parameter: str
    value: Any
    type: str
    unit: str
    remark: str = ""
    """A remark on its name: that it is no standard name, and which names are near."""


@dataclass(frozen=True, slots=True)
class ParameterRemoved(Event):
    """A parameter was removed at run time, from every set."""

    component: str
    parameter: str


@dataclass(frozen=True, slots=True)
class ParameterChanged(Event):
    """A parameter has another value since this moment; one event for each, `ParametersChanged` for all of a change."""

    component: str
    parameter: str
    old: Any
    new: Any
    set: str
    """The active set."""


@dataclass(frozen=True, slots=True)
class ConfigurationSetAdded(Event):
    """A configuration set was added."""

    component: str
    set: str
    values: Pairs


@dataclass(frozen=True, slots=True)
class ConfigurationSetChanged(Event):
    """Values of a configuration set were changed; `old` and `new` are all its values before and since."""

    component: str
    set: str
    old: Pairs
    new: Pairs


@dataclass(frozen=True, slots=True)
class ConfigurationSetRemoved(Event):
    """A configuration set was removed."""

    component: str
    set: str
    values: Pairs


@dataclass(frozen=True, slots=True)
class ConfigurationSetActivated(Event):
    """Another configuration set was activated."""

    component: str
    old: str
    new: str


def configuration_events(component: str, old: ConfigurationState, new: ConfigurationState) -> Iterator[Event]:
    """The events to publish when `new` took the place of `old`."""
    for name, spec in new.specs.items():
        if name not in old.specs:
            from aiorts.model.configuration.standard_names import remark_on

            yield ParameterAdded(component, name, new.values[name], spec.type_text, spec.unit, remark_on(spec))
    for name in old.specs:
        if name not in new.specs:
            yield ParameterRemoved(component, name)
    for name, values in new.sets.items():
        before = old.sets.get(name)
        if before is None:
            yield ConfigurationSetAdded(component, name, tuple(values.items()))
        elif not _alike(before, values):
            yield ConfigurationSetChanged(component, name, tuple(before.items()), tuple(values.items()))
    if old.active != new.active:
        yield ConfigurationSetActivated(component, old.active, new.active)
    for name, values in old.sets.items():
        if name not in new.sets:
            yield ConfigurationSetRemoved(component, name, tuple(values.items()))
    changed = []
    for name, value in new.values.items():
        if name in old.values and not same(old.values[name], value):
            changed.append((name, value))
            yield ParameterChanged(component, name, old.values[name], value, new.active)
    if changed:
        yield ParametersChanged(component, tuple(changed))


def _alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return one.keys() == other.keys() and all(same(value, other[name]) for name, value in one.items())
