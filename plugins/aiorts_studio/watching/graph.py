"""Boxes and edges of all kernels, as their profiles say, still without places."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

from aiorts.layout import Edge, Key, Spot
from aiorts_studio.watching.view import View
from aiorts_studio.watching.words import class_of

FOLDED = "folded"
HOST = "host"
ELSEWHERE = " elsewhere"
"""A word for a context, in the keys of the band and the frame of far ends; no context has a space in its name."""
IN_COMPOSITE = 4
"""The number of words in the key of a composite's band or frame."""


class Graph:
    """The boxes and edges of all kernels at one moment.

    Args:
        views: the kernels by key.
        folded: frames with one box that stands for all their content: ("frame", kernel), ("frame", kernel, context)
            or ("frame", kernel, context, composite).

    Attributes:
        spots: the boxes by key: ("box", kernel, component), ("far", kernel, path) of an end whose
            kernel is not watched, ("folded", kernel, context) of a frame that is folded. The band of a box is
            ("band", kernel, context), or ("band", kernel, context, composite) of a composite's member.
        edges: the edges by key.
        folds: the components that each folded box stands for.
        inside: the connectors inside folded boxes, by the key of their kernel.
        bundles: the connectors that each edge stands for: the view of the writer's end, and the name; a link
            that both ends list has the reader's, too.
    """

    def __init__(self, views: Mapping[str, View], folded: Collection[Key] = ()) -> None:
        self._views, self._folded = views, folded
        self.spots: dict[Key, Spot] = {}
        self.edges: dict[Key, Edge] = {}
        self.folds: dict[Key, list[str]] = {}
        self.inside: dict[str, list[str]] = {}
        self.bundles: dict[Key, list[tuple[View, str]]] = {}
        self._members = {view.key: view.members() for view in views.values()}
        for view in views.values():
            shown_as_frames = {*self._members[view.key].values(), *view.inner_composites()}
            for name, report in view.components.items():
                if name not in shown_as_frames:
                    spot = self._spot(view, name, report)
                    self.spots[spot.key] = spot
        for view in views.values():
            for name, report in view.connectors.items():
                self._add(view, name, report["source"], report["target"])
            for name, report in (view.profile.get("service_connectors") or {}).items():
                if (ends := self._service_ends(view, report["ports"])) is not None:
                    self._add(view, name, *ends)

    def bands(self) -> dict[Key, str]:
        """The group of each band: kernel by kernel, contexts in the order of their kernel, then their composites.

        Kernels of several hosts stand host by host; each host begins with an empty band of its own, which its title
        takes.
        """
        used = dict.fromkeys(spot.band for spot in self.spots.values())
        by_host: dict[str, list[View]] = {}
        for view in self._views.values():
            by_host.setdefault(view.about["host"], []).append(view)
        found: dict[Key, str] = {}
        for host, views in by_host.items():
            if len(by_host) > 1:
                found[HOST, host] = f"{HOST} {host}"
            for view in views:
                for context in (*view.contexts, "", ELSEWHERE):
                    own: Key = ("band", view.key, context)
                    bands = [band for band in used if band[:3] == own]
                    if bands:
                        found |= dict.fromkeys((own, *sorted(bands)), view.key)
        return found

    def units(self) -> dict[str, str]:
        """The pile of each group of bands: one for the kernels of a host, where there are several hosts."""
        hosts = {view.key: view.about["host"] for view in self._views.values()}
        if len({*hosts.values()}) < 2:
            return {key: key for key in hosts}
        return hosts | {f"{HOST} {host}": host for host in hosts.values()}

    # -- boxes -----------------------------------------------------------------------------------------------------

    def _band(self, view: View, name: str) -> Key:
        """The band that a component stands in while nothing is folded."""
        context = view.context_of(name)
        composite = self._members[view.key].get(name)
        return ("band", view.key, context) if composite is None else ("band", view.key, context, composite)

    def _spot(self, view: View, name: str, report: Mapping[str, Any]) -> Spot:
        band = self._band(view, name)
        frame = self._fold_of(band)
        if frame is None:
            return Spot(("box", view.key, name), band, *_ports(report), name, class_of(report["type"]))
        key = (FOLDED, *frame[1:])
        self.folds.setdefault(key, []).append(name)
        known = self.spots.get(key)
        count = 1 if known is None else int(known.kind.partition(" ")[0]) + 1
        kind = f"{count} component{'s' * (count > 1)}"
        if known is not None:
            return replace(known, kind=kind)
        is_composite = len(frame) == IN_COMPOSITE
        title = frame[-1] or "in no context" if len(frame) > len(("frame", view.key)) else view.about["name"]
        ports = _ports(view.components[frame[-1]]) if is_composite else (("in",), ("out",))
        return Spot(key, band[:3] if is_composite else band, *ports, title, kind)

    def _fold_of(self, band: Key) -> Key | None:
        """The outermost frame that is folded of those around a band."""
        if not self._folded:
            return None
        frames = (("frame", *band[1:end]) for end in range(2, len(band) + 1))
        return next((frame for frame in frames if frame in self._folded), None)

    def _grow(self, key: Key, view: View, port: str, *, out: bool) -> None:
        """Add a port to a box, or the box of a far end whose kernel is not watched."""
        known = self.spots.get(key)
        if known is None:
            known = Spot(key, ("band", view.key, ELSEWHERE), (), (), key[2], "not watched")
        inputs, outputs = known.inputs, known.outputs
        if port not in (outputs if out else inputs):
            inputs, outputs = (inputs, (*outputs, port)) if out else ((*inputs, port), outputs)
        self.spots[key] = replace(known, inputs=inputs, outputs=outputs)

    # -- edges -----------------------------------------------------------------------------------------------------

    def _add(self, view: View, name: str, source: str, target: str) -> None:
        (first, out), (last, into) = self._end(view, source), self._end(view, target)
        if first == last and first[0] == FOLDED:
            self.inside.setdefault(view.key, []).append(name)
            return
        for key, port, leaves in ((first, out, True), (last, into, False)):
            if key[0] == "far" or (key[0] == FOLDED and key in self.spots):
                self._grow(key, view, port, out=leaves)
            elif key not in self.spots:
                return  # its component is just coming, or going
        if FOLDED in (first[0], last[0]):
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
            host = view.address.partition("/")[0]
            there = [one for one in self._views.values() if one.is_called(far, host) and name in one.components]
            there.sort(key=lambda one: one.address.partition("/")[0] != host)  # of one name the one on this host
            kernel = next(iter(there), None)
        if kernel is None:
            return ("far", view.key, f"{far}/{name}"), port
        name, port = kernel.member_port(name, port)
        report = kernel.components.get(name)
        frame = None if report is None else self._fold_of(self._band(kernel, name))
        if frame is None or report is None:
            return ("box", kernel.key, name), port
        if len(frame) == IN_COMPOSITE:
            path = f"{name}.{port}"
            shown = kernel.exported(frame[-1]).get(path, path)
        else:
            shown = "out" if _leaves(report, port) else "in"
        return (FOLDED, *frame[1:]), shown

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


def _ports(report: Mapping[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of the ports at the left, and of those at the right."""
    ports = report["ports"].values()
    left, right = (tuple(one["name"] for one in ports if side_of(one) == side) for side in ("in", "out"))
    return left, right


def _leaves(report: Mapping[str, Any], port: str) -> bool:
    found = report["ports"].get(port)
    return found is not None and side_of(found) == "out"


def side_of(port: Mapping[str, Any]) -> str:
    """The side of its box at which a port stands; a provided service stands at the right."""
    if port["direction"] != "service":
        return str(port["direction"])
    return "out" if any(one["polarity"] == "provided" for one in port["interfaces"]) else "in"
