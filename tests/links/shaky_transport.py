"""A transport whose kernel is held up, killed and heard late: at any step of finding, greeting, offering, answering."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from random import Random
from typing import Any

from aiorts.errors import LinkError, LinkTimeout
from aiorts.links import Caller, Channel, ChannelEvents, LinkOffer, Peer


class ShakyTransport:
    """Another transport, behind which its kernel stands still or is dead, and whose messages take their time.

    While it is held nothing comes to the kernel and nothing that it does gets out. Each question and each answer is
    under way for as long as `delay` says, whatever was sent before or after it; an answer is lost where `lost` says so.
    `step` hears of each step.
    """

    def __init__(
        self, transport: Any, delay: Callable[[], float], lost: Callable[[], bool], step: Callable[[str], None]
    ) -> None:
        self._transport, self._delay, self._lost, self._step = transport, delay, lost, step
        self._free, self._calm = asyncio.Event(), asyncio.Event()
        self._free.set()
        self._waiting: deque[Callable[[], None]] = deque()
        self._carried: set[asyncio.Task[bytes]] = set()
        self.losing = 0
        """Questions whose answer is lost, and that are not timed out yet."""
        self.dead = False

    # -- what goes wrong -------------------------------------------------------------------------------------------

    def hold(self) -> None:
        """The kernel stands still."""
        self._free.clear()

    def go(self) -> None:
        """It goes on, and all that has waited comes in order."""
        self._free.set()
        while self._waiting and self._free.is_set():
            self._waiting.popleft()()

    def be_calm(self) -> None:
        """What is under way arrives now, and from now on at once."""
        self._calm.set()

    async def kill(self) -> None:
        """The kernel is no more: others see that its connections have ended."""
        self.dead = True
        await self._transport.close()

    # -- the transport ---------------------------------------------------------------------------------------------

    async def open(self, kernel: Any) -> None:
        if self.dead:
            raise LinkError("is dead")
        await self._transport.open(kernel)

    async def close(self) -> None:
        if not self.dead:
            await self._transport.close()

    def presence(self, tell: Callable[[Peer, bool], None]) -> Callable[[], None]:
        def told(peer: Peer, up: bool) -> None:
            self._step("present" if up else "gone")
            tell(peer, up)

        forget: Callable[[], None] = self._transport.presence(lambda peer, up: self.arrive(partial(told, peer, up)))
        return forget

    def arrive(self, what: Callable[[], None]) -> None:
        """Something comes to the kernel."""
        if self.dead:
            return
        if self._free.is_set():
            what()
        else:
            self._waiting.append(what)

    async def _under_way(self) -> None:
        if (seconds := self._delay()) and not self._calm.is_set():
            try:
                await asyncio.wait_for(self._calm.wait(), seconds)
            except TimeoutError:
                return

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        if self.dead:
            raise LinkError("is dead")
        self._step(f"ask {what}")
        # It goes on its way also where nobody waits for the answer any more.
        carried = asyncio.ensure_future(self._carry(peer, what, body))
        self._carried.add(carried)
        carried.add_done_callback(self._done)
        if self._lost() and not self._calm.is_set():
            self.losing += 1
            try:
                await asyncio.sleep(within)
            finally:
                self.losing -= 1
            raise LinkTimeout(f"{peer.kernel}: no answer within {within:g} s")
        try:
            return await asyncio.wait_for(asyncio.shield(carried), within)
        except TimeoutError:
            raise LinkTimeout(f"{peer.kernel}: no answer within {within:g} s") from None

    def _done(self, carried: asyncio.Task[bytes]) -> None:
        self._carried.discard(carried)
        if not carried.cancelled():
            carried.exception()

    async def _carry(self, peer: Peer, what: str, body: bytes) -> bytes:
        await self._free.wait()
        await self._under_way()
        answer: bytes = await self._transport.ask(peer, what, body, within=60.0)
        await self._under_way()
        await self._free.wait()
        self._step(f"answer {what}")
        return answer

    def answer(self, what: str, handler: Callable[[bytes, Caller], Awaitable[bytes]]) -> None:
        async def answered(body: bytes, caller: Caller) -> bytes:
            await self._free.wait()
            self._step(f"hear {what}")
            if self.dead:
                raise LinkError("is dead")
            return await handler(body, caller)

        self._transport.answer(what, answered)

    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel:
        self._step("channel")
        await self._free.wait()
        heard = _ShakyEvents(self, events)
        heard.channel = await self._transport.channel(offer, heard)
        return heard

    @property
    def is_free(self) -> bool:
        """Whether the kernel does not stand still."""
        return self._free.is_set()


class _ShakyEvents:
    """A channel, and what comes over it."""

    def __init__(self, transport: ShakyTransport, events: ChannelEvents) -> None:
        self._transport, self._events = transport, events
        self.channel: Channel
        self._closed = self._refused = False

    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        if self._transport.is_free:
            return self.channel.send(head, parts)
        if not self._refused:
            self._refused = True
            self._transport.arrive(self.on_room)
        return False

    def close(self) -> None:
        self._closed = True
        self.channel.close()

    def _hear(self, method: str, *values: Any) -> None:
        def hear() -> None:
            self._refused = False
            if not self._closed:
                getattr(self._events, method)(*values)

        self._transport.arrive(hear)

    def on_frames(self, frames: Any) -> None:
        self._hear("on_frames", frames)

    def on_room(self) -> None:
        self._hear("on_room")

    def on_state(self, up: bool, why: str) -> None:
        self._hear("on_state", up, why)

    def on_clock(self, ahead_ns: int, within_ns: int) -> None:
        self._hear("on_clock", ahead_ns, within_ns)


def delays(random: Random) -> Callable[[], float]:
    """How long messages are under way in one schedule: not at all, some, or longer than a question waits."""
    longest = random.choice((0.0, 0.01, 0.3, 3.0))
    return lambda: random.random() * longest if longest and random.random() < 0.7 else 0.0
