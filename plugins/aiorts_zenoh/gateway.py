"""A client's end: for each kernel of other hosts a socket in a folder of this host, as kernels of this host have one.

So every command that reaches kernels of this host reaches those of others, and knows nothing of it.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Coroutine, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from aiorts.control import Claim, answer_in
from aiorts.errors import WireError
from aiorts.links import Peer
from aiorts_zenoh.carried import Carried
from aiorts_zenoh.engine import Engine, Inbox, in_thread
from aiorts_zenoh.envelope import read
from aiorts_zenoh.keys import CTL, HELLO, INFO, ClientKeys, peer_of, session_in

_ANSWERS: Final = 0.5
"""Seconds that kernels have to say what this client may do."""


class Gateway:
    """Makes kernels of other hosts reachable from commands of this one.

    Args:
        folder: for the sockets; of this user alone.
        keys: the domain and this client's name.
        settings: of the engine by their keys.
    """

    def __init__(self, folder: Path, keys: ClientKeys, settings: Mapping[str, Any]) -> None:
        self._folder, self._keys, self._settings = folder, keys, settings
        self._engine = Engine()
        self._operable: set[Peer] = set()
        self._served: dict[Peer, tuple[Claim, asyncio.Task[None]]] = {}
        self._sessions: dict[str, tuple[Peer, Carried]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._inbox: Inbox
        self._found: list[str] = []

    @property
    def peers(self) -> tuple[Peer, ...]:
        """The kernels that can be reached."""
        return tuple(self._served)

    async def open(self) -> None:
        """Open the session, and a socket for each kernel that is there.

        Raises:
            LinkError: nothing answers where this is to connect to.
            MissingExtra: the engine is not installed.
        """
        self._inbox = Inbox(asyncio.get_running_loop())
        await in_thread(self._declare)
        for token in self._found:
            self._add(token, is_new=False)
        self._engine.presence(self._keys.tokens, self._present)

    def _declare(self) -> None:
        engine, keys = self._engine, self._keys
        engine.open(self._settings, self._inbox)
        for branch in (INFO, CTL):
            engine.subscribe(keys.answers(branch), self._arrived)
        self._found = engine.present(keys.tokens, _ANSWERS)
        self._find_operable(keys.every(CTL, HELLO))

    def _find_operable(self, key: str) -> None:
        """Ask which kernels let this client operate them; in a thread."""
        for at, data in self._engine.gather(key, _ANSWERS):
            try:
                said = answer_in(data)["ok"]
                if said["right"] == "operate" and (peer := peer_of(at)) is not None:
                    self._operable.add(peer)
            except (WireError, LookupError, TypeError):
                continue

    async def close(self) -> None:
        """Close all sockets and sessions."""
        for peer in tuple(self._served):
            self._remove(peer)
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._inbox.close()
        await in_thread(self._engine.close)

    # -- kernels ---------------------------------------------------------------------------------------------------

    def _present(self, token: str, up: bool) -> None:
        peer = peer_of(token)
        if up:
            self._add(token, is_new=True)
        elif peer is not None and peer in self._served:
            self._remove(peer)

    def _add(self, token: str, *, is_new: bool) -> None:
        peer = peer_of(token)
        if peer is None or peer in self._served:
            return
        for old in [one for one in self._served if (one.host, one.kernel) == (peer.host, peer.kernel)]:
            self._remove(old)  # its end is not known here yet
        claim = Claim(f"{peer.host}/{peer.kernel}", f"{peer.epoch:016x}", self._folder)
        self._served[peer] = claim, self._run(self._serve(peer, claim, is_new=is_new))

    async def _serve(self, peer: Peer, claim: Claim, *, is_new: bool) -> None:
        """Let commands of this host in, until the kernel goes."""
        try:
            if is_new:
                await in_thread(partial(self._find_operable, self._keys.session(CTL, peer, HELLO)))
            server = await asyncio.start_unix_server(
                lambda *ends: self._run(self._carry(peer, *ends)), sock=claim.listener
            )
            try:
                await asyncio.Event().wait()
            finally:
                server.close()
        finally:
            claim.listener.close()

    def _remove(self, peer: Peer) -> None:
        claim, serving = self._served.pop(peer)
        claim.withdraw()
        serving.cancel()
        self._operable.discard(peer)
        for whose, carried in tuple(self._sessions.values()):
            if whose == peer:
                carried.close()

    # -- sessions --------------------------------------------------------------------------------------------------

    async def _carry(self, peer: Peer, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        branch = CTL if peer in self._operable else INFO
        session = secrets.token_hex(8)
        key = self._keys.session(branch, peer, session)
        token = self._engine.hold(f"{key}/live")
        carried = Carried(partial(self._engine.put, f"{key}/c", urgent=branch == CTL), int(session[:8], 16))
        self._sessions[session] = peer, carried
        try:
            await carried.run(reader, writer)
        finally:
            del self._sessions[session]
            self._engine.release(token)

    def _arrived(self, key: str, data: bytes) -> None:
        _, session = session_in(key)
        if (found := self._sessions.get(session)) is not None:
            with suppress(ValueError):  # it is no message, and nothing is lost with it
                found[1].arrived(read(data))

    def _run(self, coroutine: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
