"""Control never waits behind samples, nor for room among them; what is begun is finished; each has its own bound."""

from __future__ import annotations

import asyncio
import os
import socket
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from aiorts.links.stream import Message, Stream
from aiorts.model.links import Turn, frames, turn_of

pytestmark = pytest.mark.anyio
KIB, MIB = 1 << 10, 1 << 20
SAMPLE, QUESTION, END, RING = range(1, 5)


class End:
    """One end of a connection, and what came to it."""

    def __init__(self, sock: socket.socket) -> None:
        self.came: list[Message] = []
        self.rooms = 0
        self.why = ""
        self.stream = Stream(asyncio.get_running_loop(), sock, self.came.extend, self._drained, self._ended)

    def _drained(self) -> None:
        self.rooms += 1

    def _ended(self, why: str) -> None:
        self.why = why

    def numbers(self, kind: int) -> list[int]:
        return [number for one, number, _, _ in self.came if one == kind]

    async def until(self, holds: Callable[[], object]) -> None:
        async with asyncio.timeout(10):
            while not holds():
                await asyncio.sleep(0.001)


@asynccontextmanager
async def one_that_takes_nothing() -> AsyncIterator[tuple[End, socket.socket]]:
    """An end, and the socket at the other end, of which nobody reads yet."""
    near, far = socket.socketpair()
    end = End(near)
    try:
        yield end, far
    finally:
        end.stream.close()
        far.close()


def fill(end: End, size: int = 64 * KIB) -> int:
    """Send samples until no more is taken; how many were."""
    count = 0
    while end.stream.send(SAMPLE, count, bytes(size)):
        count += 1
        assert count < 10_000
    return count


async def test_control_goes_before_all_samples_that_wait_and_is_taken_when_they_are_not() -> None:
    async with one_that_takes_nothing() as (near, sock):
        samples = fill(near)
        assert all(near.stream.control(QUESTION, number, b"how far?") for number in range(1_000))
        far = End(sock)
        try:
            await far.until(lambda: len(far.came) == samples + 1_000)
            first = next(place for place, message in enumerate(far.came) if message[0] == QUESTION)
            # What the socket holds, and the message that was begun.
            assert sum(len(body) for _, _, body, _ in far.came[:first]) <= 512 * KIB
            assert [message[0] for message in far.came[first : first + 1_000]] == [QUESTION] * 1_000
            assert far.numbers(SAMPLE) == [*range(samples)]
            assert far.numbers(QUESTION) == [*range(1_000)]
        finally:
            far.stream.close()


async def test_a_message_that_is_partly_sent_is_finished_first() -> None:
    async with one_that_takes_nothing() as (near, sock):
        large = os.urandom(MIB)
        assert near.stream.send(SAMPLE, 1, b"head", [memoryview(large), memoryview(b"tail")])
        assert near.stream.send(SAMPLE, 2, b"behind")
        assert near.stream.control(QUESTION, 3, b"")
        far = End(sock)
        try:
            await far.until(lambda: len(far.came) == 3)
            assert [number for _, number, _, _ in far.came] == [1, 3, 2]
            assert [bytes(part) for part in far.came[0][3]] == [large, b"tail"]
        finally:
            far.stream.close()


async def test_who_takes_nothing_costs_a_bound_of_each() -> None:
    async with one_that_takes_nothing() as (near, _):
        assert fill(near) * 64 * KIB < 6 * MIB
        short = large = 0
        while near.stream.control(QUESTION, 0, b""):
            short += 1
            assert short < 100_000
        assert short > 10_000
        assert not near.rooms
    async with one_that_takes_nothing() as (near, _):
        while near.stream.control(QUESTION, 0, bytes(64 * KIB)):
            large += 1
            assert large < 1_000
        assert large * 64 * KIB < 20 * MIB
        assert near.stream.send(SAMPLE, 0, b"")  # nor do samples wait for room among control


async def test_what_ends_a_link_is_taken_though_no_sample_is_and_comes_behind_those() -> None:
    async with one_that_takes_nothing() as (near, sock):
        samples = fill(near)
        assert near.stream.send(END, 7, b"", turn=Turn.LAST)
        far = End(sock)
        try:
            await far.until(lambda: far.numbers(END))
            assert far.numbers(SAMPLE) == [*range(samples)]
            assert far.came[-1][0] == END
        finally:
            far.stream.close()


async def test_a_descriptor_is_taken_while_samples_wait_and_is_another_one_then() -> None:
    async with one_that_takes_nothing() as (near, sock):
        samples = fill(near)
        reading, writing = os.pipe()
        assert near.stream.send_descriptor(RING, 9, b"ring", writing)
        os.close(writing)  # it stays the caller's, who may close it at once
        far = End(sock)
        try:
            far.stream.expect_descriptor()
            await far.until(lambda: far.numbers(RING))
            assert len(far.numbers(SAMPLE)) == samples
            came = far.stream.take_descriptor()
            assert came is not None
            os.write(came, b"through")
            os.close(came)
            assert os.read(reading, 10) == b"through"
        finally:
            os.close(reading)
            far.stream.close()


async def test_a_descriptor_that_waits_is_closed_with_the_connection() -> None:
    before = len(os.listdir("/proc/self/fd"))
    async with one_that_takes_nothing() as (near, _):
        fill(near)
        assert near.stream.send_descriptor(RING, 9, b"ring", 0)
    assert len(os.listdir("/proc/self/fd")) == before


async def test_who_was_refused_hears_of_room_once() -> None:
    async with one_that_takes_nothing() as (near, sock):
        fill(near)
        far = End(sock)
        try:
            await near.until(lambda: near.rooms)
            await far.until(lambda: near.stream.send(SAMPLE, 0, b"again"))
            await asyncio.sleep(0.01)
            assert near.rooms == 1
        finally:
            far.stream.close()


async def test_one_turn_of_the_loop_reads_all_that_the_socket_holds() -> None:
    """A loop that a hook holds for 0.1 s in each turn came to a question behind 208 KiB in the fourth turn."""
    came = []
    for _ in range(10):  # a turn reads for 5 ms at the most: another process may have the processor meanwhile
        async with one_that_takes_nothing() as (near, sock):
            for number in range(10):
                assert near.stream.send(SAMPLE, number, bytes(16 * KIB))
            far = End(sock)
            try:
                while not far.came:
                    await asyncio.sleep(0)
                came.append(len(far.came))
            finally:
                far.stream.close()
    assert 10 in came


def test_of_the_frames_of_a_link_samples_and_what_speaks_of_them_are_in_order() -> None:
    turns = {
        "hello": turn_of(frames.hello(1, 2, 0)),
        "data": turn_of(frames.data(1, 1, 1, [b"sample"], confirm=False)),
        "ack": turn_of(frames.acknowledgement(1, 1, 1, {})),
        "want": turn_of(frames.want(1, 1, wait=False)),
        "none": turn_of(frames.none(1, 1, wait=False)),
        "bye": turn_of(frames.bye(1)),
    }
    assert turns == {
        "hello": Turn.CONTROL,
        "data": Turn.SAMPLE,
        "ack": Turn.CONTROL,
        "want": Turn.CONTROL,
        "none": Turn.LAST,
        "bye": Turn.LAST,
    }


async def test_an_end_that_is_gone_with_something_unread_is_noticed_behind_what_it_said_last() -> None:
    """uvloop calls a reader once at such a socket: what comes then is data, and nothing calls again for the end."""
    async with one_that_takes_nothing() as (end, far):
        assert end.stream.send(SAMPLE, 1, b"unread")
        far.send(struct.pack("<IBBHI", 4, SAMPLE, 0, 0, 7) + b"last")
        far.close()
        await end.until(lambda: end.why)
        assert (end.why, end.numbers(SAMPLE)) == ("it has ended", [7])
