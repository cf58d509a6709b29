"""The scene of the page: frames, boxes and edges of all kernels, as their profiles say, with places.

Pure: profiles and changes come in, messages to pages come out. Every thing has a number that stays while it is there,
and over a restart of its kernel.
"""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Final, TypeAlias

from aiorts.model.lifecycle import state_text
from aiorts.sessions import Entry
from aiorts_studio.watching.layout import Edge, Key, Layout, Route, Spot, meets

Message: TypeAlias = dict[str, Any]
Thing: TypeAlias = dict[str, Any]
KINDS: Final = ("frames", "boxes", "edges")
_PLACE: Final = re.compile(r"\(([^()\s]+\.py):(\d+)\)")
_INFRASTRUCTURE: Final = frozenset(("FlexiDump", "FlexiLogger", "FlexiConst"))
"""Classes of components that look on, or feed a system by hand."""


@dataclass(slots=True)
class View:
    """A kernel as the scene has it.

    Attributes:
        key: the name by which it is known again after a restart.
        address: the address of the process that runs, or ran last.
        profile: the parts of its profile, as `changes` tells them.
        lasting: its name that stays over restarts; "" is not known.
        changes: how often its profile has changed.
        settled: whether it was laid out after it was whole.
        answered: when it answered last, by the monotonic clock.
        about: what the page says of it: "name", "state", "why", and others.
    """

    key: str
    address: str
    about: dict[str, Any]
    profile: dict[str, Any] = field(default_factory=dict)
    lasting: str = ""
    changes: int = 0
    settled: bool = False
    answered: float = field(default_factory=time.monotonic)

    def say(self, state: str, why: str) -> bool:
        """Take whether it answers; False: that was known."""
        if (state, why) == (self.about["state"], self.about["why"]):
            return False
        since = 0.0 if state == "live" else round(time.monotonic() - self.answered, 1)
        self.about.update(state=state, why=why, since_s=since)
        return True

    @property
    def components(self) -> Mapping[str, Any]:
        """Its components by name, as reports."""
        return self.profile.get("components") or {}

    @property
    def connectors(self) -> Mapping[str, Any]:
        """Its connectors by name, as reports."""
        return self.profile.get("connectors") or {}

    @property
    def contexts(self) -> Mapping[str, Any]:
        """Its contexts by name, as reports."""
        return self.profile.get("contexts") or {}

    def service(self, name: str) -> Mapping[str, Any]:
        """What a service attached to the kernel says of itself."""
        found = (self.profile.get("services") or {}).get(name)
        return found if isinstance(found, dict) else {}


def about(entry: Entry) -> dict[str, Any]:
    """What the page says of a kernel before it has answered."""
    host, _, name = entry.address.partition("/")
    return {
        "name": name, "host": host, "pid": entry.pid, "state": "silent", "why": "has not answered yet", "since_s": 0.0,
        "simulated": False, "round_trip_ms": None,
    }  # fmt: skip


class Scene:
    """The things of all kernels that are watched."""

    def __init__(self) -> None:
        self.views: dict[str, View] = {}
        self.things: dict[str, dict[int, Thing]] = {kind: {} for kind in KINDS}
        self.connectors: dict[tuple[str, str], int] = {}
        """The number of the edge by the kernel's key and the connector's name."""
        self.numbers: dict[Key, int] = {}
        self._next = count(1)
        self._layout = Layout()
        self._routes: dict[Key, Route] = {}
        self._told: list[Thing] = []
        self._tidy = True

    def number(self, *key: str) -> int:
        """The number of a thing; the same for the same thing."""
        if key not in self.numbers:
            self.numbers[key] = next(self._next)
        return self.numbers[key]

    def tidy(self) -> None:
        """Place all anew when it is drawn next."""
        self._tidy = True

    # -- what the page is told ------------------------------------------------------------------------------------

    def picture(self) -> Message:
        """All things, for a page that comes."""
        made = {kind: list(self.things[kind].values()) for kind in KINDS}
        return {"t": "picture", "kernels": self.kernels(), **made, "missed": 0}

    def kernels(self) -> list[Thing]:
        """The kernels, as the page has them."""
        return [{**view.about, "address": view.address} for view in self.views.values()]

    async def draw(self) -> Message | None:
        """Bring the things up to date; the change to tell, or None where there is none.

        What is laid out anew is laid out in a thread: 1,000 boxes take up to 0.4 s.
        """
        spots, edges = self._wanted()
        if self._tidy:
            self._tidy = False
            self._layout, self._routes = await asyncio.to_thread(_laid_out, spots, edges, self._groups())
        elif not self._adapt(spots, edges):
            self._layout, self._routes = await asyncio.to_thread(_laid_out, spots, edges, self._groups())
        return self._change(edges)

    def _change(self, edges: Iterable[Edge]) -> Message | None:
        new = {"frames": self._frames(), "boxes": self._boxes(), "edges": self._drawn(edges)}
        message: Message = {"t": "change"}
        gone: dict[str, list[Any]] = {}
        for kind, things in new.items():
            before = self.things[kind]
            different = [one for number, one in things.items() if before.get(number) != one]
            if different:
                message[kind] = different
            if left := [number for number in before if number not in things]:
                gone[kind] = left
            self.things[kind] = things
        kernels = self.kernels()
        before_of = {one["address"]: one for one in self._told}
        if changed := [one for one in kernels if before_of.get(one["address"]) != one]:
            message["kernels"] = changed
        if left_kernels := [address for address in before_of if address not in {one["address"] for one in kernels}]:
            gone["kernels"] = left_kernels
        self._told = kernels
        if gone:
            message["gone"] = gone
        return message if len(message) > 1 else None

    # -- boxes and edges of the profiles ---------------------------------------------------------------------------

    def _wanted(self) -> tuple[dict[Key, Spot], list[Edge]]:
        """The boxes as they are to be, without places, and the edges between them."""
        spots: dict[Key, Spot] = {
            ("box", view.key, name): self._spot(view, name, report)
            for view in self.views.values()
            for name, report in view.components.items()
        }
        self.connectors = {}
        edges: dict[Key, Edge] = {}
        for view in self.views.values():
            for name, report in view.connectors.items():
                source, target = self._end(view, report["source"]), self._end(view, report["target"])
                for path, (key, port), out in ((report["source"], source, True), (report["target"], target, False)):
                    if key not in spots:
                        spots[key] = _stub(spots.get(key), key, view, path, port, out=out)
                    elif key[0] == "far":
                        spots[key] = _stub(spots[key], key, view, path, port, out=out)
                key = ("edge", *source[0][1:], source[1], *target[0][1:], target[1])
                edges.setdefault(key, Edge(key, source[0], source[1], target[0], target[1]))
                self.connectors[view.key, name] = self.number(*key)
            for name, report in (view.profile.get("service_connectors") or {}).items():
                if (edge := self._service_edge(view, name, report, spots)) is not None:
                    edges[edge.key] = edge
                    self.connectors[view.key, name] = self.number(*edge.key)
        return spots, list(edges.values())

    def _service_edge(self, view: View, name: str, report: Thing, spots: Mapping[Key, Spot]) -> Edge | None:
        ends = [self._end(view, path) for path in report["ports"][:2]]
        if len(ends) != 2 or any(key not in spots for key, _ in ends):
            return None
        ends.sort(key=lambda end: end[1] not in spots[end[0]].outputs)
        (source, out), (target, into) = ends
        return Edge(("edge", view.key, name), source, out, target, into)

    def _spot(self, view: View, name: str, report: Thing) -> Spot:
        ports = report["ports"].values()
        inputs = tuple(one["name"] for one in ports if _side(one) == "in")
        outputs = tuple(one["name"] for one in ports if _side(one) == "out")
        band = ("band", view.key, _context_of(report))
        return Spot(("box", view.key, name), band, inputs, outputs, name, _class(report["type"]))

    def _end(self, view: View, path: str) -> tuple[Key, str]:
        """The box and the port of an end of a connector, perhaps of another kernel."""
        far, _, near = path.rpartition("/")
        name, _, port = near.rpartition(".")
        if not far:
            return ("box", view.key, name), port
        host = view.address.partition("/")[0]
        wanted = (far, f"{host}/{far}")
        for other in self.views.values():
            if (other.address in wanted or other.key in wanted) and name in other.components:
                return ("box", other.key, name), port
        return ("far", view.key, f"{far}/{name}"), port

    def _groups(self) -> dict[Key, str]:
        """The kernel of each band, in order."""
        return {("band", view.key, context): view.key for view in self.views.values() for context in _bands(view)}

    def _adapt(self, spots: Mapping[Key, Spot], edges: Iterable[Edge]) -> bool:
        """Put in what is different and leave all else where it stands; False: it is to be laid out anew."""
        layout, again = self._layout, set[Key]()
        for key in [key for key in layout.spots if key not in spots]:
            layout.remove(key)
        by_end: dict[Key, list[Edge]] = {}
        known = {edge.key: edge for edge in edges}
        for edge in known.values():
            by_end.setdefault(edge.source, []).append(edge)
            by_end.setdefault(edge.target, []).append(edge)
        for key in [key for key in self._routes if key not in known]:
            layout.forget(key)
            del self._routes[key]
        new: list[Spot] = []
        for key, spot in spots.items():
            old = layout.spots.get(key)
            if old is not None and (old.band, old.inputs, old.outputs) == (spot.band, spot.inputs, spot.outputs):
                continue
            if old is not None:
                layout.remove(key)
            new.append(spot)
        for spot in new:
            joined = by_end.get(spot.key, ())
            before = [edge.source for edge in joined if edge.target == spot.key]
            after = [edge.target for edge in joined if edge.source == spot.key]
            if not layout.add(spot, self._group_of(spot), before, after):
                return False
            again.update(edge.key for edge in joined)
            again.update(key for key, route in self._routes.items() if meets(route, spot))
        again.update(key for key in known if key not in self._routes)
        for key in again:
            if key in known:
                self._routes[key] = layout.route(known[key])
        return True

    def _group_of(self, spot: Spot) -> str:
        return spot.band[1]

    # -- things as the page has them -------------------------------------------------------------------------------

    def _frames(self) -> dict[int, Thing]:
        made: dict[int, Thing] = {}
        right = self._layout.right
        for view in self.views.values():
            bands = [
                (key, band) for key, band in self._layout.bands.items() if self._layout.groups.get(key) == view.key
            ]
            if not bands:
                continue
            number = self.number("frame", view.key)
            top, last = bands[0][1].top, bands[-1][1]
            made[number] = {
                "id": number, "kind": "kernel", "kernel": view.address, "name": view.about["name"],
                "said": view.address if view.about["name"] != view.address else "", "x": -16.0, "y": top - 44.0,
                "w": right + 32.0, "h": last.top + last.height - top + 60.0, "parent": None, "folded": False,
            }  # fmt: skip
            isolated = view.service("isolation")
            for key, band in bands:
                name = key[2]
                frame = self.number("frame", view.key, name)
                report = view.contexts.get(name)
                members = () if report is None else report["members"]
                apart = [isolated[one]["pid"] for one in members if one in isolated and isinstance(isolated[one], dict)]
                said = _said(report) + "".join(f" · process {pid}" for pid in dict.fromkeys(apart))
                made[frame] = {
                    "id": frame, "kind": "process" if apart else "context", "kernel": view.address,
                    "name": name or "in no context", "said": said, "x": 0.0, "y": band.top, "w": right,
                    "h": band.height, "parent": number, "folded": False,
                }  # fmt: skip
        return made

    def _boxes(self) -> dict[int, Thing]:
        made: dict[int, Thing] = {}
        for key, spot in self._layout.spots.items():
            kind, kernel, name = key
            view = self.views[kernel]
            number = self.number(*key)
            place = {
                "id": number, "kernel": view.address, "name": name, "frame": self.number("frame", kernel, spot.band[2]),
                "x": round(spot.x, 1), "y": round(spot.y, 1), "w": round(spot.w, 1), "h": spot.h,
            }  # fmt: skip
            made[number] = {**place, **(_far_box(spot) if kind == "far" else _box(view, name, spot))}
        return made

    def _drawn(self, edges: Iterable[Edge]) -> dict[int, Thing]:
        reports: dict[int, list[tuple[View, str]]] = {}
        for (kernel, name), number in self.connectors.items():
            reports.setdefault(number, []).append((self.views[kernel], name))
        made: dict[int, Thing] = {}
        for edge in edges:
            route, number = self._routes[edge.key], self.number(*edge.key)
            view, name = reports[number][0]
            report = view.connectors.get(name)
            links = [link for one, there in reports[number] if (link := one.service("links").get(there))]
            far = report is not None and report["options"]["on_link_lost"] is not None
            made[number] = {
                "id": number, "kernel": view.address, "name": name,
                "from": [self.number(*edge.source), edge.out], "to": [self.number(*edge.target), edge.into],
                "points": [list(point) for point in route.points], "label": list(route.label),
                "policy": "service" if report is None else policy_of(report["options"]),
                "state": _link_state(links) if far else "up", "why": "; ".join(one for one in links if one != "up"),
                "link": far, "bundle": 1,
            }  # fmt: skip
        return made


def _laid_out(spots: Mapping[Key, Spot], edges: list[Edge], groups: dict[Key, str]) -> tuple[Layout, dict[Key, Route]]:
    layout = Layout()
    layout.place(list(spots.values()), edges, groups)
    routes: dict[Key, Route] = {edge.key: layout.route(edge) for edge in edges}
    return layout, routes


def _bands(view: View) -> Iterable[str]:
    """The contexts that have components to show, in the order of the kernel; "" where some are in none."""
    used = {_context_of(report) for report in view.components.values()}
    return [*(name for name in view.contexts if name in used), *([""] if "" in used else [])]


def _context_of(report: Thing) -> str:
    return next(iter(report["states"]), "")


def _class(type_text: str) -> str:
    return type_text.rpartition(":")[2].rpartition(".")[2]


def _side(port: Thing) -> str:
    """At which side of its box a port stands: what provides a service stands at the right."""
    if port["direction"] != "service":
        return str(port["direction"])
    return "out" if any(one["polarity"] == "provided" for one in port["interfaces"]) else "in"


def _stub(known: Spot | None, key: Key, view: View, path: str, port: str, *, out: bool) -> Spot:
    """The box of a far end whose kernel is not shown, with one port more."""
    inputs, outputs = ((), ()) if known is None else (known.inputs, known.outputs)
    inputs = inputs if out or port in inputs else (*inputs, port)
    outputs = outputs if not out or port in outputs else (*outputs, port)
    band = ("band", view.key, next(iter(_bands(view)), ""))
    return Spot(key, band, inputs, outputs, key[2], "elsewhere")


def _far_box(spot: Spot) -> Thing:
    ports = [
        {"name": name, "side": side, "kind": "data", "type": "", "unit": "", "y": spot.port_y(name, out=side == "out")}
        for side, names in (("in", spot.inputs), ("out", spot.outputs))
        for name in names
    ]
    return {"type": "elsewhere", "kind": "remote", "state": "", "said": "", "error": None, "infrastructure": False,
            "ports": ports}  # fmt: skip


def _box(view: View, name: str, spot: Spot) -> Thing:
    report = view.components[name]
    ports = [
        {"name": one["name"], "side": _side(one), "kind": "service" if one["direction"] == "service" else "data",
         "type": one["type"], "unit": one["unit"] or "", "y": spot.port_y(one["name"], out=_side(one) == "out")}
        for one in report["ports"].values()
    ]  # fmt: skip
    kind = _class(report["type"])
    return {
        "type": kind, "kind": "component", "state": state_of(report["states"], failed=report["last_error"] is not None),
        "said": said_of(report["states"], report["overdue"]), "error": error_of(report["last_error"]),
        "infrastructure": kind in _INFRASTRUCTURE, "ports": ports,
    }  # fmt: skip


def state_of(states: Mapping[str, str], *, failed: bool) -> str:
    """The state of a component in one word, by its states in its contexts."""
    if failed:
        return "error"
    found = set(states.values())
    return "active" if "active" in found else next(iter(states.values()), "inactive")


def said_of(states: Mapping[str, str], overdue: Mapping[str, Any]) -> str:
    """What is to be said of the state beside its word: a hook over its deadline, states that differ; "" is nothing."""
    return state_text(states, overdue) if overdue or len(set(states.values())) > 1 else ""


def error_of(text: str | None) -> Thing | None:
    """The last error of a component, with the place that its text names."""
    if text is None:
        return None
    found = _PLACE.search(text)
    place = {"file": found[1], "line": int(found[2])} if found else {}
    return {"message": text, **place}


def policy_of(options: Mapping[str, Any]) -> str:
    """The options of a connector in a few words."""
    words = [options["subscription"]]
    if options["subscription"] != "new" and options["push"] not in ("all", None):
        words.append(f"push {options['push']}")
    if options["push_rate"]:
        words.append(f"{options['push_rate']:g} Hz")
    words += [f"{options['length']} long", options["full"]]
    return ", ".join(words)


def _link_state(links: Iterable[str]) -> str:
    states = {one.partition(":")[0] for one in links}
    if states <= {"up"}:
        return "up"
    return "waiting" if any(one.startswith("connecting") for one in states) else "down"


def _said(report: Thing | None) -> str:
    if report is None:
        return ""
    kind = report["kind"]
    return f"{kind}, {report['rate']:g} Hz" if report["rate"] else str(kind)
