"""Finds the names in the code of a hook, which show its possible effects without running it."""

from __future__ import annotations

from types import CodeType, FunctionType
from typing import Any

from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations


def may_write(component: Component, hook: str, port: str) -> bool:
    """Whether a hook, or a function that its code names, names the out-port; True if the port's name is unknown."""
    declared = declarations(type(component)).ports
    names = {attribute for attribute, one in declared.items() if port in (attribute, one.name)}
    return not names or not names.isdisjoint(used := names_of(type(component), hook)) or "ports" in used


def names_of(cls: type[Any], hook: str) -> set[str]:
    """The names in the code of a method, and in the code of the functions in its class and file that it names."""
    used: set[str] = set()
    left = _functions(cls, hook)
    seen: set[CodeType] = set()
    while left:
        function = left.pop()
        codes = [function.__code__]
        while codes:
            code = codes.pop()
            if code in seen:
                continue
            seen.add(code)
            codes += [one for one in code.co_consts if isinstance(one, CodeType)]
            for name in code.co_names:
                used.add(name)
                left += _functions(cls, name)
                if isinstance(helper := function.__globals__.get(name), FunctionType):
                    left.append(helper)
    return used


def _functions(cls: type[Any], name: str) -> list[FunctionType]:
    """The functions of this name in a class and its bases, except those of aiorts itself."""
    owners = [one for one in cls.__mro__ if one not in Component.__mro__]
    return [found for one in owners if isinstance(found := vars(one).get(name), FunctionType)]
