"""Splits JSON messages of other systems into records: numbers, texts, truth values, lists of numbers.

A schema, if there is one, gives the types of fields; else a number is a double. A field that has another type in a
later message is left out there, and counted.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from aiorts.types import (
    TimedBoolean,
    TimedBooleanSeq,
    TimedDouble,
    TimedDoubleSeq,
    TimedLongLong,
    TimedLongLongSeq,
    TimedString,
    TimedStringSeq,
)
from aiorts_log.foreign.ros import Unmapped

Lose = Callable[[str, str], None]
_DEEPEST: Final = 20
_MOST: Final = 1_000
"""The most fields of the messages of a topic."""
_STAMPS: Final = ("timestamp", "stamp")
_NOT_FINITE: Final = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


class Documents:
    """Decodes the messages of a topic.

    Args:
        schema_format: "jsonschema", or ""; schema: its text.

    Attributes:
        left: by field, the reason why its kind of value became no record in the messages decoded so far.
    """

    def __init__(self, schema_format: str, schema: str) -> None:
        self.left: dict[str, str] = {}
        self._types: dict[str, type] = {}
        self._integers: set[str] = set()
        if schema_format == "jsonschema":
            try:
                self._learn("", json.loads(schema), 0)
            except (ValueError, RecursionError):
                raise Unmapped("its schema is no JSON") from None

    def decode(self, data: bytes) -> Any:
        """Parse a message. Unmapped when it is no JSON."""
        try:
            found = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise Unmapped(f"no JSON: {type(error).__name__}") from None
        return found if isinstance(found, dict) else {"value": found}

    def time(self, document: Mapping[str, Any]) -> int | None:
        """The time stamp in ns, as Foxglove ({"timestamp": {"sec", "nsec"}}) and ROS (header.stamp) write it."""
        header = document.get("header")
        for place in (document, header if isinstance(header, dict) else {}):
            for name in _STAMPS:
                if (found := _nanoseconds(place.get(name))) is not None:
                    return found
        return None

    def frame(self, document: Mapping[str, Any]) -> str | None:
        """Return None: a frame in JSON is a text like any other."""
        return None

    def parts(self, document: Mapping[str, Any], lose: Lose, topic: str) -> Iterator[tuple[str, type, Any]]:
        """Path, record type and data of each field with a value; calls `lose` for fields that become no record."""
        for path, value in _flat("", document, 0):
            if value is None:
                if len(self.left) < _MOST:
                    self.left.setdefault(path, "null, which is no value, in some messages")
                continue
            found = self._part(path, value)
            if isinstance(found, str):
                lose(f"{topic} {path}", found)
            else:
                yield path, *found

    def _part(self, path: str, value: Any) -> tuple[type, Any] | str:
        is_integer = path in self._integers
        if isinstance(value, str) and value in _NOT_FINITE and self._types.get(path) is TimedDouble:
            value = _NOT_FINITE[value]
        if value == [] and path in self._types:
            return self._types[path], ()
        if isinstance(value, list):
            data, cls = _list(value, is_integer)
        elif isinstance(value, bool):
            data, cls = value, TimedBoolean
        elif isinstance(value, int | float):
            data, cls = _number(value, is_integer)
        elif isinstance(value, str):
            data, cls = value, TimedString
        else:
            return f"deeper than {_DEEPEST} objects"
        if cls is None:
            return str(data)
        if len(self._types) >= _MOST and path not in self._types:
            return f"more than {_MOST} fields"
        if self._types.setdefault(path, cls) is not cls:
            return f"values that are no {self._types[path].__name__}, as the others are"
        return cls, data

    def _learn(self, path: str, schema: Any, depth: int) -> None:
        """Note from the schema which fields are integers: JSON writes 1 for 1.0 as well."""
        if not isinstance(schema, dict) or depth > _DEEPEST:
            return
        kind, items = schema.get("type"), schema.get("items")
        if kind == "integer" or (kind == "array" and isinstance(items, dict) and items.get("type") == "integer"):
            self._integers.add(path)
        elif kind == "number":
            self._types[path] = TimedDouble
        inner = schema.get("properties")
        for name, one in inner.items() if isinstance(inner, dict) else ():
            self._learn(_joined(path, str(name)), one, depth + 1)


def _flat(path: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and depth <= _DEEPEST:
        for name, one in value.items():
            yield from _flat(_joined(path, name), one, depth + 1)
    else:
        yield path, value


def _joined(path: str, key: str) -> str:
    """The path of a key: one that is empty or has a dot or a quote is quoted, so that no two keys have one path."""
    name = json.dumps(key, ensure_ascii=False) if not key or "." in key or '"' in key else key
    return f"{path}.{name}" if path else name


def _number(value: float, is_integer: bool) -> tuple[Any, type | None]:
    if is_integer:
        fits = isinstance(value, int) and -(2**63) <= value < 2**63
        return (value, TimedLongLong) if fits else ("values that are no integers of 64 bits", None)
    if isinstance(value, int) and abs(value) > 2**53:
        return "integers that no double holds", None
    return float(value), TimedDouble


def _list(values: list[Any], is_integer: bool) -> tuple[Any, type | None]:
    if values and all(isinstance(one, bool) for one in values):
        return np.array(values, "?"), TimedBooleanSeq
    if values and all(isinstance(one, str) for one in values):
        return tuple(values), TimedStringSeq
    if not all(isinstance(one, int | float) and not isinstance(one, bool) for one in values):
        return "lists of what is neither all numbers, nor texts, nor truth values", None
    found = [_number(one, is_integer) for one in values]
    wrong = [str(one) for one, cls in found if cls is None]
    if wrong:
        return wrong[0], None
    return np.array(
        [one for one, _ in found], "i8" if is_integer else "f8"
    ), TimedLongLongSeq if is_integer else TimedDoubleSeq


def _nanoseconds(value: Any) -> int | None:
    if not isinstance(value, dict):
        return None
    sec, nsec = value.get("sec"), value.get("nsec", value.get("nanosec"))
    if type(sec) is not int or type(nsec) is not int:
        return None
    return sec * 10**9 + nsec
