"""From the text of a system file to `SystemFile`: every key is known, every name refers to something, or it is refused.

Pure: it opens no file and loads no component. It goes on after a mistake, so that all of them are named at once, each
with the key it is about; what is wrong is left out of the system that it answers with.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import InvalidNameError, SystemFileError
from aiorts.model.names import Path as PortPath
from aiorts.model.names import check_name
from aiorts.system.places import Key, Place, places_of
from aiorts.system.toml import LARGEST, tables
from aiorts.system.values import (
    ClockEntry,
    ComponentEntry,
    ConnectionEntry,
    ContextEntry,
    Override,
    SystemFile,
)

__all__ = ("CLOCKS", "LARGEST", "SCHEMA", "Mistake", "parse", "parse_override", "read")

SCHEMA: Final = 1
CLOCKS: Final = ("system", "scaled", "simulated")
_TOP: Final = ("schema", "plugins", "clock", "components", "connections", "contexts")
_WORDS: Final[dict[type, str]] = {
    str: "text",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    list: "a list",
    dict: "a table",
}
_NOTHING: Final[Any] = object()
_MOST_MISTAKES: Final = 200
"""Mistakes that are named: who has more mends these first."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """One thing that is wrong, and the key it is about; `of_key` when the key itself is wrong and not its value."""

    key: Key
    where: str
    what: str
    of_key: bool = False

    def place(self, text: str) -> Place:
        """Where it stands in the text."""
        places = places_of(text)
        return places.key(self.key) if self.of_key else places.value(self.key)


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


class _Reader:
    def __init__(self, text: str, path: Path) -> None:
        self._text = text
        self._path = path
        self.mistakes: list[Mistake] = []

    def system(self, top: dict[str, Any], overrides: Iterable[str]) -> SystemFile:
        if not self._schema(top):
            top = {}  # of another version nothing can be said
        self._only((), top, _TOP)
        tables_ = self._tables(top, "components", "component")
        components = {name: self._component(name, table) for name, table in tables_.items()}
        contexts = {
            name: self._context(name, table, components)
            for name, table in self._tables(top, "contexts", "context").items()
        }
        listed: list[Any] = self._get((), top, "connections", list, [])
        connections = (self._connection(number, table, components) for number, table in enumerate(listed, start=1))
        return SystemFile(
            self._path,
            MappingProxyType({name: entry for name, entry in components.items() if entry.type}),
            tuple(entry for entry in connections if entry is not None),
            MappingProxyType({name: entry for name, entry in contexts.items() if entry.kind}),
            self._plugin_paths(top),
            tuple(found for text in overrides if top and (found := self._override(text, components)) is not None),
            self._clock(top),
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
            near = _near_hint("schema", top) if "schema" not in top else ""
            self._say(("schema",), f"expected schema = {SCHEMA} in the first line, {got}{near}")
            return True
        return False

    def _component(self, name: str, table: dict[str, Any]) -> ComponentEntry:
        key: Key = ("components", name)
        unknown = self._only(key, table, ("type", "options", "params"))
        if "type" not in table and get_close_matches("type", unknown):
            table = {**table, "type": ""}  # its wrong spelling has been named
        params = self._get(key, table, "params", dict, {})
        given = self._get(key, table, "options", object, [])
        kind = self._get(key, table, "type", str)
        if kind == "" and not unknown:
            self._say((*key, "type"), "expected FILE.py:Class, or the name of an installed type, got ''")
        options = self._options((*key, "options"), given)
        return ComponentEntry(name, "" if kind is _NOTHING else kind, MappingProxyType(dict(params)), options)

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
        members = self._texts((*key, "members"), self._get(key, table, "members", list, missing=[]))
        for number, member in enumerate(members):
            where: Key = (*key, "members", number)
            if member not in components:
                self._unknown(where, "component", member, components)
            elif member in members[:number]:
                self._say(where, f"{member!r} stands there twice")
        return ContextEntry(
            name,
            self._get(key, table, "kind", str, missing=""),
            tuple(dict.fromkeys(member for member in members if member in components)),
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
        writer = self._get(key, table, "from", str, missing="")
        if writer:
            self._check_port((*key, "from"), writer, components)
        for place, path in enumerate(texts):
            self._check_port((*key, "to") if isinstance(to, str) else (*key, "to", place), path, components)
        if len(self.mistakes) > before:
            return None
        options = {word: value for word, value in table.items() if word not in ("from", "to")}
        return ConnectionEntry((writer, *texts), MappingProxyType(_flat(options)), number)

    def _check_port(self, key: Key, path: str, components: Mapping[str, Any]) -> None:
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
            what = f"unknown component {override.component[:80]!r}; {_hint(override.component, components)}"
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
        if speed is _NOTHING:
            return ClockEntry()
        if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0 < speed < float("inf"):
            self._say((*key, "speed"), f"expected a number above 0, such as 10.0, got {speed!r:.80}")
            return ClockEntry()
        return ClockEntry(kind, float(speed))

    # -- taking values out, checked ----------------------------------------------------------------------------------

    def _get(
        self,
        key: Key,
        table: dict[str, Any],
        word: str,
        kind: type,
        default: Any = _NOTHING,
        *,
        missing: Any = _NOTHING,
    ) -> Any:
        """The value of a key; `default` when it is absent, which is a mistake where there is none (then `missing`)."""
        if word not in table:
            if default is _NOTHING:
                self._say(key, f"{word} is missing{_near_hint(word, table)}", of_key=True)
                return missing
            return default
        value = table[word]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind not in (bool, object)):
            self._say((*key, word), f"expected {_WORDS.get(kind, 'a value')}, got {value!r:.80}")
            return missing if default is _NOTHING else default
        return value

    def _tables(self, top: dict[str, Any], key: str, word: str) -> dict[str, dict[str, Any]]:
        tables: dict[str, Any] = self._get((), top, key, dict, {})
        good = {}
        for name, table in tables.items():
            try:
                check_name(name, word)
            except InvalidNameError as error:
                self._say((key, name), str(error), of_key=True)
                continue
            if isinstance(table, dict):
                good[name] = table
            else:
                self._say((key, name), f"expected a table, [{key}.{name}], got {table!r:.60}")
        return good

    def _texts(self, key: Key, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list):
            self._say(key, f"expected a list of texts, got {value!r:.80}")
            return ()
        for number, item in enumerate(value):
            if not isinstance(item, str):
                self._say((*key, number), f"expected a list of texts, got {item!r:.80}")
        return tuple(item for item in value if isinstance(item, str))

    def _only(self, key: Key, table: Mapping[str, Any], known: tuple[str, ...]) -> list[str]:
        unknown = [word for word in table if word not in known]
        for word in unknown:
            self._unknown((*key, word), "key", word, known, of_key=True)
        return unknown

    def _unknown(self, key: Key, word: str, name: str, known: Iterable[str], *, of_key: bool = False) -> None:
        if len(self.mistakes) < _MOST_MISTAKES:  # near names take their time
            self._say(key, f"unknown {word} {name[:80]!r}; {_hint(name, known)}", of_key=of_key)

    def _say(self, key: Key, what: str, *, of_key: bool = False) -> None:
        if len(self.mistakes) >= _MOST_MISTAKES:
            return
        self.mistakes.append(Mistake(key, spelled(key) or "file", what, of_key))


def spelled(key: Key) -> str:
    """A key as messages call it: elements of lists count from 1."""
    text = ""
    for part in key:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part[:80]}" if text else part[:80]
    return text


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Options with dotted keys (`buffer.length = 4`) as one level; a time-out of `inf` as the None that is for ever."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = None if key == "timeout" and value == float("inf") else value
    return flat


def _hint(name: str, known: Iterable[str]) -> str:
    names = [str(one) for one in known]
    near = get_close_matches(name[:100], names, n=1)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names[:20]) or 'none'}"


def _near_hint(key: str, table: Mapping[str, Any]) -> str:
    near = get_close_matches(key, [str(other) for other in table], n=1)
    return f"; did you mean {key!r} by {near[0]!r}?" if near else ""
