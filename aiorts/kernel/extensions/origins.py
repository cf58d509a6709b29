"""The source text of an extension, found without importing: one class may be offered in several ways."""

from __future__ import annotations

import ast
import importlib.util
import os
import warnings
from collections.abc import Iterable
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Final, Protocol, TypeVar

_MOST_HOPS: Final = 8
_LARGEST: Final = 1 << 20
"""Bytes of a file that is looked into."""


class _Offer(Protocol):
    @property
    def kind(self) -> str: ...

    @property
    def source(self) -> str: ...

    @property
    def target(self) -> str: ...

    @property
    def folder(self) -> Path | None: ...


T = TypeVar("T", bound=_Offer)


def without_doubles(offers: Iterable[T]) -> list[T]:
    """The offers, of those that are one and the same class the first alone."""
    found: dict[object, T] = {}
    for offer in offers:
        found.setdefault(_origin(offer) or offer, offer)
    return list(found.values())


def told_apart(offers: Iterable[_Offer]) -> str:
    """The offers of one name, and what to do: for components the text that may be written in place of the name."""
    several = list(offers)
    sources = " and ".join(f"{one.target} ({one.source})" for one in several)
    texts = [f'"{text}"' for one in several if one.kind == "components" and (text := _as_text(one))]
    instead = f", or write {' or '.join(texts)} in place of the name" if texts else ""
    return f"{sources}; remove one{instead}"


def _as_text(offer: _Offer) -> str:
    """A text that names this offer alone, anywhere; "" for a module of a folder, which may be in several."""
    if offer.folder is None:
        return offer.target.partition(" ")[0]
    if not offer.target.partition(":")[0].endswith(".py"):
        return ""
    here = os.path.realpath(offer.folder) == os.path.realpath(os.curdir)
    return offer.target if here else f"{offer.folder.absolute()}{os.sep}{offer.target}"


def _origin(offer: _Offer) -> tuple[str, str] | None:
    """File and name of the definition; None where it cannot be found."""
    home, _, name = (part.strip() for part in offer.target.partition(":"))
    name = name.split(" ")[0]
    if not name:
        return None
    if home.endswith(".py") and offer.folder is not None:
        file = offer.folder / home
    else:
        places = None if offer.folder is None else [str(offer.folder / "src"), str(offer.folder)]
        found = _file_of(home.split("."), places)
        if found is None:
            return None
        file = found
    for _ in range(_MOST_HOPS):
        file = Path(os.path.realpath(file))
        following = _imported_from(file, name)
        if following is None:
            break
        file, name = following
    return str(file), name


def _file_of(parts: list[str], places: list[str] | None) -> Path | None:
    """The file of a module."""
    try:
        spec = importlib.util.find_spec(parts[0]) if places is None else PathFinder.find_spec(parts[0], places)
        for number in range(2, len(parts) + 1):
            if spec is None or spec.submodule_search_locations is None:
                return None
            spec = PathFinder.find_spec(".".join(parts[:number]), list(spec.submodule_search_locations))
    except (ImportError, ValueError):
        return None
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None


def _imported_from(file: Path, name: str) -> tuple[Path, str] | None:
    """File and name that a file takes a name from, out of its own package; None where it defines the name itself."""
    try:
        with file.open("rb") as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(stream.read(_LARGEST))
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                if (alias.asname or alias.name) == name:
                    found = _beside(file, node.module.split("."), node.level)
                    return None if found is None else (found, alias.name)
    return None


def _beside(file: Path, parts: list[str], level: int) -> Path | None:
    """The file of a module that a file of the same package imports."""
    folder = file.parent
    if level:
        for _ in range(level - 1):
            folder = folder.parent
        return _file_below(folder, parts)
    while (folder / "__init__.py").is_file():
        if folder.name == parts[0]:
            return _file_below(folder.parent, parts)
        folder = folder.parent
    return None


def _file_below(folder: Path, parts: list[str]) -> Path | None:
    place = folder.joinpath(*parts)
    return next((one for one in (place / "__init__.py", place.with_suffix(".py")) if one.is_file()), None)
