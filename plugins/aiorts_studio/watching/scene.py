"""The scene of the page: frames, boxes and edges of all kernels, with places.

Pure: profiles and changes come in, messages to pages come out. Every thing has a number that stays while it is there,
and over a restart of its kernel.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from itertools import count
from typing import Any, Final, TypeAlias

from aiorts.errors import AbsentError
from aiorts.layout import Band, Edge, Key, Layout, Place, Places, Point, Route, Spot, meets
from aiorts_studio.watching.frames import Thing, frames_of
from aiorts_studio.watching.graph import FOLDED, IN_COMPOSITE, Graph, side_of
from aiorts_studio.watching.piles import placed
from aiorts_studio.watching.view import View
from aiorts_studio.watching.words import class_of, link_state, policy_of, said_of, state_of

Message: TypeAlias = dict[str, Any]

KINDS: Final = ("frames", "boxes", "edges")
_SPARE: Final = 1_000
"""Things that are gone whose numbers are kept all the same: they may come again."""


class Scene:
    """The things of all kernels that are watched.

    Attributes:
        views: the kernels by key.
        things: what pages show, by kind and number.
        connectors: by the key of a kernel, the number of the edge of each connector whose figures the edge has.
        wires: by the key of a kernel, the connectors of each edge by its number.
        folds: by the key of a kernel, the components of each folded box by its number.
        inside: by the key of a kernel, its connectors that are inside folded boxes.
        numbers: the number of each thing by key.
        laid_out: by the key of a kernel, its shape at the last full layout.
    """

    def __init__(self) -> None:
        self.views: dict[str, View] = {}
        self.things: dict[str, dict[int, Thing]] = {kind: {} for kind in KINDS}
        self.connectors: dict[str, dict[str, int]] = {}
        self.wires: dict[str, dict[int, list[str]]] = {}
        self.folds: dict[str, dict[int, list[str]]] = {}
        self.inside: dict[str, list[str]] = {}
        self.numbers: dict[Key, int] = {}
        self.laid_out: dict[str, tuple[int, tuple[str, ...]]] = {}
        self._next = count(1)
        self._graph = Graph({})
        self._layout = Layout()
        self._routes: dict[Key, Route] = {}
        self._told: list[Thing] = []
        self._folded: set[Key] = set()
        self._moved: dict[Key, Point] = {}
        """Places of boxes, set by hand or kept from an earlier show, counted from the corners of their bands."""
        self._by_hand: set[Key] = set()
        self._again = True
        """Whether all is to be placed again."""
        self._tidy = True
        """Whether kernels may move, too, when all is placed again."""

    def number(self, *key: str) -> int:
        """The number of a thing; the same for the same thing."""
        if key not in self.numbers:
            self.numbers[key] = next(self._next)
        return self.numbers[key]

    # -- what pages do with it -------------------------------------------------------------------------------------

    def tidy(self) -> None:
        """Place everything again when it is drawn next, also boxes that were given a place."""
        self._moved, self._by_hand = {}, set()
        self._again = self._tidy = True

    def lay_out(self) -> None:
        """Place everything again when it is drawn next: placed boxes keep their place, kernels their order."""
        self._again = True

    def move(self, number: int, x: float, y: float) -> str | None:
        """Put a box where there is room next to a place, when it is drawn next.

        Returns:
            The key of its kernel; None: there is no such box.
        """
        for key, spot in self._layout.spots.items():
            if self.numbers.get(key) == number:
                left, top = self._layout.corner(spot.band)
                self._moved[key] = x - left, y - top
                self._by_hand.add(key)
                return key[1]
        return None

    def restore(self, kernel: str, places: Places) -> None:
        """Give the boxes of a kernel that is not drawn yet the places that they had."""
        self._moved |= {("box", kernel, name): (one.x, one.y) for name, one in places.boxes.items()}
        self._by_hand |= {("box", kernel, name) for name in places.by_hand}

    def places(self, kernel: str) -> Places:
        """The places of a kernel's boxes; for a box in a folded frame, its future place."""
        components, layout = self.views[kernel].components, self._layout
        first = min((band.top for key, band in layout.bands.items() if key[1] == kernel), default=0.0)
        boxes = {key[2]: Place(*place, 0.0) for key, place in self._moved.items() if key[:2] == ("box", kernel)}
        for key, spot in layout.spots.items():
            if key[:2] == ("box", kernel):
                left, top = layout.corner(spot.band)
                boxes[key[2]] = Place(round(spot.x - left, 1), round(spot.y - top, 1), round(top - first, 1))
        by_hand = {key[2] for key in self._by_hand if key[:2] == ("box", kernel)}
        return Places({name: one for name, one in boxes.items() if name in components}, by_hand & components.keys())

    def fold(self, number: int, *, on: bool) -> None:
        """Fold a frame into one box, or unfold it, when the scene is drawn next."""
        for key, known in self.numbers.items():
            if known == number and key[0] == "frame":
                (self._folded.add if on else self._folded.discard)(key)
                self._again = True

    def check_port(self, kernel: str, path: str) -> None:
        """Check the path of a port; AbsentError: no kernel of this address has it."""
        component, _, port = path.partition(".")
        for view in self.views.values():
            if view.address == kernel and port in view.components.get(component, {}).get("ports", {}):
                return
        raise AbsentError(f"{kernel:.80}: has no port {path:.80}")

    # -- what pages are told ---------------------------------------------------------------------------------------

    def picture(self) -> Message:
        """The message with all things, for a new page."""
        made = {kind: list(self.things[kind].values()) for kind in KINDS}
        return {"t": "picture", "kernels": self.kernels(), **made, "missed": 0}

    def kernels(self) -> list[Thing]:
        """The kernels, as pages have them."""
        return [{**view.about, "address": view.address} for view in self.views.values()]

    async def draw(self) -> Message | None:
        """Bring the things up to date; the change to tell, or None where there is none.

        A new layout is made in a thread: 1,000 boxes take some tenths of a second.
        """
        graph = Graph(self.views, self._folded)
        tidy, again = self._tidy, self._again
        self._tidy = self._again = False
        if again or not self._adapt(graph):
            before = self._layout
            kept = {} if tidy else {group: before.pile_of(band) for band, group in before.groups.items()}
            self.laid_out = {key: view.shape for key, view in self.views.items()}
            spots, edges, moved = list(graph.spots.values()), list(graph.edges.values()), dict(self._moved)
            made = await asyncio.to_thread(_laid_out, spots, edges, graph.bands(), graph.units(), kept, moved)
            self._layout, self._routes = made
        self._graph = graph
        self.folds = {key: {} for key in self.views}
        for key, members in graph.folds.items():
            self.folds[key[1]][self.number(*key)] = members
        self.inside = graph.inside
        self.connectors = {key: {} for key in self.views}
        self.wires = {key: {} for key in self.views}
        for key, bundle in graph.bundles.items():
            writer = bundle[0][0]
            for view, name in bundle:
                if view is writer:  # the reader's end of a link counts the same samples again
                    number = self.number(*key)
                    self.connectors.setdefault(view.key, {})[name] = number
                    self.wires.setdefault(view.key, {}).setdefault(number, []).append(name)
        change = self._change()
        self._forget()
        return change

    def _forget(self) -> None:
        """Forget numbers, places and folds of things that are gone, when these outnumber the things that are there."""
        there = {number for things in self.things.values() for number in things}
        if len(self.numbers) > 2 * len(there) + _SPARE:
            folded = {key for key in self._folded if key[1] in self.views or self.numbers[key] in there}
            self.numbers = {key: one for key, one in self.numbers.items() if one in there or key in folded}
            self._folded = folded
            self._moved = {key: place for key, place in self._moved.items() if key in self.numbers}
            self._by_hand &= self._moved.keys()

    def _change(self) -> Message | None:
        message: Message = {"t": "change"}
        gone: dict[str, list[Any]] = {}
        boxes = self._boxes()
        frames = frames_of(self.views, self._layout, self._routes.values(), self.number, self._folded)
        for kind, things in {"frames": frames, "boxes": boxes, "edges": self._edges(boxes)}.items():
            before = self.things[kind]
            different = [one for number, one in things.items() if before.get(number) != one]
            if different:
                message[kind] = different
            if left := [number for number in before if number not in things]:
                gone[kind] = left
            self.things[kind] = things
        kernels, told = self.kernels(), {one["address"]: one for one in self._told}
        if changed := [one for one in kernels if told.get(one["address"]) != one]:
            message["kernels"] = changed
        there = {one["address"] for one in kernels}
        if ended := [address for address in told if address not in there]:
            gone["kernels"] = ended
        self._told = kernels
        if gone:
            message["gone"] = gone
        return message if len(message) > 1 else None

    def _adapt(self, graph: Graph) -> bool:
        """Put in new and changed boxes, and leave all others where they stand; False: a new layout is needed."""
        layout, again = self._layout, set[Key]()
        for key in [key for key in layout.spots if key not in graph.spots]:
            layout.remove(key)
        for key in [key for key in self._routes if key not in graph.edges]:
            layout.forget(key)
            del self._routes[key]
        groups = graph.bands()
        new = [spot for key, spot in graph.spots.items() if not _is_placed(layout.spots.get(key), spot)]
        if any(_comes_between(spot.band, layout.bands) for spot in new):
            return False
        for spot in new:
            before = [edge.source for edge in graph.edges.values() if edge.target == spot.key]
            after = [edge.target for edge in graph.edges.values() if edge.source == spot.key]
            if not layout.add(spot, groups[spot.band], before, after):
                return False
        wanted = _wanted(layout, self._moved)
        placed = {key: place for key, place in wanted.items() if place != layout.moved.get(key)}
        layout.move(placed)
        moved = {*(spot.key for spot in new), *placed}
        for edge in graph.edges.values():
            if edge.source in moved or edge.target in moved or edge.key not in self._routes:
                again.add(edge.key)
        for key in moved:
            again.update(one for one, route in self._routes.items() if meets(route, layout.spots[key]))
        for key in again:
            self._routes[key] = layout.route(graph.edges[key])
        return True

    # -- things as pages have them ---------------------------------------------------------------------------------

    def _boxes(self) -> dict[int, Thing]:
        made: dict[int, Thing] = {}
        for key, spot in self._layout.spots.items():
            view, number = self.views.get(key[1]), self.number(*key)
            if view is None or (key[0] == "box" and key[2] not in view.components):
                continue  # it has gone while this was laid out
            frame = ("frame", *(key if key[0] == FOLDED else spot.band)[1:])
            place = {
                "id": number, "kernel": view.address, "name": spot.title, "frame": self.number(*frame),
                "around": self.number("frame", *(key if key == (FOLDED, key[1]) else spot.band)[1:]),
                "x": round(spot.x, 1), "y": round(spot.y, 1), "w": round(spot.w, 1), "h": spot.h,
            }  # fmt: skip
            box = _box(view, key[2], spot) if key[0] == "box" else _other_box(spot, key[0])
            if key[0] == FOLDED:
                box["members"] = self._graph.folds[key]
            if len(key) == IN_COMPOSITE and (report := view.components.get(key[3])) is not None:
                box |= _condition(view, report)
            made[number] = {**place, **box}
        return made

    def _edges(self, boxes: Mapping[int, Thing]) -> dict[int, Thing]:
        made: dict[int, Thing] = {}
        for key, edge in self._graph.edges.items():
            bundle, route, number = self._graph.bundles[key], self._routes[key], self.number(*key)
            if not {self.number(*edge.source), self.number(*edge.target)} <= boxes.keys():
                continue
            view, name = bundle[0]
            report = view.connectors.get(name)
            is_link = report is not None and report["options"]["on_link_lost"] is not None
            links = [found for one, there in bundle if (found := one.service("links").get(there))]
            count = sum(one is view for one, _ in bundle)
            policy = "service" if report is None else policy_of(report["options"])
            made[number] = {
                "id": number, "kernel": view.address, "name": name,
                "from": [self.number(*edge.source), edge.out], "to": [self.number(*edge.target), edge.into],
                "points": [list(point) for point in route.points], "label": list(route.label),
                "policy": policy if count == 1 else f"{count} connectors",
                "state": link_state(links) if is_link else "up", "why": "; ".join(one for one in links if one != "up"),
                "link": is_link, "bundle": count,
            }  # fmt: skip
        return made


def _laid_out(
    spots: list[Spot],
    edges: list[Edge],
    bands: Mapping[Key, str],
    units: Mapping[str, str],
    kept: Mapping[str, int],
    moved: Mapping[Key, Point],
) -> tuple[Layout, dict[Key, Route]]:
    layout = placed(spots, edges, bands, units, kept)
    layout.move(_wanted(layout, moved))
    return layout, {edge.key: layout.route(edge) for edge in edges}


def _wanted(layout: Layout, moved: Mapping[Key, Point]) -> dict[Key, Point]:
    """The wanted places of those boxes that are there."""
    found: dict[Key, Point] = {}
    for key, (x, y) in moved.items():
        if (spot := layout.spots.get(key)) is not None:
            left, top = layout.corner(spot.band)
            found[key] = left + x, top + y
    return found


def _is_placed(old: Spot | None, new: Spot) -> bool:
    """Whether a box has a place that is good for its new version; its texts are brought up to date."""
    if old is None or (old.band, old.inputs, old.outputs) != (new.band, new.inputs, new.outputs):
        return False
    old.title, old.kind = new.title, new.kind
    return True


def _other_box(spot: Spot, kind: str) -> Thing:
    """A box that stands for others: a frame that is folded, or an end whose kernel is not watched."""
    sides = (("in", spot.inputs), ("out", spot.outputs))
    ports = [
        {"name": name, "side": side, "kind": "data", "type": "", "unit": "", "y": spot.port_y(name, out=side == "out")}
        for side, names in sides
        for name in names
    ]
    kind = "remote" if kind == "far" else kind
    about = {"type": spot.kind, "kind": kind, "state": "", "said": "", "error": None, "infrastructure": False}
    return {**about, "ports": ports}


def _box(view: View, name: str, spot: Spot) -> Thing:
    report = view.components[name]
    ports = [
        {
            "name": one["name"], "side": side_of(one), "kind": "service" if one["direction"] == "service" else "data",
            "type": one["type"], "unit": one["unit"] or "", "y": spot.port_y(one["name"], out=side_of(one) == "out"),
        }
        for one in report["ports"].values()
    ]  # fmt: skip
    about = {"type": class_of(report["type"]), "kind": "component", "infrastructure": view.is_infrastructure(name)}
    return {**about, **_condition(view, report), "ports": ports}


def _condition(view: View, report: Mapping[str, Any]) -> Thing:
    """The condition of a component; where it has not failed and its kernel does not answer, the kernel's state."""
    states, failed = report["states"], report["last_error"]
    error, known = view.failure_of(report), view.about["state"]
    if known != "live" and failed is None:
        return {"state": known, "said": "", "error": error}
    return {
        "state": state_of(states, failed=failed is not None),
        "said": said_of(states, report["overdue"]),
        "error": error,
    }


def _comes_between(band: Key, bands: Mapping[Key, Band]) -> bool:
    """Whether a new band comes between others: next to those of its context, or for a composite, not at the end."""
    return band not in bands and (len(band) == IN_COMPOSITE or any(one[:3] == band[:3] for one in bands))
