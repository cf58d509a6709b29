"""The parts of a system during expansion: each with its values, and its place in a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import field
from typing import Any, Final

from aiorts.late import dataclass
from aiorts.system.text.origins import Origin
from aiorts.system.text.places import Key

NAMED: Final = ("components", "composites", "contexts")
"""Tables whose entries have names."""
TABLES: Final = (*NAMED, "connections")
COMPONENTS: Final = ("components", "composites")
"""Tables whose entries are named in connections and in lists of members."""


@dataclass(slots=True)
class Entry:
    """A component, composite, context or connection; or a table in the list of a service, such as `[[rules]]`."""

    table: str
    name: str
    """The name of the entry; "" for an entry of a list, which has none."""
    value: dict[str, Any]
    origin: Origin
    moved: dict[Key, Origin] = field(default_factory=dict)
    """The places of those keys of the entry that are not below `origin`, or have another name there."""

    def at(self, key: Key) -> Origin:
        """The place of a key of the entry."""
        for length in range(len(key), 0, -1):
            if (found := self.moved.get(key[:length])) is not None:
                return found.below(*key[length:])
        return self.origin.below(*key)

    def put(self, key: Key, items: list[tuple[Any, Origin]]) -> None:
        """Replace the list at `key`; each element comes with its place."""
        holder: Any = self.value
        for part in key[:-1]:
            holder = holder[part]
        holder[key[-1]] = [item for item, _ in items]
        self.moved.update({(*key, number): origin for number, (_, origin) in enumerate(items)})

    def texts(self, *key: str) -> list[tuple[Any, Origin]] | None:
        """The elements of the list at a key, each with its place; None if there is no list."""
        value: Any = self.value
        for part in key:
            value = value.get(part) if isinstance(value, dict) else None
        if not isinstance(value, list):
            return None
        return [(item, self.at((*key, number))) for number, item in enumerate(value)]

    def ends(self) -> Iterator[tuple[Key, str]]:
        """The ports of a connection, each with its key."""
        for word in ("from", "to"):
            given = self.value.get(word)
            if isinstance(given, str):
                yield (word,), given
            elif isinstance(given, list):
                yield from (((word, number), one) for number, one in enumerate(given) if isinstance(one, str))

    def set_end(self, key: Key, text: str) -> None:
        """Replace the port at a key."""
        if len(key) == 1:
            self.value[str(key[0])] = text
        else:
            given = list(self.value[str(key[0])])
            given[int(key[1])] = text
            self.value[str(key[0])] = given


@dataclass(slots=True)
class Document:
    """The parts of a file and of all files that it includes, by the names that they have in that file."""

    entries: list[Entry] = field(default_factory=list)
    names: dict[tuple[str, str], Origin] = field(default_factory=dict)
    """The places of the entries, by table and name."""
    absent: dict[str, Origin] = field(default_factory=dict)
    """The components and composites that a condition leaves out, and the place of that condition."""
    families: dict[str, list[str]] = field(default_factory=dict)
    """The names of the copies of each repeated part, by the part's name in the file."""
    rest: dict[str, tuple[Any, Origin]] = field(default_factory=dict)
    """All other tables."""
    plugins: dict[str, Origin] = field(default_factory=dict)
    """Folders with plugins, relative to the folder of the named file."""


def renamed(document: Document, rename: Callable[[str], str]) -> Document:
    """The document with other names for its components, composites, contexts and connections."""
    for entry in document.entries:
        _rename(entry, rename)
    return Document(
        document.entries,
        {(table, rename(name)): origin for (table, name), origin in document.names.items()},
        {rename(name): origin for name, origin in document.absent.items()},
        {rename(name): [rename(one) for one in names] for name, names in document.families.items()},
        document.rest,
        document.plugins,
    )


def _rename(entry: Entry, rename: Callable[[str], str]) -> None:
    value = entry.value
    if entry.table not in NAMED:
        for key, end in list(entry.ends()):
            entry.set_end(key, rename(end))
        if entry.table == "connections" and isinstance(value.get("name"), str) and value["name"]:
            value["name"] = rename(value["name"])
        return
    entry.name = rename(entry.name)
    if isinstance(value.get("members"), list):
        value["members"] = [rename(one) if isinstance(one, str) else one for one in value["members"]]
    if entry.table == "components":
        start = value.get("start")
        if isinstance(start, dict) and "after" in start:
            value["start"] = {**start, "after": _each(start["after"], rename)}
    if entry.table == "composites":
        if "groups" in value:
            value["groups"] = groups(value["groups"], lambda name: [rename(name)])
        if isinstance(value.get("exported"), dict):
            names = {pattern: rename(pattern) for pattern in value["exported"]}
            value["exported"] = {names[pattern]: shown for pattern, shown in value["exported"].items()}
            for pattern, name in names.items():
                entry.moved[("exported", name)] = entry.at(("exported", pattern))
        elif "exported" in value:
            given = value["exported"]
            given = [one.strip() for one in given.split(",")] if isinstance(given, str) else given
            value["exported"] = _each(given, rename)


def _each(given: Any, rename: Callable[[str], str]) -> Any:
    if isinstance(given, str):
        return rename(given.lstrip())
    return (
        [rename(one.lstrip()) if isinstance(one, str) else one for one in given] if isinstance(given, list) else given
    )


def groups(given: Any, names: Callable[[str], list[str]]) -> Any:
    """Groups of a composite, as "a,b|c" or lists, with each name replaced by the names that `names` returns for it."""
    if isinstance(given, str):
        lists: Any = [[name.strip() for name in part.split(",") if name.strip()] for part in given.split("|")]
        made = [[new for name in part for new in names(name)] for part in lists]
        return "|".join(",".join(part) for part in made if part)
    if not isinstance(given, list) or not all(isinstance(part, list) for part in given):
        return given
    made = [[new for name in part for new in (names(name) if isinstance(name, str) else [name])] for part in given]
    return [part for part, old in zip(made, given, strict=True) if part or not old]
