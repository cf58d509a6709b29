"""Samples go out of a running system and into it; the system is what it is without."""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, InPort, OutPort, PeriodicContext, profile_from_plain
from aiorts.errors import ClosedError, RecordError, WiringError
from aiorts.sessions import END, Client
from aiorts.testing import simulate
from aiorts.types import TimedDouble, TimedOctetSeq
from control_parts import WAIT, Counter, commanded, controlled, entry_of, with_client

pytestmark = pytest.mark.anyio


class Narrow(Component):
    """Takes one connector and keeps what comes."""

    in_ = InPort(TimedDouble, name="in", max_connectors=1)

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.seen: list[float] = []

    async def on_execute(self) -> None:
        self.seen += [sample.data for sample in self.in_.drain()]


async def opened(name: str) -> Client:
    return await asyncio.to_thread(lambda: Client.open(entry_of(name), timeout=WAIT))


async def until(condition: Any) -> None:
    async with asyncio.timeout(5):
        while not condition():
            await asyncio.sleep(0.005)


@pytest.mark.slow
@pytest.mark.row(114)
async def test_every_sample_comes_in_order_and_the_system_does_not_know() -> None:
    async with controlled("tapped") as kernel:
        before = kernel.profile().structure().to_json()
        with await opened("tapped") as client:
            stream = await asyncio.to_thread(lambda: client.stream("tap", port="counter0.out"))
            found = [await asyncio.to_thread(stream.next, WAIT) for _ in range(20)]
            assert kernel.profile().structure().to_json() == before
            assert kernel.components["counter0"].ports["out"].connectors == tuple(kernel.connectors.values())
    assert stream.began["type"] == "TimedDouble"
    values = [one["data"] for one in found]
    assert values == [values[0] + number for number in range(20)]
    assert stream.missed == 0


@pytest.mark.slow(kept_by="first")
async def test_what_a_reader_is_too_slow_for_is_counted_and_holds_nobody_up() -> None:
    async with controlled("lossy") as kernel:
        counter = await kernel.create(Counter, "quick")
        with await opened("lossy") as client:
            stream = await asyncio.to_thread(lambda: client.stream("tap", port="quick.out"))
            for number in range(20_000):
                counter.out.write_nowait(TimedDouble(data=float(number)))
                if number % 50 == 0:
                    await asyncio.sleep(0)
            await kernel.remove(counter)
            got = await asyncio.to_thread(lambda: list(stream.until(None)))
    assert 0 < len(got) < 20_000
    assert len(got) + stream.missed == 20_000
    assert [one["data"] for one in got] == sorted(one["data"] for one in got)


async def test_a_burst_without_a_turn_of_the_loop_is_counted() -> None:
    async with controlled("burst") as kernel:
        counter = await kernel.create(Counter, "quick")
        with await opened("burst") as client:
            stream = await asyncio.to_thread(lambda: client.stream("tap", port="quick.out"))
            for number in range(600):
                counter.out.write_nowait(TimedDouble(data=float(number)))
            await kernel.remove(counter)
            got = await asyncio.to_thread(lambda: list(stream.until(None)))
    assert (len(got), stream.missed) == (256, 344)
    assert got[-1]["data"] == 599.0


async def test_a_tap_ends_with_its_port() -> None:
    async with controlled("port") as kernel:
        other = await kernel.create(Counter, "other")
        other.add_port("more", OutPort(TimedDouble))
        with await opened("port") as client:
            stream = await asyncio.to_thread(lambda: client.stream("tap", port="other.more"))
            other.remove_port("more")
            assert await asyncio.to_thread(stream.next, WAIT) is END
    assert stream.result == "other.more: was removed"


async def test_a_tap_ends_with_its_component() -> None:
    async with controlled("gone") as kernel:
        other = await kernel.create(Counter, "other")
        with await opened("gone") as client:
            stream = await asyncio.to_thread(lambda: client.stream("tap", port="other.out"))
            await kernel.remove(other)
            assert await asyncio.to_thread(stream.next, WAIT) is END
    assert "removed" in stream.result


@pytest.mark.row(114)
async def test_injected_samples_arrive_and_take_no_place() -> None:
    async with controlled("into") as kernel:
        narrow = await kernel.create(Narrow, "narrow")
        await kernel.start(PeriodicContext(rate=100.0, name="second"), narrow, activate=True)
        lines = ["1", '{"data": 2.5, "tm": 7}']
        with await opened("into") as client:
            said = await asyncio.to_thread(lambda: client.call("inject", port="narrow.in", lines=lines))
            assert (said["written"], said["refused"], said["dropped"]) == (2, 0, {})
            assert narrow.in_.connectors == ()
            assert len(kernel.connectors) == 1
            await kernel.connect("counter0.out", "narrow.in")
            await until(lambda: 2.5 in narrow.seen and len(narrow.seen) > 5)
        with pytest.raises(WiringError, match="takes 1 connectors"):
            await kernel.connect("counter0.out", "narrow.in", allow_duplicate=True)


async def test_nothing_is_written_where_one_line_is_wrong() -> None:
    async with controlled("checked") as kernel:
        narrow = await kernel.create(Narrow, "narrow")
        with pytest.raises(RecordError, match=r"narrow.in: line 2: "):
            await with_client("checked", lambda one: one.call("inject", port="narrow.in", lines=["1", '"x"', "3"]))
        assert narrow.in_.drain() == []


@pytest.mark.parametrize("full", ["reject", "block"])
async def test_a_full_reader_refuses_and_is_counted(full: str) -> None:
    async with controlled("full") as kernel:
        await kernel.create(Narrow, "narrow")
        with await opened("full") as client:
            said = await asyncio.to_thread(
                lambda: client.call(
                    "inject", WAIT, port="narrow.in", lines=["1"] * 5, length=2, full=full, timeout=0.01
                )
            )
    assert said == {"written": 2, "refused": 3, "dropped": {}, "unread": 2}


@pytest.mark.parametrize(
    ("words", "active", "status", "said"),
    [
        ((), True, 0, {"written": 1, "refused": 0, "dropped": {}}),
        ((), False, 1, {"written": 1, "refused": 0, "dropped": {"inactive": 1}}),
        (("--timeout", "0.1"), True, 1, {"written": 1, "refused": 0, "dropped": {"lost": 1}}),
        (("--no-wait",), True, 0, {"written": 1, "refused": 0, "dropped": {}}),
    ],
    ids=["delivered", "inactive", "lost", "not waited"],
)
async def test_the_command_waits_until_its_samples_are_delivered_and_says_what_is_lost(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], active: bool, status: int, said: dict[str, Any]
) -> None:
    """The reader's next cycle comes 0.5 s later."""
    async with controlled("slow") as kernel:
        narrow = await kernel.create(Narrow, "narrow")
        await kernel.start(PeriodicContext(rate=2.0, name="second"), narrow, activate=active)
        found, text = await commanded(capsys, "inject", "narrow.in", "1.5", "--json", *words)
        assert (found, json.loads(text)) == (status, said)
        if not words and active:
            assert narrow.seen == [1.5]


async def test_an_inject_with_other_options_loses_nothing_of_the_one_before() -> None:
    async with controlled("others") as kernel:
        narrow = await kernel.create(Narrow, "narrow")
        await kernel.start(PeriodicContext(rate=5.0, name="second"), narrow, activate=True)
        with await opened("others") as client:
            for length in (2, 3, 2):
                await asyncio.to_thread(
                    lambda length=length: client.call("inject", port="narrow.in", lines=[str(length)], length=length)
                )
            last = await asyncio.to_thread(lambda: client.call("inject", WAIT, port="narrow.in", lines=[], wait=5.0))
    assert last == {"written": 0, "refused": 0, "dropped": {}, "unread": 0}
    assert narrow.seen == [2.0, 3.0, 2.0]


async def test_what_a_session_injects_by_ends_with_it() -> None:
    async with controlled("session") as kernel:
        narrow = await kernel.create(Narrow, "narrow")
        with await opened("session") as client:
            await asyncio.to_thread(lambda: client.call("inject", port="narrow.in", lines=["1"]))
            assert narrow.in_.read_nowait().data == 1.0
        await until(lambda: repr(narrow.in_).endswith("0 connectors>"))


async def test_the_profile_has_the_connectors_of_tools_apart() -> None:
    async with controlled("apart") as kernel:
        await kernel.create(Narrow, "narrow")
        before = tuple(kernel.profile().connectors)
        with await opened("apart") as client:
            await asyncio.to_thread(lambda: client.call("inject", port="narrow.in", lines=["1"] * 9, length=4))
            stream = await asyncio.to_thread(lambda: client.stream("tap", port="counter0.out"))
            await asyncio.to_thread(stream.next, WAIT)
            profile = kernel.profile()
            writes, reads = profile.services["tool"]["connectors"]
            assert profile_from_plain(type(profile), profile.to_plain()) == profile
            assert tuple(profile.connectors) == before
        await until(lambda: "tool" not in kernel.profile().services)
    assert (writes["port"], writes["reads"], writes["written"], writes["buffered"]) == ("narrow.in", False, 9, 4)
    assert writes["dropped"] == {"rejected": 5}
    assert (reads["port"], reads["reads"], reads["dropped"]) == ("counter0.out", True, {})
    assert reads["written"] == reads["delivered"] + reads["buffered"] >= 1
    assert writes["client"] == reads["client"] != ""


async def test_a_removed_port_ends_what_is_injected() -> None:
    async with controlled("removed") as kernel:
        narrow = await kernel.create(Narrow, "narrow")
        with await opened("removed") as client:
            call = {"port": "narrow.in", "lines": ["1"] * 50, "length": 2, "full": "block", "timeout": None}
            number = await asyncio.to_thread(lambda: client.begin("inject", **call))
            await until(lambda: repr(narrow.in_).endswith("1 connectors>"))
            await kernel.remove(narrow)
            with pytest.raises(ClosedError):
                await asyncio.to_thread(client.result, number, WAIT)


@pytest.mark.parametrize(("port", "says"), [("reader0.in", "counter0.out"), ("counter0", "no out-port")])
async def test_only_out_ports_can_be_tapped(port: str, says: str) -> None:
    async with controlled("refused"):
        with pytest.raises(WiringError, match=says):
            await with_client("refused", lambda client: client.stream("tap", port=port))


@pytest.mark.slow
def test_a_tap_changes_nothing_in_simulated_time() -> None:
    async def run(*, watched: bool) -> str:
        async with controlled("still", rate=1000.0) as kernel:
            client = Client.open(entry_of("still"), timeout=WAIT) if watched else None
            if client is not None:
                client.begin("tap", port="counter0.out")
            await kernel.sleep(3.0)
            if client is not None:
                client.close()
            return kernel.profile().structure().to_json()

    assert simulate(run(watched=True)) == simulate(run(watched=False))


@pytest.mark.parametrize("kind", ["file", "pipe"])
async def test_a_file_is_checked_as_a_whole_before_the_first_write_and_a_pipe_by_what_is_there(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, kind: str
) -> None:
    good, lines = ["1", "", *["2"] * 98], tmp_path / "lines"
    async with controlled("checked") as kernel:
        await kernel.create(Narrow, "narrow")
        for wrong in (['"x"'], []):
            text = "".join(f"{line}\n" for line in (*good, *wrong))
            lines.write_text(text)
            if kind == "file":
                source = lines.open()
            else:
                read, write = os.pipe()
                os.write(write, text.encode())
                os.close(write)
                source = os.fdopen(read)
            with source as stdin:
                monkeypatch.setattr(sys, "stdin", stdin)
                status, said = await commanded(capsys, "inject", "narrow.in", "--length", "200", "--json", "--no-wait")
            if wrong:
                before = "no" if kind == "file" else r"\d\d"
                assert status == 2
                assert re.search(rf"narrow.in: line 101: .*; {before} samples were written before", said)
            else:
                assert (status, json.loads(said)) == (0, {"written": 99, "refused": 0, "dropped": {}})


@pytest.mark.slow
async def test_some_fields_and_some_samples_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled(rate=200.0):
        words = ("print", "counter0.out", "--fields", "data,tm", "--count", "3")
        status, text = await commanded(capsys, *words)
        found = [json.loads(line) for line in text.splitlines()]
        assert (status, [list(one) for one in found]) == (0, [["data", "tm"]] * 3)
        assert found[2]["data"] == found[0]["data"] + 2.0
        status, text = await commanded(capsys, *words, "--rate", "1000000")
        assert (status, len(text.splitlines())) == (0, 3)
        status, text = await commanded(capsys, "print", "counter0.out", "--rate", "0.001", "--for", "0.1")
        assert (status, len(text.splitlines()) <= 1) == (0, True)  # of about 20
        assert (await commanded(capsys, "print", "counter0.out.data", "--fields", "tm"))[0] == 2


@pytest.mark.slow(kept_by="test_a_burst_without_a_turn_of_the_loop_is_counted")
async def test_what_a_slow_client_has_not_taken_at_the_end_is_sent_or_counted() -> None:
    async with controlled("last") as kernel:
        out = kernel.components["counter0"].add_port("large", OutPort(TimedOctetSeq))
        client = await asyncio.to_thread(Client.open, entry_of("last"))
        stream = await asyncio.to_thread(lambda: client.stream("tap", port="counter0.large"))
        for number in range(300):
            out.write_nowait(TimedOctetSeq(number, bytes(10_000)))
            await asyncio.sleep(0)
        took = asyncio.create_task(asyncio.to_thread(lambda: list(stream.until(None))))
    with client:
        got = await took
    assert len(got) + stream.missed == 300
