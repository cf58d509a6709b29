"""`--type-mod MODULE`: imports modules that define record types, before names are resolved.

A module is looked for where Python looks, in the plugin folders, and then in the current folder. Its records and
dataclasses are known by name after the import.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from aiorts.errors import PluginError
from aiorts.kernel.extensions.catalogue import Catalogue, Extension
from aiorts.kernel.extensions.files import package_of
from aiorts.kernel.extensions.finders import load_type
from aiorts.spelling import suggestion

_LIMIT: Final = 60.0
"""Seconds for an import; a module that the user names may be large."""


def import_types(modules: str | Iterable[str]) -> None:
    """Import these modules, by name or as FILE.py; each text may have several, separated by commas.

    Raises:
        PluginError: one does not exist (the message has near names of the current folder) or cannot be imported.
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
    """Add the current folder at the end of the path: a `json.py` there must not replace Python's."""
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
        root = package_of(path)[1]
        return Extension("types", name, path.relative_to(root).as_posix(), source, root)
    top = name.partition(".")[0]
    for folder in Catalogue.default().folders:
        for place in (folder, folder / "src"):
            if (place / top).is_dir() or (place / f"{top}.py").is_file():
                return Extension("types", name, name, source, folder)
    return Extension("types", name, name, source)


def _hint(name: str) -> str:
    files = sorted({path.stem for path in Path().glob("*.py")} - {name})
    return f"; {suggestion(name, files, 'set PYTHONPATH to its folder, or change to that')}"
