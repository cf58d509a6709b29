"""A client's sessions with kernels of other hosts: a local connection at this end of each."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Collection
from contextlib import suppress
from functools import partial
from typing import Final

from aiorts.errors import WireError
from aiorts.links import Peer
from aiorts.sessions import answer_in
from aiorts_zenoh.carried import Carried
from aiorts_zenoh.engine import Engine, in_thread
from aiorts_zenoh.envelope import read
from aiorts_zenoh.keys import CTL, HELLO, INFO, ClientKeys, peer_of, session_in

DEADLINE: Final = 3.0
"""Seconds in which kernels are found, and in which they say what this client may do."""
_ROUND: Final = 0.5
"""Seconds for the answers of all kernels; a kernel without an answer is asked again when a session with it begins."""
_LATER: Final = 1.0
"""Seconds that the answer below `ctl` may come after the answer below `info`."""
_AGAIN: Final = 0.05


class Sessions:
    """The sessions of one client.

    Args:
        engine: carries them.
        keys: the domain and the client's name.
    """

    def __init__(self, engine: Engine, keys: ClientKeys) -> None:
        self._engine, self._keys = engine, keys
        self._there: dict[str, tuple[Peer, Carried]] = {}
        self._begins: dict[str, Peer] = {}
        """Sessions that begin: their kernels are being asked whether the branch is `info` or `ctl`."""
        self._operable: set[Peer] = set()
        """Kernels that have said that this client may operate them; the others are asked again."""

    def declare(self) -> None:
        """Take the messages of kernels from now on; in a thread."""
        for branch in (INFO, CTL):
            self._engine.subscribe(self._keys.answers(branch), self._arrived)

    # -- questions -------------------------------------------------------------------------------------------------

    async def find_operable(self) -> None:
        """Ask all kernels with one question which of them let this client operate them."""
        answers = await self.asked(self._keys.every(CTL, HELLO), _ROUND)
        self._operable |= {peer for peer, data in answers.items() if _operates(data)}

    async def _branch(self, peer: Peer) -> str:
        """The branch for a session with a kernel: `ctl` if the kernel says so within the deadline, else `info`."""
        if peer in self._operable:
            return CTL
        with suppress(TimeoutError):
            async with asyncio.timeout(DEADLINE):
                return await self._ask_branch(peer)
        return INFO

    async def _ask_branch(self, peer: Peer) -> str:
        """Ask below both branches until one answers. No answer below `ctl` counts only after one below `info`."""
        while True:
            operates, looks = (
                asyncio.ensure_future(self.asked(self._keys.session(branch, peer, HELLO), DEADLINE))
                for branch in (CTL, INFO)
            )
            try:
                seen = await looks
                await asyncio.wait([operates], timeout=_LATER)
                if operates.done() and _operates(operates.result().get(peer, b"")):
                    return CTL
            finally:
                operates.cancel()
            if seen:
                return INFO
            await asyncio.sleep(_AGAIN)

    async def asked(self, key: str, first: float, following: float | None = None) -> dict[Peer, bytes]:
        """The answers to a question, by the kernels that gave them.

        Args:
            first: seconds to wait for the first answer; for all answers where `following` is None.
            following: seconds to wait for another answer after each.
        """
        found: dict[Peer, bytes] = {}
        ended, news = asyncio.Event(), asyncio.Event()

        def answered(at: str, data: bytes) -> None:
            if (peer := peer_of(at)) is not None:
                found[peer] = data
            news.set()

        def over() -> None:
            ended.set()
            news.set()

        within = first if following is None else DEADLINE
        await in_thread(partial(self._engine.ask_all, key, within, answered, over))
        with suppress(TimeoutError):
            while not ended.is_set():
                async with asyncio.timeout(following if found and following else first):
                    await news.wait()
                news.clear()
        return found

    # -- sessions --------------------------------------------------------------------------------------------------

    async def carry(
        self, peer: Peer, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, begun: bytes = b""
    ) -> None:
        """Carry one session until either end ends it: it operates the kernel if the kernel permits that, else looks.

        Args:
            begun: the bytes that have come from the local connection before.
        """
        session = secrets.token_hex(8)
        try:
            branch = await self._begin(session, peer)
            if branch is None:
                return
            key = self._keys.session(branch, peer, session)
            token = self._engine.hold(f"{key}/live")
            carried = Carried(partial(self._engine.put, f"{key}/c", urgent=branch == CTL), int(session[:8], 16))
            self._there[session] = peer, carried
            try:
                await carried.run(reader, writer, begun)
            finally:
                del self._there[session]
                self._engine.release(token)
        finally:
            writer.close()

    async def _begin(self, session: str, peer: Peer) -> str | None:
        """The branch for a session, `ctl` or `info`; None: its kernel has gone meanwhile."""
        self._begins[session] = peer
        try:
            branch = await self._branch(peer)
        finally:
            is_there = self._begins.pop(session, None) is not None
        if not is_there:
            return None
        if branch == CTL:
            self._operable.add(peer)
        return branch

    def end(self, peer: Peer) -> None:
        """End the sessions with a kernel, which is gone."""
        self._operable.discard(peer)
        self._begins = {session: whose for session, whose in self._begins.items() if whose != peer}
        for whose, carried in tuple(self._there.values()):
            if whose == peer:
                carried.peer_gone()

    def keep(self, there: Collection[Peer]) -> None:
        """End the sessions with all kernels but these, which are there."""
        for peer in {*self._operable, *self._begins.values(), *(whose for whose, _ in self._there.values())}:
            if peer not in there:
                self.end(peer)

    def _arrived(self, key: str, data: bytes) -> None:
        _, session = session_in(key)
        if (found := self._there.get(session)) is not None:
            with suppress(ValueError):  # it is no message, and nothing is lost with it
                found[1].arrived(read(data))


def _operates(data: bytes) -> bool:
    """Whether a kernel's answer says that the client may operate it."""
    try:
        return bool(answer_in(data)["ok"]["right"] == "operate")
    except (WireError, LookupError, TypeError):
        return False
