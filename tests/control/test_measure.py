"""What runs is measured by its counters: they are those of the kernel, and looking changes nothing."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from contextlib import AsyncExitStack
from typing import Any, Protocol

import pytest

from aiorts import Component, Provided, Required
from aiorts.cli.app import run_command
from aiorts.cli.commands.live.measure.readings import Counters, Rates, counters_in, rate_of
from aiorts.cli.commands.live.spans import span_text
from aiorts.errors import BusyError, ConfigurationError, DeniedError, WiringError
from aiorts.model.timing import ConnectorCounters
from aiorts.sessions import Client, Stream
from aiorts.testing import simulate
from aiorts.types import TimedDouble
from aiorts.wire import MsgpackCodec
from control_parts import WAIT, Counter, Reader, controlled, entry_of, with_client

pytestmark = pytest.mark.anyio


class Twice(Protocol):
    def twice(self, number: int) -> int: ...


class Asking(Component):
    """Would ask."""

    twice = Required[Twice]()


class Answering(Component):
    """Answers."""

    answers = Provided[Twice]()

    def twice(self, number: int) -> int:
        return 2 * number


@pytest.mark.slow
async def test_counters_are_those_of_the_kernel() -> None:
    async with controlled("counts") as kernel:
        await kernel.sleep(0.05)
        await kernel.deactivate("counter0")
        cycles = kernel.contexts["loop"].statistics.cycles
        await kernel.deactivate("reader0")
        found = await with_client("counts", lambda client: client.call("statistics"))
        ledger = next(iter(kernel.connectors.values())).statistics
    assert list(found["connectors"]) == ["counter0.out-reader0.in"]
    row = counters_in(found)["connectors"]["counter0.out-reader0.in"]
    assert (row.written, row.delivered, row.buffered, row.dropped, row.measure) == (
        ledger.written,
        ledger.delivered,
        ledger.buffered,
        ledger.dropped,
        0,
    )
    assert found["contexts"]["loop"]["cycles"] >= cycles > 0
    assert found["components"]["counter0"]["failed"] is False
    assert found["simulated"] is False


async def test_only_what_is_chosen_and_there() -> None:
    async with controlled("chosen") as kernel:
        await kernel.create(Counter, "other")
        found = await with_client(
            "chosen", lambda client: client.call("statistics", connectors=["gone"], contexts=[], components=["other"])
        )
    assert (found["connectors"], found["contexts"], list(found["components"])) == ({}, {}, ["other"])


async def test_hz_shows_the_rate_by_the_counter(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["hz", "counter0.out", "--interval", "0.05", "--count", "1", "--json"]
    async with controlled("rate"):
        assert await asyncio.to_thread(run_command, words) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["from"], found["to"], found["windows"]) == ("counter0.out", "reader0.in", 1)
    assert found["min"] == found["max"] == found["rate"] > 0


async def test_a_port_without_a_connector_has_no_rate(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled("alone"):
        assert await asyncio.to_thread(run_command, ["hz", "reader0"]) == 6
    assert (
        "reader0: no connector is there, and only they count samples; alone has counter0.out -> reader0.in"
        in capsys.readouterr().err
    )


def test_rates_are_of_windows_and_of_the_whole() -> None:
    rates = Rates()
    ended = [rates.add(at, written) for at, written in ((0, 0), (10**9, 100), (10**9, 100), (3 * 10**9, 400))]
    assert ended == [False, True, False, True]
    assert rates.summary() == {
        "rate": 400 / 3, "window": 150.0, "min": 100.0, "max": 150.0, "stdev": 25.0, "windows": 2
    }  # fmt: skip


def test_no_rate_where_a_connector_was_made_anew_or_time_stood() -> None:
    def counters(at_ns: int, written: int) -> Counters:
        return counters_in({"at_ns": at_ns, "connectors": {"a-b": [written, 0, 0, {}, 0]}})

    assert rate_of(counters(2, 10), counters(1, 5), "a-b") == 5e9
    assert rate_of(counters(2, 5), counters(1, 10), "a-b") is None
    assert rate_of(counters(1, 5), counters(1, 5), "a-b") is None
    assert rate_of(counters(2, 5), counters(1, 5), "other") is None


def test_a_row_of_a_newer_kernel_is_read_as_far_as_it_is_known() -> None:
    known = ConnectorCounters(5, 3, 1, {"expired": 1}, 7)
    newer = counters_in({"connectors": {"a-b": [*known, "new", 2]}})["connectors"]["a-b"]
    assert newer == known
    assert (newer.written, newer.lost, newer.measure) == (5, 1, 7)


async def opened(name: str) -> Client:
    return await asyncio.to_thread(lambda: Client.open(entry_of(name), timeout=WAIT))


async def test_a_connector_is_measured_as_long_as_a_session_that_asked_lasts() -> None:
    async with controlled("measure") as kernel:
        connector = next(iter(kernel.connectors.values()))
        with await opened("measure") as one:
            assert await asyncio.to_thread(lambda: one.call("measure", connectors=[connector.name])) == [connector.name]
            with await opened("measure") as two:
                await asyncio.to_thread(lambda: two.call("measure", connectors=[connector.name]))
            async with asyncio.timeout(WAIT):
                while not connector.statistics.latency:
                    await kernel.sleep(0.01)
            assert connector.profile.measure == 1000
            assert connector.statistics.balanced
        async with asyncio.timeout(WAIT):
            while connector.profile.measure:
                await kernel.sleep(0.01)
    assert connector.statistics.latency is None


async def test_what_was_measured_before_stays_so() -> None:
    async with controlled("stays") as kernel:
        counter, reader = kernel.components["counter0"], kernel.components["reader0"]
        made = await kernel.connect(counter.ports["out"], reader.ports["in"], measure=7, allow_duplicate=True)
        assert await with_client("stays", lambda client: client.call("measure", connectors=[made.name])) == []
        with pytest.raises(WiringError, match="no such connector; there are counter0"):
            await with_client("stays", lambda client: client.call("measure", connectors=["gone"]))
        with pytest.raises(ConfigurationError, match="expected 1 to"):
            await with_client("stays", lambda client: client.call("measure", connectors=[made.name], count=0))
        assert made.profile.measure == 7


async def test_the_size_is_that_of_the_sample_written_last_which_stays_unread() -> None:
    async with controlled("sizes") as kernel:
        await kernel.deactivate("counter0")
        await kernel.deactivate("reader0")
        other = await kernel.create(Counter, "other")
        reader = kernel.components["reader0"]
        assert isinstance(reader, Reader)
        wire = await kernel.connect(other.out, reader.in_, name="wire")
        found = await with_client("sizes", lambda client: client.call("sizes", connectors=["wire"]))
        assert found == {"wire": [None, "nothing was written yet"]}
        sample = TimedDouble(data=1.0)
        other.out.write_nowait(sample)
        ledger = wire.statistics
        found = await with_client("sizes", lambda client: client.call("sizes", connectors=["wire", "gone"]))
    assert found == {"wire": [len(MsgpackCodec().encode(sample)), ""]}
    assert wire.statistics.delivered == ledger.delivered


async def test_chosen_values_stream_at_a_rate() -> None:
    async with controlled("monitor"):
        with await opened("monitor") as client:
            stream = await asyncio.to_thread(
                lambda: client.stream("monitor", paths=["counter0.step", "loop.ticks"], rate=1000.0)
            )
            found = [await asyncio.to_thread(stream.next, WAIT) for _ in range(3)]
            with pytest.raises(WiringError, match="it has out, step, state"):
                await asyncio.to_thread(lambda: client.stream("monitor", paths=["counter0.count"]))
    assert [one["values"]["counter0.step"] for one in found] == [1.0] * 3
    times = [one["monotonic_ns"] for one in found]
    assert times == sorted(set(times))


@pytest.mark.parametrize("operation", ["monitor", "counters"])
def test_in_simulated_time_streams_go_by_real_time_and_look_between_instants(operation: str) -> None:
    arguments: dict[str, Any] = {"paths": ["counter0.step", "loop.ticks"]} if operation == "monitor" else {}
    found: list[dict[str, Any]] = []

    def follow(client: Client) -> None:
        with client:
            stream = client.stream(operation, WAIT, rate=50.0, **arguments)
            found.extend(stream.next(WAIT) for _ in range(3))

    async def run() -> None:
        async with controlled("virtual") as kernel:
            client = Client.open(entry_of("virtual"), timeout=WAIT)
            follower = threading.Thread(target=follow, args=(client,))
            follower.start()
            until = time.monotonic() + WAIT
            while follower.is_alive() and time.monotonic() < until:
                await kernel.sleep(1.0)
        follower.join(WAIT)

    simulate(run())
    at = [one["monotonic_ns" if operation == "monitor" else "at_ns"] for one in found]
    assert len(at) == 3
    assert at == sorted(set(at))
    assert all(one % 10**7 == 0 for one in at), "not at an instant of the system"


async def test_counters_come_whole_and_then_as_far_as_they_have_changed() -> None:
    async with controlled("followed") as kernel:
        (wire,) = kernel.connectors
        await kernel.create(Counter, "idle")
        await kernel.create(Reader, "spare")
        await kernel.connect("idle.out", "spare.in")
        with await opened("followed") as client:
            stream = await asyncio.to_thread(lambda: client.stream("counters", rate=50.0))
            first = await asyncio.to_thread(stream.next, WAIT)
            assert (first["whole"], first["gone"]) == (True, {})
            assert set(first["connectors"]) == {wire, "idle.out-spare.in"}
            assert set(first["components"]) == {"counter0", "reader0", "idle", "spare"}
            second = await asyncio.to_thread(stream.next, WAIT)
            assert second["whole"] is False
            assert set(second["connectors"]) == {wire}, "the other one has not changed"
            assert second["components"] == {}
            assert second["connectors"][wire][0] >= first["connectors"][wire][0]
            await kernel.remove(kernel.components["spare"])
            gone: dict[str, list[str]] = {}
            while not gone:
                gone = (await asyncio.to_thread(stream.next, WAIT))["gone"]
            assert gone == {"connectors": ["idle.out-spare.in"], "components": ["spare"]}
            at = await asyncio.to_thread(lambda: client.stream("counters", rate=50.0, at=["reader0.in"], contexts=[]))
            chosen = await asyncio.to_thread(at.next, WAIT)
            assert (set(chosen["connectors"]), set(chosen["components"])) == ({wire}, {"reader0"})
            assert chosen["contexts"] == {}


async def test_the_counters_of_services_are_there() -> None:
    async with controlled("served") as kernel:
        await kernel.create(Asking, "asking")
        await kernel.create(Answering, "answering")
        connector = await kernel.connect("asking.twice", "answering.answers")
        found = await with_client("served", lambda client: client.call("statistics"))
        assert found["service_connectors"][connector.name]["calls"] == 0
        assert connector.name not in found["connectors"]
        found = await with_client("served", lambda client: client.call("statistics", connectors=[]))
        assert found["service_connectors"] == {}


async def test_who_only_looks_has_connectors_measured_as_long_as_its_stream_lasts() -> None:
    async with controlled("viewing", mode="view") as kernel:
        (wire,) = kernel.connectors.values()
        with await opened("viewing") as client:
            with pytest.raises(DeniedError):
                await asyncio.to_thread(client.call, "measure", connectors=[wire.name])
            stream = await asyncio.to_thread(lambda: client.stream("counters", rate=50.0, measured=[wire.name]))
            assert stream.began == [wire.name]
            assert wire.profile.measure == 1000
            timed: dict[str, Any] = {}
            while not timed:
                timed = (await asyncio.to_thread(stream.next, WAIT))["timed"]
            assert {"latency"} <= set(timed[wire.name])
            await asyncio.to_thread(client.call, "names")
            assert wire.profile.measure == 1000
        async with asyncio.timeout(WAIT):
            while wire.profile.measure:
                await kernel.sleep(0.01)


async def test_no_client_that_only_looks_has_all_connectors_measured_that_may_be() -> None:
    async with controlled("viewing", mode="view") as kernel, AsyncExitStack() as stack:
        (wire,) = kernel.connectors.values()

        async def measured(client: Client, count: int) -> Stream:
            return await asyncio.to_thread(lambda: client.stream("counters", measured=[wire.name] * count))

        first, *others = [stack.enter_context(await opened("viewing")) for _ in range(5)]
        with pytest.raises(ConfigurationError, match="at most 16 for a client"):
            await measured(first, 17)
        held = await measured(first, 15)
        await measured(first, 1)
        with pytest.raises(BusyError, match="streams of this client, 1 more asked for; at most 16"):
            await measured(first, 1)
        for one in others[:3]:
            await measured(one, 16)
        with pytest.raises(BusyError, match="streams of all clients, 1 more asked for; at most 64"):
            await measured(others[3], 1)
        held.close()
        await asyncio.to_thread(first.call, "names")
        await measured(others[3], 15)


async def test_bytes_are_the_rate_times_the_size(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bw", "counter0.out->reader0.in", "--interval", "0.05", "--count", "1", "--json"]
    async with controlled("bytes"):
        assert await asyncio.to_thread(run_command, words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["bytes_per_second"] == found["rate"] * found["bytes"] > 0


async def test_delay_says_that_it_measures_and_puts_it_back(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["delay", "reader0.in", "--interval", "0.05", "--count", "1", "--json"]
    async with controlled("delay") as kernel:
        connector = next(iter(kernel.connectors.values()))
        assert await asyncio.to_thread(run_command, words) == 0
        async with asyncio.timeout(WAIT):
            while connector.profile.measure:
                await kernel.sleep(0.01)
    told = capsys.readouterr()
    assert told.err == "aiorts: until this ends, it is measured (option measure = 1000): counter0.out -> reader0.in\n"
    found = json.loads(told.out)
    assert found["latency"]["samples"] > 0
    assert 0 < found["latency"]["p50_ns"] <= found["latency"]["p99_ns"] <= found["latency"]["max_ns"]


async def test_who_may_only_look_reads_a_delay_that_is_measured_and_measures_none(
    capsys: pytest.CaptureFixture[str],
) -> None:
    async with controlled("looks", mode="view") as kernel:
        assert await asyncio.to_thread(run_command, ["delay", "reader0.in", "--count", "1"]) == 4
        assert "measure: needs the right 'operate'" in capsys.readouterr().err
        kernel.connections.measure(next(iter(kernel.connectors.values())), 10)
        assert await asyncio.to_thread(run_command, ["delay", "reader0.in", "--count", "1"]) == 0


def test_spans_of_time_have_three_digits() -> None:
    shown = [span_text(ns) for ns in (0, 999, 1000, 12_345, 999_900, 10**6, 2 * 10**9, 5000 * 10**9)]
    assert shown == ["0 ns", "999 ns", "1 us", "12.3 us", "1000 us", "1 ms", "2 s", "5000 s"]
