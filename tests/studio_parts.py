"""A server of the studio in this process or in one of its own, and a client that sends what it likes."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

from aiorts.control import Right
from aiorts_studio.api import Api
from aiorts_studio.serving import HOST, bound, served
from aiorts_studio.watching.places import PlaceFiles
from aiorts_studio.watching.studio import Studio
from control_parts import WAIT


@dataclass
class Reply:
    """What a server has answered."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def value(self) -> Any:
        return json.loads(self.body)

    @property
    def lines(self) -> list[Any]:
        return [json.loads(line) for line in self.body.splitlines()]


@dataclass
class Site:
    """A server, as its client knows it."""

    port: int
    code: str = ""
    token: str = ""
    said: list[str] = field(default_factory=list)
    api: Api | None = None

    @property
    def host(self) -> str:
        return f"{HOST}:{self.port}"

    @property
    def origin(self) -> str:
        return f"http://{self.host}"

    async def ask(
        self,
        method: str,
        path: str,
        value: Any = None,
        *,
        body: bytes | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> Reply:
        """One request over a connection of its own; headers with an empty value are left out."""
        if body is None:
            body = b"" if value is None else json.dumps(value).encode()
        given = {"Host": self.host, "Connection": "close", "Content-Length": str(len(body))}
        given |= {"Content-Type": "application/json"} if body else {}
        given |= {"Authorization": f"Bearer {self.token}"} if self.token else {}
        given |= headers or {}
        head = "".join(f"{name}: {text}\r\n" for name, text in given.items() if text)
        return parsed(await self.raw(f"{method} {path} HTTP/1.1\r\n{head}\r\n".encode() + body))

    async def raw(self, data: bytes) -> bytes:
        """All that is answered to some bytes."""
        async with asyncio.timeout(WAIT):
            reader, writer = await asyncio.open_connection(HOST, self.port)
            try:
                writer.write(data)
                return await reader.read()
            finally:
                writer.close()

    async def call(self, kernel: str, operation: str, /, **arguments: Any) -> Reply:
        return await self.ask("POST", f"/api/kernels/{kernel}/{operation}", arguments)

    async def exchange(self, code: str, **headers: str) -> Reply:
        return await self.ask("POST", "/api/token", {"code": code}, headers={"Origin": self.origin, **headers})

    async def enter(self) -> None:
        """Exchange the code for the token."""
        reply = await self.exchange(self.code)
        assert reply.status == 200, reply
        self.token = reply.value["token"]

    @asynccontextmanager
    async def socket(self, **first: Any) -> AsyncIterator[ClientConnection]:
        """A WebSocket that has said its token, or something else first."""
        async with connect(f"ws://{self.host}/api/socket", origin=self.origin) as socket:  # type: ignore[arg-type]
            await socket.send(json.dumps(first or {"token": self.token}))
            yield socket


def parsed(data: bytes) -> Reply:
    head, _, body = data.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    headers = {name.lower(): text.strip() for name, _, text in (line.partition(":") for line in lines)}
    if headers.get("transfer-encoding") == "chunked":
        body = b"".join(chunks(body))
    return Reply(int(first.split()[1]), headers, body)


def chunks(body: bytes) -> Iterator[bytes]:
    while body:
        length, _, body = body.partition(b"\r\n")
        yield body[: int(length, 16)]
        body = body[int(length, 16) + 2 :]


@asynccontextmanager
async def site(
    right: Right = Right.VIEW, *, enters: bool = True, places: PlaceFiles | None = None
) -> AsyncIterator[Site]:
    """A server of this process; its client has a token."""
    listening = bound(HOST, 0)
    found = Site(listening.getsockname()[1])
    ours = (found.host, f"localhost:{found.port}")
    found.api = api = Api("http", ours, right, found.said.append, {}, Studio(places=places))
    async with served(listening, api.app):
        found.code = api.codes.issue(time.monotonic())
        if enters:
            await found.enter()
        try:
            yield found
        finally:
            await api.close()


@contextmanager
def serving(*words: str) -> Iterator[tuple[subprocess.Popen[str], Site]]:
    """`aiorts studio --api WORDS` in a process of its own; killed at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "studio", "--api", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        url, code = process.stdout.readline().strip(), process.stdout.readline().strip()
        if not url:
            raise AssertionError(process.communicate(timeout=WAIT)[1])
        yield process, Site(int(url.rpartition(":")[2]), code)
    finally:
        process.kill()
        process.communicate(timeout=WAIT)


def resident(pid: int) -> int:
    """Bytes of the memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096


def seconds_of(pid: int) -> float:
    """Processor time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
