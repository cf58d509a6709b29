"""Events, changes and log lines stream to a client, in order; what is dropped is counted."""

from __future__ import annotations

import asyncio
import logging

import pytest

from aiorts import Component, Kernel, Param
from aiorts.errors import AbsentError, ConfigurationError, WireError
from aiorts.events import Change, ProfileSnapshot
from aiorts.observe import SystemProfile, profile_from_plain
from aiorts.sessions import AsyncClient, Client, framed
from control_parts import WAIT, Counter, controlled, entry_of, with_client

pytestmark = pytest.mark.anyio


class Noted(Component):
    """Has a long text."""

    text: str = Param("")


async def opened(name: str) -> Client:
    return await asyncio.to_thread(lambda: Client.open(entry_of(name), timeout=WAIT))


async def test_events_come_in_order_without_a_gap() -> None:
    async with controlled("events") as kernel:
        with await opened("events") as client:
            stream = await asyncio.to_thread(client.stream, "events")
            counter = kernel.components["counter0"]
            for _ in range(5):
                await kernel.deactivate(counter)
                await kernel.activate(counter)
            found = [await asyncio.to_thread(stream.next, WAIT) for _ in range(10)]
    assert [one["sequence"] for one in found] == list(range(stream.began + 1, stream.began + 11))
    assert found[0]["event"]["component"] == "counter0"
    assert stream.missed == 0


async def test_only_the_kinds_that_are_asked_for() -> None:
    async with controlled("kinds") as kernel:
        with await opened("kinds") as client:
            stream = await asyncio.to_thread(lambda: client.stream("events", kinds=["ComponentAdded"]))
            await kernel.deactivate("counter0")
            await kernel.create(Counter, "other")
            assert (await asyncio.to_thread(stream.next, WAIT))["event"]["component"] == "other"


@pytest.mark.slow(kept_by="test_events_come_in_order_without_a_gap")
async def test_a_reader_that_is_too_slow_is_told_how_much_is_missing() -> None:
    """The client reads nothing until far more has happened than the socket and the queue hold."""
    async with controlled("slow") as kernel:
        with await opened("slow") as client:
            stream = await asyncio.to_thread(client.stream, "events")
            before = kernel.bus.sequence
            for _ in range(3000):
                await kernel.deactivate("counter0")
                await kernel.activate("counter0")
            happened, read = kernel.bus.sequence, 0
            sequence = before
            while sequence < happened:
                await (kernel.activate if read % 2 else kernel.deactivate)("counter0")  # what was missed comes with it
                sequence = (await asyncio.to_thread(stream.next, WAIT))["sequence"]
                read += 1
                assert read + stream.missed == sequence - before
    assert stream.missed > 0


async def test_changes_begin_with_the_profile_and_follow_in_order() -> None:
    async with controlled("changes") as kernel:
        with await opened("changes") as client:
            stream = await asyncio.to_thread(client.stream, "changes")
            assert set(stream.began["profile"]["components"]) == {"counter0", "reader0"}
            await kernel.deactivate("counter0")
            change = await asyncio.to_thread(stream.next, WAIT)
    assert change["sequence"] > stream.began["sequence"]
    parts = {part["name"]: part for part in change["parts"]}
    assert parts["counter0"]["now"]["states"] == {"loop": "inactive"}


async def test_changes_begin_in_turns_and_none_is_lost_or_told_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aiorts.control.operations.events.HOLD_SECONDS", 0.0)  # a turn for each thing
    async with controlled("turns", rate=10.0) as kernel:
        for number in range(30):
            await kernel.create(Counter, f"one{number}")
        with await opened("turns") as client:
            begun = asyncio.ensure_future(asyncio.to_thread(client.stream, "changes"))
            changed = 0
            while not begun.done() and changed < 50:  # more would not wait for a client that reads nothing yet
                await kernel.components["one0"].configuration.change("default", {"step": float(changed)})
                await kernel.remove(await kernel.create(Counter, f"more{changed}"))
                changed += 1
            stream = await begun
            await kernel.deactivate("counter0")
            assert changed > 3, "no turn of the loop while the profile was taken"
            profile = profile_from_plain(ProfileSnapshot, stream.began).apply()
            sequence = profile.sequence
            while profile.sequence < kernel.bus.sequence:
                change = profile_from_plain(Change, await asyncio.to_thread(stream.next, WAIT))
                assert change.sequence > sequence
                sequence = change.sequence
                profile = change.apply(profile)
        assert profile.structure() == profile_from_plain(SystemProfile, kernel.profile().to_plain()).structure()


@pytest.mark.slow(kept_by="test_changes_begin_in_turns_and_none_is_lost_or_told_twice")
async def test_who_was_too_slow_gets_a_new_profile_in_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aiorts.control.operations.events.HOLD_SECONDS", 0.0)
    async with controlled("slow", rate=10.0) as kernel:
        with await opened("slow") as client:
            note = await kernel.create(Noted, "note0")
            stream = await asyncio.to_thread(client.stream, "changes")
            profile = profile_from_plain(ProfileSnapshot, stream.began).apply()
            big = "x" * 60_000
            for number in range(500):
                await note.configuration.change("default", {"text": f"{number}{big}"})
            renewed = 0
            async with asyncio.timeout(WAIT):
                while "end" not in profile.components["note0"].params["text"].value:
                    item = await asyncio.to_thread(stream.next, WAIT)
                    if item["kind"] == "ProfileSnapshot":
                        renewed += 1
                        assert item["missed"] > 0
                        profile = profile_from_plain(ProfileSnapshot, item).apply()
                    else:
                        profile = profile_from_plain(Change, item).apply(profile)
                    await note.configuration.change("default", {"text": f"end{item['sequence']}"})
        assert renewed


@pytest.mark.row(106)
async def test_the_last_lines_and_those_that_come() -> None:
    async with controlled("lines") as kernel:
        kernel.components["counter0"].log.warning("one %d", 1)
        with await opened("lines") as client:
            stream = await asyncio.to_thread(lambda: client.stream("log", components=["counter0"], follow=True))
            kernel.components["counter0"].log.error("two")
            kernel.components["reader0"].log.error("of another")
            kernel.components["counter0"].log.error("three")
            found = [*stream.began, *[await asyncio.to_thread(stream.next, WAIT) for _ in range(2)]]
    assert [(one["level"], one["component"], one["text"]) for one in found] == [
        ("warning", "counter0", "one 1"),
        ("error", "counter0", "two"),
        ("error", "counter0", "three"),
    ]


async def test_the_last_lines_of_many_components_are_all_there() -> None:
    async with controlled("many") as kernel:
        for number in range(20):
            log = (await kernel.create(Counter, f"one{number}")).log
            for line in range(16):
                text = f"{line} of {number}"
                log.warning(text)
        found = await with_client("many", lambda client: client.stream("log").began)
    assert {one["text"] for one in found} == {f"{line} of {number}" for line in range(16) for number in range(20)}
    assert [one["time_ns"] for one in found] == sorted(one["time_ns"] for one in found)


async def test_nothing_is_left_of_a_reader_of_the_log() -> None:
    before = list(logging.getLogger("aiorts").handlers)
    async with controlled("left") as kernel:
        with await opened("left") as client:
            await asyncio.to_thread(lambda: client.stream("log", follow=True))
            assert logging.getLogger("aiorts").handlers != before
        async with asyncio.timeout(WAIT):
            while logging.getLogger("aiorts").handlers != before:
                await kernel.sleep(0.01)


@pytest.mark.row(106)
async def test_a_level_is_set_for_one_component_and_put_back_with_the_session() -> None:
    async with controlled("levels") as kernel:
        counter, reader = kernel.components["counter0"].log, kernel.components["reader0"].log
        with await opened("levels") as client:
            await asyncio.to_thread(
                lambda: client.call("log_level", level="debug", components=["counter0"], lasting=False)
            )
            assert (counter.isEnabledFor(logging.DEBUG), reader.isEnabledFor(logging.DEBUG)) == (True, False)
            found = await asyncio.to_thread(client.call, "log_levels")
            assert found["counter0"]["level"] == "debug"
        async with asyncio.timeout(WAIT):
            while counter.isEnabledFor(logging.DEBUG):
                await kernel.sleep(0.01)


async def test_wrong_names_and_levels_are_refused() -> None:
    async with controlled("wrong"):
        with pytest.raises(AbsentError, match="cuonter0: no such component; did you mean counter0"):
            await with_client("wrong", lambda client: client.call("log_levels", components=["cuonter0"]))
        with pytest.raises(ConfigurationError, match="expected debug, info"):
            await with_client("wrong", lambda client: client.call("log_level", level="loud"))


async def test_streams_end_with_the_kernel() -> None:
    kernel = await Kernel(services={"control": {"name": "ends"}}).open()
    with await opened("ends") as client:
        stream = await asyncio.to_thread(client.stream, "events", WAIT)
        await kernel.aclose()
        assert [one["kind"] for one in await asyncio.to_thread(lambda: list(stream))] == ["Closing"]


@pytest.mark.parametrize("credit", ["x", 0, -1, True, 2**31])
async def test_credit_that_is_none_ends_the_session(credit: object) -> None:
    async with controlled("credit"), AsyncClient.connect("credit", timeout=WAIT) as client:
        stream = await client.stream("log", WAIT, follow=True).open()
        client._write(framed({"id": 1, "credit": credit}))
        with pytest.raises(WireError, match="a call with a credit that is none"):
            await stream.next(WAIT)


async def test_credit_for_what_is_no_stream_is_passed_over() -> None:
    async with controlled("credit"), AsyncClient.connect("credit", timeout=WAIT) as client:
        client._write(framed({"id": 7, "credit": 5}))
        assert (await client.call("names", WAIT))["state"] == "open"
