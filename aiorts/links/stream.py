"""Messages over a stream socket that never blocks: what arrives is cut into messages, what does not fit waits.

A message is a head of 12 bytes (bytes that follow, kind, parts, zeros behind the body, a number), the length of each
part, its body, its parts. Each part begins at a multiple of 8 bytes of the message, so that arrays on it are aligned. A
message of 64 KiB or more is received straight into a buffer of its own, and not copied.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Final, TypeAlias

from aiorts.model.links import Buffer
from aiorts.wire import sealed_bytes

_HEAD: Final = struct.Struct("<IBBHI")
_LARGE: Final = 65_536
_AT_ONCE: Final = 65_536
"""Bytes that are received at once. Above 128 KiB memory of its own is asked of the system each time: 14 us."""
_LARGEST: Final = 80 << 20
"""Bytes of one message at the most."""
_FULL: Final = 4 << 20
"""Bytes that wait to be sent beyond which no more is taken."""
_DESCRIPTOR: Final = struct.Struct("i")
_ONE: Final = 20
"""Bytes in which the system tells of one descriptor (CMSG_LEN); in CMSG_SPACE, which is rounded up, are two."""
_VECTORS: Final = 64
"""Buffers of one system call."""


Message: TypeAlias = tuple[int, int, memoryview, tuple[memoryview, ...]]
"""A message that has arrived: kind, number, body and parts, which are views that nothing writes to any more."""


class Stream:
    """One connected socket.

    Args:
        arrived: called with the messages that came together.
        drained: called when `send` takes messages again.
        ended: called once, with the reason, when the connection is over.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        sock: socket.socket,
        arrived: Callable[[list[Message]], None],
        drained: Callable[[], None],
        ended: Callable[[str], None],
    ) -> None:
        self._loop, self._socket = loop, sock
        self._arrived, self._drained, self._ended = arrived, drained, ended
        self._rest = b""
        self._large: memoryview | None = None
        self._filled = 0
        self._waiting: deque[memoryview] = deque()
        self._waits = 0
        """Bytes in `_waiting`."""
        self._refused = self._broken = self._reset = False
        self._expects = False
        """Whether a descriptor may come."""
        self._descriptor = -1
        """The one that has come; -1: none."""
        self.closed = False
        sock.setblocking(False)
        loop.add_reader(sock.fileno(), self._readable)

    # -- sending ---------------------------------------------------------------------------------------------------

    def send(self, kind: int, number: int, body: Buffer, parts: Sequence[memoryview] = ()) -> bool:
        """Send a message; False: it was not taken, since too much waits or the connection is over."""
        if self.closed or self._broken:
            return False
        if self._waits >= _FULL:
            self._refused = True
            return False
        if parts:
            flat = [part.cast("B") if part.format != "B" or part.ndim != 1 else part for part in parts]
            sizes = [part.nbytes for part in flat]
            lengths = struct.pack(f"<{len(sizes)}I", *sizes)
            length = len(lengths) + len(body)
            pad = -(_HEAD.size + length) % 8
            length += pad + _room(sizes)
            head = _HEAD.pack(length, kind, len(sizes), pad, number) + lengths
            vectors = [memoryview(head), memoryview(body), *_aligned(flat, pad)]
        else:
            vectors = [memoryview(_HEAD.pack(len(body), kind, 0, 0, number) + body)]
        if not self._waiting:
            vectors = self._send_now(vectors)
            if not vectors:
                return not self._broken
            self._loop.add_writer(self._socket.fileno(), self._writable)
        self._waiting.extend(vectors)
        self._waits += sum(map(len, vectors))
        return True

    def send_descriptor(self, kind: int, number: int, body: bytes, descriptor: int) -> bool:
        """Send a short message with a descriptor; False: it was not taken, since others wait."""
        if self.closed or self._broken or self._waiting:
            return False
        data = _HEAD.pack(len(body), kind, 0, 0, number) + body
        try:
            # All of it or nothing: so short a message is never cut.
            self._socket.sendmsg([data], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, struct.pack("i", descriptor))])
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:
            self._broken = True
            return False
        return True

    def _send_now(self, vectors: list[memoryview]) -> list[memoryview]:
        """Send what the socket takes; returns what is left."""
        while vectors:
            try:
                sock = self._socket
                sent = sock.send(vectors[0]) if len(vectors) == 1 else sock.sendmsg(vectors[:_VECTORS])
            except (BlockingIOError, InterruptedError):
                return vectors
            except OSError:
                # What the other end said last may still be read, and that it has ended.
                self._broken = True
                return []
            place = 0
            while place < len(vectors) and sent >= len(vectors[place]):
                sent -= len(vectors[place])
                place += 1
            vectors = vectors[place:]
            if sent:
                vectors[0] = vectors[0][sent:]
        return vectors

    def _writable(self) -> None:
        waiting = self._waiting
        while waiting:
            vectors = [waiting.popleft() for _ in range(min(_VECTORS, len(waiting)))]
            left = self._send_now(vectors)
            if self._broken:
                waiting.clear()
            waiting.extendleft(reversed(left))
            if left:
                break
        self._waits = sum(map(len, waiting))
        if not waiting:
            self._loop.remove_writer(self._socket.fileno())
        if self._refused and self._waits < _FULL // 2:
            self._refused = False
            self._drained()

    # -- receiving -------------------------------------------------------------------------------------------------

    def _readable(self) -> None:
        try:
            if self._expects:
                data, count = self._receive_descriptor()
            elif self._large is not None:
                count = self._socket.recv_into(self._large[self._filled :])
                data = b""
            else:
                data = self._socket.recv(_AT_ONCE)
                count = len(data)
        except (BlockingIOError, InterruptedError):
            return self._end("it has ended") if self._reset else None
        except ConnectionResetError:
            if self._reset:
                return self._end("it has ended")
            # It ended with something unread, and what it said before that is still there. Not every loop calls again.
            self._reset = True
            return self._readable()
        except OSError as error:
            return self._end(error.strerror or "broken")
        except ValueError as error:
            return self._end(f"it does not speak this protocol: {error}")
        if not count:
            return self._end("it has ended")
        messages: list[Message] = []
        try:
            if self._large is None:
                self._cut(self._rest + data if self._rest else data, messages)
            else:
                self._filled += count
                if self._filled == len(self._large):
                    messages.append(_message(self._large.toreadonly()))
                    self._large = None
        except ValueError as error:
            return self._end(f"it does not speak this protocol: {error}")
        if messages:
            self._arrived(messages)
        return self._readable() if self._reset and not self.closed else None

    def expect_descriptor(self) -> None:
        """Receive one descriptor, which comes with any message from now on.

        Others are never received: where the system is not asked for them, it closes what a peer has sent.
        """
        self._expects = True

    def take_descriptor(self) -> int | None:
        """The descriptor that has come, which the caller closes; None: none has."""
        found, self._descriptor = self._descriptor, -1
        return found if found >= 0 else None

    def _receive_descriptor(self) -> tuple[bytes, int]:
        """What `recv` receives, and a descriptor that comes with it. ValueError: more than one."""
        large = self._large
        flags = getattr(socket, "MSG_CMSG_CLOEXEC", 0)
        if large is None:
            data, rights, found, _ = self._socket.recvmsg(_AT_ONCE, _ONE, flags)
            count = len(data)
        else:
            count, rights, found, _ = self._socket.recvmsg_into([large[self._filled :]], _ONE, flags)
            data = b""
        came = [
            descriptor
            for level, kind, packed in rights
            if (level, kind) == (socket.SOL_SOCKET, socket.SCM_RIGHTS)
            for (descriptor,) in _DESCRIPTOR.iter_unpack(packed[: len(packed) - len(packed) % _DESCRIPTOR.size])
        ]
        if len(came) > 1 or found & socket.MSG_CTRUNC:
            for descriptor in came:
                os.close(descriptor)
            raise ValueError("more than one descriptor with a message")
        if came:
            self._expects, self._descriptor = False, came[0]
        return data, count

    def _cut(self, data: bytes, messages: list[Message]) -> None:
        """The messages in what has come, and what is left of the next one."""
        view, place, end = memoryview(data), 0, len(data)
        while end - place >= _HEAD.size:
            length, kind, parts, _, number = _HEAD.unpack_from(data, place)
            size = _HEAD.size + length
            if not parts and size <= end - place:
                messages.append((kind, number, view[place + _HEAD.size : place + size], ()))
                place += size
                continue
            if size > _LARGEST:
                raise ValueError(f"a message of {size} bytes")
            if size > end - place:
                if size >= _LARGE:
                    self._large = sealed_bytes(size)
                    self._filled = end - place
                    self._large[: self._filled] = view[place:]
                    place = end
                break
            messages.append(_message(view[place : place + size]))
            place += size
        self._rest = data[place:]

    def close(self) -> None:
        """End the connection; nothing is called any more. Idempotent."""
        if self.closed:
            return
        self.closed = True
        for remove in (self._loop.remove_reader, self._loop.remove_writer):
            with contextlib.suppress(ValueError, OSError, RuntimeError):
                remove(self._socket.fileno())
        self._socket.close()
        self._waiting.clear()
        if (descriptor := self.take_descriptor()) is not None:
            os.close(descriptor)

    def _end(self, why: str) -> None:
        if not self.closed:
            self.close()
            self._ended(why)


def _message(view: memoryview) -> Message:
    _, kind, count, pad, number = _HEAD.unpack_from(view)
    place = _HEAD.size
    if not count:
        return kind, number, view[place:], ()
    if len(view) < place + 4 * count:
        raise ValueError("a message that is too short")
    sizes = struct.unpack_from(f"<{count}I", view, place)
    place += 4 * count
    start = len(view) - _room(sizes)
    if start - pad < place:
        raise ValueError("parts that are longer than their message")
    body, parts = view[place : start - pad], []
    for size in sizes:
        parts.append(view[start : start + size])
        start += size + -size % 8
    return kind, number, body, tuple(parts)


def _room(sizes: Sequence[int]) -> int:
    """Bytes that parts of these sizes take: each but the last one fills up eight bytes."""
    return sum(size + -size % 8 for size in sizes[:-1]) + sizes[-1]


def _aligned(parts: Sequence[memoryview], pad: int) -> Iterator[memoryview]:
    """The parts, with what lies before each."""
    for part in parts:
        if pad:
            yield memoryview(bytes(pad))
        yield part
        pad = -part.nbytes % 8
