"""Makes one result, such as a reader, a writer or a schema, of each form of annotation; pure."""

from __future__ import annotations

import typing
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import is_dataclass
from enum import Enum
from types import NoneType, UnionType
from typing import Any, Final, Generic, TypeVar

M = TypeVar("M")
_UNIONS: Final = (typing.Union, UnionType)
_LISTS: Final = (tuple, list, set, frozenset, Sequence, Set)
_MAPPINGS: Final = (dict, Mapping)
Read = Callable[[Any], Any]


def alternatives(hint: Any) -> tuple[Any, ...]:
    """The arms of a union, else the annotation itself; None as its type."""
    if typing.get_origin(hint) in _UNIONS:
        return typing.get_args(hint)
    return (NoneType if hint is None else hint,)


def fields_of_row(hint: Any) -> Mapping[str, Any]:
    """The field annotations of a NamedTuple, which is a row of values by name; empty for another annotation."""
    is_row = isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields")
    return typing.get_type_hints(hint) if is_row else {}


class ByAnnotation(Generic[M]):
    """Makes one result per annotation. A subclass has a method for each form that it knows, and `other` for the rest.

    `union` gets the results of its arms, by arm; `words` the words of a Literal; `fixed` the results of the elements
    of a tuple, or of the fields of a NamedTuple; `many` the class of a list or set, and the result of an element;
    `mapping` the class, the annotation of its keys, and the result of a value; `members` is for an Enum, `record` for
    a dataclass.

    Args:
        simple: the results of single annotations.
    """

    def __init__(self, simple: Mapping[Any, M]) -> None:
        self._simple = simple

    def of(self, hint: Any) -> M:
        """The result of an annotation."""
        if hint in self._simple:
            return self._simple[hint]
        origin, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
        if origin in _UNIONS:
            return self.union(hint, {one: self.of(one) for one in parts})
        if origin is typing.Literal:
            return self.words(hint, parts)
        if origin is tuple and origin is not hint and parts[1:] != (...,):
            return self.fixed(hint, list(map(self.of, parts)))
        if row := fields_of_row(hint):
            return self.fixed(hint, list(map(self.of, row.values())))
        if origin in _LISTS:
            return self.many(hint, origin, self.of(parts[0] if parts else Any))
        if origin in _MAPPINGS:
            key, item = parts or (Any, Any)
            return self.mapping(hint, origin, key, self.of(item))
        if isinstance(hint, type) and issubclass(hint, Enum):
            return self.members(hint)
        return self.record(hint) if isinstance(hint, type) and is_dataclass(hint) else self.other(hint)

    def other(self, hint: Any) -> M:
        """The result of an annotation of another form."""
        raise NotImplementedError

    def _rest(self, hint: Any, *_parts: Any) -> M:
        return self.other(hint)

    union: Callable[..., M] = _rest
    words: Callable[..., M] = _rest
    fixed: Callable[..., M] = _rest
    many: Callable[..., M] = _rest
    mapping: Callable[..., M] = _rest
    members: Callable[..., M] = _rest
    record: Callable[..., M] = _rest


def as_it_is(value: Any) -> Any:
    """The value itself."""
    return value


class Lenient(ByAnnotation[Read]):
    """Readers of plain data: lists become what the annotation says, element by element; other values stay."""

    def fixed(self, hint: Any, items: list[Read]) -> Read:
        def read(value: Any) -> Any:
            if type(value) is not list or len(value) != len(items):
                return tuple(value) if type(value) is list else value
            return tuple([item(one) for item, one in zip(items, value, strict=True)])

        return read

    def many(self, hint: Any, kind: Any, item: Read) -> Read:
        made = {Sequence: list, Set: set}.get(kind, kind)
        return lambda value: made(list(map(item, value))) if type(value) is list else value

    def mapping(self, hint: Any, kind: Any, key: Any, item: Read) -> Read:
        name = self.of(key)

        def read(value: Any) -> Any:
            return {name(key): item(one) for key, one in value.items()} if type(value) is dict else value

        return read

    def other(self, hint: Any) -> Read:
        return as_it_is
