"""`include`: reads its entries, and makes the parts of an included file parts of the including one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import field
from typing import Any, Final

from aiorts.errors import InvalidNameError
from aiorts.late import dataclass
from aiorts.model.names import Path
from aiorts.spelling import suggestion
from aiorts.system.expansion.entries import Document, renamed
from aiorts.system.expansion.faults import Fault
from aiorts.system.text.origins import Origin

KEYS: Final = ("file", "prefix", "vars", "remap", "if", "repeat")
_FORM: Final = 'include = ["arm.toml"], or [[include]] with file = "arm.toml"'
_PREFIX: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]*")


@dataclass(frozen=True, slots=True)
class Inclusion:
    """One file to include, and the changes that the including file makes to it."""

    origin: Origin
    file: str
    prefix: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    remap: Mapping[str, tuple[str, Origin]] = field(default_factory=dict)
    """By replaced port: the new port, and the place of this replacement."""


def listed(given: Any, origin: Origin) -> list[tuple[Any, Origin]]:
    """The entries under `include`."""
    if isinstance(given, str | dict):
        return [(given, origin)]
    if not isinstance(given, list):
        raise Fault(origin, f"expected files, got {given!r:.80}; write {_FORM}")
    return [(one, origin.below(number)) for number, one in enumerate(given)]


def as_table(given: Any, origin: Origin) -> dict[str, Any]:
    """An entry in its long form."""
    if isinstance(given, str):
        return {"file": given}
    if not isinstance(given, dict):
        raise Fault(origin, f"expected a file, got {given!r:.80}; write {_FORM}")
    for word in given:
        if word not in KEYS:
            raise Fault(origin.below(word), f"unknown key {word[:80]!r}; {suggestion(word, KEYS)}", of_key=True)
    if "file" not in given:
        raise Fault(origin, 'file is missing; write file = "arm.toml"', of_key=True)
    return given


def inclusion(table: dict[str, Any], origin: Origin) -> Inclusion:
    """Read an entry of `include`; its variables are already filled in."""
    if not isinstance(table["file"], str) or not table["file"]:
        raise Fault(origin.below("file"), f"expected the name of a file, got {table['file']!r:.80}")
    prefix = table.get("prefix", "")
    if not isinstance(prefix, str) or (prefix and not _PREFIX.fullmatch(prefix)):
        what = 'what names may begin with, such as "left_" or "left-"'
        raise Fault(origin.below("prefix"), f"expected {what}, got {prefix!r:.80}")
    values = table.get("vars", {})
    if not isinstance(values, dict):
        raise Fault(origin.below("vars"), f"expected values by the file's variables, got {values!r:.80}")
    remap = table.get("remap", {})
    if not isinstance(remap, dict):
        raise Fault(origin.below("remap"), f'expected ports by port, such as {{"a.out" = "b.out"}}, got {remap!r:.80}')
    ports: dict[str, tuple[str, Origin]] = {}
    for word, given in remap.items():
        key = origin.below("remap", word)
        # Without quotes round the key, TOML reads a.out = "b.out" as a table `a` with a key `out`.
        inner = [(f"{word}.{port}", one, key.below(port)) for port, one in given.items()] if _is_table(given) else []
        for port, target, at in inner or [(word, given, key)]:
            _check_port(port, at, of_key=True)
            _check_port(target, at)
            ports[port] = target, at
    return Inclusion(origin, table["file"], prefix, values, ports)


def _is_table(value: Any) -> bool:
    return isinstance(value, dict)


def _check_port(text: Any, origin: Origin, *, of_key: bool = False) -> None:
    """Refuse a value that is no path of a port."""
    if (fault := port_fault(text)) != "":
        raise Fault(origin, fault, of_key=of_key)


def port_fault(text: Any) -> str:
    """The reason why a value is no path of a port; "" when it is one."""
    try:
        if isinstance(text, str) and (path := Path.parse(text)).port and not path.kernel:
            return ""
    except InvalidNameError as error:
        return str(error)
    return f"expected COMPONENT.PORT, got {text!r:.80}"


def included(document: Document, how: Inclusion) -> Document:
    """The parts of an included file for the including file: with ports replaced, and the prefix before names."""
    changed = [
        (entry, key, end)
        for entry in document.entries
        if entry.table == "connections"
        for key, end in entry.ends()
        if end in how.remap
    ]
    used = {end for _, _, end in changed}
    for port, (_, origin) in how.remap.items():
        if port not in used:
            raise Fault(origin, not_named(port, document, f"in {how.file}"), of_key=True)
    made = renamed(document, lambda name: how.prefix + name) if how.prefix else document
    for entry, key, end in changed:
        target, origin = how.remap[end]
        entry.set_end(key, target)
        entry.moved[key] = origin
    return made


def remapped(document: Document, port: str, target: str, where: str) -> str:
    """Replace a port in all connections; returns the reason if no connection has the port, else ""."""
    found = [
        (entry, key)
        for entry in document.entries
        if entry.table == "connections"
        for key, end in entry.ends()
        if end == port
    ]
    for entry, key in found:
        entry.set_end(key, target)
    return "" if found else not_named(port, document, where)


def not_named(port: str, document: Document, where: str) -> str:
    """The message that no connection has this port, and the port that may be meant."""
    ports = dict.fromkeys(end for one in document.entries if one.table == "connections" for _, end in one.ends())
    known = suggestion(port, ports)
    return f"no connection {where} has the port {port[:80]!r}; {known}"
