"""The transport of one host: kernels of one user find each other by their sockets in the run-time folder.

Each kernel listens at a socket of its own. A kernel that opens connects to all that are there, so no kernel has to look
again. The connecting end waits for the greeting as long as the other kernel is there, and connects again when the
connection ends, until no process listens there. The accepting end closes a connection that is silent for a second: any
process may have made it. A socket without a listener was left by a kernel that is gone: the next that connects to it
removes it. The connecting process must be of the same user, as the system says.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import hashlib
import os
import socket
import struct
import sys
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from aiorts.errors import AiortsError, LinkError
from aiorts.links.messages import LARGEST, fields, packed
from aiorts.links.stream import Message, Stream
from aiorts.links.transport import (
    BaseChannel,
    BaseTransport,
    Caller,
    Channel,
    ChannelEvents,
    KernelFace,
    LinkOffer,
    Peer,
    checked_peer,
)
from aiorts.model.links import Buffer, turn_of
from aiorts.rings import OFFERED, REFUSAL, Rings, proof, proves
from aiorts.sessions import private_folder

_HELLO, _ASK, _ANSWER, _REFUSAL, _BY_WRITER, _BY_READER, _PROOF, _RING = range(1, 9)
_IN_RING: Final = 4
"""The number added to `_BY_WRITER` and `_BY_READER` where parts of the frame are in a ring."""
_RINGED: Final = (_BY_WRITER + _IN_RING, _BY_READER + _IN_RING)
_SUFFIX: Final = ".link"
_GREETING_SECONDS: Final = 1.0
"""Seconds that an accepted connection may be silent, and that `open` waits for the greetings of others."""
_SILENT: Final = 256
"""The most silent connections. One more ends the oldest; its kernel connects again."""
_ACCEPT_AGAIN_SECONDS: Final = 0.2
_CONNECT_AGAIN: Final = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Seconds until the next attempt to connect to a kernel."""
_NO_ROOM: Final = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
"""Errors that say that this process or the system has no descriptors or memory left."""
_FOR_NOW: Final = (errno.EAGAIN, errno.EINTR, *_NO_ROOM)
"""Passing errors of a connection to a kernel that is there, whose queue may be full while it stands still."""
_MET: Final = 1_024
"""The most channels of one connection that are remembered."""
_ASKED: Final = 1_000
"""The most questions of one peer that are being answered at the same time."""
_OF_ONE_PROGRAM: Final = 64 << 20
"""The most bytes of a question between kernels of one program, such as the state of a component that moves."""


class UnixTransport(BaseTransport["_UnixChannel"]):
    """Carries links between kernels of one user on one host. See `Transport`.

    Large arrays go through memory that both kernels share. Readers of the same program use the arrays there,
    although the writer's kernel could still change them; for other readers the arrays are copied.

    Args:
        listens: whether other kernels find this one by the run-time folder; else `take` gives it its
            connections.
    """

    program: bytes = b""
    """A secret of 16 random bytes or more that all kernels of one program share; b"": this kernel has none."""

    def __init__(self, *, listens: bool = True) -> None:
        super().__init__()
        self._listens = listens
        self.largest = LARGEST if listens else _OF_ONE_PROGRAM
        """The most bytes of a question."""
        self._connections: set[_Connection] = set()
        self._ways: dict[Peer, list[_Connection]] = {}
        """Connections with each peer: one, or two where both have opened at the same time. The first one is used."""
        self._silent: dict[_Connection, asyncio.TimerHandle] = {}
        """Accepted connections that have not greeted, the oldest first, and the timer that ends each."""
        self._due: dict[Path, asyncio.TimerHandle] = {}
        """Sockets that are connected to again, and the timer of each."""
        self._listener: socket.socket | None = None
        self._path = Path()
        self.greeting = b""

    async def open(self, kernel: KernelFace) -> None:
        """Listen, and connect to the kernels that are there.

        Raises:
            LinkError: a kernel of that name is there already, or the socket cannot be made.
        """
        self.begin(kernel)
        own = self.own
        self.greeting = packed([own.host, own.kernel, own.epoch])
        if not self._listens:
            return
        taken = LinkError(f"a kernel named {kernel.name!r} runs already; give this one another name")
        try:
            folder, name = private_folder(), _hashed(kernel.name)
            if any(map(_is_served, folder.glob(f"{name}-*{_SUFFIX}"))):
                raise taken  # before this kernel is seen: it may be tried again and again
            self._listen(folder / f"{name}-{kernel.epoch:016x}{_SUFFIX}")
            # Others are sought only now: if two kernels open at the same time, at least one finds the other.
            others = [path for path in sorted(folder.glob(f"*{_SUFFIX}")) if path != self._path]
            mine = _made_ns(self._path)
            if any(path.name.startswith(f"{name}-") and _made_ns(path) <= mine and _is_served(path) for path in others):
                await self.close()
                raise taken
        except LinkError:
            raise
        except (AiortsError, OSError) as error:
            await self.close()  # the transport may listen already, and is opened again
            raise LinkError(f"other kernels of this host cannot be reached: {error}") from None
        found = [connection for path in others if (connection := self._connect(path)) is not None]
        if found:
            await asyncio.wait([one.greeted for one in found], timeout=_GREETING_SECONDS)

    def _listen(self, path: Path) -> None:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        new = path.with_suffix(".new")
        try:
            listener.setblocking(False)
            listener.bind(str(new))
            listener.listen(128)
            new.rename(path)  # a socket that does not listen yet looks like one that a killed kernel has left
        except BaseException:
            listener.close()
            new.unlink(missing_ok=True)
            raise
        self._path, self._listener = path, listener
        self.loop.add_reader(listener.fileno(), self._accept)

    def _connect(self, path: Path, tried: int = 0) -> _Connection | None:
        """Connect to the kernel at a socket, and again when that connection has ended, until the socket is refused."""
        self._due.pop(path, None)
        try:
            sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                sock.setblocking(False)
                sock.connect(str(path))
            except OSError:
                sock.close()
                raise
        except OSError as error:
            if isinstance(error, ConnectionRefusedError):
                with contextlib.suppress(OSError):
                    path.unlink()
            elif error.errno in _FOR_NOW:
                self._connect_soon(path, tried)
            return None
        connection = self.take(sock)
        connection.lost = lambda: self._connect_soon(path, tried if connection.peer is None else 0)
        return connection

    def _connect_soon(self, path: Path, tried: int) -> None:
        seconds = _CONNECT_AGAIN[min(tried, len(_CONNECT_AGAIN) - 1)]
        self._due[path] = self.loop.call_later(seconds, self._connect, path, tried + 1)

    def _accept(self) -> None:
        assert self._listener is not None  # noqa: S101 - it listens
        try:
            sock, _ = self._listener.accept()
        except OSError as error:
            if error.errno in _NO_ROOM:
                # The connection stays in the queue, and the loop would call this method without end.
                self.loop.remove_reader(self._listener.fileno())
                self.loop.call_later(_ACCEPT_AGAIN_SECONDS, self._accept_again)
            return
        if _owner_of(sock)[1] != os.geteuid():
            sock.close()
            return
        if len(self._silent) >= _SILENT:
            next(iter(self._silent)).close()
        connection = self.take(sock)
        self._silent[connection] = self.loop.call_later(_GREETING_SECONDS, connection.close)

    def _is_heard(self, connection: _Connection) -> None:
        """Stop the timer of a connection that has greeted, or is over."""
        if (timer := self._silent.pop(connection, None)) is not None:
            timer.cancel()

    def _accept_again(self) -> None:
        if self._listener is not None:
            self.loop.add_reader(self._listener.fileno(), self._accept)

    def take(self, sock: socket.socket) -> _Connection:
        """Use a socket that is connected to another kernel; when it ends, that kernel is gone."""
        connection = _Connection(self, sock)
        self._connections.add(connection)
        return connection

    async def close(self) -> None:
        """Stop listening, and end all connections."""
        if self._listener is not None:
            self.loop.remove_reader(self._listener.fileno())
            self._listener.close()
            self._listener = None
            with contextlib.suppress(OSError):
                self._path.unlink()
        for timer in self._due.values():
            timer.cancel()
        self._due.clear()
        self.end_all()
        for connection in tuple(self._connections):
            connection.close()

    # -- other kernels ---------------------------------------------------------------------------------------------

    def greeted(self, connection: _Connection, peer: Peer) -> None:
        """Add a connection on which its peer has greeted."""
        self._is_heard(connection)
        ways = self._ways.setdefault(peer, [])
        ways.append(connection)
        if len(ways) == 1:
            self.found(peer)

    def ended(self, connection: _Connection, why: str) -> None:
        """Remove a connection that is over. A second one with the same kernel takes over its channels."""
        self._connections.discard(connection)
        self._is_heard(connection)
        peer = connection.peer
        if peer is None or connection not in (ways := self._ways.get(peer, [])):
            return
        was_used = ways[0] is connection
        ways.remove(connection)
        if not ways:
            del self._ways[peer]
            self.lost(peer, why)
        elif was_used:
            self.fail(peer, why)
            for channel in [one for one in self.channels.values() if one.connection is connection]:
                channel.connection = ways[0]
                self.loop.call_soon(channel.on_room)

    # -- channels --------------------------------------------------------------------------------------------------

    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel:
        """The channel of an offer, which both ends have agreed on.

        Raises:
            LinkError: the other kernel is gone.
        """
        peer, writes = self.far_end(offer)
        mine, theirs = (_BY_WRITER, _BY_READER) if writes else (_BY_READER, _BY_WRITER)
        key = (peer, theirs, offer.number)
        return self.keep(key, _UnixChannel(self._ways[peer][0], mine, offer.number, events, partial(self.forget, key)))

    def arrived(self, peer: Peer, frames: dict[tuple[int, int], list[tuple[Buffer, tuple[Buffer, ...]]]]) -> None:
        """Give frames from a peer to their channels."""
        for (kind, number), those in frames.items():
            if (channel := self.channels.get((peer, kind, number))) is not None:
                channel.events.on_frames(those)

    def drained(self, connection: _Connection) -> None:
        """Tell the channels of a connection that it takes frames again."""
        for channel in tuple(self.channels.values()):
            if channel.connection is connection:
                channel.on_room()

    # -- questions -------------------------------------------------------------------------------------------------

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        """The answer of another kernel.

        Raises:
            LinkTimeout: there was no answer within so many seconds.
            LinkError: the kernel is gone, or refuses to answer.
        """
        question = packed([what, body])
        if len(question) > self.largest:
            raise LinkError(f"{what}: {len(question)} bytes; a question has {self.largest} at the most")
        return await self.asked(peer, within, lambda number: self._ways[peer][0].ask(number, question))


class _UnixChannel(BaseChannel):
    """One end of a link over the connection of its kernels."""

    def __init__(
        self, connection: _Connection, kind: int, number: int, events: ChannelEvents, closed: Callable[[], object]
    ) -> None:
        assert connection.peer is not None  # noqa: S101 - it has greeted
        super().__init__(connection.peer, events, closed)
        self.connection = connection
        self._kind, self._number = kind, number

    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        connection = self.connection
        if parts and connection.rings is not None:
            return connection.send_parts(self._kind, self._number, head, parts)
        kind, number, stream = self._kind, self._number, connection.stream
        if not parts and stream.send_alone(kind, number, head):
            return True
        return stream.send(kind, number, head, parts, turn_of(head))


class _Connection:
    """A connection with another kernel: its greeting, questions, and the frames of all channels."""

    def __init__(self, transport: UnixTransport, sock: socket.socket) -> None:
        self._transport = transport
        self.peer: Peer | None = None
        self.lost: Callable[[], object] = _nothing
        """Called when the other end has ended the connection."""
        self.greeted: asyncio.Future[None] = transport.loop.create_future()
        """Done when the other end has greeted, or the connection is over."""
        self._answering = 0
        """Questions of the other end whose answer was not sent yet."""
        self._unsent: deque[tuple[int, int, bytes]] = deque()
        """Answers that wait until the stream takes them."""
        self._process, user = _owner_of(sock)
        self._identity = f"user {user}"
        self.rings: Rings | None = None
        """The shared memory, from the other end's greeting on, where this system has it."""
        self._greeting = b""
        """The first message of the other end, byte for byte."""
        self._met: dict[tuple[int, int], _UnixChannel] = {}
        """Channels that frames came for, by kind and number: the look-up by peer takes 1 us."""
        self.stream = Stream(transport.loop, sock, self._arrived, self._drained, self._over, self._arrived_alone)
        self.stream.control(_HELLO, 0, transport.greeting)

    def close(self) -> None:
        """End the connection."""
        self.lost = _nothing
        self.stream.close()
        self._over("this kernel ends")

    def send_parts(self, kind: int, number: int, head: bytes, parts: Sequence[memoryview]) -> bool:
        """Send a frame of a channel, its large parts through the ring where that has room."""
        rings = self.rings
        put = None if rings is None else rings.put(parts)
        if rings is None or put is None:
            return False
        places, beside = put
        if not places:
            return self.stream.send(kind, number, head, beside)
        sent = self.stream.send(kind + _IN_RING, number, rings.frame(places, head), beside)
        if not sent:
            rings.take_back(places)
        return sent

    def _over(self, why: str) -> None:
        if not self.greeted.done():
            self.greeted.set_result(None)
        if self.rings is not None:
            self.rings.close()
        self._transport.ended(self, why)
        self.lost()

    def _drained(self) -> None:
        if self.rings is not None:
            self.rings.flush()
        while self._unsent and self.stream.control(*self._unsent[0]):
            self._unsent.popleft()
            self._answering -= 1
        self._transport.drained(self)

    def _arrived_alone(self, kind: int, number: int, body: Buffer) -> bool:
        channel = self._met.get((kind, number))
        if channel is None or not channel.is_open:
            channel = None if self.peer is None else self._transport.channels.get((self.peer, kind, number))
            if channel is None:
                return False
            if len(self._met) >= _MET:
                self._met.clear()  # mostly channels that were closed
            self._met[kind, number] = channel
        channel.events.on_frames(((body, ()),))
        return True

    def _arrived(self, messages: list[Message]) -> None:
        frames: dict[tuple[int, int], list[tuple[Buffer, tuple[Buffer, ...]]]] = {}
        for kind, number, body, parts in messages:
            if kind in (_BY_WRITER, _BY_READER):
                frames.setdefault((kind, number), []).append((body, parts))
                continue
            try:
                if kind in _RINGED and self.rings is not None:
                    frame = self.rings.frame_of(body, parts)
                    frames.setdefault((kind - _IN_RING, number), []).append(frame)
                    continue
                self._control(kind, number, bytes(body))
            except LinkError as error:
                if self.stream.closed:
                    return None  # an earlier message has ended the connection, and the ring with it
                self._transport.kernel.report(f"ended the connection with {self.peer or 'a process'}: {error}")
                return self.close()
        if frames and self.peer is not None:
            self._transport.arrived(self.peer, frames)
        return None

    def _control(self, kind: int, number: int, body: bytes) -> None:
        if kind == _HELLO:
            if self.peer is None:
                self.peer = _peer_of(body)
                self._prove(body)
                self._transport.greeted(self, self.peer)
                if not self.greeted.done():
                    self.greeted.set_result(None)
        elif self.peer is None:
            raise LinkError("it did not say who it is")
        elif kind == _PROOF:
            self._meet(body)
        elif kind == _RING:
            self._hear(body)
        elif kind in _RINGED:
            raise LinkError("it speaks of a ring that there is not")
        elif kind == _ASK:
            what, question = fields(body, (str, bytes), largest=self._transport.largest)
            if self._answering >= _ASKED:
                if not self.stream.control(_REFUSAL, number, b"too many questions at the same time"):
                    raise LinkError("it asks, and takes no answers")
                return
            self._answering += 1
            self._transport.kernel.run_in_background(self._answer(number, what, question), f"aiorts answer {what:.20}")
        elif kind in (_ANSWER, _REFUSAL):
            self._transport.settle(self.peer, number, kind == _ANSWER, body)

    # -- rings -------------------------------------------------------------------------------------------------------

    def _prove(self, greeting: bytes) -> None:
        """Answer the other end's greeting with the proof of a common program, if this kernel has one; make rings.

        The proof is not in our greeting: kernels of other versions take only its present fields, and skip this message.
        """
        self._greeting = greeting
        transport, stream = self._transport, self.stream
        if transport.program:
            stream.control(_PROOF, 0, proof(transport.program, transport.greeting, greeting))
        if Rings.available:
            self.rings = Rings(
                transport.loop,
                self._say,
                stream.expect_descriptor,
                stream.take_descriptor,
                lambda text: transport.kernel.report(f"{self._name}: {text}"),
                self._drained,
            )

    def _meet(self, said: bytes) -> None:
        """Use the other end's memory from now on, if that end has proved to be of the same program."""
        transport = self._transport
        ours, theirs = transport.greeting, self._greeting
        if self.rings is not None and proves(transport.program, said, theirs, ours, process=self._process):
            self.rings.trust()

    def _say(self, body: bytes, descriptor: int | None) -> bool:
        if descriptor is None:
            return self.stream.control(_RING, 0, body)
        return self.stream.send_descriptor(_RING, 0, body, descriptor)

    def _hear(self, body: bytes) -> None:
        if self.rings is not None:
            self.rings.heard(body)
        elif body == OFFERED:
            self._say(REFUSAL, None)
        else:
            raise LinkError("it speaks of a ring that there is not")

    def ask(self, number: int, question: bytes) -> None:
        """Send a question. LinkError: it was not sent."""
        if not self.stream.control(_ASK, number, question):
            raise LinkError(f"{self._name}: takes no more questions now")

    @property
    def _name(self) -> str:
        return self.peer.kernel if self.peer is not None else "another kernel"

    async def _answer(self, number: int, what: str, question: bytes) -> None:
        good, body = await self._transport.answer_to(what, question, Caller(self.peer, self._identity))
        kind = _ANSWER if good else _REFUSAL
        if not self._unsent and self.stream.control(kind, number, body):
            self._answering -= 1
        else:
            self._unsent.append((kind, number, body))  # sent in its turn, as long as the other end is there


def _nothing() -> None:
    """Do nothing: no connection is made again."""


def _peer_of(greeting: bytes) -> Peer:
    """The peer of a greeting. LinkError: it is no greeting, or its names are not valid."""
    return checked_peer(*fields(greeting, (str, str, int)))


def _made_ns(path: Path) -> int:
    """The time when a socket was put into its place; in the far future if the socket is gone."""
    try:
        return path.stat().st_ctime_ns
    except OSError:
        return sys.maxsize


def _is_served(path: Path) -> bool:
    """Whether a process listens at a socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except OSError as error:
            return error.errno not in (errno.ECONNREFUSED, errno.ENOENT)
    return True


def _owner_of(sock: socket.socket) -> tuple[int, int]:
    """The process at the other end, and its user. Where the system does not say: 0 and our user, since the folder
    admits no other."""
    option: Any = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return 0, os.geteuid()
    process, user, _ = struct.unpack("3i", sock.getsockopt(socket.SOL_SOCKET, option, struct.calcsize("3i")))
    return int(process), int(user)


def _hashed(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()[:16]
