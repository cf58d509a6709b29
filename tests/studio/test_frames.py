"""What the page is told of composites, of filters that were put in, of hosts, and of the ages of samples."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect

from aiorts import Component, Composite, Connector, InPort, Kernel, OutPort, PeriodicContext
from aiorts.sessions import Entry
from aiorts.types import TimedDouble, TimedDoubleSeq
from aiorts_studio.watching.scene import Scene
from aiorts_studio.watching.view import View, about
from control_parts import WAIT, Counter, Reader, controlled
from studio_parts import Site, site

pytestmark = [pytest.mark.anyio, pytest.mark.row(120)]


class Stage(Component):
    """Passes on what comes."""

    value = InPort(TimedDouble)
    result = OutPort(TimedDouble)

    async def on_execute(self) -> None:
        for sample in self.value.drain():
            self.result.write_nowait(sample)


class Pins(Component):
    """Takes several numbers at once."""

    values = InPort(TimedDoubleSeq, shape=(1,))


@dataclass
class Shown:
    """What a page is shown, by what it was told."""

    socket: ClientConnection
    things: dict[str, dict[int, Any]] = field(default_factory=lambda: {"frames": {}, "boxes": {}, "edges": {}})
    rows: dict[int, Any] = field(default_factory=dict)
    problems: list[Any] = field(default_factory=list)

    async def say(self, kind: str, **said: Any) -> None:
        await self.socket.send(json.dumps({"t": kind, **said}))

    async def until(self, found: Callable[[], Any]) -> Any:
        """Take what is told until something is there."""
        async with asyncio.timeout(WAIT):
            while not (value := found()):
                self._take(json.loads(await self.socket.recv()))
        return value

    def _take(self, told: dict[str, Any]) -> None:
        for kind, things in self.things.items():
            if told["t"] == "picture":
                things.clear()
            things.update({one["id"]: one for one in told.get(kind, ())})
            for number in told.get("gone", {}).get(kind, ()):
                things.pop(number)
        self.rows.update({int(number): row for number, row in told.get("e", {}).items()})
        if told["t"] == "problem":
            self.problems.append(told["problem"])

    def named(self, kind: str, name: str) -> Any:
        return next((one for one in self.things[kind].values() if one["name"] == name), None)

    def boxes(self) -> list[str]:
        return sorted(one["name"] for one in self.things["boxes"].values())

    def lines(self) -> list[tuple[str, str, str, str]]:
        """The edges: box and port of each end."""
        names = {number: box["name"] for number, box in self.things["boxes"].items()}
        ends = [(*edge["from"], *edge["to"]) for edge in self.things["edges"].values()]
        return sorted((names[a], out, names[b], into) for a, out, b, into in ends)


@asynccontextmanager
async def page(client: Site) -> AsyncIterator[Shown]:
    async with connect(f"ws://{client.host}/api/page", origin=client.origin) as socket:  # type: ignore[arg-type]
        shown = Shown(socket)
        await shown.say("greeting", token=client.token)
        yield shown


@asynccontextmanager
async def arm() -> AsyncIterator[Kernel]:
    """counter0 -> a composite "arm" of first and second -> reader0."""
    async with Kernel(services={"control": {"name": "unit", "mode": "on"}}) as kernel:
        counter, reader = await kernel.create(Counter, "counter0"), await kernel.create(Reader, "reader0")
        first, second = Stage("first"), Stage("second")
        composite = Composite("arm", first, second, exported=["first.value", "second.result"])
        await kernel.add(composite)
        await kernel.connect(first.result, second.value)
        await kernel.connect(counter.out, composite.ports["value"])
        await kernel.connect(composite.ports["result"], reader.in_)
        context = PeriodicContext(rate=100.0, name="loop")
        await kernel.start(context, counter, composite, reader, activate=True)
        yield kernel


async def test_a_composite_is_a_frame_that_folds_into_a_box_with_its_ports() -> None:
    async with arm(), site() as client, page(client) as shown:
        frame = await shown.until(lambda: len(shown.lines()) == 3 and shown.named("frames", "arm"))
        await shown.until(lambda: "active" in shown.named("frames", "arm")["said"])
        assert frame["kind"] == "composite"
        assert shown.named("frames", "arm")["said"] == "composite of 2, active"
        assert frame["parent"] == shown.named("frames", "loop")["id"]
        assert shown.boxes() == ["counter0", "first", "reader0", "second"]
        inside = [one["name"] for one in shown.things["boxes"].values() if one["frame"] == frame["id"]]
        assert sorted(inside) == ["first", "second"]
        for one in shown.things["boxes"].values():
            within = frame["y"] < one["y"] and one["y"] + one["h"] < frame["y"] + frame["h"]
            assert within is (one["name"] in inside)

        await shown.say("fold", id=frame["id"], on=True)
        await shown.until(lambda: len(shown.boxes()) == 3)
        box = shown.named("boxes", "arm")
        assert (box["kind"], box["type"], box["state"], box["frame"]) == (
            "folded",
            "2 components",
            "active",
            frame["id"],
        )
        assert box["around"] == shown.named("frames", "loop")["id"]
        assert box["members"] == ["first", "second"]
        assert [(one["name"], one["side"]) for one in box["ports"]] == [("value", "in"), ("result", "out")]
        assert shown.lines() == [("arm", "result", "reader0", "in"), ("counter0", "out", "arm", "value")]

        await shown.say("fold", id=box["frame"], on=False)
        await shown.until(lambda: len(shown.boxes()) == 4)
        assert len(shown.lines()) == 3


async def test_a_frame_that_is_folded_is_as_large_as_its_box_wants() -> None:
    async with arm(), site() as client, page(client) as shown:
        await shown.until(lambda: len(shown.lines()) == 3 and shown.named("frames", "loop"))
        for kind, name in (("context", "loop"), ("kernel", "unit")):
            before = await shown.until(lambda name=name: shown.named("frames", name))
            assert before["kind"] == kind
            await shown.say("fold", id=before["id"], on=True)
            box = await shown.until(lambda name=name: shown.boxes() == [name] and shown.named("boxes", name))
            frame = shown.named("frames", name)
            assert frame["w"] < before["w"]
            assert frame["h"] < before["h"]
            assert frame["x"] < box["x"]
            assert box["x"] + box["w"] < frame["x"] + frame["w"] <= box["x"] + box["w"] + 60
            assert frame["y"] + 40 < box["y"]
            assert box["y"] + box["h"] < frame["y"] + frame["h"] <= box["y"] + box["h"] + 40
            assert frame["id"] == box["around"]
            assert not [one for one in shown.things["frames"].values() if one["parent"] == frame["id"]]
            await shown.say("fold", id=before["id"], on=False)
            await shown.until(lambda: len(shown.boxes()) == 4)


class Failing(Component):
    """Fails at once."""

    async def on_execute(self) -> None:
        raise RuntimeError("no current")


async def test_the_last_error_says_where_and_when() -> None:
    async with controlled() as kernel, site() as client, page(client) as shown:
        await shown.until(lambda: shown.named("boxes", "counter0"))
        before = kernel.clock.time_ns()
        failing = await kernel.create(Failing, "failing0")
        await kernel.start(PeriodicContext(rate=50.0, name="other"), failing, activate=True)
        error = await shown.until(lambda: (shown.named("boxes", "failing0") or {}).get("error"))
        assert error["message"] == "RuntimeError: no current"
        assert error["file"].endswith("test_frames.py")
        assert before <= int(error["at_ns"]) <= kernel.clock.time_ns()


async def test_a_filter_that_was_put_in_is_infrastructure_and_one_of_the_system_is_not() -> None:
    async with controlled() as kernel, site() as client, page(client) as shown:
        pins = await kernel.create(Pins, "pins0")
        await kernel.start(PeriodicContext(rate=10.0, name="slow"), pins, activate=True)
        await kernel.connect("counter0.out", "pins0.values", adapt=True)
        own = {"inputs": ["TimedDouble"], "outputs": ["TimedDouble"]}
        await kernel.create("FlexiFilter", "mine", **own)
        await shown.until(lambda: shown.named("boxes", "mine") and len(shown.things["edges"]) == 3)
        filters = [one for one in shown.things["boxes"].values() if one["type"] == "FlexiFilter"]
        found = {one["name"]: one["infrastructure"] for one in filters}
        assert found == {"counter0_to_pins0_values": True, "mine": False}


@asynccontextmanager
async def stamped(kernel: Kernel, shown: Shown, **options: Any) -> AsyncIterator[tuple[Connector, int]]:
    """A connector of samples that say when they were sent, and the number of its edge, which is in view."""
    reader = await kernel.create(Reader, "reader1")
    await kernel.start(PeriodicContext(rate=50.0, name="other"), reader, activate=True)
    wire = await kernel.connect("counter0.out", "reader1.in", stamp="send", **options)
    edge = await shown.until(lambda: shown.named("edges", wire.name))
    await shown.say("view", rect=[-1e4, -1e4, 1e4, 1e4], scale=1.0)
    await shown.until(lambda: shown.rows.get(edge["id"]))
    yield wire, edge["id"]


@pytest.mark.slow(kept_by="test_a_connector_that_is_measured_by_its_option_has_an_age_unasked")
async def test_the_age_of_samples_is_measured_while_a_page_asks_for_it() -> None:
    async with controlled() as kernel, site() as client:
        async with page(client) as shown, stamped(kernel, shown) as (wire, edge):
            assert shown.rows[edge][5] is None
            assert not wire.profile.measure
            await shown.say("measure", edges=[edge], on=True)
            assert 0.0 < await shown.until(lambda: shown.rows[edge][5]) < 1000.0
            await shown.say("measure", edges=[edge], on=False)
            await shown.until(lambda: shown.rows[edge][5] is None)
            async with asyncio.timeout(WAIT):  # the page knows before the kernel has done it
                while wire.profile.measure:
                    await asyncio.sleep(0.02)
            await shown.say("measure", edges=[edge], on=True)
            await shown.until(lambda: shown.rows[edge][5])
            assert wire.profile.measure
        async with asyncio.timeout(WAIT):
            while wire.profile.measure:
                await asyncio.sleep(0.02)


async def test_a_connector_that_is_measured_by_its_option_has_an_age_unasked() -> None:
    async with (
        controlled() as kernel,
        site() as client,
        page(client) as shown,
        stamped(kernel, shown, measure=100) as (_, edge),
    ):
        assert 0.0 < await shown.until(lambda: shown.rows[edge][5]) < 1000.0


async def test_pages_have_few_connectors_measured() -> None:
    async with controlled() as kernel, site() as client, page(client) as shown:
        for number in range(1, 17):
            await kernel.create(Reader, f"reader{number}")
            await kernel.connect("counter0.out", f"reader{number}.in")
        await shown.until(lambda: len(shown.things["edges"]) == 17)
        await shown.say("measure", edges=list(shown.things["edges"]), on=True)
        problem = await shown.until(lambda: shown.problems)
        assert problem[0]["code"] == "E-BUSY"
        await shown.say("measure", edges=["1"], on=True)
        await shown.until(lambda: len(shown.problems) == 2)


async def test_frames_hold_edges_that_go_back() -> None:
    async with controlled() as kernel, site() as client, page(client) as shown:
        first, second = await kernel.create(Stage, "first"), await kernel.create(Stage, "second")
        await kernel.start(PeriodicContext(rate=10.0, name="back"), first, second, activate=True)
        await kernel.connect("first.result", "second.value")
        await kernel.connect("second.result", "first.value")
        await shown.until(lambda: len(shown.things["edges"]) == 3 and shown.named("frames", "back"))
        bends = [x for one in shown.things["edges"].values() for x, _ in one["points"]]
        assert min(bends) < min(one["x"] for one in shown.things["boxes"].values())
        for one in shown.things["frames"].values():
            assert one["x"] < min(bends)
            assert max(bends) < one["x"] + one["w"]


async def test_kernels_of_several_hosts_stand_in_frames_of_their_hosts() -> None:
    scene = Scene()
    async with controlled() as kernel:
        profile = json.loads(kernel.profile().to_json())
    for address in ("north/one", "south/two", "north/three"):
        host = address.partition("/")[0]
        view = View(address, address, about(Entry(address, 1, "", "")))
        view.profile = profile
        assert view.about["host"] == host
        scene.views[address] = view
        await scene.draw()
    scene.tidy()
    await scene.draw()
    frames = scene.things["frames"]
    hosts = {one["name"]: one for one in frames.values() if one["kind"] == "host"}
    assert {name: one["said"] for name, one in hosts.items()} == {"north": "2 kernels", "south": "1 kernel"}
    for one in frames.values():
        if one["kind"] == "kernel":
            around = frames[one["parent"]]
            assert around["name"] == one["kernel"].partition("/")[0]
            assert around["y"] + 32 <= one["y"]
            assert one["y"] + one["h"] < around["y"] + around["h"]
            assert around["x"] < one["x"]
            assert one["x"] + one["w"] < around["x"] + around["w"]
    north, south = hosts["north"], hosts["south"]
    assert north["x"] + north["w"] < south["x"] or south["x"] + south["w"] < north["x"]
