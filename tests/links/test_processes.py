"""Links between real processes: one is stopped, or killed, and what becomes of the samples is known."""

from __future__ import annotations

import asyncio
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

import pytest
from anyio import fail_after, sleep

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.types import TimedOctetSeq
from campaign import cases

pytestmark = pytest.mark.anyio
WRITER = Path(__file__).with_name("link_writer.py")


class Source(Component):
    out = OutPort(TimedOctetSeq)


class Sink(Component):
    inp = InPort(TimedOctetSeq)


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


@pytest.mark.slow(kept_by="links/test_protocol.py::test_a_reader_without_room_stops_the_writer_and_loses_nothing")
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


@pytest.mark.slow(kept_by="links/test_protocol.py::test_a_reader_without_room_stops_the_writer_and_loses_nothing")
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


@pytest.mark.slow(kept_by="links/test_kernels.py::test_a_kernel_that_is_started_anew_goes_on_with_the_loss_counted")
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


@pytest.mark.slow(kept_by="links/test_kernels.py::test_a_kernel_that_is_started_anew_goes_on_with_the_loss_counted")
@pytest.mark.fault("E01")
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
async def test_a_reader_that_is_killed_is_counted_to_the_sample(tmp_path: Path, loop: str) -> None:
    kills, random = cases(100) // 2 or 2, Random(5)
    file = tmp_path / "numbers"
    command = [sys.executable, str(Path(__file__).with_name("link_reader.py")), str(file), loop]
    process = await asyncio.to_thread(subprocess.Popen, command)
    try:
        async with Kernel("writer") as kernel:
            source = await kernel.add(Source("source"))
            connector = await kernel.connect(source.out, "reader/sink.inp", full="block", timeout=None, length=64)
            written = 0

            async def write() -> None:
                nonlocal written
                while True:
                    await source.out.write(TimedOctetSeq(tm=written, data=b"x" * 64))
                    written += 1

            writing = asyncio.ensure_future(write())
            for _ in range(kills):
                acknowledged = connector.statistics.acknowledged
                with fail_after(20):
                    while connector.statistics.acknowledged <= acknowledged:
                        await sleep(0.01)
                await sleep(random.uniform(0, 0.2))
                process.kill()
                await asyncio.to_thread(process.wait, 10)
                process = await asyncio.to_thread(subprocess.Popen, command)
            acknowledged = connector.statistics.acknowledged
            with fail_after(20):
                while connector.statistics.acknowledged <= acknowledged:
                    await sleep(0.01)
                writing.cancel()
                while connector.statistics.in_flight or connector.statistics.buffered:
                    await sleep(0.01)
            ledger = connector.statistics
            assert ledger.balanced
            assert set(ledger.dropped) <= {"unknown_fate"}
            unknown = ledger.dropped.get("unknown_fate", 0)
            assert ledger.acknowledged + unknown == ledger.written
            process.kill()
            await asyncio.to_thread(process.wait, 10)
    finally:
        process.kill()
        await asyncio.to_thread(process.wait, 10)
    numbers = [number for (number,) in struct.iter_unpack("<Q", file.read_bytes()[: file.stat().st_size // 8 * 8])]
    assert numbers == sorted(set(numbers))
    # Acknowledged is what is in the reader's buffer: at each kill at most that much is lost besides.
    missing = ledger.written - len(numbers)
    assert 0 <= missing <= unknown + 64 * (kills + 1)


async def _up(kernel: Kernel) -> bool:
    from aiorts.links import Links

    return any(one == "up" for one in kernel.service(Links).report().values())
