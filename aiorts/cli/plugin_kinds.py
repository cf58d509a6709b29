"""What each kind of extension has to be; one table, one test for each."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, Final

import click

from aiorts import Component, Context, Extension
from aiorts.errors import AiortsError, DeclarationError
from aiorts.types import TimedDouble, check_port_type

__all__ = ("fault_of",)


def fault_of(extension: Extension, found: Any) -> str:
    """Why what was loaded cannot be used as what it is offered for; "" when it can."""
    return _TESTS[extension.kind](extension, found)


def _component(extension: Extension, found: Any) -> str:
    return _derived(found, Component)


def _context(extension: Extension, found: Any) -> str:
    return _derived(found, Context)


def _derived(found: Any, base: type) -> str:
    fits = isinstance(found, type) and issubclass(found, base)
    return "" if fits else f"{_shown(found)} is no class derived from {base.__name__}"


def _codec(extension: Extension, found: Any) -> str:
    from aiorts.wire.codecs import codec_of

    record = TimedDouble(1, 0.5)
    try:
        codec = codec_of(extension.name, found)
        back = codec.decode(codec.encode(record))
    except AiortsError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - a plugin's border: whatever its codec does is reported as the plugin's
        return f"it fails on a TimedDouble: {type(error).__name__}: {error}"
    return "" if back == record else f"it gives {back!r} back for {record!r}; see aiorts.testing.check_codec"


def _command(extension: Extension, found: Any) -> str:
    return "" if isinstance(found, click.Command) else f"{_shown(found)} is no click.Command"


def _bench(extension: Extension, found: Any) -> str:
    wanted: type = importlib.import_module("aiorts.bench.registry").Bench
    return "" if isinstance(found, wanted) else f"{_shown(found)} is no aiorts.bench.registry.Bench"


def _type(extension: Extension, found: Any) -> str:
    if isinstance(found, ModuleType):
        return ""
    try:
        check_port_type(found)
    except DeclarationError as error:
        return str(error)
    return "" if found.__name__ == extension.name else f"the type is called {found.__name__}, and found by that name"


def _anything(extension: Extension, found: Any) -> str:
    """No transport exists yet, and so nothing that one has to be."""
    return ""


def _shown(found: Any) -> str:
    return getattr(found, "__qualname__", None) or f"an object of {type(found).__qualname__}"


_TESTS: Final[Mapping[str, Callable[[Extension, Any], str]]] = {
    "components": _component,
    "contexts": _context,
    "codecs": _codec,
    "transports": _anything,
    "commands": _command,
    "benches": _bench,
    "types": _type,
}
