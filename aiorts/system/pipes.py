"""Components that make any component a Unix filter: standard input to its in-ports, its out-ports to standard output.

Lines are JSON, one sample each (`aiorts.wire.lines`). A line that is bad is reported and counted, the others go on; the
end of input is the end of the source. Nothing is read ahead of a reader that cannot take it: a connector with
full = block holds back who writes to our standard input.
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
from aiorts.kernel.ports import InPort, OutPort
from aiorts.system.stream import LineStream
from aiorts.wire.lines import LineReader, LineWriter

__all__ = ("Incoming", "StandardInput", "StandardOutput")

_CHUNK: Final = 1 << 16
_LONGEST: Final = 64 << 20
"""Bytes of a line."""
_MARK: Final = b"\xef\xbb\xbf"
"""A byte order mark, with which some editors begin a file of UTF-8."""
_GONE: Final = (errno.EIO, errno.EBADF)
"""A terminal that was hung up; a descriptor that somebody has closed."""

_LINES_KEPT: Final = 4096
"""Samples of a port whose lines are known: more than wait in a connector and in who takes from it."""
_TURNS: Final = 50
"""Turns of the loop after which who waits for a component looks but now and then."""
_LOOK: Final = 0.001
_STUCK_S: Final = 10.0
"""Seconds after which a reader that takes nothing, while nobody holds it up, is asked what it waits for."""

Tell = Callable[[int, str], None]


class Feed:
    """The out-ports of a source: in the order of lines where that is asked for, with the line of each late sample.

    Args:
        ordered: whether a sample waits until those before it were taken from other ports.
        held_up: whether the reader itself waits for somebody; without it a full port is waited for without end.
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
            WriteTimeout: the port is full, and its reader takes nothing, since it waits for a sample of another port.
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
                lacking = [out.name for out in self._outs.values() if not any(c.unread for c in out.connectors)]
                if lacking and not held_up():
                    raise WriteTimeout(
                        f"in-port {port.name} is full, with {sum(c.unread for c in port.connectors)} samples, and its "
                        f"component waits for {', '.join(lacking)}; give the lines of the in-ports by turns"
                    ) from None
            else:
                return

    def line_of(self, name: str, nth: int) -> int:
        """The line of the n-th sample (from 1) of a port; 0 when that was too long ago."""
        lines = self._lines[name]
        place = nth - 1 - self._written[name] + len(lines)
        return lines[place] if 0 <= place < len(lines) else 0


async def _taken(port: OutPort[Any]) -> None:
    """Wait until what was written to a port has been read."""
    turns = 0
    while any(connector.unread for connector in port.connectors):
        turns += 1
        await asyncio.sleep(0 if turns < _TURNS else _LOOK)


class Incoming(Component):
    """A source of what a descriptor says, from which lines (`StandardInput`) and frames (`FrameInput`) derive.

    Args:
        ports: type of each in-port that is to be fed; this component gets an out-port of the same name for it.
        tell: called with the number (from 1) of what is bad and why.
        descriptor: what is read; standard input by default. It is not closed.
        count: finish after so many samples; None is with the end of input.
        ordered: feed the in-ports in the order of what is read; only for who reads all of them in each cycle.
        held_up: whether the reader waits for somebody; while it does not, one that takes nothing is an error.
    """

    def __init__(
        self,
        name: str,
        ports: Mapping[str, type],
        tell: Tell,
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
        self._tell = tell
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
        """Feed what the descriptor says until its end, or until there was enough."""
        raise NotImplementedError

    def refused(self, port: str, nth: int, why: str) -> None:
        """The reader could make nothing of the n-th sample (from 1) of a port: its line or frame is a bad one."""
        self._complain(self._feed.line_of(port, nth), why)

    def _complain(self, number: int, why: str) -> None:
        self.bad += 1
        self._tell(number, why)


class StandardInput(Incoming):
    """A source of what the lines of standard input say; for an event context. Args: see `Incoming`."""

    lines = 0
    """Lines read, bad ones among them; blank ones are none."""

    async def _read(self, descriptor: int | None) -> None:
        number, reader = 0, LineReader(self._types)
        async for lines in _batches(descriptor):
            for line in lines:
                number += 1
                if self._count is not None and self.lines - self.bad >= self._count:
                    return
                if line is None or line.strip():
                    await self._take(reader, number, line)

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
    """Writes what arrives to standard output, one line for each sample; for an event context.

    Args:
        ports: type of each out-port that is to be shown; this component gets an in-port of the same name for it.
        stream: where lines go; standard output by default.
        count: after so many samples no more are written and `done` is called; None is without end.
    """

    def __init__(
        self,
        name: str,
        ports: Mapping[str, type],
        *,
        stream: LineStream | None = None,
        count: int | None = None,
        done: Callable[[], None] | None = None,
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
        return None  # started without


async def _batches(descriptor: int | None) -> AsyncIterator[list[bytes | None]]:
    """The lines of a descriptor, as they come; None in the place of one that is too long."""
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
    """What there is to read, waiting for some; empty at the end. OSError when it cannot be read."""
    while True:
        awaited = _can_be_awaited(descriptor) and await _readable(descriptor)
        try:
            return _read(descriptor) if awaited else await asyncio.to_thread(_read, descriptor)
        except BlockingIOError:
            await asyncio.sleep(0)  # somebody else was faster: several processes may share one input


async def _readable(descriptor: int) -> bool:
    """Wait until there is something to read; False where the loop cannot tell."""
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
