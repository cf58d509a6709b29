"""What carries links: the seam between a kernel's ends and a transport, which may be a plugin's.

A transport finds other kernels, carries questions and answers between them, and opens channels for links. It promises
nothing about the frames of a channel: they may be lost, doubled and reordered, and the ends of the link put it right.
Everything here is called on the kernel's loop, and nothing blocks.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import TYPE_CHECKING, Any, Final, Protocol

from aiorts.errors import AiortsError, InvalidNameError, LinkError, WiringError, format_error
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
    """Another kernel that can be reached; one that was started anew is another peer."""

    host: str
    kernel: str
    epoch: int


def checked_peer(host: str, kernel: str, epoch: int) -> Peer:
    """The kernel of these names, which another one has said. LinkError: they are no names."""
    try:
        check_name(kernel, "kernel")
    except InvalidNameError as error:
        raise LinkError(str(error)) from None
    if len(host) > MAX_HOST_LENGTH or "/" in host:  # what a machine calls itself may have other characters than a path
        raise LinkError(f"host name {host[:60]!r}: is none")
    return Peer(host, kernel, epoch)


EVERYTHING: Final = Allowed()


@dataclass(frozen=True, slots=True)
class Caller:
    """Who asks."""

    peer: Peer | None
    identity: str
    """As the transport knows it, such as a user or a certificate: never what the caller says of itself."""
    allowed: Allowed = EVERYTHING
    """Rights of the kernels that this transport reaches, to ports of this one."""

    def check(self, right: str, port: str) -> None:
        """WiringError: who asks has not this right to a port, `component.port`."""
        if refused := self.allowed.refusal("" if self.peer is None else self.peer.kernel, right, port):
            raise WiringError(refused)


class Channel(Protocol):
    """A way for the frames of one link, at one of its ends."""

    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        """Send one frame, with buffers that travel beside it; False: not taken, again after `on_room`."""
        ...

    def close(self) -> None:
        """Give it up; nothing is called any more."""
        ...


class ChannelEvents(Protocol):
    """The end of a link, as a transport calls it."""

    def on_frames(self, frames: Sequence[tuple[Buffer, tuple[Buffer, ...]]]) -> None:
        """Frames have come; as many as the transport gives at once."""
        ...

    def on_room(self) -> None:
        """`send` takes frames again."""
        ...

    def on_state(self, up: bool, why: str) -> None:
        """The channel is up, or it is down for good, for this reason."""
        ...

    def on_clock(self, ahead_ns: int, within_ns: int) -> None:
        """The clock of the other end is so far ahead, and that may be off by so much; 0, 0: both have one clock."""
        ...


@dataclass(frozen=True, slots=True)
class LinkOffer:
    """What both ends of a link must agree on."""

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
        """The offer of a frame. LinkError: it is none; WiringError: this kernel does not have one of its options."""
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
    """What a transport sees of the kernel."""

    name: str
    """By which others reach it."""
    epoch: int

    def run_in_background(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        """Run a coroutine as a task of the kernel."""
        ...

    def report(self, text: str) -> None:
        """Log a warning."""
        ...


class Transport(Protocol):
    """Carries links between kernels.

    It may have three things more: `known_as`, the name by which others know this kernel where its own is taken there;
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
    """What a handler answers to a question, for transports: whatever it fails with becomes a LinkError.

    Raises:
        LinkError: there is no such handler, it refuses, or it failed, which is reported.
    """
    try:
        if handler is None:
            raise LinkError(f"does not know the question {what!r:.60}")
        return await handler(body, caller)
    except AiortsError as error:
        raise LinkError(str(error)) from None
    except Exception as error:  # noqa: BLE001 - a fault of this end: who asks hears of it now, not by its time-out
        kernel.report(f"cannot answer the question {what!r:.60}: {format_error(error)}")
        raise LinkError(f"failed to answer: {type(error).__name__}") from None
