"""Values of frozen dataclasses, made from their annotations, and what JSON and msgpack can carry."""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from types import MappingProxyType
from typing import Any

from hypothesis import strategies as st

from aiorts import SystemProfile

NUMBERS = st.floats(allow_nan=False)
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
JSON = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
)
"""What `json.loads` may give."""
MSGPACK = st.recursive(
    LEAVES | st.binary(max_size=3) | st.datetimes(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(LEAVES | st.binary(max_size=3), inner, max_size=3)
    ),
)
FROZEN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=2).map(tuple)
        | st.dictionaries(st.text(max_size=5), inner, max_size=2).map(MappingProxyType)
    ),
    max_leaves=4,
)
"""What a field without a type holds after it was read."""
SIMPLE: dict[Any, st.SearchStrategy[Any]] = {
    str: st.text(max_size=5),
    int: st.integers(),
    bool: st.booleans(),
    float: NUMBERS,
    types.NoneType: st.none(),
    Any: FROZEN,
}


def values(hint: Any) -> st.SearchStrategy[Any]:
    """All values of an annotation."""
    if hint in SIMPLE:
        return SIMPLE[hint]
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return st.one_of([values(one) for one in arguments])
    if origin is typing.Literal:
        return st.sampled_from(arguments)
    if origin is tuple and arguments[1:] == (...,):
        return st.lists(values(arguments[0]), max_size=2).map(tuple)
    if origin is tuple:
        return st.tuples(*map(values, arguments))
    if origin is Mapping:
        return st.dictionaries(values(arguments[0]), values(arguments[1]), max_size=2).map(MappingProxyType)
    if origin is dict:
        return st.dictionaries(values(arguments[0]), values(arguments[1]), max_size=2)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return st.sampled_from(hint)
    assert is_dataclass(hint), hint
    return st.deferred(lambda: of_class(hint))


def of_class(kind: Any) -> st.SearchStrategy[Any]:
    """All values of a dataclass, with and without its defaults."""
    hints = typing.get_type_hints(kind) | ({"schema": typing.Literal[1]} if kind is SystemProfile else {})
    required = {one.name: values(hints[one.name]) for one in fields(kind) if one.default is one.default_factory}
    others = {one.name: values(hints[one.name]) for one in fields(kind) if one.name not in required}
    return st.fixed_dictionaries(required, optional=others).map(lambda given: kind(**given))
