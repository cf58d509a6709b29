"""From the text of a system file to `SystemFile`: every key is known, every name refers to something, or it is refused.

Pure: it opens no file and loads no component. It goes on after a mistake, so that all of them are named at once, each
with the key it is about; what is wrong is left out of the system that it answers with.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import InvalidNameError, SystemFileError
from aiorts.model.names import Path as PortPath
from aiorts.model.options import OWN_KEYS, SERVICE_KEYS
from aiorts.system.entries import EntryReader
from aiorts.system.families import misplaced
from aiorts.system.places import Key
from aiorts.system.reading import NOTHING, Mistake, hint, near_hint, spelled
from aiorts.system.toml import LARGEST, tables
from aiorts.system.values import (
    ClockEntry,
    ComponentEntry,
    ConnectionEntry,
    ContextEntry,
    Override,
    SystemFile,
)

__all__ = ("CLOCKS", "LARGEST", "SCHEMA", "Mistake", "parse", "parse_override", "read", "spelled")

SCHEMA: Final = 1
CLOCKS: Final = ("system", "scaled", "simulated")
_TOP: Final = ("schema", "plugins", "clock", "components", "composites", "connections", "contexts", "watch_loop")
_COMPONENT: Final = ("type", "options", "params", "sets", "active", "supervision", "start")


def parse(text: str, path: Path, overrides: Iterable[str] = ()) -> SystemFile:
    """The system that `text` describes; `path` is where it stands, `overrides` are texts "component.param=value".

    Raises:
        SystemFileError: says what is wrong first, with line and column, and what may have been meant.
    """
    system, mistakes = read(text, path, overrides)
    if not mistakes:
        return system
    if not (in_file := [mistake for mistake in mistakes if not mistake.where.startswith("--set")]):
        raise SystemFileError(f"{path}: {mistakes[0].where}: {mistakes[0].what}")
    text = text.removeprefix("\ufeff")
    first = min(in_file, key=lambda mistake: (mistake.place(text).line, mistake.place(text).column))
    place = first.place(text)
    text = text.replace("\r\n", "\n")
    start = sum(len(line) + 1 for line in text.split("\n")[: place.line - 1]) + place.column - 1
    error = SystemFileError(f"{path}:{place.line}:{place.column}: {first.where}: {first.what}")
    raise error.at(text, start, start + place.width)


def read(text: str, path: Path, overrides: Iterable[str] = ()) -> tuple[SystemFile, tuple[Mistake, ...]]:
    """The system without what is wrong in it, and all that is wrong.

    Raises:
        NotToml: it is no TOML: says line, column and reason. SystemFileError: it is too large.
    """
    text = text.removeprefix("\ufeff")
    reader = _Reader(text, path)
    system = reader.system(tables(text, path), overrides)
    return system, tuple(reader.mistakes)


def parse_override(text: str) -> Override:
    """`component.param=value` taken apart; SystemFileError when it has another form."""
    where, equals, value = text.partition("=")
    component, dot, param = where.strip().partition(".")
    if not (equals and dot and component and param):
        error = SystemFileError(f"--set {text[:80]!r}: expected COMPONENT.PARAM=VALUE, such as imu.speed=200")
        raise error.at(text, _misplaced(text))
    return Override(component, param, value)


def _misplaced(text: str) -> int:
    """Where a text ceases to look like COMPONENT.PARAM=VALUE."""
    found = re.match(r"[^.=]+(?:\.(?:[^=]+)?)?", text)
    return 0 if found is None else found.end()


class _Reader(EntryReader):
    def __init__(self, text: str, path: Path) -> None:
        super().__init__()
        self._text = text
        self._path = path

    def system(self, top: dict[str, Any], overrides: Iterable[str]) -> SystemFile:
        if not self._schema(top):
            top = {}  # of another version nothing can be said
        self._only((), top, _TOP)
        tables_ = self._tables(top, "components", "component")
        components = {name: self._component(name, table) for name, table in tables_.items()}
        composites = self._composites(top, components)
        known = {**components, **composites}
        self._start_order(components, known, tables_)
        contexts = {
            name: self._context(name, table, known) for name, table in self._tables(top, "contexts", "context").items()
        }
        for key, what in misplaced(composites, contexts):
            self._say(key, what)
        listed: list[Any] = self._get((), top, "connections", list, [])
        connections = (self._connection(number, table, known) for number, table in enumerate(listed, start=1))
        return SystemFile(
            self._path,
            MappingProxyType({name: entry for name, entry in components.items() if entry.type}),
            tuple(entry for entry in connections if entry is not None),
            MappingProxyType({name: entry for name, entry in contexts.items() if entry.kind}),
            self._plugin_paths(top),
            tuple(found for text in overrides if top and (found := self._override(text, components)) is not None),
            self._clock(top),
            composites,
            self._watch(top),
            self._text,
        )

    # -- the parts -------------------------------------------------------------------------------------------------

    def _schema(self, top: dict[str, Any]) -> bool:
        version = top.get("schema")
        if version == SCHEMA and type(version) is int:
            return True
        if type(version) is int:
            advice = "update aiorts" if version > SCHEMA else f"write the file for schema {SCHEMA}"
            self._say(("schema",), f"version {version}, and this aiorts reads schema = {SCHEMA} alone; {advice}")
        else:
            got = f"got {version!r:.80}" if "schema" in top else "it is missing"
            near = near_hint("schema", top) if "schema" not in top else ""
            self._say(("schema",), f"expected schema = {SCHEMA} in the first line, {got}{near}")
            return True
        return False

    def _component(self, name: str, table: dict[str, Any]) -> ComponentEntry:
        key: Key = ("components", name)
        unknown = self._only(key, table, _COMPONENT)
        if "type" not in table and get_close_matches("type", unknown):
            table = {**table, "type": ""}  # its wrong spelling has been named
        params = self._get(key, table, "params", dict, {})
        given = self._get(key, table, "options", object, [])
        kind = self._get(key, table, "type", str)
        if kind == "" and not unknown:
            self._say((*key, "type"), "expected FILE.py:Class, or the name of an installed type, got ''")
        options = self._options((*key, "options"), given)
        return ComponentEntry(
            name,
            "" if kind is NOTHING else kind,
            MappingProxyType(dict(params)),
            options,
            self._sets(key, table),
            self._get(key, table, "active", str, ""),
            self._supervision(key, table),
            self._start(key, table),
        )

    def _options(self, key: Key, given: Any) -> tuple[str, ...]:
        if isinstance(given, str):
            try:
                return tuple(shlex.split(given))
            except ValueError as error:
                self._say(key, f"{str(error).lower()} in {given!r:.80}; a list needs no quotes")
                return ()
        if not isinstance(given, list):
            self._say(key, f'expected a list such as ["-i", "TimedDouble"] or one text, got {given!r:.80}')
            return ()
        for number, item in enumerate(given):
            if isinstance(item, bool) or not isinstance(item, str | int | float):
                self._say((*key, number), f"expected text or a number, got {item!r:.80}")
        return tuple(str(item) for item in given if isinstance(item, str | int | float) and not isinstance(item, bool))

    def _context(self, name: str, table: dict[str, Any], components: Mapping[str, Any]) -> ContextEntry:
        key: Key = ("contexts", name)
        if "order" in table and "members" not in table:
            self._say(
                (*key, "order"), "members run in the order in which they stand; write members = [...]", of_key=True
            )
            table = {("members" if word == "order" else word): value for word, value in table.items()}
        if "type" in table and "kind" not in table:
            self._say((*key, "type"), "a context has a kind, and only components have a type; write kind", of_key=True)
            table = {("kind" if word == "type" else word): value for word, value in table.items()}
        members = self._members(key, self._get(key, table, "members", list, missing=[]), components)
        return ContextEntry(
            name,
            self._get(key, table, "kind", str, missing=""),
            members,
            self._get(key, table, "activate", bool, True),
            MappingProxyType({k: value for k, value in table.items() if k not in ("kind", "members", "activate")}),
        )

    def _connection(self, number: int, table: Any, components: Mapping[str, Any]) -> ConnectionEntry | None:
        key: Key = ("connections", number - 1)
        if not isinstance(table, dict):
            self._say(key, f"expected a table with from and to, got {table!r:.60}")
            return None
        before = len(self.mistakes)
        to = self._get(key, table, "to", object, missing=None)
        texts = (to,) if isinstance(to, str) else self._texts((*key, "to"), to) if to is not None else ()
        if to is not None and not isinstance(to, str) and to == []:
            self._say((*key, "to"), "expected at least one port")
        writer = self._get(key, table, "from", str, missing=None)
        if writer is not None:
            self._check_port((*key, "from"), writer, components)
        for place, path in enumerate(texts):
            self._check_port((*key, "to") if isinstance(to, str) else (*key, "to", place), path, components)
        options = {word: value for word, value in table.items() if word not in ("from", "to")}
        self._no_tables(key, options)
        if writer is None or len(self.mistakes) > before:
            return None
        return ConnectionEntry((writer, *texts), MappingProxyType(_flat(options)), number)

    def _no_tables(self, key: Key, options: Mapping[str, Any]) -> None:
        """Refuse a table where an option wants a value, and one that holds nothing."""
        for word, value in options.items():
            if not isinstance(value, dict):
                continue
            if len(key) == 2 and word in OWN_KEYS:
                dotted = [f"{word}_{inner}" for inner in value if f"{word}_{inner}" in OWN_KEYS]
                remedy = f"did you mean {dotted[0]!r}?" if dotted else f"write {word} = VALUE"
                self._say((*key, word), f"expected a value, got the table {value!r:.60}; {remedy}")
            elif not value and word not in SERVICE_KEYS:
                self._say((*key, word), "is an empty table and says nothing; take it away", of_key=True)
            else:
                self._no_tables((*key, word), value)

    def _check_port(self, key: Key, path: str, components: Mapping[str, Any]) -> None:
        if not path:
            self._say(key, "is empty; write COMPONENT.PORT")
            return
        try:
            parsed = PortPath.parse(path)
        except InvalidNameError as error:
            self._say(key, str(error))
            return
        if not parsed.port or parsed.kernel:
            self._say(key, f"{path!r:.80} names no port of this system; write COMPONENT.PORT")
        elif parsed.component not in components:
            self._unknown(key, "component", parsed.component, components)

    def _override(self, text: str, components: Mapping[str, Any]) -> Override | None:
        try:
            override = parse_override(text)
        except SystemFileError as error:
            where, _, what = str(error).partition(": ")
            self.mistakes.append(Mistake((), where, what))
            return None
        if override.component not in components:
            what = f"unknown component {override.component[:80]!r}; {hint(override.component, components)}"
            self.mistakes.append(Mistake((), f"--set {text[:80]}", what))
            return None
        return override

    def _plugin_paths(self, top: dict[str, Any]) -> tuple[Path, ...]:
        table = self._get((), top, "plugins", dict, {})
        self._only(("plugins",), table, ("path",))
        folder = self._path.parent.resolve()
        paths = []
        for number, text in enumerate(
            self._texts(("plugins", "path"), self._get(("plugins",), table, "path", list, ["."]))
        ):
            key: Key = ("plugins", "path", number)
            try:
                found = (folder / text).resolve()
            except (OSError, ValueError, RuntimeError) as error:
                self._say(key, f"{text!r:.80}: {error}")
                continue
            if found.is_relative_to(folder):
                paths.append(found)
            else:
                self._say(key, f"{text!r:.80} is outside the system file's folder; move the files below it")
        return tuple(paths)

    def _clock(self, top: dict[str, Any]) -> ClockEntry:
        key: Key = ("clock",)
        table = self._get((), top, "clock", dict, {})
        self._only(key, table, ("kind", "speed"))
        kind = self._get(key, table, "kind", str, "scaled" if "speed" in table else "system")
        if kind not in CLOCKS:
            self._unknown((*key, "kind"), "kind", kind, CLOCKS)
            return ClockEntry()
        if kind != "scaled":
            if "speed" in table:
                self._say((*key, "speed"), f'only a clock of kind = "scaled" has a speed, this is {kind}')
            return ClockEntry(kind)
        speed = self._get(key, table, "speed", object)
        if speed is NOTHING:
            return ClockEntry()
        if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0 < speed < float("inf"):
            self._say((*key, "speed"), f"expected a number above 0, such as 10.0, got {speed!r:.80}")
            return ClockEntry()
        return ClockEntry(kind, float(speed))


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Options with dotted keys (`buffer.length = 4`) as one level; a time-out of `inf` as the None that is for ever."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = None if key == "timeout" and value == float("inf") else value
    return flat
