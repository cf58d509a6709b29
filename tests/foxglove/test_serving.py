"""A kernel is shown to viewers; they change nothing in it, and nothing else is looked at than what they want."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import jsonschema
import pytest
from websockets.exceptions import InvalidStatus

from aiorts import Component, Kernel, OutPort
from aiorts.sessions import AsyncClient
from aiorts.types import TimedDouble, TimedString, record
from aiorts_foxglove.admission import ORIGINS
from aiorts_foxglove.serving import Serving
from control_parts import WAIT, Counter, controlled
from foxglove_parts import viewer

pytestmark = pytest.mark.anyio


@record
class Odd:
    """A type that another process does not know."""

    left: int = 0
    right: float | None = None


class Strange(Component):
    """Writes a type of this file."""

    out = OutPort(Odd)


class Large(Component):
    """Writes texts."""

    out = OutPort(TimedString)


@asynccontextmanager
async def shown(name: str) -> AsyncIterator[tuple[str, Kernel, Serving]]:
    """A kernel, and what shows it, both in this loop."""
    async with controlled(name) as kernel:
        serving = Serving(ORIGINS, lambda _: None)
        client = await AsyncClient.open(name, timeout=WAIT, right="view")
        async with await serving.listen(0) as listening:
            showing = asyncio.create_task(serving.show(client))
            host, port = listening.sockets[0].getsockname()[:2]
            try:
                yield f"ws://{host}:{port}", kernel, serving
            finally:
                showing.cancel()
                await asyncio.gather(showing, return_exceptions=True)


async def test_samples_of_a_port_come_as_its_schema_says_and_the_system_is_as_it_was() -> None:
    async with shown("fox") as (url, kernel, _), viewer(url) as one:
        before = kernel.profile().structure().to_json()
        await one.until(lambda: "counter0.out" in one.channels)
        channel = one.channels["counter0.out"]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
        assert channel["schemaName"] == "TimedDouble"
        await one.want("counter0.out")
        await one.until(lambda: len(one.samples.get("counter0.out", [])) >= 3 and one.times)
        for sample in one.samples["counter0.out"]:
            jsonschema.validate(sample, json.loads(channel["schema"]))
        values = [sample["data"] for sample in one.samples["counter0.out"]]
        assert values == [values[0] + number for number in range(len(values))]
        assert kernel.profile().structure().to_json() == before


@pytest.mark.slow
async def test_a_port_is_tapped_only_while_somebody_wants_it() -> None:
    async with shown("lazy") as (url, kernel, _):
        out = kernel.components["counter0"].ports["out"]

        def writers() -> int:
            return len(out._connectors)

        async with viewer(url) as one, viewer(url, "foxglove.websocket.v1") as two:
            await one.until(lambda: "counter0.out" in one.channels)
            await two.until(lambda: "counter0.out" in two.channels)
            usual = writers()
            await one.want("counter0.out")
            await two.want("counter0.out")
            await one.until(lambda: one.samples)
            await two.until(lambda: two.samples)
            assert writers() == usual + 1
            await one.unwant("counter0.out")
            count = len(two.samples["counter0.out"])
            await two.until(lambda: len(two.samples["counter0.out"]) > count + 5)
        async with asyncio.timeout(WAIT):
            while writers() != usual:
                await asyncio.sleep(0.01)


async def test_ports_come_and_go_with_their_components() -> None:
    async with shown("moving") as (url, kernel, _), viewer(url) as one:
        added = await kernel.create(Counter, "extra")
        await one.until(lambda: "extra.out" in one.channels)
        first = one.channels["extra.out"]["id"]
        await one.want("extra.out")
        await kernel.remove(added)
        await one.until(lambda: "extra.out" not in one.channels)
        again = await kernel.create(Counter, "extra")
        await one.until(lambda: "extra.out" in one.channels)
        assert one.channels["extra.out"]["id"] != first
        await one.want("extra.out")
        writing = asyncio.create_task(_write_on(again, TimedDouble(data=1.0)))
        await one.until(lambda: one.samples.get("extra.out"))
        writing.cancel()
        assert one.samples["extra.out"][0]["data"] == 1.0


async def test_a_stranger_is_refused_and_garbage_is_answered() -> None:
    async with shown("guarded") as (url, _, _serving):
        for options in ({"origin": "https://evil.example"}, {"additional_headers": {"Host": "evil.example"}}):
            with pytest.raises(InvalidStatus, match="403"):
                async with viewer(url, **options):
                    pass
        with pytest.raises(InvalidStatus, match="400"):
            async with viewer(url, "chat"):
                pass
        async with viewer(url, origin="https://app.foxglove.dev") as one:
            for garbage in ("{", b"\x01\x00", '{"op": "advertise"}', '{"op": "subscribe", "subscriptions": 3}'):
                await one.socket.send(garbage)
            await one.until(lambda: "subscriptions" in one.statuses.get("request", {}).get("message", ""))
            assert one.statuses["request"]["level"] == 2
            await one.until(lambda: "counter0.out" in one.channels)
            await one.want("counter0.out")
            await one.until(lambda: one.samples)


@pytest.mark.slow(kept_by="foxglove/test_viewer.py::test_the_oldest_are_dropped_and_counted_and_the_count_is_said")
async def test_a_viewer_that_reads_nothing_loses_samples_and_the_others_do_not() -> None:
    async with shown("slow") as (url, kernel, _):
        large = await kernel.create(Large)
        async with viewer(url, max_queue=1) as stuck, viewer(url) as one:
            for each in (stuck, one):
                await each.until(lambda each=each: "large0.out" in each.channels)
                await each.want("large0.out")
            writing = asyncio.create_task(_write_on(large, TimedString(data="-")))
            await one.until(lambda: one.samples)
            await stuck.until(lambda: stuck.samples)
            writing.cancel()
            for number in range(60):
                large.out.write_nowait(TimedString(data=f"{number} {'x' * 500_000}"))
                await one.until(lambda number=number: one.samples["large0.out"][-1]["data"].startswith(f"{number} "))
            await stuck.until(lambda: stuck.samples["large0.out"][-1]["data"].startswith("59 "))
            got = [sample["data"].split()[0] for sample in stuck.samples["large0.out"] if sample["data"] != "-"]
            await stuck.until(
                lambda: stuck.statuses.get("dropped", {}).get("message", "").startswith(str(60 - len(got)))
            )
        assert 3 <= len(got) < 60
        assert "dropped" not in one.statuses


async def test_a_type_that_is_not_known_is_shown_without_a_schema(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aiorts_foxglove.channels.wire_type", lambda _: None)
    async with shown("odd") as (url, kernel, _), viewer(url) as one:
        strange = await kernel.create(Strange)
        await one.until(lambda: "strange0.out" in one.channels)
        channel = one.channels["strange0.out"]
        assert (channel["schemaName"], channel["schema"]) == ("", "")
        await one.want("strange0.out")
        writing = asyncio.create_task(_write_on(strange, Odd(3, None)))
        await one.until(lambda: one.samples.get("strange0.out"))
        writing.cancel()
        assert one.samples["strange0.out"][0] == {"left": 3, "right": None}


async def _write_on(component: Any, sample: object) -> None:
    """Write until the end of the test: what is wanted is not tapped at once."""
    while True:
        component.out.write_nowait(sample)
        await asyncio.sleep(0.01)
