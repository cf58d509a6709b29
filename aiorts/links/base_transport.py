"""The base class of transports: the peers that were found, and the channels and questions with each of them.

A transport finds and greets peers in its own way. From then on the same holds for all: a callback hears of each peer
once when it comes and once when it goes; a peer that goes takes its channels and open questions with it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Hashable
from typing import Final, Generic, TypeVar

from aiorts.errors import LinkError, LinkTimeout
from aiorts.links.transport import Caller, ChannelEvents, KernelFace, LinkOffer, Peer, answer_of

_LONGEST: Final = 2_000
"""Bytes of a refusal."""
_NUMBERS: Final = 0xFFFFFFFF
_LOOKS: Final = 2
"""Turns of the loop after which an answer that lay in the socket is handled."""

Handler = Callable[[bytes, Caller], Awaitable[bytes]]


class BaseChannel:
    """One end of a link, as a transport keeps it until it is closed. See `Channel`.

    Args:
        peer: the kernel of the other end.
        events: the end of the link.
        closed: called once when it is closed, or its peer has gone.
    """

    def __init__(self, peer: Peer, events: ChannelEvents, closed: Callable[[], object]) -> None:
        self.peer, self.events = peer, events
        self._closed = closed
        self.is_open = True

    def on_room(self) -> None:
        """Tell the end of the link that frames are taken again, unless it was closed."""
        if self.is_open:
            self.events.on_room()

    def lost(self, why: str) -> None:
        """Close it, and tell the end of the link why, unless it was closed."""
        if self.is_open:
            self.close()
            self.events.on_state(False, why)

    def close(self) -> None:
        """Give it up; nothing is called any more. Idempotent."""
        if self.is_open:
            self.is_open = False
            self._closed()


C = TypeVar("C", bound=BaseChannel)


class BaseTransport(Generic[C]):
    """The peers of one transport, its channels and its questions. A transport derives from it, and finds peers.

    It calls `begin` when it is opened, `found` and `lost` as peers come and go, `settle` with each answer, and
    `end_all` when it is closed.
    """

    kernel: KernelFace
    """The kernel that it was opened for."""
    loop: asyncio.AbstractEventLoop

    def __init__(self) -> None:
        self.channels: dict[Hashable, C] = {}
        """The open channels by the transport's own key, such as peer, direction and number."""
        self._there: dict[Peer, None] = {}
        self._tells: list[Callable[[Peer, bool], None]] = []
        self._handlers: dict[str, Handler] = {}
        self._questions: dict[int, tuple[Peer, asyncio.Future[bytes]]] = {}
        self._last = 0

    def begin(self, kernel: KernelFace) -> None:
        """Be the transport of this kernel, on the loop that runs."""
        self.kernel, self.loop = kernel, asyncio.get_running_loop()

    @property
    def own(self) -> Peer:
        """This kernel, as its peers know it."""
        return Peer(self.kernel.host, self.kernel.name, self.kernel.epoch)

    def end_all(self) -> None:
        """Tell nothing any more, close all channels, and fail all questions."""
        self._tells.clear()
        for channel in tuple(self.channels.values()):
            channel.close()
        for peer, _ in tuple(self._questions.values()):
            self.fail(peer, "this kernel ends")
        self._there.clear()

    # -- peers -----------------------------------------------------------------------------------------------------

    @property
    def peers(self) -> tuple[Peer, ...]:
        """The kernels that are there, in the order in which they were found."""
        return tuple(self._there)

    @property
    def is_watched(self) -> bool:
        """Whether a callback is told of peers."""
        return bool(self._tells)

    def presence(self, tell: Callable[[Peer, bool], None]) -> Callable[[], None]:
        """Tell of each kernel that is there or comes, and of each that goes; until the returned function is called."""
        self._tells.append(tell)
        for peer in self.peers:
            tell(peer, True)
        return lambda: self._tells.remove(tell) if tell in self._tells else None

    def found(self, peer: Peer) -> None:
        """A kernel has said who it is, and can be asked from now on."""
        self._there[peer] = None
        for tell in tuple(self._tells):
            tell(peer, True)

    def lost(self, peer: Peer, why: str) -> None:
        """A kernel is gone: all callbacks are told, its questions fail, and its channels end, for this reason."""
        if peer not in self._there:
            return
        del self._there[peer]
        for tell in tuple(self._tells):
            tell(peer, False)
        self.fail(peer, why)
        for channel in [one for one in self.channels.values() if one.peer == peer]:
            channel.lost(f"{peer.kernel}: {why}")

    def check_there(self, peer: Peer) -> None:
        """LinkError: the kernel is gone."""
        if peer not in self._there:
            raise LinkError(f"{peer.kernel}: is gone")

    # -- channels --------------------------------------------------------------------------------------------------

    def far_end(self, offer: LinkOffer) -> tuple[Peer, bool]:
        """The kernel at the other end of an offer, and whether this one has the writer. LinkError: it is gone.

        Of several that were started one after the other with one name it is the last.
        """
        own = self.own
        writes = offer.writer.kernel == own.kernel and offer.writer.host in ("", own.host)
        far = offer.reader if writes else offer.writer
        for peer in reversed(self._there):
            if peer.kernel == far.kernel and far.host in ("", peer.host):
                return peer, writes
        raise LinkError(f"{far.kernel}: is gone")

    def keep(self, key: Hashable, channel: C) -> C:
        """Keep a channel below this key; an older one of the key is closed."""
        self.drop(key)
        self.channels[key] = channel
        return channel

    def drop(self, key: Hashable) -> None:
        """Close the channel of this key, if there is one."""
        if (old := self.channels.get(key)) is not None:
            old.close()

    def forget(self, key: Hashable) -> None:
        """A channel was closed."""
        self.channels.pop(key, None)

    # -- questions -------------------------------------------------------------------------------------------------

    def answer(self, what: str, handler: Handler) -> None:
        """Answer such questions with `handler` from now on."""
        self._handlers[what] = handler

    async def answer_to(self, what: str, body: bytes, caller: Caller) -> tuple[bool, bytes]:
        """Whether this kernel answers a question, and its answer, or the text of its refusal."""
        try:
            return True, await answer_of(self._handlers.get(what), what, body, caller, self.kernel)
        except LinkError as error:
            return False, str(error).encode()[:_LONGEST]

    def is_awaited(self, number: int) -> bool:
        """Whether the question of this number waits for its answer."""
        return number in self._questions

    async def asked(self, peer: Peer, within: float, give: Callable[[int], None]) -> bytes:
        """The answer of another kernel to a question that `give` sends, with the number under which it is settled.

        Raises:
            LinkTimeout: there was none within so many seconds.
            LinkError: the kernel is gone, or refuses to answer.
        """
        self.check_there(peer)
        self._last = number = self._last % _NUMBERS + 1
        future: asyncio.Future[bytes] = self.loop.create_future()
        self._questions[number] = peer, future
        try:
            give(number)
            await asyncio.wait((future,), timeout=within)
            for _ in range(0 if future.done() else _LOOKS):
                await asyncio.sleep(0)  # where it was this end that stood still, the answer has come, and is not read
            if future.done():
                return future.result()
            raise LinkTimeout(f"{peer.kernel}: no answer within {within:g} s")
        finally:
            del self._questions[number]
            if not future.cancel():
                future.exception()  # also where who asked has given up in the turn in which it came

    def settle(self, peer: Peer, number: int, good: bool, body: bytes) -> None:
        """The answer, or refusal, of a kernel to a question; a late one is ignored."""
        whom, future = self._questions.get(number, (None, None))
        if future is None or whom != peer or future.done():
            return
        if good:
            future.set_result(body)
        else:
            future.set_exception(LinkError(f"{peer.kernel}: {body[:_LONGEST].decode(errors='replace')}"))

    def fail(self, peer: Peer, why: str) -> None:
        """A kernel will not answer what it was asked until now, for this reason."""
        for whom, future in tuple(self._questions.values()):
            if whom == peer and not future.done():
                future.set_exception(LinkError(f"{peer.kernel}: {why}"))
