"""Clients that nobody wants, for as long as the process lives: `python garbage.py SOCKET COUNT [KIND...]`."""

from __future__ import annotations

import contextlib
import os
import random
import socket
import sys
import time
from collections.abc import Iterator

import msgpack  # type: ignore[import-untyped]

from aiorts.sessions.folder import entries


def framed(body: bytes) -> bytes:
    """A body with its length."""
    return len(body).to_bytes(4, "big") + body


HELLO = framed(msgpack.packb({"hello": {"oldest": 1, "newest": 1, "who": "garbage"}}))


def calls(operation: str, epoch: str) -> bytes:
    """As many calls as go into one write."""
    return b"".join(
        framed(msgpack.packb({"id": number, "op": operation, "epoch": epoch, "args": {}})) for number in range(1, 2000)
    )


class Garbage:
    """One of these clients; `turn` is called again and again, and may raise what sockets raise."""

    def __init__(self, path: str, kind: str, epoch: str, seed: int) -> None:
        self.path, self.kind, self.epoch = path, kind, epoch
        self.random = random.Random(seed)
        self.socket: socket.socket | None = None
        self.turns: Iterator[None] = iter(())
        self.due = 0.0

    def turn(self) -> None:
        """Do the next thing."""
        if time.monotonic() < self.due:
            return
        try:
            next(self.turns)
        except (StopIteration, OSError):
            if self.socket is not None:
                self.socket.close()
            self.due = time.monotonic() + 0.02
            self.socket = socket.socket(socket.AF_UNIX)
            self.socket.setblocking(False)
            self.turns = getattr(self, self.kind)(self.socket)

    def _say(self, connected: socket.socket, data: bytes) -> Iterator[None]:
        view = memoryview(data)
        while view:
            with contextlib.suppress(BlockingIOError):
                view = view[connected.send(view) :]
            yield

    def malformed(self, connected: socket.socket) -> Iterator[None]:
        """Random bytes in frames, random lengths, wrong shapes."""
        connected.connect(self.path)
        if self.random.random() < 0.5:
            yield from self._say(connected, HELLO)
        wrong = [b"\x81\x80\x01", b"\xc1", b"", b"\x91" * 400, b"\xdf\xff\xff\xff\xff", self.random.randbytes(60)]
        yield from self._say(connected, framed(self.random.choice(wrong)))
        yield from self._say(connected, self.random.randbytes(200))

    def flood(self, connected: socket.socket) -> Iterator[None]:
        """Calls at full speed; the answers are read."""
        connected.connect(self.path)
        yield from self._say(connected, HELLO)
        data = calls(self.random.choice(("names", "profile", "nothing", "activate")), self.epoch)
        while True:
            for _ in self._say(connected, data):
                with contextlib.suppress(BlockingIOError):
                    if not connected.recv(1 << 20):
                        return
                yield

    def never_reads(self, connected: socket.socket) -> Iterator[None]:
        """Calls at full speed; no answer is read."""
        connected.connect(self.path)
        yield from self._say(connected, HELLO)
        while True:
            yield from self._say(connected, calls("profile", self.epoch))

    def half_open(self, connected: socket.socket) -> Iterator[None]:
        """The first half of a frame, and nothing more."""
        connected.connect(self.path)
        yield from self._say(connected, HELLO[: self.random.choice((0, 3, 20))])
        until = time.monotonic() + 3600
        while time.monotonic() < until:
            self.due = time.monotonic() + 1.0
            yield

    def half_closed(self, connected: socket.socket) -> Iterator[None]:
        """Calls, and the end of what it sends."""
        connected.connect(self.path)
        yield from self._say(connected, HELLO + calls("names", self.epoch)[:3000])
        connected.shutdown(socket.SHUT_WR)
        self.due = time.monotonic() + 1.0
        yield

    def vanishes(self, connected: socket.socket) -> Iterator[None]:
        """Connects, and is gone."""
        connected.connect(self.path)
        yield

    def slow(self, connected: socket.socket) -> Iterator[None]:
        """One byte a second."""
        connected.connect(self.path)
        for byte in HELLO * 100:
            yield from self._say(connected, bytes([byte]))
            self.due = time.monotonic() + 1.0
            yield


KINDS = ("malformed", "flood", "never_reads", "half_open", "half_closed", "vanishes", "slow")


def main() -> None:
    """All of them at a time."""
    path, count, kinds = sys.argv[1], int(sys.argv[2]), sys.argv[3:] or KINDS
    epoch = next(one.epoch for one in entries() if one.path == path)
    clients = [Garbage(path, kinds[number % len(kinds)], epoch, number) for number in range(count)]
    print("ready", flush=True)
    parent = os.getppid()
    while os.getppid() == parent:
        for one in clients:
            one.turn()
        time.sleep(0.0005)


if __name__ == "__main__":
    main()
