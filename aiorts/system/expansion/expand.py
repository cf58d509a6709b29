"""Makes one system from the text of a system file and the files it includes: tables, and the place of each key.

Pure: the caller passes the function that reads files, and the variables of the environment. A file without includes,
variables, conditions and repetitions stays as it is.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeAlias

from aiorts.errors import SystemFileError
from aiorts.late import dataclass
from aiorts.spelling import suggestion
from aiorts.system.expansion.choices import Choices
from aiorts.system.expansion.entries import Document
from aiorts.system.expansion.faults import Budget, Excess, Fault, Mistakes, Typed
from aiorts.system.expansion.inclusion import Inclusion, as_table, included, inclusion, listed, port_fault, remapped
from aiorts.system.expansion.joining import joined, mixed
from aiorts.system.expansion.parts import INCLUDE, VARIABLES, File, filled, put_own
from aiorts.system.expansion.repeating import IF, REPEAT, copies, has_number, is_there
from aiorts.system.expansion.resolving import refuse_absent, resolve
from aiorts.system.expansion.variables import Given, Scope, declared, handed, names_of, typed
from aiorts.system.expansion.writing import document_text
from aiorts.system.text.origins import Origin, Origins, Source
from aiorts.system.text.reading import Mistake, spelled
from aiorts.system.text.toml import LARGEST, NotToml, tables
from aiorts.system.text.version import version_fault

TOP_KEYS: Final = (INCLUDE, VARIABLES)
"""Keys at the top of a file that expansion removes."""
_DEEPEST: Final = 16
"""The most levels of files that include each other."""
_MOST: Final = 1000
"""The most inclusions; a file that is included twice counts twice."""
Reader: TypeAlias = Callable[[Path], tuple[Path, str]]
"""Reads an included file: its whole path, and its text. SystemFileError: it cannot be read."""


@dataclass(frozen=True, slots=True)
class Expanded:
    """One expanded system."""

    top: dict[str, Any]
    text: str
    """The whole system as one text."""
    origins: Origins
    mistakes: tuple[Mistake, ...] = ()
    """The mistakes of all files; if there are any, the tables are empty."""
    notes: tuple[Mistake, ...] = ()
    """Remarks that are no mistakes."""


def expand(main: Source, choices: Choices, environ: Mapping[str, str], read: Reader) -> Expanded:
    """The system of a file and of all files that it includes.

    Raises:
        NotToml: a file is no TOML.
        SystemFileError: the text is too large.
    """
    top = tables(main.text, main.path)
    if version_fault(top)[1] or not (choices.variables or choices.remaps or _is_written_so(top, main.text)):
        return Expanded(top, main.text, Origins(main))
    expansion = _Expansion(main, choices, environ, read)
    document = expansion.whole(top)
    others = tuple(source for _, source, _ in expansion.files.values())
    if expansion.mistakes.found:
        return Expanded({}, main.text, Origins(main, others=others), tuple(expansion.mistakes.found))
    whole, moved = joined(document, top, main)
    return Expanded(whole, document_text(whole), Origins(main, moved, others), (), tuple(expansion.notes()))


def _is_written_so(top: Mapping[str, Any], text: str) -> bool:
    if "${" in text or INCLUDE in top or VARIABLES in top:
        return True
    tables_ = [table for table in top.values() if isinstance(table, dict | list)]
    entries = [one for table in tables_ for one in (table.values() if isinstance(table, dict) else table)]
    return any(isinstance(one, dict) and (IF in one or REPEAT in one) for one in (*tables_, *entries))


class _Expansion:
    """Expands one system; goes on after a mistake, so that all mistakes are named at once."""

    def __init__(self, main: Source, choices: Choices, environ: Mapping[str, str], read: Reader) -> None:
        self._main, self._choices, self._environ, self._read = main, choices, environ, read
        self._budget = Budget()
        self._left = _MOST
        self._characters = LARGEST - len(main.text)
        self._declared: dict[str, Path] = {}
        self._read_files: list[File] = []
        self.files: dict[Path, tuple[Path, Source, dict[str, Any]]] = {}
        self.mistakes = Mistakes()
        self._kept = self.mistakes.kept

    def whole(self, top: dict[str, Any]) -> Document:
        """The document of the main file, with the choices of the command line."""
        document = Document()
        with self._kept(Excess):
            given = self._given()
            if (scope := self._scope(self._main, top, given)) is not None:
                way = ((Path(os.path.realpath(self._main.path)), self._main.path),)
                document = self._document(File(self._main, top, scope, way, ""))
            self._check_given(top)
            if self.mistakes.found:
                return document
            for fault in mixed(document):
                self.mistakes.say(fault)
            for fault in resolve(document, self._budget):
                self.mistakes.say(fault)
            self._remap(document)
            for fault in refuse_absent(document):
                self.mistakes.say(fault)
        return document

    def notes(self) -> Iterator[Mistake]:
        """The notes on variables that no text uses; one note for each, even if its file is included several times."""
        used = {(file.source.path, name) for file in self._read_files for name in file.scope.used}
        unused = {
            (file.source.path, name): file.at(VARIABLES, name)
            for file in self._read_files
            for name in file.scope.values
            if (file.source.path, name) not in used
        }
        for (_, name), origin in unused.items():
            what = f'no text has it; write "${{{name}}}" where it is meant, or take it away'
            yield Mistake(origin.key, spelled(origin.key), what, True, origin)

    # -- what the command line says --------------------------------------------------------------------------------

    def _given(self) -> dict[str, Given]:
        found: dict[str, Given] = {}
        for text in self._choices.variables:
            name, equals, value = text.partition("=")
            where, name = f"--var {text[:80]}", name.strip()
            if not equals or not name:
                self.mistakes.typed(where, "expected NAME=VALUE, such as sim=true")
            else:
                found[name] = typed(value, partial(Typed, where))
        return found

    def _check_given(self, top: Mapping[str, Any]) -> None:
        """Refuse variables of the command line that the file does not have."""
        own = list(names_of(top.get(VARIABLES, {})))
        for text in self._choices.variables:
            name = text.partition("=")[0].strip()
            if name and name not in own and "=" in text:
                what = f"unknown variable {name[:80]!r}; {suggestion(name, own) if own else 'the file has none'}"
                if (other := self._declared.get(name)) is not None:
                    what = f"{other} has it, and it is not handed on; declare {name} in {self._main.path}, and include"
                    what = f'{what} with vars = {{ {name} = "${{{name}}}" }}'
                self.mistakes.typed(f"--var {text[:80]}", what)

    def _remap(self, document: Document) -> None:
        for text in self._choices.remaps:
            port, equals, target = (part.strip() for part in text.partition("="))
            if not equals:
                fault = "expected COMPONENT.PORT=COMPONENT.PORT, such as camera.image=player.image"
            else:
                fault = port_fault(port) or port_fault(target) or remapped(document, port, target, "of the system")
            if fault:
                self.mistakes.typed(f"--remap {text[:80]}", fault)

    # -- a file ------------------------------------------------------------------------------------------------------

    def _scope(self, source: Source, top: Mapping[str, Any], given: Mapping[str, Given]) -> Scope | None:
        with self._kept():
            return declared(top.get(VARIABLES, {}), Origin(source, (VARIABLES,)), given, self._environ, self._budget)
        return None

    def _document(self, file: File) -> Document:
        document = Document()
        if INCLUDE in file.top:
            with self._kept():
                for given, origin in listed(file.top[INCLUDE], file.at(INCLUDE)):
                    with self._kept():
                        self._include(document, file, given, origin)
        put_own(document, file, self._kept)
        self._read_files.append(file)
        return document

    # -- including ---------------------------------------------------------------------------------------------------

    def _include(self, document: Document, file: File, given: Any, origin: Origin) -> None:
        table = as_table(given, origin)
        numbers = copies(table, file.scope, origin)
        there = is_there(table, file.scope, origin)
        prefix = table.get("prefix", "")
        prefix = file.scope.text(prefix, origin.below("prefix")) if isinstance(prefix, str) else ""
        if numbers is not None and not has_number(prefix):
            raise Fault(origin.below("prefix"), 'repeat needs a prefix with a number, such as prefix = "arm{i}_"')
        for number in (None,) if numbers is None else numbers:
            made, _ = filled(file, table, origin, number)
            how = inclusion(made, origin)
            if not there:
                self._leave_out(document, file, how)
                continue
            self._merge(document, file, included(self._read_in(file, how), how), prefix, how.prefix)

    def _read_in(self, file: File, how: Inclusion) -> Document:
        """The document of an included file, with the names that its parts have in that file."""
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
                known_names = suggestion(name, own) if own else "it has none; declare it there under [variables]"
                raise Fault(key, f"{how.file} has no variable {name[:80]!r}; {known_names}", of_key=True)
            values[name] = handed(name, value, key)
        scope = declared(top.get(VARIABLES, {}), Origin(source, (VARIABLES,)), values, self._environ, self._budget)
        folder = os.path.normpath(os.path.join(file.folder, os.path.dirname(how.file)))
        return self._document(
            File(source, top, scope, (*file.way, (whole, source.path)), "" if folder == "." else folder)
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

    def _leave_out(self, document: Document, file: File, how: Inclusion) -> None:
        """Record as absent the names in a file whose inclusion a condition leaves out; its mistakes do not count."""
        before = len(self.mistakes.found)
        try:
            left = included(self._read_in(file, how), how)
        except Excess:
            raise
        except SystemFileError:
            left = Document()
        del self.mistakes.found[before:]
        names = [name for table, name in left.names if table != "contexts"]
        document.absent.update(dict.fromkeys([*names, *left.absent], how.origin.below(IF)))
        document.families.update({name: [] for name in left.families})

    def _merge(self, document: Document, file: File, part: Document, template: str, prefix: str) -> None:
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
