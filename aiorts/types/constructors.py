"""The `__init__` of record types: generated when the first record of a type is made, once for each shape of fields.

Each field costs one comparison when the value is already right, one call of its kind's `check` when it is not, and one
call of the slot's own `__set__` (the class refuses assignment, its slots do not). The code is written out for the
number of fields, which takes a third of the time of a loop. The generated source contains numbers only, never a name:
`CodeType.replace` gives the parameters their names afterwards.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any, Final, NamedTuple

from aiorts.types.generated import generate
from aiorts.types.kinds import STAMP_LIMIT, IntKind, Kind, TextKind

MISSING = inspect.Parameter.empty
Init = Callable[..., None]
_WRITTEN_OUT: Final = 12
"""The most fields of a written-out constructor: one of 21 fields takes 0.5 ms to compile and is hardly faster."""
_TESTS: Final = {
    "stamp": "type(v{i}) is not int or not 0 <= v{i} < LIMIT",
    "integer": "type(v{i}) is not int or not low{i} <= v{i} <= high{i}",
    "text": "type(v{i}) is not str or not v{i}.isascii()",
    "other": "type(v{i}) is not exact{i}",
}
"""The condition on which a value goes through the check of its kind, by the sort of the kind."""


class Parameter(NamedTuple):
    """The parts of one field that a constructor needs."""

    name: str
    kind: Kind
    check: Callable[[Any, str], Any]
    where: str
    store: Callable[[Any, Any], None]
    default: Any


def give_init(cls: type, parameters: Sequence[Parameter]) -> None:
    """Give the class an `__init__` that takes, checks and stores these fields, and calls `__post_init__` at the end."""
    has_more = hasattr(cls, "__post_init__")

    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        made = _written_out(cls, parameters) if len(parameters) <= _WRITTEN_OUT else _loop(cls, parameters)
        made = _and_then(made) if has_more else made
        type.__setattr__(cls, "__init__", made)
        made(self, *args, **kwargs)

    type.__setattr__(cls, "__init__", _described(init, cls, parameters))


def _and_then(init: Init) -> Init:
    @functools.wraps(init)
    def checked_init(self: Any, *args: Any, **kwargs: Any) -> None:
        init(self, *args, **kwargs)
        self.__post_init__()

    return checked_init


def _written_out(cls: type, parameters: Sequence[Parameter]) -> Init:
    sorts = tuple(_sort(parameter.kind) for parameter in parameters)
    template: FunctionType = _maker(sorts)(parameters)
    names = tuple(parameter.name for parameter in parameters)
    first = "self" if "self" not in names else "record"
    code = template.__code__.replace(
        co_varnames=(first, *names), co_name="__init__", co_qualname=f"{cls.__qualname__}.__init__"
    )
    defaults = tuple(parameter.default for parameter in parameters if parameter.default is not MISSING)
    made = FunctionType(code, template.__globals__, "__init__", defaults, template.__closure__)
    made.__module__ = cls.__module__
    return made


def _sort(kind: Kind) -> str:
    if kind.spelling == "stamp":
        return "stamp"
    if isinstance(kind, IntKind):
        return "integer"
    return "text" if isinstance(kind, TextKind) and kind.limit is None else "other"


@functools.cache
def _maker(sorts: tuple[str, ...]) -> Any:
    """A function that makes an `__init__` for parameters of these sorts."""
    before, body = [], []
    for i, sort in enumerate(sorts):
        before += [f"p = parameters[{i}]", f"check{i}, where{i}, store{i} = p.check, p.where, p.store"]
        before += [f"low{i}, high{i} = p.kind.low, p.kind.high" if sort == "integer" else f"exact{i} = p.kind.exact"]
        body += [f" if {_TESTS[sort].format(i=i)}:", f"  v{i} = check{i}(v{i}, where{i})"]
    # All values are checked before the first is stored: an error leaves no half-filled record.
    body += [f" store{i}(self, v{i})" for i in range(len(sorts))] or [" pass"]
    values = ", ".join(f"v{i}" for i in range(len(sorts)))
    lines = [*before, f"def init(self, {values}):", *body, "return init"]
    return generate("maker(parameters)", lines, {"LIMIT": STAMP_LIMIT})


def _described(init: Any, cls: type, parameters: Sequence[Parameter]) -> Init:
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    listed = [inspect.Parameter(p.name, kind, default=p.default) for p in parameters]
    init.__name__, init.__qualname__, init.__module__ = "__init__", f"{cls.__qualname__}.__init__", cls.__module__
    init.__signature__ = inspect.Signature([inspect.Parameter("self", kind), *listed])
    made: Init = init
    return made


def _loop(cls: type, parameters: Sequence[Parameter]) -> Init:
    steps = tuple((p.store, p.kind.exact, p.check, p.where) for p in parameters)
    count = len(steps)
    arrange = _binder(cls.__qualname__, parameters)

    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        if kwargs or len(args) != count:
            args = arrange(args, kwargs)
        for (store, exact, check, where), value in zip(steps, args, strict=True):
            store(self, value if type(value) is exact else check(value, where))

    return _described(init, cls, parameters)


def _binder(
    qualname: str, parameters: Sequence[Parameter]
) -> Callable[[tuple[Any, ...], dict[str, Any]], tuple[Any, ...]]:
    names = tuple(parameter.name for parameter in parameters)
    defaults = {parameter.name: parameter.default for parameter in parameters}

    def arrange(args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[Any, ...]:
        if len(args) > len(names):
            raise TypeError(f"{qualname} takes {len(names)} values, {len(args)} were given")
        given = dict(zip(names, args, strict=False))
        for name, value in kwargs.items():
            if name not in defaults or name in given:
                problem = "twice the value" if name in given else "an unexpected value"
                raise TypeError(f"{qualname} got {problem} {name!r}; its fields are {', '.join(names)}")
            given[name] = value
        complete = {**defaults, **given}
        missing = [name for name, value in complete.items() if value is MISSING]
        if missing:
            raise TypeError(f"{qualname} misses {', '.join(missing)}")
        return tuple(complete.values())

    return arrange
