"""What names mean once all parts are known: names of the repeated stand for all of them, the absent are left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from aiorts.system.expansion.entries import COMPONENTS, Document, Entry, groups
from aiorts.system.expansion.faults import Fault
from aiorts.system.expansion.repeating import has_number
from aiorts.system.text.origins import Origin
from aiorts.system.text.places import Key


def resolve(document: Document) -> Iterator[Fault]:
    """Put names in the place of those that stand for several, and take those away that are absent."""
    there = {name for table, name in document.names if table in COMPONENTS}
    absent = {name: origin for name, origin in document.absent.items() if name not in there}
    document.absent = absent
    families = document.families
    if not absent and not families:
        return

    def names(name: str) -> list[str]:
        return families.get(name, [] if name in absent else [name])

    def condition(text: str) -> list[str]:
        name, space, state = text.strip().partition(" ")
        return [f"{one}{space}{state}" for one in names(name)]

    for entry in document.entries:
        if entry.table == "connections":
            yield from _ends(entry, families)
            continue
        _put(entry, ("members",), names)
        _put(entry, ("start", "after"), condition)
        value = entry.value
        start = value.get("start")
        if isinstance(start, dict) and isinstance(start.get("after"), str):
            found = condition(start["after"])
            value["start"] = {**start, "after": found[0] if len(found) == 1 else found}
        if "groups" in value:
            value["groups"] = groups(value["groups"], names)
        _leave_out_exported(entry, absent)


def refuse_absent(document: Document) -> Iterator[Fault]:
    """Faults for connections of those that are left out."""
    for entry in document.entries:
        if entry.table != "connections":
            continue
        for key, end in entry.ends():
            component = end.partition(".")[0]
            if component in document.absent:
                spot = document.absent[component].spot()
                what = f"{component} is left out by the if in {spot}; give the connection the same if"
                yield Fault(entry.at(key), what if len(key) == 1 else f"{what}, or a connection of its own")


def _put(entry: Entry, key: Key, names: Callable[[str], list[str]]) -> None:
    texts = entry.texts(*map(str, key))
    if texts is None:
        return
    items: list[tuple[Any, Origin]] = [
        (name, origin) for text, origin in texts for name in (names(text) if isinstance(text, str) else [text])
    ]
    if len(items) != len(texts) or any(one[0] is not other[0] for one, other in zip(items, texts, strict=True)):
        entry.put(key, items)


def _ends(entry: Entry, families: dict[str, list[str]]) -> Iterator[Fault]:
    """Several ports for one of something repeated; only a list of in-ports may have several."""
    texts = entry.texts("to")
    if texts is not None:

        def ports(text: str) -> list[str]:
            name, dot, port = text.partition(".")
            return [f"{one}{dot}{port}" for one in families[name]] if name in families else [text]

        _put(entry, ("to",), ports)
    for key, end in entry.ends():
        name = end.partition(".")[0]
        if name in families and has_number(name):
            what = f"{name} stands for {len(families[name])} components; write repeat in the connection"
            yield Fault(entry.at(key), what if key == ("from",) else f'{what}, or a list: to = ["{end}"]')


def _leave_out_exported(entry: Entry, absent: dict[str, Origin]) -> None:
    exported = entry.value.get("exported")
    if isinstance(exported, dict):
        entry.value["exported"] = {
            pattern: shown for pattern, shown in exported.items() if pattern.partition(".")[0] not in absent
        }
    elif isinstance(exported, list):
        _put(
            entry,
            ("exported",),
            lambda pattern: [] if pattern.partition(".")[0] in absent else [pattern],
        )
    elif isinstance(exported, str):
        parts = [one.strip() for one in exported.split(",")]
        entry.value["exported"] = ",".join(one for one in parts if one.partition(".")[0] not in absent)
