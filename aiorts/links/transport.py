"""The seam between a kernel's ends of links and the transport that carries them, which may be a plugin's.

A transport finds other kernels, carries questions and answers between them, and opens channels for links. It promises
nothing about the frames of a channel: they may be lost, doubled and reordered, and the ends of the link put it right.
Everything here is called on the kernel's loop, and nothing blocks.

A transport finds and greets peers in its own way. From then on all transports do as `BaseTransport` does: a callback
hears of each peer once when it comes and once when it goes; a peer that goes takes its channels and open questions
with it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Hashable, Sequence
from typing import TYPE_CHECKING, Any, Final, Generic, Protocol, TypeVar

from aiorts.errors import AiortsError, InvalidNameError, LinkError, LinkTimeout, WiringError, format_error
from aiorts.kernel.ports.port import give_turn
from aiorts.late import dataclass
from aiorts.links.messages import checked, fields, packed
from aiorts.model.links import Allowed
from aiorts.model.names import MAX_HOST_LENGTH, Path, check_name
from aiorts.model.options import chosen_options, connector_profile

if TYPE_CHECKING:
    from aiorts.model.links import Buffer
    from aiorts.model.profile import ConnectorProfile


@dataclass(frozen=True, slots=True)
class Peer:
    """Another kernel that can be reached; after a restart it is another peer."""

    host: str
    kernel: str
    epoch: int


def checked_peer(host: str, kernel: str, epoch: int) -> Peer:
    """The peer with these names, which it has given itself. LinkError: the names are not valid."""
    try:
        check_name(kernel, "kernel")
    except InvalidNameError as error:
        raise LinkError(str(error)) from None
    if len(host) > MAX_HOST_LENGTH or "/" in host:  # a machine's own name may have characters that a path may not
        raise LinkError(f"host name {host[:60]!r}: is none")
    return Peer(host, kernel, epoch)


EVERYTHING: Final = Allowed()


@dataclass(frozen=True, slots=True)
class Caller:
    """The sender of a question."""

    peer: Peer | None
    identity: str
    """The caller as the transport knows it, such as a user or a certificate: never as it calls itself."""
    allowed: Allowed = EVERYTHING
    """The rights to ports of this kernel that the kernels reached by this transport have."""

    @property
    def address(self) -> str:
        """The kernel as `host/kernel`, the same whichever transport has found it first."""
        return "/" if self.peer is None else f"{self.peer.host}/{self.peer.kernel}"

    def check(self, right: str, port: str) -> None:
        """Raise WiringError unless the caller has this right to a port, `component.port`."""
        if refused := self.allowed.refusal("" if self.peer is None else self.peer.kernel, right, port):
            raise WiringError(refused)


class Channel(Protocol):
    """A way for the frames of one link, at one of its ends."""

    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        """Send one frame, with buffers that travel with it; False: not taken, to be sent again after `on_room`."""
        ...

    def close(self) -> None:
        """Close the channel; no event is called any more."""
        ...


class ChannelEvents(Protocol):
    """The end of a link, as a transport calls it."""

    def on_frames(self, frames: Sequence[tuple[Buffer, tuple[Buffer, ...]]]) -> None:
        """Take frames that have come, as many as the transport gives at once."""
        ...

    def on_room(self) -> None:
        """Handle room: `send` takes frames again."""
        ...

    def on_state(self, up: bool, why: str) -> None:
        """Handle the state of the channel: it is up, or it is down for good, for this reason."""
        ...

    def on_clock(self, ahead_ns: int, within_ns: int) -> None:
        """Note how far the other end's clock is ahead, and the possible error; 0, 0: both ends share a clock."""
        ...


@dataclass(frozen=True, slots=True)
class LinkOffer:
    """The terms of a link, on which both ends must agree."""

    protocol: tuple[int, int]
    link: str
    writer: Path
    reader: Path
    writer_epoch: int
    reader_epoch: int
    number: int
    schema: bytes
    type_text: str
    unit: str | None
    shape: tuple[int, ...] | None
    profile: ConnectorProfile
    window: int
    window_bytes: int

    def to_bytes(self) -> bytes:
        """The offer as one frame."""
        shape = None if self.shape is None else list(self.shape)
        ends = [str(self.writer), str(self.reader), self.writer_epoch, self.reader_epoch, self.number]
        kind = [self.schema, self.type_text, self.unit or "", shape or []]
        options = [self.profile.name, chosen_options(self.profile), self.window, self.window_bytes]
        return packed([list(self.protocol), self.link, ends, kind, options])

    @classmethod
    def from_bytes(cls, body: bytes) -> LinkOffer:
        """The offer in a frame. LinkError: the frame is no offer; WiringError: this kernel lacks one of its options."""
        protocol, link, ends, kind, options = fields(body, (list, str, list, list, list), longer=True)
        low, high = checked(protocol, (int, int), longer=True)
        writer, reader, writer_epoch, reader_epoch, number = checked(ends, (str, str, int, int, int), longer=True)
        schema, type_text, unit, shape = checked(kind, (bytes, str, str, list), longer=True)
        name, chosen, window, window_bytes = checked(options, (str, dict, int, int), longer=True)
        if not all(type(length) is int for length in shape):
            raise LinkError("an offer whose shape has other than whole numbers")
        try:
            profile, _ = connector_profile(f"{writer} -> {reader}", chosen, name, (writer, reader))
            return cls(
                (low, high),
                link,
                Path.parse(writer),
                Path.parse(reader),
                writer_epoch,
                reader_epoch,
                number,
                schema,
                type_text,
                unit or None,
                tuple(shape) or None,
                profile,
                window,
                window_bytes,
            )
        except WiringError as error:
            raise WiringError(f"an offer of options that this kernel does not have: {error}") from None
        except AiortsError as error:
            raise LinkError(f"an offer that cannot be read: {error}") from None


class KernelFace(Protocol):
    """The kernel as a transport sees it."""

    name: str
    """The name by which other kernels reach this one."""
    epoch: int
    host: str
    """The name of this machine, as other hosts know it."""

    def run_in_background(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        """Run a coroutine as a task of the kernel."""
        ...

    def report(self, text: str) -> None:
        """Log a warning."""
        ...


class Transport(Protocol):
    """Carries links between kernels.

    It may have three things more: `known_as`, the name by which others know this kernel where its own name is taken;
    `async def session(peer)`, a connected socket for a control session with another kernel; and `allowed`, the
    rights of the kernels that it reaches to ports of this one, which it also gives with each `Caller`.
    """

    async def open(self, kernel: KernelFace) -> None: ...

    async def close(self) -> None: ...

    def presence(self, tell: Callable[[Peer, bool], None]) -> Callable[[], None]: ...

    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel: ...

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes: ...

    def answer(self, what: str, handler: Callable[[bytes, Caller], Awaitable[bytes]]) -> None: ...


async def answer_of(
    handler: Callable[[bytes, Caller], Awaitable[bytes]] | None,
    what: str,
    body: bytes,
    caller: Caller,
    kernel: KernelFace,
) -> bytes:
    """The answer of a handler to a question, for transports: any failure of it becomes a LinkError.

    Raises:
        LinkError: there is no such handler, it refuses, or it failed, which is reported.
    """
    try:
        if handler is None:
            raise LinkError(f"does not know the question {what!r:.60}")
        return await handler(body, caller)
    except AiortsError as error:
        raise LinkError(str(error)) from None
    except Exception as error:  # noqa: BLE001 - a fault of this end: the caller hears of it now, not by its time-out
        kernel.report(f"cannot answer the question {what!r:.60}: {format_error(error)}")
        raise LinkError(f"failed to answer: {type(error).__name__}") from None


_LONGEST: Final = 2_000
"""The most bytes of a refusal."""
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
        """Close the channel, and tell the end of the link why, unless it was closed."""
        if self.is_open:
            self.close()
            self.events.on_state(False, why)

    def close(self) -> None:
        """Close the channel; no event is called any more. Idempotent."""
        if self.is_open:
            self.is_open = False
            self._closed()


C = TypeVar("C", bound=BaseChannel)


class BaseTransport(Generic[C]):
    """The peers of one transport, its channels and its questions. A transport derives from this class and finds peers.

    The transport calls `begin` when it is opened, `found` and `lost` as peers come and go, `settle` with each answer,
    and `end_all` when it is closed.
    """

    kernel: KernelFace
    """The kernel that the transport was opened for."""
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
        """Become the transport of this kernel, on the running loop."""
        self.kernel, self.loop = kernel, asyncio.get_running_loop()

    @property
    def own(self) -> Peer:
        """This kernel, as its peers know it."""
        return Peer(self.kernel.host, self.kernel.name, self.kernel.epoch)

    def end_all(self) -> None:
        """Call no callback any more, close all channels, and fail all questions."""
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
        """Whether there is a callback for peers."""
        return bool(self._tells)

    def presence(self, tell: Callable[[Peer, bool], None]) -> Callable[[], None]:
        """Call `tell` for each kernel that is there, comes or goes, until the returned function is called."""
        self._tells.append(tell)
        for peer in self.peers:
            tell(peer, True)
        return lambda: self._tells.remove(tell) if tell in self._tells else None

    def found(self, peer: Peer) -> None:
        """Add a kernel that has greeted: the callbacks hear of it, and it can be asked from now on."""
        self._there[peer] = None
        for tell in tuple(self._tells):
            tell(peer, True)

    def lost(self, peer: Peer, why: str) -> None:
        """Remove a kernel that is gone: callbacks hear of it, its questions fail, its channels end, for this reason."""
        if peer not in self._there:
            return
        del self._there[peer]
        for tell in tuple(self._tells):
            tell(peer, False)
        self.fail(peer, why)
        for channel in [one for one in self.channels.values() if one.peer == peer]:
            channel.lost(f"{peer.kernel}: {why}")

    def check_there(self, peer: Peer) -> None:
        """Raise LinkError if the kernel is gone."""
        if peer not in self._there:
            raise LinkError(f"{peer.kernel}: is gone")

    # -- channels --------------------------------------------------------------------------------------------------

    def far_end(self, offer: LinkOffer) -> tuple[Peer, bool]:
        """The kernel at the other end of an offer, and whether this one has the writer. LinkError: it is gone.

        If several kernels had this name one after the other, the last is meant.
        """
        own = self.own
        writes = offer.writer.kernel == own.kernel and offer.writer.host in ("", own.host)
        far = offer.reader if writes else offer.writer
        for peer in reversed(self._there):
            if peer.kernel == far.kernel and far.host in ("", peer.host):
                return peer, writes
        raise LinkError(f"{far.kernel}: is gone")

    def keep(self, key: Hashable, channel: C) -> C:
        """Keep a channel by this key; an older one of the key is closed."""
        self.drop(key)
        self.channels[key] = channel
        return channel

    def drop(self, key: Hashable) -> None:
        """Close the channel of this key, if there is one."""
        if (old := self.channels.get(key)) is not None:
            old.close()

    def forget(self, key: Hashable) -> None:
        """Forget the channel of this key, which was closed."""
        self.channels.pop(key, None)

    # -- questions -------------------------------------------------------------------------------------------------

    def answer(self, what: str, handler: Handler) -> None:
        """Answer questions of this name with `handler` from now on."""
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
        """The answer of another kernel to a question. `give` sends the question, with its number for `settle`.

        Raises:
            LinkTimeout: there was no answer within so many seconds.
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
                await give_turn()  # if this end stood still, the answer may have come and not be read yet
            if future.done():
                return future.result()
            raise LinkTimeout(f"{peer.kernel}: no answer within {within:g} s")
        finally:
            del self._questions[number]
            if not future.cancel():
                future.exception()  # mark as seen, also if the caller gave up in the turn in which it came

    def settle(self, peer: Peer, number: int, good: bool, body: bytes) -> None:
        """Settle a question with the answer, or refusal, of a kernel; a late one is ignored."""
        whom, future = self._questions.get(number, (None, None))
        if future is None or whom != peer or future.done():
            return
        if good:
            future.set_result(body)
        else:
            future.set_exception(LinkError(f"{peer.kernel}: {body[:_LONGEST].decode(errors='replace')}"))

    def fail(self, peer: Peer, why: str) -> None:
        """Fail the open questions to a kernel, for this reason."""
        for whom, future in tuple(self._questions.values()):
            if whom == peer and not future.done():
                future.set_exception(LinkError(f"{peer.kernel}: {why}"))
