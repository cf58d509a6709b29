"""Arrays that look into a ring keep their values, and what nobody looks at is used again."""

from __future__ import annotations

import asyncio
import errno
import gc
import os
import threading
from collections.abc import Callable

import numpy as np
import pytest

from aiorts.errors import LinkError
from aiorts.rings import Rings, sending
from aiorts.rings.frames import FREED, OFFERED, freed_bytes, places_bytes
from aiorts.rings.memory import LARGEST
from aiorts.types import NDArray, record
from aiorts.wire import LINK, MsgpackCodec
from rings.ring_pair import End, close, pair, turns

pytestmark = pytest.mark.skipif(not Rings.available, reason="this system has no such memory")
KIB = 1024


def block(number: int, size: int = 64 * KIB) -> bytes:
    return bytes([number % 251]) * size


@record
class Picture:
    pixels: NDArray


ENCODE, DECODE = MsgpackCodec(limits=LINK).parts_encoder(Picture), MsgpackCodec(limits=LINK).parts_decoder(Picture)


async def picture_through(near: End, number: int) -> Picture:
    """A record whose array came through the ring."""
    head, parts = ENCODE(Picture(np.frombuffer(block(number), np.uint8).reshape(256, 256)))
    return DECODE(head, await near.through_ring(*map(bytes, parts)))


KEPT: dict[str, Callable[[np.ndarray], object]] = {
    "slice": lambda array: array[7:9, ::3],
    "memoryview": memoryview,
    "asarray": np.asarray,
    "another type": lambda array: array.view(np.uint16),
    "row of a row": lambda array: array[3][5:],
}


@pytest.mark.slow
@pytest.mark.parametrize("trust", [True, False], ids=["views", "copies"])
def test_whatever_is_kept_of_dead_records_keeps_its_values(trust: bool) -> None:
    async def run() -> None:
        ends = near, _ = pair(trust=trust)
        kept = {}
        for number, (what, keep) in enumerate(KEPT.items()):
            received = await picture_through(near, number)
            kept[what] = keep(received.pixels)
            del received
        before = {what: np.array(one) for what, one in kept.items()}
        for number in range(10_000):
            near.send(block(number + 100))
            if not number % 8:
                await asyncio.sleep(0)
        for what, one in kept.items():
            assert np.array_equal(np.asarray(one), before[what]), what
        close(ends)

    asyncio.run(run())


def test_arrays_are_not_copied_out_of_a_ring_of_one_program() -> None:
    async def run() -> None:
        ends = near, _ = pair()
        received = await picture_through(near, 1)
        first = received.pixels.ctypes.data
        del received
        await turns()
        assert (await picture_through(near, 2)).pixels.ctypes.data == first  # free again, and used again
        close(ends)

    asyncio.run(run())


@pytest.mark.slow
def test_a_ring_of_arrays_that_are_kept_for_ever_holds_nobody_up() -> None:
    async def run() -> int:
        ends = near, _ = pair()
        size, kept = 8 << 20, []
        await near.through_ring(block(0, size))
        for number in range(16):
            kept.append(near.send(block(number, size))[0])
            await turns()
        assert [one[-1] for one in kept] == list(range(16))
        close(ends)
        return sum(isinstance(one.obj, bytes) for one in kept)

    assert asyncio.run(run()) >= 16 - LARGEST // (8 << 20)


def test_a_larger_ring_takes_the_place_of_one_that_is_full() -> None:
    async def run() -> None:
        ends = near, _ = pair()
        (first,) = await near.through_ring(block(1, 1 << 20))
        kept = [near.send(block(number, 1 << 20))[0] for number in range(2, 30)]
        (later,) = await near.through_ring(block(40, 1 << 20))
        del kept[:]
        await turns()
        assert (first[0], later[0]) == (1, 40)
        assert (await near.through_ring(block(50, 1 << 20)))[0][-1] == 50
        assert first[-1] == 1
        close(ends)

    asyncio.run(run())


def test_large_parts_wait_for_the_ring_that_is_being_made_and_hear_of_it() -> None:
    async def run() -> None:
        ends = near, _ = pair()
        large, small = memoryview(block(1)), memoryview(b"small")
        assert near.rings.put([large]) is None
        assert near.rings.put([small]) == ([], [small])  # which is not to wait for anything
        assert near.rooms == 0
        async with asyncio.timeout(5):
            while not near.rooms:
                await turns()
        assert near.rooms == 1
        put = near.rings.put([large])
        assert put is not None
        assert put.beside == []
        close(ends)

    asyncio.run(run())


def test_large_parts_do_not_wait_for_a_ring_that_the_other_end_never_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sending, "_HELD", 0.05)

    async def run() -> None:
        ends = near, far = pair()
        far.takes = False
        large = memoryview(block(1))
        assert near.rings.put([large]) is None
        async with asyncio.timeout(5):
            while not near.rooms:
                await asyncio.sleep(0.01)
        assert near.rings.put([large]) == ([], [large])
        close(ends)

    asyncio.run(run())


@pytest.mark.slow
def test_what_dies_in_any_thread_is_given_back() -> None:
    async def run() -> None:
        ends = near, _ = pair()
        await near.through_ring(block(0))

        def drop(views: list[object]) -> None:
            while views:
                views.pop()

        for _ in range(8):
            views: list[object] = []
            while not isinstance((found := near.send(block(1, 1 << 20))[0]).obj, bytes):
                views.append(found)
            del found
            assert views
            threads = [threading.Thread(target=drop, args=(views,)) for _ in range(3)]
            for thread in threads:
                thread.start()
            for thread in threads:
                await asyncio.to_thread(thread.join, 5.0)
            gc.collect()
            await turns()
        close(ends)

    asyncio.run(run())


def test_what_cannot_be_said_at_once_is_said_later() -> None:
    async def run() -> None:
        ends = near, far = pair()
        (view,) = await near.through_ring(block(1))
        place = view.obj
        far.takes = False
        address = np.asarray(place).ctypes.data
        del view, place
        await turns()
        (second,) = near.send(block(2))
        assert np.asarray(second.obj).ctypes.data != address
        far.takes = True
        far.rings.flush()
        await turns()
        (third,) = near.send(block(3))
        assert np.asarray(third.obj).ctypes.data == address
        assert (second[0], third[0]) == (2, 3)
        close(ends)

    asyncio.run(run())


def test_small_and_large_parts_of_one_frame_keep_their_order() -> None:
    async def run() -> None:
        ends = near, _ = pair()
        parts = [b"small", block(1), b"", block(2), b"last"]
        assert [bytes(one) for one in await near.through_ring(*parts)] == parts
        close(ends)

    asyncio.run(run())


def test_a_frame_that_was_not_sent_takes_nothing() -> None:
    async def run() -> None:
        ends = near, _ = pair()
        await near.through_ring(block(0))
        await turns()
        for _ in range(1_000):
            put = near.rings.put([memoryview(block(1, 1 << 20))])
            assert put is not None
            near.rings.take_back(put[0])
        close(ends)

    asyncio.run(run())


def test_without_memory_there_is_no_ring_and_it_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)

    async def run() -> list[str]:
        ends = near, _ = pair()
        for number in range(100):
            (found,) = near.send(block(number))
            assert found[0] == number
            await turns(3)
        close(ends)
        return near.reports

    (said,) = asyncio.run(run())
    assert said.startswith("no memory for arrays, which are sent through the socket: ")


def test_a_reader_that_cannot_map_it_gets_arrays_through_the_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_descriptor: int) -> object:
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    monkeypatch.setattr("aiorts.rings.receiving.mapped", refused)

    async def run() -> list[str]:
        ends = near, far = pair()
        for number in range(100):
            (found,) = near.send(block(number))
            assert isinstance(found.obj, bytes)
            await turns(3)
        close(ends)
        return far.reports

    assert len(asyncio.run(run())) == 1


@pytest.mark.parametrize(
    ("start", "length"),
    [(LARGEST, 64 * KIB), (0, LARGEST + 1), ((4 << 20) - 64, 65), (2**37, 1), (0, 64 * KIB), (64, 1), (0, 1 << 20)],
)
def test_places_that_are_not_in_the_ring_or_looked_into_are_refused(start: int, length: int) -> None:
    async def run() -> None:
        ends = near, far = pair()
        (kept,) = await near.through_ring(block(9))
        with pytest.raises(LinkError):
            far.rings.frame_of(memoryview(places_bytes([(start, length)])), [])
        assert bytes(kept) == block(9)
        close(ends)

    asyncio.run(run())


@pytest.mark.parametrize(
    "body",
    [
        *(b"", b"\x00", b"\xff", b"\x02", b"\x03", b"\x04", b"\x05", bytes((FREED, 1)), OFFERED),
        *(freed_bytes([(1, 0)]), freed_bytes([(200, 64)])),
    ],
)
def test_messages_out_of_turn_are_refused(body: bytes) -> None:
    async def run() -> None:
        ends = _, far = pair()
        if body == OFFERED:
            far.rings.heard(body)  # the first is none out of turn
        with pytest.raises(LinkError):
            far.rings.heard(body)
        close(ends)

    asyncio.run(run())


@pytest.mark.parametrize("body", [b"", b"\x00", b"\x01", b"\x02" + bytes(8), b"\xff" * 100])
def test_frames_without_their_parts_are_refused(body: bytes) -> None:
    async def run() -> None:
        ends = _, far = pair()
        with pytest.raises(LinkError):
            far.rings.frame_of(memoryview(body), [])
        close(ends)

    asyncio.run(run())
