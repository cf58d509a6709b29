"""From the text of a system file, and of those it includes, to one system: tables, and where each key stands.

Pure: files are read by a function that it is given, and so are the variables of the environment. A file that uses
nothing of all this is handed on as it is.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeAlias

from aiorts.errors import SystemFileError
from aiorts.late import dataclass
from aiorts.system.expansion.choices import Choices
from aiorts.system.expansion.entries import NAMED, TABLES, Document, Entry
from aiorts.system.expansion.faults import Budget, Excess, Fault, Typed
from aiorts.system.expansion.inclusion import Inclusion, as_table, included, inclusion, listed, port_fault, remapped
from aiorts.system.expansion.joining import PLUGINS, joined
from aiorts.system.expansion.repeating import IF, REPEAT, copies, has_number, is_there, name_of, numbered
from aiorts.system.expansion.resolving import refuse_absent, resolve
from aiorts.system.expansion.variables import Given, Scope, declared, handed, names_of, typed
from aiorts.system.expansion.writing import document_text
from aiorts.system.text.origins import Origin, Origins, Source
from aiorts.system.text.places import Key
from aiorts.system.text.reading import Mistake, hint, spelled
from aiorts.system.text.toml import LARGEST, NotToml, tables
from aiorts.system.text.version import version_fault

INCLUDE, VARIABLES = "include", "variables"
TOP_KEYS: Final = (INCLUDE, VARIABLES)
"""Keys at the top of a file that are gone when it is expanded."""
_OWN: Final = ("schema", INCLUDE, VARIABLES, PLUGINS, *TABLES)
_DEEPEST: Final = 16
"""Files that include each other."""
_MOST: Final = 1000
"""Files that are included, each as often as it is."""
Reader: TypeAlias = Callable[[Path], tuple[Path, str]]
"""Reads an included file: its whole path, and its text. SystemFileError when it cannot be had."""


@dataclass(frozen=True, slots=True)
class Expanded:
    """One system."""

    top: dict[str, Any]
    text: str
    """All of it as one text."""
    origins: Origins
    mistakes: tuple[Mistake, ...] = ()
    """Where there are any, the tables are empty."""


def expand(main: Source, choices: Choices, environ: Mapping[str, str], read: Reader) -> Expanded:
    """The system of a file and of all that it includes.

    Raises:
        NotToml: a file is no TOML.
        SystemFileError: it is too large.
    """
    top = tables(main.text, main.path)
    if version_fault(top)[1] or not (choices.variables or choices.remaps or _is_written_so(top, main.text)):
        return Expanded(top, main.text, Origins(main))
    expansion = _Expansion(main, choices, environ, read)
    document = expansion.whole(top)
    others = tuple(source for _, source, _ in expansion.files.values())
    if expansion.mistakes:
        return Expanded({}, main.text, Origins(main, others=others), tuple(expansion.mistakes))
    whole, moved = joined(document, top, main)
    return Expanded(whole, document_text(whole), Origins(main, moved, others))


def _is_written_so(top: Mapping[str, Any], text: str) -> bool:
    if "${" in text or INCLUDE in top or VARIABLES in top:
        return True
    tables_ = [table for table in top.values() if isinstance(table, dict | list)]
    entries = [one for table in tables_ for one in (table.values() if isinstance(table, dict) else table)]
    return any(isinstance(one, dict) and (IF in one or REPEAT in one) for one in (*tables_, *entries))


@dataclass(frozen=True, slots=True)
class _File:
    """A file while its parts are put together."""

    source: Source
    top: dict[str, Any]
    scope: Scope
    way: tuple[tuple[Path, Path], ...]
    """The files that led here, itself last: the whole path, and as it was written."""
    folder: str
    """Where it lies, counted from the folder of the file that was named."""

    def at(self, *key: str | int) -> Origin:
        return Origin(self.source, key)


class _Expansion:
    """Expands one system; it goes on after a mistake, so that all of them are named at once."""

    def __init__(self, main: Source, choices: Choices, environ: Mapping[str, str], read: Reader) -> None:
        self._main, self._choices, self._environ, self._read = main, choices, environ, read
        self._budget = Budget()
        self._left = _MOST
        self._characters = LARGEST - len(main.text)
        self._declared: dict[str, Path] = {}
        self.files: dict[Path, tuple[Path, Source, dict[str, Any]]] = {}
        self.mistakes: list[Mistake] = []

    def whole(self, top: dict[str, Any]) -> Document:
        """The document of the file that was named, with what the command line says."""
        document = Document()
        with self._kept(Excess):
            given = self._given()
            if (scope := self._scope(self._main, top, given)) is not None:
                way = ((Path(os.path.realpath(self._main.path)), self._main.path),)
                document = self._document(_File(self._main, top, scope, way, ""))
            self._check_given(top)
            if self.mistakes:
                return document
            for fault in resolve(document):
                self._say(fault)
            self._remap(document)
            for fault in refuse_absent(document):
                self._say(fault)
        return document

    # -- what the command line says --------------------------------------------------------------------------------

    def _given(self) -> dict[str, Given]:
        found: dict[str, Given] = {}
        for text in self._choices.variables:
            name, equals, value = text.partition("=")
            where, name = f"--var {text[:80]}", name.strip()
            if not equals or not name:
                self.mistakes.append(Mistake((), where, "expected NAME=VALUE, such as sim=true"))
            else:
                found[name] = typed(value, partial(Typed, where))
        return found

    def _check_given(self, top: Mapping[str, Any]) -> None:
        """Refuse variables of the command line that the file does not have."""
        own = list(names_of(top.get(VARIABLES, {})))
        for text in self._choices.variables:
            name = text.partition("=")[0].strip()
            if name and name not in own and "=" in text:
                what = f"unknown variable {name[:80]!r}; {hint(name, own) if own else 'the file has none'}"
                if (other := self._declared.get(name)) is not None:
                    what = f"{other} has it, and it is not handed on; declare {name} in {self._main.path}, and include"
                    what = f'{what} with vars = {{ {name} = "${{{name}}}" }}'
                self.mistakes.append(Mistake((), f"--var {text[:80]}", what))

    def _remap(self, document: Document) -> None:
        for text in self._choices.remaps:
            port, equals, target = (part.strip() for part in text.partition("="))
            if not equals:
                fault = "expected COMPONENT.PORT=COMPONENT.PORT, such as camera.image=player.image"
            else:
                fault = port_fault(port) or port_fault(target) or remapped(document, port, target, "of the system")
            if fault:
                self.mistakes.append(Mistake((), f"--remap {text[:80]}", fault))

    # -- a file ------------------------------------------------------------------------------------------------------

    def _scope(self, source: Source, top: Mapping[str, Any], given: Mapping[str, Given]) -> Scope | None:
        with self._kept():
            return declared(top.get(VARIABLES, {}), Origin(source, (VARIABLES,)), given, self._environ, self._budget)
        return None

    def _document(self, file: _File) -> Document:
        document = Document()
        if INCLUDE in file.top:
            with self._kept():
                for given, origin in listed(file.top[INCLUDE], file.at(INCLUDE)):
                    with self._kept():
                        self._include(document, file, given, origin)
        for table in NAMED:
            with self._kept():
                for name, value in _entries(file, table):
                    with self._kept():
                        self._named(document, file, table, name, value)
        with self._kept():
            for number, value in _connections(file):
                with self._kept():
                    self._connection(document, file, number, value)
        for word, value in file.top.items():
            if word not in _OWN:
                with self._kept():
                    self._other(document, file, word, value)
        with self._kept():
            self._plugins(document, file)
        return document

    def _other(self, document: Document, file: _File, word: str, value: Any) -> None:
        """The clock, the table of a service."""
        origin = file.at(word)
        made = file.scope.filled(value, origin)
        if isinstance(value, dict) and IF in value:
            made.pop(IF)
            if not is_there(value, file.scope, origin):
                return
        document.rest[word] = made, origin

    def _named(self, document: Document, file: _File, table: str, name: str, value: dict[str, Any]) -> None:
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
            self._filled(file, value, origin, None if numbers is None else 0)  # for what is wrong in it
            return
        for number, one in zip((None,) if numbers is None else numbers, names, strict=True):
            made, moved = self._filled(file, value, origin, number)
            self._add(document, Entry(table, one, made, origin, moved))

    def _connection(self, document: Document, file: _File, number: int, value: dict[str, Any]) -> None:
        origin = file.at("connections", number)
        numbers = copies(value, file.scope, origin)
        there = is_there(value, file.scope, origin)
        for one in (None,) if numbers is None else numbers:
            made, moved = self._filled(file, value, origin, one)
            if there:
                document.entries.append(Entry("connections", "", made, origin, moved))

    def _filled(
        self, file: _File, value: dict[str, Any], origin: Origin, number: int | None
    ) -> tuple[dict[str, Any], dict[Key, Origin]]:
        """The table of one copy, without what is said of all of them; and its keys that have another name there."""
        value = {word: one for word, one in value.items() if word not in (IF, REPEAT)}
        called: dict[Key, Key] = {}
        if number is not None:
            value = numbered(value, number, called)
        moved = {new: origin.below(*old) for new, old in called.items()}
        made: dict[str, Any] = file.scope.filled(value, origin, moved)
        return made, moved

    def _add(self, document: Document, entry: Entry) -> None:
        other = document.names.setdefault((entry.table, entry.name), entry.origin)
        if other is not entry.origin:
            what = f"there is {entry.name[:80]!r} already, in {other.spot(of_key=True)}"
            raise Fault(entry.origin, f"{what}; choose another name, or include with a prefix", of_key=True)
        document.entries.append(entry)

    def _plugins(self, document: Document, file: _File) -> None:
        """The folders with plugins of an included file; of the first one, whoever reads the system sees to it."""
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

    # -- including ---------------------------------------------------------------------------------------------------

    def _include(self, document: Document, file: _File, given: Any, origin: Origin) -> None:
        table = as_table(given, origin)
        numbers = copies(table, file.scope, origin)
        there = is_there(table, file.scope, origin)
        prefix = table.get("prefix", "")
        prefix = file.scope.text(prefix, origin.below("prefix")) if isinstance(prefix, str) else ""
        if numbers is not None and not has_number(prefix):
            raise Fault(origin.below("prefix"), 'repeat needs a prefix with a number, such as prefix = "arm{i}_"')
        for number in (None,) if numbers is None else numbers:
            made, _ = self._filled(file, table, origin, number)
            how = inclusion(made, origin)
            if not there:
                self._leave_out(document, file, how)
                continue
            self._merge(document, file, included(self._read_in(file, how), how), prefix, how.prefix)

    def _read_in(self, file: _File, how: Inclusion) -> Document:
        """The document of an included file, by its own names."""
        at = how.origin.below("file")
        self._left -= 1
        if self._left < 0:
            raise Excess(at, f"more than {_MOST} files are included; include less", of_key=True)
        path = file.source.path.parent / how.file
        whole, source, top = self._fetched(path, at)
        if whole in (known := [one for one, _ in file.way]):
            circle = [written for _, written in file.way[known.index(whole) :]] + [source.path]
            raise Fault(at, f"includes itself: {' -> '.join(map(str, circle))}")
        if len(file.way) >= _DEEPEST:
            raise Fault(at, f"more than {_DEEPEST} files include each other; include fewer levels")
        self._characters -= len(source.text)
        if self._characters < 0:
            what = f"the files that are included have more than {LARGEST} characters together, each as often as it is"
            raise Excess(at, f"{what}; include less", of_key=True)
        fault, _ = version_fault(top)
        if fault:
            raise Fault(Origin(source, ("schema",)), fault)
        own = list(names_of(top.get(VARIABLES, {})))
        for name in own:
            self._declared.setdefault(name, source.path)
        values = {}
        for name, value in how.values.items():
            key = how.origin.below("vars", name)
            if name not in own:
                known_names = hint(name, own) if own else "it has none; declare it there under [variables]"
                raise Fault(key, f"{how.file} has no variable {name[:80]!r}; {known_names}", of_key=True)
            values[name] = handed(name, value, key)
        scope = declared(top.get(VARIABLES, {}), Origin(source, (VARIABLES,)), values, self._environ, self._budget)
        folder = os.path.normpath(os.path.join(file.folder, os.path.dirname(how.file)))
        return self._document(
            _File(source, top, scope, (*file.way, (whole, source.path)), "" if folder == "." else folder)
        )

    def _fetched(self, path: Path, at: Origin) -> tuple[Path, Source, dict[str, Any]]:
        if path not in self.files:
            try:
                whole, text = self._read(path)
                self.files[path] = whole, Source(path, text), tables(text, path)
            except NotToml:
                raise
            except SystemFileError as error:
                raise Fault(at, str(error)) from None
        return self.files[path]

    def _leave_out(self, document: Document, file: _File, how: Inclusion) -> None:
        """Note whom a file that is not included would have brought; what is wrong with it does not matter now."""
        before = len(self.mistakes)
        try:
            left = included(self._read_in(file, how), how)
        except Excess:
            raise
        except SystemFileError:
            left = Document()
        del self.mistakes[before:]
        names = [name for table, name in left.names if table != "contexts"]
        document.absent.update(dict.fromkeys([*names, *left.absent], how.origin.below(IF)))
        document.families.update({name: [] for name in left.families})

    def _merge(self, document: Document, file: _File, part: Document, template: str, prefix: str) -> None:
        for key, origin in part.names.items():
            if (other := document.names.get(key)) is not None:
                what = f"there is {key[1][:80]!r} already, in {other.spot(of_key=True)}"
                raise Fault(origin, f"{what}; choose another name, or include with a prefix", of_key=True)
        document.names.update(part.names)
        document.entries += part.entries
        document.absent.update(part.absent)
        document.families.update(part.families)
        if has_number(template):
            for table, name in part.names:
                if table != "contexts":
                    family = template + name.removeprefix(prefix)
                    document.families.setdefault(family, []).append(name)
        for path, origin in part.plugins.items():
            document.plugins.setdefault(path, origin)
        for word, (value, origin) in part.rest.items():
            known = document.rest.setdefault(word, (value, origin))
            if known[0] != value and word not in file.top:
                what = f"{known[1].spot(of_key=True)} says something else; write [{word}] in {file.source.path}"
                raise Fault(origin, f"{what}, which counts", of_key=True)

    # -- mistakes ----------------------------------------------------------------------------------------------------

    @contextmanager
    def _kept(self, kind: type[Fault] = Fault) -> Iterator[None]:
        """Keep what is wrong and go on after it; where there is too much of something, it ends."""
        try:
            yield
        except Fault as fault:
            if isinstance(fault, Excess) and kind is not Excess:
                raise
            self._say(fault)

    def _say(self, fault: Fault) -> None:
        if isinstance(fault, Typed):
            self.mistakes.append(Mistake((), fault.where, fault.what))
        elif len(self.mistakes) < 200:
            key = fault.origin.key
            self.mistakes.append(Mistake(key, spelled(key) or "file", fault.what, fault.of_key, fault.origin))


def _entries(file: _File, table: str) -> Iterator[tuple[str, dict[str, Any]]]:
    found = file.top.get(table, {})
    if not isinstance(found, dict):
        raise Fault(file.at(table), f"expected tables such as [{table}.NAME], got {found!r:.60}; write [{table}.NAME]")
    for name, value in found.items():
        if not isinstance(value, dict):
            raise Fault(file.at(table, name), f"expected a table, [{table}.{name[:60]}], got {value!r:.60}")
        yield name, value


def _connections(file: _File) -> Iterator[tuple[int, dict[str, Any]]]:
    found = file.top.get("connections", [])
    if not isinstance(found, list):
        raise Fault(file.at("connections"), f"expected a list, got {found!r:.60}; write [[connections]]")
    for number, value in enumerate(found):
        if not isinstance(value, dict):
            raise Fault(file.at("connections", number), f"expected a table with from and to, got {value!r:.60}")
        yield number, value
