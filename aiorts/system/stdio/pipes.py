"""Makes any component a Unix filter: feeds its in-ports from standard input, writes its out-ports to standard output.

Lines are JSON, one sample each (`aiorts.wire.lines`). A bad line is reported and counted, and the others are processed;
the end of input ends the source. No line is read before its reader has room for it: a connector with full = block
holds back the program that writes to our standard input.
"""

from __future__ import annotations

import asyncio
import errno
import os
import stat
import sys
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, Final

from anyio import WouldBlock

from aiorts.errors import RecordError, WriteTimeout
from aiorts.kernel.component import Component
from aiorts.kernel.loop.line_stream import LineStream
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.ports.connector import unread_at
from aiorts.wire.lines import LineReader, LineWriter

_CHUNK: Final = 1 << 16
_LONGEST: Final = 64 << 20
"""The most bytes of a line."""
_MARK: Final = b"\xef\xbb\xbf"
"""A byte order mark, which some editors put before UTF-8."""
_GONE: Final = (errno.EIO, errno.EBADF)
"""The errors of a terminal that was hung up, and of a descriptor that was closed."""

_LINES_KEPT: Final = 4096
"""The number of samples of a port whose line numbers are kept: more than fit into a connector and its reader."""
_TURNS: Final = 50
"""Turns of the loop for which a wait for a component checks in each turn; afterwards it sleeps between checks."""
_LOOK: Final = 0.001
_STUCK_S: Final = 10.0
"""Seconds after which it is an error that a reader reads nothing although it waits for no other component."""

Notify = Callable[[int, str], None]


class Feed:
    """Writes to the out-ports of a source, in the order of lines if `ordered`; keeps the lines of recent samples.

    Args:
        ordered: whether a sample is written only after earlier samples were read from other ports.
        held_up: tells whether the reader itself waits for another component; without it a full port is waited for
            without end.
    """

    def __init__(
        self, outs: Mapping[str, OutPort[Any]], *, ordered: bool, held_up: Callable[[], bool] | None = None
    ) -> None:
        self._held_up = held_up if len(outs) > 1 else None
        self._outs = outs
        self._ordered = ordered and len(outs) > 1
        self._before: OutPort[Any] | None = None
        self._lines: dict[str, deque[int]] = {name: deque(maxlen=_LINES_KEPT) for name in outs}
        self._written = dict.fromkeys(outs, 0)

    async def write(self, name: str, number: int, sample: Any) -> None:
        """Write the sample of line `number` to the port `name`.

        Raises:
            WriteTimeout: the port is full, and its reader takes nothing because it waits for a sample of another port.
        """
        port = self._outs[name]
        if self._ordered and port is not self._before:
            if self._before is not None:
                await _taken(self._before)
            self._before = port
        self._lines[name].append(number)
        self._written[name] += 1
        if self._held_up is None:
            await port.write(sample)
            return
        try:
            port.write_nowait(sample)
        except WouldBlock:
            await self._write_unless_stuck(port, sample, self._held_up)

    async def _write_unless_stuck(self, port: OutPort[Any], sample: Any, held_up: Callable[[], bool]) -> None:
        while True:
            try:
                await asyncio.wait_for(port.write(sample), _STUCK_S)
            except TimeoutError:
                lacking = [out.name for out in self._outs.values() if not unread_at(out)]
                if lacking and not held_up():
                    raise WriteTimeout(
                        f"in-port {port.name} is full, with {unread_at(port)} samples, and its "
                        f"component waits for {', '.join(lacking)}; give the lines of the in-ports by turns"
                    ) from None
            else:
                return

    def line_of(self, name: str, nth: int) -> int:
        """The line of the n-th sample (from 1) of a port; 0 when it is no longer kept."""
        lines = self._lines[name]
        place = nth - 1 - self._written[name] + len(lines)
        return lines[place] if 0 <= place < len(lines) else 0


async def _taken(port: OutPort[Any]) -> None:
    """Wait until everything written to a port has been read."""
    turns = 0
    while unread_at(port):
        turns += 1
        await asyncio.sleep(0 if turns < _TURNS else _LOOK)


class Incoming(Component):
    """A source that reads a descriptor; the base of `StandardInput` (lines) and `FrameInput` (frames).

    Args:
        ports: type of each in-port to feed; this component gets an out-port of the same name for it.
        notify: called with the number (from 1) of a bad item and the reason.
        descriptor: the descriptor that is read; standard input by default. It is not closed.
        count: number of samples after which it finishes; None is the end of input.
        ordered: feed the in-ports in the order of the input; for readers that read all of them in each cycle.
        held_up: tells whether the reader waits for another component; while it does not, taking nothing is an error.
    """

    def __init__(
        self,
        name: str,
        ports: Mapping[str, type],
        notify: Notify,
        descriptor: int | None = None,
        *,
        count: int | None = None,
        ordered: bool = False,
        held_up: Callable[[], bool] | None = None,
    ) -> None:
        super().__init__(name)
        self.bad = 0
        self._types = dict(ports)
        self._count = count
        outs: dict[str, OutPort[Any]] = {port: self.add_port(port, OutPort(cls)) for port, cls in ports.items()}
        self._feed = Feed(outs, ordered=ordered, held_up=held_up)
        self._notify = notify
        self._descriptor = descriptor
        self._reading: asyncio.Task[None] | None = None

    def on_activated(self) -> None:
        self._reading = asyncio.ensure_future(self._read_all())

    def on_deactivated(self) -> None:
        if self._reading is not None:
            self._reading.cancel()

    async def _read_all(self) -> None:
        await self._read(_standard_input() if self._descriptor is None else self._descriptor)
        self._reading = None
        self.finish()

    async def _read(self, descriptor: int | None) -> None:
        """Read the descriptor and feed the ports, until its end or until `count` is reached."""
        raise NotImplementedError

    def refused(self, port: str, nth: int, why: str) -> None:
        """Report the n-th sample (from 1) of a port as bad: its reader refused it."""
        self._complain(self._feed.line_of(port, nth), why)

    def _complain(self, number: int, why: str) -> None:
        self.bad += 1
        self._notify(number, why)


class StandardInput(Incoming):
    """A source that reads lines from standard input; for an event context.

    Args:
        optional: whether an input that ends without a line counts as none; this source then does not finish.
    """

    lines = 0
    """The number of lines read, bad ones included, blank ones not."""

    def __init__(self, *args: Any, optional: bool = False, **how: Any) -> None:
        super().__init__(*args, **how)
        self._optional = optional

    async def _read(self, descriptor: int | None) -> None:
        number, reader = 0, LineReader(self._types)
        async for lines in _batches(descriptor):
            for line in lines:
                number += 1
                if self._count is not None and self.lines - self.bad >= self._count:
                    return
                if line is None or line.strip():
                    await self._take(reader, number, line)
        if self._optional and not self.lines:
            await asyncio.Event().wait()  # until it is deactivated

    async def _take(self, reader: LineReader, number: int, line: bytes | None) -> None:
        self.lines += 1
        try:
            if line is None:
                raise RecordError(f"longer than {_LONGEST} bytes")
            text = (line.removeprefix(_MARK) if number == 1 else line).decode()
            port, sample = reader.sample(text, self.clock.time_ns())
        except UnicodeDecodeError as error:
            self._complain(number, f"no UTF-8: {error.reason} at byte {error.start}")
        except RecordError as error:
            self._complain(number, str(error))
        else:
            await self._feed.write(port, number, sample)


class StandardOutput(Component):
    """Writes the samples it gets to standard output, one line each; for an event context.

    Args:
        ports: type of each out-port to write; this component gets an in-port of the same name for it.
        stream: the stream that gets the lines; standard output by default.
        count: number of samples after which it stops and calls `done`; None never stops.
    """

    def __init__(
        self,
        name: str,
        ports: Mapping[str, type],
        *,
        stream: LineStream | None = None,
        count: int | None = None,
        done: Callable[[], object] | None = None,
    ) -> None:
        super().__init__(name)
        self.written = 0
        self._stream = LineStream() if stream is None else stream
        self._count = count
        self._done = done
        self._sources: list[tuple[InPort[Any], LineWriter]] = [
            (self.add_port(port, InPort(cls)), LineWriter(port, cls)) for port, cls in ports.items()
        ]

    async def on_execute(self) -> None:
        lines = [writer.line(sample) for port, writer in self._sources for sample in port.drain()]
        if self._count is not None:
            lines = lines[: self._count - self.written]
        await self._stream.write(lines)
        self.written += len(lines)
        if self.written == self._count and lines and self._done is not None:
            self._done()


def _standard_input() -> int | None:
    try:
        return sys.stdin.fileno()
    except (AttributeError, ValueError, OSError):
        return None  # started without standard input


async def _batches(descriptor: int | None) -> AsyncIterator[list[bytes | None]]:
    """The lines of a descriptor, as they arrive; None replaces a line that is too long."""
    rest, skipping = bytearray(), False
    while descriptor is not None and (chunk := await _next_chunk(descriptor)):
        *lines, last = chunk.split(b"\n")
        batch: list[bytes | None] = []
        for line in lines:
            batch.append(None if skipping or len(rest) + len(line) > _LONGEST else bytes(rest) + line)
            rest.clear()
            skipping = False
        rest += last
        if len(rest) > _LONGEST:
            rest.clear()
            skipping = True
        if batch:
            yield batch
    if rest or skipping:
        yield [None if skipping else bytes(rest)]


async def _next_chunk(descriptor: int) -> bytes:
    """Read what is available, waiting for some; empty at the end. OSError when it cannot be read."""
    while True:
        awaited = _can_be_awaited(descriptor) and await _readable(descriptor)
        try:
            return _read(descriptor) if awaited else await asyncio.to_thread(_read, descriptor)
        except BlockingIOError:
            await asyncio.sleep(0)  # another process was faster: several may share one input


async def _readable(descriptor: int) -> bool:
    """Wait until there is something to read; False where the loop does not support that."""
    loop = asyncio.get_running_loop()
    readable: asyncio.Future[None] = loop.create_future()
    try:
        loop.add_reader(descriptor, _resolve, readable)
    except (OSError, NotImplementedError):  # the null device, and loops without readers
        return False
    try:
        await readable
    finally:
        loop.remove_reader(descriptor)
    return True


def _can_be_awaited(descriptor: int) -> bool:
    try:
        return not stat.S_ISREG(os.fstat(descriptor).st_mode)
    except OSError:
        return False


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, _CHUNK)
    except OSError as error:
        if error.errno in _GONE:
            return b""
        raise


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
