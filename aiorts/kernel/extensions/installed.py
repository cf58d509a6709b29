"""The entry points of aiorts that installed packages declare, read from where they lie on the path.

`importlib.metadata` says the same; importing it takes 25 ms, which was a quarter of `aiorts --help`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

Entry = tuple[str, str, str]
"""Group, name and target."""


def packages(problem: Callable[[str, str], None]) -> Iterator[tuple[str, str, list[Entry]]]:
    """Name, version and entries of each package that has any, in the order of the path.

    Args:
        problem: told of a package whose metadata is broken: which one, and why.
    """
    for info in (info for place in sys.path for info in _infos(place or ".")):
        try:
            entries = list(_entries(_text(info, "entry_points.txt")))
            if not entries:
                continue
            about = _about(_text(info, "METADATA") or _text(info, "PKG-INFO"))
            if not about.get("name"):
                raise ValueError("its metadata has no name")
        except (OSError, ValueError) as error:
            problem(f"package {info}", str(error))
            continue
        yield about["name"], about.get("version", ""), entries


def _infos(place: str) -> list[Any]:
    """The folders with metadata in a folder of the path, as text, or in a zip file."""
    with suppress(OSError):
        return [os.path.join(place, name) for name in os.listdir(place) if _is_info(name)]
    if os.path.isfile(place):
        from zipfile import BadZipFile, Path

        with suppress(OSError, BadZipFile):
            return [inside for inside in Path(place).iterdir() if _is_info(inside.name)]
    return []


def _is_info(name: str) -> bool:
    return name.lower().endswith((".dist-info", "egg-info"))


def _text(info: Any, name: str) -> str:
    """The text of a file of a package; empty when there is none."""
    with suppress(FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError, KeyError):
        if not isinstance(info, str):
            return str((info / name).read_text(encoding="utf-8"))
        with open(os.path.join(info, name), encoding="utf-8") as file:
            return file.read()
    return ""


def _entries(text: str) -> Iterator[Entry]:
    group = ""
    for line in map(str.strip, text.splitlines()):
        if line.startswith("[") and line.endswith("]"):
            group = line.strip("[]")
        elif group.startswith("aiorts.") and line and not line.startswith("#"):
            name, equals, target = map(str.strip, line.partition("="))
            if not equals:
                raise ValueError(f"entry_points.txt: expected NAME = MODULE:ATTRIBUTE, got {line[:80]!r}")
            yield group, name, target


def _about(text: str) -> dict[str, str]:
    """The headers of the metadata, each as it stands first, by their names in lower case."""
    found: dict[str, str] = {}
    for line in text.partition("\n\n")[0].splitlines():
        name, _, value = line.partition(":")
        found.setdefault(name.lower(), value.strip())
    return found
