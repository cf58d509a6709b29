"""What a component leaves behind when it is finalised is reported by name; its tasks are cancelled."""

from __future__ import annotations

import asyncio
import functools
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, EventContext, Kernel
from aiorts.testing import simulated

pytestmark = pytest.mark.anyio


class Leaver(Component):
    """Starts and opens a lot, and gives nothing up."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.end = threading.Event()
        self.closed_file = open(__file__)  # noqa: SIM115 - a component keeps it open
        self.closed_file.close()

    async def on_activated(self) -> None:
        self.reader = threading.Thread(target=self.wait, args=(60.0,), name="reader")
        self.reader.start()
        self.unkept()
        self.pool = ThreadPoolExecutor(1, thread_name_prefix="pool")
        self.pool.submit(self.end.wait)
        self.file = open(__file__)  # noqa: SIM115 - a component keeps it open
        self.sockets = [socket.socket()]
        self.children = {"child": subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)}
        self.task = asyncio.create_task(self.forever(), name="poller")

    def unkept(self) -> None:
        threading.Thread(target=functools.partial(self.wait, 60.0), name="unkept").start()

    def wait(self, seconds: float) -> None:
        self.end.wait(seconds)

    async def forever(self) -> None:
        await asyncio.Event().wait()

    def clean(self) -> None:
        self.end.set()
        self.reader.join()
        self.pool.shutdown()
        self.file.close()
        self.sockets[0].close()
        self.children["child"].communicate(timeout=40)


@pytest.mark.fault("A15")
@pytest.mark.row(92)
@pytest.mark.parametrize("how", ["remove", "close"])
async def test_what_is_left_is_named_exactly_and_tasks_are_cancelled(
    how: str, caplog: pytest.LogCaptureFixture
) -> None:
    kernel = await Kernel().open()
    one: Any = await kernel.create(Leaver, "one")
    other = await kernel.create(Component, "other")
    try:
        await kernel.start(EventContext(), one, other, activate=True)
        if how == "remove":
            await kernel.remove(one)
        else:
            await kernel.aclose()
        assert one.task.cancelled()
        lines = [record.getMessage() for record in caplog.records]
        descriptor, pid = one.sockets[0].fileno(), one.children["child"].pid
        assert lines == [
            "one: left task poller running; it is cancelled",
            "one: left after on_finalize: thread 'reader' (self.reader), thread 'pool_0' (self.pool), "
            f"file {__file__!r} (self.file), socket of descriptor {descriptor} (self.sockets), "
            f"process {pid} (self.children), thread 'unkept'",
        ]
    finally:
        one.clean()
        await kernel.aclose()
        for thread in threading.enumerate():
            if thread.name == "unkept":
                thread.join()


@pytest.mark.fault("A15")
@simulated
async def test_who_gives_everything_up_is_not_named(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    class Tidy(Component):
        async def on_activated(self) -> None:
            self.file = open(tmp_path / "x", "w")  # noqa: SIM115 - a component keeps it open
            self.thread = threading.Thread(target=self.run)
            self.thread.start()

        def run(self) -> None:
            """Ends at once."""

        def on_finalize(self) -> None:
            self.file.close()
            self.thread.join()

    async with Kernel() as kernel:
        await kernel.start(EventContext(), await kernel.create(Tidy), activate=True)
    assert not caplog.records
