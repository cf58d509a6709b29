"""The hooks that a component class declares, read and checked once when the class is made.

A hook is a coroutine function or a plain function, has no argument beyond `self` (`on_error` and `on_aborting` get
the error), and returns nothing. Anything else is refused here, with class and hook named, not when it first runs. So
is a method that is a hook but for its spelling, which the kernel would never call: `onExecute`, or one slip of the pen
(`on_excute`, `on_activate`) in a method that could be called as a hook is. `on_button` and `on_preset(self, number)`
are left alone.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Awaitable, Mapping
from types import CoroutineType
from typing import Any, cast

from aiorts.errors import DeclarationError, StateError
from aiorts.model.lifecycle import HOOKS
from aiorts.model.values import shown

TAKES_ERROR = frozenset({"on_error", "on_aborting"})


class HookKind:
    """How a hook is run."""

    ABSENT = 0
    PLAIN = 1
    ASYNC = 2


def hook_kinds(cls: type[Any], base: type[Any] | None) -> dict[str, int]:
    """The kind of every hook of `cls`; absent where it is `base`'s own.

    Raises:
        DeclarationError: a hook is not a function, takes other arguments, or is a generator.
    """
    return {hook: _kind(cls, base, hook) for hook in HOOKS}


def further_kinds(cls: type[Any], base: type[Any], hooks: dict[str, tuple[str, ...]]) -> dict[str, int]:
    """The kinds of hooks that only components derived from `base` have, each with its arguments; checked as any."""
    check_spelling(cls, tuple(hooks))
    return {hook: _kind(cls, base, hook, expected) for hook, expected in hooks.items()}


def check_spelling(cls: type[Any], hooks: tuple[str, ...] = HOOKS) -> None:
    """Raise DeclarationError when a method that the class defines is a misspelt hook."""
    for name, value in vars(cls).items():
        if name in HOOKS or name in hooks or not _LIKE_A_HOOK.match(name) or not inspect.isfunction(value):
            continue
        for hook in hooks:
            wanted, got = (text.replace("_", "").lower() for text in (hook, name))
            if wanted == got or (_one_slip(wanted, got) and _callable_as(hook, value)):
                raise DeclarationError(
                    f"{cls.__qualname__}.{name}: there is no such hook; did you mean {hook}? "
                    "A method of your own needs another name"
                )


_LIKE_A_HOOK = re.compile("on(_|[A-Z])")


def _one_slip(wanted: str, got: str) -> bool:
    """Whether one letter is missing, too many, wrong, or two neighbours are exchanged."""
    if abs(len(wanted) - len(got)) > 1:
        return False
    at = next((n for n, (a, b) in enumerate(zip(wanted, got, strict=False)) if a != b), min(len(wanted), len(got)))
    left, right = wanted[at:], got[at:]
    exchanged = left[:2] == right[1::-1] and left[2:] == right[2:]
    return left[1:] == right or left == right[1:] or left[1:] == right[1:] or exchanged


def _callable_as(hook: str, function: Any) -> bool:
    try:
        inspect.signature(function).bind("self", *(("error",) if hook in TAKES_ERROR else ()))
    except TypeError:
        return False
    return True


def coroutine_hooks(kinds: Mapping[str, int]) -> list[str]:
    """The hooks that are coroutine functions, which a thread cannot run."""
    return [hook for hook, kind in kinds.items() if kind == HookKind.ASYNC]


def _kind(cls: type[Any], base: type[Any] | None, hook: str, expected: tuple[str, ...] | None = None) -> int:
    function = inspect.getattr_static(cls, hook, None)
    if base is None or function is inspect.getattr_static(base, hook):
        return HookKind.ABSENT
    where = f"{cls.__qualname__}.{hook}"
    if not inspect.isfunction(function):
        raise DeclarationError(f"{where}: expected a method, got {type(function).__name__} {function!r}")
    if inspect.isasyncgenfunction(function) or inspect.isgeneratorfunction(function):
        raise DeclarationError(f"{where}: is a generator (it contains `yield`); a hook returns nothing")
    if expected is None:
        expected = ("self", "error") if hook in TAKES_ERROR else ("self",)
    _check_signature(where, function, expected)
    return HookKind.ASYNC if inspect.iscoroutinefunction(function) else HookKind.PLAIN


def _check_signature(where: str, function: Any, expected: tuple[str, ...]) -> None:
    signature = inspect.signature(function)
    try:
        signature.bind(*expected)
    except TypeError as error:
        raise DeclarationError(
            f"{where}{signature}: expected ({', '.join(expected)}), since it is called that way: {error}"
        ) from None


def bad_return(component: str, hook: str, result: object) -> BaseException:
    """The error for a hook of this component that returned something."""
    kind = type(result)
    if issubclass(kind, CoroutineType):
        cast("CoroutineType[Any, Any, Any]", result).close()
    advice = "write `async def`, or await inside" if issubclass(kind, Awaitable) else "a hook returns nothing"
    takes = "self, error" if hook in TAKES_ERROR else "self"
    return StateError(f"{component}.{hook}({takes}): returned {kind.__name__} {shown(result)}; {advice}")
