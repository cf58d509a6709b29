"""Reads and writes single values of samples; a pin's port and path are looked up once for many samples."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any, Final

from aiorts.errors import RecordError
from aiorts.types import convert, describe, read_path
from aiorts_flexi.common.ports import PortSpec

_INTEGER: Final = re.compile("[iu](?:8|16|32|64)")


def reader(spec: PortSpec, pin: int | str) -> Callable[[Any], Any]:
    """A function that reads this pin from a sample; only the items of a sequence may be missing."""
    path, special = spec.pin_path(pin), spec.special(pin)
    if not path:
        return lambda sample: sample
    if special is not None:
        return lambda sample: _present(read_path(sample, path), special, path)
    if "[" not in path:
        return attrgetter(path)
    if spec.shape != "sequence" or isinstance(pin, str):
        return lambda sample: read_path(sample, path)

    def item(sample: Any) -> Any:
        data = sample.data
        if pin >= len(data):
            return read_path(sample, path)  # its error has the number of items
        found = data[pin]
        return found.item() if hasattr(found, "dtype") else found

    return item


def _present(value: Any, kind: Any, path: str) -> Any:
    if value is None:
        raise RecordError(f"{path} is absent")
    return convert(value, kind)


def holder(kind: str) -> Callable[[Any], bool]:
    """A function that tells whether a value fits this kind without conversion: its class and its limits."""
    if kind == "f64":
        return lambda value: type(value) is float
    if _INTEGER.fullmatch(kind) is None:
        return lambda value: False
    bits = int(kind[1:])
    low, high = (0, 2**bits - 1) if kind[0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return lambda value: type(value) is int and low <= value <= high


def with_values(sample: Any, changes: Mapping[str, Any]) -> Any:
    """A copy of a record with the values at these field paths changed."""
    here: dict[str, Any] = {}
    below: dict[str, dict[str, Any]] = {}
    for path, value in changes.items():
        name, dot, rest = path.partition(".")
        if dot:
            below.setdefault(name, {})[rest] = value
        else:
            here[name] = value
    for name, inner in below.items():
        here[name] = with_values(getattr(sample, name), inner)
    cls = type(sample)
    return cls(**{part.name: here.get(part.name, getattr(sample, part.name)) for part in describe(cls).fields})
