"""Reads in-ports, out-ports and parameters of a component from a function's signature, without running it.

A plain hint (`float`, `list[str]`, `numpy.ndarray`) stands for the record that carries such data with a time stamp; a
record, a dataclass or `bytes` travels as it is. Anything else is refused with function, parameter and what is allowed.
"""

from __future__ import annotations

import functools
import inspect
import types
import typing
from collections import abc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass, replace
from operator import attrgetter
from typing import Annotated, Any, Final, get_args, get_origin

from aiorts.errors import DeclarationError
from aiorts.kernel.parameters import Declared, Param
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.late import dataclass
from aiorts.model.annotations import alternatives
from aiorts.types.spelling import Array, Tag

_DATA: Final = attrgetter("data")
_EMPTY: Final = inspect.Parameter.empty
_RECORDS: Final[Mapping[object, str]] = {
    float: "TimedDouble",
    int: "TimedLongLong",
    bool: "TimedBoolean",
    str: "TimedString",
    "i16": "TimedShort",
    "i32": "TimedLong",
    "i64": "TimedLongLong",
    "u8": "TimedOctet",
    "u16": "TimedUShort",
    "u32": "TimedULong",
    "u64": "TimedULongLong",
    "f32": "TimedFloat",
    "f64": "TimedDouble",
    "char": "TimedChar",
    "wchar": "TimedWChar",
    "str": "TimedWString",
}
"""The record for a plain hint, or a tagged hint (`i32` of aiorts.types); the name with "Seq" is that for a sequence."""
_STREAMS: Final = (abc.Iterator, abc.Generator, abc.Iterable)
_ASYNC_STREAMS: Final = (abc.AsyncIterator, abc.AsyncGenerator, abc.AsyncIterable)
_ALLOWED: Final = "float, int, bool, str, bytes, list[float], numpy.ndarray, dict[str, ...], a record or a dataclass"


@dataclass(frozen=True, slots=True)
class Carried:
    """The type by which a hint travels."""

    type: type[Any]
    unwrap: Callable[[Any], Any] | None
    """Makes the function's argument from the sample; None: the argument is the sample itself."""


@dataclass(frozen=True, slots=True)
class Inlet:
    """An in-port, and how its sample becomes an argument."""

    name: str
    port: InPort[Any]
    unwrap: Callable[[Any], Any] | None
    default: Any
    """The argument before the first sample; `inspect.Parameter.empty` where the function waits for one."""
    stamped: bool
    plain: bool
    """Whether the argument is the sample's field `data`, unchanged."""


@dataclass(frozen=True, slots=True)
class Outlet:
    """An out-port, and how a result becomes its sample."""

    name: str
    port: OutPort[Any]
    record: Callable[[int, Any], Any] | None
    """Makes the sample from a time stamp and the result; None: the result is the sample itself."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A function as a component."""

    function: Callable[..., Any]
    label: str
    inlets: tuple[Inlet, ...]
    outlets: tuple[Outlet, ...]
    params: Mapping[str, Declared]
    several: bool
    """Whether a result is a tuple with one item for each out-port."""
    streams: bool
    """Whether a call gives an iterator of results."""
    awaits: bool
    """Whether the call, or its iterator, is awaited."""


def read_signature(
    function: Callable[..., Any], label: str, output: str | Sequence[str] | None, hints: Mapping[str, Any] | None
) -> Plan:
    """The plan of a function.

    Args:
        label: its name in messages.
        output: names of its out-ports, in place of `output`, `output0`, ... or a NamedTuple's own.
        hints: hints for parameters without one of their own; a parameter with a default and no hint is then left out.

    Raises:
        DeclarationError: a hint is missing or unsupported, or a parameter cannot be a port.
    """
    where = f"component({label})"
    plain = function.func if isinstance(function, functools.partial) else function
    if not (inspect.isroutine(plain) and callable(plain)):
        what = "a class" if isinstance(plain, type) else f"an object of {type(plain).__qualname__}"
        raise DeclarationError(f"{where}: expected a function or a method, got {what}; wrap it in a `def`")
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        raise DeclarationError(f"{where}: its signature cannot be read; wrap it in a `def` with type hints") from None
    known = _hints(plain, where) | dict(hints or {})
    _check_names(where, hints, parameters)
    inlets: list[Inlet] = []
    params: dict[str, Declared] = {}
    for parameter in parameters:
        hint = known.get(parameter.name, _EMPTY)
        if hint is _EMPTY and hints is not None and (parameter.default is not _EMPTY or _is_variable(parameter)):
            continue
        _check_parameter(where, parameter, hint)
        if parameter.kind is parameter.KEYWORD_ONLY:
            params[parameter.name] = _declared(parameter.default, hint)
        else:
            inlets.append(_inlet(f"{where}: parameter {parameter.name}", parameter, hint))
    streams, awaits, result = _result(where, plain, known.get("return", _EMPTY))
    outlets, several = _outlets(where, result, output)
    _check_taken(where, {one.name for one in inlets} | params.keys(), {one.name for one in outlets})
    return Plan(_callable(function, params), label, tuple(inlets), tuple(outlets), params, several, streams, awaits)


# -- the parameters ----------------------------------------------------------------------------------------------------


def _hints(function: Any, where: str) -> dict[str, Any]:
    target = getattr(function, "__func__", function)
    try:
        return typing.get_type_hints(target, include_extras=True)
    except NameError as error:
        raise DeclarationError(
            f"{where}: a type hint names {error.name!r}, which is not there at run time; import it outside of "
            "TYPE_CHECKING"
        ) from None
    except TypeError as error:
        raise DeclarationError(f"{where}: its type hints cannot be read: {error}") from None


def _check_names(where: str, hints: Mapping[str, Any] | None, parameters: abc.Iterable[inspect.Parameter]) -> None:
    names = [parameter.name for parameter in parameters] + ["return"]
    for name in hints or ():
        if name not in names:
            raise DeclarationError(f"{where}: hints[{name!r}]: no such parameter; there are {', '.join(names)}")


def _check_taken(where: str, ins: set[str], outs: set[str]) -> None:
    for name in sorted((ins | outs) & {"function", "max_instance"}):
        raise DeclarationError(f"{where}: a component has a {name} of its own; choose another name")
    for name in sorted(ins & outs):
        raise DeclarationError(
            f'{where}: {name} is a parameter and an out-port; name the out-port: component(..., output="result")'
        )


def _is_variable(parameter: inspect.Parameter) -> bool:
    return parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)


def _check_parameter(where: str, parameter: inspect.Parameter, hint: Any) -> None:
    if _is_variable(parameter):
        raise DeclarationError(f"{where}: {parameter}: each port needs a name; write the parameters out one by one")
    if parameter.kind is parameter.KEYWORD_ONLY and parameter.default is _EMPTY:
        raise DeclarationError(
            f"{where}: {parameter.name} is keyword-only, a parameter to configure, and needs a default: "
            f"{parameter.name}: float = 0.0"
        )
    if hint is _EMPTY:
        raise DeclarationError(f"{where}: parameter {parameter.name} has no type hint; allowed: {_ALLOWED}")


def _declared(default: Any, hint: Any) -> Declared:
    kind = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    if isinstance(default, Declared):
        return default if default.type is not None else replace(default, type=kind)
    declared: Any = Param(default, type=kind)
    made: Declared = declared
    return made


def _callable(function: Callable[..., Any], params: Mapping[str, Declared]) -> Callable[..., Any]:
    """The function with plain values for defaults that are `Param(...)`, so that it can still be called directly."""
    defaults = getattr(function, "__kwdefaults__", None) or {}
    if not any(isinstance(value, Declared) for value in defaults.values()) or not inspect.isfunction(function):
        return function
    copy = types.FunctionType(
        function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    )
    functools.update_wrapper(copy, function)
    del copy.__wrapped__  # type: ignore[attr-defined] # it is the function itself, not a wrapper
    copy.__kwdefaults__ = {
        name: value.default if isinstance(value, Declared) else value for name, value in defaults.items()
    }
    return copy


def _inlet(where: str, parameter: inspect.Parameter, hint: Any) -> Inlet:
    from aiorts.types import has_tm

    kind, given = _bare(hint)
    kind = _without_none(kind)[0]
    port = _given_port(where, given, InPort)
    carried = _carried(where, kind, None if port is None else port.type)
    if port is None:
        port = InPort(carried.type)
    return Inlet(parameter.name, port, carried.unwrap, parameter.default, has_tm(carried.type), carried.unwrap is _DATA)


# -- the result --------------------------------------------------------------------------------------------------------


def _result(where: str, function: Any, hint: Any) -> tuple[bool, bool, Any]:
    """Whether the function streams, whether its call is awaited, and the hint of one result."""
    if hint is _EMPTY:
        raise DeclarationError(f"{where}: the result has no type hint; write -> None, or: {_ALLOWED}")
    origin, args = get_origin(hint) or hint, get_args(hint)
    generator = inspect.isgeneratorfunction(function)
    asynchronous = inspect.isasyncgenfunction(function)
    if asynchronous or origin in _ASYNC_STREAMS[:2]:
        if origin not in _ASYNC_STREAMS or not args:
            raise DeclarationError(
                f"{where}: is an async generator; its result is AsyncIterator[TYPE], got {_named(hint)}"
            )
        return True, True, args[0]
    if generator or origin in _STREAMS[:2]:
        if origin not in _STREAMS or not args:
            raise DeclarationError(f"{where}: is a generator; its result is Iterator[TYPE], got {_named(hint)}")
        if inspect.iscoroutinefunction(function):
            raise DeclarationError(f"{where}: `async def` with an Iterator; write AsyncIterator[TYPE] and `yield`")
        return True, False, args[0]
    return False, inspect.iscoroutinefunction(function), hint


def _outlets(where: str, hint: Any, output: str | Sequence[str] | None) -> tuple[list[Outlet], bool]:
    kind, given = _bare(hint)
    kind = _without_none(kind)[0]
    if kind is None or kind is type(None):
        return _named_outlets(where, [], [], output), False
    names: list[str] = []
    if isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields"):
        hints = typing.get_type_hints(kind, include_extras=True)
        names, items = list(hints), list(hints.values())
    elif get_origin(kind) is tuple and get_args(kind) and get_args(kind)[-1] is not Ellipsis:
        items = list(get_args(kind))
        names = [f"output{number}" for number in range(len(items))]
    else:
        return _named_outlets(where, [hint], ["output"], output), False
    if any(isinstance(one, Port) for one in given):
        raise DeclarationError(f"{where}: one OutPort for several results; annotate each item of the tuple")
    return _named_outlets(where, items, names, output), True


def _named_outlets(where: str, hints: list[Any], names: list[str], output: str | Sequence[str] | None) -> list[Outlet]:
    if output is not None:
        chosen = [output] if isinstance(output, str) else list(output)
        if len(chosen) != len(hints):
            raise DeclarationError(f"{where}: output={output!r}: {len(chosen)} names for {len(hints)} results")
        names = chosen
    if len(set(names)) < len(names):
        raise DeclarationError(f"{where}: output={output!r}: two results of one name")
    return [
        _outlet(f"{where}: the result" if len(hints) == 1 else f"{where}: result {name}", name, hint)
        for name, hint in zip(names, hints, strict=True)
    ]


def _outlet(where: str, name: str, hint: Any) -> Outlet:
    kind, given = _bare(hint)
    kind = _without_none(kind)[0]
    port = _given_port(where, given, OutPort)
    carried = _carried(where, kind, None if port is None else port.type)
    if port is None:
        port = OutPort(carried.type)
    return Outlet(name, port, None if carried.unwrap is None else carried.type)


# -- hints -------------------------------------------------------------------------------------------------------------


def _bare(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """The hint and its annotations; for a tagged hint (`i32`), the tag is the hint."""
    if get_origin(hint) is not Annotated:
        return hint, ()
    kind, *given = get_args(hint)
    tags = [one for one in given if type(one) is Tag]
    return (hint if tags else kind), tuple(given)


def _without_none(hint: Any) -> tuple[Any, bool]:
    kinds = alternatives(hint)
    others = [kind for kind in kinds if kind is not type(None)]
    return (others[0], True) if len(others) == 1 < len(kinds) else (hint, False)


def _given_port(where: str, given: tuple[Any, ...], kind: type[Any]) -> Any:
    """The declaration in `Annotated[float, InPort(TimedDouble, unit="m")]`."""
    for one in given:
        if isinstance(one, kind):
            return one
        if isinstance(one, Port):
            raise DeclarationError(f"{where}: is annotated with {one!r}; expected {kind.__name__}(...)")
    return None


def _carried(where: str, hint: Any, wanted: type[Any] | None) -> Carried:
    """The type by which a hint travels: the record type `wanted` if the annotation names one."""
    from aiorts.types import check_port_type, fields_of

    found = _plain(hint)
    if wanted is not None:
        if wanted is hint:
            return Carried(wanted, None)
        has_data = is_dataclass(wanted) and [field.name for field in fields_of(wanted)] == ["tm", "data"]
        if not has_data:
            raise DeclarationError(
                f"{where}: is {_named(hint)} and its port {_named(wanted)}; a port for plain data has a record of "
                "`tm` and `data`"
            )
        return Carried(wanted, _DATA if found is None else found.unwrap)
    if found is not None:
        return found
    try:
        check_port_type(hint)
    except DeclarationError as error:
        reason = f"; {error}" if is_dataclass(hint) else ""
        raise DeclarationError(f"{where}: {_named(hint)} cannot travel; allowed: {_ALLOWED}{reason}") from None
    return Carried(hint, None)


def _plain(hint: Any) -> Carried | None:
    """The record and the way back of a plain hint; None for a type that travels as it is, or cannot."""
    import aiorts.types as records

    while hasattr(hint, "__supertype__"):  # a NewType
        hint = hint.__supertype__
    while type(alias := get_origin(hint) or hint).__name__ == "TypeAliasType":  # as numpy's NDArray from Python 3.12 on
        hint = alias.__value__
    origin, args = get_origin(hint), get_args(hint)
    if origin is None and getattr(hint, "__module__", "") == "numpy" and hint.__name__ == "ndarray":
        return Carried(records.TimedNDArray, _DATA)
    if getattr(origin, "__module__", "") == "numpy":
        return Carried(records.TimedNDArray, _DATA)
    if hint is dict or origin in (dict, abc.Mapping, abc.MutableMapping):
        if args and args[0] is not str:
            return None
        return Carried(records.TimedMap, lambda sample: dict(sample.data))
    is_sequence = origin in (list, abc.Sequence, Array) or (origin is tuple and args[1:] == (Ellipsis,))
    kind = args[0] if is_sequence else hint
    tags = [one for one in get_args(kind)[1:] if type(one) is Tag] if get_origin(kind) is Annotated else []
    try:
        name = _RECORDS.get(str(tags[0]) if tags else kind)
    except TypeError:  # not hashable: an Annotated with a list in it
        name = None
    if name is None:
        return None
    if not is_sequence:
        return Carried(getattr(records, name), _DATA)
    back = _DATA if origin is Array else _tuple if origin is tuple else _list
    return Carried(getattr(records, f"{name}Seq"), back)


def _list(sample: Any) -> list[Any]:
    data = sample.data
    plain: list[Any] = data.tolist() if hasattr(data, "tolist") else list(data)
    return plain


def _tuple(sample: Any) -> tuple[Any, ...]:
    return tuple(_list(sample))


def _named(hint: Any) -> str:
    if isinstance(hint, type) and not get_args(hint):
        return hint.__qualname__
    return str(hint).replace("typing.", "").replace("collections.abc.", "")
