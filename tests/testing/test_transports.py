"""The conformance suite of transports, and the network in memory whose faults are asked for."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import LinkError, LinkTimeout
from aiorts.links import Caller, Channel, LinkOffer, Peer, Transport
from aiorts.model.names import Path
from aiorts.model.profile import ConnectorProfile
from aiorts.testing import TRANSPORT_CHECKS, ConformanceError, MemoryNetwork, check_transport, simulate
from testing.wrong_transports import WRONG_TRANSPORTS, Passing, pair_of


def quiet() -> tuple[Transport, Transport]:
    network = MemoryNetwork()
    return network.transport("one"), network.transport("two")


def faulty() -> tuple[Transport, Transport]:
    network = MemoryNetwork(3, loss=0.3, duplicate=0.3, reorder=0.3, delay=0.005)
    return network.transport("one"), network.transport("two")


@pytest.mark.parametrize("name", TRANSPORT_CHECKS)
@pytest.mark.parametrize("make_pair", [quiet, faulty, pair_of(Passing)], ids=["quiet", "faulty", "passing"])
def test_transport_in_memory_keeps_every_promise(
    make_pair: Callable[[], tuple[Transport, Transport]], name: str
) -> None:
    check_transport(make_pair, simulated=True, only=[name])


@pytest.mark.parametrize("name", [name for name in TRANSPORT_CHECKS if name != "never_blocks"])
def test_transport_in_memory_keeps_every_promise_in_real_time(name: str) -> None:
    check_transport(quiet, only=[name])


@pytest.mark.parametrize("what", WRONG_TRANSPORTS)
def test_wrong_transport_is_refused_by_the_check_of_that_promise(what: str) -> None:
    kind, name = WRONG_TRANSPORTS[what]
    with pytest.raises(ConformanceError) as caught:
        check_transport(pair_of(kind), simulated=True, only=[name])
    assert caught.value.check == name


class Face:
    def __init__(self, name: str, epoch: int = 1) -> None:
        self.name, self.epoch = name, epoch

    def run_in_background(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        return asyncio.get_running_loop().create_task(coroutine, name=name)

    def report(self, text: str) -> None:
        raise AssertionError(text)


class End:
    """One end of a channel, and when each frame came."""

    def __init__(self) -> None:
        self.channel: Channel
        self.came: list[tuple[float, int]] = []
        self.calls: list[int] = []
        self.rooms = 0
        self.downs: list[str] = []

    def on_frames(self, frames: Sequence[tuple[Any, tuple[Any, ...]]]) -> None:
        now = round(asyncio.get_running_loop().time(), 6)
        self.calls.append(len(frames))
        self.came += [(now, int.from_bytes(head[:4], "little")) for head, _ in frames]

    def on_room(self) -> None:
        self.rooms += 1

    def on_clock(self, ahead_ns: int, within_ns: int) -> None:
        pass

    def on_state(self, up: bool, why: str) -> None:
        self.downs.append(why)

    def send(self, number: int, size: int = 4) -> bool:
        return self.channel.send(number.to_bytes(4, "little") + bytes(size - 4))

    @property
    def numbers(self) -> list[int]:
        return [number for _, number in self.came]


OFFER = LinkOffer(
    *((1, 1), "link", Path("a", "out", "one"), Path("b", "inp", "two"), 1, 1, 1, b"", "", None, None),
    *(ConnectorProfile("link"), 256, 1 << 20),
)


class Stage:
    """Two kernels on a network, and what each was told of the other."""

    def __init__(self, network: MemoryNetwork) -> None:
        self.network = network
        self.one, self.two = network.transport("one"), network.transport("two")
        self.told: list[tuple[str, int, bool]] = []
        self.peers: list[Peer] = []

    def tell(self, peer: Peer, up: bool) -> None:
        self.told.append((peer.kernel, peer.epoch, up))
        self.peers.append(peer)

    async def open(self) -> None:
        await self.one.open(Face("one"))
        self.one.presence(self.tell)
        await self.two.open(Face("two"))
        await asyncio.sleep(0.001)

    async def ends(self) -> tuple[End, End]:
        ends = End(), End()
        ends[0].channel = await self.one.channel(OFFER, ends[0])
        ends[1].channel = await self.two.channel(OFFER, ends[1])
        return ends


def staged(network: MemoryNetwork, play: Callable[[Stage], Awaitable[None]]) -> None:
    """Play with an open stage in virtual time."""

    async def main() -> None:
        stage = Stage(network)
        await stage.open()
        await play(stage)
        await stage.one.close()
        await stage.two.close()

    simulate(main())


def sent(network: MemoryNetwork, count: int = 1_000) -> list[int]:
    """The numbers that arrive when so many are sent, one each millisecond."""
    arrived: list[int] = []

    async def play(stage: Stage) -> None:
        writer, reader = await stage.ends()
        for number in range(count):
            assert writer.send(number)
            await asyncio.sleep(0.001)
        await asyncio.sleep(1.0)
        arrived.extend(reader.numbers)

    staged(network, play)
    return arrived


def test_without_faults_everything_comes_in_order() -> None:
    assert sent(MemoryNetwork()) == list(range(1_000))


def test_loss_is_the_share_that_never_comes() -> None:
    arrived = sent(MemoryNetwork(1, loss=0.2))
    assert arrived == sorted(set(arrived))
    assert 750 <= len(arrived) <= 850


def test_duplicate_is_the_share_that_comes_twice() -> None:
    arrived = Counter(sent(MemoryNetwork(1, duplicate=0.2)))
    assert arrived.keys() == set(range(1_000))
    assert 150 <= sum(1 for times in arrived.values() if times == 2) <= 250
    assert max(arrived.values()) == 2


def test_reorder_is_the_share_that_others_overtake() -> None:
    arrived = sent(MemoryNetwork(1, reorder=0.2))
    assert sorted(arrived) == list(range(1_000))
    late = sum(1 for before, after in pairwise(arrived) if after < before)
    assert 100 <= late <= 250
    assert max(place - number for place, number in enumerate(arrived)) <= 20


def test_the_same_seed_makes_the_same_faults() -> None:
    faults = {"loss": 0.1, "duplicate": 0.1, "reorder": 0.1}
    assert sent(MemoryNetwork(5, **faults), 200) == sent(MemoryNetwork(5, **faults), 200)
    assert sent(MemoryNetwork(5, **faults), 200) != sent(MemoryNetwork(6, **faults), 200)


@settings(max_examples=10, deadline=None)
@given(
    seed=st.integers(0, 1_000),
    faults=st.fixed_dictionaries({key: st.sampled_from([0.0, 0.3, 1.0]) for key in ("loss", "duplicate", "reorder")}),
    delay=st.sampled_from([0.0, 0.005]),
)
def test_whatever_the_faults_nothing_comes_that_was_not_sent(seed: int, faults: dict[str, float], delay: float) -> None:
    arrived = Counter(sent(MemoryNetwork(seed, **faults, delay=delay), 30))
    assert arrived.keys() <= set(range(30))
    assert max(arrived.values(), default=0) <= (2 if faults["duplicate"] else 1)
    if not faults["loss"]:
        assert arrived.keys() == set(range(30))
    if faults["loss"] == 1.0:
        assert not arrived


def test_delay_is_exact_and_frames_of_one_moment_come_in_one_call() -> None:
    async def play(stage: Stage) -> None:
        writer, reader = await stage.ends()
        began = asyncio.get_running_loop().time()
        for number in range(10):
            writer.send(number)
        await asyncio.sleep(0.5)
        assert {round(when - began, 6) for when, _ in reader.came} == {0.25}
        assert reader.calls == [10]

    staged(MemoryNetwork(delay=0.25), play)


def test_a_cut_ends_channels_and_questions_and_loses_what_is_under_way() -> None:
    async def play(stage: Stage) -> None:
        async def never(body: bytes, caller: Caller) -> bytes:
            raise AssertionError("the question was under way")

        stage.two.answer("never", never)
        writer, reader = await stage.ends()
        asked = asyncio.ensure_future(stage.one.ask(stage.peers[0], "never", b"", within=9.0))
        writer.send(1)
        await asyncio.sleep(0.05)
        stage.network.cut("one", "two")
        assert not writer.send(2)
        await asyncio.sleep(1.0)
        assert writer.downs == ["two: the connection is cut"]
        assert reader.downs == ["one: the connection is cut"]
        assert reader.came == []
        with pytest.raises(LinkError, match=r"two: the connection is cut"):
            await asked
        with pytest.raises(LinkError, match=r"two: is gone"):
            await stage.one.channel(OFFER, End())
        stage.network.restore("two", "one")
        await asyncio.sleep(0.05)
        assert stage.told == [("two", 1, True), ("two", 1, False), ("two", 1, True)]
        writer, reader = await stage.ends()
        writer.send(3)
        await asyncio.sleep(1.0)
        assert reader.numbers == [3]

    staged(MemoryNetwork(delay=0.1), play)


@pytest.mark.parametrize("stopped", ["one", "two"])
def test_a_kernel_that_is_stopped_gets_and_sends_nothing_until_it_goes_on(stopped: str) -> None:
    async def play(stage: Stage) -> None:
        async def echo(body: bytes, caller: Caller) -> bytes:
            return body

        stage.two.answer("echo", echo)
        writer, reader = await stage.ends()
        stage.network.stop(stopped)
        for number in range(5):
            writer.send(number)
        reader.send(9)
        with pytest.raises(LinkTimeout, match=r"two: no answer within 3 s"):
            await stage.one.ask(stage.peers[0], "echo", b"x", within=3.0)
        assert (writer.came, reader.came, writer.downs, reader.downs) == ([], [], [], [])
        stage.network.go(stopped)
        await asyncio.sleep(0.1)
        assert (writer.numbers, reader.numbers) == ([9], [0, 1, 2, 3, 4])
        assert await stage.one.ask(stage.peers[0], "echo", b"x", within=3.0) == b"x"

    staged(MemoryNetwork(), play)


def test_a_stopped_kernel_hears_of_a_cut_when_it_goes_on() -> None:
    async def play(stage: Stage) -> None:
        writer, reader = await stage.ends()
        stage.network.stop("one")
        stage.network.cut("one", "two")
        await asyncio.sleep(1.0)
        assert (writer.downs, reader.downs) == ([], ["one: the connection is cut"])
        stage.network.restore("one", "two")
        await asyncio.sleep(1.0)
        assert stage.told == [("two", 1, True)]
        stage.network.go("one")
        await asyncio.sleep(0.1)
        assert writer.downs == ["two: the connection is cut"]
        assert stage.told == [("two", 1, True), ("two", 1, False), ("two", 1, True)]

    staged(MemoryNetwork(), play)


def test_a_channel_takes_a_megabyte_and_says_when_there_is_room() -> None:
    async def play(stage: Stage) -> None:
        writer, reader = await stage.ends()
        stage.network.stop("two")
        taken = 0
        while writer.send(taken, 65_536):
            taken += 1
        assert taken == 17
        await asyncio.sleep(1.0)
        assert writer.rooms == 0
        stage.network.go("two")
        await asyncio.sleep(1.0)
        assert (writer.rooms, reader.numbers) == (1, list(range(17)))
        assert writer.send(17)

    staged(MemoryNetwork(), play)


def test_a_kernel_that_is_started_anew_is_another_peer() -> None:
    async def play(stage: Stage) -> None:
        await stage.two.close()
        stage.two = stage.network.transport("two")
        await stage.two.open(Face("two", 2))
        await asyncio.sleep(0.1)
        assert stage.told == [("two", 1, True), ("two", 1, False), ("two", 2, True)]
        with pytest.raises(LinkError, match=r"two: is gone"):
            await stage.one.ask(stage.peers[0], "echo", b"", within=1.0)

    staged(MemoryNetwork(), play)


def test_a_name_belongs_to_one_kernel() -> None:
    async def play(stage: Stage) -> None:
        with pytest.raises(LinkError, match=r"a kernel named 'two' runs already; give this one another name"):
            await stage.network.transport("two").open(Face("two"))
        with pytest.raises(LinkError, match=r"the transport of 'three' was given to the kernel 'four'"):
            await stage.network.transport("three").open(Face("four"))

    staged(MemoryNetwork(), play)


def test_a_thousand_questions_wait_and_no_more() -> None:
    async def play(stage: Stage) -> None:
        stage.network.stop("two")
        asked = [asyncio.ensure_future(stage.one.ask(stage.peers[0], "x", b"", within=1.0)) for _ in range(1_000)]
        await asyncio.sleep(0.1)
        with pytest.raises(LinkError, match=r"two: 1000 questions are not answered yet"):
            await stage.one.ask(stage.peers[0], "x", b"", within=1.0)
        results = await asyncio.gather(*asked, return_exceptions=True)
        assert {type(result) for result in results} == {LinkTimeout}
        stage.network.go("two")

    staged(MemoryNetwork(), play)
