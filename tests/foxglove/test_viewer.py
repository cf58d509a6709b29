"""What waits for a viewer is bounded and counted, and comes in an order that makes sense to it."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from aiorts_foxglove import viewer as viewing
from aiorts_foxglove.channels import Channel, Kind
from aiorts_foxglove.viewer import QUEUE, Viewer

pytestmark = pytest.mark.anyio
OUT = Channel(1, "counter0.out", Kind.of("aiorts.types.TimedDouble"))


async def drained(viewer: Viewer) -> list[Any]:
    """All that is to be sent now."""
    found: list[Any] = []
    messages = viewer.messages()
    while True:
        try:
            async with asyncio.timeout(0.02):
                message = await anext(messages)
        except TimeoutError:
            return found
        found.append(message if isinstance(message, bytes) else json.loads(message))


def ops(messages: list[Any]) -> list[str]:
    return [str(one["op"]) if isinstance(one, dict) else {1: "sample", 2: "time"}[one[0]] for one in messages]


async def watching() -> Viewer:
    viewer = Viewer()
    viewer.show(("unit", "1"), {1: OUT})
    await drained(viewer)
    viewer.subscribe([(9, 1)])
    return viewer


async def test_it_begins_with_the_server_and_an_advertisement_even_of_nothing() -> None:
    viewer = Viewer()
    viewer.show(("unit", "1"), {})
    viewer.say("kernel", 2, "has ended")
    info, status, advertised = await drained(viewer)
    assert (info["op"], info["name"], info["sessionId"]) == ("serverInfo", "unit", "1")
    assert (status["op"], status["message"]) == ("status", "has ended")
    assert advertised == {"op": "advertise", "channels": []}


async def test_the_oldest_are_dropped_and_counted_and_the_count_is_said() -> None:
    viewer = await watching()
    for number in range(QUEUE + 500):
        viewer.offer(1, number, b"{}")
    found = await drained(viewer)
    samples = [one for one in found if isinstance(one, bytes)]
    assert len(samples) + viewer.dropped == QUEUE + 500
    assert int.from_bytes(samples[-1][5:13], "little") == QUEUE + 499
    (status,) = (one for one in found if isinstance(one, dict))
    assert (status["id"], status["message"]) == ("dropped", "500 samples were dropped on the way to this viewer")


async def test_bytes_are_bounded_too_and_one_large_sample_comes_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewing, "QUEUE_BYTES", 1_000)
    viewer = await watching()
    for number in range(3):
        viewer.offer(1, number, b" " * 5_000)
    assert (ops(await drained(viewer)), viewer.dropped) == (["sample", "status"], 2)


async def test_a_port_that_goes_and_comes_is_another_channel_after_its_last_samples() -> None:
    viewer = await watching()
    viewer.offer(1, 5, b"{}")
    viewer.show(("unit", "1"), {2: Channel(2, OUT.port, OUT.kind)})
    assert (viewer.wanted, ops(await drained(viewer))) == ({}, ["sample", "unadvertise", "advertise"])


async def test_a_kernel_that_comes_again_is_a_new_session() -> None:
    viewer = await watching()
    viewer.say("kernel", 2, "has ended")
    viewer.show(("unit", "1"), {})
    assert ops(await drained(viewer)) == ["unadvertise", "status"]
    viewer.say("kernel", 2, "")
    viewer.show(("unit", "2"), {2: OUT})
    found = await drained(viewer)
    assert ops(found) == ["serverInfo", "removeStatus", "advertise"]
    assert found[0]["sessionId"] == "2"


async def test_what_cannot_be_wanted_is_one_line_and_the_rest_is_wanted() -> None:
    viewer = Viewer()
    viewer.show(("unit", "1"), {1: OUT})
    await drained(viewer)
    viewer.subscribe([(number, channel) for number in range(200) for channel in range(100)])
    assert viewer.wanted == {1: 0}
    (status,) = await drained(viewer)
    assert status["message"].startswith("subscribe: 19999 refused")


async def test_what_waits_of_a_subscription_that_ends_is_not_sent() -> None:
    viewer = await watching()
    viewer.offer(1, 5, b"{}")
    viewer.unsubscribe([9])
    assert (await drained(viewer), viewer.wanted, viewer.dropped) == ([], {}, 0)


async def test_time_never_goes_back() -> None:
    viewer = await watching()
    viewer.show_time(5)
    viewer.show_time(3)
    (message,) = await drained(viewer)
    assert int.from_bytes(message[1:], "little") == 5
