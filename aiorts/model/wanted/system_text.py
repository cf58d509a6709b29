"""A wanted system as the text of a system file, without defaults."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from aiorts.errors import SystemFileError
from aiorts.late import dataclass
from aiorts.model.configuration.toml_values import basic_string, value_text
from aiorts.model.wanted.entries import (
    ComponentEntry,
    CompositeEntry,
    ConnectionEntry,
    ContextEntry,
    Wanted,
    said_keys,
)
from aiorts.model.wanted.restart_policy import Supervision
from aiorts.model.wanted.start_rules import StartRule

_BARE: Final = re.compile(r"[A-Za-z0-9_-]+")
_LONGEST: Final = 100
"""The most characters of a line; a longer list has a line for each of its items."""


@dataclass(frozen=True, slots=True)
class Saved:
    """A system as the text of a system file."""

    text: str
    notes: tuple[str, ...] = ()
    """The parts of the system that no system file can express, and that are not in the text."""


def system_text(wanted: Wanted, folder: Path, notes: list[str] | None = None) -> str:
    """The text of a system file in `folder`; paths below the folder are relative to it.

    Args:
        notes: receives the plugin folders that are not below `folder`, and so are left out.

    Raises:
        SystemFileError: names each component whose file is not below the folder.
    """
    writer = _Writer(folder, [] if notes is None else notes)
    text = "\n".join(writer.lines(wanted)) + "\n"
    if writer.faults:
        raise SystemFileError("\n".join(writer.faults))
    return text


class _Writer:
    """Writes one system."""

    def __init__(self, folder: Path, notes: list[str]) -> None:
        self._folder = folder
        self._notes = notes
        self.faults: list[str] = []

    def lines(self, wanted: Wanted) -> Iterator[str]:
        yield "schema = 1"
        yield from self._plugins(wanted)
        if wanted.clock.kind != "system":
            yield from ("", "[clock]", f"kind = {basic_string(wanted.clock.kind)}")
            if wanted.clock.speed is not None:
                yield f"speed = {value_text('clock.speed', wanted.clock.speed)}"
        for name, table in wanted.services.items():
            if tuple(table) == (name,) and is_list_of_tables(table[name]):
                for entry in table[name]:
                    yield from ("", f"[[{_key(name)}]]", *self._pairs(name, entry))
            else:
                yield from ("", f"[{_key(name)}]", *self._pairs(name, table))
        for component in wanted.components.values():
            yield from ("", f"[components.{component.name}]", *self._component(component))
        for composite in wanted.composites.values():
            yield from ("", f"[composites.{composite.name}]", *self._composite(composite))
        for connection in wanted.connections:
            yield from ("", "[[connections]]", *self._connection(connection))
        for context in wanted.contexts.values():
            yield from ("", f"[contexts.{context.name}]", *self._context(context))

    def _plugins(self, wanted: Wanted) -> Iterator[str]:
        inside = [path for path in wanted.plugin_paths if path.is_relative_to(self._folder)]
        for path in wanted.plugin_paths:
            if path not in inside:
                self._notes.append(f"plugins in {path}, which is not below {self._folder}: run it with --plugins")
        # The folder itself comes first: a relative FILE.py is taken from the first of these folders that has it.
        if places := [path for path in inside if path != self._folder]:
            yield from ("", "[plugins]", self._pair("plugins", "path", (".", *map(self._relative, places))))

    def _component(self, one: ComponentEntry) -> Iterator[str]:
        yield f"type = {basic_string(literal(self._type(one.name, one.type)), f'{one.name}.type')}"
        for param, value in one.params.items():
            yield self._pair(one.name, f"params.{_key(param)}", value)
        if one.active:
            yield f"active = {basic_string(one.active)}"
        for name, values in one.sets.items():
            yield f"sets.{_key(name)} = {self._inline(f'{one.name}.{name}', values)}"
        for word, value in said_keys(one).items():
            said = said_keys(value) if isinstance(value, Supervision | StartRule) else value
            yield f"{word} = {self._value(one.name, said)}"

    def _composite(self, one: CompositeEntry) -> Iterator[str]:
        yield self._pair(one.name, "members", one.members)
        for word, value in said_keys(one).items():
            if word == "exported" and all(name == "{port}" for name in value.values()):
                value = tuple(value)
            yield self._pair(one.name, word, value)

    def _connection(self, one: ConnectionEntry) -> Iterator[str]:
        source, *targets = one.ports
        yield f"from = {basic_string(source)}"
        yield f"to = {basic_string(targets[0]) if len(targets) == 1 else value_text(source, targets)}"
        for word, value in one.options.items():
            shown: Any = self._type(one.place, value) if word == "convert" else value
            yield self._pair(one.place, _key(word), float("inf") if word == "timeout" and value is None else shown)

    def _context(self, one: ContextEntry) -> Iterator[str]:
        yield f"kind = {basic_string(one.kind)}"
        yield from self._pairs(one.name, one.options)
        yield self._pair(one.name, "members", one.members)
        if not one.activate:
            yield "activate = false"

    # -- values ----------------------------------------------------------------------------------------------------

    def _type(self, where: str, text: str) -> str:
        """A text that names a class or function; the whole path of a file becomes the path from the folder."""
        home, _, name = text.rpartition(":")
        path = Path(home)
        if not (home.endswith(".py") and path.is_absolute()):
            return text
        if not path.is_relative_to(self._folder):
            what = f"{name} is in {path.parent}, which is not below {self._folder}"
            self.faults.append(f"{where}: {what}; save into {path.parent} or a folder above it")
        return f"{self._relative(path)}:{name}"

    def _relative(self, path: Path) -> str:
        inside = path.is_relative_to(self._folder)
        return path.relative_to(self._folder).as_posix() if inside else str(path)

    def _pairs(self, where: str, table: Mapping[str, Any]) -> Iterator[str]:
        return (self._pair(where, _key(key), value) for key, value in table.items())

    def _pair(self, where: str, key: str, value: Any) -> str:
        line = f"{key} = {self._value(f'{where}.{key}', value)}"
        if len(line) <= _LONGEST or not isinstance(value, tuple):
            return line
        items = "".join(f"    {self._value(where, item)},\n" for item in value)
        return f"{key} = [\n{items}]"

    def _inline(self, where: str, table: Mapping[str, Any]) -> str:
        pairs = (f"{_key(key)} = {self._value(where, value)}" for key, value in table.items())
        return f"{{ {', '.join(pairs)} }}" if table else "{}"

    def _value(self, where: str, value: Any) -> str:
        if isinstance(value, Path):
            return basic_string(literal(self._relative(value)), where)
        if isinstance(value, Mapping):
            return self._inline(where, value)
        if isinstance(value, tuple):
            return f"[{', '.join(self._value(where, item) for item in value)}]"
        return value_text(where, literal(value))


def is_list_of_tables(value: Any) -> bool:
    """Whether a system file writes the value as `[[NAME]]`."""
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(one, Mapping) for one in value)


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else basic_string(literal(name))


def literal(value: Any) -> Any:
    """The value as it is to be written: in a system file `${` begins a variable, and `$${` is a literal `${`."""
    if isinstance(value, str):
        return value.replace("${", "$${")
    if isinstance(value, tuple | list):
        return [literal(item) for item in value]
    if isinstance(value, Mapping):
        return {literal(key): literal(item) for key, item in value.items()}
    return value
