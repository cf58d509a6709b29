"""The `__init__` of record types: one closure for each number of fields, given its parameter names afterwards.

No source text is generated: a template is an ordinary function, and `CodeType.replace` renames its parameters. Each
field is one class comparison when the value is already right, one call of its kind's `check` when it is not, and one
call of the slot's own `__set__` (the class refuses assignment, its slots do not).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any, NamedTuple

from aiorts.types.kinds import STAMP_LIMIT, IntKind, Kind

MISSING = inspect.Parameter.empty
Init = Callable[..., None]


class Parameter(NamedTuple):
    """What a constructor needs to know of one field."""

    name: str
    kind: Kind
    check: Callable[[Any, str], Any]
    where: str
    store: Callable[[Any, Any], None]
    default: Any


def make_init(qualname: str, parameters: Sequence[Parameter]) -> Init:
    """An `__init__` that takes, checks and stores these fields."""
    template = _template(parameters)
    if template is None:
        return _general(qualname, parameters)
    names = tuple(parameter.name for parameter in parameters)
    first = "self" if "self" not in names else "record"
    code = template.__code__.replace(
        co_varnames=(first, *names), co_name="__init__", co_qualname=f"{qualname}.__init__"
    )
    defaults = tuple(parameter.default for parameter in parameters if parameter.default is not MISSING)
    return FunctionType(code, template.__globals__, "__init__", defaults, template.__closure__)


def _template(parameters: Sequence[Parameter]) -> FunctionType | None:
    maker: Any = _BY_COUNT.get(len(parameters))
    if len(parameters) == 2 and parameters[0].kind.spelling == "stamp":
        maker = _stamped_integer if isinstance(parameters[1].kind, IntKind) else _stamped
    if maker is None:
        return None
    template: FunctionType = maker(*parameters)
    return template


def _stamped(p: Parameter, q: Parameter) -> Init:
    (sp, cp, wp), (sq, tq, cq, wq) = (p.store, p.check, p.where), _parts(q)

    def init(self: Any, a: Any, b: Any) -> None:
        if type(a) is not int or not 0 <= a < STAMP_LIMIT:
            a = cp(a, wp)
        if type(b) is not tq:
            b = cq(b, wq)
        sp(self, a)
        sq(self, b)

    return init


def _stamped_integer(p: Parameter, q: Parameter) -> Init:
    (sp, cp, wp), (sq, cq, wq) = (p.store, p.check, p.where), (q.store, q.check, q.where)
    low, high = q.kind.low, q.kind.high  # type: ignore[attr-defined]

    def init(self: Any, a: Any, b: Any) -> None:
        if type(a) is not int or not 0 <= a < STAMP_LIMIT:
            a = cp(a, wp)
        if type(b) is not int or not low <= b <= high:
            b = cq(b, wq)
        sp(self, a)
        sq(self, b)

    return init


def _parts(p: Parameter) -> tuple[Any, Any, Any, Any]:
    return p.store, p.kind.exact, p.check, p.where


def _one(p: Parameter) -> Init:
    sp, tp, cp, wp = _parts(p)

    def init(self: Any, a: Any) -> None:
        sp(self, a if type(a) is tp else cp(a, wp))

    return init


def _two(p: Parameter, q: Parameter) -> Init:
    (sp, tp, cp, wp), (sq, tq, cq, wq) = _parts(p), _parts(q)

    def init(self: Any, a: Any, b: Any) -> None:
        sp(self, a if type(a) is tp else cp(a, wp))
        sq(self, b if type(b) is tq else cq(b, wq))

    return init


def _three(p: Parameter, q: Parameter, r: Parameter) -> Init:
    (sp, tp, cp, wp), (sq, tq, cq, wq), (sr, tr, cr, wr) = _parts(p), _parts(q), _parts(r)

    def init(self: Any, a: Any, b: Any, c: Any) -> None:
        sp(self, a if type(a) is tp else cp(a, wp))
        sq(self, b if type(b) is tq else cq(b, wq))
        sr(self, c if type(c) is tr else cr(c, wr))

    return init


def _four(p: Parameter, q: Parameter, r: Parameter, s: Parameter) -> Init:
    (sp, tp, cp, wp), (sq, tq, cq, wq), (sr, tr, cr, wr), (ss, ts, cs, ws) = map(_parts, (p, q, r, s))

    def init(self: Any, a: Any, b: Any, c: Any, d: Any) -> None:
        sp(self, a if type(a) is tp else cp(a, wp))
        sq(self, b if type(b) is tq else cq(b, wq))
        sr(self, c if type(c) is tr else cr(c, wr))
        ss(self, d if type(d) is ts else cs(d, ws))

    return init


_BY_COUNT: dict[int, Any] = {1: _one, 2: _two, 3: _three, 4: _four}


def _general(qualname: str, parameters: Sequence[Parameter]) -> Init:
    steps = tuple(_parts(parameter) for parameter in parameters)
    count = len(steps)
    arrange = _binder(qualname, parameters)

    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        if kwargs or len(args) != count:
            args = arrange(args, kwargs)
        for (store, exact, check, where), value in zip(steps, args, strict=True):
            store(self, value if type(value) is exact else check(value, where))

    init.__name__, init.__qualname__ = "__init__", f"{qualname}.__init__"
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    listed = [inspect.Parameter(p.name, kind, default=p.default) for p in parameters]
    init.__signature__ = inspect.Signature([inspect.Parameter("self", kind), *listed])  # type: ignore[attr-defined]
    return init


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
