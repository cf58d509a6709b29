"""A client's end: makes kernels of other hosts reachable by a socket in a folder, as kernels of this host are.

So every command for kernels of this host reaches those of other hosts, and knows nothing of it. The folder lists the
kernels whose tokens are there. A session with a kernel begins when a command needs it; a command's question to very
many kernels is sent once, to all of them, without sessions.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from aiorts.errors import AbsentError, AiortsError, LinkError
from aiorts.links import Peer
from aiorts.sessions import REQUESTS, Carrier, answer_in, framed, frames
from aiorts_zenoh.engine import Engine, Inbox, in_thread
from aiorts_zenoh.keys import INFO, ClientKeys, peer_of
from aiorts_zenoh.sessions import DEADLINE, Sessions
from aiorts_zenoh.stream import CHUNK

_FIRST: Final = 1.0
"""Seconds to wait for the first answer of many kernels; `_NEXT`: for another answer after each."""
_NEXT: Final = 0.25
_BEGINS: Final = 5.0
"""Seconds in which a command sends its first frame."""
_COMMANDS: Final = 1_024
"""The most commands that may wait to be let in."""


class Gateway:
    """Makes kernels of other hosts reachable from commands of this one.

    Args:
        folder: the place of the socket and the list; of this user alone.
        keys: the domain and this client's name.
        settings: settings of the engine by their keys.
    """

    def __init__(self, folder: Path, keys: ClientKeys, settings: Mapping[str, Any]) -> None:
        self._keys, self._settings = keys, settings
        self._carrier = Carrier(folder)
        self._engine = Engine()
        self._sessions = Sessions(self._engine, keys)
        self._peers: dict[tuple[str, str], Peer] = {}
        """The kernels that are there, by host and name."""
        self._tasks: set[asyncio.Task[Any]] = set()
        self._asking: asyncio.Task[None]
        self._early: tuple[str, asyncio.Task[dict[Peer, bytes]]] | None = None
        self._settling = False
        self._inbox: Inbox | None = None
        self._server: asyncio.Server | None = None

    @property
    def peers(self) -> tuple[Peer, ...]:
        """The kernels that can be reached."""
        return tuple(self._peers.values())

    async def open(self) -> None:
        """Open the session, and list the kernels that are there.

        Raises:
            LinkError: nothing answers where this is to connect to.
            MissingExtra: the engine is not installed.
        """
        self._inbox = inbox = Inbox(asyncio.get_running_loop())
        for token in await in_thread(partial(self._declare, inbox)):
            self._present(token, True)
        self._server = await asyncio.start_unix_server(self._came, self._carrier.path, backlog=_COMMANDS)
        self._settle()  # a list without a listener looks like one that a killed process has left
        self._asking = self._run(self._sessions.find_operable())
        self._engine.presence(self._keys.tokens, self._present)

    def _declare(self, inbox: Inbox) -> list[str]:
        """Open the session; return the tokens of the kernels that are there."""
        engine, keys = self._engine, self._keys
        engine.open(self._settings, inbox)
        self._sessions.declare()
        return engine.present(keys.tokens, DEADLINE)

    def ask_early(self, operation: str) -> None:
        """Ask all kernels now, for a command that is being started; the first command to want the answers gets them."""
        self._early = operation, self._run(self._answers(operation))

    async def close(self) -> None:
        """Close the socket and all sessions."""
        if self._server is not None:
            self._server.close()
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._inbox is not None:
            self._inbox.close()
        await in_thread(self._engine.close)

    # -- kernels ---------------------------------------------------------------------------------------------------

    def _present(self, token: str, up: bool) -> None:
        peer = peer_of(token)
        if peer is None:
            return
        name = peer.host, peer.kernel
        before = self._peers.get(name)
        if up:
            self._peers[name] = peer  # the end of a former kernel of the name may not be known here yet
        elif before == peer:
            del self._peers[name]
        if self._peers.get(name) != before and not self._settling:
            self._settling = True
            asyncio.get_running_loop().call_soon(self._settle)

    def _settle(self) -> None:
        """List the kernels that are there, and end the sessions with all others."""
        self._settling = False
        there = set(self._peers.values())
        self._carrier.write((_address(peer), _epoch(peer)) for peer in there)
        self._sessions.keep(there)

    # -- commands --------------------------------------------------------------------------------------------------

    def _came(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._run(self._let_in(reader, writer))

    async def _let_in(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a command: carry its session, or answer its question to all kernels."""
        try:
            async with asyncio.timeout(_BEGINS):
                begun, first = await _first_frame(reader)
            if "every" in first:
                writer.write(framed({"said": await self._values(str(first["every"]))}))
                await writer.drain()
            else:
                peer = self._meant(first)
                await asyncio.wait([self._asking])
                await self._sessions.carry(peer, reader, writer, begun)
        except AiortsError as error:
            if not writer.is_closing():  # by `Sessions.carry`
                writer.write(framed({"error": {"code": error.code, "text": str(error)}}))
        except (OSError, TimeoutError):
            pass  # the command has gone, or is none
        finally:
            writer.close()

    def _meant(self, first: Mapping[Any, Any]) -> Peer:
        """The kernel with which a command begins a session; AbsentError: it is gone."""
        hello = first.get("hello")
        said = hello.get("to") if isinstance(hello, dict) else None
        address, epoch = said if isinstance(said, list) and len(said) == 2 else ("", "")
        host, _, kernel = str(address).rpartition("/")
        peer = self._peers.get((host, kernel))
        if peer is None or _epoch(peer) != epoch:
            raise AbsentError(f"{address}: is gone; `aiorts ls` shows what runs")
        return peer

    async def _values(self, operation: str) -> list[tuple[str, str, Any]]:
        """The answers of kernels to a call: address, epoch and value of each that answers soon."""
        early, self._early = self._early, None
        answers = await (early[1] if early is not None and early[0] == operation else self._answers(operation))
        values = []
        for peer, data in answers.items():
            with suppress(AiortsError, LookupError):
                values.append((_address(peer), _epoch(peer), answer_in(data)["ok"]))
        return values

    async def _answers(self, operation: str) -> dict[Peer, bytes]:
        return await self._sessions.asked(self._keys.every(INFO, operation), _FIRST, _NEXT)

    def _run(self, coroutine: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task


async def _first_frame(reader: asyncio.StreamReader) -> tuple[bytes, dict[Any, Any]]:
    """All bytes that have come, and the first frame in them. LinkError: there is none."""
    begun = b""
    while data := await reader.read(CHUNK):
        begun += data
        for frame in frames(bytearray(begun), REQUESTS.frame):
            return begun, answer_in(frame)
    raise LinkError("nothing was said")


def _address(peer: Peer) -> str:
    return f"{peer.host}/{peer.kernel}"


def _epoch(peer: Peer) -> str:
    return f"{peer.epoch:016x}"
