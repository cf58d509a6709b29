"""The transport of one host keeps what every transport promises."""

from __future__ import annotations

import asyncio
import errno
import os
import resource
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.errors import LinkError
from aiorts.links import Caller, Links, Transport, checked_peer
from aiorts.links.messages import packed
from aiorts.links.stream import Message, Stream
from aiorts.links.unix import UnixTransport
from aiorts.testing import TRANSPORT_CHECKS, check_transport
from aiorts.types import TimedLong


class _Source(Component):
    out = OutPort(TimedLong)


class _Sink(Component):
    inp = InPort(TimedLong)


def unix() -> tuple[Transport, Transport]:
    return UnixTransport(), UnixTransport()


@pytest.mark.parametrize("name", TRANSPORT_CHECKS)
def test_unix_sockets_keep_every_promise(name: str) -> None:
    check_transport(unix, only=[name])


async def _through_a_socket(parts: list[memoryview]) -> Message:
    """A message with these parts, as it arrives."""
    loop, (near, far) = asyncio.get_running_loop(), socket.socketpair()
    arrived: asyncio.Future[Message] = loop.create_future()
    ends = [
        Stream(loop, near, lambda _messages: None, lambda: None, lambda _why: None),
        Stream(loop, far, lambda messages: arrived.set_result(messages[0]), lambda: None, lambda _why: None),
    ]
    try:
        assert ends[0].send(1, 2, b"head", parts)
        return await asyncio.wait_for(arrived, 5.0)
    finally:
        for end in ends:
            end.close()


@pytest.mark.parametrize("sizes", [(100_000,), (3, 100_000, 7, 200_001, 8)])
def test_arrays_of_a_large_message_are_aligned_and_nobody_writes_to_them(sizes: tuple[int, ...]) -> None:
    sent = [bytes([number]) * size for number, size in enumerate(sizes)]
    message = asyncio.run(_through_a_socket([memoryview(part) for part in sent]))
    assert (bytes(message[2]), [bytes(part) for part in message[3]]) == (b"head", sent)
    for part in message[3]:
        assert part.readonly
        assert np.frombuffer(part, "u1").ctypes.data % 8 == 0


def _resident() -> int:
    """Bytes of memory that this process uses."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="asks the kernel for its memory")
def test_a_size_that_is_claimed_takes_no_memory() -> None:
    async def claim() -> int:
        loop, ends = asyncio.get_running_loop(), []
        before = _resident()
        for _ in range(20):
            near, far = socket.socketpair()
            ends.append((near, Stream(loop, far, lambda _messages: None, lambda: None, lambda _why: None)))
            near.send(struct.pack("<IBBHI", 79 << 20, 5, 0, 0, 1) + b"first")
        await asyncio.sleep(0.1)
        grown = _resident() - before
        for near, stream in ends:
            stream.close()
            near.close()
        return grown

    assert asyncio.run(claim()) < 100 << 20


_WITHOUT_DESCRIPTORS = """
import asyncio, os, resource, socket, time
from aiorts import Kernel
from aiorts.sessions import private_folder
from aiorts.links import Links

async def main():
    async with Kernel("busy", services={"links": {}}) as kernel:
        await kernel.service(Links).opened()
        (path,) = private_folder().glob("*.link")
        callers = [socket.socket(socket.AF_UNIX) for _ in range(4)]
        resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
        taken = []
        try:
            while True:
                taken.append(os.dup(0))
        except OSError:
            pass
        for caller in callers:
            caller.setblocking(False)
            caller.connect(str(path))
        before = time.process_time()
        await asyncio.sleep(1.0)
        used = time.process_time() - before
        for one in taken:
            os.close(one)
        loop = asyncio.get_running_loop()
        greeted = await asyncio.wait_for(asyncio.gather(*[loop.sock_recv(one, 1) for one in callers]), 5)
        print(f"{used < 0.5} {all(greeted)}")

asyncio.run(main())
"""


@pytest.mark.slow(kept_by="test_unix_sockets_keep_every_promise")
def test_without_descriptors_a_kernel_does_not_spin_and_greets_later() -> None:
    done = subprocess.run([sys.executable, "-c", _WITHOUT_DESCRIPTORS], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("True True\n", "")


def test_a_machine_may_call_itself_what_it_likes_but_for_what_parts_a_path() -> None:
    assert checked_peer("Büro 2", "robot", 7).host == "Büro 2"
    for host, kernel in (("a/b", "robot"), ("h" * 254, "robot"), ("host", "a/b"), ("host", "")):
        with pytest.raises(LinkError, match="name"):
            checked_peer(host, kernel, 7)


@pytest.fixture
def all_look_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two kernels, each in a thread: both have looked who is there before one of them listens."""
    meet, listen, met = threading.Barrier(2), UnixTransport._listen, threading.local()

    def meeting(transport: UnixTransport, path: Path) -> None:
        if not getattr(met, "once", False):
            met.once = True
            meet.wait(10)
        listen(transport, path)

    monkeypatch.setattr(UnixTransport, "_listen", meeting)


def in_threads(main: Callable[[str], Coroutine[Any, Any, bool]], *names: str) -> list[bool]:
    """What the coroutines return that this function makes of names, each run in a thread of its own."""
    with ThreadPoolExecutor(len(names)) as pool:
        return list(pool.map(lambda name: asyncio.run(main(name)), names))


@pytest.mark.usefixtures("all_look_first")
def test_kernels_that_start_at_the_same_time_find_each_other() -> None:
    over = threading.Barrier(2)

    async def main(name: str) -> bool:
        async with Kernel(name) as kernel:
            links = kernel.service(Links)
            await links.opened()
            until = time.monotonic() + 5.0
            while not links.peers and time.monotonic() < until:
                await asyncio.sleep(0.01)
            found = bool(links.peers)
            await asyncio.to_thread(over.wait, 10)
            return found

    assert in_threads(main, "one", "two") == [True, True]


@pytest.mark.slow
@pytest.mark.usefixtures("all_look_first")
def test_of_kernels_of_one_name_that_start_at_the_same_time_one_has_it() -> None:
    """Where the clock of files cannot tell them apart, both try again."""
    over, opened = threading.Barrier(2), list[Links]()

    async def main(name: str) -> bool:
        async with Kernel(name) as kernel:
            links = kernel.service(Links)
            with suppress(LinkError):  # its name is taken
                await links.opened()
            until = time.monotonic() + 10.0
            while not opened and time.monotonic() < until:
                if links.reach.is_open:
                    opened.append(links)
                await asyncio.sleep(0.01)
            await asyncio.sleep(1.0)
            has_it = links.reach.is_open
            await asyncio.to_thread(over.wait, 10)
            return has_it

    assert sorted(in_threads(main, "same", "same")) == [False, True]


class _Asked:
    """A kernel that never reads what it is sent, at the other end of a socket, and what it has asked."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(str(path))
        self.socket.setblocking(False)

    async def send(self, kind: int, number: int, body: bytes) -> None:
        message = struct.pack("<IBBHI", len(body), kind, 0, 0, number) + body
        await asyncio.get_running_loop().sock_sendall(self.socket, message)

    async def answers(self, count: int) -> list[tuple[int, int]]:
        """Kind and number of so many answers."""
        found: list[tuple[int, int]] = []
        loop, data = asyncio.get_running_loop(), b""
        while len(found) < count:
            data += await loop.sock_recv(self.socket, 1 << 20)
            while len(data) >= 12 and len(data) >= 12 + struct.unpack_from("<I", data)[0]:
                length, kind, _, _, number = struct.unpack_from("<IBBHI", data)
                if kind in (3, 4):
                    found.append((kind, number))
                data = data[12 + length :]
        return found


@pytest.mark.slow(kept_by="test_unix_sockets_keep_every_promise")
def test_no_answer_is_lost_when_the_other_end_reads_late() -> None:
    """As while it stands still: more answers wait than the stream takes, and each waits for its turn."""

    async def main() -> list[tuple[int, int]]:
        async with Kernel("answers", services={"links": {}}) as kernel:
            links = kernel.service(Links)
            await links.opened()
            transport = links.reach._transport
            assert isinstance(transport, UnixTransport)

            async def large(body: bytes, caller: Caller) -> bytes:
                return bytes(60_000)

            transport.answer("large", large)
            asked = _Asked(transport._path)
            with asked.socket:
                await asked.send(1, 0, packed(["here", "asks", 1]))
                for number in range(1, 901):
                    await asked.send(2, number, packed(["large", b""]))
                await asyncio.sleep(1.0)  # 54 MB of answers wait, and the stream takes 16
                async with asyncio.timeout(20.0):
                    return await asked.answers(900)

    assert asyncio.run(main()) == [(3, number) for number in range(1, 901)]


async def _found(kernel: Kernel, name: str, within: float = 10.0) -> None:
    async with asyncio.timeout(within):
        while name not in [peer.kernel for peer in kernel.service(Links).peers]:
            await asyncio.sleep(0.01)


def test_a_kernel_whose_queue_is_full_is_found_when_it_takes_connections_again() -> None:
    """While it stands still others may come until its queue is full; `connect` fails then, and is made again."""

    async def main() -> None:
        async with Kernel("late", services={"links": {}}) as late:
            await late.service(Links).opened()
            transport = late.service(Links).reach._transport
            assert isinstance(transport, UnixTransport)
            listener, loop = transport._listener, asyncio.get_running_loop()
            assert listener is not None
            loop.remove_reader(listener.fileno())  # it stands still
            callers = []
            with suppress(BlockingIOError):
                while True:
                    callers.append(socket.socket(socket.AF_UNIX))
                    callers[-1].setblocking(False)
                    callers[-1].connect(str(transport._path))
            async with Kernel("other", services={"links": {}}) as other:
                await other.service(Links).opened()
                assert not other.service(Links).peers
                loop.add_reader(listener.fileno(), transport._accept)
                await _found(other, "late")
                await _found(late, "other")
            for one in callers:
                one.close()

    asyncio.run(main())


def test_a_connection_that_was_ended_before_its_greeting_is_made_again() -> None:
    """Who accepts ends one that is silent; who has connected may only have stood still."""

    async def main() -> None:
        async with Kernel("one", services={"links": {}}) as one:
            await one.service(Links).opened()
            async with Kernel("two", services={"links": {}}) as two:
                await two.service(Links).opened()
                await _found(two, "one")
                transport = one.service(Links).reach._transport
                assert isinstance(transport, UnixTransport)
                for _ in range(3):
                    (connection,) = transport._connections
                    connection.close()
                    assert not one.service(Links).peers
                    await _found(one, "two")
                    await _found(two, "one")
            async with asyncio.timeout(10.0):  # and not once it is gone
                while one.service(Links).peers or transport._connections:
                    await asyncio.sleep(0.01)

    asyncio.run(main())


def test_of_two_connections_with_one_kernel_the_other_one_carries_on() -> None:
    """Kernels that open at the same time have two; frames of a channel whose one ended were never taken again."""

    async def main() -> None:
        async with Kernel("one") as one, Kernel("two") as two:
            ends = [kernel.service(Links) for kernel in (one, two)]
            transports = [UnixTransport(), UnixTransport()]
            for links, transport in zip(ends, transports, strict=True):
                links.use(transport)
                await links.opened()
            await _found(one, "two")
            second = transports[0]._connect(transports[1]._path)
            assert second is not None
            await second.greeted
            source, sink = await one.add(_Source("source")), await two.add(_Sink("sink"))
            connector = await one.connect(source.out, "two/sink.inp")
            first = next(iter(transports[0]._ways.values()))[0]
            source.out.write_nowait(TimedLong(0, 1))
            assert (await sink.inp.read(timeout=10.0)).data == 1
            first.close()
            source.out.write_nowait(TimedLong(0, 2))
            assert (await sink.inp.read(timeout=10.0)).data == 2
            assert links.report()
            assert connector.statistics.dropped == {}

    asyncio.run(main())


def test_a_transport_that_could_not_be_opened_for_want_of_descriptors_has_given_up_its_socket() -> None:
    class Face:
        name, epoch, host = "one", 7, "here"

        def report(self, text: str) -> None:
            raise AssertionError(text)

        def run_in_background(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
            return asyncio.get_running_loop().create_task(coroutine, name=name)

    async def main() -> None:
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        transport, fillers = UnixTransport(), list[int]()
        resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
        try:
            with suppress(OSError):
                while True:
                    fillers.append(os.dup(0))
            os.close(fillers.pop())  # enough to listen, and not to look who is there
            with pytest.raises(LinkError, match="cannot be reached"):
                await transport.open(Face())
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            for one in fillers:
                os.close(one)
        assert not list(Path(os.environ["XDG_RUNTIME_DIR"], "aiorts").glob("*"))
        await transport.open(Face())
        await transport.close()

    asyncio.run(main())


class _Short:
    """A socket whose system has no memory to send anything."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._socket, name)

    def send(self, _data: object) -> int:
        raise OSError(errno.ENOBUFS, "No buffer space available")


def test_a_connection_that_can_send_no_more_ends_at_this_end() -> None:
    async def main() -> None:
        loop, (near, far) = asyncio.get_running_loop(), socket.socketpair()
        ended: asyncio.Future[str] = loop.create_future()
        short: Any = _Short(near)
        stream = Stream(loop, short, lambda _messages: None, lambda: None, ended.set_result)
        assert not stream.send(1, 2, b"head")
        assert await asyncio.wait_for(ended, 5.0) == "No buffer space available"
        assert stream.closed
        far.close()

    asyncio.run(main())


def test_a_descriptor_that_cannot_be_kept_is_not_sent() -> None:
    async def main() -> None:
        near, far = socket.socketpair()
        stream = Stream(asyncio.get_running_loop(), near, lambda _messages: None, lambda: None, lambda _why: None)
        assert not stream.send_descriptor(1, 2, b"ring", 100_000)  # there is none of this number
        stream.close()
        far.close()

    asyncio.run(main())
