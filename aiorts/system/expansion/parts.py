"""Collects the parts of one file, without those of files it includes: components, connections, contexts and others."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Final

from aiorts.late import dataclass
from aiorts.model.wanted.system_text import is_list_of_tables
from aiorts.system.expansion.entries import NAMED, TABLES, Document, Entry
from aiorts.system.expansion.faults import Fault
from aiorts.system.expansion.joining import PLUGINS
from aiorts.system.expansion.repeating import IF, REPEAT, copies, has_number, is_there, name_of, numbered
from aiorts.system.expansion.variables import Scope
from aiorts.system.text.origins import Origin, Source
from aiorts.system.text.places import Key

INCLUDE, VARIABLES = "include", "variables"
_OWN: Final = ("schema", INCLUDE, VARIABLES, PLUGINS, *TABLES)


@dataclass(frozen=True, slots=True)
class File:
    """A file whose parts are collected."""

    source: Source
    top: dict[str, Any]
    scope: Scope
    way: tuple[tuple[Path, Path], ...]
    """The chain of inclusions, from the main file to this file: the whole path of each, and its path as written."""
    folder: str
    """The folder of the file, relative to the folder of the named file."""

    def at(self, *key: str | int) -> Origin:
        return Origin(self.source, key)


def put_own(document: Document, file: File, kept: Callable[[], AbstractContextManager[None]]) -> None:
    """Put the file's own parts into its document; `kept` collects the faults of a part."""
    for table in NAMED:
        with kept():
            for name, value in _entries(file, table):
                with kept():
                    _named(document, file, table, name, value)
    with kept():
        for number, value in _connections(file):
            with kept():
                _unnamed(document, file, "connections", number, value)
    for word, value in file.top.items():
        if word in _OWN:
            continue
        with kept():
            if not is_list_of_tables(value):
                _other(document, file, word, value)
                continue
            for number, one in enumerate(value):
                with kept():
                    _unnamed(document, file, word, number, one)
    with kept():
        _plugins(document, file)


def _other(document: Document, file: File, word: str, value: Any) -> None:
    """Put a table without entries, such as `clock` or that of a service, into the document."""
    origin = file.at(word)
    made = file.scope.filled(value, origin)
    if isinstance(value, dict) and IF in value:
        made.pop(IF)
        if not is_there(value, file.scope, origin):
            return
    document.rest[word] = made, origin


def _named(document: Document, file: File, table: str, name: str, value: dict[str, Any]) -> None:
    origin = file.at(table, name)
    shown = file.scope.text(name, origin, of_key=True)
    numbers = copies(value, file.scope, origin)
    if numbers is None and has_number(name):
        raise Fault(origin, f"{name[:80]!r} has a number only with repeat; write repeat = 3", of_key=True)
    if numbers is not None and not has_number(name):
        what = f'{{i}} is missing in the name; write [{table}."{name[:60]}{{i}}"], and repeat gives each its number'
        raise Fault(origin, what, of_key=True)
    names = [shown] if numbers is None else [name_of(shown, number) for number in numbers]
    there = is_there(value, file.scope, origin)
    if numbers is not None and table != "contexts":
        document.families[shown] = names if there else []
    if not there:
        if table != "contexts":
            document.absent.update(dict.fromkeys(names, origin.below(IF)))
        filled(file, value, origin, None if numbers is None else 0)  # for the faults in it
        return
    for number, one in zip((None,) if numbers is None else numbers, names, strict=True):
        made, moved = filled(file, value, origin, number)
        _add(document, Entry(table, one, made, origin, moved))


def _unnamed(document: Document, file: File, table: str, number: int, value: dict[str, Any]) -> None:
    """Put a connection, or a table of a service's list, into the document."""
    origin = file.at(table, number)
    numbers = copies(value, file.scope, origin)
    there = is_there(value, file.scope, origin)
    for one in (None,) if numbers is None else numbers:
        made, moved = filled(file, value, origin, one)
        if there:
            document.entries.append(Entry(table, "", made, origin, moved))


def filled(
    file: File, value: dict[str, Any], origin: Origin, number: int | None
) -> tuple[dict[str, Any], dict[Key, Origin]]:
    """The table of one copy, without `if` and `repeat`; and the places of keys that have another name in the file."""
    value = {word: one for word, one in value.items() if word not in (IF, REPEAT)}
    moved: dict[Key, Origin] = {}
    if number is not None:
        value = numbered(value, number, origin, moved)
    made: dict[str, Any] = file.scope.filled(value, origin, moved)
    return made, moved


def _add(document: Document, entry: Entry) -> None:
    other = document.names.setdefault((entry.table, entry.name), entry.origin)
    if other is not entry.origin:
        what = f"there is {entry.name[:80]!r} already, in {other.spot(of_key=True)}"
        raise Fault(entry.origin, f"{what}; choose another name, or include with a prefix", of_key=True)
    document.entries.append(entry)


def _plugins(document: Document, file: File) -> None:
    """Put the plugin folders of an included file into the document; for the main file, the whole table as it is."""
    origin = file.at(PLUGINS)
    given = file.scope.filled(file.top.get(PLUGINS, {}), origin)
    if len(file.way) == 1:
        document.rest[PLUGINS] = given, origin
        return
    paths = given.get("path", ["."]) if isinstance(given, dict) else None
    if not isinstance(given, dict) or given.keys() - {"path"} or not isinstance(paths, list):
        raise Fault(origin, 'expected plugins.path = ["."], the folders with plugins, and nothing else')
    for number, path in enumerate(paths):
        if not isinstance(path, str):
            raise Fault(origin.below("path", number), f"expected a folder, got {path!r:.80}")
        document.plugins.setdefault(os.path.normpath(os.path.join(file.folder, path)), origin.below("path", number))


def _entries(file: File, table: str) -> Iterator[tuple[str, dict[str, Any]]]:
    found = file.top.get(table, {})
    if not isinstance(found, dict):
        raise Fault(file.at(table), f"expected tables such as [{table}.NAME], got {found!r:.60}; write [{table}.NAME]")
    for name, value in found.items():
        if not isinstance(value, dict):
            raise Fault(file.at(table, name), f"expected a table, [{table}.{name[:60]}], got {value!r:.60}")
        yield name, value


def _connections(file: File) -> Iterator[tuple[int, dict[str, Any]]]:
    found = file.top.get("connections", [])
    if not isinstance(found, list):
        raise Fault(file.at("connections"), f"expected a list, got {found!r:.60}; write [[connections]]")
    for number, value in enumerate(found):
        if not isinstance(value, dict):
            raise Fault(file.at("connections", number), f"expected a table with from and to, got {value!r:.60}")
        yield number, value
