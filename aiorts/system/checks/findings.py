"""The findings of a check, as frozen values and as text; the checks themselves are in other modules."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from aiorts.late import dataclass
from aiorts.spelling import nearest
from aiorts.system.text.origins import Spot
from aiorts.system.text.places import Key

_MEANT: Final = re.compile(r"did you mean (?:'([^']+)'|([^\s'?;]+))\?")
_MISSING: Final = re.compile(r"expected (schema = \d+) in the first line")
_NUMBER: Final = re.compile(r"\d+")
SEVERITIES: Final = ("error", "warning", "note")


@dataclass(frozen=True, slots=True)
class Finding:
    """An error, warning or note about a system file.

    `line` and `column` count from 1, in characters; they are 0 for a finding about the file as a whole. `where` is
    the key, as in "contexts.loop.rate". `width` is the length of the place.
    """

    severity: str
    """"error": the system cannot run; "warning": it will hardly do what was intended; "note": good to know."""
    code: str
    path: Path
    line: int
    column: int
    width: int
    where: str
    cause: str
    remedy: str = ""
    quote: str = ""
    """The line of the file."""
    suggestion: str = ""
    """Text that mends the fault when it is put into the file."""
    copies: int = 0
    """The number of further copies of a repeated part with the same finding."""

    @property
    def place(self) -> str:
        """The place of the finding, such as "system.toml:7:3"."""
        return f"{self.path}:{self.line}:{self.column}" if self.line else str(self.path)

    @property
    def mended(self) -> str:
        """The corrected text of the place if the message suggests a name; else ""."""
        if found := _MISSING.search(self.message):
            return found[1]
        found = _MEANT.search(self.message)
        if found is None or not self.line:
            return ""
        old, meant = self.quote[self.column - 1 : self.column - 1 + self.width], found[1] or found[2]
        words = [*re.findall(r"[\w.:/-]+", old), *re.findall(r"\w+", old)]
        near = nearest(meant, words, cutoff=0.5)
        return old.replace(near, meant, 1) if near else ""

    @property
    def message(self) -> str:
        """Cause and remedy in one line."""
        cause = f"{self.cause} (and of {self.copies} more that are repeated)" if self.copies else self.cause
        return f"{cause}; {self.remedy}" if self.remedy else cause

    def plain(self) -> dict[str, Any]:
        """The finding as plain data for JSON."""
        words = ("line", "column", "width", "where", "cause", "remedy")
        head = {"severity": self.severity, "code": self.code, "file": str(self.path)}
        found = {word: getattr(self, word) for word in words}
        return head | found | {"suggestion": self.suggestion or self.mended, "copies": self.copies}


@dataclass(frozen=True, slots=True)
class Said:
    """A finding before its place is looked up. `text` is "cause; remedy"."""

    severity: str
    code: str
    key: Key
    text: str
    of_key: bool = False
    where: str = ""
    spot: Spot | None = None
    suggestion: str = ""


def _once(findings: Iterable[Finding]) -> list[Finding]:
    """The findings without repetitions: of the copies of a repeated part only the first, with the others' number."""
    alike: dict[tuple[object, ...], list[Finding]] = {}
    for one in dict.fromkeys(findings):
        said = _NUMBER.sub("#", one.where), _NUMBER.sub("#", one.cause)
        key = (one.path, one.line, one.column, one.code, *said) if one.line else (one,)
        alike.setdefault(key, []).append(one)
    found: list[Finding] = []
    for first, *others in alike.values():
        if len({one.where for one in (first, *others)}) <= len(others):
            found += [first, *others]  # one thing with several findings
        else:
            found.append(replace(first, copies=len(others)))
    return found


def in_order(findings: Iterable[Finding], files: Sequence[Path]) -> tuple[Finding, ...]:
    """The findings in the order of the files and places, at one place the worst first, without repetitions."""
    unique = _once(findings)
    order = {path: number for number, path in enumerate(files)}
    return tuple(
        sorted(unique, key=lambda one: (order.get(one.path, 0), one.line, one.column, SEVERITIES.index(one.severity)))
    )
