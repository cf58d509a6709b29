"""JSON as clients send it, bounded, and answers of kernels as JSON that every client reads without loss.

An integer that a number of JavaScript does not hold exactly is a text, a number that is not finite a word, and bytes
are base64 text, as in recordings and in the output of `--json`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import isfinite
from typing import Any, Final, NoReturn

from aiorts.errors import ControlError, RecordError
from aiorts.types import to_plain

LARGEST: Final = 2**53
"""Integers beyond this, positive or negative, are texts."""
DEEPEST: Final = 32
"""The most levels of objects and lists in a client's JSON."""


def json_in(text: bytes | str) -> Any:
    """The value that a client sends.

    Raises:
        RecordError: it is no JSON, has a number that JSON does not have, or is nested too deep.
    """
    try:
        value = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise RecordError(f"what was sent is no JSON: {error!s:.100}") from None
    if not _is_flat(value, DEEPEST):
        raise RecordError(f"what was sent is nested deeper than {DEEPEST} levels")
    return value


def json_out(value: Any) -> bytes:
    """A value of a kernel as one line of JSON, in UTF-8; ControlError: it is nested too deep."""
    try:
        text = json.dumps(value_out(value), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    except RecursionError:
        raise ControlError("what the kernel answers is nested too deep for JSON") from None
    return text.encode("utf-8", "replace")  # a path may have bytes that are no UTF-8


def value_out(value: Any) -> Any:
    """A value of a kernel as data that strict JSON has."""
    kind = type(value)
    if kind is str or value is None or kind is bool:
        return value
    if kind is int:
        return value if -LARGEST <= value <= LARGEST else str(value)
    if kind is float and isfinite(value):
        return value
    if kind is list:  # these two before the slower checks: pictures and figures have thousands of them
        return [value_out(one) for one in value]
    if kind is dict:
        return {str(key): value_out(one) for key, one in value.items()}
    if isinstance(value, Mapping):
        return {str(key): value_out(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [value_out(one) for one in value]
    return to_plain(value)


def _refuse(word: str) -> NoReturn:
    raise ValueError(f'{word}: send "{word}"')


def _is_flat(value: Any, levels: int) -> bool:
    """Whether a value has at most so many levels."""
    if isinstance(value, dict):
        value = value.values()
    elif not isinstance(value, list):
        return True
    return levels > 0 and all(_is_flat(one, levels - 1) for one in value)
