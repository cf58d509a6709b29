"""The component or record type that a word means: a name, or a type as text (`kernel/extensions/type_names.py`).

The module of the type is imported; no component is created and no hook runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from aiorts import Catalogue, Component
from aiorts.cli.console.plugins_option import catalogue_of
from aiorts.errors import DeclarationError, UnknownTypeError
from aiorts.kernel.extensions.catalogue import AbsentExtension
from aiorts.kernel.extensions.finders import declared_types
from aiorts.kernel.extensions.type_names import extension_of, split_type
from aiorts.kernel.extensions.uninstalled import named_in_project
from aiorts.late import dataclass
from aiorts.spelling import suggestion
from aiorts.types import all_types, find_type
from aiorts.types.registry import is_known

_MOST_LISTED = 12


@dataclass(frozen=True, slots=True)
class Subject:
    """A class, and its origin: "package NAME VERSION", "folder PATH", "file PATH" or "module NAME"."""

    cls: type
    source: str
    command: str = ""
    """The name of an installed component as an `aiorts` command."""

    @property
    def is_component(self) -> bool:
        """Whether the class is a component, else it is a record type."""
        return issubclass(self.cls, Component)


def find_subject(name: str, folders: Iterable[Path] = ()) -> Subject:
    """Find the component or record type of this name.

    Raises:
        UnknownTypeError: there is none (the text has near names), or several types have the name.
        PluginError: it cannot be loaded.
    """
    catalogue = catalogue_of(folders)
    if ":" in name or name.endswith(".py"):
        try:
            extension = extension_of(name, catalogue)
            cls = extension.load_class(object)
        except AbsentExtension as error:
            raise UnknownTypeError(str(error)) from error.__cause__
        home, folder = split_type(extension.target)[0], extension.folder
        return Subject(cls, f"module {home}" if folder is None or not home.endswith(".py") else f"file {folder / home}")
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
        if "more than once" in str(error) or isinstance(error.__cause__, DeclarationError):
            raise
        load_declared()  # the type may be declared only as a field of another
        if not is_known(name):
            raise _unknown(name, catalogue) from None
        cls = find_type(name)
    return Subject(cls, _home(cls))


def load_declared(fits: Callable[[str], bool] = lambda _: True) -> list[str]:
    """Import the types declared by plugins whose full name fits; returns the faults of those that cannot be loaded."""
    broken = []
    for name in filter(fits, declared_types()):
        try:
            find_type(name)
        except UnknownTypeError as error:
            broken.append(str(error))
    return broken


def _unknown(name: str, catalogue: Catalogue) -> UnknownTypeError:
    components = list(catalogue.extensions("components"))
    types = [full.rpartition(".")[2] for full in all_types()]
    # Keyed by the last word of ROS's names; a type or component of that name takes precedence.
    named = sorted((*types, *components), key=lambda one: "/" not in one)
    lowered = {one.lower().rpartition("/")[2]: one for one in named}
    if hint := named_in_project(name, "components", "types"):
        return UnknownTypeError(f"no component or type named {name[:60]!r}; {hint}")
    hint = suggestion(name.lower().rpartition("/")[2], lowered, "", shown=lowered.__getitem__, most=3)
    hint += " " * bool(hint)
    listed = ", ".join(components[:_MOST_LISTED]) or "none"
    return UnknownTypeError(
        f"no component or type named {name[:60]!r}; {hint}components: {listed}; types: see aiorts types"
    )


def _home(cls: type) -> str:
    if cls.__module__.startswith("aiorts.types."):
        from aiorts import __version__

        return f"package aiorts {__version__}"
    return "Python itself" if cls.__module__ == "builtins" else f"module {cls.__module__}"
