"""What a client gives for a method: texts of a command line, or plain data, by the types that the interface says."""

from __future__ import annotations

import enum
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from inspect import Parameter, Signature
from itertools import chain
from json import loads
from pathlib import PurePath
from typing import Any, Final

from aiorts.errors import AiortsError, InterfaceMismatch
from aiorts.kernel.execution.file_access import check_file
from aiorts.model.interface import spelled
from aiorts.model.values import convert_value, is_path, shown
from aiorts.types import describe, from_plain

_LISTS: Final[Mapping[Any, Any]] = {list: list, set: set, frozenset: frozenset}
_SCALARS: Final = (bool, int, float, str)


def read_arguments(
    where: str, signature: Signature, args: Sequence[Any], kwargs: Mapping[str, Any]
) -> tuple[list[Any], dict[str, Any]]:
    """The arguments of a call, each of the type that its parameter has; what has no parameter stays as it is.

    Raises:
        InterfaceMismatch: names the parameter, what it takes and what was given.
        DeniedError: a path names a file that the client may not name.
    """
    parameters = signature.parameters
    order = [one for one in parameters.values() if one.kind is not Parameter.KEYWORD_ONLY]
    read = [_argument(where, order[index], value) if index < len(order) else value for index, value in enumerate(args)]
    named = {
        name: _argument(where, parameters[name], value) if name in parameters else value
        for name, value in kwargs.items()
    }
    return read, named


def _argument(where: str, parameter: Parameter, value: Any) -> Any:
    try:
        read = _read(value, parameter.annotation)
    except (TypeError, ValueError, RecursionError) as error:
        kind = spelled(parameter.annotation)
        raise InterfaceMismatch(f"{where}: {parameter.name}: {kind} = {shown(value)}: {error}") from None
    for path in _paths(read):
        check_file(f"{where}: {parameter.name}", path)
    return read


def _paths(value: Any) -> Iterator[PurePath]:
    """The paths in an argument."""
    if isinstance(value, PurePath):
        yield value
    elif isinstance(value, Mapping):
        yield from chain.from_iterable(map(_paths, (*value, *value.values())))
    elif isinstance(value, list | tuple | set | frozenset):
        yield from chain.from_iterable(map(_paths, value))
    elif is_dataclass(value):
        yield from chain.from_iterable(_paths(getattr(value, one.name)) for one in fields(value))


def _read(value: Any, hint: Any) -> Any:
    """A value by its type; one whose type is not known is JSON, or else the text that it is."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return _one_of(value, typing.get_args(hint))
    if hint is None or hint is type(None):
        if value is None or (isinstance(value, str) and value.strip().lower() in ("none", "null")):
            return None
        raise ValueError("must be none")
    if hint in _SCALARS or is_path(hint) or (isinstance(hint, type) and issubclass(hint, enum.Enum)):
        return convert_value(value, hint)
    origin, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin is typing.Literal:
        return next((one for one in parts if value == one or value == str(one)), value)
    plain = _plain(value)
    if isinstance(hint, type) and is_dataclass(hint):
        return from_plain(hint, plain, defaults=True)
    if origin in _LISTS and isinstance(plain, list):
        return _LISTS[origin](_read(one, parts[0]) if parts else one for one in plain)
    if origin is tuple and isinstance(plain, list):
        kinds = parts[:1] * len(plain) if parts[1:] == (...,) else parts
        return tuple(map(_read, plain, kinds)) if len(kinds) == len(plain) else tuple(plain)
    if origin in (dict, Mapping) and isinstance(plain, dict) and len(parts) == 2:
        return {_read(key, parts[0]): _read(one, parts[1]) for key, one in plain.items()}
    if isinstance(value, str) and origin in (dict, Mapping) and parts[:1] == (str,):  # a: 1, b: 2
        return dict(convert_value(value, types.GenericAlias(Mapping, parts)))
    if isinstance(value, str) and origin in (tuple, *_LISTS) and parts:  # 1,2,3
        return _LISTS.get(origin, tuple)(
            convert_value(value, hint if origin is tuple else types.GenericAlias(tuple, (parts[0], ...)))
        )
    return plain


def _one_of(value: Any, hints: Sequence[Any]) -> Any:
    errors = []
    for hint in sorted(hints, key=lambda hint: hint is str):  # any text is a text
        try:
            return _read(value, hint)
        except (TypeError, ValueError) as error:
            errors.append(str(error))
    raise ValueError(" or ".join(dict.fromkeys(errors)))


# -- what a form needs -------------------------------------------------------------------------------------------------


def value_schema(hint: Any) -> dict[str, Any]:
    """The JSON Schema of what is read as a value of this type; empty where that is not known, as any may be one."""
    if hint in _SCHEMAS:
        return dict(_SCHEMAS[hint])
    origin, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return {"anyOf": list(map(value_schema, parts))}
    if origin is typing.Literal:
        return {"enum": list(parts)}
    if is_path(hint):
        return {"type": "string", "format": "path"}
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return {"enum": list(hint.__members__)}
    if isinstance(hint, type) and is_dataclass(hint):
        return _record_schema(hint)
    if origin is tuple and parts and parts[1:] != (...,):
        return {"type": "array", "prefixItems": list(map(value_schema, parts)), "items": False, "minItems": len(parts)}
    if origin in (tuple, *_LISTS):
        return {"type": "array", "items": value_schema(parts[0]) if parts else {}}
    if origin in (dict, Mapping):
        return {"type": "object", "additionalProperties": value_schema(parts[1]) if len(parts) == 2 else {}}
    return {}


def _record_schema(cls: type) -> dict[str, Any]:
    from aiorts.wire import schema_text

    try:
        schema: dict[str, Any] = loads(schema_text(cls, as_json=True))
        given = [one.name for one in describe(cls).fields if one.default is MISSING and one.factory is MISSING]
    except AiortsError:  # it has fields that samples cannot have
        return {}
    del schema["$schema"]
    return {**schema, "required": given}


_SCHEMAS: Final[Mapping[Any, Mapping[str, Any]]] = {
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": "number"},
    str: {"type": "string"},
    None: {"type": "null"},
    types.NoneType: {"type": "null"},
}


def _plain(value: Any) -> Any:
    """Data as JSON has it, of a text what it says as JSON."""
    if isinstance(value, str):
        try:
            return loads(value)
        except ValueError:
            return value
    if isinstance(value, Mapping):
        return {key: _plain_inside(one) for key, one in value.items()}
    return [_plain_inside(one) for one in value] if isinstance(value, tuple | list) else value


def _plain_inside(value: Any) -> Any:
    return value if isinstance(value, str) else _plain(value)
