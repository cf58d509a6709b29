"""From the text of a system file to `SystemFile`: every key is known, every name refers to something, or it is refused.

Pure: it opens no file and loads no component. Errors name file, key, what was expected and what was got, and for text
that is no TOML line and column.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NoReturn

from aiorts.errors import InvalidNameError, SystemFileError
from aiorts.model.names import Path as PortPath
from aiorts.model.names import check_name
from aiorts.system.values import ComponentEntry, ConnectionEntry, ContextEntry, Override, SystemFile

__all__ = ("LARGEST", "parse", "parse_override")

LARGEST: Final = 1024 * 1024
"""Bytes of a system file."""
_TOP: Final = ("schema", "plugins", "components", "connections", "contexts")
_DEEPEST: Final = 32  # stands in the two patterns, too
# tomllib takes time that grows with the square of a key's parts, and its recursion ends the interpreter's patience.
_LONG_KEY: Final = re.compile(r"(?:\.[\w\-\"' \t]*+){32}")
_DEEP: Final = re.compile(r"(?:[\[{][ \t\r\n]*+){32}")
_WORDS: Final[dict[type, str]] = {
    str: "text",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    list: "a list",
    dict: "a table",
}


def parse(text: str, path: Path, overrides: Iterable[str] = ()) -> SystemFile:
    """The system that `text` describes; `path` is where it stands, `overrides` are texts "component.param=value".

    Raises:
        SystemFileError: says what is wrong, where, and what may have been meant.
    """
    return _Parser(path).system(_toml(text, path), overrides)


def parse_override(text: str) -> Override:
    """`component.param=value` taken apart; SystemFileError when it has another form."""
    where, equals, value = text.partition("=")
    component, dot, param = where.strip().partition(".")
    if not (equals and dot and component and param):
        error = SystemFileError(f"--set {text[:80]!r}: expected COMPONENT.PARAM=VALUE, such as imu.speed=200")
        raise error.at(text, _misplaced(text))
    return Override(component, param, value)


def _toml(text: str, path: Path) -> dict[str, Any]:
    if len(text.encode("utf-8", "surrogatepass")) > LARGEST:
        raise SystemFileError(f"{path}: larger than {LARGEST} bytes; a system file is not")
    text = text.removeprefix("\ufeff")
    for pattern, what in ((_LONG_KEY, "a key of so many parts"), (_DEEP, "nesting so deep")):
        if (found := pattern.search(text)) is not None:
            line = text.count("\n", 0, found.start()) + 1
            raise SystemFileError(f"{path}, line {line}: {what} has no place in a system file (at most {_DEEPEST})")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        end = f"(at line {text.rstrip().count(chr(10)) + 1}, the end of the file)"
        what = str(error).replace("(at end of document)", end)
        refused = SystemFileError(f"{path}: not valid TOML: {what}")
        text = text.replace("\r\n", "\n")  # as tomllib counts
        raise refused.at(text, _toml_place(text, what)) from None
    except (ValueError, RecursionError) as error:
        raise SystemFileError(f"{path}: not valid TOML: {str(error) or 'nested too deeply'}") from None


def _toml_place(text: str, what: str) -> int:
    """Where in the text it is of which tomllib says "(at line 3, column 5)"; its end where it says nothing."""
    found = re.search(r"\(at line (\d+), column (\d+)\)", what)
    if found is None:
        return len(text.rstrip())
    lines = text.split("\n")
    return sum(len(line) + 1 for line in lines[: int(found[1]) - 1]) + int(found[2]) - 1


def _misplaced(text: str) -> int:
    """Where a text ceases to look like COMPONENT.PARAM=VALUE."""
    found = re.match(r"[^.=]+(?:\.(?:[^=]+)?)?", text)
    return 0 if found is None else found.end()


class _Parser:
    def __init__(self, path: Path) -> None:
        self._path = path

    def system(self, top: dict[str, Any], overrides: Iterable[str]) -> SystemFile:
        if top.get("schema") != 1 or isinstance(top.get("schema"), bool):
            self._fail("schema", f"expected schema = 1 in the first line, got {top.get('schema', 'nothing')!r}")
        self._only("", top, _TOP)
        components = {
            name: self._component(name, table) for name, table in self._tables(top, "components", "component").items()
        }
        contexts = {
            name: self._context(name, table, components)
            for name, table in self._tables(top, "contexts", "context").items()
        }
        connections = self._list(top, "connections")
        return SystemFile(
            self._path,
            MappingProxyType(components),
            tuple(self._connection(number, table, components) for number, table in enumerate(connections, start=1)),
            MappingProxyType(contexts),
            self._plugin_paths(top),
            tuple(self._override(text, components) for text in overrides),
        )

    # -- the parts -------------------------------------------------------------------------------------------------

    def _component(self, name: str, table: dict[str, Any]) -> ComponentEntry:
        where = f"components.{name}"
        self._only(where, table, ("type", "params"))
        params = self._get(where, table, "params", dict, {})
        return ComponentEntry(name, self._get(where, table, "type", str), MappingProxyType(dict(params)))

    def _context(self, name: str, table: dict[str, Any], components: Mapping[str, Any]) -> ContextEntry:
        where = f"contexts.{name}"
        members = self._texts(f"{where}.members", self._get(where, table, "members", list))
        for member in members:
            if member not in components:
                self._unknown(f"{where}.members", "component", member, components)
            if members.count(member) > 1:
                self._fail(f"{where}.members", f"{member!r} stands there twice")
        options = {key: value for key, value in table.items() if key not in ("kind", "members", "activate")}
        return ContextEntry(
            name,
            self._get(where, table, "kind", str),
            members,
            self._get(where, table, "activate", bool, True),
            MappingProxyType(options),
        )

    def _connection(self, number: int, table: Any, components: Mapping[str, Any]) -> ConnectionEntry:
        where = f"connections[{number}]"
        if not isinstance(table, dict):
            self._fail(where, f"expected a table with from and to, got {table!r:.60}")
        to = self._get(where, table, "to", object)
        targets = (to,) if isinstance(to, str) else self._texts(f"{where}.to", to)
        ports = (self._get(where, table, "from", str), *targets)
        if len(ports) < 2:
            self._fail(f"{where}.to", "expected at least one port")
        for path in ports:
            self._check_port(where, path, components)
        options = {key: value for key, value in table.items() if key not in ("from", "to")}
        return ConnectionEntry(ports, MappingProxyType(_flat(options)), number)

    def _check_port(self, where: str, path: str, components: Mapping[str, Any]) -> None:
        try:
            parsed = PortPath.parse(path)
        except InvalidNameError as error:
            self._fail(where, str(error))
        if not parsed.port or parsed.kernel:
            self._fail(where, f"{path!r} names no port of this system; write COMPONENT.PORT")
        if parsed.component not in components:
            self._unknown(where, "component", parsed.component, components)

    def _override(self, text: str, components: Mapping[str, Any]) -> Override:
        override = parse_override(text)
        if override.component not in components:
            self._unknown(f"--set {text}", "component", override.component, components)
        return override

    def _plugin_paths(self, top: dict[str, Any]) -> tuple[Path, ...]:
        table = self._get("", top, "plugins", dict, {})
        self._only("plugins", table, ("path",))
        folder = self._path.parent.resolve()
        paths = []
        for text in self._texts("plugins.path", self._get("plugins", table, "path", list, ["."])):
            found = (folder / text).resolve()
            if not found.is_relative_to(folder):
                self._fail("plugins.path", f"{text!r} is outside the system file's folder; move the files below it")
            paths.append(found)
        return tuple(paths)

    # -- taking values out, checked ----------------------------------------------------------------------------------

    def _get(self, where: str, table: dict[str, Any], key: str, kind: type, *default: Any) -> Any:
        full = f"{where}.{key}" if where else key
        if key not in table:
            if default:
                return default[0]
            self._fail(where or "file", f"{key} is missing{_near_hint(key, table)}")
        value = table[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind not in (bool, object)):
            self._fail(full, f"expected {_WORDS.get(kind, 'a value')}, got {value!r:.80}")
        return value

    def _tables(self, top: dict[str, Any], key: str, word: str) -> dict[str, dict[str, Any]]:
        tables: dict[str, dict[str, Any]] = self._get("", top, key, dict, {})
        for name, table in tables.items():
            try:
                check_name(name, word)
            except InvalidNameError as error:
                self._fail(f"{key}.{name[:60]}", str(error))
            if not isinstance(table, dict):
                self._fail(f"{key}.{name}", f"expected a table, [{key}.{name}], got {table!r:.60}")
        return tables

    def _list(self, top: dict[str, Any], key: str) -> list[Any]:
        value: list[Any] = self._get("", top, key, list, [])
        return value

    def _texts(self, where: str, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self._fail(where, f"expected a list of texts, got {value!r:.80}")
        return tuple(value)

    def _only(self, where: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
        for key in table:
            if key not in known:
                self._unknown(where or "file", "key", key, known)

    def _unknown(self, where: str, word: str, name: str, known: Iterable[str]) -> NoReturn:
        self._fail(where, f"unknown {word} {name[:80]!r}; {_hint(name, known)}")

    def _fail(self, where: str, what: str) -> NoReturn:
        raise SystemFileError(f"{self._path}: {where}: {what}")


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Options with dotted keys (`buffer.length = 4`) as one level; `inf` as the None that means for ever."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = None if value == float("inf") else value
    return flat


def _hint(name: str, known: Iterable[str]) -> str:
    names = [str(one) for one in known]
    near = get_close_matches(name[:100], names, n=1)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names[:20]) or 'none'}"


def _near_hint(key: str, table: Mapping[str, Any]) -> str:
    near = get_close_matches(key, [str(other) for other in table], n=1)
    return f"; did you mean {key!r} by {near[0]!r}?" if near else ""
