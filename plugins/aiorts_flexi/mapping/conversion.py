"""Offers FlexiFilter's map as a converter of connections: `convert = "map 0>1000>0"`.

The text is a map between one in-port and one out-port, both of number 0, and then rules, each after a blank:
`map 0:x>1000>0 overflow=saturate rounding=floor`. A sequence is as long as its last pin that the map names.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any, Final

from aiorts.errors import ConfigurationError
from aiorts_flexi.common.ports import PortSpec, port_of
from aiorts_flexi.mapping.grammar import parse_map, parse_number
from aiorts_flexi.mapping.mapping import COMBINE, Mapping, Rules

_RULE: Final = re.compile(r"\s+(\w+)=(\S*)$")
_WORDS: Final = {
    "rounding": ("nearest", "truncate", "floor"),
    "overflow": ("error", "saturate", "wrap"),
    "combine": COMBINE,
}
_RULES: Final = ("rounding", "overflow", "combine", "clamp", "nan")


def conversion(text: str, source: type[Any], target: type[Any]) -> Callable[[Any], Any]:
    """A function that makes a sample of `target` from a sample of `source` by this map.

    A source without a time makes samples of time 0.

    Raises:
        TypedTextError: the map is wrong, with the place.
        ConfigurationError: a rule is wrong, or a type has no pins.
    """
    rules: dict[str, Any] = {}
    while (found := _RULE.search(text)) is not None:
        text = text[: found.start()]
        rules[found[1]] = _rule(found[1], found[2])
    entries = parse_map(text)
    ins = _port("input0", source, (entry.source_pin for entry in entries))
    outs = _port("output0", target, (entry.target_pin for entry in entries))
    mapping = Mapping([ins], [outs], text, Rules(**rules))
    return lambda sample: mapping.apply({0: sample}, 0)[0][1]


def _port(name: str, cls: type[Any], pins: Iterable[int | str]) -> PortSpec:
    return port_of(cls, name, 1 + max((pin for pin in pins if isinstance(pin, int)), default=0))


def _rule(name: str, value: str) -> Any:
    if name not in _RULES:
        raise ConfigurationError(f"{name}={value}: no such rule; there are {', '.join(_RULES)}")
    if name == "clamp":
        return tuple(parse_number(part, "clamp=LO,HI") for part in value.split(","))
    if value not in _WORDS.get(name, (value,)):
        raise ConfigurationError(f"{name}={value}: expected {', '.join(filter(None, _WORDS[name]))}")
    return value
