"""A component's configuration as plain data: all that tools, documents and other processes need to show or change it.

`dataclasses.asdict` of a profile is JSON: an Enum is its name, a path its text, infinities and NaN are texts that the
parameter reads back.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aiorts.late import dataclass
from aiorts.model.configuration.constraint_text import constraint_text
from aiorts.model.configuration.constraints import Constraint
from aiorts.model.configuration.sets import ConfigurationState
from aiorts.model.configuration.standard_names import remark_on


@dataclass(frozen=True, slots=True)
class ParameterProfile:
    """A parameter at one moment, as plain data."""

    name: str
    type: str
    value: Any
    """The value in force."""
    default: Any
    unit: str = ""
    doc: str = ""
    constraint: str = ""
    """The allowed values, in the grammar of `aiorts.model.configuration.constraint_text`; empty: all."""
    lower: float | str | None = None
    """The lower bound of a number, and whether it may be reached."""
    lower_included: bool = True
    upper: float | str | None = None
    upper_included: bool = True
    choices: tuple[Any, ...] | None = None
    pattern: str | None = None
    widget: str = ""
    file: str = ""
    """"read" or "write" when the value names a file."""
    declared: bool = True
    """Whether the class declares it; else it was added at run time."""
    remark: str = ""
    """The remark on an added parameter: how it differs from a standard name, or which are near; else empty."""


@dataclass(frozen=True, slots=True)
class ConfigurationProfile:
    """The configuration of one component at one moment, as plain data."""

    active: str
    sets: dict[str, dict[str, Any]]
    """The values of each set: "default" has all parameters, another set those that it names."""
    parameters: tuple[ParameterProfile, ...]


def configuration_profile(state: ConfigurationState, declared: Mapping[str, object]) -> ConfigurationProfile:
    """The profile of a state; `declared` are the parameters of the class."""
    return ConfigurationProfile(
        state.active,
        {name: {key: plain_value(value) for key, value in values.items()} for name, values in state.sets.items()},
        tuple(_parameter(state, name, declared=name in declared) for name in state.specs),
    )


def _parameter(state: ConfigurationState, name: str, *, declared: bool) -> ParameterProfile:
    spec = state.specs[name]
    constraint: Constraint = spec.constraint
    return ParameterProfile(
        name,
        spec.type_text,
        plain_value(state.values[name]),
        plain_value(spec.default),
        spec.unit,
        spec.doc,
        constraint_text(constraint),
        plain_value(constraint.lower),
        constraint.gt is None,
        plain_value(constraint.upper),
        constraint.lt is None,
        None if constraint.choices is None else tuple(plain_value(choice) for choice in constraint.choices),
        constraint.pattern,
        spec.widget,
        spec.names_file,
        declared,
        "" if declared else remark_on(spec),
    )


def plain_value(value: Any) -> Any:
    """A parameter's value as JSON has it; the parameter reads it back as the same value."""
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, tuple):
        return [plain_value(item) for item in value]
    if isinstance(value, Mapping):
        return {key: plain_value(item) for key, item in value.items()}
    return value
