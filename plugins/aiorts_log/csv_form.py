"""How tables are read and written: `TableOptions` that both share, quoting, and times as exact numbers. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import ROUND_HALF_EVEN, Context, Decimal
from typing import Final, Literal, TypeAlias

from aiorts.errors import ConfigurationError, RecordError

__all__ = ("LOG_TIME", "PORT", "TableOptions", "TimeUnit", "quoted", "time_cell", "time_of")

TimeUnit: TypeAlias = Literal["s", "ms", "us", "ns"]
LOG_TIME: Final = "log_time"
PORT: Final = "port"
"""The column that says which port a row is of, where a table has several."""
_DIGITS: Final[dict[TimeUnit, int]] = {"s": 9, "ms": 6, "us": 3, "ns": 0}
_DECIMAL: Final = re.compile(r"[+-]?(\d{1,25}(\.\d{0,40})?|\.\d{1,40})([eE][+-]?\d{1,2})?", re.ASCII)
_LATEST: Final = 2**63
_EXACT: Final = Context(prec=100)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOptions:
    """How a table is read or written.

    Attributes:
        time: the column with the log time; unit: of its numbers.
        offset: seconds to add to it, as a decimal number.
        delimiter: between cells.
        header: whether the first row names the columns; without, they are 0, 1, 2, ...
        comment: rows whose first cell begins with it are none; "" is none.
        ports: name and type of each port of a table that is read; a table written has those that it is given.
        columns: field path for a column, with the port's name in front where there are several: {"x": "data.x"}.
        values: constants for fields that have no column.
        empty_is_nan: an empty cell is a NaN where a float stands.
        skip_bad: go on behind a row that is none.
        by_time: write samples of one time into one row.

    Raises:
        ConfigurationError: a value makes no sense.
    """

    time: str = LOG_TIME
    unit: TimeUnit = "ns"
    offset: str = "0"
    delimiter: str = ","
    header: bool = True
    comment: str = "#"
    ports: tuple[tuple[str, type], ...] = ()
    columns: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, str] = field(default_factory=dict)
    empty_is_nan: bool = False
    skip_bad: bool = False
    by_time: bool = False

    def __post_init__(self) -> None:
        if len(self.delimiter) != 1 or self.delimiter in '"\r\n':
            raise ConfigurationError(f"delimiter: expected one character, or tab, got {self.delimiter!r}")
        if self.unit not in _DIGITS:
            raise ConfigurationError(f"time unit: expected {' | '.join(_DIGITS)}, got {self.unit!r}")
        if not _DECIMAL.fullmatch(self.offset):
            raise ConfigurationError(f"time offset: expected seconds, got {self.offset[:40]!r}")


def quoted(text: str, delimiter: str) -> str:
    """A cell as it stands in a table: between quotes where it would be read as something else."""
    if text.isalnum() or not (_NEEDS.search(text) or delimiter in text or text.strip() != text):
        return text
    doubled = text.replace('"', '""')
    return f'"{doubled}"'


_NEEDS: Final = re.compile(r'["\r\n#]')


def time_of(text: str, unit: TimeUnit, offset: str = "0") -> int:
    """Nanoseconds of a decimal number; what is finer is rounded. RecordError for what is none, or no log time."""
    text = text.strip()
    if not _DECIMAL.fullmatch(text):
        raise RecordError(f"expected a time in {unit}, got {text[:40]!r}" if text else f"expected a time in {unit}")
    scaled = Decimal(text).scaleb(_DIGITS[unit], _EXACT) + Decimal(offset).scaleb(9, _EXACT)
    ns = int(scaled.to_integral_value(ROUND_HALF_EVEN, _EXACT))
    if not 0 <= ns < _LATEST:
        raise RecordError(f"expected a time of 0 <= time < 2**63 ns, got {text[:40]} {unit}")
    return ns


def time_cell(ns: int, unit: TimeUnit) -> str:
    """A time as an exact decimal number."""
    digits = _DIGITS[unit]
    return f"{ns // 10**digits}.{ns % 10**digits:0{digits}d}" if digits else str(ns)
