"""What a check found, as frozen values and as text; it finds nothing itself."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from aiorts.system.places import Key, Place

__all__ = ("SEVERITIES", "Finding", "Said", "in_order")

SEVERITIES: Final = ("error", "warning", "note")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing to know about a system file before it runs.

    `line` and `column` count from 1, in characters; they are 0 where it is about the file as a whole. `where` is the
    key, as in "contexts.loop.rate". `width` is the length of the place that is meant.
    """

    severity: str
    """"error": it cannot run; "warning": it will hardly do what was meant; "note": good to know."""
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
    """Text for the file that would mend it."""

    @property
    def place(self) -> str:
        """Such as "system.toml:7:3"."""
        return f"{self.path}:{self.line}:{self.column}" if self.line else str(self.path)

    @property
    def message(self) -> str:
        """Cause and remedy in one line."""
        return f"{self.cause}; {self.remedy}" if self.remedy else self.cause

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "severity": self.severity,
            "code": self.code,
            "file": str(self.path),
            "line": self.line,
            "column": self.column,
            "width": self.width,
            "where": self.where,
            "cause": self.cause,
            "remedy": self.remedy,
            "suggestion": self.suggestion,
        }


@dataclass(frozen=True, slots=True)
class Said:
    """A finding before its place is looked up. `text` is "cause; remedy"."""

    severity: str
    code: str
    key: Key
    text: str
    of_key: bool = False
    where: str = ""
    place: Place | None = None
    suggestion: str = ""


def in_order(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """As they stand in the file; in one place the worse first, and each once."""
    unique = dict.fromkeys(findings)
    return tuple(sorted(unique, key=lambda one: (one.line, one.column, SEVERITIES.index(one.severity))))
