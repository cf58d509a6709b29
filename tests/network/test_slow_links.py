"""A link that carries less than is written, a reader whose loop is held up, questions right after a reconnection."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from aiorts import Kernel
from aiorts.links import Links
from campaign import CAMPAIGN, cases, time_limit
from network.linked_parts import Linked, assert_in_order, ended, settings, settled
from network.linked_program import Answers, Asks, Sink, Source
from network.network_parts import free_port
from network.proxy_parts import proxied

MEBI = 1 << 20
MEGABIT = 125_000
"""Bytes."""


def memory(one: Linked, what: str) -> int:
    """Bytes of a process that are in memory now, VmRSS, or were at the most, VmHWM."""
    lines = Path(f"/proc/{one.process.pid}/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) << 10 for line in lines if line.startswith(what))


@pytest.mark.slow(kept_by="links/test_simulated.py::test_where_the_newest_counts_each_comes_that_the_way_has_time_for")
@pytest.mark.fault("E07")
@pytest.mark.parametrize(("size", "every"), [(12_500, 0.01), (1_250, 0.001)], ids=["large", "small"])
def test_of_ten_megabit_on_a_link_of_one_the_newest_comes_soon_and_calls_are_answered(
    size: int, every: float, tmp_path: Path
) -> None:
    port = free_port()
    with proxied(port) as proxy:
        a = Linked(settings("a", sinks={"k": tmp_path / "k"}, listen=f"127.0.0.1:{port}"), tmp_path / "a.log")
        b = Linked(settings("b", sources=["s"], connect=proxy.address), tmp_path / "b.log")
        with ended(a, b):
            b.until(lambda seen: seen["peers"] == ["ha/a"])
            b.do("connect", source="s", to="ha/a/k.inp", push="new")
            b.do("connect", source="asks", to="ha/a/answers.service")
            b.up(2)
            proxy.rate = MEGABIT
            before = [memory(one, "VmRSS") for one in (a, b)]
            b.do("write", sources=["s"], every=every, size=size)
            b.do("ask", every=0.05)
            time.sleep(20.0 if CAMPAIGN else 5.0)
            calls, ages = b.do("asked"), a.do("look")["ages"]["k"]
            grown = [memory(one, "VmHWM") - was for one, was in zip((a, b), before, strict=True)]
            proxy.rate = 0.0
            b.do("halt")
            (ledger,) = settled(b).values()
    assert [fault for _, _, fault in calls if fault] == []
    took = sorted(seconds for _, seconds, _ in calls)
    ages.sort()
    print(
        f"calls {len(took)}: median {took[len(took) // 2]:.3f} s, p99 {took[len(took) * 99 // 100]:.3f} s, worst "
        f"{took[-1]:.3f} s; newest {len(ages)}: median {ages[len(ages) // 2]:.3f} s, worst {ages[-1]:.3f} s; "
        f"grown by {[one >> 10 for one in grown]} KiB; {ledger}"
    )
    assert len(took) > 10
    assert took[len(took) // 2] <= 1.0
    assert took[len(took) * 99 // 100] <= (1.0 if CAMPAIGN else 5.0)  # of few calls the worst, beside whatever runs
    assert len(ages) > 10
    assert ages[-1] <= 2.0
    assert max(grown) <= 32 * MEBI
    assert ledger["unexplained"] == 0
    assert ledger["dropped"].keys() == {"superseded"}
    assert ledger["dropped"]["superseded"] > ledger["delivered"]
    assert_in_order(tmp_path / "k")


@pytest.mark.slow(kept_by="network/test_network.py::test_what_is_beyond_the_bounds_is_left_out_and_counted")
@pytest.mark.fault("E24")
@pytest.mark.parametrize("options", [{"length": 1_000}, {"push": "new"}], ids=["all", "newest"])
def test_samples_that_flood_in_while_the_loop_is_held_up_take_little_memory(
    options: dict[str, Any], tmp_path: Path
) -> None:
    address = f"127.0.0.1:{free_port()}"
    names = [f"s{number}" for number in range(4)]
    a = Linked(settings("a", sinks={one: tmp_path / one for one in names}, listen=address), tmp_path / "a.log")
    b = Linked(settings("b", sources=names, connect=address), tmp_path / "b.log")
    with ended(a, b):
        b.until(lambda seen: seen["peers"] == ["ha/a"])
        for one in names:
            b.do("connect", source=one, to=f"ha/a/{one}.inp", **options)
        b.up(4)
        b.do("write", sources=names, every=0.0, size=1_024)
        a.until(lambda seen: all(count > 100 for count in seen["read"].values()))
        before = memory(a, "VmHWM")
        for _ in range(5 if CAMPAIGN else 2):
            a.do("block", seconds=2.5)
            time.sleep(0.5)
        grown = memory(a, "VmHWM") - before
        b.do("halt")
        ledgers, written = settled(b), b.do("look")["written"]
    print(f"grown by {grown >> 10} KiB; {ledgers}")
    assert grown <= 16 * MEBI
    for one in names:
        ledger = ledgers[f"{one}.out-ha/a/{one}.inp"]
        assert (ledger["unexplained"], ledger["written"]) == (0, written[one])
        assert sum(ledger["dropped"].values()) > 0
        assert_in_order(tmp_path / one)


async def until(holds: Callable[[], object]) -> None:
    async with asyncio.timeout(20.0):
        while not holds():
            await asyncio.sleep(0)


@pytest.mark.slow
@pytest.mark.fault("E23")
@pytest.mark.timeout(time_limit(900))
def test_nothing_is_said_to_be_absent_right_after_a_reconnection() -> None:
    rounds, port = cases(200), free_port()

    async def main(proxy: Any) -> None:
        far = {"zenoh": {"listen": f"127.0.0.1:{port}", "host": "far", "insecure": True}}
        near = {"zenoh": {"connect": proxy.address, "host": "near", "insecure": True}}
        async with Kernel("there", services=far) as there, Kernel("here", services=near) as here:
            for one in (Sink("sink"), Answers("answers")):
                await there.add(one)
            links = here.service(Links)
            await until(lambda: links.peers)
            for number in range(rounds):
                await asyncio.to_thread(proxy.cut)
                await until(lambda: not links.peers)
                await asyncio.to_thread(proxy.mend)
                await until(lambda: links.peers)  # and in this moment:
                source, asks = await here.add(Source(f"s{number}")), await here.add(Asks(f"a{number}"))
                connector = await here.connect(source.out, "far/there/sink.inp", allow_duplicate=True)
                await here.connect(asks.service, "far/there/answers.service")
                assert "absent" not in (state := links.report()[connector.name]), state
                assert "no component" not in state, state
                assert await asks.service.proxy.echo(number) == number
                await here.remove(source)
                await here.remove(asks)

    with proxied(port) as proxy:
        asyncio.run(main(proxy))
