"""What the base class of transports promises, held by each of them: peers, channels, questions, and how all end."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Coroutine
from importlib.util import find_spec
from typing import Any

import pytest

from aiorts.errors import LinkError, LinkTimeout
from aiorts.links import BaseTransport, Caller, LinkOffer, Peer, Transport, UnixTransport
from aiorts.model.names import Path
from aiorts.model.profile import ConnectorProfile
from aiorts.testing import MemoryNetwork, check_transport

WAIT = 20.0
Pair = tuple[Transport, Transport]


def sockets() -> Pair:
    return UnixTransport(), UnixTransport()


def memory() -> Pair:
    network = MemoryNetwork()
    return network.transport("one"), network.transport("two")


def zenoh() -> Pair:
    pytest.importorskip("zenoh")
    from network.network_parts import loopback

    return loopback()


class Face:
    """A kernel, as far as a transport sees it."""

    host = "here"

    def __init__(self, name: str, epoch: int) -> None:
        self.name, self.epoch = name, epoch

    def run_in_background(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        return asyncio.get_running_loop().create_task(coroutine, name=name)

    def report(self, text: str) -> None:
        raise AssertionError(text)


class End:
    """The end of a link: why it went down."""

    def __init__(self) -> None:
        self.downs: list[str] = []

    def on_frames(self, frames: Any) -> None:
        """What comes is not looked at."""

    def on_room(self) -> None:
        """It sends nothing."""

    def on_clock(self, ahead_ns: int, within_ns: int) -> None:
        """It has no stamps."""

    def on_state(self, up: bool, why: str) -> None:
        self.downs.append(why)


def offer(number: int) -> LinkOffer:
    ends = Path("a", "out", "one"), Path("b", "inp", "two")
    return LinkOffer((1, 1), "link", *ends, 1, 1, number, b"", "", None, None, ConnectorProfile("link"), 256, 1 << 20)


async def until(holds: Callable[[], object]) -> None:
    async with asyncio.timeout(WAIT):
        while not holds():
            await asyncio.sleep(0.005)


def played(make_pair: Callable[[], Pair], play: Callable[[Any, Any], Awaitable[None]]) -> None:
    """Play with two open transports that have found each other."""

    async def main() -> None:
        one, two = make_pair()
        try:
            for transport, face in ((one, Face("one", 11)), (two, Face("two", 22))):
                assert isinstance(transport, BaseTransport)
                await transport.open(face)
                transport.presence(lambda _peer, _up: None)
            await until(lambda: one.peers and two.peers)  # type: ignore[attr-defined]
            await play(one, two)
        finally:
            await one.close()
            await two.close()

    asyncio.run(main())


@pytest.fixture(scope="session", autouse=True)
def _engine_is_there() -> None:
    """Its own threads and descriptors live as long as the process: they are made before a test counts."""
    if find_spec("zenoh"):
        check_transport(zenoh, only=["answers_questions"])


transports = pytest.mark.parametrize("make_pair", [sockets, memory, zenoh])


@transports
def test_who_watches_hears_of_each_peer_once_until_it_watches_no_more(make_pair: Callable[[], Pair]) -> None:
    async def play(one: Any, two: Any) -> None:
        told: list[tuple[str, int, bool]] = []
        undo = one.presence(lambda peer, up: told.append((peer.kernel, peer.epoch, up)))
        one.presence(lambda peer, up: told.append((peer.kernel, peer.epoch, up)))()
        assert one.is_watched
        assert [peer.kernel for peer in one.peers] == ["two"]
        assert told == [("two", 22, True), ("two", 22, True)]
        await two.close()
        await until(lambda: not one.peers)
        assert told[2:] == [("two", 22, False)]
        undo()
        undo()

    played(make_pair, play)


@transports
def test_a_peer_that_goes_ends_its_channels_and_fails_its_questions_with_a_reason(
    make_pair: Callable[[], Pair],
) -> None:
    async def play(one: Any, two: Any) -> None:
        asked = asyncio.Event()

        async def never(body: bytes, caller: Caller) -> bytes:
            asked.set()
            await asyncio.Event().wait()
            return body

        two.answer("never", never)
        peer, ends = one.peers[0], [End(), End(), End()]
        channels = [await one.channel(offer(number), end) for number, end in enumerate(ends)]
        channels[2].close()
        question = asyncio.ensure_future(one.ask(peer, "never", b"", within=WAIT))
        await asked.wait()
        await two.close()
        with pytest.raises(LinkError, match=r"^two: ") as caught:
            await asyncio.wait_for(question, WAIT)
        assert not isinstance(caught.value, LinkTimeout)
        await until(lambda: ends[0].downs and ends[1].downs)
        assert [len(end.downs) for end in ends] == [1, 1, 0]
        assert ends[0].downs[0].startswith("two: ")
        assert not one.channels
        assert not channels[0].send(b"x")
        with pytest.raises(LinkError, match="two: is gone"):
            await one.ask(peer, "never", b"", within=WAIT)
        with pytest.raises(LinkError, match="two: is gone"):
            await one.channel(offer(1), End())

    played(make_pair, play)


@transports
def test_of_two_channels_of_one_number_the_newer_one_is_open(make_pair: Callable[[], Pair]) -> None:
    async def play(one: Any, two: Any) -> None:
        older, newer = await one.channel(offer(1), End()), await one.channel(offer(1), End())
        assert (older.is_open, newer.is_open) == (False, True)
        older.close()
        assert list(one.channels.values()) == [newer]
        newer.close()
        newer.close()
        assert not one.channels

    played(make_pair, play)


@pytest.mark.parametrize("make_pair", [sockets, memory])  # the other end of the engine stands still in the same loop
def test_an_answer_that_came_while_this_end_stood_still_counts(make_pair: Callable[[], Pair]) -> None:
    """Its time is over when it goes on, and the answer lies there unread: a time-out would be for nothing."""

    async def play(one: Any, two: Any) -> None:
        async def echo(body: bytes, caller: Caller) -> bytes:
            return body

        two.answer("echo", echo)
        await one.ask(one.peers[0], "echo", b"a", within=WAIT)
        question = asyncio.ensure_future(one.ask(one.peers[0], "echo", b"b", within=0.05))
        await asyncio.sleep(0)
        asyncio.get_running_loop().call_soon(time.sleep, 0.1)
        assert await question == b"b"

    played(make_pair, play)


@transports
def test_only_who_was_asked_answers(make_pair: Callable[[], Pair]) -> None:
    async def play(one: Any, two: Any) -> None:
        peer = one.peers[0]

        async def echo(body: bytes, caller: Caller) -> bytes:
            one.settle(Peer("here", "mallory", 1), number, True, b"of another")
            one.settle(peer, number + 1, True, b"of another question")
            return body

        two.answer("echo", echo)
        number = one._last + 1
        assert await one.ask(peer, "echo", b"mine", within=WAIT) == b"mine"
        assert not one.is_awaited(number)

    played(make_pair, play)
