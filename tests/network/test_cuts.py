"""Links between hosts that are cut, in both directions or one, and come back: nothing is lost uncounted, or doubled."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.types import TimedLong
from aiorts_zenoh import NetworkSettings, ZenohTransport
from aiorts_zenoh.network import engine_settings
from campaign import CAMPAIGN, time_limit
from network.host_parts import wire_of
from network.linked_parts import LEASE, Linked, assert_in_order, came, changed, ended, settings, settled
from network.network_parts import free_port
from network.proxy_parts import Proxy, Way, proxied

DOWN = 1.25 * LEASE + 1.0
"""Seconds until a cut is noticed: a lease, a sign of life that is not taken any more, and a moment for the rest."""
AGAIN = 5.0
"""Seconds until links are up again when there is a network again."""
POLICIES: dict[str, dict[str, Any]] = {
    "block": {"full": "block", "timeout": None},
    "flush": {"subscription": "flush", "full": "block", "timeout": None},
    "short": {"length": 20},
    "newest": {"push": "new"},
}
"""One connector each, from `b` to `a`."""


def pair(tmp_path: Path, listen: str, connect: str, before: tuple[list[str], list[str]] = ([], [])) -> tuple[Any, Any]:
    """Two kernels with a connector of each policy, all up and written to 200 times a second."""
    sinks = {name: tmp_path / name for name in POLICIES}
    a = Linked(settings("a", sinks=sinks, listen=listen), tmp_path / "a.log", before[0])
    b = Linked(settings("b", sources=[*POLICIES], connect=connect), tmp_path / "b.log", before[1])
    return a, b


def connected(a: Linked, b: Linked) -> None:
    a.until(lambda seen: seen["peers"] == ["hb/b"])
    for name, options in POLICIES.items():
        b.do("connect", source=name, to=f"ha/a/{name}.inp", **options)
    b.up(4)
    b.do("write", sources=[*POLICIES], every=0.005)
    b.until(lambda seen: all(count > 100 for count in seen["written"].values()))


def nothing_unexplained(tmp_path: Path, a: Linked, b: Linked) -> dict[str, Any]:
    """Write no more; the ledgers when all has come, which say what was written and what was read."""
    written, read = b.do("halt")["written"], {}
    ledgers = settled(b)
    read = a.do("look")["read"]
    for name in POLICIES:
        ledger = ledgers[f"{name}.out-ha/a/{name}.inp"]
        assert (ledger["unexplained"], ledger["written"]) == (0, written[name]), (name, ledger)
        assert ledger["delivered"] == read[name], (name, ledger)
        assert_in_order(tmp_path / name)
    for name in ("block", "flush"):
        assert read[name] == written[name], (ledgers, b.said, a.said, b.do("look"))
    return ledgers


def down_and_said(one: Linked, since: float, count: int = 4) -> list[float]:
    """After how many seconds each link of a kernel was down, which it has said of each."""
    found = changed(one.do("look"), since, "down")
    assert len(found) == count, found
    assert one.said.count("lost the link") >= count, one.said
    return sorted(found.values())


@pytest.fixture
def wired(hosts: tuple[list[str], list[str]]) -> tuple[tuple[list[str], list[str]], Any]:
    """Two hosts, and what takes the network device of the second one up or down."""
    return hosts, wire_of(hosts[1])


@pytest.mark.slow(kept_by="test_both_ends_see_that_there_is_no_way_and_go_on_when_there_is_one")
@pytest.mark.fault("E02", "E03")
@pytest.mark.parametrize("connects", [0, 1], ids=["who listens", "who connects"])
@pytest.mark.timeout(time_limit(300))
def test_a_network_that_goes_down_and_comes_back(wired: Any, connects: int, tmp_path: Path) -> None:
    """Of one end it is known at once that there is no way, of the other it is not."""
    hosts, set_to = wired
    at = f"10.77.0.{2 - connects}:7447"
    a, b = pair(tmp_path, at, at, (hosts[1 - connects], hosts[connects]))
    with ended(a, b):
        connected(a, b)
        for pause in (5.0, 60.0) if CAMPAIGN else (5.0,):
            cut = set_to("down")
            time.sleep(max(pause, DOWN))
            before = b.do("look")
            for one in (a, b):
                assert down_and_said(one, cut)[-1] <= DOWN
            for name in ("block", "flush"):  # nobody has let go of what waits
                assert not before["counts"][f"{name}.out-ha/a/{name}.inp"]["dropped"]
            assert before["counts"]["short.out-ha/a/short.inp"]["dropped"] != {}
            again = set_to("up")
            b.up(4)
            a.up(4)
            for one in (a, b):
                assert max(changed(one.do("look"), again, "up").values()) <= AGAIN
            time.sleep(1.0)
        ledgers = nothing_unexplained(tmp_path, a, b)
        assert ledgers["short.out-ha/a/short.inp"]["dropped"].keys() == {"overwritten"}


@pytest.fixture
def through(tmp_path: Path) -> Iterator[tuple[Linked, Linked, Proxy]]:
    """Two kernels with a proxy between them."""
    port = free_port()
    with proxied(port) as proxy:
        a, b = pair(tmp_path, f"127.0.0.1:{port}", proxy.address)
        with ended(a, b):
            connected(a, b)
            yield a, b, proxy


@pytest.mark.slow(kept_by="test_both_ends_see_that_there_is_no_way_and_go_on_when_there_is_one")
@pytest.mark.fault("E04")
@pytest.mark.parametrize("way", ["there", "back"])
def test_a_network_that_carries_one_way_alone_is_none(
    through: tuple[Linked, Linked, Proxy], way: Way, tmp_path: Path
) -> None:
    a, b, proxy = through
    proxy.hold(way)
    cut = time.monotonic()
    time.sleep(2 * LEASE)
    for one in (a, b):
        assert down_and_said(one, cut)[-1] <= 2 * LEASE
        assert one.do("look")["peers"] == []
    proxy.release()
    released = time.monotonic()
    a.up(4)
    b.up(4)
    assert time.monotonic() - released < AGAIN
    time.sleep(1.0)
    nothing_unexplained(tmp_path, a, b)


@pytest.mark.slow(
    kept_by="links/test_apart.py::test_what_its_kernel_disconnects_while_there_is_no_way_ends_at_the_other_end_when_there_is"
)
@pytest.mark.fault("E05")
def test_what_both_sides_change_while_they_are_apart_is_the_truth_of_both_afterwards(
    through: tuple[Linked, Linked, Proxy], tmp_path: Path
) -> None:
    a, b, proxy = through
    proxy.hold("there", "back")
    a.until(lambda seen: seen["peers"] == [])
    b.until(lambda seen: seen["peers"] == [])
    a.do("remove", name="short")
    a.do("sink", name="later", file=str(tmp_path / "later"))
    b.do("disconnect", name="newest.out-ha/a/newest.inp")
    b.do("connect", source="newest", to="ha/a/later.inp", length=5)
    proxy.release()
    released = time.monotonic()
    there = {"block", "flush", "later"}

    def states(seen: dict[str, Any]) -> dict[str, str]:
        return {name.rpartition("/")[2]: state for name, state in seen["states"].items()}

    of_writer = b.until(
        lambda seen: (
            {name: state for name, state in states(seen).items() if state == "up"}
            == {f"{name}.inp": "up" for name in there}
            and "no component" in states(seen).get("short.inp", "")
        )
    )
    of_reader = a.until(lambda seen: {*seen["states"].values()} == {"up"} and len(seen["states"]) == 3)
    assert time.monotonic() - released < AGAIN
    assert len(of_writer["states"]) == 4  # the one to a component that was removed waits for it
    assert {name.rpartition("-")[2] for name in of_reader["states"]} == {f"{name}.inp" for name in there}
    b.do("disconnect", name="short.out-ha/a/short.inp")
    b.do("halt")
    for ledger in settled(b).values():
        assert ledger["unexplained"] == 0
    for name in there:
        assert_in_order(tmp_path / name)


@pytest.mark.slow(kept_by="links/test_protocol.py::test_any_order_of_faults_leaves_nothing_unexplained")
@pytest.mark.fault("E08")
def test_a_network_that_delays_stalls_and_breaks_off_doubles_and_reorders_nothing(
    through: tuple[Linked, Linked, Proxy], tmp_path: Path
) -> None:
    a, b, proxy = through
    chance = random.Random(8)
    for _ in range(30 if CAMPAIGN else 6):
        proxy.delay = chance.choice((0.0, 0.05, 0.2))
        time.sleep(chance.uniform(0.3, 1.0))
        proxy.hold(*chance.choice((("there",), ("back",), ("there", "back"))))
        time.sleep(chance.uniform(0.1, 0.6))
        if chance.random() < 0.6:
            proxy.cut()
            time.sleep(chance.uniform(0.0, 0.5))
            proxy.mend()
        proxy.release()
    proxy.delay = 0.0
    b.up(4)
    nothing_unexplained(tmp_path, a, b)
    assert sum(len(numbers) for numbers in came(tmp_path / "block").values()) > 500


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("E02", "E03", "E04")
@pytest.mark.parametrize("ways", [("there",), ("back",), ("there", "back")], ids=" and ".join)
def test_both_ends_see_that_there_is_no_way_and_go_on_when_there_is_one(ways: tuple[Way, ...]) -> None:
    """The same with a lease so short that it takes a second."""

    async def until(holds: Callable[[], bool]) -> None:
        async with asyncio.timeout(10.0):
            while not holds():
                await asyncio.sleep(0.005)

    async def main(port: int, proxy: Proxy) -> list[int]:
        ends = {"far": {"listen": f"127.0.0.1:{port}"}, "near": {"connect": proxy.address}}
        async with Kernel("there") as there, Kernel("here") as here:
            for kernel, (host, end) in zip((there, here), ends.items(), strict=True):
                engine = {**engine_settings(NetworkSettings(insecure=True, **end)), "transport/link/tx/lease": 200}
                await kernel.service(Links).reach.carry(ZenohTransport(host, engine=engine))
            source, sink = await here.add(Source("source")), await there.add(Sink("sink"))
            await until(lambda: bool(here.service(Links).peers and there.service(Links).peers))
            connector = await here.connect(source.out, "far/there/sink.inp", full="block", timeout=None, length=10)
            source.out.write_nowait(TimedLong(0, 0))
            await until(lambda: sink.inp.is_new)
            proxy.hold(*ways)
            source.out.write_nowait(TimedLong(0, 1))
            links = [here.service(Links), there.service(Links)]
            await until(lambda: all(next(iter(one.report().values())).startswith("down: ") for one in links))
            assert [one.peers for one in links] == [(), ()]
            source.out.write_nowait(TimedLong(0, 2))
            proxy.release()
            await until(lambda: connector.statistics.acknowledged == 3)
            ledger = await links[0].ledger(connector)
            assert (ledger.unexplained, ledger.dropped) == (0, {})
            return [sample.data for sample in sink.inp.drain()]

    with proxied(port := free_port()) as proxy:
        assert asyncio.run(main(port, proxy)) == [0, 1, 2]
