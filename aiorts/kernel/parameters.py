"""Typed parameters of a component: declared as class attributes, in force as plain instance attributes.

`Param(0.0, unit="m")` is typed as its value, as `dataclasses.field` is: `self.gain` is the float in force. Values are
replaced between cycles only, so a hook never sees half a change. The parameter itself (bounds, unit, default) is
`component.params["gain"]`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from aiorts.errors import ConfigurationError, DeclarationError
from aiorts.kernel.execution.cell import cell, has_cell, is_inside
from aiorts.late import dataclass
from aiorts.model.configuration.parameters import Constraint, ParameterSpec, validate
from aiorts.model.values import shown

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import ComponentSide
    from aiorts.model.configuration.sets import ConfigurationState

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Declared:
    """A parameter as a class body declares it, and the guard of the attribute on instances.

    It has no `__get__`: reading the attribute finds the value in the instance, as fast as any other.
    """

    default: Any
    type: Any
    unit: str
    doc: str
    constraint: Constraint
    widget: str
    validator: Callable[[Any], object] | None = None
    file: str = ""
    attribute: str = ""
    """The attribute that it stands at; `low = high = Param(...)` makes a declaration for each."""

    def __set_name__(self, owner: Any, name: str) -> None:
        if self.attribute:
            setattr(owner, name, replace(self, attribute=name))
        else:
            object.__setattr__(self, "attribute", name)

    def __set__(self, component: Any, value: object) -> None:
        """Take the value from the component's own code, unchecked; from others before it belongs to a kernel only.

        Raises:
            ConfigurationError: others change it with `configure`.
        """
        if not has_cell(component):
            raise DeclarationError(
                f"{type(component).__name__}.{self.attribute}: is assigned before super().__init__() has run; "
                "call that first"
            )
        if cell(component).kernel is not None and not is_inside(component):
            what = f"{component.name}.{self.attribute}"
            raise ConfigurationError(
                f"{what}: is not assigned from outside, where nothing checks it and a hook may be using it; "
                f"await {component.name}.configure({self.attribute}={shown(value)})"
            )
        vars(component)[self.attribute] = value

    def __delete__(self, component: Any) -> None:
        """Let the component do without it."""
        if vars(component).pop(self.attribute, self) is self:
            raise AttributeError(self.attribute, name=self.attribute, obj=component)

    def named(self, name: str, owner: str) -> ParameterSpec:
        """The specification under its name; DeclarationError when the default does not fit."""
        return ParameterSpec(
            name,
            self.default,
            self.type,
            self.unit,
            self.doc,
            self.constraint,
            self.widget,
            self.validator,
            self.file,
            owner=owner,
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
    constraint: str | None = None,
    widget: str = "",
    validator: Callable[[T], object] | None = None,
    file: Literal["read", "write", ""] = "",
) -> T:
    """Declare a parameter in a component's class body; on an instance the attribute is the value in force.

    Args:
        default: the value until another is set; its type is the parameter's.
        type: the type where the default does not tell it (None, an empty tuple).
        unit, doc, widget: for people and tools.
        ge, gt, le, lt, choices, pattern: what values are allowed.
        constraint: the same as text, in OpenRTM's grammar ("0<=x<=10"); see
            `aiorts.model.configuration.constraint_text`.
        validator: asked, between cycles, for each new value; a ValueError that it raises refuses the whole change.
        file: what the component does with the file that the value, a path or text, names. A client without the right
            `code` names files below the folder `aiorts run --files` alone. A Path that says nothing counts as "write".

    Raises:
        DeclarationError: the declaration contradicts itself.
    """
    allowed = Constraint(ge, gt, le, lt, choices, pattern)
    if constraint is not None:
        if allowed != Constraint():
            raise DeclarationError(
                f"constraint={constraint!r}: stands for ge, gt, le, lt, choices and pattern; give either"
            )
        from aiorts.model.configuration.constraint_text import parse_constraint

        allowed = parse_constraint(constraint)
    declared: Any = Declared(default, type, unit, doc, allowed, widget, validator, file)
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
    """The parameters of one component, by name. Changed through `Component.configure` and `.configuration` only."""

    __slots__ = ("_component",)

    def __init__(self, component: ComponentSide) -> None:
        self._component = component

    @property
    def _state(self) -> ConfigurationState:
        return cell(self._component).configuration

    def __getitem__(self, name: str) -> Parameter:
        return Parameter(self._state.specs[name], self._state.values[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._state.specs)

    def __len__(self) -> int:
        return len(self._state.specs)

    def __repr__(self) -> str:
        return f"<Parameters {', '.join(f'{name}={value!r}' for name, value in self._state.values.items())}>"

    @property
    def values_in_force(self) -> dict[str, Any]:
        """Name to value."""
        return dict(self._state.values)

    def check(self, changes: Mapping[str, object]) -> dict[str, Any]:
        """The changes converted and checked; ConfigurationError when any is bad, and then none is made."""
        return validate(self._state.specs, changes, owner=self._component.name, current=self._state.values)
