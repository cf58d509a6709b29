"""Draws fields of a recording into a PNG or SVG: over time, or one over the other as a path. Needs matplotlib.

The same recording gives the same bytes. Colours can be read on white and on black.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from aiorts.errors import ConfigurationError, MissingExtra
from aiorts_log.analysis.series import Series
from aiorts_log.analysis.thinning import thinned, thinned_path

_INK: Final = "#7d8793"
_COLOURS: Final = ("#2f81f7", "#e8730c", "#2da44e", "#cf3b9a", "#9a6fe0", "#d13438", "#0ea5a5", "#a8870b")
_PIECES: Final = 1600
"""Number of pieces of the time axis: twice as many as a curve has pixels."""
_CELLS: Final = 1200
_ROW: Final = 0.2
"""Inches of a row of a legend. Below: inches of the margin next to a diagram, and of a legend's line with its space."""
_MARGIN: Final = 0.8
_KEY: Final = 0.65
_TALL: Final = 1.8
"""The most inches of a name next to a diagram; a longer name stands above it."""
_RC: Final = {
    "svg.hashsalt": "aiorts",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.edgecolor": _INK,
    "axes.labelcolor": _INK,
    "axes.titlecolor": _INK,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.alpha": 0.3,
    "grid.color": _INK,
    "legend.frameon": False,
    "legend.labelcolor": _INK,
    "text.color": _INK,
    "text.parse_math": False,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "lines.linewidth": 1.3,
    "path.simplify": False,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """The properties of a picture: title, width and height in inches, dots per inch of a PNG."""

    title: str = ""
    width: float = 8.0
    height: float = 0.0
    dpi: int = 110


def check_picture(name: Path) -> str:
    """The type of a picture by its name: "png" or "svg".

    Raises:
        ConfigurationError: the name has another ending.
        MissingExtra: matplotlib is not installed.
    """
    file_type = name.suffix.lower().removeprefix(".")
    if file_type not in ("png", "svg"):
        raise ConfigurationError(f"-o: expected FILE.png or FILE.svg, got {name}")
    if find_spec("matplotlib") is None:
        raise MissingExtra(f"{name}: a picture", "matplotlib", "plot")
    return file_type


def draw_times(file: Path, file_type: str, groups: Sequence[Sequence[Series]], picture: Picture) -> None:
    """Draw curves over time; those of one unit, or of one field, share a diagram. OSError when writing fails."""
    diagrams: dict[tuple[str, int], list[Series]] = {}
    for number, group in enumerate(groups):
        for one in group:
            diagrams.setdefault((one.unit, 0 if one.unit else number), []).append(one)
    with _matplotlib() as figure_of:
        columns = [_columns(several, picture.width) for several in diagrams.values()]
        rows = sum(-(-len(several) // most) for several, most in zip(diagrams.values(), columns, strict=True))
        height = picture.height or 1.0 + 2.0 * len(diagrams) + _ROW * rows
        figure = figure_of(figsize=(picture.width, height), layout="constrained")
        axes = figure.subplots(len(diagrams), 1, sharex=True, squeeze=False)
        for ((unit, _), several), most, axis in zip(diagrams.items(), columns, axes[:, 0], strict=True):
            for number, one in enumerate(several):
                kept = thinned(one.times, one.values, _PIECES)
                xs, ys = [one.times[i] for i in kept], [one.values[i] for i in kept]
                colour = _COLOURS[number % len(_COLOURS)]
                axis.plot(xs, ys, color=colour, label=_cut(one.label, picture.width), **_marks(xs, ys))
            name = f"{several[0].label}{f' [{unit}]' if unit else ''}"
            if len(several) == 1 and _inches(name) <= _TALL:
                axis.set_ylabel(name)
            else:
                axis.set_ylabel(f"[{unit}]" if unit else "")
                axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=most, borderaxespad=0.0)
        axes[-1, 0].set_xlabel("time [s]")
        _save(figure, file, file_type, picture)


def _marks(xs: Sequence[float], ys: Sequence[float]) -> dict[str, Any]:
    """Options that mark the points which no line reaches: those between two gaps."""
    there = [False, *(math.isfinite(x) and math.isfinite(y) for x, y in zip(xs, ys, strict=True)), False]
    alone = [i - 1 for i in range(1, len(there) - 1) if there[i] and not there[i - 1] and not there[i + 1]]
    return {"marker": ".", "markevery": alone} if alone else {}


def _columns(several: Sequence[Series], width: float) -> int:
    """Columns of a legend that stay within a picture of that width."""
    return max(1, min(4, int((width - _MARGIN) / (max(_inches(one.label) for one in several) + _KEY))))


def _cut(label: str, width: float) -> str:
    """The label, or the end of it that a legend of one column has room for."""
    kept = label
    while len(kept) > 1 and _inches(kept) > width - _MARGIN - _KEY:
        kept = f"\N{HORIZONTAL ELLIPSIS}{kept[2:]}"
    return kept


def _inches(text: str) -> float:
    measure = import_module("matplotlib.textpath").text_to_path.get_text_width_height_descent
    font = import_module("matplotlib.font_manager").FontProperties(size=_RC["font.size"])
    return float(measure(text, font, False)[0]) / 72


def draw_path(file: Path, file_type: str, x: Series, y: Series, picture: Picture) -> None:
    """Draw a path in equal axes with its begin and end marked. OSError when writing fails."""
    xs, ys = _paired(x, y)
    kept = thinned_path(xs, ys, _CELLS)
    with _matplotlib() as figure_of:
        figure = figure_of(figsize=(picture.width, picture.height or picture.width), layout="constrained")
        axis = figure.subplots()
        path = [xs[i] for i in kept], [ys[i] for i in kept]
        axis.plot(*path, color=_COLOURS[0], **_marks(*path))
        if kept:
            for number, at, what in ((2, kept[0], "begin"), (1, kept[-1], "end")):
                axis.plot([xs[at]], [ys[at]], "o", color=_COLOURS[number], label=what)
            axis.legend(loc="best")
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel(f"{x.label}{f' [{x.unit}]' if x.unit else ''}")
        axis.set_ylabel(f"{y.label}{f' [{y.unit}]' if y.unit else ''}")
        _save(figure, file, file_type, picture)


def _paired(x: Series, y: Series) -> tuple[Sequence[float], Sequence[float]]:
    """The pairs of values to draw: x and y of one sample, or y with the newest x at its time."""
    if x.times == y.times:
        return x.values, y.values
    xs, ys = array("d"), array("d")
    for time, value in zip(y.times, y.values, strict=True):
        at = bisect_right(x.times, time)
        if at:
            xs.append(x.values[at - 1])
            ys.append(value)
    return xs, ys


class _matplotlib:  # noqa: N801
    """Gives matplotlib's Figure to a block, under settings that no file of the user can change."""

    def __enter__(self) -> Any:
        matplotlib: Any = import_module("matplotlib")
        self._context = matplotlib.rc_context()
        self._context.__enter__()
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_RC)
        return import_module("matplotlib.figure").Figure

    def __exit__(self, *error: Any) -> None:
        self._context.__exit__(*error)


def _save(figure: Any, file: Path, file_type: str, picture: Picture) -> None:
    if picture.title:
        figure.suptitle(picture.title)
    metadata = {"Date": None, "Creator": "aiorts"} if file_type == "svg" else {"Software": "aiorts"}
    figure.savefig(file, format=file_type, dpi=picture.dpi, transparent=True, metadata=metadata)
