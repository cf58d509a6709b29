"""Kernels that run, and the sessions that a client of this server has with them.

No wait for a kernel holds up another: each session begins in a task of its own, and every wait has an end.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from typing import Any, Final

from anyio import to_thread

from aiorts.control import Right
from aiorts.errors import AbsentError, AmbiguousError, ClosedError, DeniedError
from aiorts.late import dataclass
from aiorts.sessions import END, AsyncClient, AsyncStream, Entry, entries
from aiorts_studio.codes import Holder
from aiorts_studio.plain.limits import Bucket

_OPEN: Final = 5.0
"""Seconds within which a kernel has to begin a session."""


@dataclass(frozen=True, slots=True)
class Running:
    """A kernel that runs."""

    name: str
    address: str
    """"host/kernel"; both it and the name stand for the kernel in a path."""
    pid: int
    epoch: str
    """A text that differs at each start of the kernel."""


async def running() -> tuple[Running, ...]:
    """The kernels whose processes are there, by address; ControlError: the folder of sockets is not safe."""
    return tuple(Running(one.name, one.address, one.pid, one.epoch) for one in await _entries())


async def entry_of(word: str) -> Entry:
    """The entry of the kernel with this name or address.

    Raises:
        AbsentError: there is none.
        AmbiguousError: there are several.
    """
    every = await _entries()
    found = [one for one in every if word in (one.name, one.address)]
    if len(found) == 1:
        return found[0]
    if found:
        raise AmbiguousError(f"{word}: is the name of {', '.join(one.address for one in found)}; give the address")
    there = ", ".join(one.name for one in every[:10]) or "none"
    raise AbsentError(f"{word:.80}: no such kernel; there are {there}")


async def _entries() -> list[Entry]:
    return [one for one in await to_thread.run_sync(entries) if _lives(one.pid)]


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True  # of another user
    return True


class Visitor:
    """A client with a token: its sessions with kernels, and its work under way.

    Args:
        holder: the client, as its token names it.
        right: the most that it may do.
    """

    def __init__(self, holder: Holder, right: Right) -> None:
        self.holder = holder
        self.requests = Bucket()
        self._right = right
        self._sessions: dict[str, asyncio.Task[AsyncClient]] = {}
        self._works: set[asyncio.Future[Any]] = set()
        self.closed = False

    async def session(self, entry: Entry) -> AsyncClient:
        """The session with a kernel; it begins with the first call, and again after it has ended.

        Raises:
            AiortsError: the kernel does not answer, or refuses.
        """
        opening = self._sessions.get(entry.epoch)
        if opening is None or (opening.done() and not _is_open(opening)):
            self._sessions = {epoch: one for epoch, one in self._sessions.items() if not one.done() or _is_open(one)}
            opening = self._sessions[entry.epoch] = asyncio.create_task(self._open(entry), name="studio session")
            opening.add_done_callback(lambda done: done.cancelled() or done.exception())
        return await asyncio.shield(opening)

    async def _open(self, entry: Entry) -> AsyncClient:
        who = f"aiorts studio, client {self.holder.number}"
        client = await AsyncClient.open(entry, timeout=_OPEN, who=who, right=self._right.value)
        given = Right(client.right)
        if not self.closed and self._right.allows(given):
            return client
        await client.aclose()
        if self.closed:
            raise ClosedError("the token has ended")
        raise DeniedError(f"{entry.address}: is of a release that gives {given.value!r} whatever is asked; not used")

    async def work(self, work: Coroutine[Any, Any, object], gone: Callable[[], Awaitable[object]]) -> bool:
        """Carry out work while its client is there; False: the client has gone, or its token has ended.

        Args:
            work: is cancelled when the client goes.
            gone: waits until the client has gone.
        """
        working = asyncio.ensure_future(work)
        leaving = asyncio.ensure_future(gone())
        self._works.add(working)
        try:
            if self.closed:
                return False
            await asyncio.wait((working, leaving), return_when=asyncio.FIRST_COMPLETED)
            if not working.done() or working.cancelled():
                return False
            working.result()
            return True
        finally:
            self._works.discard(working)
            for one in (working, leaving):
                one.cancel()
            await asyncio.wait((working, leaving))
            for one in (working, leaving):
                if not one.cancelled():
                    one.exception()

    async def close(self) -> None:
        """End the client's work, and its sessions."""
        self.closed = True
        for work in tuple(self._works):
            work.cancel()
        sessions = tuple(self._sessions.values())
        for opening in sessions:
            opening.cancel()
        if sessions:
            await asyncio.wait(sessions)
        for opening in sessions:
            if _is_open(opening):
                await opening.result().aclose()


async def _at_once() -> None:
    """Wait for nothing: the credit of a client that takes every item at once."""


def _is_open(opening: asyncio.Task[AsyncClient]) -> bool:
    return not opening.cancelled() and opening.exception() is None and opening.result().is_open


async def lines_of(
    stream: AsyncStream, credit: Callable[[], Awaitable[object]] = _at_once
) -> AsyncIterator[Mapping[str, Any]]:
    """The messages to the client of a stream: its beginning, each item, its end.

    Args:
        stream: a stream that has begun.
        credit: waits until the client takes an item; the end needs none.

    Raises:
        AiortsError: the stream's kernel ended, or failed.
    """
    yield {"began": stream.began}
    counted = 0
    while True:
        item = await stream.next()
        missed, counted = stream.missed - counted, stream.missed
        if item is END:
            yield {"end": stream.result, "missed": missed}
            return
        await credit()
        yield {"item": item, "missed": missed}
