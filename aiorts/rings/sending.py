"""The sender's end of a ring: makes the memory, copies parts there, and hears which extents are free again."""

from __future__ import annotations

import asyncio
import mmap
from collections.abc import Callable, Sequence
from typing import Final

from aiorts.errors import LinkError
from aiorts.rings.extents import Extents
from aiorts.rings.frames import CANNOT, MAPPED, OFFERED, PLACES, READY, RING, Place, Put, freed_of
from aiorts.rings.memory import LARGEST, Making

LEAST: Final = 65_536
"""The least bytes of a part in the ring. Measured there and back, p50, through the socket, looked at in the
ring, copied out of it: 32 KiB 449, 605, 615 us; 64 KiB 570, 547, 612 us; 128 KiB 642, 532, 579 us. That extents are
given back costs a message."""
RINGS: Final = 4
"""Rings of one connection and direction, one after the other: each is at least four times as large."""
_SLOTS: Final = 8
"""Parts like the first one that a ring has room for: those on their way and those that a reader looks at."""
_SMALLEST: Final = 4 << 20
"""Bytes of the first ring at the least."""
_HELD: Final = 1.0
"""Seconds for which large parts wait for a ring that is being made. A kernel whose turns take 0.1 s needs 0.4 s to take
it, and 0.6 s for one part of 1 MiB out of its socket, behind which a question waits."""


class _Ring:
    """Memory that the other end has mapped."""

    def __init__(self, number: int, memory: mmap.mmap) -> None:
        self.number, self.extents = number, Extents(len(memory))
        self.view = memoryview(memory)


class Sending:
    """Copies large parts into memory that the other end reads.

    The first large part causes a ring to be made; a part that finds no room causes a larger ring. Large parts wait at
    most a second for that ring; after that they travel with their frames, outside the ring.

    Args:
        say: sends a message, with a descriptor or without; False: the connection takes none any more.
        report: says why there is no ring.
        room: called when parts that had to wait may be sent.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        say: Callable[[bytes, int | None], bool],
        report: Callable[[str], None],
        room: Callable[[], None],
    ) -> None:
        self._loop, self._say, self._report, self._room = loop, say, report, room
        self._rings: dict[int, _Ring] = {}
        """By number: the ring in use, and older rings that arrays still use."""
        self._used: _Ring | None = None
        self._making: Making | None = None
        self._memory: mmap.mmap | None = None
        """The memory of the ring in `_making`, once it is complete."""
        self._awaits = 0
        """The kind of the next message from the other end."""
        self._made = 0
        self._holding: asyncio.TimerHandle | None = None
        """The timer that ends the wait of large parts for the ring that is being made; None: no part waits."""
        self.closed = False

    def put(self, parts: Sequence[memoryview]) -> Put | None:
        """The places of the parts of a frame; None: there is none yet, and the frame has to wait for `room`."""
        # Between the descriptor and its answer it is not known which ring the other end means.
        ring = None if self._awaits == MAPPED else self._used
        places, beside, wanted = list[Place](), list[memoryview](), 0
        for part in parts:
            size = part.nbytes
            if size >= LEAST and len(parts) <= PLACES:
                start = None if ring is None else ring.extents.take(size)
                if ring is not None and start is not None:
                    ring.view[start : start + size] = part.cast("B") if part.format != "B" or part.ndim != 1 else part
                    places.append((start, size))
                    continue
                wanted = max(wanted, size)
            places.append((0, 0))
            beside.append(part)
        if wanted:
            self._grow(wanted)
            if self._holding is not None:
                self.take_back(places)
                return None
        return Put([] if len(beside) == len(parts) else places, beside)

    def take_back(self, places: Sequence[Place]) -> None:
        """Take back the last `put`, which was not sent."""
        for start, length in places:
            if length and self._used is not None:
                self._used.extents.give(start)

    def _grow(self, size: int) -> None:
        """Begin to make a ring that has room for parts of this size."""
        if self._making is not None:
            return
        before = 0 if self._used is None else self._used.extents.size
        wanted = min(LARGEST, max(_SMALLEST, _SLOTS * size, 4 * before))
        if self.closed or self._made >= RINGS or size > LARGEST or wanted <= before:
            return
        self._made += 1
        try:
            self._making = Making(wanted - wanted % mmap.PAGESIZE)
        except OSError as error:
            self._without(error)
            return
        self._holding = self._loop.call_later(_HELD, self._let_go)
        self._loop.call_soon(self._step)

    def _let_go(self) -> None:
        """Let large parts no longer wait for a ring."""
        if self._holding is not None:
            self._holding.cancel()
            self._holding = None
            self._room()

    def _step(self) -> None:
        if self._making is None:
            return
        try:
            self._memory = self._making.step()
        except (OSError, ValueError) as error:
            self._without(error)
            return
        if self._memory is None:
            self._loop.call_soon(self._step)
        elif self._say(OFFERED, None):
            self._awaits = READY
        else:
            self._drop()

    def _without(self, error: Exception) -> None:
        self._made = RINGS
        self._drop()
        self._report(f"no memory for arrays, which are sent through the socket: {error}")

    def _drop(self) -> None:
        if self._making is not None:
            self._making.close()
        self._making = self._memory = None
        self._awaits = 0
        self._let_go()

    def heard(self, what: int, body: bytes) -> None:
        """Take a message of the other end about our rings.

        Raises:
            LinkError: this message was not due.
        """
        if what == READY and self._awaits == READY and self._making is not None:
            self._awaits = MAPPED
            if not self._say(bytes((RING,)), self._making.descriptor):
                self._made = RINGS  # the other end waits for this one, and would take no other
                self._drop()
        elif what == MAPPED and self._awaits == MAPPED and self._memory is not None:
            before = self._used
            self._used = self._rings[self._made] = _Ring(self._made, self._memory)
            self._drop()
            if before is not None:
                self._forget(before)
        elif what == CANNOT and self._awaits:
            self._made = RINGS
            self._drop()
        else:
            raise LinkError("it speaks of a ring that there is not")

    def freed(self, body: bytes) -> None:
        """Take back the extents that the other end frees.

        Raises:
            LinkError: the extents were not taken.
        """
        for number, start in freed_of(body):
            ring = self._rings.get(number)
            if ring is None or not ring.extents.give(start):
                raise LinkError(f"it gave back {start} of ring {number}, which was not taken")
            self._forget(ring)

    def _forget(self, ring: _Ring) -> None:
        """Forget an older ring, once no array uses its memory."""
        if ring is not self._used and not ring.extents.count:
            self._rings.pop(ring.number, None)

    def close(self) -> None:
        """End the sender: nothing is sent any more. Memory that the other end uses stays as it is."""
        self.closed = True
        if self._holding is not None:
            self._holding.cancel()
            self._holding = None
        self._drop()
        self._rings.clear()
        self._used = None
