"""Mends the text of a system file where a finding of a check has one answer: `aiorts check --fix`.

Three findings have one answer: a misspelt name that is similar to a known one; a missing `schema`; and a member with a
process of its own in a shared context, which needs its own context. The rest of the text, its comments too, stays.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

from aiorts.model.configuration.toml_values import value_text
from aiorts.system.checks.findings import Finding
from aiorts.system.text.places import Place, places_of

Edit: TypeAlias = tuple[int, int, str]
"""A change of the text: begin and end of a part of it, and the new text for that part."""
_ROUNDS: Final = 10
"""The most rounds of mending: only once a type is mended, its misspelt ports are found, and so on."""
_AFTER: Final = re.compile(r"[ \t]*,[ \t]*")
_BEFORE: Final = re.compile(r",[ \t]*\Z")


def fixed(text: str, path: Path, check: Callable[[str], Sequence[Finding]]) -> tuple[str, tuple[Finding, ...]]:
    """The text with all faults mended that have one answer, and the findings about the mended text.

    A change that would lead to more errors than before is not made.

    Args:
        path: the file of the text; faults in files that it includes are left alone.
        check: returns the findings about a text.
    """
    found = tuple(check(text))
    for _ in range(_ROUNDS):
        wrong = [one for one in found if one.severity == "error" and one.path == path]
        for edits in (_respelt(wrong, text), _set_apart(wrong, text)):
            new = _edited(text, edits)
            if new == text or (_tables(new) is None and _tables(text) is not None):
                continue  # the one error of a text that is no TOML hides all others
            after = tuple(check(new))
            if _errors(after) <= _errors(found):
                text, found = new, after
                break
        else:
            break
    return text, found


def _errors(found: Iterable[Finding]) -> int:
    return sum(one.severity == "error" for one in found)


def _edited(text: str, edits: Iterable[Edit]) -> str:
    """The text with these changes; a change that overlaps another is left out."""
    end = len(text)
    for start, stop, new in sorted(set(edits), reverse=True):
        if stop <= end:
            text, end = text[:start] + new + text[stop:], start
    return text


def _respelt(wrong: Iterable[Finding], text: str) -> list[Edit]:
    """The changes that correct misspelt names."""
    edits: list[Edit] = []
    places = None if _tables(text) is None else places_of(text)
    for one in wrong:
        if one.mended.startswith("schema = "):
            if re.search(r"^[ \t]*schema\b", text, re.MULTILINE) is None:
                edits.append((0, 0, f"{one.mended}\n"))
        elif one.mended and places is not None:
            edits.append((*places.extent(Place(one.line, one.column, one.width)), one.mended))
    return edits


def _set_apart(wrong: Iterable[Finding], text: str) -> list[Edit]:
    """The changes that move a member with a process of its own from the first shared context to a new context."""
    tables = _tables(text)
    if tables is None:
        return []
    components, contexts = tables.get("components", {}), tables.get("contexts", {})
    places = places_of(text)
    for one in wrong:
        front, _, name = one.where.removesuffix(".members").partition(".")
        table: Any = contexts.get(name) if front == "contexts" else None
        table = table if isinstance(table, dict) else {}
        members = table.get("members", ())
        apart = [at for at, member in enumerate(members) if _is_isolated(components, member)]
        if not apart or len(members) < 2 or any(isinstance(value, dict) for value in table.values()):
            continue
        at = apart[-1]
        new_name = f"{name}_{members[at]}"
        heading = places.extent(places.value(("contexts", name)))[0]
        if new_name in contexts or not text[:heading].rpartition("\n")[2].lstrip().startswith("["):
            continue  # no table with a heading of its own
        lines = [f"[contexts.{new_name}]"]
        alone = {**table, "members": [members[at]]}
        lines += [f"{key} = {value_text(key, value)}" for key, value in alone.items()]
        end = max(places.end(("contexts", name, key)) for key in table)
        end = len(text) if (line := text.find("\n", end)) < 0 else line + 1
        return [
            _without(text, *places.extent(places.value(("contexts", name, "members", at)))),
            _added(text, end, lines),
        ]
    return []


def _is_isolated(components: Any, member: object) -> bool:
    table = components.get(member) if isinstance(member, str) else None
    return isinstance(table, dict) and table.get("isolation") == "process"


def _tables(text: str) -> dict[str, Any] | None:
    """The tables of the text; None for a text that is no TOML."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None


def _added(text: str, end: int, lines: Sequence[str]) -> Edit:
    return end, end, ("" if text[:end].endswith("\n") else "\n") + "\n" + "\n".join(lines) + "\n"


def _without(text: str, start: int, end: int) -> Edit:
    """The change that removes an element of a list, with its comma."""
    if (found := _AFTER.match(text, end)) is not None:
        return start, found.end(), ""
    if (before := _BEFORE.search(text, 0, start)) is not None:
        return before.start(), end, ""
    return start, end, ""
