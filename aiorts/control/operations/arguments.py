"""Arguments of a client's call of a method: command-line texts or plain data, read by the types of the interface."""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import partial
from inspect import Parameter, Signature
from itertools import chain
from json import loads
from pathlib import PurePath
from typing import Any, Final

from aiorts.errors import AiortsError, InterfaceMismatch
from aiorts.kernel.execution.file_access import check_file
from aiorts.model.annotations import Lenient, Read
from aiorts.model.interface import spelled
from aiorts.model.plain import Schema, SchemaForms
from aiorts.model.values import convert_value, is_path, items_of, pairs_of, shown
from aiorts.types import describe, from_plain


def read_arguments(
    where: str, signature: Signature, args: Sequence[Any], kwargs: Mapping[str, Any]
) -> tuple[list[Any], dict[str, Any]]:
    """Read the arguments of a call, each as the type of its parameter; an argument without a parameter stays as it is.

    Raises:
        InterfaceMismatch: a value does not fit; the text names the parameter, its type and the value.
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
    """Find the paths in an argument."""
    if isinstance(value, PurePath):
        yield value
    elif isinstance(value, Mapping):
        yield from chain.from_iterable(map(_paths, (*value, *value.values())))
    elif isinstance(value, list | tuple | set | frozenset):
        yield from chain.from_iterable(map(_paths, value))
    elif is_dataclass(value):
        yield from chain.from_iterable(_paths(getattr(value, one.name)) for one in fields(value))


def _read(value: Any, hint: Any) -> Any:
    """Read a value by its type; where the type is unknown, a text is read as JSON, or stays if it is none."""
    return _READERS.of(hint)(value)


def _converted(kind: Any, value: Any) -> Any:
    return convert_value(value, kind)


def _none(value: Any) -> None:
    if value is not None and (not isinstance(value, str) or value.strip().lower() not in ("none", "null")):
        raise ValueError("must be none")


class _Readers(Lenient):
    """Readers of a client's values: a list or mapping may be a text, too, as JSON or as `1,2` and `a: 1, b: 2`."""

    def union(self, hint: Any, arms: dict[Any, Read]) -> Read:
        def read(value: Any) -> Any:
            errors = []
            for one in sorted(arms, key=lambda one: one is str):  # str last: it takes any text
                try:
                    return arms[one](value)
                except (TypeError, ValueError) as error:
                    errors.append(str(error))
            raise ValueError(" or ".join(dict.fromkeys(errors)))

        return read

    def words(self, hint: Any, words: tuple[Any, ...]) -> Read:
        return lambda value: next((one for one in words if value == one or value == str(one)), value)

    def fixed(self, hint: Any, items: list[Read]) -> Read:
        return _of_text(super().fixed(hint, items), list, items_of)

    def many(self, hint: Any, kind: Any, item: Read) -> Read:
        return _of_text(super().many(hint, kind, item), list, items_of)

    def mapping(self, hint: Any, kind: Any, key: Any, item: Read) -> Read:
        return _of_text(super().mapping(hint, kind, key, item), dict, pairs_of)

    def members(self, kind: type[Enum]) -> Read:
        return partial(_converted, kind)

    def record(self, kind: type) -> Read:
        return lambda value: from_plain(kind, _plain(value), defaults=True)

    def other(self, hint: Any) -> Read:
        return partial(_converted, hint) if is_path(hint) else _plain


_READERS: Final = _Readers(
    {**{kind: partial(_converted, kind) for kind in (bool, int, float, str)}, None: _none, types.NoneType: _none}
)


def _of_text(read: Read, kind: type, split: Read) -> Read:
    """Make a reader of values of a kind; a text that is not a value of this kind in JSON is first split."""

    def of_text(value: Any) -> Any:
        plain = _plain(value)
        return read(split(value) if isinstance(value, str) and not isinstance(plain, kind) else plain)

    return of_text


# -- what a form needs -------------------------------------------------------------------------------------------------


def value_schema(hint: Any) -> dict[str, Any]:
    """The JSON Schema of values that are read as this type; empty for an unknown type, which takes any value."""
    return _Schemas(simple={float: {"type": "number"}, bytes: {}, None: {"type": "null"}}).of(hint)


class _Schemas(SchemaForms):
    """Schemas for a form to be filled in."""

    def members(self, kind: type[Enum]) -> Schema:
        return {"enum": list(kind.__members__)}

    def record(self, kind: type) -> Schema:
        from aiorts.wire import schema_text

        try:
            schema: Schema = loads(schema_text(kind, as_json=True))
            given = [one.name for one in describe(kind).fields if one.default is MISSING and one.factory is MISSING]
        except AiortsError:  # the record has fields that samples cannot have
            return {}
        del schema["$schema"]
        return {**schema, "required": given}

    def other(self, hint: Any) -> Schema:
        return {"type": "string", "format": "path"} if is_path(hint) else {}


def _plain(value: Any) -> Any:
    """Data as JSON has it; a text is parsed as JSON where it is JSON."""
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
