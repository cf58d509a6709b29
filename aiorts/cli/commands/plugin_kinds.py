"""The tests of all kinds of extensions: one table, one function for each kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from enum import Enum
from types import ModuleType
from typing import Any, Final

import click

from aiorts import Component, Context, Extension, KernelService
from aiorts.cli.runtime.service_options import option_faults
from aiorts.errors import AiortsError, DeclarationError
from aiorts.kernel.extensions.arguments import settings_faults
from aiorts.types import TimedDouble, check_port_type


def fault_of(extension: Extension, found: Any) -> str:
    """The fault for which an object cannot be used as its kind of extension; "" when it can."""
    return _TESTS[extension.kind](extension, found)


def _derived(found: Any, base: type) -> str:
    fits = isinstance(found, type) and issubclass(found, base)
    return "" if fits else f"{_shown(found)} is no class derived from {base.__name__}"


def _service(extension: Extension, found: Any) -> str:
    if fault := _derived(found, KernelService):
        return fault
    if found.name != extension.name:
        return f"the service is called {found.name!r}, and found by the name {extension.name!r}"
    settings: type[Any] = found.settings
    if not is_dataclass(settings):
        return f"its settings, {_shown(settings)}, are no dataclass"
    faults = [f"its settings have no right defaults: {what}" for _, what, _ in settings_faults(settings, {})]
    from aiorts.cli.commands.run import run

    return "; ".join((*faults, *option_faults(found.name, settings, run.params).values()))


def _codec(extension: Extension, found: Any) -> str:
    from aiorts.wire.codecs import codec_of

    record = TimedDouble(1, 0.5)
    try:
        codec = codec_of(extension.name, found)
        back = codec.decode(codec.encode(record))
    except AiortsError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - any exception of a plugin's codec is the plugin's fault
        return f"it fails on a TimedDouble: {type(error).__name__}: {error}"
    return "" if back == record else f"it gives {back!r} back for {record!r}; see aiorts.testing.check_codec"


def _fitting(fits: Callable[[Any], bool], what: str) -> Callable[[Extension, Any], str]:
    return lambda _, found: "" if fits(found) else f"{_shown(found)} is no {what}"


def _is_bench(found: Any) -> bool:
    # aiorts_bench checks its benches itself; these are the attributes it needs.
    return isinstance(getattr(found, "help", None), str) and callable(getattr(found, "report", None))


def _type(extension: Extension, found: Any) -> str:
    if isinstance(found, ModuleType):
        return "names a module; name each of its classes, as MODULE:CLASS: recordings find no other types"
    if isinstance(found, type) and issubclass(found, Enum):
        return (
            f"{found.__qualname__} is an enum, and no record type: name the record that has a field of it, as "
            "MODULE:CLASS; the enum comes with that"
        )
    try:
        check_port_type(found)
    except DeclarationError as error:
        return str(error)
    if found.__name__ != extension.name:
        return f"the type is called {found.__name__}, and found by that name"
    module = extension.target.partition(":")[0].strip()
    home = f"recordings name the type by its own module; write {found.__module__}:{found.__qualname__}"
    return "" if found.__module__ == module or module.endswith(".py") else home


def _shown(found: Any) -> str:
    return getattr(found, "__qualname__", None) or f"an object of {type(found).__qualname__}"


_TESTS: Final[Mapping[str, Callable[[Extension, Any], str]]] = {
    "components": lambda _, found: _derived(found, Component),
    "contexts": lambda _, found: _derived(found, Context),
    "services": _service,
    "codecs": _codec,
    "converters": _fitting(callable, "function that makes a converter of text and two types"),
    "describers": _fitting(callable, "function that describes a component of a path"),
    "transports": lambda _extension, _found: "",  # no plugin offers one yet, so there is no rule
    "commands": _fitting(lambda found: isinstance(found, click.Command), "click.Command"),
    "benches": _fitting(_is_bench, "aiorts_bench.Bench"),
    "types": _type,
}
