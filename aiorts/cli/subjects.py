"""What a name on the command line means: an installed component, `file.py:Class`, `module:Class` or a record type.

Finding it imports what has to be imported and nothing else; it creates nothing and runs no hook.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType
from typing import Any

from aiorts import Catalogue, Component, Extension
from aiorts.cli.plugins_option import catalogue_of
from aiorts.cli.type_modules import make_here_importable
from aiorts.errors import PluginError, UnknownTypeError
from aiorts.types import all_types, find_type, full_name

__all__ = ("Subject", "find_subject")

_MOST_LISTED = 12


@dataclass(frozen=True, slots=True)
class Subject:
    """A class, and where it is from: "package NAME VERSION", "folder PATH", "file PATH" or "module NAME"."""

    cls: type
    source: str
    command: str = ""
    """The name under which `aiorts` runs it, for an installed component."""

    @property
    def is_component(self) -> bool:
        """Whether it is a component and not a record type."""
        return issubclass(self.cls, Component)


def find_subject(name: str, folders: Iterable[Path] = ()) -> Subject:
    """What this name means.

    Raises:
        PluginError: there is no such thing (near names are given), or it cannot be loaded.
        UnknownTypeError: several types have the name.
    """
    if ":" in name:
        return _of_module(name)
    catalogue = catalogue_of(folders)
    components = catalogue.extensions("components")
    known = {other.lower(): other for other in components}
    if (found := name if name in components else known.get(name)) is not None:
        extension = catalogue.find("components", found)
        return Subject(extension.load_class(Component), extension.source, found.lower())
    return _of_type(name, catalogue)


def _of_type(name: str, catalogue: Catalogue) -> Subject:
    offered = catalogue.extensions("types")
    if name in offered:
        found = catalogue.find("types", name)
        loaded = found.load()
        if isinstance(loaded, type):
            return Subject(loaded, found.source)
    try:
        cls = find_type(name)
    except UnknownTypeError as error:
        if "more than once" in str(error):
            raise
        raise _unknown(name, catalogue) from None
    return Subject(cls, _home(cls))


def _unknown(name: str, catalogue: Catalogue) -> PluginError:
    components = list(catalogue.extensions("components"))
    types = [full.rpartition(".")[2] for full in all_types()]
    lowered = {one.lower(): one for one in (*types, *components)}
    near = get_close_matches(name[:100].lower(), lowered, n=3, cutoff=0.6)
    hint = f"did you mean {' or '.join(lowered[one] for one in near)}? " if near else ""
    listed = ", ".join(components[:_MOST_LISTED]) or "none"
    return PluginError(f"no component or type named {name[:60]!r}; {hint}components: {listed}; types: see aiorts types")


def _home(cls: type) -> str:
    if full_name(cls).startswith("aiorts.types."):
        from aiorts import __version__

        return f"package aiorts {__version__}"
    return "Python itself" if cls.__module__ == "builtins" else f"module {cls.__module__}"


def _of_module(name: str) -> Subject:
    where, _, attribute = name.rpartition(":")
    module, source = _file(where) if where.endswith(".py") else _module(where, name)
    if not attribute:
        raise PluginError(f"{name[:80]}: which class? {_listed(module)}")
    found: Any = getattr(module, attribute, None)
    if not isinstance(found, type):
        near = get_close_matches(attribute[:100], _classes(module), n=1)
        hint = f"did you mean {near[0]!r}?" if near else _listed(module)
        raise PluginError(f"{where}: no class {attribute[:60]!r}; {hint}")
    return Subject(found, source)


def _file(where: str) -> tuple[ModuleType, str]:
    path = Path(where)
    try:
        is_there = path.is_file()
        others = [other.name for other in path.parent.glob("*.py")] if not is_there else []
    except (OSError, ValueError) as error:
        raise PluginError(f"{where[:80]!r}: {error}") from None
    if not is_there:
        near = get_close_matches(path.name, others, n=1)
        raise PluginError(f"no file {where[:80]!r}{f'; did you mean {near[0]!r}?' if near else ''}")
    path = path.resolve()
    module: ModuleType = Extension("components", path.stem, path.name, f"file {path}", path.parent).load()
    return module, f"file {path}"


def _module(where: str, name: str) -> tuple[ModuleType, str]:
    if not all(part.isidentifier() for part in where.split(".")):
        raise PluginError(f"{name[:80]!r}: expected FILE.py:Class or MODULE:Class")
    make_here_importable()
    module: ModuleType = Extension("components", where, where, f"module {where}").load()
    return module, f"module {where}"


def _classes(module: ModuleType) -> list[str]:
    return [
        name
        for name, value in vars(module).items()
        if isinstance(value, type) and not name.startswith("_") and value.__module__ == module.__name__
    ]


def _listed(module: ModuleType) -> str:
    return f"it has {', '.join(_classes(module)[:_MOST_LISTED]) or 'none'}"
