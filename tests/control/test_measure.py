"""What runs is measured by its counters: they are those of the kernel, and looking changes nothing."""

from __future__ import annotations

import asyncio
import json

import pytest

from aiorts.cli.app import run_command
from aiorts.cli.commands.live.measure.readings import Rates, rate_of
from control_parts import Counter, controlled, with_client

pytestmark = pytest.mark.anyio


async def test_counters_are_those_of_the_kernel() -> None:
    async with controlled("counts") as kernel:
        await kernel.sleep(0.05)
        await kernel.deactivate("counter0")
        cycles = kernel.contexts["loop"].statistics.cycles
        await kernel.deactivate("reader0")
        found = await with_client("counts", lambda client: client.call("statistics"))
        ledger = next(iter(kernel.connectors.values())).statistics
    assert found["connectors"] == {
        "counter0.out-reader0.in": [ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped), 0]
    }
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
    def counters(at_ns: int, written: int) -> dict[str, object]:
        return {"at_ns": at_ns, "connectors": {"a-b": [written, 0, 0, {}, 0]}}

    assert rate_of(counters(2, 10), counters(1, 5), "a-b") == 5e9
    assert rate_of(counters(2, 5), counters(1, 10), "a-b") is None
    assert rate_of(counters(1, 5), counters(1, 5), "a-b") is None
    assert rate_of(counters(2, 5), counters(1, 5), "other") is None
