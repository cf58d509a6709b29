"""`--type-mod MODULE`: modules that define record types, imported before a name is looked for.

A module is looked for where Python looks, in the plugin folders, and then in the current folder, whatever way the
command was started. Records and dataclasses that it defines are all known by name once it is imported.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from aiorts import Catalogue, Extension
from aiorts.errors import PluginError
from aiorts.kernel.offers import load_type

__all__ = ("import_types", "make_here_importable")

_LIMIT: Final = 60.0
"""Seconds; one that was named by its user may be large."""


def import_types(modules: str | Iterable[str]) -> None:
    """Import these modules, by name or as FILE.py; each text may name several, separated by commas.

    Raises:
        PluginError: one is not there (near names of the current folder are given) or cannot be imported.
    """
    texts = (modules,) if isinstance(modules, str) else tuple(modules)
    for name in filter(None, (part.strip() for text in texts for part in text.split(","))):
        make_here_importable()
        try:
            load_type(_extension(name), _LIMIT)
        except PluginError as error:
            missing = error.__cause__
            if isinstance(missing, ModuleNotFoundError) and missing.name == name.partition(".")[0]:
                raise PluginError(f"--type-mod {name}: there is no such module{_hint(name)}") from error
            raise


def make_here_importable() -> None:
    """Have modules of the current folder found, after all others: a `json.py` there must not take Python's place."""
    try:
        here = str(Path.cwd())
    except OSError:
        return  # it was deleted
    if here not in sys.path:
        sys.path.append(here)


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


def _hint(name: str) -> str:
    near = get_close_matches(name, sorted(path.stem for path in Path().glob("*.py")), n=1)
    return f"; did you mean {near[0]!r}?" if near else "; set PYTHONPATH to its folder, or change to that"
