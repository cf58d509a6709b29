"""Rights of other kernels to read, write and call the ports of this one: a table decides, and nothing is looked up.

The table has a list of patterns for each right and name:

    write: {station: ["drive.velocity", "lamp.*"], "*": ["display.text"]}

A right that is not in the table is granted to every kernel. For one that is, the list of the kernel's name holds,
else the list of "*". The first pattern of the list that matches `component.port` decides; one that begins
with "!" denies. Where none matches, the port is denied.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any, Final

from aiorts.errors import ConfigurationError

READ: Final = "read"
WRITE: Final = "write"
CALL: Final = "call"
RIGHTS: Final = (READ, WRITE, CALL)
OTHERS: Final = "*"
"""The entry for all names that have no list of their own."""
_DENIES: Final = "!"
_PATTERN: Final = re.compile(r"!?[A-Za-z0-9_*-]+\.[A-Za-z0-9_*-]+")


class Allowed:
    """Rights of other kernels to the ports of this one; without a table every kernel has every right.

    Args:
        table: patterns by right and name, checked.
        where: the place of the table, for messages.
    """

    def __init__(self, table: Mapping[str, Mapping[str, tuple[str, ...]]] | None = None, where: str = "allow") -> None:
        self._table, self._where = table or {}, where

    @classmethod
    def of_table(cls, table: Any, where: str = "allow") -> Allowed:
        """Rights of a table: lists of patterns by name by right. ConfigurationError: `table` is no such table."""
        rights = _mapping("allow", table, "a table by right")
        if unknown := next((right for right in rights if right not in RIGHTS), None):
            raise ConfigurationError(f"allow: expected {', '.join(RIGHTS)}, got {unknown!r:.80}")
        made = {}
        for right, names in rights.items():
            lists = _mapping(f"allow: {right}", names, "a table of patterns by name")
            made[right] = {name: tuple(_patterns(f"allow: {right}.{name}", given)) for name, given in lists.items()}
        return cls(made, where)

    @property
    def names(self) -> frozenset[str]:
        """All names that have a list of their own."""
        return frozenset(name for lists in self._table.values() for name in lists) - {OTHERS}

    def refusal(self, name: str, right: str, port: str) -> str:
        """The reason why a name lacks this right to a port, `component.port`, with the rule; "": the name has it."""
        if (lists := self._table.get(right)) is None:
            return ""
        entry = name if name in lists else OTHERS
        rule = next((one for one in lists.get(entry, ()) if fnmatchcase(port, one.removeprefix(_DENIES))), None)
        if rule is not None and not rule.startswith(_DENIES):
            return ""
        if entry not in lists:
            why = f"has neither {name!r} nor {OTHERS!r}"
        else:
            why = f"{entry!r}: " + (f"{rule!r} denies it" if rule else "no pattern matches it")
        return f"{port}: {name!r} may not {right} it: {self._where} {right} {why}"


def _mapping(where: str, given: Any, expected: str) -> Mapping[str, Any]:
    if not (isinstance(given, Mapping) and all(isinstance(key, str) for key in given)):
        raise ConfigurationError(f"{where}: expected {expected}, got {given!r:.80}")
    return given


def _patterns(where: str, given: Any) -> Iterator[str]:
    """The patterns of a list, each of which can decide."""
    if not isinstance(given, (list, tuple)):
        raise ConfigurationError(f"{where}: expected a list of patterns, got {given!r:.80}")
    for number, one in enumerate(given):
        if not (isinstance(one, str) and _PATTERN.fullmatch(one)):
            raise ConfigurationError(f"{where}: expected COMPONENT.PORT, with * for any letters, got {one!r:.80}")
        bare = one.removeprefix(_DENIES)
        before = next((each for each in given[:number] if fnmatchcase(bare, each.removeprefix(_DENIES))), None)
        if before is not None:
            raise ConfigurationError(f"{where}: {one!r} is never looked at: {before!r} before it matches all of it")
        yield one
