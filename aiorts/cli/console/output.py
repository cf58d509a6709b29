"""Printing to standard output: text without control characters, tables, strict JSON."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from typing import Any

from aiorts.cli.console.quote import cells_of
from aiorts.cli.console.report import printed


def say(text: str) -> None:
    """Print lines; unprintable characters, and those that the encoding lacks, as numbers.

    Raises:
        OSError: standard output cannot be written any more.
    """
    stream = sys.stdout
    if stream is None:
        return
    encoding = getattr(stream, "encoding", None) or "utf-8"
    shown = "\n".join(printed(line) for line in text.split("\n"))
    stream.write(f"{shown}\n".encode(encoding, "backslashreplace").decode(encoding))


def say_now(text: str) -> None:
    """Print lines and flush them, so that a reader gets them at once."""
    say(text)
    if sys.stdout is not None:
        sys.stdout.flush()


def say_json(value: Any) -> None:
    """Print one JSON document: strict, and in ASCII, so that it survives any encoding."""
    from json import dumps

    say(dumps(plain(value), indent=1, allow_nan=False))


def say_either(value: Any, text: Callable[[], str], *, as_json: bool) -> None:
    """Print a value as a JSON document, or its text for people."""
    if as_json:
        say_json(value)
    else:
        say(text())


def say_line(value: Any) -> None:
    """Print one JSON document of many, in one line and at once."""
    from json import dumps

    say_now(dumps(plain(value), allow_nan=False))


def plain(value: Any) -> Any:
    """A value that JSON can carry: enums and numbers that are not finite by name, all other types as text."""
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
    return str(value) if isinstance(value, os.PathLike) else repr(value)


def counted(count: int, what: str) -> str:
    """A count with its noun, in the plural unless it is 1."""
    return f"{count} {what}{'s' * (count != 1)}"


def table(rows: Iterable[Sequence[str]], *, indent: str = "  ") -> str:
    """Format rows in columns; empty columns are left out, and the last one is not padded."""
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
