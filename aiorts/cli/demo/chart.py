"""A strip chart of ASCII characters: one line for each moment, time goes down."""

from __future__ import annotations

from aiorts.late import dataclass

_NARROWEST = 10


@dataclass(frozen=True, slots=True)
class Strip:
    """A chart from 0 to `most`, `width` columns wide: `*` is the value, `:` the target, `#` both."""

    most: float
    width: int

    def line(self, value: float, wanted: float) -> str:
        """One line of the chart, without its end."""
        width = max(self.width, _NARROWEST)
        cells = [" "] * width
        cells[self._column(wanted, width)] = ":"
        at = self._column(value, width)
        cells[at] = "*" if cells[at] == " " else "#"
        return "".join(cells).rstrip()

    def _column(self, value: float, width: int) -> int:
        return min(width - 1, max(0, round(value / self.most * (width - 1))))
