"""The extensions of installed packages and folders, by kind and name: found without importing anything.

An extension is declared as an entry point of the group `aiorts.<kind>`: by an installed package, or in the
`pyproject.toml` of a folder (or of a folder below it) that was named. Of a folder without one each Python file offers
the components that its text defines. What is broken is kept as a problem and hides nothing else. A project that is
installed and named as a folder, too, is one, and what is installed is used; so is a class that is offered twice.
"""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

from aiorts.errors import PluginError
from aiorts.kernel.extensions.installed import packages
from aiorts.late import dataclass
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from pathlib import Path

T = TypeVar("T")


class AbsentExtension(PluginError):
    """There is no file, module, class or offer of the name that was asked for."""


KINDS: Final = (
    *("components", "contexts", "services", "codecs", "converters", "describers", "transports", "commands"),
    *("benches", "types"),
)
"""The kinds of extensions."""
_LARGEST: Final = 1 << 20
"""Bytes of a file that is looked into."""
_MOST_FILES: Final = 1000


def singular(kind: str) -> str:
    """One of them: "component", "bench"."""
    return "bench" if kind == "benches" else kind.removesuffix("s")


@dataclass(frozen=True, slots=True)
class Extension:
    """One thing that a plugin offers, by kind and name."""

    kind: str
    name: str
    target: str
    """"module:attribute", or "file.py:Class" of a single file."""
    source: str
    """The origin: "package NAME VERSION" or "folder PATH"; "" for a target that a user typed."""
    folder: Path | None = None
    """The folder of its modules, for an extension that is not installed."""
    project: str = ""
    """The name of the project that offers it, in the form that compares; "" for a single file."""

    @property
    def described(self) -> str:
        """Kind, name, source and target, for messages; a target that a user typed, as it was typed."""
        return self.name if not self.source else f"{singular(self.kind)} {self.name!r} of {self.source} ({self.target})"

    def load(self) -> Any:
        """The object itself, imported. PluginError names the plugin and what went wrong."""
        from aiorts.kernel.extensions.loading import load

        return load(self)

    def load_class(self, base: type[T]) -> type[T]:
        """The object itself, which is a class derived from `base`; else PluginError."""
        from aiorts.kernel.extensions.loading import class_of

        return class_of(self, self.load(), base)


@dataclass(frozen=True, slots=True)
class Problem:
    """A plugin, or a part of one, that cannot be used."""

    source: str
    reason: str


class Catalogue:
    """The extensions of installed packages and plugin folders, listed at the first use without importing them.

    Args:
        folders: plugins that are not installed: a folder, or one with such folders in it.
    """

    KINDS: ClassVar[tuple[str, ...]] = KINDS
    _default: ClassVar[Catalogue | None] = None

    @classmethod
    def default(cls) -> Catalogue:
        """The catalogue used where no other is named: what is installed, unless `make_default` set another."""
        return Catalogue() if Catalogue._default is None else Catalogue._default

    def make_default(self) -> None:
        """Use it in this process where no other catalogue is named; for main programs, as `aiorts --plugins` is.

        Record types and codecs of plugins, which belong to a process and not to a kernel, are looked for here.
        """
        Catalogue._default = self

    def __init__(self, folders: Iterable[Path] = ()) -> None:
        self.folders = tuple(dict.fromkeys(folders))
        self._problems: dict[Problem, None] = {}

    @property
    def problems(self) -> tuple[Problem, ...]:
        """The declarations that could not be read."""
        return tuple(self._problems) if self._offers else ()

    @cached_property
    def _offers(self) -> dict[str, dict[str, list[Extension]]]:
        found: dict[str, dict[str, list[Extension]]] = {kind: {} for kind in KINDS}
        installed = list(self._installed())
        seen = {(one.kind, one.name, one.target, one.project) for one in installed}
        for extension in (*installed, *(one for folder in self.folders for one in self._in_folder(folder))):
            if extension.folder is not None:
                offer = (extension.kind, extension.name, extension.target)
                place = (*offer, _resolved(extension.folder))  # a folder may be reached in two ways
                if (*offer, extension.project) in seen or place in seen:
                    continue
                seen.add(place)
            found[extension.kind].setdefault(extension.name, []).append(extension)
        for offers in found.values():
            for name, several in offers.items():
                if len(several) > 1:
                    from aiorts.kernel.extensions.origins import without_doubles  # late: most names are offered once

                    offers[name] = without_doubles(several)
        return found

    def extensions(self, kind: str) -> Mapping[str, tuple[Extension, ...]]:
        """The extensions of a kind, by name; a name that several plugins offer has several."""
        return {name: tuple(offers) for name, offers in sorted(self._offers[kind].items())}

    def find(self, kind: str, name: str) -> Extension:
        """The only extension of that name.

        Raises:
            PluginError: no plugin offers it (near names are given), or several do (all are named).
        """
        offers = self._offers[kind]
        found = offers.get(name, [])
        word = singular(kind)
        if not found:
            from aiorts.kernel.extensions.uninstalled import named_in_project

            hint = named_in_project(name, kind)
            hint = hint or suggestion(name, sorted(offers), shown=str, most=3)
            broken = f" ({len(self.problems)} could not be read: see `aiorts plugins`)" if self.problems else ""
            raise AbsentExtension(f"no {word} named {name[:100]!r}; {hint}{broken}")
        if len(found) > 1:
            from aiorts.kernel.extensions.origins import told_apart

            raise PluginError(f"{word} {name!r} is offered twice, by {told_apart(found)}")
        return found[0]

    def _installed(self) -> Iterator[Extension]:
        """The extensions of packages; a package with broken metadata is a problem and hides no other."""
        seen = set()
        for name, version, entries in packages(self._problem):
            if (project := _project(name)) in seen:
                continue  # further back on the path: what is imported is the first
            seen.add(project)
            source = f"package {name} {version}"
            for group, offered, target in entries:
                kind = self._kind(source, group)
                if kind:
                    yield Extension(kind, offered, target, source, project=project)

    def _kind(self, source: str, group: str) -> str:
        """The kind that a group of entry points is of; "" and a problem when there is no such kind."""
        kind = group.removeprefix("aiorts.")
        if kind in KINDS:
            return kind
        hint = suggestion(kind, KINDS, shown="aiorts.{}".format)
        self._problem(source, f"entry points {group[:80]!r}: no such kind of plugin; {hint}")
        return ""

    def _problem(self, source: str, reason: str) -> None:
        self._problems[Problem(source, reason)] = None

    # -- folders ---------------------------------------------------------------------------------------------------

    def _in_folder(self, folder: Path) -> Iterator[Extension]:
        try:
            inside = sorted(path for path in folder.iterdir() if not path.name.startswith((".", "_")))
        except (OSError, ValueError) as error:
            self._problem(f"folder {folder}", getattr(error, "strerror", None) or str(error))
            return
        for place in (folder, *(path for path in inside if self._is(path, "is_dir"))):
            if self._is(place / "pyproject.toml", "is_file"):
                yield from self._declared(place)
        if self._is(folder / "pyproject.toml", "is_file"):
            return  # its files are the modules of what it declares
        files = [path for path in inside if path.suffix == ".py" and self._is(path, "is_file")]
        if len(files) > _MOST_FILES:
            self._problem(f"folder {folder}", f"{len(files)} Python files; the first {_MOST_FILES} were looked into")
        for path in files[:_MOST_FILES]:
            yield from self.defined_in(path)

    def _is(self, path: Path, what: str) -> bool:
        try:
            return bool(getattr(path, what)())
        except OSError as error:
            self._problem(f"folder {path.parent}", error.strerror or str(error))
            return False

    def _declared(self, folder: Path) -> Iterator[Extension]:
        from tomllib import loads

        source = f"folder {folder}"
        try:
            project = loads(self._content(folder / "pyproject.toml").decode("utf-8")).get("project", {})
            name = _project(str(project.get("name", "")))
            declared = [
                (str(group), str(name), str(target))
                for group, offers in project.get("entry-points", {}).items()
                if str(group).startswith("aiorts.")
                for name, target in dict(offers).items()
            ]
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            self._problem(source, f"pyproject.toml: {error}")
            return
        for group, extension, target in declared:
            kind = self._kind(source, group)
            if kind:
                yield Extension(kind, extension, target, source, folder, name)

    def defined_in(self, path: Path) -> Iterator[Extension]:
        """Classes that derive from Component, or from one of the same file that does; functions made components."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about its text: its import will show them
                tree = ast.parse(self._content(path), str(path))
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            line = getattr(error, "lineno", None)
            where = "" if line is None else f":{line}"
            self._problem(f"file {path}{where}", str(getattr(error, "msg", error)))
            return
        components = {"Component"}
        for node in tree.body:
            name = _made_of_function(node)
            if isinstance(node, ast.ClassDef) and components.intersection(map(_last_name, node.bases)):
                components.add(node.name)
                name = node.name
            if name:
                yield Extension("components", name, f"{path.name}:{name}", f"file {path}", path.parent)

    def _content(self, path: Path) -> bytes:
        try:
            with path.open("rb") as file:
                data = file.read(_LARGEST + 1)
            if len(data) > _LARGEST:
                raise OSError(f"larger than {_LARGEST} bytes")
        except OSError as error:
            self._problem(f"file {path}", error.strerror or str(error))
            return b""
        return data


def _project(name: str) -> str:
    """A project's name in the form that compares: `Acme.Depth` and `acme_depth` are one."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _resolved(folder: Path | None) -> str:
    try:
        return "" if folder is None else str(folder.resolve())
    except (OSError, RuntimeError):  # a loop of links
        return str(folder)


def _made_of_function(node: ast.stmt) -> str:
    """The name of a component that `@component` or `name = component(...)` makes here; else ""."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return node.name if any(_is_maker(one) for one in node.decorator_list) else ""
    if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.value, ast.Call):
        return getattr(node.targets[0], "id", "") if _is_maker(node.value) else ""
    return ""


def _is_maker(called: ast.expr) -> bool:
    """Whether it is aiorts' `component`, `aiorts.component` or a call of it."""
    called = called.func if isinstance(called, ast.Call) else called
    if isinstance(called, ast.Attribute):
        return called.attr == "component" and getattr(called.value, "id", "") == "aiorts"
    return getattr(called, "id", "") == "component"


def _last_name(base: ast.expr) -> str:
    return base.attr if isinstance(base, ast.Attribute) else getattr(base, "id", "")
