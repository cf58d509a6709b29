"""Record types and codecs that plugins offer, found by name where the layers below ask; imported on first use alone.

An entry point of the group `aiorts.types` declares a record (`Depth = "acme.records:Depth"`), which is imported when
that name is asked for, or when a frame or a file has a sample of exactly `acme.records.Depth`. One that names a
whole module (`acme = "acme.records"`) is imported for a name that nothing else has, and for no file.
A module that could not be imported is not tried again.
"""

from __future__ import annotations

import dataclasses
import os
import sys
import threading
from collections.abc import Iterable, Mapping
from enum import Enum
from types import ModuleType
from typing import Any, Final

from aiorts.errors import DeclarationError, PluginError, UnknownTypeError
from aiorts.kernel.extensions.catalogue import Catalogue, Extension
from aiorts.kernel.extensions.loading import load, load_in_time
from aiorts.kernel.loop.origins import is_foreign
from aiorts.types import registry
from aiorts.types.samples import check_port_type

_LIMIT: Final = 5.0
"""Seconds that the import of a type may take: the caller waits for it."""
_catalogue: Catalogue | None = None
_installed: tuple[tuple[tuple[str, int], ...], Catalogue] | None = None
_declared: tuple[Catalogue, Mapping[str, Extension]] | None = None
_done: set[Extension] = set()
_broken: dict[Extension, str] = {}
_refused: dict[str, DeclarationError | None] = {}
"""The reason why a dataclass of a named module is no type, by its name; None for one that is."""
_local = threading.local()


def offer_from(catalogue: Catalogue | None) -> None:
    """Look for types and codecs that are not loaded there from now on; None is the default.

    One for the process, as types are: the last one counts, and what was loaded stays known.
    """
    global _catalogue
    _catalogue = catalogue


def load_type(extension: Extension, limit: float | None = None) -> None:
    """Import a record type, or a module with record types, and make all that it defines known by name.

    Args:
        limit: seconds that the import may take; a few by default.

    Raises:
        PluginError: it cannot be imported within that time, or what it names is no record type.
    """
    # One that is asked for by another while that is imported: the thread of that one is the one to go on.
    nested = getattr(_local, "importing", False)
    found = load(extension) if nested else load_in_time(extension, limit or _LIMIT, _mark_importing)
    if isinstance(found, ModuleType):
        for cls in vars(found).values():
            if _is_type(cls) and (cls.__module__ == found.__name__ or _is_users(cls.__module__)):
                _refused[cls.__name__] = _register(cls)
        return
    if fault := _register(found) if _is_type(found) else DeclarationError("it is no record type"):
        raise PluginError(f"type {extension.name!r} of {extension.source} ({extension.target}): {fault}")


def _mark_importing() -> None:
    _local.importing = True


def _is_type(thing: Any) -> bool:
    return isinstance(thing, type) and (dataclasses.is_dataclass(thing) or issubclass(thing, Enum))


def _is_users(module: str) -> bool:
    """Whether the module is the user's own, so that a file that imports a type of it has that type, too."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return file is not None and not is_foreign(file)


def _register(cls: type) -> DeclarationError | None:
    """Make it known by name, unless it cannot travel: then why; a dataclass may be made for something else."""
    if not issubclass(cls, Enum):
        try:
            check_port_type(cls)
        except DeclarationError as error:
            return error
    registry.register(cls)
    return None


def _find_type(name: str) -> Iterable[str]:
    """Import what offers the type `name`; gives all names that are offered."""
    catalogue = _used()
    offers = catalogue.extensions("types")
    short = name.rpartition(".")[2]
    exact = declared_types().get(name)
    faults = []
    if exact is not None or short in offers:
        try:
            _load_once(exact or catalogue.find("types", short))
        except PluginError as error:
            raise UnknownTypeError(f"unknown type {name!r}: {error}") from error
    else:
        for extension in (one for several in offers.values() for one in several if _may_define(one, name)):
            try:
                _load_once(extension)
            except PluginError as error:
                faults.append(str(error))
    if faults and not registry.is_known(name):
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise UnknownTypeError(f"unknown type {name!r}; a plugin that may define it is broken{more}: {faults[0]}")
    if (refused := _refused.get(short)) is not None and not registry.is_known(name):
        raise UnknownTypeError(f"unknown type {name!r}: {refused}") from refused
    return [shown for shown, several in offers.items() if any(":" in one.target for one in several)]


def declared_types() -> Mapping[str, Extension]:
    """The classes that plugins declare to be types, by full name (`MODULE.CLASS`); nothing is imported."""
    global _declared
    catalogue = _used()
    if _declared is None or _declared[0] is not catalogue:
        named: dict[str, Extension] = {}
        for one in (one for several in catalogue.extensions("types").values() for one in several if ":" in one.target):
            named.setdefault(one.target.partition("[")[0].replace(" ", "").replace(":", ".", 1), one)
        _declared = catalogue, named
    return _declared[1]


def _import_declared(name: str) -> bool:
    """Whether a plugin declares the class of that name, full or bare, which then has been imported.

    UnknownTypeError if it cannot be, or if several have a bare name. The only import that a name in a frame or a file
    can lead to.
    """
    declared = declared_types()
    found = [full for full in declared if full.rpartition(".")[2] == name] if "." not in name else [name]
    if len(found) > 1:
        raise UnknownTypeError(f"type {name!r} is declared more than once: {' and '.join(found)}; write the full name")
    if not found or found[0] not in declared:
        return False
    try:
        _load_once(declared[found[0]])
    except PluginError as error:
        raise UnknownTypeError(f"type {name!r}: {error}") from error
    return True


def _may_define(extension: Extension, name: str) -> bool:
    """A module, for a bare name; for a full name only the module that it begins with."""
    module, colon, _ = extension.target.partition(":")
    return not colon and ("." not in name or name.startswith(f"{module.strip()}."))


def _load_once(extension: Extension) -> None:
    if extension in _broken:
        raise PluginError(_broken[extension])
    if extension in _done:
        return
    try:
        load_type(extension)
        _done.add(extension)
    except PluginError as error:
        _broken[extension] = str(error)
        raise


def _find_codec(name: str) -> Any:
    return load(_used().find("codecs", name))


def _used() -> Catalogue:
    """The catalogue that was set, or what is installed at present: listed again when a folder of the path changed."""
    global _installed
    if _catalogue is not None:
        return _catalogue
    default = Catalogue.default()
    if default.folders:
        return default
    path = tuple((place, _changed_ns(place)) for place in sys.path)
    if _installed is None or _installed[0] != path:
        _installed = path, default
    return _installed[1]


def _changed_ns(place: str) -> int:
    try:
        return os.stat(place or ".").st_mtime_ns
    except (OSError, ValueError):
        return 0


FINDERS: Final = {"types": _find_type, "declared types": _import_declared, "codecs": _find_codec}
"""The finders of names that are not loaded, by kind."""
