"""A kernel that several transports find: it is one, has one name, and both ends go by the same transport."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.links import BaseTransport, Caller, Links, Peer
from aiorts.model.names import Path

PEER = Peer("hb", "other", 7)


class Finding(BaseTransport[Any]):
    """A transport that finds what the test says."""

    async def open(self, kernel: Any) -> None:
        self.begin(kernel)

    async def close(self) -> None:
        self.end_all()

    async def channel(self, offer: Any, events: Any) -> Any:
        raise AssertionError("no link is made here")

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        return b""


def played(play: Callable[[Links, Finding, Finding, list[tuple[Peer, bool]]], Awaitable[None]]) -> None:
    """Play with a kernel that has two transports: the general one, and one beside it."""

    async def main() -> None:
        async with Kernel("one") as kernel:
            links, general, beside = kernel.service(Links), Finding(), Finding()
            links.reach.host = "ha"
            links.use(general)
            await links.opened()
            await links.reach.carry(beside)
            told: list[tuple[Peer, bool]] = []
            tell = links.reach._tell
            links.reach._tell = lambda peer, up: (told.append((peer, up)), tell(peer, up))[1]
            await play(links, general, beside, told)

    asyncio.run(main())


def test_a_kernel_that_two_transports_find_is_one() -> None:
    async def play(links: Links, general: Finding, beside: Finding, told: list[tuple[Peer, bool]]) -> None:
        assert (general.own, general.own.host) == (beside.own, "ha")
        general.found(PEER)
        beside.found(PEER)
        assert (links.peers, told) == ((PEER,), [(PEER, True)])
        for host in ("", "hb/", "localhost/"):
            assert links.peer_of(Path.parse(f"{host}other/part.inp")) == PEER
        assert links.peer_of(Path.parse("hc/other/part.inp")) is None
        beside.lost(PEER, "is gone")
        assert told == [(PEER, True)]
        general.lost(PEER, "is gone")
        assert (links.peers, told[1:]) == ((), [(PEER, False)])

    played(play)


@pytest.mark.parametrize("general_first", [True, False])
def test_who_is_asked_goes_by_the_transport_that_brought_the_question_and_keeps_the_name(general_first: bool) -> None:
    """Each end may have found the other one first by another transport: a channel would be open at each."""

    async def play(links: Links, general: Finding, beside: Finding, told: list[tuple[Peer, bool]]) -> None:
        for transport in (general, beside) if general_first else (beside, general):
            transport.found(PEER)
        host = "" if general_first else "hb"
        assert (links.reach.carrier(PEER), links.reach.host_of(PEER)) == (general, host)
        good, _ = await beside.answer_to("come", b"part", Caller(PEER, "test"))
        assert good
        assert (links.reach.carrier(PEER), links.reach.host_of(PEER)) == (beside, host)
        assert told == [(PEER, True)]
        beside.lost(PEER, "is gone")
        assert told[1:] == [(PEER, False), (PEER, True)]
        assert links.reach.carrier(PEER) is general

    played(play)
