"""What is to be drawn of all kernels: boxes and edges, as the profiles say, still without places."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from aiorts_studio.watching.layout import Edge, Key, Spot
from aiorts_studio.watching.view import View
from aiorts_studio.watching.words import class_of

FOLDED = "folded"


class Graph:
    """The boxes and edges of all kernels at one moment.

    Args:
        views: the kernels by key.
        folded: frames of which one box stands for all that is in them: ("frame", kernel) or ("frame", kernel, context).

    Attributes:
        spots: the boxes by key: ("box", kernel, component), ("far", kernel, path) of an end whose
            kernel is not watched, ("folded", kernel, context) of a frame that is folded.
        edges: the edges by key.
        bundles: of each edge, the connectors that it stands for: the view of the writer's end, and the name; a link
            that both ends list has the reader's, too.
    """

    def __init__(self, views: Mapping[str, View], folded: Collection[Key] = ()) -> None:
        self._views, self._folded = views, folded
        self.spots: dict[Key, Spot] = {}
        self.edges: dict[Key, Edge] = {}
        self.bundles: dict[Key, list[tuple[View, str]]] = {}
        for view in views.values():
            for name, report in view.components.items():
                spot = self._spot(view, name, report)
                self.spots[spot.key] = spot
        for view in views.values():
            for name, report in view.connectors.items():
                self._add(view, name, report["source"], report["target"])
            for name, report in (view.profile.get("service_connectors") or {}).items():
                if (ends := self._service_ends(view, report["ports"])) is not None:
                    self._add(view, name, *ends)

    def bands(self) -> dict[Key, str]:
        """The key of the kernel of each band, kernel by kernel, and contexts in the order of their kernel."""
        used = {spot.band for spot in self.spots.values()}
        return {
            band: view.key
            for view in self._views.values()
            for context in (*view.contexts, "")
            if (band := ("band", view.key, context)) in used
        }

    # -- boxes -----------------------------------------------------------------------------------------------------

    def _spot(self, view: View, name: str, report: Mapping[str, Any]) -> Spot:
        context = next(iter(report["states"]), "")
        band = ("band", view.key, context)
        frame = self._fold_of(view.key, context)
        if frame is not None:
            key = (FOLDED, *frame[1:])
            known = self.spots.get(key)
            count = 1 if known is None else int(known.kind.partition(" ")[0]) + 1
            title = view.about["name"] if len(frame) == 2 else context or "in no context"
            kind = f"{count} component{'s' * (count > 1)}"
            return Spot(key, band if known is None else known.band, ("in",), ("out",), title, kind)
        ports = report["ports"].values()
        inputs = tuple(one["name"] for one in ports if side_of(one) == "in")
        outputs = tuple(one["name"] for one in ports if side_of(one) == "out")
        return Spot(("box", view.key, name), band, inputs, outputs, name, class_of(report["type"]))

    def _fold_of(self, kernel: str, context: str) -> Key | None:
        for frame in (("frame", kernel), ("frame", kernel, context)):
            if frame in self._folded:
                return frame
        return None

    def _stub(self, key: Key, view: View, port: str, *, out: bool) -> None:
        """Put in the box of a far end whose kernel is not watched, or one port more of it."""
        known = self.spots.get(key)
        inputs, outputs = ((), ()) if known is None else (known.inputs, known.outputs)
        if port not in (outputs if out else inputs):
            inputs, outputs = (inputs, (*outputs, port)) if out else ((*inputs, port), outputs)
        context = next((spot.band[2] for spot in self.spots.values() if spot.band[1] == view.key), "")
        self.spots[key] = Spot(key, ("band", view.key, context), inputs, outputs, key[2], "elsewhere")

    # -- edges -----------------------------------------------------------------------------------------------------

    def _add(self, view: View, name: str, source: str, target: str) -> None:
        (first, out), (last, into) = self._end(view, source), self._end(view, target)
        for key, port, leaves in ((first, out, True), (last, into, False)):
            if key[0] == "far":
                self._stub(key, view, port, out=leaves)
            elif key not in self.spots:
                return  # its component is just coming, or going
        if FOLDED in (first[0], last[0]):
            if first == last:
                return
            key = ("edge", *first, out, *last, into)
        elif first[1] == last[1]:
            key = ("edge", view.key, name)
        else:
            key = ("edge", *first[1:], out, *last[1:], into)  # both ends list it
        self.edges[key] = Edge(key, first, out, last, into)
        bundle = self.bundles.setdefault(key, [])
        bundle.insert(0 if first[1] == view.key else len(bundle), (view, name))

    def _end(self, view: View, path: str) -> tuple[Key, str]:
        """The box and the port of an end of a connector, perhaps of another kernel."""
        far, _, near = path.rpartition("/")
        name, _, port = near.rpartition(".")
        kernel: View | None = view
        if far:
            wanted = (far, f"{view.address.partition('/')[0]}/{far}")
            kernel = next(
                (one for one in self._views.values() if one.address in wanted and name in one.components), None
            )
        if kernel is None:
            return ("far", view.key, f"{far}/{name}"), port
        report = kernel.components.get(name)
        frame = None if report is None else self._fold_of(kernel.key, next(iter(report["states"]), ""))
        if frame is None:
            return ("box", kernel.key, name), port
        return (FOLDED, *frame[1:]), "out" if report is not None and _leaves(report, port) else "in"

    def _service_ends(self, view: View, paths: Iterable[str]) -> tuple[str, str] | None:
        """The paths of two service ports, the one that provides first."""
        found = []
        for path in paths:
            key, port = self._end(view, path)
            spot = self.spots.get(key)
            found.append((spot is None or port not in spot.outputs, path))
        if len(found) != 2:
            return None
        (_, source), (_, target) = sorted(found, key=lambda one: one[0])
        return source, target


def _leaves(report: Mapping[str, Any], port: str) -> bool:
    found = report["ports"].get(port)
    return found is not None and side_of(found) == "out"


def side_of(port: Mapping[str, Any]) -> str:
    """At which side of its box a port stands: what provides a service stands at the right."""
    if port["direction"] != "service":
        return str(port["direction"])
    return "out" if any(one["polarity"] == "provided" for one in port["interfaces"]) else "in"
