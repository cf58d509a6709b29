"""The grammar of a type as text: `FILE.py:Class`, `package.module:Class`, or a name that a plugin offers.

System files, the command line, `Kernel.create` and `reload` all ask here. It finds the extension and imports nothing;
`loading.py` loads it.
"""

from __future__ import annotations

import pkgutil
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from aiorts.errors import PluginError
from aiorts.kernel.extensions.catalogue import AbsentExtension, Catalogue, Extension
from aiorts.kernel.extensions.files import INSTALL, is_importable, package_of
from aiorts.spelling import suggestion

_LONGEST: Final = 4096
"""Characters of a text in a message: a path that works is no longer."""


def split_type(text: str) -> tuple[str, str]:
    """The file or module of a class ("" for an installed name), and its name.

    Raises:
        PluginError: it is none of the three forms.
    """
    home, colon, name = (part.strip() for part in text.rpartition(":"))
    is_home = home.endswith(".py") or all(part.isidentifier() for part in home.split("."))
    if colon and not (is_home and all(part.isidentifier() for part in name.split("."))):
        if home.endswith(".py") and not name:
            raise PluginError(_which(Path(home), home))
        raise PluginError(f"{shown(text)}: expected FILE.py:Class, package.module:Class or an installed name")
    return home, name


def extension_of(
    text: str,
    catalogue: Catalogue,
    places: Iterable[Path] = (Path(),),
    allow: Callable[[Path], object] | None = None,
    kind: str = "components",
) -> Extension:
    """The extension that a text names, to be loaded.

    Args:
        places: folders that a relative file is counted from, one after the other, and where modules are that Python
            does not find; besides the catalogue's.
        allow: called with each path before it is looked at; it raises when the file may not be taken. Then only what
            lies in a place is made importable for it.
        kind: what it is the text of.

    Raises:
        AbsentExtension: there is no such file, module or offer; near names are given.
        PluginError: it is none of the three forms.
    """
    home, name = split_type(text)
    folders = tuple(places)
    if home.endswith(".py"):
        return _of_file(kind, text, home, name, folders, allow)
    if home:
        return Extension(kind, text, f"{home}:{name}", "", _place_of(home, (*folders, *catalogue.folders)))
    if name.endswith(".py") and name not in catalogue.extensions(kind):
        found = next((place / name for place in folders if _is_file(place / name)), None)
        if found is not None:
            raise PluginError(_which(found, name))
    return catalogue.find(kind, name)


def shown(text: str) -> str:
    """The text in quotes, whole: it may be a path."""
    return f"{text!r:.{_LONGEST}}"


def _which(path: Path, typed: str) -> str:
    names = [one.name for one in Catalogue().defined_in(path)] if _is_file(path) else []
    has = f"it has {', '.join(names[:10])}" if names else "it has no component"
    return f"{shown(typed)}: which class? write {typed}:{names[0] if len(names) == 1 else 'CLASS'}; {has}"


# -- files -------------------------------------------------------------------------------------------------------------


def _of_file(
    kind: str, text: str, home: str, name: str, places: tuple[Path, ...], allow: Callable[[Path], object] | None
) -> Extension:
    for place in places:
        path = place / home
        if allow is not None:
            allow(path)
        if _is_file(path):
            path, within = path.resolve(), place.resolve()
            root = package_of(path)[1]
            if allow is not None:
                root = within if path.is_relative_to(within) else path.parent
            return Extension(kind, text, f"{path.relative_to(root).as_posix()}:{name}", "", root)
    folders = [(place / home).parent for place in places]
    names = {other.name for folder in folders for other in _files(folder)} - {Path(home).name}
    listed = " and ".join(dict.fromkeys(map(_absolute, folders)))
    hint = suggestion(
        Path(home).name,
        sorted(names),
        "a relative one is counted from there",
        shown=lambda near: repr(f"{Path(home).with_name(near).as_posix()}:{name}"),
    )
    raise AbsentExtension(f"{shown(text)}: no file {Path(home).name!r} in {listed}; {hint}")


def _absolute(folder: Path) -> str:
    try:
        return str(folder.resolve())
    except OSError:  # the current folder was deleted
        return str(folder)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _files(folder: Path) -> list[Path]:
    try:
        return sorted(folder.glob("*.py"))
    except (OSError, ValueError):
        return []


# -- modules -----------------------------------------------------------------------------------------------------------


def _place_of(home: str, places: tuple[Path, ...]) -> Path | None:
    """The place that has the module; None where Python finds it by itself, which comes first."""
    top = home.partition(".")[0]
    if is_importable(top):
        return None
    for place in places:
        if any((root / top).is_dir() or _is_file(root / f"{top}.py") for root in (place / "src", place)):
            return place
    known = {module.name for module in pkgutil.iter_modules([*map(_absolute, places), *sys.path])}
    hint = suggestion(top, known, INSTALL, shown=lambda near: near + home[len(top) :])
    raise AbsentExtension(f"no module named {top!r}; {hint}")
