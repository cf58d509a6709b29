"""What installed packages and folders offer, by kind and name: found without importing anything.

An extension is declared as an entry point of the group `aiorts.<kind>`: by an installed package, or in the
`pyproject.toml` of a folder (or of a folder below it) that was named. Of a folder without one each Python file offers
the components that its text defines. What is broken is kept as a problem and hides nothing else.
"""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Final, TypeVar

from aiorts.errors import PluginError

__all__ = ("KINDS", "Catalogue", "Extension", "Problem")

T = TypeVar("T")
KINDS: Final = ("components", "contexts", "codecs", "transports", "commands", "benches", "types")
"""What a plugin can offer."""
_LARGEST: Final = 1 << 20
"""Bytes of a file that is looked into."""
_MOST_FILES: Final = 1000


@dataclass(frozen=True, slots=True)
class Extension:
    """One named offer of a plugin."""

    kind: str
    name: str
    target: str
    """"module:attribute", or "file.py:Class" of a single file."""
    source: str
    """Who offers it: "package NAME VERSION" or "folder PATH"."""
    folder: Path | None = None
    """Where its modules are, for one that is not installed."""

    def load(self) -> Any:
        """The object itself, imported. PluginError names the plugin and what went wrong."""
        from aiorts.kernel.plugins import load

        return load(self)

    def load_class(self, base: type[T]) -> type[T]:
        """The object itself, which is a class derived from `base`; else PluginError."""
        from aiorts.kernel.plugins import class_of

        return class_of(self, self.load(), base)


@dataclass(frozen=True, slots=True)
class Problem:
    """A plugin, or a part of one, that cannot be used."""

    source: str
    reason: str


class Catalogue:
    """What there is, as it was when somebody first asked.

    Args:
        folders: plugins that are not installed: a folder, or one with such folders in it.
    """

    KINDS: ClassVar[tuple[str, ...]] = KINDS

    def __init__(self, folders: Iterable[Path] = ()) -> None:
        self.folders = tuple(folders)
        self._problems: list[Problem] = []

    @property
    def problems(self) -> tuple[Problem, ...]:
        """What could not be read."""
        return tuple(self._problems) if self._offers else ()

    @cached_property
    def _offers(self) -> dict[str, dict[str, list[Extension]]]:
        found: dict[str, dict[str, list[Extension]]] = {kind: {} for kind in KINDS}
        for extension in (*self._installed(), *(one for folder in self.folders for one in self._in_folder(folder))):
            offers = found[extension.kind].setdefault(extension.name, [])
            # A package that is installed and named as a folder, too, is one.
            if all(other.target != extension.target for other in offers):
                offers.append(extension)
        return found

    def extensions(self, kind: str) -> Mapping[str, tuple[Extension, ...]]:
        """What is offered under `kind`, by name; a name that several offer has several."""
        return {name: tuple(offers) for name, offers in sorted(self._offers[kind].items())}

    def find(self, kind: str, name: str) -> Extension:
        """The one extension of that name.

        Raises:
            PluginError: nobody offers it (near names are given), or several do (all are named).
        """
        offers = self._offers[kind]
        found = offers.get(name, [])
        word = kind.removesuffix("s")
        if not found:
            near = get_close_matches(name[:100], offers, n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(sorted(offers)) or 'none'}"
            raise PluginError(f"no {word} named {name[:100]!r}; {hint}")
        if len(found) > 1:
            sources = " and ".join(f"{one.target} ({one.source})" for one in found)
            raise PluginError(f"{word} {name!r} is offered twice, by {sources}; remove one")
        return found[0]

    def _installed(self) -> Iterator[Extension]:
        """What packages offer; one whose metadata is broken is a problem and hides nothing."""
        from importlib.metadata import distributions  # late: 10 ms, and most programs ask for no extension

        seen = set()
        for distribution in distributions():
            try:
                entries = [entry for entry in distribution.entry_points if entry.group.startswith("aiorts.")]
                if not entries:
                    continue
                name, version = str(distribution.metadata["Name"]), str(distribution.version)
                if name in seen:
                    continue  # further back on the path: what is imported is the first
                seen.add(name)
            except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
                self._problems.append(Problem(f"package {getattr(distribution, '_path', '?')}", str(error)))
                continue
            for entry in entries:
                if (kind := entry.group.removeprefix("aiorts.")) in KINDS:
                    yield Extension(kind, entry.name, entry.value, f"package {name} {version}")

    # -- folders ---------------------------------------------------------------------------------------------------

    def _in_folder(self, folder: Path) -> Iterator[Extension]:
        try:
            inside = sorted(path for path in folder.iterdir() if not path.name.startswith((".", "_")))
        except (OSError, ValueError) as error:
            self._problems.append(Problem(f"folder {folder}", getattr(error, "strerror", None) or str(error)))
            return
        for place in (folder, *(path for path in inside if self._is(path, Path.is_dir))):
            if self._is(place / "pyproject.toml", Path.is_file):
                yield from self._declared(place)
        if self._is(folder / "pyproject.toml", Path.is_file):
            return  # its files are the modules of what it declares
        for path in inside[:_MOST_FILES]:
            if path.suffix == ".py" and self._is(path, Path.is_file):
                yield from self._defined(path)

    def _is(self, path: Path, what: Callable[[Path], bool]) -> bool:
        try:
            return what(path)
        except OSError as error:
            self._problems.append(Problem(f"folder {path.parent}", error.strerror or str(error)))
            return False

    def _declared(self, folder: Path) -> Iterator[Extension]:
        text = self._text(folder / "pyproject.toml")
        try:
            groups = tomllib.loads(text).get("project", {}).get("entry-points", {})
            declared = [
                (kind, str(name), str(target))
                for kind in KINDS
                for name, target in dict(groups.get(f"aiorts.{kind}", {})).items()
            ]
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            self._problems.append(Problem(f"folder {folder}", f"pyproject.toml: {error}"))
            return
        for kind, name, target in declared:
            yield Extension(kind, name, target, f"folder {folder}", folder)

    def _defined(self, path: Path) -> Iterator[Extension]:
        try:
            tree = ast.parse(self._text(path), str(path))
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            line = getattr(error, "lineno", None)
            where = "" if line is None else f", line {line}"
            self._problems.append(Problem(f"file {path}{where}", str(getattr(error, "msg", error))))
            return
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and any(_says_component(base) for base in node.bases):
                yield Extension("components", node.name, f"{path.name}:{node.name}", f"file {path}", path.parent)

    def _text(self, path: Path) -> str:
        try:
            with path.open("rb") as file:
                data = file.read(_LARGEST + 1)
            if len(data) > _LARGEST:
                raise OSError(f"larger than {_LARGEST} bytes")
            return data.decode("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            self._problems.append(Problem(f"file {path}", str(error)))
            return ""


def _says_component(base: ast.expr) -> bool:
    return (base.attr if isinstance(base, ast.Attribute) else getattr(base, "id", "")) == "Component"
