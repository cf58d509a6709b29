"""Interfaces of services as values: the methods that a Protocol asks for, those of a provider, and the differences.

This file reads and compares; it calls nothing and waits for nothing. An interface consists of methods with named
parameters: `async def`, which a caller awaits, or plain `def`, which never waits. An `async def` of the interface
may be either at the provider; a plain method has to be plain.
"""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, TypeAlias

from aiorts.errors import DeclarationError
from aiorts.late import dataclass
from aiorts.model.annotations import ByAnnotation, alternatives
from aiorts.model.profile import MethodProfile, ParameterProfile

Check: TypeAlias = Callable[[Any], bool]

_EMPTY: Final = inspect.Parameter.empty
_EITHER: Final = inspect.Parameter.POSITIONAL_OR_KEYWORD
_POSITION: Final = inspect.Parameter.POSITIONAL_ONLY
_KEYWORD: Final = inspect.Parameter.KEYWORD_ONLY
_VAR_POSITION: Final = inspect.Parameter.VAR_POSITIONAL
_VAR_KEYWORD: Final = inspect.Parameter.VAR_KEYWORD
_KINDS: Final[dict[Any, str]] = {_EITHER: "either", _POSITION: "position", _KEYWORD: "keyword"}
IDEMPOTENT: Final = "_aiorts_idempotent"
"""The attribute that marks a method that may be called again."""
_CONTAINERS: Final = (list, dict, tuple, set, frozenset)


@dataclass(frozen=True, slots=True)
class Method:
    """One method: its parameters without `self`, with the types that could be resolved."""

    name: str
    parameters: tuple[inspect.Parameter, ...]
    returns: Any
    doc: str
    plain: bool
    idempotent: bool = False
    """Whether a call of unknown outcome may be made again."""

    @property
    def profile(self) -> MethodProfile:
        """The method as plain data."""
        parameters = tuple(
            ParameterProfile(
                parameter.name,
                spelled(parameter.annotation),
                None if parameter.default is _EMPTY else repr(parameter.default),
                _KINDS.get(parameter.kind, "either"),
            )
            for parameter in self.parameters
        )
        return MethodProfile(self.name, parameters, spelled(self.returns), self.doc, self.plain)

    @property
    def signature(self) -> inspect.Signature:
        """The signature for a caller, without `self`."""
        return inspect.Signature(list(self.parameters))


@dataclass(frozen=True, slots=True)
class Interface:
    """The methods of one Protocol, by name, in the order they are written."""

    name: str
    doc: str
    methods: Mapping[str, Method]


def read_interface(protocol: object) -> Interface:
    """The methods that a Protocol asks for.

    Raises:
        DeclarationError: `protocol` is no Protocol, or has something that is not a method with named parameters.
    """
    if not (isinstance(protocol, type) and getattr(protocol, "_is_protocol", False)):
        raise DeclarationError(f"{spelled(protocol)}: an interface is a typing.Protocol with methods")
    name, methods = protocol.__name__, dict[str, Method]()
    for base in reversed(protocol.__mro__):
        if base in (object, typing.Protocol, typing.Generic):
            continue
        for attribute in inspect.get_annotations(base):
            if not attribute.startswith("_"):
                raise DeclarationError(f"{name}.{attribute}: is a value; an interface has methods only")
        for attribute, value in vars(base).items():
            if attribute.startswith("_"):
                continue
            if not inspect.isfunction(value):
                raise DeclarationError(f"{name}.{attribute}: is no method (`def` or `async def`) but {value!r:.60}")
            methods[attribute] = _checked(name, read_method(attribute, value, bound=False))
    if not methods:
        raise DeclarationError(f"{name}: an interface needs a method at least")
    return Interface(name, inspect.getdoc(protocol) or "" if protocol.__doc__ else "", types.MappingProxyType(methods))


def _checked(interface: str, method: Method) -> Method:
    for parameter in method.parameters:
        if parameter.kind in (_VAR_POSITION, _VAR_KEYWORD):
            raise DeclarationError(
                f"{interface}.{method.name}: *{parameter.name}: each parameter needs a name of its own"
            )
    return method


def read_method(name: str, function: Callable[..., Any], *, bound: bool) -> Method:
    """Read a function as a method; a `bound` function has no `self` any more.

    Raises:
        DeclarationError: the function is a generator, or its parameters cannot be known.
    """
    if inspect.isgeneratorfunction(function) or inspect.isasyncgenfunction(function):
        raise DeclarationError(f"{name}: is a generator (it contains `yield`); a method of a service returns once")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError) as error:
        raise DeclarationError(f"{name}: {function!r:.60}: its parameters cannot be known: {error}") from None
    hints = _hints(function)
    given = list(signature.parameters.values())
    if not bound:
        given = given[1:]
    parameters = tuple(one.replace(annotation=hints.get(one.name, one.annotation)) for one in given)
    returns = hints.get("return", signature.return_annotation)
    doc = (inspect.getdoc(function) or "") if getattr(function, "__doc__", None) else ""
    repeats = bool(getattr(function, IDEMPOTENT, False))
    return Method(name, parameters, returns, doc, not inspect.iscoroutinefunction(function), repeats)


def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    """The annotations, resolved one by one; an annotation with an unknown name stays text."""
    function = inspect.unwrap(getattr(function, "__func__", function))
    found: dict[str, Any] = {}
    for name, hint in getattr(function, "__annotations__", {}).items():
        holder = types.SimpleNamespace(__annotations__={name: hint})
        try:
            found[name] = typing.get_type_hints(holder, getattr(function, "__globals__", {}))[name]
        except (NameError, TypeError, AttributeError, SyntaxError):
            found[name] = hint
    return found


def spelled(hint: Any) -> str:
    """A type as it is written in annotations."""
    if hint is _EMPTY:
        return ""
    if hint is None or hint is type(None):
        return "None"
    if isinstance(hint, str):
        return hint
    if isinstance(hint, type) and not typing.get_args(hint):
        return hint.__name__
    if _generic(hint) is not None:
        return f"{_generic(hint).__name__}[{', '.join(map(spelled, typing.get_args(hint)))}]"
    return str(hint).replace("typing.", "")


def _generic(hint: Any) -> Any:
    """The class of a type such as `Goal[float, str]`, which is generic and not built in; None for all others."""
    origin = typing.get_origin(hint)
    parameters = getattr(origin, "__parameters__", None)
    return origin if isinstance(parameters, tuple) and parameters else None


# -- comparing ---------------------------------------------------------------------------------------------------------


def differences(wanted: Mapping[str, Method], given: Mapping[str, Method]) -> list[str]:
    """The reasons why `given` cannot answer every call of the `wanted` methods, a line each; empty where it can."""
    found = []
    for name, method in wanted.items():
        other = given.get(name)
        if other is None:
            found.append(f"there is no method {method.profile}")
        else:
            reason = _difference(method, other)
            if reason:
                found.append(f"{reason}: wanted {method.profile}, there is {other.profile}")
    return found


def _difference(wanted: Method, given: Method) -> str:
    if wanted.plain and not given.plain:
        return f"{wanted.name} may not wait"
    return _parameters_differ(wanted, given) or (
        ""
        if fits(given.returns, wanted.returns)
        else f"{wanted.name} returns {spelled(given.returns)}, not {spelled(wanted.returns)}"
    )


def _parameters_differ(wanted: Method, given: Method) -> str:
    any_position = any(parameter.kind is _VAR_POSITION for parameter in given.parameters)
    any_keyword = any(parameter.kind is _VAR_KEYWORD for parameter in given.parameters)
    in_order = [parameter for parameter in given.parameters if parameter.kind in (_POSITION, _EITHER)]
    by_name = {parameter.name: parameter for parameter in given.parameters if parameter.kind in (_EITHER, _KEYWORD)}
    met: set[str] = set()
    for index, parameter in enumerate(wanted.parameters):
        where = f"{wanted.name}, parameter {parameter.name}"
        if parameter.kind is _KEYWORD:
            other, anything = by_name.get(parameter.name), any_keyword
        else:
            other = in_order[index] if index < len(in_order) else None
            anything = any_position and (parameter.kind is _POSITION or any_keyword)
            if other is not None and parameter.kind is _EITHER:
                if other.kind is _POSITION:
                    return f"{where}: can be given by position only"
                if other.name != parameter.name:
                    return f"{where}: is called {other.name}"
        if other is None:
            if not anything or (parameter.kind is _EITHER and parameter.name in by_name):
                return f"{where}: is not taken"
            continue
        if other.name in met:
            return f"{where}: is given twice, by position and by name"
        met.add(other.name)
        if parameter.default is not _EMPTY and other.default is _EMPTY:
            return f"{where}: has no default"
        if not fits(parameter.annotation, other.annotation):
            return f"{where}: is {spelled(other.annotation)}, not {spelled(parameter.annotation)}"
    for parameter in given.parameters:
        named = parameter.kind not in (_VAR_POSITION, _VAR_KEYWORD)
        if named and parameter.name not in met and parameter.default is _EMPTY:
            return f"{wanted.name}, parameter {parameter.name}: is needed and never given"
    return ""


def fits(one: Any, other: Any) -> bool:
    """Whether a value of the first type may stand where the second is required, as far as that can be known."""
    if other in (_EMPTY, Any, object) or one in (_EMPTY, Any) or one == other:
        return True
    parts, others = alternatives(one), alternatives(other)
    if not len(parts) == len(others) == 1:
        return all(any(fits(part, another) for another in others) for part in parts)
    one, other = parts[0], others[0]
    if isinstance(one, type) and isinstance(other, type) and not (typing.get_args(one) or typing.get_args(other)):
        if getattr(other, "_is_protocol", False):
            return True  # structural: not to be known from the class alone
        return issubclass(one, other) or (other is float and issubclass(one, int))
    if (_generic(one) or one) is (_generic(other) or other):
        return all(map(fits, typing.get_args(one), typing.get_args(other)))
    return spelled(one) == spelled(other)


# -- checking results --------------------------------------------------------------------------------------------------


def check_of(hint: Any) -> Check | None:
    """A check whether a value is of this type, in containers element by element.

    None for types that are not checked: Protocols, type variables, unknown names.
    """
    return _CHECKS.of(hint)


class _Checks(ByAnnotation["Check | None"]):
    """The checks of annotations."""

    def union(self, hint: Any, arms: dict[Any, Check | None]) -> Check | None:
        known = [check for check in arms.values() if check is not None]
        return (lambda value: any(check(value) for check in known)) if len(known) == len(arms) else None

    def mapping(self, hint: Any, kind: Any, key: Any, item: Check | None) -> Check | None:
        if kind is not dict:
            return self.other(hint)
        keys = self.of(key)
        return lambda value: (
            isinstance(value, dict)
            and (keys is None or all(map(keys, value)))
            and (item is None or all(map(item, value.values())))
        )

    def fixed(self, hint: Any, items: list[Check | None]) -> Check:
        return lambda value: (
            isinstance(value, tuple)
            and len(value) == len(items)
            and all(check is None or check(element) for check, element in zip(items, value, strict=True))
        )

    def many(self, hint: Any, kind: Any, item: Check | None) -> Check | None:
        if kind not in _CONTAINERS:
            return self.other(hint)
        if item is None:
            return lambda value: isinstance(value, kind)
        # Ten thousand numbers of exactly this type are compared as one set, with no check of each.
        exact = {typing.get_args(hint)[0]}
        return lambda value: isinstance(value, kind) and (set(map(type, value)) <= exact or all(map(item, value)))

    def other(self, hint: Any) -> Check | None:
        plain = isinstance(hint, type) and typing.get_origin(hint) is None and not getattr(hint, "_is_protocol", False)
        return (lambda value: isinstance(value, hint)) if plain else None


def _is_none(value: Any) -> bool:
    return value is None


_CHECKS: Final = _Checks(
    {
        **dict.fromkeys((_EMPTY, Any, object)),
        **dict.fromkeys((None, types.NoneType), _is_none),
        float: lambda value: isinstance(value, float | int) and not isinstance(value, bool),
        int: lambda value: isinstance(value, int) and not isinstance(value, bool),
    }
)


def misfit(hint: Any, value: Any) -> tuple[str, Any]:
    """The innermost part of a value that is not of the type: its place ("[3]", "['a'][0]"), and the part itself."""
    for one in alternatives(hint):
        kind = typing.get_origin(one)
        if kind in _CONTAINERS and isinstance(value, kind):
            for place, part, element in _elements(kind, typing.get_args(one), value):
                check = check_of(part)
                if check is not None and not check(element):
                    inside, what = misfit(part, element)
                    return place + inside, what
    return "", value


def _elements(kind: Any, hints: tuple[Any, ...], value: Any) -> Iterator[tuple[str, Any, Any]]:
    if kind is dict:
        for key, element in value.items():
            yield f"[key {key!r:.40}]", hints[0], key
            yield f"[{key!r:.40}]", hints[1], element
    elif kind is tuple and hints[1:] != (...,):
        if len(hints) == len(value):
            for index, (part, element) in enumerate(zip(hints, value, strict=True)):
                yield f"[{index}]", part, element
    else:
        for index, element in enumerate(value):
            yield f"[{index}]" if kind in (list, tuple) else "[an element]", hints[0], element
