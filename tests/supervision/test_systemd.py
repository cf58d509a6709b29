"""systemd is told what is so, over a real socket: ready after activation, alive while contexts get on, stopping."""

from __future__ import annotations

import asyncio
import itertools
import logging
import os
import socket
import subprocess
import sys
import textwrap
import time
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, EventContext, Kernel, PeriodicContext, ThreadContext
from aiorts.errors import ConfigurationError
from aiorts.testing import simulated

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from aiorts import SimulatedClock

pytestmark = pytest.mark.anyio
ONE_LOOP = pytest.mark.parametrize("anyio_backend", ["asyncio"])
"""For what takes its time and is the same on every loop."""


class Systemd:
    """The other end: a datagram socket, and what came in, with the time of it."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(f"\0{address[1:]}" if address.startswith("@") else address)
        self.socket.settimeout(10.0)

    def receive(self) -> list[str]:
        """The next message; waits."""
        return self.socket.recv(4096).decode().split("\n")

    def all(self) -> list[str]:
        """What there is now."""
        self.socket.setblocking(False)
        found: list[str] = []
        try:
            while True:
                found += self.receive()
        except BlockingIOError:
            self.socket.settimeout(10.0)
            return found


@pytest.fixture
def systemd(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Systemd]:
    """At a path, or at an abstract address where a test asks for that."""
    abstract = getattr(request, "param", "path") == "abstract"
    address = f"@aiorts-test-{os.getpid()}-{time.time_ns()}" if abstract else str(tmp_path / "notify")
    other_end = Systemd(address)
    yield other_end
    other_end.socket.close()


class Part(Component):
    """Does as it is told in one hook."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.go = asyncio.Event()
        self.waits = False
        self.released = asyncio.Event()

    async def on_activated(self) -> None:
        await self.go.wait()

    async def on_execute(self) -> None:
        if self.waits:
            await self.released.wait()


@pytest.mark.slow
@pytest.mark.fault("G12")
@pytest.mark.row(17)
@pytest.mark.parametrize("systemd", ["path", "abstract"], indirect=True)
async def test_ready_comes_after_activation_and_stopping_at_the_end(systemd: Systemd) -> None:
    async with Kernel("robot") as kernel:
        part = await kernel.add(Part("part"))
        context = await kernel.start(PeriodicContext(100.0), part)
        assert kernel.notify_systemd(environ={"NOTIFY_SOCKET": systemd.address})
        with pytest.raises(ConfigurationError):
            kernel.notify_systemd(environ={"NOTIFY_SOCKET": systemd.address})
        activating = asyncio.ensure_future(context.activate())
        await asyncio.sleep(0.2)
        before = systemd.all()
        assert "READY=1" not in before
        assert before == ["STATUS=0 of 1 active; starting"]
        part.go.set()
        await activating
        await asyncio.sleep(0.05)
        assert systemd.all() == ["READY=1", "STATUS=1 of 1 active"]
    assert systemd.all() == ["STOPPING=1", "STATUS=robot stops"]


@pytest.mark.slow(kept_by="test_no_two_pings_are_further_apart_than_half_the_time")
@pytest.mark.fault("G12")
async def test_pings_come_in_half_the_time_and_only_while_contexts_get_on(
    systemd: Systemd, caplog: pytest.LogCaptureFixture
) -> None:
    environ = {"NOTIFY_SOCKET": systemd.address, "WATCHDOG_USEC": "300000", "WATCHDOG_PID": str(os.getpid())}
    async with Kernel() as kernel:
        one, two = await kernel.add(Part("one")), await kernel.add(Part("two"))
        one.go.set()
        two.go.set()
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        await kernel.start(EventContext(), two, activate=True)  # idles: nothing is wrong with that
        kernel.notify_systemd(environ=environ)
        systemd.all()
        await asyncio.sleep(1.0)
        assert systemd.all().count("WATCHDOG=1") >= 5
        one.waits = True  # one of two contexts gets stuck
        await asyncio.sleep(0.4)
        systemd.all()
        await asyncio.sleep(0.5)
        assert "WATCHDOG=1" not in systemd.all()
        said = [record for record in caplog.records if "watchdog gets no keep-alive" in record.getMessage()]
        assert len(said) == 1
        assert "one.on_execute" in said[0].getMessage()
        one.released.set()


@pytest.mark.slow(kept_by="observe/test_heartbeats.py::test_each_context_and_component_beats_and_a_stuck_one_says_so")
@ONE_LOOP
async def test_a_thread_that_is_stuck_is_a_context_that_does_not_get_on(systemd: Systemd) -> None:
    class Blocks(Component):
        blocks = True

        def on_execute(self) -> None:
            while self.blocks:
                time.sleep(0.01)

    async with Kernel() as kernel:
        one = await kernel.create(Blocks)
        await kernel.start(ThreadContext(100.0), one, activate=True)
        kernel.notify_systemd(environ={"NOTIFY_SOCKET": systemd.address, "WATCHDOG_USEC": "200000"})
        await asyncio.sleep(0.3)
        systemd.all()
        await asyncio.sleep(0.4)
        assert "WATCHDOG=1" not in systemd.all()
        one.blocks = False
        await asyncio.sleep(0.3)
        assert "WATCHDOG=1" in systemd.all()


@simulated
async def test_what_failed_is_in_the_status_in_one_line(systemd: Systemd, simulated_clock: SimulatedClock) -> None:
    class Fails(Component):
        async def on_execute(self) -> None:
            raise RuntimeError("no\nlink")

    async with Kernel() as kernel:
        await kernel.start(PeriodicContext(100.0), await kernel.create(Fails, "arm"))
        kernel.notify_systemd(environ={"NOTIFY_SOCKET": systemd.address, "WATCHDOG_USEC": "200000"})
        await kernel.components["arm"].context.activate()
        await simulated_clock.advance(0.3)
        said = systemd.all()
        assert "STATUS=0 of 1 active; in error: arm (RuntimeError: no link)" in said
        assert "WATCHDOG=1" in said  # the contexts get on


@pytest.mark.parametrize(
    ("environ", "told", "pings"),
    [
        ({}, False, False),
        ({"NOTIFY_SOCKET": ""}, False, False),
        ({"NOTIFY_SOCKET": "vsock:2:1"}, False, False),
        ({"WATCHDOG_USEC": "100000"}, False, False),
        ({"NOTIFY_SOCKET": None, "WATCHDOG_USEC": "100000"}, True, True),
        ({"NOTIFY_SOCKET": None, "WATCHDOG_USEC": "100000", "WATCHDOG_PID": "1"}, True, False),
        ({"NOTIFY_SOCKET": None, "WATCHDOG_USEC": "soon"}, True, False),
        ({"NOTIFY_SOCKET": None, "WATCHDOG_USEC": "0"}, True, False),
        ({"NOTIFY_SOCKET": "/nowhere/at/all", "WATCHDOG_USEC": "100000"}, True, False),
    ],
)
@simulated
async def test_only_what_the_environment_asks_for(
    environ: dict[str, Any], told: bool, pings: bool, systemd: Systemd, simulated_clock: SimulatedClock
) -> None:
    given = {name: systemd.address if value is None else value for name, value in environ.items()}
    async with Kernel() as kernel:
        assert kernel.notify_systemd(environ=given) is told
        await simulated_clock.advance(0.2)
        assert ("WATCHDOG=1" in systemd.all()) is pings


CHILD = """
import asyncio, sys, time
from aiorts import Component, Kernel, PeriodicContext

class Blocks(Component):
    ran = 0
    async def on_execute(self):
        self.ran += 1
        if self.ran == 60:
            time.sleep(60)

async def main():
    async with Kernel() as kernel:
        assert kernel.notify_systemd()
        await kernel.start(PeriodicContext(50.0), await kernel.create(Blocks), activate=True)
        await kernel.wait_stop_requested()

asyncio.run(main())
"""


@pytest.mark.slow(kept_by="test_no_two_pings_are_further_apart_than_half_the_time")
@pytest.mark.fault("G12")
def test_a_blocked_loop_sends_nothing_and_systemd_would_start_it_again(systemd: Systemd, tmp_path: Path) -> None:
    script = tmp_path / "blocks.py"
    script.write_text(textwrap.dedent(CHILD))
    interval = 0.6
    environ = {**os.environ, "NOTIFY_SOCKET": systemd.address, "WATCHDOG_USEC": str(round(interval * 1e6))}
    environ.pop("WATCHDOG_PID", None)
    with subprocess.Popen([sys.executable, str(script)], env=environ) as process:
        try:
            pings = 0
            ready = False
            systemd.socket.settimeout(20.0)
            while True:
                try:
                    message = systemd.receive()
                except TimeoutError:
                    break  # no sign of life for the whole time: systemd would end it
                ready = ready or "READY=1" in message
                pings += "WATCHDOG=1" in message
                if ready:
                    systemd.socket.settimeout(interval * 4)
            assert ready
            assert pings >= 3
            assert process.poll() is None  # it is alive, and blocked
        finally:
            process.kill()


async def test_nothing_is_left_when_the_kernel_closes_before_it_is_ready(
    systemd: Systemd, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    async with Kernel("robot") as kernel:
        await kernel.start(PeriodicContext(100.0), await kernel.create(Part))
        kernel.notify_systemd(environ={"NOTIFY_SOCKET": systemd.address})
    said = systemd.all()
    assert "READY=1" not in said
    assert "STOPPING=1" in said
    assert not caplog.records


@pytest.mark.fault("G12")
@simulated
async def test_no_two_pings_are_further_apart_than_half_the_time(
    systemd: Systemd, simulated_clock: SimulatedClock
) -> None:
    """On the loop's own time, so to the microsecond."""
    async with Kernel() as kernel:
        part = await kernel.add(Part("part"))
        part.go.set()
        await kernel.start(PeriodicContext(1.0), part, activate=True)
        kernel.notify_systemd(environ={"NOTIFY_SOCKET": systemd.address, "WATCHDOG_USEC": "1000000"})
        pings = []
        for step in range(400):
            if "WATCHDOG=1" in systemd.all():
                pings.append(step * 0.05)
            await simulated_clock.advance(0.05)
        gaps = [later - earlier for earlier, later in itertools.pairwise(pings)]
        assert len(pings) >= 40
        assert max(gaps) <= 0.5 + 1e-9
        part.waits = True
        await simulated_clock.advance(3.0)
        systemd.all()
        await simulated_clock.advance(10.0)
        assert "WATCHDOG=1" not in systemd.all()
