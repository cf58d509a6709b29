"""A transport between kernels of one loop, whose faults are chosen and repeat with the same seed.

    network = MemoryNetwork(seed=7, loss=0.1, duplicate=0.05)
    one.service(Links).use(network.transport("one"))
    two.service(Links).use(network.transport("two"))

It uses the time of the loop, which is virtual in a simulated loop. Faults hit the frames of channels
alone: questions and answers are delayed, and lost only with the connection.
"""

from __future__ import annotations

import asyncio
import heapq
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from random import Random
from typing import TYPE_CHECKING, Final, NamedTuple

from aiorts.errors import LinkError
from aiorts.links import BaseChannel, BaseTransport, Caller, Peer

if TYPE_CHECKING:
    from aiorts.links import Channel, ChannelEvents, KernelFace, LinkOffer, Transport

_FULL: Final = 1 << 20
"""The most bytes under way in a channel; it accepts no more."""
_ASKED: Final = 1_000
"""The most questions of one kernel that are not answered yet."""
_OVERTAKEN: Final = 0.02
"""The most seconds by which a frame is delayed so that others overtake it."""
_HOST: Final = "memory"

_Frame = tuple[bytes, tuple[memoryview, ...]]


class MemoryNetwork:
    """Kernels that reach each other in memory, and the faults between them.

    `loss`, `duplicate`, `reorder` and `delay` can be set at any time; they hold for frames that are sent from then on.

    Args:
        seed: decides which frames are hit.
        loss: the share of frames that never arrive. duplicate: the share that arrives twice.
        reorder: the share that is up to 20 ms late, so that others overtake it.
        delay: seconds that everything is under way.
    """

    def __init__(
        self, seed: int = 0, *, loss: float = 0.0, duplicate: float = 0.0, reorder: float = 0.0, delay: float = 0.0
    ) -> None:
        self.loss, self.duplicate, self.reorder, self.delay = loss, duplicate, reorder, delay
        self._random = Random(seed)  # noqa: S311 - which frames are hit is no secret
        self._open: dict[str, _MemoryTransport] = {}
        self._cuts: set[frozenset[str]] = set()
        self._stopped: set[str] = set()

    def transport(self, kernel: str) -> Transport:
        """A new transport for the kernel that others reach by this name; each start of a kernel needs a new one."""
        return _MemoryTransport(self, kernel)

    def cut(self, one: str, other: str) -> None:
        """End the connection of two kernels, with all that is under way, until `restore`."""
        self._cuts.add(frozenset((one, other)))
        if one in self._open and other in self._open:
            self._open[one].part(self._open[other], "the connection is cut")

    def restore(self, one: str, other: str) -> None:
        """Let two kernels find each other again."""
        self._cuts.discard(frozenset((one, other)))
        if one in self._open and other in self._open:
            self._open[one].meet(self._open[other])

    def stop(self, kernel: str) -> None:
        """Deliver nothing to a kernel and nothing from it until `go`; its connections stay."""
        self._stopped.add(kernel)

    def go(self, kernel: str) -> None:
        """Deliver what has waited since `stop`."""
        self._stopped.discard(kernel)
        for transport in self._open.values():
            transport.wake()

    # -- for its transports ----------------------------------------------------------------------------------------

    def _stands(self, *transports: _MemoryTransport) -> bool:
        """Whether the kernel of one of these transports is stopped."""
        return any(one.name in self._stopped for one in transports)

    def _enter(self, newcomer: _MemoryTransport) -> None:
        """Let all open transports find `newcomer`. LinkError: a transport of that name is open."""
        if newcomer.name in self._open:
            raise LinkError(f"a kernel named {newcomer.name!r} runs already; give this one another name")
        others = tuple(self._open.values())
        self._open[newcomer.name] = newcomer
        for other in others:
            if frozenset((newcomer.name, other.name)) not in self._cuts:
                newcomer.meet(other)

    def _leave(self, transport: _MemoryTransport) -> None:
        """Let no other kernel find `transport` any more."""
        if self._open.get(transport.name) is transport:
            del self._open[transport.name]

    def _delays(self) -> list[float]:
        """When the copies of the next frame arrive, in seconds from now: one, two or none."""
        draw = self._random.random
        copies = 0 if draw() < self.loss else 2 if draw() < self.duplicate else 1
        return [self.delay + (draw() * _OVERTAKEN if draw() < self.reorder else 0.0) for _ in range(copies)]


class _Sent(NamedTuple):
    """A frame under way."""

    channel: _MemoryChannel
    frame: _Frame
    size: int


class _Line:
    """The frames and calls under way from one kernel to another."""

    def __init__(self, network: MemoryNetwork, near: _MemoryTransport, far: _MemoryTransport) -> None:
        self._network, self._near, self.far = network, near, far
        self._under_way: list[tuple[float, int, _Sent | Callable[[], None]]] = []
        self._numbers = count()
        self._timer: asyncio.Handle | None = None
        self._due = 0.0
        self.asked = 0
        """Questions that are not answered yet."""
        self.ended = False

    def put(self, what: _Sent | Callable[[], None], seconds: float) -> None:
        """Deliver a frame, or call, so many seconds later; never once the line has ended."""
        if self.ended:
            return
        heapq.heappush(self._under_way, (self._near.loop.time() + seconds, next(self._numbers), what))
        self.wake()

    def wake(self) -> None:
        """Set the timer for the first arrival."""
        if self._under_way and (self._timer is None or self._under_way[0][0] < self._due):
            self._stop_waiting()
            self._due = self._under_way[0][0]
            self._timer = self._near.loop.call_at(self._due, self.arrive)

    def _stop_waiting(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def arrive(self) -> None:
        """Deliver what is due by now."""
        self._stop_waiting()
        if self._network._stands(self._near, self.far):
            return
        now = self._near.loop.time()
        arrived: dict[tuple[bool, int], list[_Frame]] = {}
        while self._under_way and self._under_way[0][0] <= now:
            what = heapq.heappop(self._under_way)[2]
            if isinstance(what, _Sent):
                what.channel.is_delivered(what.size)
                arrived.setdefault(what.channel.far_key, []).append(what.frame)
            else:
                what()
        self.wake()
        for key, frames in arrived.items():
            self.far.take(self._near.peer, key, frames)

    def end(self) -> None:
        """Lose all that is under way."""
        self.ended = True
        self._stop_waiting()
        self._under_way.clear()


class _MemoryTransport(BaseTransport["_MemoryChannel"]):
    """One kernel's side of a `MemoryNetwork`. See `aiorts.links.Transport`."""

    def __init__(self, network: MemoryNetwork, name: str) -> None:
        super().__init__()
        self.network, self.name = network, name
        self.peer = Peer(_HOST, name, 0)
        self._lines: dict[Peer, _Line] = {}
        self._notices: deque[Callable[[], None]] = deque()
        """The next notices to its kernel, in this order, each in a step of the loop of its own."""

    async def open(self, kernel: KernelFace) -> None:
        """See `Transport`. LinkError: the kernel has another name than this transport, or one of that name is open."""
        if kernel.name != self.name:
            raise LinkError(f"the transport of {self.name!r} was given to the kernel {kernel.name!r}")
        self.begin(kernel)
        self.peer = Peer(_HOST, self.name, kernel.epoch)
        self.network._enter(self)

    async def close(self) -> None:
        """See `Transport`. Frames that were sent before arrive, except those that the network delays."""
        for line in tuple(self._lines.values()):
            line.arrive()
        self.network._leave(self)
        self.end_all()
        for line in tuple(self._lines.values()):
            self.part(line.far, "it has ended")
        self._notices.clear()

    # -- other kernels ---------------------------------------------------------------------------------------------

    @property
    def own(self) -> Peer:
        """This kernel; all are of one host."""
        return self.peer

    def meet(self, other: _MemoryTransport) -> None:
        """Connect the two transports, unless they are connected."""
        if other.peer not in self._lines:
            for near, far in ((self, other), (other, self)):
                near._lines[far.peer] = _Line(self.network, near, far)
                near.tell(partial(near.found, far.peer))

    def part(self, other: _MemoryTransport, why: str) -> None:
        """End their connection, if there is one."""
        for near, far in ((self, other), (other, self)):
            if (line := near._lines.pop(far.peer, None)) is not None:
                line.end()
                near.tell(partial(near.lost, far.peer, why))

    def tell(self, notice: Callable[[], None]) -> None:
        """Call `notice` in its own step of the loop, after earlier notices; for a stopped kernel, only after `go`."""
        self._notices.append(notice)
        self.loop.call_soon(self._tell_next)

    def _tell_next(self) -> None:
        if self._notices and not self.network._stands(self):
            self._notices.popleft()()

    def wake(self) -> None:
        """Continue with what waited until `go`."""
        for _ in self._notices:
            self.loop.call_soon(self._tell_next)
        for line in self._lines.values():
            line.wake()

    def line_to(self, peer: Peer) -> _Line:
        """The line to a kernel. LinkError: there is none."""
        if (line := self._lines.get(peer)) is None:
            raise LinkError(f"{peer.kernel}: is gone")
        return line

    # -- channels --------------------------------------------------------------------------------------------------

    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel:
        """See `Transport`. LinkError: the other kernel is gone."""
        peer, writes = self.far_end(offer)
        key = (peer, writes, offer.number)
        return self.keep(key, _MemoryChannel(self, key, events))

    def take(self, peer: Peer, key: tuple[bool, int], frames: list[_Frame]) -> None:
        """Pass on frames that have arrived; those of a channel that is not open here are lost."""
        if (channel := self.channels.get((peer, *key))) is not None:
            channel.events.on_frames(frames)

    # -- questions -------------------------------------------------------------------------------------------------

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        """See `Transport`. LinkTimeout: no answer came in time. LinkError: the kernel is gone, or refuses."""
        line = self.line_to(peer)
        if line.asked >= _ASKED:
            raise LinkError(f"{peer.kernel}: {_ASKED} questions are not answered yet")
        line.asked += 1
        try:
            return await self.asked(
                peer,
                within,
                lambda number: line.put(partial(line.far.hear, self, number, what, bytes(body)), self.network.delay),
            )
        finally:
            line.asked -= 1

    def hear(self, asker: _MemoryTransport, number: int, what: str, body: bytes) -> None:
        """Answer a question that has arrived."""
        self.kernel.run_in_background(self._reply(asker, number, what, body), f"aiorts answer {what:.20}")

    async def _reply(self, asker: _MemoryTransport, number: int, what: str, body: bytes) -> None:
        good, answer = await self.answer_to(what, body, Caller(asker.peer, f"memory {asker.name}"))
        if (line := self._lines.get(asker.peer)) is not None:
            line.put(partial(asker.settle, self.peer, number, good, answer), self.network.delay)


class _MemoryChannel(BaseChannel):
    """One end of a channel. See `aiorts.links.Channel`."""

    def __init__(self, transport: _MemoryTransport, key: tuple[Peer, bool, int], events: ChannelEvents) -> None:
        super().__init__(key[0], events, partial(transport.forget, key))
        self._transport = transport
        self._line = transport.line_to(key[0])
        self.far_key = (not key[1], key[2])
        self._under_way = 0
        """Bytes under way."""
        self._refused = False

    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        if not self.is_open or self._line.ended:
            return False
        if self._under_way > _FULL:
            self._refused = True
            return False
        # The parts are copied, since the sender may write to its buffers afterwards.
        frame = bytes(head), tuple(memoryview(part.tobytes()) for part in parts)
        size = len(head) + sum(part.nbytes for part in parts)
        for seconds in self._transport.network._delays():
            self._under_way += size
            self._line.put(_Sent(self, frame, size), seconds)
        return True

    def is_delivered(self, size: int) -> None:
        """Count a frame as no longer under way."""
        self._under_way -= size
        if self._refused and self._under_way <= _FULL // 2:
            self._refused = False
            self._transport.tell(self.on_room)
