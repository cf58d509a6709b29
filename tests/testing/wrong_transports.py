"""Transports that break one promise each; the conformance suite must find every one of them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from aiorts.errors import LinkError, LinkTimeout
from aiorts.links import Caller, Channel, ChannelEvents, KernelFace, LinkOffer, Peer, Transport
from aiorts.testing import MemoryNetwork


class Passing:
    """A transport in memory whose channels are of `kind`."""

    kind: Callable[[Channel, ChannelEvents], Channel] = staticmethod(lambda channel, events: channel)

    def __init__(self, inner: Transport) -> None:
        self.inner = inner

    async def open(self, kernel: KernelFace) -> None:
        await self.inner.open(kernel)

    async def close(self) -> None:
        await self.inner.close()

    def presence(self, tell: Callable[[Peer, bool], None]) -> Callable[[], None]:
        return self.inner.presence(tell)

    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel:
        return self.kind(await self.inner.channel(offer, events), events)

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        return await self.inner.ask(peer, what, body, within=within)

    def answer(self, what: str, handler: Callable[[bytes, Caller], Awaitable[bytes]]) -> None:
        self.inner.answer(what, handler)


class PassingChannel:
    """Passes everything on."""

    def __init__(self, inner: Channel, events: ChannelEvents) -> None:
        self.inner, self.events = inner, events

    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        return self.inner.send(head, parts)

    def close(self) -> None:
        self.inner.close()


class _Blocking(PassingChannel):
    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        time.sleep(0.06)
        return self.inner.send(head, parts)


class _Endless(PassingChannel):
    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        self.inner.send(head, parts)
        return True


class _Eager(PassingChannel):
    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        taken = self.inner.send(head, parts)
        if not taken:
            self.events.on_room()
        return taken


class _Partless(PassingChannel):
    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        return self.inner.send(head)


class _Haunted(PassingChannel):
    def close(self) -> None:
        asyncio.get_running_loop().call_soon(self.events.on_room)
        self.inner.close()


class _Writable(Passing):
    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel:
        return await self.inner.channel(offer, _Unpacking(events))


class _Unpacking:
    """Gives frames in buffers that can be written to."""

    def __init__(self, events: ChannelEvents) -> None:
        self.events = events
        self.on_room, self.on_state = events.on_room, events.on_state

    def on_frames(self, frames: Sequence[tuple[Any, tuple[Any, ...]]]) -> None:
        self.events.on_frames([(bytearray(head), parts) for head, parts in frames])


class _Mixing(Passing):
    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel:
        both = self.__dict__.setdefault("both", [])
        both.append(events)
        return await self.inner.channel(offer, both[offer.number - 2] if len(both) == 2 else events)


class _Hanging(Passing):
    async def close(self) -> None:
        await self.inner.close()
        await asyncio.sleep(30.0)


class _Silent(Passing):
    def presence(self, tell: Callable[[Peer, bool], None]) -> Callable[[], None]:
        return self.inner.presence(lambda peer, up: tell(peer, up) if up else None)


class _Deaf(Passing):
    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel:
        quiet = _Unpacking(events)
        quiet.on_frames, quiet.on_state = events.on_frames, lambda up, why: None  # type: ignore[method-assign]
        return await self.inner.channel(offer, quiet)


class _Patient(Passing):
    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        return await self.inner.ask(peer, what, body, within=within + 3.0)


class _Secretive(Passing):
    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        try:
            return await self.inner.ask(peer, what, body, within=within)
        except LinkError as error:
            raise type(error)("it went wrong") from None


class _Behind(Passing):
    """Answers nothing while a channel is full."""

    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel:
        channel = await self.inner.channel(offer, events)
        self.__dict__.setdefault("full", [])
        return _Noting(channel, events, self.__dict__["full"])

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        if self.__dict__.get("full"):
            raise LinkTimeout(f"{peer.kernel}: behind samples")
        return await self.inner.ask(peer, what, body, within=within)


class _Noting(PassingChannel):
    def __init__(self, inner: Channel, events: ChannelEvents, full: list[bool]) -> None:
        super().__init__(inner, events)
        self.full = full

    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        taken = self.inner.send(head, parts)
        if not taken:
            self.full.append(True)
        return taken


class _Hopeful(Passing):
    """Waits for an answer of who has ended."""

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        try:
            return await self.inner.ask(peer, what, body, within=within)
        except LinkError:
            await asyncio.sleep(within)
            raise


def _of(channel: Callable[[Channel, ChannelEvents], Channel]) -> type[Passing]:
    return type(channel.__name__, (Passing,), {"kind": staticmethod(channel)})


def pair_of(kind: Callable[[Transport], Transport]) -> Callable[[], tuple[Transport, Transport]]:
    """Makes pairs of such transports."""

    def make_pair() -> tuple[Transport, Transport]:
        network = MemoryNetwork()
        return kind(network.transport("one")), kind(network.transport("two"))

    return make_pair


WRONG_TRANSPORTS: dict[str, tuple[type[Passing], str]] = {
    "its send blocks": (_of(_Blocking), "never_blocks"),
    "it takes frames without end": (_of(_Endless), "never_blocks"),
    "it calls inside send": (_of(_Eager), "never_blocks"),
    "it loses what travels beside a frame": (_of(_Partless), "carries_frames_whole"),
    "its buffers can be written to": (_Writable, "carries_frames_whole"),
    "it calls after close": (_of(_Haunted), "is_silent_when_closed"),
    "it mixes up channels": (_Mixing, "keeps_channels_apart"),
    "it never tells that a kernel has ended": (_Silent, "finds_the_other_kernel"),
    "it never tells that a channel is down": (_Deaf, "tells_of_the_end"),
    "it waits longer than it may": (_Patient, "keeps_to_its_time"),
    "it does not say why": (_Secretive, "answers_questions"),
    "its answers wait behind samples": (_Behind, "answers_beside_samples"),
    "it waits for who has ended": (_Hopeful, "fails_what_is_not_answered"),
    "it hangs in close": (_Hanging, "ends_in_time"),
}
"""Each with the check that must find it."""
