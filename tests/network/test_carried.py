"""One end of a session: what ends it before it has a connection."""

from __future__ import annotations

import asyncio
import socket

import pytest

pytest.importorskip("zenoh")

from aiorts_zenoh.carried import Carried
from aiorts_zenoh.envelope import END, read

WAIT = 10.0


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
