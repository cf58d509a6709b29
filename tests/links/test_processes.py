"""Links between real processes: one is stopped, or killed, and what becomes of the samples is known."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from anyio import fail_after, sleep

from aiorts import Component, InPort, Kernel
from aiorts.types import TimedOctetSeq
from campaign import cases

pytestmark = pytest.mark.anyio
WRITER = Path(__file__).with_name("link_writer.py")


class Sink(Component):
    inp = InPort(TimedOctetSeq)


@pytest.fixture(autouse=True)
def _folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    with TemporaryDirectory(prefix="al") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield Path(folder)


@pytest.fixture
def writer() -> Iterator[Callable[[int, int], subprocess.Popen[str]]]:
    started = []

    def start(count: int, size: int) -> subprocess.Popen[str]:
        command = [sys.executable, str(WRITER), "reader", str(count), str(size)]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait(10)
        if process.stdout is not None:
            process.stdout.close()


async def read(sink: Sink, count: int, *, seconds: float) -> list[int]:
    """The numbers of so many samples."""
    numbers: list[int] = []
    with fail_after(seconds):
        while len(numbers) < count:
            numbers.append((await sink.inp.read()).tm)
    return numbers


@pytest.mark.fault("E06")
async def test_a_writer_that_is_stopped_and_goes_on_loses_nothing(
    writer: Callable[[int, int], subprocess.Popen[str]],
) -> None:
    count, pause = (20_000, 8.0) if cases(100) == 100 else (2_000, 1.5)
    async with Kernel("reader", services={"links": {}}) as kernel:
        sink = await kernel.add(Sink())
        process = writer(count, 4_096)
        numbers = await read(sink, count // 4, seconds=60)
        os.kill(process.pid, signal.SIGSTOP)
        await sleep(pause)
        os.kill(process.pid, signal.SIGCONT)
        numbers += await read(sink, count - len(numbers), seconds=60)
        assert numbers == list(range(count))
        out, _ = await asyncio.to_thread(process.communicate, timeout=20)
        assert out.split()[:2] == [str(count), str(count)]


async def test_a_reader_that_stands_still_does_not_hold_the_writers_loop(
    writer: Callable[[int, int], subprocess.Popen[str]],
) -> None:
    count, pause = (20_000, 8.0) if cases(100) == 100 else (2_000, 1.5)
    async with Kernel("reader", services={"links": {}}) as kernel:
        sink = await kernel.add(Sink())
        process = writer(count, 4_096)
        numbers = await read(sink, count // 4, seconds=60)
        import time

        time.sleep(pause)
        numbers += await read(sink, count - len(numbers), seconds=60)
        assert numbers == list(range(count))
        out, _ = await asyncio.to_thread(process.communicate, timeout=20)
        *_, worst = out.split()
        assert float(worst) < pause / 2


@pytest.mark.fault("E01")
async def test_a_writer_that_is_killed_leaves_what_it_sent_in_order_and_the_next_begins_anew(
    writer: Callable[[int, int], subprocess.Popen[str]],
) -> None:
    async with Kernel("reader", services={"links": {}}) as kernel:
        sink = await kernel.add(Sink())
        for kill in range(cases(200) // 2 or 1):
            process = writer(100_000, 64)
            numbers = await read(sink, 200 + 7 * kill, seconds=60)
            process.kill()
            await asyncio.to_thread(process.wait, 10)
            with fail_after(10):
                while (await _up(kernel)) or sink.inp.is_new:
                    numbers += [sample.tm for sample in sink.inp.drain()]
                    await sleep(0.005)
            assert numbers == list(range(len(numbers)))
            (connector,) = kernel.connectors.values()
            assert connector.statistics.balanced


async def _up(kernel: Kernel) -> bool:
    from aiorts.links import Links

    return any(one == "up" for one in kernel.service(Links).report().values())
