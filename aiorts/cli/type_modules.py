"""`--type-mod MODULE`: modules that define record types, imported before a name is looked for."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from aiorts import Catalogue, Extension
from aiorts.kernel.offers import load_type

__all__ = ("import_types",)

_LIMIT: Final = 60.0
"""Seconds; one that was named by its user may be large."""


def import_types(modules: str) -> None:
    """Import these modules, separated by commas: by name, or as FILE.py; plugin folders are looked into as well.

    Raises:
        PluginError: one cannot be imported.
    """
    for name in filter(None, (part.strip() for part in modules.split(","))):
        load_type(_extension(name), _LIMIT)


def _extension(name: str) -> Extension:
    source = "--type-mod"
    if name.endswith(".py"):
        path = Path(name).absolute()
        return Extension("types", name, path.name, source, path.parent)
    top = name.partition(".")[0]
    for folder in Catalogue.default().folders:
        for place in (folder, folder / "src"):
            if (place / top).is_dir() or (place / f"{top}.py").is_file():
                return Extension("types", name, name, source, folder)
    return Extension("types", name, name, source)
