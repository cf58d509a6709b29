"""A kernel's session with another one that says what is no answer."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import pytest
from anyio import fail_after

from aiorts.errors import ClosedError, WireError
from aiorts.remote.session import KernelSession
from aiorts.sessions import framed
from aiorts.sessions.protocol import NEWEST

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("message", [{"id": 1, "item": {}}, {"id": 1, "ok": None}, {"id": 1, "item": 3}])
async def test_it_ends_and_says_so(message: dict[str, Any]) -> None:
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    theirs.setblocking(False)
    with theirs:
        loop = asyncio.get_running_loop()
        await loop.sock_sendall(theirs, framed({"hello": {"protocol": NEWEST, "epoch": "1", "right": "operate"}}))
        session = await KernelSession.over(ours, "pc/left", "me")
        lost: list[int] = []
        session.lost = lambda: lost.append(1)
        following = asyncio.ensure_future(session.follow("events", lambda item: item["event"].get("component")))
        await asyncio.sleep(0)
        await loop.sock_sendall(theirs, framed({"id": 1, "ok": None}))
        await following
        await loop.sock_sendall(theirs, framed(message))
        with fail_after(10):
            while session.is_open:
                await asyncio.sleep(0.01)
        assert lost == [1]
        with pytest.raises((ClosedError, WireError)):
            await session.call("names")
