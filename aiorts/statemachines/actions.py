"""Looks up the actions and guards that a chart names in the component's class, and checks them at its definition."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

from aiorts.errors import DeclarationError, StateError
from aiorts.kernel.declarations import declarations
from aiorts.statemachines.charting import Chart, hint, means
from aiorts.statemachines.statechart import Act

if TYPE_CHECKING:
    from aiorts.kernel.component import Component

Acting: TypeAlias = tuple[Callable[..., Any], bool]
"""The function to call, and whether it takes the event's data."""


def acting(component: Component, act: Act) -> Acting:
    """The bound action or guard of this component."""
    if isinstance(act, str):
        return getattr(component, act), _takes(getattr(component, act), 0)
    return partial(act, component), _takes(act, 1)


def check_acts(cls: type[Any], chart: Chart, events: Mapping[str, str]) -> bool:
    """Check all actions and guards; return whether any action is a coroutine function.

    Raises:
        DeclarationError: names class, place and action, and the expected form of the action.
    """
    awaits = False
    for where, act, event in chart.acts:
        function = _function(cls, where, act)
        awaits |= inspect.iscoroutinefunction(function)
        _check_type(cls, where, function, event, events)
    for arc in chart.arcs:
        for guard in arc.asks:
            where = f"{chart.describe(arc)}, guard"
            function = _function(cls, where, guard)
            if inspect.iscoroutinefunction(function):
                raise DeclarationError(
                    f"{cls.__qualname__}.chart: {where}: {_name(guard)} is async; a guard only looks"
                )
            _check_type(cls, where, function, arc.event, events)
        if isinstance(arc.delay, str) and not hasattr(cls, arc.delay):
            known = sorted(declarations(cls).parameters | vars(cls))
            raise DeclarationError(
                f"{cls.__qualname__}.chart: {chart.describe(arc)}: no parameter {arc.delay!r}"
                f"{hint(arc.delay, [name for name in known if not name.startswith('_')])}"
            )
    return awaits


def unawaited(function: Callable[..., Any], result: Any) -> StateError:
    """The error for a plain action that returned an awaitable."""
    if inspect.iscoroutine(result):
        result.close()
    return StateError(f"{_name(function)}: is a plain function and returned {type(result).__name__}; write `async def`")


def _function(cls: type[Any], where: str, act: Act) -> Any:
    where = f"{cls.__qualname__}.chart: {where}"
    if isinstance(act, str):
        function = getattr(cls, act, None)
        if function is None:
            ours = frozenset(dir(cls.__mro__[-2]))  # Component's own are no actions
            methods = [n for n in dir(cls) if not n.startswith("_") and n not in ours and callable(getattr(cls, n))]
            raise DeclarationError(f"{where}: no method {act!r}{hint(act, methods)}")
    else:
        function = act
    bound = isinstance(act, str) and isinstance(inspect.getattr_static(cls, act), staticmethod | classmethod)
    if not callable(function):
        raise DeclarationError(f"{where}: expected a method, got {function!r:.60}")
    try:
        signature = inspect.signature(function)
    except ValueError:
        return function
    for count in (0, 1):
        try:
            signature.bind(*([None] * (count + (not bound))))
        except TypeError:
            continue
        return function
    raise DeclarationError(f"{where}: {_name(act)}{signature}: expected (self) or (self, what came with the event)")


def _takes(function: Callable[..., Any], before: int) -> bool:
    """Whether a function takes a further argument after the first `before` arguments."""
    try:
        inspect.signature(function).bind(*([None] * (before + 1)))
    except (TypeError, ValueError):
        return False
    return True


def _check_type(cls: type[Any], where: str, function: Any, event: str, events: Mapping[str, str]) -> None:
    """Check that an action takes the type of its event's port."""
    ports = [port for port in _ports(cls) if port[0] in events and means(event, events[port[0]])]
    if not ports:
        return
    try:
        annotations = inspect.get_annotations(function, eval_str=True)
    except (NameError, SyntaxError, AttributeError, TypeError):
        return  # a name that only the type checker knows
    parameters = [p for p in inspect.signature(function).parameters.values() if p.name != "self"]
    annotation: Any = annotations.get(parameters[0].name) if parameters else None
    wanted: type[Any] | None = annotation if isinstance(annotation, type) and annotation is not Any else None
    for name, port in ports:
        if wanted is not None and not issubclass(port.type, wanted):
            raise DeclarationError(
                f"{cls.__qualname__}.chart: {where}: {_name(function)} takes a {wanted.__name__}, "
                f"and {name} carries {port.type.__name__}"
            )


def _ports(cls: type[Any]) -> list[tuple[str, Any]]:
    found = dict(declarations(cls).ports) | {
        name: value for name, value in vars(cls).items() if hasattr(value, "event") and hasattr(value, "direction")
    }
    return [(port.name or name, port) for name, port in found.items()]


def _name(act: Any) -> str:
    return act if isinstance(act, str) else getattr(act, "__qualname__", repr(act))
