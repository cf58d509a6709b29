"""One end of a session: what ends it before it begins."""

from __future__ import annotations

import asyncio
import socket

import pytest

pytest.importorskip("zenoh")

from aiorts.links import Peer
from aiorts_zenoh.carried import Carried
from aiorts_zenoh.engine import Engine, Inbox, in_thread
from aiorts_zenoh.envelope import END, read
from aiorts_zenoh.keys import ClientKeys
from aiorts_zenoh.network import NetworkSettings, engine_settings
from aiorts_zenoh.sessions import Sessions

WAIT = 10.0


@pytest.mark.slow
@pytest.mark.fault("E18")
def test_a_session_that_is_ended_while_it_is_let_in_is_over() -> None:
    async def main() -> list[int]:
        sent: list[bytes] = []
        carried = Carried(sent.append, 1)
        carried.cut_off()
        kernel, ours = socket.socketpair()
        with kernel:
            async with asyncio.timeout(WAIT):
                await carried.run(*await asyncio.open_unix_connection(sock=ours))
            assert kernel.recv(1) == b""
        return [read(one).kind for one in sent]

    assert END in asyncio.run(main())


def test_a_client_is_not_left_waiting_where_nobody_can_be_asked() -> None:
    async def main() -> bytes:
        engine, inbox = Engine(), Inbox(asyncio.get_running_loop())
        await in_thread(lambda: engine.open(engine_settings(NetworkSettings()), inbox))
        await in_thread(engine.close)
        client, theirs = socket.socketpair()
        with client:
            client.setblocking(False)
            reader, writer = await asyncio.open_unix_connection(sock=theirs)
            session = Sessions(engine, ClientKeys("default", "client")).carry(Peer("host", "a", 1), reader, writer)
            task = asyncio.ensure_future(session)
            async with asyncio.timeout(WAIT):
                said = await asyncio.get_running_loop().sock_recv(client, 1)
                await asyncio.wait([task])
            assert task.exception() is not None
        return said

    assert asyncio.run(main()) == b""
