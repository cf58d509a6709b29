"""A wanted system as text that another process reads: defaults are left out."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, field, fields, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import RecordError
from aiorts.late import dataclass
from aiorts.model.reading import PlainLimits, from_plain
from aiorts.model.wanted.entries import (
    ClockEntry,
    ComponentEntry,
    CompositeEntry,
    ConnectionEntry,
    ContextEntry,
    Wanted,
)

_PATH: Final = "$path"
"""The only key of an object that stands for a path, not a text."""
_LIMITS: Final = PlainLimits(values=1_000_000)


@dataclass(frozen=True, slots=True)
class _Carried:
    """`Wanted`, as far as `from_plain` reads it."""

    components: tuple[ComponentEntry, ...] = ()
    connections: tuple[ConnectionEntry, ...] = ()
    contexts: tuple[ContextEntry, ...] = ()
    clock: ClockEntry = ClockEntry()
    composites: tuple[CompositeEntry, ...] = ()
    services: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: MappingProxyType({}))
    plugin_paths: tuple[str, ...] = ()


def carried(wanted: Wanted) -> str:
    """The system as JSON, which `received` reads."""
    made = _Carried(
        tuple(wanted.components.values()),
        wanted.connections,
        tuple(wanted.contexts.values()),
        wanted.clock,
        tuple(wanted.composites.values()),
        wanted.services,
        tuple(map(str, wanted.plugin_paths)),
    )
    return json.dumps(_sent(made), separators=(",", ":"))


def received(text: str) -> Wanted:
    """The system of a text that `carried` has made.

    Raises:
        RecordError, LimitError, ConfigurationError: the text is no such one, or a value in it is wrong.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordError(f"a system that is no JSON: {error}") from None
    read = from_plain(_Carried, data, limits=_LIMITS)
    return Wanted(
        _by_name(read.components, _component),
        tuple(replace(one, options=_restored(one.options)) for one in read.connections),
        _by_name(read.contexts, _with_options),
        read.clock,
        _by_name(read.composites, _composite),
        _restored(read.services),
        tuple(map(Path, read.plugin_paths)),
    )


def _by_name(entries: tuple[Any, ...], restored: Callable[[Any], Any]) -> Mapping[str, Any]:
    return MappingProxyType({one.name: restored(one) for one in entries})


def _component(entry: ComponentEntry) -> ComponentEntry:
    return replace(entry, params=_restored(entry.params), sets=_restored(entry.sets))


def _composite(entry: CompositeEntry) -> CompositeEntry:
    return replace(entry, exported=_restored(entry.exported))


def _with_options(entry: Any) -> Any:
    return replace(entry, options=_restored(entry.options))


def _sent(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {name: _sent(one) for name, one in _chosen(value)}
    if isinstance(value, Mapping):
        return {key: _sent(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [_sent(one) for one in value]
    return {_PATH: str(value)} if isinstance(value, Path) else value


def _chosen(value: Any) -> Iterator[tuple[str, Any]]:
    """The fields whose values are not the default."""
    for one in fields(value):
        usual = one.default_factory() if one.default_factory is not MISSING else one.default
        found = getattr(value, one.name)
        if usual is MISSING or found != usual:
            yield one.name, found


def _restored(value: Any) -> Any:
    if isinstance(value, Mapping):
        if len(value) == 1 and isinstance(path := value.get(_PATH), str):
            return Path(path)
        return MappingProxyType({key: _restored(one) for key, one in value.items()})
    return tuple(map(_restored, value)) if isinstance(value, tuple) else value
