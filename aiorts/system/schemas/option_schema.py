"""The JSON Schema of declared options: the words of each, or its type and range, its default and its description."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Final

from aiorts.model.declared import Option, words_of
from aiorts.model.values import TRUTH, WHOLE

_FLOAT: Final = r"[+-]?[0-9._]+([eE][+-]?[0-9]+)?"


def _spelled(word: str) -> str:
    """The pattern of a word in any case."""
    return "".join(f"[{c}{c.upper()}]" if c.isalpha() else c for c in word)


def _text(*patterns: str) -> dict[str, Any]:
    """The schema of a text that matches one of these patterns, with blanks round it allowed."""
    return {"type": "string", "pattern": rf"^\s*({'|'.join(patterns)})\s*$"}


YES_TEXT: Final = _text(*map(_spelled, TRUTH))
WHOLE_TEXT: Final = _text(WHOLE)


def _choice(kind: type[StrEnum], one: Option) -> dict[str, Any]:
    """The schema of an option with words: the words for editors to offer, and the words in any case, with blanks."""
    words = [*(member.value for member in kind), *one.words, *([""] if one.default is None else [])]
    return {"anyOf": [{"enum": words}, _text(*map(_spelled, words))]}


def _number(kind: type, one: Option) -> dict[str, Any]:
    return {"anyOf": [_range(kind, one), WHOLE_TEXT if kind is int else _text(_FLOAT)]}


def _range(kind: type, one: Option) -> dict[str, Any]:
    return {"type": "integer" if kind is int else "number", **limits_schema(one)}


def limits_schema(one: Option) -> dict[str, Any]:
    """The JSON Schema of the range of a number."""
    ends = {"minimum": one.low, "exclusiveMinimum": one.above, "maximum": None if one.endless else one.high}
    return {word: end for word, end in ends.items() if end is not None}


def _length(one: Option) -> dict[str, Any]:
    """The JSON Schema of the number of a text's characters."""
    ends = {"minLength": one.low, "maxLength": one.high}
    return {word: end for word, end in ends.items() if end is not None}


def _yes(others: tuple[Any, ...]) -> dict[str, Any]:
    words = [word for other in others for word in words_of(other)]
    return {"anyOf": [{"type": "boolean"}, {"enum": [0, 1]}, YES_TEXT, *(_text(_spelled(word)) for word in words)]}


def option_schema(kinds: tuple[Any, ...], one: Option) -> dict[str, Any]:
    """The JSON Schema of an option that also accepts its values as texts."""
    kind = kinds[0]
    if kind is bool:
        found = _yes(kinds[1:])
    elif kind is str:
        found = {"type": "string", **_length(one)}
    else:
        found = _choice(kind, one) if issubclass(kind, StrEnum) else _number(kind, one)
    return {**found, **_said(one)}


def plain_schema(kind: Any, one: Option) -> dict[str, Any]:
    """The JSON Schema of an option whose values have the types of TOML."""
    if words := words_of(kind):
        found: dict[str, Any] = {"enum": [word for word in words if word]}
    elif kind in (int, float):
        found = _range(kind, one)
    else:
        found = {"type": "boolean"} if kind is bool else {"type": "string", **_length(one)}
    return {**found, **_said(one)}


def _said(one: Option) -> dict[str, Any]:
    """The part of a schema with the option's default, unless it is None or "", and its description."""
    default = {} if one.default in (None, "") else {"default": one.default}
    return {**default, "description": one.described}
