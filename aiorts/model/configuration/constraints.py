"""The values that a parameter may have, and the rule that a value breaks; `constraint_text` has the text of a rule.

A plain constraint holds for each element of a tuple, and for each value of a mapping.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Mapping
from dataclasses import field, fields
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import DeclarationError
from aiorts.late import dataclass
from aiorts.model.values import leaves, shown

_BOUNDS: Final = {
    "ge": (">=", operator.ge),
    "gt": (">", operator.gt),
    "le": ("<=", operator.le),
    "lt": ("<", operator.lt),
}


@dataclass(frozen=True, slots=True)
class Constraint:
    """The values that are allowed. NaN is inside no bound.

    Raises DeclarationError when no value could satisfy it.
    """

    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None
    choices: tuple[Any, ...] | None = None
    pattern: str | None = None
    """A regular expression that the whole text (or path) has to match."""
    elements: tuple[Constraint, ...] | None = None
    """One constraint for each element of a tuple of that length; then no other field is set."""
    keys: Mapping[str, Constraint] | None = field(default=None, hash=False)
    """One constraint for each key of a mapping with just these keys; then no other field is set."""

    def __post_init__(self) -> None:
        if self.choices is not None:
            if isinstance(self.choices, str):
                raise DeclarationError(f"choices={self.choices!r}: expected a tuple of values, got one text")
            object.__setattr__(self, "choices", tuple(self.choices))
        if self.elements is not None:
            object.__setattr__(self, "elements", tuple(self.elements))
        if self.keys is not None:
            object.__setattr__(self, "keys", MappingProxyType(dict(self.keys)))
        for fault in self._part_faults() or self._faults():
            raise DeclarationError(fault)

    def _part_faults(self) -> list[str]:
        parts = self.parts
        if parts is None:
            return []
        faults = []
        if len(parts) < (1 if self.elements is None else 2):
            faults.append("elements and keys: at least two elements, or one key")
        if sum(getattr(self, each.name) is not None for each in fields(self)) > 1:
            faults.append("elements and keys: each stands alone; what else is to hold stands in every one of them")
        if any(part.parts is not None for part in parts):
            faults.append("elements and keys: none has elements or keys of its own")
        return faults

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
    def parts(self) -> tuple[Constraint, ...] | None:
        """The constraints of elements or keys, where each has its own; else None."""
        return self.elements if self.keys is None else tuple(self.keys.values())

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
        """The rule that the value breaks ("must be >= 0.0"), or None. `value` has the parameter's type already."""
        if value is None:
            return None
        if self.elements is not None:
            return self._fault_of_elements(self.elements, value)
        if self.keys is not None:
            return self._fault_of_keys(self.keys, value)
        for leaf in leaves(value):
            if leaf is not None and (fault := self._fault_of(leaf)) is not None:
                return fault
        return None

    def _fault_of_elements(self, elements: tuple[Constraint, ...], value: object) -> str | None:
        if not isinstance(value, tuple) or len(value) != len(elements):
            return f"must have {len(elements)} elements"
        for index, (part, item) in enumerate(zip(elements, value, strict=True)):
            if (fault := part.fault(item)) is not None:
                return f"element {index} {fault}"
        return None

    def _fault_of_keys(self, keys: Mapping[str, Constraint], value: object) -> str | None:
        if not isinstance(value, Mapping) or value.keys() != keys.keys():
            return f"must have the keys {', '.join(keys)}"
        for key, part in keys.items():
            if (fault := part.fault(value[key])) is not None:
                return f"{key} {fault}"
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
        if self.elements is not None:
            return f"elements ({'; '.join(str(part) for part in self.elements)})"
        if self.keys is not None:
            return f"keys ({'; '.join(f'{key}: {part}' for key, part in self.keys.items())})"
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
