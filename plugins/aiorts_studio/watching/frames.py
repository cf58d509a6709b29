"""The frames around boxes: hosts, kernels, contexts, isolated processes and composites."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, Final, TypeAlias

from aiorts.layout import BAND_FOOT, BAND_HEAD, GROUP_HEAD, LEFT, Band, Key, Layout, Route
from aiorts_studio.watching.graph import ELSEWHERE, FOLDED, HOST, IN_COMPOSITE
from aiorts_studio.watching.view import View
from aiorts_studio.watching.words import composite_said, context_said

Thing: TypeAlias = dict[str, Any]

_PAD: Final = 16.0
"""The distance between the frame of a kernel and those of its contexts."""
_INSET: Final = 8.0
"""The distance between the frame of a context and those of its composites."""
_BEND: Final = 20.0
"""The distance between a bend of an edge and the frame of its context."""


def frames_of(
    views: Mapping[str, View],
    layout: Layout,
    routes: Collection[Route],
    number: Callable[..., int],
    folded: Collection[Key],
) -> dict[int, Thing]:
    """The frames of all kernels, by number.

    The frames of a pile are as wide as the boxes and edges that reach farthest; a folded frame is as large as its box
    needs.

    Args:
        number: the number of a thing, by the words of its key.
        folded: the keys of the folded frames.
    """
    return _Frames(layout, routes, number, folded).made(views)


class _Frames:
    def __init__(
        self, layout: Layout, routes: Collection[Route], number: Callable[..., int], folded: Collection[Key]
    ) -> None:
        self._layout, self._number, self._folded = layout, number, folded
        self._bends = [x for route in routes for x, _ in route.points]
        self._used = {spot.band[:3] for spot in layout.spots.values()}
        self._reaches: dict[int, tuple[float, float]] = {}

    def _reach(self, band: Key) -> tuple[float, float]:
        """The left end and the width of the frames of contexts in the pile of a band."""
        pile = self._layout.pile_of(band)
        if pile not in self._reaches:
            low, high = self._layout.room_of(pile)
            spots = [one for one in self._layout.spots.values() if self._layout.pile_of(one.band) == pile]
            bends = [x for x in self._bends if low < x < high]
            left = min((*(one.x - LEFT for one in spots), *(x - _BEND for x in bends)), default=0.0)
            right = max((*(one.x + one.w + LEFT for one in spots), *(x + _BEND for x in bends)), default=left)
            self._reaches[pile] = left, right - left
        return self._reaches[pile]

    def made(self, views: Mapping[str, View]) -> dict[int, Thing]:
        made: dict[int, Thing] = {}
        layout = self._layout
        for view in views.values():
            bands = {key: band for key, band in layout.bands.items() if layout.groups.get(key) == view.key}
            if not bands:
                continue
            key: Key = ("frame", view.key)
            number, extent = self._number(*key), _extent(bands.values())
            height = GROUP_HEAD + extent.height + _PAD
            left, width = self._reach(next(iter(bands)))
            place = {"x": left - _PAD, "y": extent.top - GROUP_HEAD, "w": width + 2 * _PAD, "h": height}
            near = self._near_box(key)
            said = f"process {view.about['pid']} on {view.about['host']}"
            said += " · simulated time" if view.about["simulated"] else ""
            host = (HOST, view.about["host"])
            parent = self._number("frame", *host) if host in layout.bands else None
            made[number] = self._frame(key, "kernel", view, view.about["name"], said, near or place, parent)
            for band in bands if near is None else ():
                if band[2] == "" and band[:3] not in self._used:
                    continue  # all that was in no context is in one now
                made |= self._inner_frame(view, band, bands, number)
        return made | self._host_frames(made)

    def _inner_frame(self, view: View, band: Key, bands: Mapping[Key, Band], parent: int) -> dict[int, Thing]:
        """The frame of a context, or of a composite in one."""
        key, context = ("frame", *band[1:]), band[2]
        left, width = self._reach(band)
        if len(band) == IN_COMPOSITE:
            extent, report = bands[band], view.components.get(band[3])
            place = {
                "x": left + _INSET,
                "y": extent.top,
                "w": width - 2 * _INSET,
                "h": extent.height - _INSET,
            }
            said = "" if report is None else composite_said(report)
            frame = self._frame(key, "composite", view, band[3], said, place, self._number(*key[:3]))
        else:
            extent = _extent(one for there, one in bands.items() if there[:3] == band)
            report = view.contexts.get(context)
            apart = view.processes_of(() if report is None else report["members"])
            said = "other kernels" if context == ELSEWHERE else context_said(report)
            said += "".join(f" · process {pid}" for pid in apart)
            place = {"x": left, "y": extent.top, "w": width, "h": extent.height}
            kind = "process" if apart else "context"
            place = self._near_box(key) or place
            frame = self._frame(key, kind, view, context.strip() or "in no context", said, place, parent)
        return {frame["id"]: frame}

    def _near_box(self, key: Key) -> Thing | None:
        """The place of a folded frame: around the box that stands for its content; None: it is not folded."""
        box = self._layout.spots.get((FOLDED, *key[1:]))
        if box is None:
            return None
        place = {"x": box.x - LEFT, "y": box.y - BAND_HEAD, "w": box.w + 2 * LEFT, "h": box.h + BAND_HEAD + BAND_FOOT}
        return {side: round(value, 1) for side, value in place.items()}

    def _host_frames(self, kernels: Mapping[int, Thing]) -> dict[int, Thing]:
        """A frame around the kernels of each host, where there are several hosts."""
        made: dict[int, Thing] = {}
        for key in [key for key in self._layout.bands if key[0] == HOST]:
            number, top = self._number("frame", *key), self._layout.bands[key].top
            if inner := [one for one in kernels.values() if one["parent"] == number]:
                bottom = max(one["y"] + one["h"] for one in inner)
                left, width = self._reach(key)
                place = {"x": left - 2 * _PAD, "y": top, "w": width + 4 * _PAD, "h": bottom - top + _PAD}
                said = f"{len(inner)} kernel{'s' * (len(inner) > 1)}"
                about = {"id": number, "kind": HOST, "kernel": inner[0]["kernel"], "name": key[1], "said": said}
                made[number] = {**about, **place, "parent": None, "folded": False}
        return made

    def _frame(self, key: Key, kind: str, view: View, name: str, said: str, place: Thing, parent: int | None) -> Thing:
        about = {"id": self._number(*key), "kind": kind, "kernel": view.address, "name": name, "said": said}
        return {**about, **place, "parent": parent, "folded": key in self._folded}


def _extent(bands: Iterable[Band]) -> Band:
    """The band from the top of the first of some bands to the foot of the last."""
    found = list(bands)
    return Band(found[0].top, found[-1].top + found[-1].height - found[0].top)
