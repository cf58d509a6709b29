"""Programs of children, and which processes of a test are there, whatever became of their parents."""

from __future__ import annotations

import asyncio
import os
import socket
import textwrap
import time
import uuid
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

from aiorts.processes import Child, Launcher, Limits

WAIT = 20.0
"""Seconds within which anything happens, also where other tests take the processors."""
GONE = 2.0
"""Seconds within which nothing is left of a process that was killed."""
MARK = "AIORTS_TEST_MARK"
DAEMON = """
import subprocess, sys
code = "import os, signal, time\\nfor n in (1, 2, 15): signal.signal(n, signal.SIG_IGN)\\n" \\
    "os.fork() and os._exit(0)\\nos.setsid()\\nopen('/proc/self/comm', 'w').write('daemon')\\ntime.sleep(100)"
subprocess.run([sys.executable, "-c", code])
"""
"""Leaves a process that has a session of its own, whose parent has ended, and that ignores what can be ignored."""


def program(body: str, *, prepared: bool = True) -> list[str]:
    """The arguments of a child that runs this."""
    begin = "from aiorts.processes import prepare\nprepare()\n" if prepared else ""
    return ["-c", begin + textwrap.dedent(body).strip()]


@contextmanager
def marked() -> Iterator[str]:
    """Mark all processes that are started within."""
    mark = os.environ[MARK] = uuid.uuid4().hex
    try:
        yield mark
    finally:
        del os.environ[MARK]


def there(mark: str) -> dict[int, str]:
    """The processes with a mark that have not ended, and their names."""
    found = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal() and int(folder.name) != os.getpid():
            try:
                if f"{MARK}={mark}".encode() in (folder / "environ").read_bytes():
                    found[int(folder.name)] = (folder / "comm").read_text().strip()
            except OSError:
                continue
    return found


def all_gone(mark: str, within: float = GONE) -> dict[int, str]:
    """What is left of the processes with a mark after so many seconds at the most."""
    until = time.monotonic() + within
    while (left := there(mark)) and time.monotonic() < until:
        time.sleep(0.01)
    return left


class Started:
    """A launcher and what its children write."""

    def __init__(self, mark: str) -> None:
        self.mark = mark
        self.launcher = Launcher()
        self.lines: list[tuple[str, str]] = []
        self.ours, self.its = socket.socketpair()

    async def start(self, body: str, *, prepared: bool = True, limits: Limits | None = None) -> Child:
        async with asyncio.timeout(WAIT):
            return await self.launcher.start(
                program(body, prepared=prepared),
                descriptor=self.its.fileno(),
                name="camera0",
                on_line=lambda stream, line: self.lines.append((stream, line)),
                limits=limits or Limits(),
            )

    async def line(self, text: str) -> None:
        """Wait until a child has written it."""
        async with asyncio.timeout(WAIT):
            while not any(line == text for _, line in self.lines):
                await asyncio.sleep(0.005)

    @property
    def helper(self) -> int:
        process = self.launcher._helper
        assert process is not None
        return process.pid


@asynccontextmanager
async def started() -> AsyncIterator[Started]:
    """A launcher, whose processes are gone when it is closed."""
    with marked() as mark:
        found = Started(mark)
        try:
            yield found
        finally:
            await found.launcher.close(WAIT)
            found.ours.close()
            found.its.close()
        assert all_gone(mark, 0.5) == {}
