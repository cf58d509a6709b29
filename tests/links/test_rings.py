"""Large arrays between kernels go through shared memory, and a hostile peer there changes nothing and stops nobody."""

from __future__ import annotations

import array
import asyncio
import fcntl
import logging
import mmap
import os
import socket
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import msgpack
import numpy as np
import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.links.unix import UnixTransport
from aiorts.rings import Rings, proof
from aiorts.sessions import private_folder
from aiorts.types import TimedOctetSeq

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(not Rings.available, reason="this system has no such memory"),
]
HEAD = struct.Struct("<IBBHI")
HELLO, BY_WRITER, PROOF, RING, RINGED = 1, 5, 7, 8, 9
OFFER, READY, DESCRIPTOR, MAPPED, CANNOT, FREED = range(1, 7)
SECRET = b"the same program"
SIZE = 1 << 20


class Ends(Component):
    out = OutPort(TimedOctetSeq)
    inp = InPort(TimedOctetSeq)


def octets(number: int, size: int = 200_000) -> TimedOctetSeq:
    return TimedOctetSeq(number, bytes([number % 251]) * size)


@asynccontextmanager
async def kernel_of(name: str, program: bytes = b"") -> AsyncIterator[Kernel]:
    async with Kernel(name) as kernel:
        transport = UnixTransport()
        transport.program = program
        kernel.service(Links).use(transport)
        await kernel.service(Links).opened()
        yield kernel


@pytest.mark.slow
@pytest.mark.parametrize("programs", [(SECRET, SECRET), (b"", b""), (SECRET, b"another"), (SECRET, b"")])
async def test_arrays_arrive_and_keep_their_values_whoever_sent_them(programs: tuple[bytes, bytes]) -> None:
    async with kernel_of("one", programs[0]) as one, kernel_of("two", programs[1]) as two:
        near, far = await one.add(Ends("near")), await two.add(Ends("far"))
        await one.connect(near.out, "two/far.inp")
        kept = []
        async with asyncio.timeout(20):
            for number in range(300):
                near.out.write_nowait(octets(number))
                sample = await far.inp.read()
                assert (sample.tm, sample.data[0], sample.data[-1]) == (number, number % 251, number % 251)
                if number % 10 == 0:
                    kept.append(sample.data[5:7])
                del sample
        assert [int(one[0]) for one in kept] == [number % 251 for number in range(0, 300, 10)]
        ((connection,),) = one.service(Links).reach._transport._ways.values()  # type: ignore[union-attr]
        assert connection.rings._sending._used is not None


@pytest.mark.slow
async def test_what_a_reader_holds_outlives_the_writers_kernel() -> None:
    async with kernel_of("two", SECRET) as two:
        far = await two.add(Ends("far"))
        async with kernel_of("one", SECRET) as one:
            near = await one.add(Ends("near"))
            await one.connect(near.out, "two/far.inp")
            held = []
            async with asyncio.timeout(10):
                for number in range(20):
                    near.out.write_nowait(octets(number))
                    held.append(await far.inp.read())
        await asyncio.sleep(0.05)
        assert [set(sample.data.tolist()) for sample in held[-3:]] == [{17}, {18}, {19}]


class Hostile:
    """A process of the same user that speaks the protocol by hand."""

    def __init__(self, kernel: Kernel, program: bytes) -> None:
        self.sock = socket.socket(socket.AF_UNIX)
        self._rest = b""
        self._program = program
        (path,) = private_folder().glob("*.link")
        self.sock.connect(str(path))
        self.sock.setblocking(False)
        self.greeting = msgpack.packb(["host", "hostile", 7])

    async def meet(self) -> None:
        """Greet, and say that this is of the program."""
        theirs = await self.next(HELLO)
        self.say(HELLO, self.greeting)
        if self._program:
            self.say(PROOF, proof(self._program, self.greeting, theirs))

    def say(self, kind: int, body: bytes, descriptors: tuple[int, ...] = ()) -> None:
        data = HEAD.pack(len(body), kind, 0, 0, 0) + body
        rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", descriptors))] if descriptors else []
        self.sock.sendmsg([data], rights)

    async def next(self, kind: int) -> bytes:
        """The next message of this kind."""
        loop = asyncio.get_running_loop()
        async with asyncio.timeout(5):
            while True:
                while len(self._rest) < 12 or len(self._rest) < 12 + HEAD.unpack_from(self._rest)[0]:
                    data = await loop.sock_recv(self.sock, 65_536)
                    if not data:
                        raise EOFError
                    self._rest += data
                length, found, *_ = HEAD.unpack_from(self._rest)
                body, self._rest = self._rest[12 : 12 + length], self._rest[12 + length :]
                if found == kind:
                    return body

    async def ended(self) -> bool:
        """Whether the kernel ends the connection."""
        try:
            while True:
                await self.next(RING)
        except (EOFError, ConnectionResetError):
            return True
        except TimeoutError:
            return False

    async def ring(self, descriptor: int) -> bytes:
        """Pass a ring on; what the kernel says of it."""
        self.say(RING, bytes((OFFER,)))
        assert await self.next(RING) == bytes((READY,))
        self.say(RING, bytes((DESCRIPTOR,)), (descriptor,))
        return await self.next(RING)


@asynccontextmanager
async def hostile_to_a_kernel(program: bytes = SECRET) -> AsyncIterator[tuple[Kernel, Hostile]]:
    async with kernel_of("two", SECRET) as two:
        hostile = Hostile(two, program)
        try:
            await hostile.meet()
            yield two, hostile
        finally:
            hostile.sock.close()


def memory(seals: int = 0x17, size: int = SIZE, commit: int = SIZE) -> tuple[int, mmap.mmap]:
    descriptor = os.memfd_create("hostile", os.MFD_ALLOW_SEALING)
    if commit:
        os.posix_fallocate(descriptor, 0, commit)
    os.ftruncate(descriptor, size)
    view = mmap.mmap(descriptor, size)
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, seals)
    return descriptor, view


def places(*numbers: int) -> bytes:
    return struct.pack(f"<B{len(numbers)}I", len(numbers) // 2, *numbers)


OFFENCES: dict[str, Callable[[Hostile, int], None]] = {
    "a place behind the end": lambda peer, _: peer.say(RINGED, places(SIZE // 64, 64)),
    "a part that is longer": lambda peer, _: peer.say(RINGED, places(0, SIZE + 1)),
    "a place far away": lambda peer, _: peer.say(RINGED, places(2**32 - 1, 2**32 - 1)),
    "the same place twice": lambda peer, _: peer.say(RINGED, places(0, 4096, 32, 4096)),
    "no places": lambda peer, _: peer.say(RINGED, b""),
    "missing parts": lambda peer, _: peer.say(RINGED, places(0, 0)),
    "places cut off": lambda peer, _: peer.say(RINGED, b"\xff\0\0"),
    "a ring out of turn": lambda peer, fd: peer.say(RING, bytes((DESCRIPTOR,)), (fd,)),
    "an answer to nothing": lambda peer, _: peer.say(RING, bytes((MAPPED,))),
    "gives back what it never had": lambda peer, _: peer.say(RING, struct.pack("<BBI", FREED, 1, 0)),
    "half of a message": lambda peer, _: peer.say(RING, bytes((FREED, 1))),
    "nothing": lambda peer, _: peer.say(RING, b""),
    "two descriptors": lambda peer, fd: (
        peer.say(RING, bytes((OFFER,))),
        peer.say(RING, bytes((DESCRIPTOR,)), (fd, fd)),
    )[0],
    "two offers": lambda peer, _: (peer.say(RING, bytes((OFFER,))), peer.say(RING, bytes((OFFER,))))[0],
}


@pytest.mark.parametrize("offence", OFFENCES)
async def test_a_peer_that_breaks_the_rules_is_ended_and_it_is_said(
    offence: str, caplog: pytest.LogCaptureFixture
) -> None:
    descriptor, view = memory()
    try:
        async with hostile_to_a_kernel() as (_, hostile):
            with caplog.at_level(logging.WARNING):
                assert await hostile.ring(descriptor) == bytes((MAPPED,))
                before = len(os.listdir("/proc/self/fd"))
                OFFENCES[offence](hostile, descriptor)
                assert await hostile.ended()
                assert len(os.listdir("/proc/self/fd")) <= before
            assert "hostile" in caplog.text or offence == "two descriptors"
    finally:
        view.close()
        os.close(descriptor)


WRONG = {
    "no seals": lambda: memory(0),
    "it could shrink": lambda: memory(0x15),
    "it could be written to": lambda: memory(0x07),
    "holes": lambda: memory(commit=0),
    "too large": lambda: memory(size=65 << 20, commit=0),
}


@pytest.mark.parametrize("wrong", WRONG)
async def test_memory_that_could_change_is_not_mapped(wrong: str, caplog: pytest.LogCaptureFixture) -> None:
    descriptor, view = WRONG[wrong]()
    try:
        async with hostile_to_a_kernel() as (_, hostile):
            hostile.say(RING, bytes((OFFER,)))
            assert await hostile.next(RING) == bytes((READY,))
            with caplog.at_level(logging.WARNING):
                hostile.say(RING, bytes((DESCRIPTOR,)), (descriptor,))
                assert await hostile.ended()
        assert "memory" in caplog.text
    finally:
        view.close()
        os.close(descriptor)


async def test_a_fifth_ring_is_refused() -> None:
    descriptor, view = memory()
    try:
        async with hostile_to_a_kernel() as (_, hostile):
            for _ in range(4):
                assert await hostile.ring(descriptor) == bytes((MAPPED,))
            hostile.say(RING, bytes((OFFER,)))
            assert await hostile.ended()
    finally:
        view.close()
        os.close(descriptor)


async def test_a_thousand_descriptors_never_reach_the_kernel() -> None:
    reading, writing = os.pipe()
    try:
        async with hostile_to_a_kernel() as (_, hostile):
            before = len(os.listdir("/proc/self/fd"))
            for _ in range(100):
                hostile.say(77, b"", (reading,) * 10)
                await asyncio.sleep(0)
            await asyncio.sleep(0.05)
            assert len(os.listdir("/proc/self/fd")) == before
    finally:
        os.close(reading)
        os.close(writing)


@pytest.mark.slow
@pytest.mark.parametrize("program", [b"", b"another program!"])
async def test_what_another_program_writes_after_sending_changes_no_value(program: bytes) -> None:
    """The frame is taken as a reader's end takes it: the values are those of the moment at which it came."""
    descriptor, view = memory()
    seen: list[memoryview] = []
    try:
        async with hostile_to_a_kernel(program) as (two, hostile):
            transport = two.service(Links).reach._transport
            transport.arrived = lambda _peer, frames: seen.extend(  # type: ignore[union-attr]
                part for those in frames.values() for _, parts in those for part in parts
            )
            assert await hostile.ring(descriptor) == bytes((MAPPED,))
            view[:SIZE] = bytes([1]) * SIZE
            hostile.say(RINGED, places(0, SIZE))
            assert await hostile.next(RING) == struct.pack("<BBI", FREED, 1, 0)
            view[:SIZE] = bytes([2]) * SIZE
            (part,) = seen
            assert (part.readonly, set(np.frombuffer(part, np.uint8))) == (True, {1})
    finally:
        view.close()
        os.close(descriptor)


async def test_a_peer_that_gives_nothing_back_stops_nobody() -> None:
    async with hostile_to_a_kernel() as (two, hostile):
        transport = two.service(Links).reach._transport
        await hostile.next(PROOF)
        ((connection,),) = transport._ways.values()  # type: ignore[union-attr]
        block = memoryview(bytes(SIZE))
        async with asyncio.timeout(10):
            connection.send_parts(BY_WRITER, 1, b"head", [block])
            assert await hostile.next(RING) == bytes((OFFER,))
            hostile.say(RING, bytes((READY,)))
            assert await hostile.next(RING) == bytes((DESCRIPTOR,))
            hostile.say(RING, bytes((MAPPED,)))
            while connection.rings._sending._used is None:
                await asyncio.sleep(0)
            sent = [connection.send_parts(BY_WRITER, 1, b"head", [block]) for _ in range(40)]
        assert sent[:8] == [True] * 8
