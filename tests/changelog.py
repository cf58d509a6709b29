"""Sort the entries of the newest version in CHANGELOG.md by kind, breaking first. Run: python tests/changelog.py

Changes are written at the end, one entry each, and sorted when a version is made. Within a kind their order stays, and
an entry that stands twice, as a merge may leave it, stands once afterwards.
"""

from __future__ import annotations

import re
from pathlib import Path

CHANGELOG = Path(__file__).parents[1] / "CHANGELOG.md"
KINDS = ("added", "changed", "fixed", "removed")
"""What an entry may begin with, in the order in which they stand."""
_ENTRY = re.compile(r"^- .*(?:\n  .*)*\n?", re.MULTILINE)
_BREAKING = re.compile(r"\*\*breaking\b", re.IGNORECASE)


def split(text: str) -> tuple[str, list[str], str]:
    """The text before the entries of the newest version, the entries, and the older versions."""
    found = re.search(r"^## .*\n\n(?=- )", text, re.MULTILINE)
    assert found, "no heading of a version with entries below it"
    body, older, rest = text[found.end() :].partition("\n## ")
    return text[: found.end()], [entry.rstrip("\n") for entry in _ENTRY.findall(body)], older + rest


def kind(entry: str) -> str:
    """What an entry begins with."""
    return entry[2:].partition(":")[0]


def rank(entry: str) -> int:
    """Where an entry stands: breaking first."""
    return -1 if _BREAKING.search(entry) else KINDS.index(kind(entry))


def in_order(text: str) -> str:
    """The whole text with the entries of its newest version sorted."""
    before, entries, older = split(text)
    lines = "".join(f"{entry}\n" for entry in sorted(dict.fromkeys(entries), key=rank))
    return before + lines + older


if __name__ == "__main__":
    CHANGELOG.write_text(in_order(CHANGELOG.read_text(encoding="utf-8")), encoding="utf-8")
