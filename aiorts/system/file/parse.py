"""Parses the text of a system file into `SystemFile`: unknown keys, and names that refer to nothing, are refused.

The parser loads no component, and opens no file but those that the text includes. It goes on after a mistake, so that
all mistakes are named at once, each with its key; wrong parts are left out of the resulting system.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from aiorts.composites import exports, groups_of
from aiorts.errors import AiortsError, ConfigurationError, InvalidNameError, SystemFileError, WiringError
from aiorts.model.configuration.sets import DEFAULT
from aiorts.model.declared import OptionError, fault_of, kinds_of, options_of, read_option, words_of
from aiorts.model.names import Path as PortPath
from aiorts.model.names import check_name, names_kernel
from aiorts.model.options import OWN_KEYS, SERVICE_KEYS, connector_profile
from aiorts.model.wanted.entries import ClockEntry, ComponentEntry, CompositeEntry, ConnectionEntry, ContextEntry
from aiorts.model.wanted.restart_policy import ACTING
from aiorts.processes import Limits
from aiorts.spelling import meant, nearest, suggestion
from aiorts.supervision import StartRule, Supervision, in_order
from aiorts.system.expansion.choices import AS_WRITTEN, Choices
from aiorts.system.expansion.expand import TOP_KEYS, Expanded, expand
from aiorts.system.expansion.repeating import IF, REPEAT
from aiorts.system.file.families import misplaced
from aiorts.system.file.pairs import ConnectedPairs
from aiorts.system.file.values import Override, SystemFile
from aiorts.system.text.origins import Source
from aiorts.system.text.places import Key
from aiorts.system.text.reading import NOTHING, Mistake, Reading, spelled
from aiorts.system.text.toml import LARGEST, read_text
from aiorts.system.text.version import SCHEMA, version_fault

__all__ = (
    "LARGEST",
    "SCHEMA",
    "TOP",
    "Mistake",
    "may_be_a_service",
    "parse",
    "parse_override",
    "read",
    "spelled",
)

_PLUGINS: Final = 'write plugins.path = ["."], the folders with plugins, counted from this file; [] is none'
TOP: Final = ("schema", *TOP_KEYS, "plugins", "clock", "components", "composites", "connections", "contexts")
_LIMITS: Final = tuple(options_of(Limits))
_COMPONENT: Final = ("type", "options", "params", "sets", "active", *options_of(ComponentEntry), IF, REPEAT)
_COMPOSITE: Final = ("members", *options_of(CompositeEntry), IF, REPEAT)
_LOOSE: Final[Mapping[str, Mapping[str, Any]]] = {"backoff": {"backoff_max": 1e300}, "backoff_max": {"backoff": 1e-300}}
"""Values that go with one that is checked alone: without the other limit of a delay, its default would be compared."""


def parse(text: str, path: Path, overrides: Iterable[str] = (), choices: Choices = AS_WRITTEN) -> SystemFile:
    """The system that `text` describes; `path` is its file, `overrides` are texts "component.param=value".

    Args:
        choices: variables, and ports in the place of others.

    Raises:
        SystemFileError: names the first mistake, with line and column, and what may have been meant.
    """
    system, mistakes = read(text, path, overrides, choices)
    if not mistakes:
        return system
    if not (in_file := [mistake for mistake in mistakes if not mistake.typed]):
        raise SystemFileError(f"{path}: {mistakes[0].where}: {mistakes[0].what}")
    order = {source.path: number for number, source in enumerate(system.origins.sources())}
    spots = [(mistake.spot(system.origins), mistake) for mistake in in_file]
    spot, first = min(spots, key=lambda one: (order[one[0].source.path], one[0].place.line, one[0].place.column))
    raise spot.mark(SystemFileError(f"{spot}: {first.where}: {first.what}"))


def read(
    text: str, path: Path, overrides: Iterable[str] = (), choices: Choices = AS_WRITTEN
) -> tuple[SystemFile, tuple[Mistake, ...]]:
    """The system without its wrong parts, and all mistakes; opens the files that the text includes.

    Raises:
        NotToml: the text is no TOML; names line, column and reason.
        SystemFileError: the text is too large.
    """
    found = expand(Source(path, text.removeprefix("\ufeff")), choices, os.environ, partial(_below, path.parent))
    reader = _Reader(found)
    if found.mistakes:
        return replace(reader.system({"schema": SCHEMA}, ()), text=found.text), found.mistakes
    return reader.system(found.top, overrides), tuple(reader.mistakes)


def _below(folder: Path, path: Path) -> tuple[Path, str]:
    """The path and text of an included file, which has to lie below the folder of the named file."""
    try:
        whole = path.resolve()
    except (OSError, ValueError, RuntimeError) as error:
        raise SystemFileError(f"{str(path)!r:.4096}: {error}") from None
    if not whole.is_relative_to(folder.resolve()):
        raise SystemFileError(f"{str(path)!r:.4096} is outside the system file's folder; move the file below it")
    return whole, read_text(path)


def parse_override(text: str) -> Override:
    """Take `component.param=value` apart; SystemFileError: the text has another form."""
    where, equals, value = text.partition("=")
    component, dot, param = where.strip().partition(".")
    if not (equals and dot and component and param):
        error = SystemFileError(f"--set {text[:80]!r}: expected COMPONENT.PARAM=VALUE, such as imu.speed=200")
        begins = re.match(r"[^.=]+(?:\.(?:[^=]+)?)?", text)  # what looks like COMPONENT.PARAM=VALUE
        raise error.at(text, 0 if begins is None else begins.end())
    return Override(component, param, value)


def may_be_a_service(key: str) -> bool:
    """Whether a key may name the table of a service: one that resembles a key of `TOP` is a misspelling."""
    return not nearest(key, TOP, cutoff=0.85)


def may_be_of_a_service(key: str, value: Any) -> bool:
    """Whether a value may be the table of a service, or a list of tables: `[[NAME]]`."""
    listed = isinstance(value, list) and key not in TOP and all(isinstance(one, dict) for one in value)
    return (isinstance(value, dict) or listed) and may_be_a_service(key)


def _service_table(key: str, value: Any) -> dict[str, Any]:
    """The settings of a service; a list `[[NAME]]` is the setting that has the service's own name."""
    return value if isinstance(value, dict) else {key: value}


class _Reader(Reading):
    """Reads the tables, one method for each kind of entry."""

    def __init__(self, found: Expanded) -> None:
        super().__init__()
        self._found = found
        self._joined = ConnectedPairs()
        self._path = found.origins.main.path

    def system(self, top: dict[str, Any], overrides: Iterable[str]) -> SystemFile:
        if not self._schema(top):
            top = {}  # the keys of another version are not known
        services = {key: _service_table(key, value) for key, value in top.items() if may_be_of_a_service(key, value)}
        self._only((), top, (*TOP, *services))
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
            path=self._path,
            components=MappingProxyType({name: entry for name, entry in components.items() if entry.type}),
            connections=tuple(entry for entry in connections if entry is not None),
            contexts=MappingProxyType({name: entry for name, entry in contexts.items() if entry.kind}),
            plugin_paths=self._plugin_paths(top),
            overrides=tuple(
                found for text in overrides if top and (found := self._override(text, components)) is not None
            ),
            clock=self._clock(top),
            composites=composites,
            services=MappingProxyType(services),
            text=self._found.text,
            origins=self._found.origins,
            notes=self._found.notes,
        )

    # -- the parts -------------------------------------------------------------------------------------------------

    def _schema(self, top: dict[str, Any]) -> bool:
        fault, is_other = version_fault(top)
        if fault:
            self._say(("schema",), fault)
        return not is_other

    def _component(self, name: str, table: dict[str, Any]) -> ComponentEntry:
        key: Key = ("components", name)
        unknown = self._only(key, table, _COMPONENT)
        params = self._get(key, table, "params", dict, {})
        given = self._get(key, table, "options", object, [])
        kind = self._get(key, table, "type", str)
        if kind == "" and not unknown:
            self._say((*key, "type"), "expected FILE.py:Class, package.module:Class or an installed name, got ''")
        tables = {"supervision": self._supervision, "start": self._start, "limits": self._limits}
        return ComponentEntry(
            name,
            "" if kind is NOTHING else kind,
            MappingProxyType(dict(params)),
            self._options((*key, "options"), given),
            self._sets(key, table),
            self._get(key, table, "active", str, ""),
            **self._declared(ComponentEntry, key, table, tables),
        )

    def _declared(
        self, cls: type, key: Key, table: dict[str, Any], tables: Mapping[str, Callable[[Key, dict[str, Any]], Any]]
    ) -> dict[str, Any]:
        """The values of a class's declared keys: tables are read by the functions in `tables`, others by type."""
        return {
            word: tables[word](key, table) if word in tables else self._value(cls, key, table, word)
            for word in options_of(cls)
        }

    def _value(self, cls: type, key: Key, table: dict[str, Any], word: str) -> Any:
        one, kind = options_of(cls)[word], kinds_of(cls)[word][0]
        if words := [other for other in words_of(kind) if other]:
            found = self._of_words(key, table, word, words)
            if found is None:
                return one.default
            return kind(found) if isinstance(kind, type) else found
        value = self._get(key, table, word, object if kind in (int, float) else kind, one.default)
        if kind is str and (what := fault_of(cls, word, value)):
            self._say((*key, word), what)
            return one.default
        if word not in table or kind not in (int, float):
            return value
        try:
            if isinstance(value, str):  # in quotes it is no number of TOML
                raise OptionError(f"{word} = {value!r}: expected a number")
            return read_option(cls, word, value)
        except OptionError as error:
            self._say((*key, word), str(error).removeprefix(f"{word} = {value!r}: ") + f", got {value!r:.80}")
            return one.default

    def _of_words(self, key: Key, table: dict[str, Any], word: str, words: list[str]) -> str | None:
        if len(words) > 1:
            return self._word(key, table, word, words)
        value = self._get(key, table, word, str, "")
        if value not in ("", *words):
            hint = meant(value, words)
            self._say((*key, word), f"expected {words[0]!r}, or no such line, got {value!r:.80}{hint}")
        return str(value)

    def _limits(self, key: Key, table: dict[str, Any]) -> Mapping[str, Any]:
        limits = self._get(key, table, "limits", dict, {})
        if limits and not table.get("isolation"):
            self._say((*key, "limits"), 'limits are those of a process; add isolation = "process"', of_key=True)
        self._made((*key, "limits"), limits, _LIMITS, Limits)
        return MappingProxyType(dict(limits))

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
        if writer is not None and texts and all(names_kernel(path) for path in (writer, *texts)):
            self._say((*key, "from"), "no port is of this system; connect them in the file of one of those kernels")
        if writer is None or len(self.mistakes) > before:
            return None
        entry = ConnectionEntry((writer, *texts), MappingProxyType(_flat(options)), number)
        self._once(key, entry)
        return None if len(self.mistakes) > before else entry

    def _once(self, key: Key, entry: ConnectionEntry) -> None:
        """Refuse pairs that are connected already, as far as that is known without the ports."""
        try:
            _, limits = connector_profile("", entry.options, "", entry.ports)
        except WiringError:  # wrong, or an option of service ports: judged with the ports
            return
        writer, *readers = entry.ports
        for reader in readers:
            if (fault := self._joined.fault(writer, reader, entry.number, limits)) is not None:
                self._say(key, str(fault), of_key=True)

    def _no_tables(self, key: Key, options: Mapping[str, Any]) -> None:
        """Refuse a table where an option wants a value, and an empty table."""
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
        if not parsed.port:
            self._say(
                key, f"{path!r:.80} names no port; write COMPONENT.PORT, or KERNEL/COMPONENT.PORT of another kernel"
            )
        elif parsed.kernel:
            return  # the components of another kernel are known when it is there
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
            what = f"unknown component {override.component[:80]!r}; {suggestion(override.component, components)}"
            self.mistakes.append(Mistake((), f"--set {text[:80]}", what))
            return None
        return override

    def _plugin_paths(self, top: dict[str, Any]) -> tuple[Path, ...]:
        table = top.get("plugins", {})
        if not isinstance(table, dict):
            self._say(("plugins",), f"expected a table, got {table!r:.80}; {_PLUGINS}")
            return ()
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
                self._say(key, f"{text!r:.4096}: {error}")
                continue
            if found.is_relative_to(folder):
                paths.append(found)
            else:
                self._say(key, f"{text!r:.4096} is outside the system file's folder; move the files below it")
        return tuple(paths)

    def _clock(self, top: dict[str, Any]) -> ClockEntry:
        key: Key = ("clock",)
        table = self._get((), top, "clock", dict, {})
        self._only(key, table, options_of(ClockEntry))
        usual = {"kind": "scaled"} if "speed" in table else {}
        kind = self._value(ClockEntry, key, {**usual, **table}, "kind")
        if kind == "scaled":
            speed = self._get(key, table, "speed", object, missing=None)
            if not (what := fault_of(ClockEntry, "speed", speed)):
                return ClockEntry() if speed is None else ClockEntry(kind, float(speed))
        else:
            what = f'only a clock of kind = "scaled" has a speed, this is {kind}' if "speed" in table else ""
        if what:
            self._say((*key, "speed"), what)
        return ClockEntry() if kind == "scaled" else ClockEntry(kind)

    # -- of a component ----------------------------------------------------------------------------------------------

    def _sets(self, key: Key, table: dict[str, Any]) -> Mapping[str, Mapping[str, Any]]:
        good: dict[str, Mapping[str, Any]] = {}
        for name, values in self._get(key, table, "sets", dict, {}).items():
            where: Key = (*key, "sets", name)
            try:
                check_name(name, "configuration set")
            except AiortsError as error:
                self._say(where, str(error), of_key=True)
                continue
            if name == DEFAULT:
                self._say(where, f"the set {DEFAULT!r} is what params says; write it under params", of_key=True)
            elif name.startswith("_"):
                self._say(where, "names that begin with '_' are not for configuration sets", of_key=True)
            elif isinstance(values, dict):
                good[name] = MappingProxyType(dict(values))
            else:
                self._say(where, f"expected a table of parameters, got {values!r:.60}")
        return MappingProxyType(good)

    def _supervision(self, key: Key, table: dict[str, Any]) -> Supervision | None:
        if "supervision" not in table:
            return None
        key = (*key, "supervision")
        given = self._get(key[:-1], table, "supervision", dict, {})
        if given.keys().isdisjoint(ACTING):
            if not self._only(key, given, options_of(Supervision)):
                what = 'says nothing that is done; write restart = "reset" or "restart", or a deadline'
                self._say(key, what, of_key=True)
            return None
        made: Supervision | None = self._made(key, given, options_of(Supervision), Supervision)
        return made

    def _start(self, key: Key, table: dict[str, Any]) -> StartRule | None:
        if "start" not in table:
            return None
        given = self._get(key, table, "start", dict, {})
        made: StartRule | None = self._made(
            (*key, "start"), given, options_of(StartRule), partial(StartRule, str(key[-1]))
        )
        return made

    def _made(self, key: Key, given: dict[str, Any], known: Collection[str], make: Any) -> Any:
        """The result of `make` for the values; each value is tried alone first, so that each wrong value is marked."""
        before = len(self.mistakes)
        self._only(key, given, known)
        for word, value in given.items():
            if word not in known:
                continue
            if word == "deadlines" and not isinstance(value, dict):
                self._say((*key, word), f"expected a table of seconds by hook, got {value!r:.80}")
                continue
            if word == "after" and isinstance(value, list):
                for number, text in enumerate(value):
                    self._try((*key, word, number), lambda text=text: make(after=(text,)))
                continue
            self._try((*key, word), lambda word=word, value=value: make(**{word: value, **_LOOSE.get(word, {})}))
        if len(self.mistakes) > before:
            return None
        return self._try(key, lambda: make(**given), of_key=True)

    def _try(self, key: Key, make: Any, *, of_key: bool = False) -> Any:
        try:
            return make()
        except AiortsError as error:
            word = next((part for part in reversed(key) if isinstance(part, str)), "")
            text = str(error).removeprefix(f"{key[1]}: ").removeprefix(f"{word} = ")
            self._say(key, text, of_key=of_key)
            return None

    # -- composites --------------------------------------------------------------------------------------------------

    def _composites(
        self, top: dict[str, Any], components: Mapping[str, ComponentEntry]
    ) -> Mapping[str, CompositeEntry]:
        tables = self._tables(top, "composites", "component")
        good = {}
        for name, table in tables.items():
            if name in components:
                self._say(("composites", name), f"there is a component {name!r}; choose another name", of_key=True)
                continue
            good[name] = self._composite(name, table, {**components, **tables})
        self._families(good)
        return MappingProxyType(good)

    def _composite(self, name: str, table: dict[str, Any], known: Mapping[str, Any]) -> CompositeEntry:
        key: Key = ("composites", name)
        if "isolation" in table:
            what = f"write a class derived from Composite, and make it a component: [components.{name}]"
            what += ', type = "FILE.py:Class", isolation = "process"; or give single members a process each'
            self._say((*key, "isolation"), f"members that a file lists have no process together; {what}", of_key=True)
            table = {word: value for word, value in table.items() if word not in ("isolation", "limits")}
        self._only(key, table, _COMPOSITE)
        given = self._get(key, table, "members", list, missing=[])
        far = {one: None for one in given if isinstance(one, str) and names_kernel(one)}
        members = self._members(key, given, {**known, **far})
        named = tuple(one.rpartition("/")[2] for one in members)

        def groups(key: Key, table: dict[str, Any]) -> Any:
            if "groups" not in table:
                return ()
            return self._try((*key, "groups"), lambda: groups_of(_texts(table["groups"]), named, name)) or ()

        def exported(key: Key, table: dict[str, Any]) -> Any:
            return MappingProxyType(self._exported((*key, "exported"), table.get("exported", []), named))

        keys = self._declared(CompositeEntry, key, table, {"groups": groups, "exported": exported})
        return CompositeEntry(name, members, named=isinstance(table.get("exported"), dict), **keys)

    def _members(self, key: Key, given: Any, known: Mapping[str, Any]) -> tuple[str, ...]:
        """Names of components and composites, each once."""
        members = self._texts((*key, "members"), given)
        for number, member in enumerate(members):
            where: Key = (*key, "members", number)
            if member not in known:
                self._unknown(where, "component", member, known)
            elif member in members[:number]:
                self._say(where, f"{member!r} stands there twice")
        return tuple(dict.fromkeys(member for member in members if member in known))

    def _word(self, key: Key, table: dict[str, Any], word: str, allowed: Iterable[str]) -> str | None:
        value = self._get(key, table, word, str, NOTHING if word in table else None)
        if value is None or value is NOTHING:
            return None
        if value not in allowed:
            self._unknown((*key, word), word, value, [str(one) for one in allowed])
            return None
        return str(value)

    def _exported(self, key: Key, given: Any, members: tuple[str, ...]) -> dict[str, str]:
        """The rules of `exported` as names by pattern."""
        if isinstance(given, str):
            given = [part.strip() for part in given.split(",") if part.strip()]
        if not isinstance(given, list | dict):
            what = 'a list such as ["arm.force"] or a table of names by pattern'
            self._say(key, f"expected {what}, got {given!r:.80}")
            return {}
        pairs = given.items() if isinstance(given, dict) else [(pattern, "{port}") for pattern in given]
        good = {}
        for number, (pattern, shown) in enumerate(pairs):
            where: Key = (*key, pattern if isinstance(given, dict) else number)
            rules = self._try(where, lambda pattern=pattern, shown=shown: self._rule(pattern, shown, key))
            if rules is None:
                continue
            if not any(fnmatchcase(member, rules[0].component) for member in members):
                self._unknown(where, "member", rules[0].component, members, of_key=isinstance(given, dict))
            else:
                good[pattern] = shown
        return good

    def _rule(self, pattern: Any, shown: Any, key: Key) -> Any:
        if not isinstance(pattern, str):
            raise ConfigurationError(f'expected text such as "arm.force", got {pattern!r:.80}; write COMPONENT.PORT')
        return exports({pattern: shown}, str(key[1]))

    def _families(self, composites: dict[str, CompositeEntry]) -> None:
        """Refuse a member of two composites, and one that would be a member of itself."""
        owners: dict[str, str] = {}
        for entry in composites.values():
            for number, member in enumerate(entry.members):
                owner = owners.setdefault(member, entry.name)
                if owner != entry.name:
                    what = f"{member!r} is a member of {owner} already; take it away from one of them"
                    self._say(("composites", entry.name, "members", number), what)
        for name in composites:
            seen, here = [name], name
            while (here := owners.get(here, "")) not in ("", *seen):
                seen.append(here)
            if here == name:
                way = " -> ".join([name, *reversed(seen)])
                self._say(("composites", name, "members"), f"would be a member of itself: {way}")
                for one in seen:
                    owners.pop(one, None)
                    composites[one] = replace(composites[one], members=())  # so that a walk along the members ends

    # -- the order of starting ---------------------------------------------------------------------------------------

    def _start_order(
        self, components: Mapping[str, ComponentEntry], known: Mapping[str, Any], tables: Mapping[str, Any]
    ) -> None:
        """Refuse conditions about unknown components, and rules that wait for each other."""
        rules = [entry.start for entry in components.values() if entry.start is not None]
        for rule in rules:
            for number, condition in enumerate(rule.conditions):
                if condition.component not in known:
                    key: Key = ("components", rule.component, "start", "after")
                    if isinstance(tables[rule.component]["start"]["after"], list):
                        key = (*key, number)
                    self._unknown(key, "component", condition.component, known)
        try:
            in_order(rules)
        except AiortsError as error:
            first = str(error).rpartition(": ")[2].partition(" ")[0]
            self._say(("components", first, "start", "after"), str(error))


def _texts(groups: Any) -> Any:
    """Groups as they may stand in a file: one text, or lists of names."""
    ok = isinstance(groups, str) or (
        isinstance(groups, list)
        and all(isinstance(group, list) and all(isinstance(name, str) for name in group) for group in groups)
    )
    if not ok:
        raise ConfigurationError(f'expected a text such as "a,b|c,d", or lists of names, got {groups!r:.80}')
    return groups


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Options with dotted keys (`buffer.length = 4`) as one level; a time-out of `inf` becomes None, forever."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = None if key == "timeout" and value == float("inf") else value
    return flat
