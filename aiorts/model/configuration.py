"""Parameters as values: this file decides whether a value may be in force; it keeps no value and tells nobody.

A `ParameterSpec` is what a component declares; `check` converts one value or refuses it, `validate` does the same for
several at once: all of them or none. What text becomes, from a command line or a system file, stands in
`aiorts.model.values`.
"""

from __future__ import annotations

import operator
import re
from dataclasses import InitVar, dataclass, field
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import ConfigurationError, DeclarationError
from aiorts.model.names import check_name
from aiorts.model.values import convert_value, infer_type, leaf_types, leaves, shown, type_text

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ("WIDGETS", "Constraint", "ParameterSpec", "validate")

_NOTHING: Final = object()

_BOUNDS: Final = {
    "ge": (">=", operator.ge),
    "gt": (">", operator.gt),
    "le": ("<=", operator.le),
    "lt": ("<", operator.lt),
}

WIDGETS: Final = {
    "text": "",
    "slider": "range",
    "spin": "range",
    "radio": "choices",
    "checkbox": "choices",
    "ordered_list": "choices",
}
"""What an editor can show, and what each needs to be declared. "slider.0.1" is a slider that moves in steps of 0.1."""


@dataclass(frozen=True, slots=True)
class Constraint:
    """What values are allowed. For a tuple it holds for each element. NaN is inside no bound.

    Raises DeclarationError when nothing could ever satisfy it.
    """

    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None
    choices: tuple[Any, ...] | None = None
    pattern: str | None = None
    """A regular expression that the whole text (or path) has to match."""

    def __post_init__(self) -> None:
        if self.choices is not None:
            if isinstance(self.choices, str):
                raise DeclarationError(f"choices={self.choices!r}: expected a tuple of values, got one text")
            object.__setattr__(self, "choices", tuple(self.choices))
        for fault in self._faults():
            raise DeclarationError(fault)

    def _faults(self) -> list[str]:
        faults = []
        for name in _BOUNDS:
            limit = getattr(self, name)
            if limit is not None and (isinstance(limit, bool) or not isinstance(limit, int | float) or limit != limit):
                faults.append(f"{name}={limit!r}: expected a number")
        if faults:
            return faults
        if self.ge is not None and self.gt is not None:
            faults.append(f"ge={self.ge!r} and gt={self.gt!r}: choose one lower bound")
        if self.le is not None and self.lt is not None:
            faults.append(f"le={self.le!r} and lt={self.lt!r}: choose one upper bound")
        low, high = self.lower, self.upper
        closed = self.gt is None and self.lt is None
        if low is not None and high is not None and not (low < high or (low == high and closed)):
            faults.append(f"no value lies between {low!r} and {high!r}; exchange the bounds")
        if self.choices == ():
            faults.append("choices=(): nothing to choose from")
        if self.pattern is not None:
            try:
                re.compile(self.pattern)
            except (re.error, TypeError) as error:
                faults.append(f"pattern={self.pattern!r}: not a regular expression: {error}")
        return faults

    @property
    def lower(self) -> float | None:
        """The lower bound, inclusive or not."""
        return self.ge if self.ge is not None else self.gt

    @property
    def upper(self) -> float | None:
        """The upper bound, inclusive or not."""
        return self.le if self.le is not None else self.lt

    @property
    def bounded(self) -> bool:
        """True when a number has a bound."""
        return self.lower is not None or self.upper is not None

    def fault(self, value: object) -> str | None:
        """What the value breaks ("must be >= 0.0"), or None. `value` has the parameter's type already."""
        for leaf in leaves(value):
            if leaf is not None and (fault := self._fault_of(leaf)) is not None:
                return fault
        return None

    def _fault_of(self, leaf: Any) -> str | None:
        for name, (sign, holds) in _BOUNDS.items():
            limit = getattr(self, name)
            if limit is not None and not holds(leaf, limit):
                return f"must be {sign} {limit!r}"
        if self.choices is not None and leaf not in self.choices:
            return f"must be one of {', '.join(shown(choice) for choice in self.choices)}"
        if self.pattern is not None and not re.fullmatch(self.pattern, str(leaf)):
            return f"must match {self.pattern!r}"
        return None

    def __str__(self) -> str:
        """The constraint in one line ("0.0 <= x <= 10.0"), empty when everything is allowed."""
        parts = []
        if self.bounded:
            low = "" if self.lower is None else f"{self.lower!r} {'<=' if self.gt is None else '<'} "
            high = "" if self.upper is None else f" {'<=' if self.lt is None else '<'} {self.upper!r}"
            parts.append(f"{low}x{high}")
        if self.choices is not None:
            parts.append(f"one of {', '.join(shown(choice) for choice in self.choices)}")
        if self.pattern is not None:
            parts.append(f"matches {self.pattern!r}")
        return ", ".join(parts)


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """One declared parameter.

    `type` is bool, int, float, str, pathlib.Path, an Enum, tuple[X, ...], tuple[X, Y] or X | None; when it is None it
    comes from the default. `owner` (the component class) only stands in messages. Raises DeclarationError when the
    default does not fit, and InvalidNameError for the name.
    """

    name: str
    default: Any
    type: Any = None
    unit: str = ""
    doc: str = ""
    constraint: Constraint = field(default_factory=Constraint)
    widget: str = ""
    owner: InitVar[str] = ""

    def __post_init__(self, owner: str) -> None:
        check_name(self.name, "parameter")
        where = f"{owner}.{self.name}" if owner else self.name
        try:
            kind = infer_type(self.default) if self.type is None else self.type
            leaf_kinds = leaf_types(kind)
        except (TypeError, ValueError) as error:
            raise DeclarationError(f"{where}: {error}") from None
        object.__setattr__(self, "type", kind)
        object.__setattr__(self, "constraint", _checked_constraint(where, leaf_kinds, self.constraint))
        try:
            default = convert_value(self.default, kind)
        except (TypeError, ValueError) as error:
            raise DeclarationError(f"{where}: default {shown(self.default)}: {error}") from None
        if (fault := self.constraint.fault(default)) is not None:
            raise DeclarationError(f"{where}: default {shown(default)} {fault}")
        object.__setattr__(self, "default", default)
        if self.widget and (fault := _widget_fault(self.widget, self.constraint)):
            raise DeclarationError(f"{where}: widget={self.widget!r}: {fault}")

    @property
    def type_text(self) -> str:
        """The type as one writes it ("float", "tuple[int, ...]")."""
        return type_text(self.type)

    def check(self, value: object, *, owner: str = "", current: object = _NOTHING) -> Any:
        """The value as the parameter holds it: immutable, of the parameter's type, inside its constraint.

        `owner` (the component's name) and `current` (the value in force) only stand in the message. Raises
        ConfigurationError ("pid0.gain = -1.0: must be >= 0.0; 2.0 kept").
        """
        checked, fault = self._judge(value)
        if fault is None:
            return checked
        where = f"{owner}.{self.name}" if owner else self.name
        kept = "" if current is _NOTHING else f"; {shown(current)} kept"
        raise ConfigurationError(f"{where} = {shown(value)}: {fault}{kept}")

    def _judge(self, value: object) -> tuple[Any, str | None]:
        try:
            checked = convert_value(value, self.type)
        except (TypeError, ValueError) as error:
            return None, str(error)
        return checked, self.constraint.fault(checked)


def validate(
    specs: Mapping[str, ParameterSpec],
    changes: Mapping[str, object],
    *,
    owner: str = "",
    current: Mapping[str, object] | None = None,
) -> dict[str, Any]:
    """All changes converted and checked, in their order; or one ConfigurationError that names every bad one.

    An unknown name is answered with near ones. Nothing is half done: the caller puts the result in force or keeps all.
    """
    checked: dict[str, Any] = {}
    refused: list[tuple[str, str]] = []
    for name, value in changes.items():
        spec = specs.get(name)
        if spec is None:
            refused.append((name, _unknown(name, specs)))
            continue
        result, fault = spec._judge(value)
        if fault is None:
            checked[name] = result
        else:
            kept = "" if current is None or name not in current else f"; {shown(current[name])} kept"
            refused.append((name, f" = {shown(value)}: {fault}{kept}"))
    if not refused:
        return checked
    listed = "\n  ".join(f"{owner}.{name}{why}" if owner else f"{name}{why}" for name, why in refused)
    if len(changes) == 1:
        raise ConfigurationError(listed)
    count = f"{len(refused)} of {len(changes)} changes refused, none was made"
    raise ConfigurationError(f"{owner + ': ' if owner else ''}{count}:\n  {listed}")


def _unknown(name: object, specs: Mapping[str, ParameterSpec]) -> str:
    near = get_close_matches(str(name), specs, n=3)
    if near:
        return f": no such parameter; did you mean {' or '.join(near)}?"
    return f": no such parameter; there are {', '.join(specs)}" if specs else ": no such parameter; there are none"


def _checked_constraint(where: str, kinds: tuple[Any, ...], constraint: Constraint) -> Constraint:
    """The constraint with its choices converted to the parameter's type."""
    if constraint.bounded and not all(kind in (int, float) for kind in kinds):
        raise DeclarationError(f"{where}: a bound ({constraint}) needs numbers, the type is {_names(kinds)}")
    if constraint.pattern is not None and not all(kind is str or kind.__name__ == "Path" for kind in kinds):
        raise DeclarationError(f"{where}: pattern={constraint.pattern!r} needs text, the type is {_names(kinds)}")
    if constraint.choices is None:
        return constraint
    if len(set(kinds)) != 1:
        raise DeclarationError(f"{where}: choices need one element type, the type has {_names(kinds)}")
    try:
        choices = tuple(convert_value(choice, kinds[0]) for choice in constraint.choices)
    except (TypeError, ValueError) as error:
        raise DeclarationError(f"{where}: choices={constraint.choices!r}: {error}") from None
    return Constraint(constraint.ge, constraint.gt, constraint.le, constraint.lt, choices, constraint.pattern)


def _names(kinds: tuple[Any, ...]) -> str:
    return " and ".join(dict.fromkeys(type_text(kind) for kind in kinds))


def _widget_fault(widget: str, constraint: Constraint) -> str | None:
    kind, _, step = widget.partition(".")
    if kind not in WIDGETS:
        near = get_close_matches(kind, WIDGETS, n=1)
        return f"unknown; {'did you mean ' + near[0] + '?' if near else 'there are ' + ', '.join(WIDGETS)}"
    if step and (kind != "slider" or not re.fullmatch(r"\d+(\.\d+)?", step)):
        return "only a slider has a step, a number (slider.0.1)"
    if WIDGETS[kind] == "range" and (constraint.lower is None or constraint.upper is None):
        return "needs a lower and an upper bound"
    if WIDGETS[kind] == "choices" and constraint.choices is None:
        return "needs choices"
    return None
