"""Typed parameters of a component: declared as class attributes, in force as plain instance attributes.

`Param(0.0, unit="m")` is typed as its value, as `dataclasses.field` is: `self.gain` is the float in force. Values are
replaced between cycles only, so a hook never sees half a change. The parameter itself (bounds, unit, default) is
`component.params["gain"]`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from aiorts.model.configuration import Constraint, ParameterSpec, validate

__all__ = ("Declared", "Param", "Parameter", "Parameters")

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Declared:
    """What stands in a class body until the class is made."""

    default: Any
    type: Any
    unit: str
    doc: str
    constraint: Constraint
    widget: str

    def named(self, name: str, owner: str) -> ParameterSpec:
        """The specification under its name; DeclarationError when the default does not fit."""
        return ParameterSpec(
            name, self.default, self.type, self.unit, self.doc, self.constraint, self.widget, owner=owner
        )


def Param(  # noqa: N802 - a declaration reads as a type does
    default: T,
    *,
    type: Any = None,  # noqa: A002 - the word users expect
    unit: str = "",
    doc: str = "",
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    lt: float | None = None,
    choices: tuple[Any, ...] | None = None,
    pattern: str | None = None,
    widget: str = "",
) -> T:
    """Declare a parameter in a component's class body; on an instance the attribute is the value in force.

    Args:
        default: the value until another is set; its type is the parameter's.
        type: the type where the default does not tell it (None, an empty tuple).
        unit, doc, widget: for people and tools.
        ge, gt, le, lt, choices, pattern: what values are allowed.

    Raises:
        DeclarationError: the declaration contradicts itself.
    """
    declared: Any = Declared(default, type, unit, doc, Constraint(ge, gt, le, lt, choices, pattern), widget)
    result: T = declared
    return result


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter at one moment: what was declared and the value in force."""

    spec: ParameterSpec
    value: Any

    @property
    def name(self) -> str:
        """The parameter's name."""
        return self.spec.name

    @property
    def unit(self) -> str:
        """The unit of the value."""
        return self.spec.unit


class Parameters(Mapping[str, Parameter]):
    """The parameters of one component, by name. Changed through `Component.configure` only."""

    __slots__ = ("_owner", "_parameters")

    def __init__(self, owner: str, specs: Mapping[str, ParameterSpec]) -> None:
        self._owner = owner
        self._parameters = {name: Parameter(spec, spec.default) for name, spec in specs.items()}

    def __getitem__(self, name: str) -> Parameter:
        return self._parameters[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._parameters)

    def __len__(self) -> int:
        return len(self._parameters)

    def __repr__(self) -> str:
        return f"<Parameters {', '.join(f'{name}={p.value!r}' for name, p in self._parameters.items())}>"

    @property
    def values_in_force(self) -> dict[str, Any]:
        """Name to value."""
        return {name: parameter.value for name, parameter in self._parameters.items()}

    def check(self, changes: Mapping[str, object]) -> dict[str, Any]:
        """The changes converted and checked; ConfigurationError when any is bad, and then none is made."""
        specs = {name: parameter.spec for name, parameter in self._parameters.items()}
        return validate(specs, changes, owner=self._owner, current=self.values_in_force)

    def _put(self, checked: Mapping[str, Any]) -> None:
        for name, value in checked.items():
            self._parameters[name] = replace(self._parameters[name], value=value)

    def _rename(self, owner: str) -> None:
        self._owner = owner
