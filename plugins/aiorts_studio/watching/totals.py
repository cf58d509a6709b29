"""A kernel as a whole, whatever pages have folded: its sums, and the parts that need a look.

Pure: a view and its figures come in, rows for pages come out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, TypeAlias

from aiorts_studio.watching.figures import Figures, Row, lost
from aiorts_studio.watching.view import View

Place: TypeAlias = int | None
"""The number of the box or edge that stands for a thing; None: there is none."""
_MOST: Final = 30
"""Failed components, and connectors that lose samples, that are named."""
_WORST_FIRST: Final = ("error", "ended", "created", "inactive", "active")


def total_of(view: View, figures: Figures, connectors: Mapping[str, Place], boxes: Mapping[str, Place]) -> Row:
    """Components, connectors, samples a second, lost samples; then failed components, and connectors that lose samples.

    Args:
        view: the kernel.
        figures: its counters.
        connectors: the numbers of edges by connector; None of one that is inside a folded frame.
        boxes: the numbers of boxes by component.
    """
    reports = view.components
    found = [
        [name, said, boxes.get(name)]
        for name in figures.now["components"]
        if (said := _trouble(reports.get(name), figures.box(name)))
    ]
    losing = [(figures.lost(name), name) for name in connectors.keys() & figures.lossy]
    losing.sort(key=lambda one: (-one[0], one[1]))
    dropped = sum(count for count, _ in losing)
    lossy = [_loss(view, figures, name, connectors[name], boxes) for _, name in losing[:_MOST]]
    return [len(view.components), len(connectors), figures.rate(connectors), dropped, found[:_MOST], lossy]


def _trouble(report: Mapping[str, Any] | None, row: Row | None) -> str:
    """Words for the trouble of a component; "" is none."""
    state, said = row or ("", "")
    failed = (report or {}).get("last_error")
    return said or (str(failed or state) if state == "error" or failed else "")


def _loss(view: View, figures: Figures, name: str, edge: Place, boxes: Mapping[str, Place]) -> list[Any]:
    """The ends of a connector, the samples that it has lost, why, and the kind and number of its thing on the page."""
    report = view.connectors.get(name) or {"source": name, "target": ""}
    reasons = [reason for reason, count in figures.now["connectors"][name].dropped.items() if lost({reason: count})]
    where = ["box", boxes.get(report["source"].partition(".")[0])] if edge is None else ["edge", edge]
    return [report["source"], report["target"], figures.lost(name), reasons, *where]


def folded_row(figures: Figures, components: Iterable[str], connectors: Iterable[str]) -> Row:
    """The worst state of the components inside a folded frame, and words on them.

    Args:
        figures: the counters of their kernel.
        components: the components in the frame.
        connectors: the connectors that have an end, or both, inside.
    """
    states = [str(row[0]) for name in components if (row := figures.box(name)) is not None]
    failed, lossy = states.count("error"), len(figures.lossy.intersection(connectors))
    said = [f"{failed} failed"] * (failed > 0) + [f"{lossy} lose{'s' * (lossy == 1)} samples"] * (lossy > 0)
    return [next((one for one in _WORST_FIRST if one in states), ""), ", ".join(said)]
