"""What commands show on standard output: text that commands no terminal, tables, strict JSON; it chooses no content."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

from aiorts.cli.quote import cells_of
from aiorts.cli.report import printed

__all__ = ("plain", "say", "say_json", "table")


def say(text: str) -> None:
    """Lines on standard output; what does not print, or what its encoding lacks, by number.

    Raises:
        OSError: standard output takes nothing any more.
    """
    stream = sys.stdout
    if stream is None:
        return
    encoding = getattr(stream, "encoding", None) or "utf-8"
    shown = "\n".join(printed(line) for line in text.split("\n"))
    stream.write(f"{shown}\n".encode(encoding, "backslashreplace").decode(encoding))


def say_json(value: Any) -> None:
    """One JSON document on standard output: strict, and of ASCII alone, so that it survives any encoding."""
    say(json.dumps(plain(value), indent=1, allow_nan=False))


def plain(value: Any) -> Any:
    """A value as JSON can carry it: numbers that are not finite by name, enumerations by theirs, all else as text."""
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, float):
        return value if math.isfinite(value) else {math.inf: "Infinity", -math.inf: "-Infinity"}.get(value, "NaN")
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else repr(value)


def table(rows: Iterable[Sequence[str]], *, indent: str = "  ") -> str:
    """Rows in columns; the last column is as wide as it is, and an empty column is left out."""
    cells = [[printed(cell) for cell in row] for row in rows]
    count = max((len(row) for row in cells), default=0)
    cells = [[*row, *[""] * (count - len(row))] for row in cells]
    kept = [column for column in range(count) if any(row[column] for row in cells)]
    widths = {column: max(cells_of(row[column]) for row in cells) for column in kept}
    lines = []
    for row in cells:
        padded = [row[column] + " " * (widths[column] - cells_of(row[column])) for column in kept]
        lines.append(f"{indent}{'  '.join(padded)}".rstrip())
    return "\n".join(lines)
