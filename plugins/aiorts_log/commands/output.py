"""Shared by the commands of recordings: option types, and output of times, sizes and names."""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import click

from aiorts_log.commands.moment import moment_ns
from aiorts_log.mcap.reader import Recording, unclosed_text
from aiorts_log.mcap.source import Limits
from aiorts_log.mcap.survey import Gap

FILE: Final = click.Path(path_type=Path)
MOST_LINES: Final = 10
"""The most lines of a list that are printed; a number stands for the others."""
UNLIMITED: Final = click.option(
    "--unlimited",
    "limits",
    is_flag=True,
    callback=lambda _context, _option, given: Limits.unlimited() if given else Limits(),
    help="Read a small file that holds very much, too.",
)
"""The option whose value is the `limits` for `open_recording`."""


class Finite(click.FloatRange):
    """A finite number that is not negative."""

    def __init__(self, least: float = 0.0, most: float | None = None) -> None:
        super().__init__(least, most)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Refuse numbers that are not finite, too: no range refuses NaN, since comparisons with it are false."""
        found = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"{found!r} is no finite number", param, ctx)
        return found


def moment(option: str, text: str | None, start: int) -> int | None:
    """A time of the command line in ns; None when it was not given."""
    return None if text is None else moment_ns(option, text, start)


def strict(plain: Any) -> Any:
    """Plain data with numbers that are not finite as texts, since JSON has none."""
    if isinstance(plain, float) and not math.isfinite(plain):
        return str(plain)
    if isinstance(plain, dict):
        return {str(key): strict(value) for key, value in plain.items()}
    return [strict(value) for value in plain] if isinstance(plain, list) else plain


def safe(text: object) -> str:
    """A text of a file with control characters escaped, so that it cannot command a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text)[:300])


def number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def size(count: int) -> str:
    return f"{count} bytes" if count < 10_000 else f"{count / 1e6:.2f} MB"


def date(ns: int) -> str:
    try:
        moment = datetime.fromtimestamp(ns // 10**9, UTC)
    except (OverflowError, ValueError, OSError):
        return f"{ns} ns"
    return f"{moment:%Y-%m-%d %H:%M:%S}.{ns % 10**9 // 10**6:03d} UTC"


def span(reader: Recording) -> str:
    """The period in which a recording has samples, in words."""
    if not reader.count:
        return "the recording has none"
    seconds = (reader.end - reader.start) / 1e9
    return f"the recording is from {date(reader.start)} to {date(reader.end)}, which is +{seconds:.3f}"


def say_unclosed(unclosed: Iterable[tuple[str, int]]) -> bool:
    """Name on standard error the recordings that were not closed; returns whether bytes of one cannot be read.

    Args:
        unclosed: path and unusable bytes of each such recording.
    """
    torn = False
    for path, length in unclosed:
        click.echo(f"  {safe(path)} {unclosed_text(length)}", err=True)
        torn = torn or length > 0
    return torn


def gap_lines(gaps: tuple[Gap, ...]) -> list[str]:
    lines = [f"{gap.length} bytes from byte {gap.offset}: {safe(gap.why)}" for gap in gaps[:MOST_LINES]]
    return [*lines, *([f"and {len(gaps) - MOST_LINES} more places"] if len(gaps) > MOST_LINES else [])]
