"""`--type-mod MODULE`: imports modules that define record types, so that their types are known by name.

A module is looked for where Python looks, then in the current folder, whatever way the command was started. Records
and dataclasses that a module defines are all known once it is imported.
"""

from __future__ import annotations

import dataclasses
import sys
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType

from aiorts import Extension
from aiorts.errors import DeclarationError, PluginError
from aiorts.types import describe

__all__ = ("import_types",)


def import_types(modules: str) -> None:
    """Import these modules, separated by commas.

    Raises:
        PluginError: one is not there (near names of the current folder are given) or cannot be imported.
    """
    for name in filter(None, (part.strip() for part in modules.split(","))):
        _register(_imported(name))


def _imported(name: str) -> ModuleType:
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # at the end: a file `json.py` of the user must not take the place of Python's
    try:
        module = Extension("type modules", name, name, "--type-mod").load()
    except PluginError as error:
        missing = error.__cause__
        if isinstance(missing, ModuleNotFoundError) and missing.name == name.partition(".")[0]:
            raise PluginError(f"--type-mod {name}: there is no such module{_hint(name)}") from error
        raise
    if not isinstance(module, ModuleType):
        raise PluginError(f"--type-mod {name}: expected the name of a module, such as mytypes")
    return module


def _hint(name: str) -> str:
    near = get_close_matches(name, sorted(path.stem for path in Path().glob("*.py")), n=1)
    return f"; did you mean {near[0]!r}?" if near else "; set PYTHONPATH to its folder, or change to that"


def _register(module: ModuleType) -> None:
    """A record is known by its definition, a plain dataclass when somebody looks at it: this does."""
    for found in vars(module).values():
        if isinstance(found, type) and dataclasses.is_dataclass(found) and found.__module__ == module.__name__:
            try:
                describe(found)
            except DeclarationError:
                continue  # a dataclass that cannot travel is nobody's port type
