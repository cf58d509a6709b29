"""Constraints of `RTC.xml` as text, in the grammar that constraints of .conf files and of parameters have."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.markup.element import Element

_BOUNDS: Final = {
    "propertyIsGreaterThan": "x>",
    "propertyIsGreaterThanOrEqualTo": "x>=",
    "propertyIsLessThan": "x<",
    "propertyIsLessThanOrEqualTo": "x<=",
}
_WORD: Final = re.compile(r"[^\s(){},:<>=\"]+")


def constraint_text(element: Element) -> str:
    """The text of an element `Constraint`.

    Raises:
        OpenRTMError: the grammar has no words for the constraint.
    """
    kind = _only(element)
    if kind is None:
        return ""
    if kind.local == "ConstraintListType":
        return ", ".join(constraint_text(one) for one in kind.elements())
    if kind.local == "ConstraintHashType":
        pairs = [(_key(one), constraint_text(one)) for one in kind.elements()]
        return f"{{{', '.join(f'{_written(key)}: {text}' for key, text in pairs)}}}"
    condition = _only(kind)
    return "" if condition is None else _condition(condition)


def _condition(element: Element) -> str:
    if element.local in _BOUNDS:
        return f"{_BOUNDS[element.local]}{_literal(element)}"
    if element.local == "propertyIsEqualTo":
        return _written(_literal(element))
    if element.local == "propertyIsBetween":
        low, high = (next((_literal(one) for one in element.elements() if one.local == name), "") for name in _LIMITS)
        return f"{low}<=x<={high}"
    if element.local == "And":
        return " and ".join(constraint_text(one) for one in element.elements())
    if element.local == "Or":
        found = [one for part in element.elements() for one in _equals(part)]
        return f"({', '.join(_written(one) for one in found)})"
    if element.local == "propertyIsLike":
        raise OpenRTMError(f'{element.where}: a constraint by pattern; write it at the parameter as ~"..."')
    raise OpenRTMError(f"{element.where}: a constraint cannot say {element.local!r:.60}; take it away")


_LIMITS: Final = ("LowerBoundary", "UpperBoundary")


def _equals(element: Element) -> Iterator[str]:
    """The values that a constraint of one value, or of several, allows."""
    kind = _only(element)
    condition = None if kind is None else _only(kind)
    if condition is None or condition.local not in ("propertyIsEqualTo", "Or"):
        raise OpenRTMError(f"{element.where}: of constraints of which one has to hold, all have to name one value")
    if condition.local == "Or":
        for one in condition.elements():
            yield from _equals(one)
    else:
        yield _literal(condition)


def _key(element: Element) -> str:
    kind = _only(element)
    return "" if kind is None else next((one.value for one in kind.attributes if one.local == "key"), "")


def _only(element: Element) -> Element | None:
    return next(element.elements(), None)


def _literal(element: Element) -> str:
    found = next((one for one in element.elements() if one.local == "Literal"), None)
    return (element if found is None else found).text.strip()


def _written(value: str) -> str:
    import json

    return value if _WORD.fullmatch(value) else json.dumps(value, ensure_ascii=False)
