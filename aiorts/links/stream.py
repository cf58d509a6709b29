"""Messages over a stream socket that never blocks: received bytes are cut into messages, unsent messages wait.

A message is a head of 12 bytes (bytes that follow, kind, parts, zeros behind the body, a number), the length of each
part, its body, its parts. Each part begins at a multiple of 8 bytes of the message, so that arrays on it are aligned. A
message of 64 KiB or more is received straight into a buffer of its own, and not copied.

Messages wait in two queues, each with a bound of its own. Control messages go first: they wait for the rest of the
message that is partly sent, and for the bytes in the socket (208 KiB on Linux); never for the samples behind those.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import select
import socket
import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Final, TypeAlias

from aiorts.model.links import Buffer, Turn
from aiorts.wire import sealed_bytes

_HEAD: Final = struct.Struct("<IBBHI")
_LARGE: Final = 65_536
_AT_ONCE: Final = 65_536
"""Bytes that are received at once. Above 128 KiB each buffer is memory of its own from the system: 14 us."""
_SHORT: Final = 512
"""The most bytes of a received message whose body is copied."""
_ONE_TURN: Final = 1 << 20
"""Bytes after which a turn of the loop receives no more. With 64 KiB a loop whose turns take 0.1 s needed four
turns to reach a question behind the 208 KiB that a socket holds."""
_ONE_TURN_SECONDS: Final = 0.005
"""Seconds after which a turn of the loop receives no more: small messages need more time than bytes."""
_LARGEST: Final = 80 << 20
"""The most bytes of one message."""
_DESCRIPTOR: Final = struct.Struct("i")
_ONE: Final = 20
"""The ancillary bytes of one descriptor (CMSG_LEN); CMSG_SPACE is rounded up and has room for two."""
_GONE: Final = (errno.EPIPE, errno.ECONNRESET)
"""Errors of a connection whose other end reads no more. Any other error, such as a lack of memory, is of this end."""
_VECTORS: Final = 64
"""The most buffers of one system call."""


Message: TypeAlias = tuple[int, int, memoryview, tuple[memoryview, ...]]
"""A message that has arrived: kind, number, body and parts, which are views that nothing writes to any more."""


Vectors: TypeAlias = list[bytes | memoryview]
Outgoing: TypeAlias = tuple[Vectors, int, int]
"""A message that waits: its buffers, their bytes in all, and the descriptor that goes with it; -1: none does."""


class _Queue:
    """Messages that wait for their turn.

    Args:
        full: bytes beyond which no message is taken.
        most: messages beyond which no more are taken.
    """

    def __init__(self, full: int, most: int) -> None:
        self.messages: deque[Outgoing] = deque()
        self.size = 0
        """Bytes of the messages."""
        self._full, self._most = full, most
        self._refused = False

    def takes(self, turn: Turn) -> bool:
        """Whether one more message is taken; with `Turn.LAST`, up to twice as many, of any size. Notes a refusal."""
        count = len(self.messages)
        if (self.size < self._full and count < self._most) or (turn is Turn.LAST and count < 2 * self._most):
            return True
        self._refused = True
        return False

    def room_made(self) -> bool:
        """Whether there is room again after a refusal; True once for each refusal."""
        made = self._refused and self.size < self._full // 2 and len(self.messages) < self._most // 2
        self._refused = self._refused and not made
        return made


class Stream:
    """One connected socket.

    Args:
        arrived: called with the messages that came together.
        arrived_alone: called with the kind, the number and the body of a message without parts that came alone, as most
            do; where it returns False, `arrived` is called.
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
        arrived_alone: Callable[[int, int, Buffer], bool] = lambda *_: False,
    ) -> None:
        self._loop, self._socket = loop, sock
        self._arrived_alone = arrived_alone
        self._arrived, self._drained, self._ended = arrived, drained, ended
        self._rest = b""
        self._large: memoryview | None = None
        self._filled = 0
        self._begun: Vectors = []
        """The bytes of a partly sent message that are still to be sent."""
        self._waits = False
        """Whether anything waits to be sent."""
        self._control = _Queue(16 << 20, 16_384)
        self._samples = _Queue(4 << 20, 65_536)
        self._broken = self._reset = False
        self._expects = False
        """Whether a descriptor may come."""
        self._descriptor = -1
        """The descriptor that was received and not taken yet; -1: none."""
        self.closed = False
        self._hung_up: select.poll | None = None
        """Says whether the other end has hung up, on a loop that calls a reader only once after an error.

        That call may be for data; uvloop does not call again for the end behind the data. One poll takes 0.4 us.
        """
        if not isinstance(loop, asyncio.SelectorEventLoop):
            self._hung_up = select.poll()
            self._hung_up.register(sock.fileno(), 0)
        sock.setblocking(False)
        loop.add_reader(sock.fileno(), self._readable)

    # -- sending ---------------------------------------------------------------------------------------------------

    def send_alone(self, kind: int, number: int, body: bytes) -> bool:
        """`send`, written out for a message without parts while no message waits; False: call `send` instead."""
        if self._waits or self.closed or self._broken:
            return False
        data = _HEAD.pack(len(body), kind, 0, 0, number) + body
        try:
            sent = self._socket.send(data)
        except OSError:
            return False
        if sent < len(data):
            self._wait()
            self._begun = [memoryview(data)[sent:]]
        return True

    def send(
        self, kind: int, number: int, body: Buffer, parts: Sequence[memoryview] = (), turn: Turn = Turn.SAMPLE
    ) -> bool:
        """Send a message; False: it was not taken, since too much waits or the connection is over."""
        if self.closed or self._broken:
            return False
        queue = self._control if turn is Turn.CONTROL else self._samples
        if self._waits and not queue.takes(turn):
            return False
        vectors: Vectors
        if parts:
            flat = [part.cast("B") if part.format != "B" or part.ndim != 1 else part for part in parts]
            sizes = [part.nbytes for part in flat]
            lengths = struct.pack(f"<{len(sizes)}I", *sizes)
            length = len(lengths) + len(body)
            pad = -(_HEAD.size + length) % 8
            length += pad + _room(sizes)
            head = _HEAD.pack(length, kind, len(sizes), pad, number) + lengths
            vectors, size = [head, memoryview(body), *_aligned(flat, pad)], _HEAD.size + length
        else:
            data = _HEAD.pack(len(body), kind, 0, 0, number) + body
            vectors = [data]
            size = len(data)
        sent = 0
        if not self._waits:
            sent = self._put(vectors)
            if sent == size:
                return True
            if self._broken:
                return False
            self._wait()
        if sent:
            self._begun = _after(vectors, sent)
        else:
            queue.messages.append((vectors, size, -1))
            queue.size += size
        return True

    def control(self, kind: int, number: int, body: Buffer) -> bool:
        """Send a control message, before all samples that wait. See `send`."""
        return self.send(kind, number, body, (), Turn.CONTROL)

    def send_descriptor(self, kind: int, number: int, body: bytes, descriptor: int) -> bool:
        """Send a short message with a descriptor, which stays the caller's; False: it will not be sent.

        The message goes after the samples that wait, since those refer to earlier rings.
        """
        if self.closed or self._broken or not self._samples.takes(Turn.LAST):
            return False
        try:
            own = os.dup(descriptor)
        except OSError:
            return False
        if not self._waits:
            self._wait()
        data = _HEAD.pack(len(body), kind, 0, 0, number) + body
        self._samples.messages.append(([data], len(data), own))
        self._samples.size += len(data)
        return True

    def _wait(self) -> None:
        self._waits = True
        self._loop.add_writer(self._socket.fileno(), self._writable)

    def _put(self, vectors: Vectors, descriptor: int = -1) -> int:
        """Send as much as the socket takes in one call; the number of bytes sent."""
        try:
            if descriptor >= 0:
                rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, _DESCRIPTOR.pack(descriptor))]
                return self._socket.sendmsg(vectors, rights)
            return self._socket.send(vectors[0]) if len(vectors) == 1 else self._socket.sendmsg(vectors[:_VECTORS])
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError as error:
            self._broken = True
            # Where the other end has ended, its last messages may still be read, and after them its end.
            if error.errno not in _GONE:
                self._loop.call_soon(self._end, error.strerror or "broken")
            return 0

    def _writable(self) -> None:
        while self._send_next():
            pass
        if self._broken:
            self._forget()
        if not (self._begun or self._control.messages or self._samples.messages):
            self._waits = False
            self._loop.remove_writer(self._socket.fileno())
        if self._control.room_made() | self._samples.room_made():
            self._drained()

    def _send_next(self) -> bool:
        """Send the next messages, as many as go in one call; False: none waits, or the socket takes no more."""
        if self._begun:
            if sent := self._put(self._begun):
                self._begun = _after(self._begun, sent)
            return sent > 0
        queue = self._control if self._control.messages else self._samples
        batch: list[Outgoing] = []
        vectors: Vectors = []
        for message in islice(queue.messages, _VECTORS):
            if batch and (message[2] >= 0 or len(vectors) + len(message[0]) > _VECTORS):
                break
            batch.append(message)
            vectors += message[0]
            if message[2] >= 0:
                break
        if not batch or not (left := self._put(vectors, batch[0][2])):
            return False
        for its, size, descriptor in batch:
            if not left:
                break
            queue.messages.popleft()
            queue.size -= size
            if descriptor >= 0:
                os.close(descriptor)
            if left < size:
                self._begun = _after(its, left)
                break
            left -= size
        return True

    def _forget(self) -> None:
        """Discard all messages that wait."""
        self._begun = []
        for queue in (self._control, self._samples):
            for _, _, descriptor in queue.messages:
                if descriptor >= 0:
                    os.close(descriptor)
            queue.messages.clear()
            queue.size = 0

    # -- receiving -------------------------------------------------------------------------------------------------

    def _readable(self) -> None:
        if self.closed or not (count := self._receive()):
            return
        until, left = self._loop.time() + _ONE_TURN_SECONDS, _ONE_TURN - count
        while left > 0 and (count := self._receive()) and self._loop.time() < until:
            left -= count
        if self._reset and not self.closed:
            self._loop.call_soon(self._readable)  # read to the end: the loop may not call again

    def _receive(self) -> int:
        """Receive once; the number of bytes if there may be more, 0 if there is no more or the connection is over."""
        asked = _AT_ONCE if self._large is None else len(self._large) - self._filled
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
            return self._end("it has ended") if self._reset else 0
        except ConnectionResetError:
            if self._reset:
                return self._end("it has ended")
            # The other end ended with unread bytes; its earlier messages are still there. Not every loop calls again.
            self._reset = True
            return self._receive()
        except OSError as error:
            return self._end(error.strerror or "broken")
        except ValueError as error:
            return self._end(f"it does not speak this protocol: {error}")
        if not count:
            return self._end("it has ended")
        if not self._rest and count >= _HEAD.size and self._large is None:
            length, kind, parts, _, number = _HEAD.unpack_from(data)
            if (
                not parts
                and length == count - _HEAD.size
                # To make a view of a short message takes longer than to copy the message.
                and self._arrived_alone(
                    kind, number, data[_HEAD.size :] if count <= _SHORT else memoryview(data)[_HEAD.size :]
                )
            ):
                return 0 if count < asked and self._hung_up is None and not self._reset else self._more(count, asked)
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
        return self._more(count, asked)

    def _more(self, count: int, asked: int) -> int:
        """The number of bytes received, where there may be more; else 0."""
        if self.closed:
            return 0
        if self._hung_up is not None and not self._reset and self._hung_up.poll(0):
            self._reset = True
        return count if self._reset else count * (count == asked)

    def expect_descriptor(self) -> None:
        """Allow one descriptor to come, with any message from now on.

        Unexpected descriptors are never received: the system closes those for which it is not asked.
        """
        self._expects = True

    def take_descriptor(self) -> int | None:
        """The descriptor that was received, which the caller closes; None: none was."""
        found, self._descriptor = self._descriptor, -1
        return found if found >= 0 else None

    def _receive_descriptor(self) -> tuple[bytes, int]:
        """The data, as from `recv`, and their count; keep a descriptor that comes along. ValueError: several."""
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
        """Cut received bytes into messages, and keep the beginning of the next one."""
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
        """End the connection; no callback is called any more. Idempotent."""
        if self.closed:
            return
        self.closed = True
        for remove in (self._loop.remove_reader, self._loop.remove_writer):
            with contextlib.suppress(ValueError, OSError, RuntimeError):
                remove(self._socket.fileno())
        self._socket.close()
        self._forget()
        if (descriptor := self.take_descriptor()) is not None:
            os.close(descriptor)

    def _end(self, why: str) -> int:
        if not self.closed:
            self.close()
            self._ended(why)
        return 0


def _after(vectors: Vectors, sent: int) -> Vectors:
    """The buffers without their first `sent` bytes."""
    place = 0
    while place < len(vectors) and sent >= len(vectors[place]):
        sent -= len(vectors[place])
        place += 1
    left = vectors[place:]
    if sent:
        left[0] = memoryview(left[0])[sent:]
    return left


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
    """Bytes that parts of these sizes take: each but the last is padded to a multiple of eight."""
    return sum(size + -size % 8 for size in sizes[:-1]) + sizes[-1]


def _aligned(parts: Sequence[memoryview], pad: int) -> Iterator[memoryview]:
    """The parts, each after its padding."""
    for part in parts:
        if pad:
            yield memoryview(bytes(pad))
        yield part
        pad = -part.nbytes % 8
