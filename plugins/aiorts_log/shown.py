"""How the commands of recordings read and show things: times, sizes, and names without what commands a terminal."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import click

from aiorts.errors import ConfigurationError
from aiorts_log.survey import Gap

__all__ = ("FILE", "SHOWN", "Finite", "date", "gap_lines", "moment", "number", "shown", "size", "strict")

FILE: Final = click.Path(path_type=Path)
SHOWN: Final = 10
"""How many of many things are shown."""
_SECONDS: Final = re.compile(r"\+?\d{1,12}(\.\d{1,9})?", re.ASCII)


class Finite(click.FloatRange):
    """A number that is not negative, and is one."""

    def __init__(self, least: float = 0.0, most: float | None = None) -> None:
        super().__init__(least, most)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number; a comparison with NaN is never true, so that no range refuses it."""
        found = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"{found!r} is no finite number", param, ctx)
        return found


def moment(option: str, text: str | None, start: int) -> int | None:
    """A time of the command line in ns."""
    if text is None:
        return None
    if not _SECONDS.fullmatch(text):
        raise ConfigurationError(f"{option}: expected +SECONDS or seconds since 1970, got {text[:40]!r}").at(text, 0)
    whole, _, rest = text.removeprefix("+").partition(".")
    ns = int(whole) * 10**9 + int(rest.ljust(9, "0") or "0")
    return start + ns if text.startswith("+") else ns


def strict(plain: Any) -> Any:
    """JSON made by others may hold numbers that are not finite, which are no JSON."""
    if isinstance(plain, float) and not math.isfinite(plain):
        return str(plain)
    if isinstance(plain, dict):
        return {str(key): strict(value) for key, value in plain.items()}
    return [strict(value) for value in plain] if isinstance(plain, list) else plain


def shown(text: object) -> str:
    """Text of a file without anything that commands a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text)[:300])


def number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def size(octets: int) -> str:
    return f"{octets} octets" if octets < 10_000 else f"{octets / 1e6:.2f} MB"


def date(ns: int) -> str:
    try:
        moment = datetime.fromtimestamp(ns // 10**9, UTC)
    except (OverflowError, ValueError, OSError):
        return f"{ns} ns"
    return f"{moment:%Y-%m-%d %H:%M:%S}.{ns % 10**9 // 10**6:03d} UTC"


def gap_lines(gaps: tuple[Gap, ...]) -> list[str]:
    lines = [f"{gap.length} octets from octet {gap.offset}: {shown(gap.why)}" for gap in gaps[:SHOWN]]
    return [*lines, *([f"and {len(gaps) - SHOWN} more places"] if len(gaps) > SHOWN else [])]
