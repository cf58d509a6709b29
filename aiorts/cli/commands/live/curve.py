"""A curve of the latest numbers in a terminal, drawn again as numbers come."""

from __future__ import annotations

import math
import shutil
import time
from collections import deque
from typing import Final, TextIO

_HEIGHT: Final = 16
_EVERY: Final = 0.1
"""Seconds between two drawings."""
_LABEL: Final = 12
_LEAST: Final = 20
_HOME: Final = "\x1b[{rows}A\r"
_CLEAR: Final = "\x1b[K"


class Curve:
    """A curve of the added numbers: on a terminal it is redrawn in place, elsewhere drawn once at the end."""

    def __init__(self, title: str, stream: TextIO | None) -> None:
        self._title = title
        self._stream = stream
        self._live = stream is not None and stream.isatty()
        self._points: deque[tuple[float, float]] = deque(maxlen=4096)
        self._missed = 0
        self._drawn_at = 0.0
        self._rows = 0

    def add(self, seconds: float, value: float, missed: int) -> None:
        """Add a number with the time in seconds at which it was sent, and the number of missed samples so far."""
        if math.isfinite(value):
            self._points.append((seconds, value))
        self._missed = missed
        if self._live and time.monotonic() - self._drawn_at >= _EVERY:
            self._draw()

    def end(self) -> None:
        """Draw the curve for the last time."""
        self._draw()

    def _draw(self) -> None:
        self._drawn_at = time.monotonic()
        if self._stream is None:
            return
        width = max(_LEAST, min(shutil.get_terminal_size().columns, 160) - _LABEL - 2)
        lines = drawn(self._title, list(self._points), width, _HEIGHT, self._missed)
        if self._live:
            home = _HOME.format(rows=self._rows) if self._rows else ""
            self._stream.write(home + "".join(f"{line}{_CLEAR}\n" for line in lines))
            self._rows = len(lines)
        else:
            self._stream.write("".join(f"{line}\n" for line in lines))
        self._stream.flush()


def drawn(title: str, points: list[tuple[float, float]], width: int, height: int, missed: int) -> list[str]:
    """The lines of a drawing: the title, `height` rows with a scale on the left, and the seconds below."""
    head = f"{title}: {points[-1][1]:.6g}" if points else f"{title}: nothing yet"
    if missed:
        head += f"   ({missed} dropped)"
    if not points:
        return [head]
    end = points[-1][0]
    begin = points[0][0]
    low, high = min(value for _, value in points), max(value for _, value in points)
    if low == high:
        low, high = low - 1.0, high + 1.0
    span = max(end - begin, 1e-9)
    grid = [[" "] * width for _ in range(height)]
    for seconds, value in points:
        column = min(width - 1, int((seconds - begin) / span * (width - 1)))
        row = min(height - 1, int((high - value) / (high - low) * (height - 1) + 0.5))
        grid[row][column] = "*"
    labels = {0: high, height // 2: low + (high - low) * (1 - (height // 2) / (height - 1)), height - 1: low}
    lines = [head]
    for number, cells in enumerate(grid):
        label = f"{labels[number]:.5g}" if number in labels else ""
        lines.append(f"{label:>{_LABEL - 1}} |{''.join(cells).rstrip()}")
    lines.append(f"{'':>{_LABEL - 1}} +{'-' * (width - 1)}")
    lines.append(f"{'':>{_LABEL}} last {end - begin:.3g} s")
    return lines
