"""Resolves names once all parts are known: a repeated part's name stands for its copies, absent names are left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from aiorts.system.expansion.entries import COMPONENTS, NAMED, Document, Entry, groups
from aiorts.system.expansion.faults import Budget, Fault
from aiorts.system.expansion.repeating import has_number, name_of
from aiorts.system.text.origins import Origin
from aiorts.system.text.places import Key


def resolve(document: Document, budget: Budget) -> Iterator[Fault]:
    """Replace the name of each repeated part by those of its copies, and remove absent names from lists."""
    there = {name for table, name in document.names if table in COMPONENTS}
    document.absent = {name: origin for name, origin in document.absent.items() if name not in there}
    if document.absent or document.families:
        for entry in document.entries:
            yield from _Names(document, budget, entry).resolved()


def refuse_absent(document: Document) -> Iterator[Fault]:
    """Faults for connections of components that are left out."""
    for entry in document.entries:
        if entry.table != "connections":
            continue
        for key, end in entry.ends():
            component = end.partition(".")[0]
            if component in document.absent:
                spot = document.absent[component].spot()
                what = f"{component} is left out by the if in {spot}; give the connection the same if"
                yield Fault(entry.at(key), what if len(key) == 1 else f"{what}, or a connection of its own")


class _Names:
    """Resolves the names in one entry."""

    def __init__(self, document: Document, budget: Budget, entry: Entry) -> None:
        self._families, self._absent = document.families, document.absent
        self._budget, self._entry = budget, entry

    def resolved(self) -> Iterator[Fault]:
        """Change the entry; yields its faults."""
        if self._entry.table not in NAMED:
            if self._entry.table != "connections":
                return
            self._put(("to",), self._ports)
            yield from self._ends()
            return
        self._put(("members",), self._names)
        self._put(("start", "after"), self._conditions)
        value = self._entry.value
        start = value.get("start")
        if isinstance(start, dict) and isinstance(start.get("after"), str):
            found = self._conditions(start["after"])
            value["start"] = {**start, "after": found[0] if len(found) == 1 else found}
        if "groups" in value:
            value["groups"] = groups(value["groups"], self._names)
        if "exported" in value:
            self._exported(value["exported"])

    def _names(self, name: str) -> list[str]:
        if name not in self._families:
            return [] if name in self._absent else [name]
        found = self._families[name]
        self._budget.spend(sum(map(len, found)) + len(found), self._entry.origin)
        return found

    def _conditions(self, text: str) -> list[str]:
        name, space, state = text.strip().partition(" ")
        return [f"{one}{space}{state}" for one in self._names(name)]

    def _ports(self, text: str) -> list[str]:
        """The ports that a port in a connection stands for; components that are left out stay, to be refused later."""
        name, dot, port = text.partition(".")
        return [f"{one}{dot}{port}" for one in self._names(name)] if name in self._families else [text]

    def _patterns(self, text: str) -> list[str]:
        name, dot, port = text.strip().partition(".")
        return [f"{one}{dot}{port}" for one in self._names(name)]

    def _put(self, key: Key, names: Callable[[str], list[str]]) -> None:
        texts = self._entry.texts(*map(str, key))
        if texts is None:
            return
        items: list[tuple[Any, Origin]] = [
            (name, origin) for text, origin in texts for name in (names(text) if isinstance(text, str) else [text])
        ]
        if [item for item, _ in items] != [text for text, _ in texts]:
            self._entry.put(key, items)

    def _ends(self) -> Iterator[Fault]:
        """Faults for ports that stand for several but are not in a list of in-ports."""
        for key, end in self._entry.ends():
            name = end.partition(".")[0]
            if name in self._families and has_number(name):
                what = f"{name} stands for {len(self._families[name])} components; write repeat in the connection"
                yield Fault(self._entry.at(key), what if key == ("from",) else f'{what}, or a list: to = ["{end}"]')

    def _exported(self, exported: Any) -> None:
        """Export the ports of a repeated part by one pattern for each copy, under a name with the copy's number."""
        if isinstance(exported, list):
            self._put(("exported",), self._patterns)
        elif isinstance(exported, str):
            parts = [one for part in exported.split(",") for one in self._patterns(part)]
            self._entry.value["exported"] = ",".join(parts)
        elif isinstance(exported, dict):
            made = {}
            for pattern, shown in exported.items():
                origin = self._entry.at(("exported", pattern))
                for number, one in enumerate(self._patterns(pattern)):
                    made[one] = name_of(shown, number) if one != pattern and isinstance(shown, str) else shown
                    if one != pattern:
                        self._entry.moved[("exported", one)] = origin
            self._entry.value["exported"] = made
