"""Finds the class of a component's type: a plugin's, or one of a file below the folders that may be named."""

from __future__ import annotations

import ast
import os
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final

_LARGEST: Final = 1 << 20
"""Bytes of a file that are searched for a class."""
_OF_OPENRTM: Final = ("OpenRTM_aist", "RTC")


class Types:
    """Finds types by their names. It reads files, and imports none."""

    def __init__(self, roots: Sequence[Path], target: Path) -> None:
        """Set `roots`, the folders below which files may be named, and `target`, the system file's future folder."""
        self.roots = tuple(Path(os.path.realpath(root)) for root in roots)
        self.target = Path(os.path.realpath(target))

    def inside(self, text: str, folder: Path | None = None) -> Path | None:
        """The real path of a file or folder that a text names; None outside of the folders that may be named.

        The text is looked for in each of these folders, or only in `folder`.
        """
        if "\0" in text:
            return None
        for root in self.roots if folder is None else (folder,):
            path = Path(os.path.realpath(root / text))
            if any(path.is_relative_to(one) for one in self.roots) and path.exists():
                return path
        return None

    def find(self, name: str, files: Iterable[Path] = ()) -> tuple[str, str]:
        """The text of a type for a system file, and a note on it, "" for none.

        Args:
            name: OpenRTM's name of the type.
            files: files to search before the folders.
        """
        if name in _installed():
            return name, ""
        file = f"{name}.py"
        usual = [found for root in self.roots if (found := self.inside(file, root)) is not None]
        note = ""
        for path in sorted((*files, *usual), key=lambda one: one.name != file):
            kind = _class_in(path, name)
            if kind == "openrtm":
                note = note or f"{path} is written for OpenRTM; make an aiorts component of it"
            elif kind and not path.is_relative_to(self.target):
                note = f"{path} is not below {self.target}; write the system file above it (-o)"
            elif kind:
                return f"{path}:{name}", ""
        folders = ", ".join(map(str, self.roots))
        missing = f"no plugin offers it, and there is no class {name} in {file} below {folders}; write it, or name"
        return name, f"type {name!r}: {note or f'{missing} its folder (--module-path)'}"

    def stated(self, text: str) -> str:
        """The type that a profile states itself, if it may be named; else ""."""
        home, colon, name = text.rpartition(":")
        if not colon:
            return text if text.replace("_", "").replace("-", "").isalnum() else ""
        file = home if home.endswith(".py") else f"{home.replace('.', '/')}.py"
        path = self.inside(file)
        if path is None or not path.is_relative_to(self.target) or not name.isidentifier():
            return ""
        return f"{path}:{name}" if home.endswith(".py") else text


def word_of(text: str) -> str:
    """The name of the class that the text of a type ends with."""
    return text.rpartition(":")[2].rpartition(".")[2]


@cache
def _installed() -> frozenset[str]:
    """The types that plugins offer."""
    return frozenset(one.name for one in entry_points(group="aiorts.components"))


@cache
def _class_in(path: Path, name: str) -> str:
    """ "aiorts" or "openrtm", by what a file with this class imports; "" where there is no such class."""
    try:
        with path.open("rb") as file:
            tree = ast.parse(file.read(_LARGEST))
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return ""
    if not any(isinstance(node, ast.ClassDef) and node.name == name for node in tree.body):
        return ""
    imported = {
        word.partition(".")[0]
        for node in tree.body
        for word in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    return "openrtm" if imported & set(_OF_OPENRTM) and "aiorts" not in imported else "aiorts"
