"""Makes the tables of one system of the collected parts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from aiorts.system.expansion.entries import NAMED, Document
from aiorts.system.expansion.faults import Fault
from aiorts.system.text.origins import Origin, Source
from aiorts.system.text.places import Key

PLUGINS: Final = "plugins"


def mixed(document: Document) -> Iterator[Fault]:
    """Faults for tables of a list, such as `[[rules]]`, if another file has no list under that name."""
    for entry in document.entries:
        value, origin = document.rest.get(entry.table, ([], entry.origin))
        if not isinstance(value, list):
            what = f"{origin.spot(of_key=True)} has {entry.table}, and no list; write all as [[{entry.table}]]"
            yield Fault(entry.origin, what, of_key=True)


def joined(document: Document, top: Mapping[str, Any], main: Source) -> tuple[dict[str, Any], dict[Key, Origin]]:
    """The tables of the system, and the places of keys that are in another file or have another name in their file."""
    whole: dict[str, Any] = {"schema": top.get("schema")}
    moved: dict[Key, Origin] = {}
    whole.update({word: value for word, (value, _) in document.rest.items()})
    moved.update({(word,): origin for word, (_, origin) in document.rest.items()})
    plugins = whole.get(PLUGINS)
    if plugins == {} and PLUGINS not in top:
        del whole[PLUGINS]
    if document.plugins and isinstance(plugins, dict):
        paths = plugins.get("path", ["."])
        if isinstance(paths, list):
            more = {path: origin for path, origin in document.plugins.items() if path not in paths}
            whole[PLUGINS] = {**plugins, "path": [*paths, *more]}
            moved.update({(PLUGINS, "path", len(paths) + at): origin for at, origin in enumerate(more.values())})
    for entry in document.entries:
        if entry.table not in NAMED:
            found = whole.setdefault(entry.table, [])
            base: Key = (entry.table, len(found))
            found.append(entry.value)
        else:
            whole.setdefault(entry.table, {})[entry.name] = entry.value
            base = (entry.table, entry.name)
        moved[base] = entry.origin
        moved.update({(*base, *key): origin for key, origin in entry.moved.items()})
    return whole, {key: origin for key, origin in moved.items() if origin.source is not main or origin.key != key}
