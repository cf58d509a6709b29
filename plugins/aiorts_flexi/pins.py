"""Reading and writing single values of samples: what a pin's port and path come to, looked up once for many samples."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any, Final

from aiorts.types import describe, read_path
from aiorts_flexi.ports import PortSpec

__all__ = ("holder", "reader", "with_values")

_INTEGER: Final = re.compile("[iu](?:8|16|32|64)")


def reader(spec: PortSpec, pin: int | str) -> Callable[[Any], Any]:
    """What reads this pin of a sample; the port's type has it, so that only the items of a sequence may be missing."""
    path = spec.pin_path(pin)
    if not path:
        return lambda sample: sample
    if "[" not in path:
        return attrgetter(path)
    if spec.form != "sequence" or isinstance(pin, str):
        return lambda sample: read_path(sample, path)

    def item(sample: Any) -> Any:
        data = sample.data
        if pin >= len(data):
            return read_path(sample, path)  # which says how many there are
        found = data[pin]
        return found.item() if hasattr(found, "dtype") else found

    return item


def holder(kind: str) -> Callable[[Any], bool]:
    """Whether a value needs no conversion to this kind: numbers of the very class, within its limits."""
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
