"""Parameters as values: this file decides whether a value may be in force; it keeps no value and publishes nothing.

A `ParameterSpec` is what a component declares; `check` converts one value or refuses it, `validate` does the same for
several at once: all of them or none. What text becomes, from a command line or a system file, stands in
`aiorts.model.values`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import InitVar, field, replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import ConfigurationError, DeclarationError
from aiorts.late import dataclass
from aiorts.model.configuration.constraints import Constraint
from aiorts.model.names import check_name
from aiorts.model.values import (
    convert_value,
    element_types,
    infer_type,
    is_path,
    leaf_types,
    shown,
    type_text,
    value_type,
)
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ("FILES", "WIDGETS", "Constraint", "ParameterSpec", "validate")

_NOTHING: Final = object()

WIDGETS: Final = {
    "text": "",
    "slider": "range",
    "spin": "range",
    "radio": "choices",
    "checkbox": "choices",
    "ordered_list": "choices",
}
"""Widgets of an editor, each with its needs: two bounds ("range") or choices. "slider.0.1" moves in steps of 0.1."""

FILES: Final = ("read", "write")
"""The uses that a component makes of the file that a parameter names; "write" allows reading, too."""


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """One declared parameter.

    `type` is bool, int, float, str, pathlib.Path, an Enum, tuple[X, ...], tuple[X, Y],
    Mapping[str, X] or X | None; when `type` is None, it
    comes from the default. `owner` (the component class) only stands in messages. Raises DeclarationError when the
    default does not fit, and InvalidNameError for a bad name.
    """

    name: str
    default: Any
    type: Any = None
    unit: str = ""
    doc: str = ""
    constraint: Constraint = field(default_factory=Constraint)
    widget: str = ""
    validator: Callable[[Any], object] | None = None
    """Called by the core before a value comes into force; it raises ValueError to refuse the value."""
    file: str = ""
    """"read" or "write": the value names a file that the component only reads, or writes; see `names_file`."""
    owner: InitVar[str] = ""

    def __post_init__(self, owner: str) -> None:
        check_name(self.name, "parameter")
        where = f"{owner}.{self.name}" if owner else self.name
        try:
            kind = infer_type(self.default) if self.type is None else self.type
            leaf_types(kind)
        except (TypeError, ValueError) as error:
            raise DeclarationError(f"{where}: {error}") from None
        object.__setattr__(self, "type", kind)
        object.__setattr__(self, "constraint", _checked_constraint(where, kind, self.constraint))
        try:
            default = convert_value(self.default, kind)
        except (TypeError, ValueError) as error:
            raise DeclarationError(f"{where}: default {shown(self.default)}: {error}") from None
        if (fault := self.constraint.fault(default)) is not None:
            raise DeclarationError(f"{where}: default {shown(default)} {fault}")
        object.__setattr__(self, "default", default)
        if self.widget and (fault := _widget_fault(self.widget, self.constraint)):
            raise DeclarationError(f"{where}: widget={self.widget!r}: {fault}")
        if self.file and (fault := _file_fault(self.file, kind)):
            raise DeclarationError(f"{where}: file={self.file!r}: {fault}")

    @property
    def type_text(self) -> str:
        """The type as one writes it ("float", "tuple[int, ...]")."""
        return type_text(self.type)

    @property
    def names_file(self) -> str:
        """ "read" or "write" when its value names a file, else "". A Path without either counts as written."""
        return self.file or ("write" if self.is_path else "")

    @property
    def is_path(self) -> bool:
        """Whether the parameter's value is a Path, or has one in it."""
        return any(map(is_path, leaf_types(self.type)))

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

    The error offers names near to an unknown one. Nothing is changed here: the caller puts the result in force.
    """
    check_mapping(changes, owner)
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


def check_mapping(given: object, owner: str, expected: str = "values by parameter") -> None:
    """Raise ConfigurationError unless `given` is a mapping."""
    if not isinstance(given, Mapping):
        raise ConfigurationError(f"{owner}: expected {expected}, such as {{...}}, got {shown(given)}")


def _unknown(name: object, specs: Mapping[str, ParameterSpec]) -> str:
    if name == "active":
        return ": no such parameter; a configuration set is chosen by configuration.activate(NAME), --set or a file"
    return f": no such parameter; {suggestion(name, specs, shown=str, most=3)}"


def _checked_constraint(where: str, kind: Any, constraint: Constraint) -> Constraint:
    """The constraint with its choices converted to the parameter's type."""
    if constraint.elements is not None:
        kinds = element_types(kind, len(constraint.elements))
        if kinds is None:
            count = len(constraint.elements)
            raise DeclarationError(f"{where}: constraints of {count} elements, the type is {type_text(kind)}")
        parts = zip(kinds, constraint.elements, strict=True)
        return Constraint(elements=tuple(_checked_constraint(where, *part) for part in parts))
    if constraint.keys is not None:
        item = value_type(kind)
        if item is None:
            raise DeclarationError(f"{where}: constraints of keys need a mapping, the type is {type_text(kind)}")
        parts_by_key = constraint.keys.items()
        return Constraint(keys={key: _checked_constraint(where, item, part) for key, part in parts_by_key})
    leaf_kinds = leaf_types(kind)
    if constraint.bounded and not all(leaf in (int, float) for leaf in leaf_kinds):
        raise DeclarationError(f"{where}: a bound ({constraint}) needs numbers, the type is {_names(leaf_kinds)}")
    if constraint.pattern is not None and not all(leaf is str or is_path(leaf) for leaf in leaf_kinds):
        raise DeclarationError(f"{where}: pattern={constraint.pattern!r} needs text, the type is {_names(leaf_kinds)}")
    if constraint.choices is None:
        return constraint
    if len(set(leaf_kinds)) != 1:
        raise DeclarationError(f"{where}: choices need one element type, the type has {_names(leaf_kinds)}")
    try:
        choices = tuple(convert_value(choice, leaf_kinds[0]) for choice in constraint.choices)
    except (TypeError, ValueError) as error:
        raise DeclarationError(f"{where}: choices={constraint.choices!r}: {error}") from None
    return replace(constraint, choices=choices)


def _names(kinds: tuple[Any, ...]) -> str:
    return " and ".join(dict.fromkeys(type_text(kind) for kind in kinds))


def _file_fault(file: str, kind: Any) -> str | None:
    if file not in FILES:
        return f"expected {' or '.join(map(repr, FILES))}"
    if not any(leaf is str or is_path(leaf) for leaf in leaf_types(kind)):
        return f"needs a path or text, the type is {type_text(kind)}"
    return None


def _widget_fault(widget: str, constraint: Constraint) -> str | None:
    kind, _, step = widget.partition(".")
    if kind not in WIDGETS:
        return f"unknown; {suggestion(kind, WIDGETS, shown=str)}"
    if step and (kind != "slider" or not re.fullmatch(r"\d+(\.\d+)?", step)):
        return "only a slider has a step, a number (slider.0.1)"
    if WIDGETS[kind] == "range" and (constraint.lower is None or constraint.upper is None):
        return "needs a lower and an upper bound"
    if WIDGETS[kind] == "choices" and constraint.choices is None:
        return "needs choices"
    return None
