"""Checks whether a caller's arguments have the types of the interface; quick for values of exactly these classes.
Finds whether a method answers with a goal, and the types of that goal's values.

A value of another class is checked as results are (`check_of`): an int may stand for a float.
"""

from __future__ import annotations

import re
import typing
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

from aiorts.errors import DeclarationError
from aiorts.model.interface import Method, check_of, misfit, spelled
from aiorts.model.values import shown
from aiorts.services.goals import Goal

Look: TypeAlias = "Callable[[tuple[Any, ...], dict[str, Any]], str]"
"""A check of a call's arguments: returns the name of the first one of a wrong type, or ""."""


def look_of(method: Method) -> Look | None:
    """The check of a call's arguments; None where no type is known."""
    checks = {one.name: check for one in method.parameters if (check := check_of(one.annotation)) is not None}
    if not checks:
        return None
    order = tuple(one.name for one in method.parameters if one.kind is not one.KEYWORD_ONLY)
    defaults = {one.name: one.default for one in method.parameters}

    def look(args: tuple[Any, ...], kwargs: dict[str, Any]) -> str:
        for name, value in (*zip(order, args, strict=False), *kwargs.items()):
            if name in checks and value is not defaults[name] and not checks[name](value):
                return name
        return ""

    kinds = tuple(one.annotation for one in method.parameters)
    if not all(isinstance(kind, type) for kind in kinds):
        return look
    if len(kinds) == 1:
        return _one(kinds[0], look)
    return _two(*kinds, look) if len(kinds) == 2 else _several(kinds, look)


def _one(only: type, look: Look) -> Look:
    def quick(args: tuple[Any, ...], kwargs: dict[str, Any]) -> str:
        try:
            (value,) = args
        except ValueError:
            return look(args, kwargs)
        return "" if value.__class__ is only and not kwargs else look(args, kwargs)

    return quick


def _two(first: type, second: type, look: Look) -> Look:
    def quick(args: tuple[Any, ...], kwargs: dict[str, Any]) -> str:
        try:
            one, two = args
        except ValueError:
            return look(args, kwargs)
        return "" if one.__class__ is first and two.__class__ is second and not kwargs else look(args, kwargs)

    return quick


def _several(kinds: tuple[type, ...], look: Look) -> Look:
    def quick(args: tuple[Any, ...], kwargs: dict[str, Any]) -> str:
        return "" if (*map(type, args),) == kinds and not kwargs else look(args, kwargs)

    return quick


# -- goals -------------------------------------------------------------------------------------------------------------


class GoalTypes(NamedTuple):
    """The types of feedback and result in an interface's method, and a check of values."""

    feedback: Any = Any
    result: Any = Any

    def misfit(self, what: str, value: object) -> str:
        """The misfit of a value and its type, in words; "" where the value fits, or its type is not known."""
        hint = getattr(self, what)
        check = check_of(hint)
        if check is None or check(value):
            return ""
        place, inner = misfit(hint, value)
        return f"{what}{place} = {type(inner).__name__} {shown(inner)}, the interface says {spelled(hint)}"


def goal_types(returns: Any, where: str = "") -> GoalTypes | None:
    """The types of the goals that a method returns; None where it returns none.

    Raises:
        DeclarationError: the method may return a goal, but the types of its values cannot be known.
    """
    if returns is Goal:
        return GoalTypes()
    if typing.get_origin(returns) is Goal:
        return GoalTypes(*typing.get_args(returns))
    if isinstance(returns, str) and re.search(r"\bGoal\[", returns):
        raise DeclarationError(
            f"{where}: returns {returns!r}, which cannot be resolved; import its names when the file runs, not under "
            "TYPE_CHECKING"
        )
    if any(one is Goal or typing.get_origin(one) is Goal for one in typing.get_args(returns)):
        raise DeclarationError(
            f"{where}: returns {spelled(returns)}; annotate `-> Goal[Feedback, Result]` alone: a method that refuses "
            "a goal raises"
        )
    return None


def is_goal(value: object) -> bool:
    """The check of the answers of a method with goals."""
    return isinstance(value, Goal)
