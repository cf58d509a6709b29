"""`component(function)`: makes a component type of a function; parameters are in-ports, the result is the out-port.

`signature.py` reads the function's declaration, `function_component.py` calls it.
"""

from __future__ import annotations

import copyreg
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Literal, TypeAlias, overload

from aiorts.errors import DeclarationError
from aiorts.functions.function_component import FunctionComponent, FunctionKind, FunctionType, hooks_of, kind_of
from aiorts.functions.signature import read_signature
from aiorts.kernel.declarations import declarations

__all__ = ("FunctionComponent", "When", "component")

When: TypeAlias = Literal["any", "all", "cycle"]
_WHEN: Final = ("any", "all", "cycle")


@overload
def component(
    function: Callable[..., Any],
    /,
    *,
    when: When = "any",
    latest: bool = False,
    output: str | Sequence[str] | None = None,
    hints: Mapping[str, Any] | None = None,
    name: str | None = None,
) -> type[FunctionComponent]: ...


@overload
def component(
    *,
    when: When = "any",
    latest: bool = False,
    output: str | Sequence[str] | None = None,
    hints: Mapping[str, Any] | None = None,
    name: str | None = None,
) -> Callable[[Callable[..., Any]], type[FunctionComponent]]: ...


def component(
    function: Callable[..., Any] | None = None,
    /,
    *,
    when: When = "any",
    latest: bool = False,
    output: str | Sequence[str] | None = None,
    hints: Mapping[str, Any] | None = None,
    name: str | None = None,
) -> type[FunctionComponent] | Callable[[Callable[..., Any]], type[FunctionComponent]]:
    """Make a component type that calls `function`, by its type hints; also a decorator, with or without arguments.

    Positional parameters are in-ports (one with a default is not waited for), keyword-only ones with a default are
    parameters (`gain: float = Param(1.0, ge=0.0)` states bounds), the result is the out-port `output`: several,
    `output0`, ..., for `tuple[A, B]`, or a NamedTuple's fields; None sends nothing. `float` travels as TimedDouble,
    `int` as TimedLongLong, `list[float]` as TimedDoubleSeq, `numpy.ndarray` as TimedNDArray, with the time stamp of
    the newest argument, or the clock's where none has one; records, dataclasses and bytes travel as they are;
    `Annotated[float, InPort(TimedFloat, unit="m")]` says more. A generator sends all that it yields for a call; one
    without in-ports is a source: one sample a cycle (in an event context as fast as its readers take them), finished at
    its end, restarted when it is activated. A function that blocks belongs into a ThreadContext.

    Args:
        when: "any": for each new sample, with the last ones of the other in-ports, once every in-port has had one;
            earlier ones stay unread, and the first call takes the oldest of each. Samples unread as a cycle begins are
            taken in the order of the time stamps (equal ones, and all where a type has none, in the order of the
            ports). "all": with one new sample of each. "cycle": in every cycle, with the newest of each.
        latest: only the newest samples count, at most one call a cycle; older ones are dropped{superseded}.
        output: the out-port's name, or one for each.
        hints: hints for a function that has none ("return" is the result's); one with a default may be left out.
        name: the type's name in place of the function's.

    Raises:
        DeclarationError: names function and parameter, and says what is allowed.
    """
    options = {"when": when, "latest": latest, "output": output, "hints": hints, "name": name}
    if function is None:
        return lambda decorated: _make(decorated, options)
    return _make(function, options)


def _make(function: Callable[..., Any], options: Mapping[str, Any]) -> type[FunctionComponent]:
    plain = getattr(function, "func", function)
    label = getattr(plain, "__qualname__", None) or type(plain).__qualname__
    if options["when"] not in _WHEN:
        raise DeclarationError(f"component({label}): when={options['when']!r}: expected {', '.join(_WHEN)}")
    plan = read_signature(function, label, options["output"], options["hints"])
    own_name = options["name"] or getattr(plain, "__name__", label)
    if not own_name.isidentifier():
        raise DeclarationError(f'component({label}): is no name for a type; say component(..., name="Scale")')
    namespace: dict[str, Any] = {
        "__doc__": inspect.getdoc(plain),
        "__module__": getattr(plain, "__module__", None) or "builtins",
        "__qualname__": options["name"] or label,
        "function": staticmethod(plan.function),
        # A source sets its own pace: it goes on as soon as its sample is read, or waits inside the function.
        **({"alone": {"kind": "event"}} if plan.streams and not plan.inlets else {}),
        **hooks_of(plan, options["when"], options["latest"]),
        **{one.name: one.port for one in plan.inlets},
        **{one.name: one.port for one in plan.outlets},
        **plan.params,
    }
    made: Any = FunctionType(own_name, (FunctionComponent,), namespace, kind=FunctionKind(plan, function, options))
    cls: type[FunctionComponent] = made
    return cls


def _reduce(cls: type[Any]) -> str | tuple[Any, ...]:
    """Pickle a class by name if its module has it under that name, as for a decorator; else by function and options."""
    found: Any = sys.modules.get(cls.__module__)
    for part in cls.__qualname__.split("."):
        found = getattr(found, part, None)
    kind = kind_of(cls)
    if found is cls or kind is None or kind in declarations(cls.__mro__[1]).kinds:
        return cls.__qualname__
    return _make, (kind.original, dict(kind.options))


copyreg.pickle(FunctionType, _reduce)
