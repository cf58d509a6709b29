"""What a page is told: what runs, what changes, figures, and what it asks for."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from aiorts import Component, EventContext, InPort, Kernel, OutPort
from aiorts.types import TimedDouble
from aiorts_studio.page_socket import PAGES
from aiorts_studio.watching.watch import Watch
from control_parts import WAIT, Counter, controlled, running
from studio_page import paging
from studio_parts import site

pytestmark = [pytest.mark.anyio, pytest.mark.row(120)]
ROOMBA = str(Path(__file__).parents[2] / "examples/roomba/system.toml")


def address_of(kernel: Kernel) -> str:
    assert kernel.address is not None
    return kernel.address


async def sessions_end() -> None:
    """Wait until no client is connected with a kernel of this test's user."""
    runtime = os.environ["XDG_RUNTIME_DIR"]
    async with asyncio.timeout(WAIT):
        while any(runtime in one and one.split()[5] == "03" for one in Path("/proc/net/unix").read_text().splitlines()):
            await asyncio.sleep(0.02)


async def test_a_page_shows_what_runs_and_its_figures_are_those_of_the_kernel() -> None:
    async with controlled("robot") as kernel, site() as client, paging(client) as page:
        await page.whole("counter0", "reader0")
        (edge,) = page.edges.values()
        assert edge["from"] == [page.box("counter0")["id"], "out"]
        assert edge["to"] == [page.box("reader0")["id"], "in"]
        assert {one["kind"] for one in page.frames.values()} == {"kernel", "context"}
        await page.until(lambda: edge["id"] in page.figures and page.figures[edge["id"]][0] is not None)
        for one in kernel.components.values():  # then nothing is counted any more
            await kernel.deactivate(one)
        statistics = (await client.call("robot", "statistics")).value
        ((written, _, buffered, dropped, _),) = statistics["connectors"].values()
        assert written > 0
        await page.until(lambda: page.at[address_of(kernel)] > int(statistics["at_ns"]))
        assert page.figures[edge["id"]][1:3] == [sum(dropped.values()), buffered]


async def test_what_comes_and_goes_is_told_and_nothing_else_moves() -> None:
    async with controlled("robot") as kernel, site() as client, paging(client) as page:
        await page.whole("counter0", "reader0")
        before, number = page.places(), page.box("counter0")["id"]
        kernel.components["counter0"].add_port("extra", OutPort(TimedDouble))
        await page.until(lambda: len(page.boxes[number]["ports"]) == 2, 5.0)
        assert {one: place for one, place in page.places().items() if one != number} == {
            one: place for one, place in before.items() if one != number
        }
        before = page.places()
        added = await kernel.create(Counter, "counter1")
        await page.until(lambda: page.box("counter1"), 5.0)
        assert page.places().items() >= before.items()
        await kernel.remove(added)
        await page.until(lambda: not page.box("counter1"), 5.0)
        assert page.places() == before


@pytest.mark.slow(kept_by="test_a_page_shows_what_runs_and_its_figures_are_those_of_the_kernel")
async def test_a_kernel_that_ends_and_begins_again_is_the_same() -> None:
    async with site() as client:
        async with controlled("robot"):
            async with asyncio.timeout(WAIT):
                page_of = paging(client)
                page = await page_of.__aenter__()
            await page.whole("counter0", "reader0")
            before = {name: page.box(name)["id"] for name in ("counter0", "reader0")}
        try:
            await page.until(lambda: page.kernel("robot")["state"] == "ended", 3.0)
            async with controlled("robot"):
                await page.until(lambda: page.is_live("robot"))
                await page.whole("counter0", "reader0")
                assert before == {name: page.box(name)["id"] for name in before}
                assert len(page.kernels) == 1
        finally:
            await page_of.__aexit__(None, None, None)


@pytest.mark.slow(kept_by="test_a_page_shows_what_runs_and_its_figures_are_those_of_the_kernel")
async def test_a_kernel_that_ends_while_no_page_is_open_is_not_shown_as_live() -> None:
    async with site() as client:
        async with controlled("robot"):
            async with paging(client) as page:
                await page.whole("counter0")
            await sessions_end()
        async with controlled("other"), paging(client) as page:
            await page.until(lambda: page.is_live("other"))
            await page.until(lambda: page.kernel("robot") is None or page.kernel("robot")["state"] == "ended")


@pytest.mark.slow(kept_by="test_a_page_shows_what_runs_and_its_figures_are_those_of_the_kernel")
async def test_the_end_of_a_run_leaves_its_last_whole_picture_without_rates() -> None:
    async with site() as client, paging(client) as page:
        async with controlled("robot"):
            await page.whole("counter0", "reader0")
            (edge,) = page.edges
            await page.until(lambda: edge in page.figures and page.figures[edge][0])
            frames = {number: (one["name"], one["kind"]) for number, one in page.frames.items()}
            before, arrived = page.places(), page.figures[edge][1]
        await page.until(lambda: page.kernel("robot")["state"] == "ended")
        await page.until(lambda: {one["state"] for one in page.boxes.values()} == {"ended"})
        await page.until(lambda: page.figures[edge][0] is None)
        assert page.kernel("robot")["why"] == "has ended"
        assert page.places() == before
        assert {number: (one["name"], one["kind"]) for number, one in page.frames.items()} == frames
        async with paging(client) as another:  # that comes later
            await another.until(lambda: edge in another.figures)
            assert another.figures[edge][:2] == [None, arrived]


@pytest.mark.slow
async def test_a_process_that_is_killed_is_said_to_be() -> None:
    async with site() as client, paging(client) as page:
        with running("killed", ROOMBA) as process:
            await page.until(lambda: page.is_live("killed"))
            process.kill()
            await page.until(lambda: page.kernel("killed")["state"] == "ended")
            assert "killed" in page.kernel("killed")["why"]


@pytest.mark.slow
async def test_a_process_that_is_stopped_is_silent_and_the_others_are_live() -> None:
    with running("stopped", ROOMBA) as process:
        async with controlled("robot") as kernel, site() as client, paging(client) as page:
            await page.until(lambda: page.is_live("stopped") and page.is_live("robot"))
            await page.whole("counter0")
            os.kill(process.pid, signal.SIGSTOP)
            try:
                began = time.monotonic()
                await page.until(lambda: page.kernel("stopped")["state"] == "silent")
                assert time.monotonic() - began < 6.0
                await page.until(lambda: page.box("odometry")["state"] == "silent")
                seen = len(page.at)
                await kernel.create(Counter, "counter1")
                await page.until(lambda: page.box("counter1"), 5.0)
                assert page.is_live("robot")
                assert len(page.at) == seen
            finally:
                os.kill(process.pid, signal.SIGCONT)
            await page.until(lambda: page.is_live("stopped"))
            await page.until(lambda: page.box("odometry")["state"] == "active")


@pytest.mark.slow(kept_by="test_what_comes_and_goes_is_told_and_nothing_else_moves")
async def test_frames_fold_and_unfold_and_boxes_are_moved() -> None:
    async with controlled("robot"), site() as client, paging(client) as page:
        await page.whole("counter0", "reader0")
        (frame,) = [one["id"] for one in page.frames.values() if one["kind"] == "kernel"]
        await page.say("fold", id=frame, on=True)
        await page.until(lambda: [one["kind"] for one in page.boxes.values()] == ["folded"] and not page.edges)
        await page.say("fold", id=frame, on=False)
        await page.whole("counter0", "reader0")
        assert len(page.edges) == 1
        counter = page.box("counter0")
        await page.say("move", id=counter["id"], x=1_000, y=counter["y"])
        await page.until(lambda: page.box("counter0")["x"] != counter["x"])
        await page.say("tidy")
        assert page.box("reader0")["id"] != counter["id"]


@pytest.mark.slow(kept_by="test_a_page_shows_what_runs_and_its_figures_are_those_of_the_kernel")
async def test_values_of_a_port_come_to_two_pages_by_one_tap() -> None:
    async with controlled("robot") as kernel, site() as client, paging(client) as one, paging(client) as other:
        out = kernel.components["counter0"].ports["out"]
        usual = len(out._connectors)
        watched = {"kernel": address_of(kernel), "path": "counter0.out"}
        await one.whole("counter0")
        await one.say("watch", id=1, fields=[""], columns_per_s=50, **watched)
        await other.say("watch", id=7, fields=[], **watched)
        values = await one.heard("values", lambda one: one["id"] == 1)
        assert all(low <= high for _, low, high in values["columns"])
        assert (await other.heard("text", lambda one: one["id"] == 7))["value"] > 0
        assert len(out._connectors) == usual + 1
        await one.say("watch", id=2, fields=["nowhere.at.all", "9" * 5_000], **watched)
        assert (await one.heard("answer", lambda one: one["id"] == 2))["problem"]["code"] == "E-ABSENT"
        await one.heard("values", lambda one: one["id"] == 1)  # the same tap goes on
        for path in ("counter0.nothing", "nobody.out", "", "."):
            await one.say("watch", id=3, kernel=watched["kernel"], path=path, fields=[])
            assert "E-ABSENT" in str((await one.heard("answer", lambda one: one["id"] == 3))["problem"])
        await one.say("watch", id=4, kernel=watched["kernel"], path="reader0.in", fields=[""])
        await one.heard("values", lambda one: one["id"] == 4)
        await one.say("unwatch", id=1)
        await one.say("unwatch", id=2)
        await other.say("unwatch", id=7)
        async with asyncio.timeout(WAIT):
            while len(out._connectors) > usual:
                await asyncio.sleep(0.02)


@pytest.mark.slow(kept_by="test_losses_that_the_kernel_warned_of_before_are_in_the_log")
async def test_the_log_is_told_by_level_and_a_burst_is_counted() -> None:
    async with controlled("robot") as kernel, site() as client, paging(client) as page:
        await page.whole("counter0")
        await page.say("log", on=True, level="WARNING", component="counter0")
        log = kernel.components["counter0"].log
        marked = 0
        async with asyncio.timeout(WAIT):
            while not any(one["t"] == "log" and one["lines"] for one in page.messages):
                log.info("not this")
                log.warning("number %d", marked)
                marked += 1
                await page.next()
        for i in range(5_000):
            log.warning(f"burst {i}")  # noqa: G004 - lines of one template are told as one
        await page.say("ask", id=5, kernel=address_of(kernel), operation="names", arguments={})
        assert "value" in await page.heard("answer", lambda one: one["id"] == 5, 10.0)
        told, missed = 0, 0
        with suppress(TimeoutError):
            while True:
                message = await page.heard("log", seconds=1.5)
                assert len(message["lines"]) <= 200
                assert {one["component"] for one in message["lines"]} <= {"counter0"}
                assert {one["level"] for one in message["lines"]} <= {"WARNING"}
                told, missed = told + len(message["lines"]), missed + message["missed"]
        assert told >= 200
        assert missed > 0
        assert told + missed <= 5_000 + marked


class Deaf(Component):
    in_ = InPort(TimedDouble, name="in")


async def test_losses_that_the_kernel_warned_of_before_are_in_the_log() -> None:
    async with controlled("robot") as kernel, site() as client, paging(client) as page:
        await kernel.connect(kernel.components["counter0"].ports["out"], (await kernel.create(Deaf, "deaf")).in_)
        await kernel.start(EventContext(name="other"), kernel.components["deaf"], activate=True)
        async with asyncio.timeout(WAIT):
            while not kernel.connectors["counter0.out-deaf.in"].statistics.dropped:
                await asyncio.sleep(0.05)
        await page.say("log", on=True, level="INFO", component="")
        (line,) = (await page.heard("log", lambda one: one["lines"]))["lines"]
        assert (line["level"], line["component"]) == ("WARNING", "")
        assert line["text"].startswith("counter0.out -> deaf.in: 1 sample lost so far")


@pytest.mark.slow(kept_by="test_what_comes_and_goes_is_told_and_nothing_else_moves")
async def test_events_are_told_and_history_is_there_for_a_page_that_comes() -> None:
    async with controlled("robot") as kernel, site() as client, paging(client) as page:
        await page.whole("counter0")
        await page.say("events", on=True)
        await page.say("ask", id=1, kernel=address_of(kernel), operation="names", arguments={})
        await page.heard("answer")
        await kernel.deactivate(kernel.components["counter0"])
        found = await page.heard("event", lambda one: any(item["component"] == "counter0" for item in one["items"]))
        assert all(item["kernel"] == address_of(kernel) for item in found["items"])
        async with paging(client) as other:
            await other.say("events", on=True)
            history = await other.heard("history")
            assert any(item["component"] == "counter0" for item in history["items"])


@pytest.mark.slow(kept_by="test_a_page_shows_what_runs_and_its_figures_are_those_of_the_kernel")
async def test_a_page_that_does_not_read_gets_a_fresh_picture() -> None:
    async with controlled("robot") as kernel, site() as client, paging(client) as page:
        await page.whole("counter0")
        assert client.api is not None
        (one,) = client.api.studio.pages
        for number in range(100_000):
            one.put({"t": "filler", "number": number, "text": "x" * 1_000})
            if one.missed:
                break
        assert one.missed
        await page.until(lambda: len(page.missed) == 2)
        assert page.missed[-1] > 0
        assert page.box("counter0")
        await kernel.remove(kernel.components["reader0"])
        await page.until(lambda: not page.box("reader0"))


async def test_there_are_no_more_than_so_many_pages() -> None:
    async with site() as client:
        assert client.api is not None
        sockets = [
            await connect(f"ws://{client.host}/api/page", origin=client.origin)  # type: ignore[arg-type]
            for _ in range(PAGES + 1)
        ]
        try:
            for socket in sockets:
                await socket.send(json.dumps({"token": client.token}))
            heard = await asyncio.gather(
                *(asyncio.wait_for(one.recv(), WAIT) for one in sockets), return_exceptions=True
            )
            refused = [one for one in heard if isinstance(one, ConnectionClosed)]
            assert len(refused) == 1, heard
        finally:
            for socket in sockets:
                await socket.close()


HOSTILE: tuple[str | bytes, ...] = (
    "", "x", "[]", "null", "1", '"t"', "{",
    b"\x00\xff", "[" * 60_000, '{"t":null}', '{"t":[]}', '{"t":{}}', '{"t":"x"}',
    '{"t":"view"}', '{"t":"view","rect":[NaN,0,1,1],"scale":1}', '{"t":"view","rect":[0,0,1,1],"scale":1e999}',
    '{"t":"view","rect":[0,0,1],"scale":1}', '{"t":"view","rect":[true,0,1,1],"scale":1}',
    '{"t":"view","rect":[0,0,1,' + "9" * 400 + '],"scale":1}',
    '{"t":"view","rect":[0,0,1,' + "9" * 5_000 + '],"scale":1}',
    '{"t":"fold","id":1.5,"on":true}', '{"t":"fold","id":true,"on":true}', '{"t":"fold","id":-1}', '{"t":"fold"}',
    '{"t":"fold","id":99999,"on":true}', '{"t":"move","id":1,"x":NaN,"y":0}', '{"t":"move","id":1,"x":"1","y":0}',
    '{"t":"move","id":99999,"x":1,"y":0}', '{"t":"watch","id":1,"kernel":1,"path":"a"}', '{"t":"watch","id":1}',
    '{"t":"watch","id":1,"kernel":"a","path":"b","fields":[1]}',
    '{"t":"watch","id":1,"kernel":"\\ud800","path":"\\u0000"}',
    '{"t":"unwatch","id":77}', '{"t":"log","on":true,"level":5}', '{"t":"log","on":true,"level":"\\ud800"}',
    '{"t":"log","on":true,"component":"nobody"}', '{"t":"ask","id":1}', '{"t":"ask","id":1,"kernel":"robot"}',
    '{"t":"ask","id":1,"kernel":"robot","operation":"stop","arguments":{}}',
    '{"t":"ask","id":1,"kernel":"robot","operation":"tap","arguments":{"port":"counter0.out"}}',
    '{"t":"ask","id":1,"kernel":"robot","operation":"names","arguments":[]}',
    '{"t":"record","on":true}', '{"t":"record","on":true,"ports":[]}', '{"t":"record","on":true,"ports":[["a"]]}',
    '{"t":"record","on":true,"ports":[["robot","\\u0000"]]}', '{"t":"record","on":true,"ports":[["--help","-o"]]}',
    '{"t":"record","on":false}', '{"t":"measure"}', '{"t":"view","rect":{"0":1},"scale":1}',
)  # fmt: skip


@pytest.mark.slow(kept_by="test_a_page_shows_what_runs_and_its_figures_are_those_of_the_kernel")
async def test_hostile_messages_end_nothing(caplog: pytest.LogCaptureFixture) -> None:
    async with controlled("robot") as kernel, site() as client, paging(client) as page:
        await page.whole("counter0")
        for number, text in enumerate(HOSTILE):
            await page.socket.send(text)
            await page.say("ask", id=1_000 + number, kernel=address_of(kernel), operation="names", arguments={})
            told = await page.heard("answer", lambda one, number=number: one["id"] == 1_000 + number)
            assert "value" in told or told["problem"]["code"] == "E-BUSY", (text[:80], told)
        assert page.is_live("robot")
        assert not caplog.records, caplog.records


@pytest.mark.slow(kept_by="test_a_page_shows_what_runs_and_its_figures_are_those_of_the_kernel")
async def test_no_session_stays_without_a_page() -> None:
    async with controlled("robot"), site() as client:
        for _ in range(3):
            async with paging(client) as page:
                await page.whole("counter0")
            await sessions_end()
        watching = ("studio", "studio kernels", "studio watch", "studio follower", "studio layout", "studio page")
        async with asyncio.timeout(WAIT):
            while left := {one.get_name() for one in asyncio.all_tasks()} & {*watching}:
                await asyncio.sleep(0.02)
        assert not left


class Failing:
    """A follower with a defect."""

    kernel = ""

    async def run(self, watch: Watch) -> None:
        raise KeyError("a defect")


@pytest.mark.slow(kept_by="test_a_page_shows_what_runs_and_its_figures_are_those_of_the_kernel")
async def test_an_error_of_a_follower_is_told_and_ends_nothing_else() -> None:
    async with controlled("robot") as kernel, site() as client, paging(client) as page:
        await page.whole("counter0")
        loop, reports = asyncio.get_running_loop(), list[Any]()
        before = loop.get_exception_handler()
        loop.set_exception_handler(lambda _, report: reports.append(report))
        try:
            assert client.api is not None
            client.api.studio.follow(Failing())
            at = page.at[address_of(kernel)]
            await page.until(lambda: page.at[address_of(kernel)] > at)
        finally:
            loop.set_exception_handler(before)
        assert [type(one["exception"]) for one in reports] == [KeyError]
        assert page.is_live("robot")
        await kernel.create(Counter, "counter1")
        await page.until(lambda: page.box("counter1"))
