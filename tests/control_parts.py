"""What tests of control are made of: kernels in this process and in others, and clients of them."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any, TypeVar

import pytest

from aiorts import Component, InPort, Kernel, OutPort, Param, PeriodicContext
from aiorts.cli.app import run_command
from aiorts.sessions import Client, Entry, entries
from aiorts.types import TimedDouble

T = TypeVar("T")
WAIT = 20.0
"""Seconds, at most, for what takes milliseconds on an idle machine."""


class Counter(Component):
    """Writes 1, 2, 3 ..."""

    out = OutPort(TimedDouble)
    step: float = Param(1.0, ge=0.0)
    count = 0.0

    async def on_execute(self) -> None:
        self.count += self.step
        self.out.write_nowait(TimedDouble(data=self.count))


class Reader(Component):
    """Takes what comes."""

    in_ = InPort(TimedDouble, name="in")

    async def on_execute(self) -> None:
        self.in_.drain()


@asynccontextmanager
async def controlled(name: str = "unit", mode: str = "on", rate: float = 100.0) -> AsyncIterator[Kernel]:
    """A kernel of this process with a socket: counter0.out -> reader0.in."""
    async with Kernel(services={"control": {"name": name, "mode": mode}}) as kernel:
        counter = await kernel.create(Counter, "counter0")
        reader = await kernel.create(Reader, "reader0")
        await kernel.connect(counter.out, reader.in_)
        await kernel.start(PeriodicContext(rate=rate, name="loop"), counter, reader, activate=True)
        yield kernel


def entry_of(name: str) -> Entry:
    """The entry of the kernel of this name."""
    return next(one for one in entries() if one.name == name)


async def with_client(name: str, use: Callable[[Client], T]) -> T:
    """What `use` makes of a session with the kernel of this name, in a thread: the client blocks."""

    def work() -> T:
        with Client.open(entry_of(name), timeout=WAIT) as client:
            return use(client)

    return await asyncio.to_thread(work)


async def commanded(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """The status of `aiorts WORDS` and what it printed, on both streams, while kernels of this process run on."""
    status = await asyncio.to_thread(run_command, words)
    out, err = capsys.readouterr()
    return status, out + err


@contextmanager
def running(name: str, *words: str) -> Iterator[subprocess.Popen[str]]:
    """`aiorts run --name NAME WORDS` in a process of its own, from when it can be reached; killed at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "run", "--name", name, *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        until(lambda: process.poll() is not None or any(one.name == name for one in entries()))
        if process.poll() is not None:
            raise AssertionError(f"it ended with {process.returncode}: {process.communicate(timeout=WAIT)[0]}")
        yield process
    finally:
        process.kill()
        process.communicate(timeout=WAIT)


def until(condition: Callable[[], Any], seconds: float = WAIT) -> Any:
    """What the condition gives once it is true; AssertionError when it is not within `seconds`."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"not within {seconds} s")
        time.sleep(0.01)
    return found
