"""The options of tables that are read and written, their quoting, and times as exact decimal numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import ROUND_HALF_EVEN, Context, Decimal
from typing import Final, Literal, TypeAlias

from aiorts.errors import ConfigurationError, RecordError

TimeUnit: TypeAlias = Literal["s", "ms", "us", "ns"]
LOG_TIME: Final = "log_time"
PORT: Final = "port"
"""The column that names the port of a row, where a table has several."""
_DIGITS: Final[dict[TimeUnit, int]] = {"s": 9, "ms": 6, "us": 3, "ns": 0}
_DECIMAL: Final = re.compile(r"[+-]?(\d{1,25}(\.\d{0,40})?|\.\d{1,40})([eE][+-]?\d{1,2})?", re.ASCII)
_LATEST: Final = 2**63
# The default context has 28 digits; a time may have 25 before the point and 40 behind it.
_EXACT: Final = Context(prec=100)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOptions:
    """The options for reading or writing a table.

    Attributes:
        time: the column with the log time; unit: of its numbers.
        offset: seconds to add to it, as a decimal number.
        delimiter: between cells.
        header: whether the first row has the names of the columns; else they are 0, 1, 2, ...
        comment: a row whose first cell begins with it is left out; "" leaves none out.
        ports: name and type of each port of a table that is read.
        columns: field path by column, with the port's name in front where there are several: {"x": "data.x"}.
        values: constants for fields that have no column.
        empty_is_nan: read an empty cell as NaN in a column of floats.
        skip_bad: leave out a row that cannot be read, and go on.
        by_time: write samples of equal time into one row.

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


_RUNS: Final = re.compile(r"'*[=+\-@\x00-\x1f\x7f]")
"""The beginning of a text that spreadsheets run as a formula, or of a text that `defused` has changed."""


def defused(text: str) -> str:
    """The text for a cell: with an apostrophe in front where a spreadsheet would run it as a formula."""
    return f"'{text}" if _RUNS.match(text) else text


def original(cell: str) -> str:
    """The text that `defused` turned into this cell."""
    return cell[1:] if cell[:1] == "'" and _RUNS.match(cell, 1) else cell


def quoted(text: str, delimiter: str) -> str:
    """The cell as written: between quotes where it would be read as something else."""
    if text.isalnum() or not (_NEEDS.search(text) or delimiter in text or text.strip() != text):
        return text
    doubled = text.replace('"', '""')
    return f'"{doubled}"'


_NEEDS: Final = re.compile(r'["\r\n#]')


def time_of(text: str, unit: TimeUnit, offset: str = "0") -> int:
    """Nanoseconds of a decimal number; finer digits are rounded. RecordError: the text is no number, or no log time."""
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
