"""Scaffold: an in-process wire."""
from __future__ import annotations
import asyncio
from typing import Any
from aiorts.errors import LinkError
from aiorts.links.transport import Caller, Peer

class Net:
    def __init__(self) -> None:
        self.nodes: dict[str, Wire] = {}
        self.halves: dict[Any, Any] = {}
    def wire(self) -> Wire:
        return Wire(self)

class Chan:
    def __init__(self, events: Any) -> None:
        self.events, self.other, self.queue, self.open = events, None, [], True
    def send(self, head: bytes, parts: Any = ()) -> bool:
        if self.other is not None:
            if not self.other.queue:
                asyncio.get_running_loop().call_soon(self.other.deliver)
            self.other.queue.append((head, tuple(memoryview(p).toreadonly() for p in parts)))
        return True
    def deliver(self) -> None:
        frames, self.queue = self.queue, []
        if self.open:
            self.events.on_frames(frames)
    def close(self) -> None:
        self.open = False

class Wire:
    def __init__(self, net: Net) -> None:
        self.net, self.handlers, self.tells, self.chans = net, {}, [], []
    async def open(self, kernel: Any) -> None:
        self.kernel = kernel
        self.peer = Peer("host", kernel.name, kernel.epoch)
        for other in self.net.nodes.values():
            for tell in other.tells:
                tell(self.peer, True)
        self.net.nodes[kernel.name] = self
    async def close(self) -> None:
        self.net.nodes.pop(self.kernel.name, None)
        for other in self.net.nodes.values():
            for tell in other.tells:
                tell(self.peer, False)
        for chan in self.chans:
            if chan.other is not None and chan.other.open:
                chan.other.open = False
                chan.other.events.on_state(False, "gone")
    def presence(self, tell: Any) -> Any:
        self.tells.append(tell)
        for other in self.net.nodes.values():
            if other is not self:
                tell(other.peer, True)
    async def channel(self, offer: Any, events: Any) -> Any:
        key = (offer.link, offer.number, offer.reader_epoch)
        mine = Chan(events)
        self.chans.append(mine)
        half = self.net.halves.setdefault(key, [])
        half.append(mine)
        while len(half) < 2:
            await asyncio.sleep(0)
        mine.other = half[1] if half[0] is mine else half[0]
        return mine
    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        node = self.net.nodes.get(peer.kernel)
        if node is None:
            raise LinkError("gone")
        return await node.handlers[what](body, Caller(self.peer, "me"))
    def answer(self, what: str, handler: Any) -> None:
        self.handlers[what] = handler
