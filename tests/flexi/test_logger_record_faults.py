"""FlexiLogger in trouble: bursts, disks that are slow, full or broken, files that vanish, too large samples."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import os
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, Context, EventContext, Kernel, LifecycleState, PeriodicContext, ThreadContext
from aiorts.errors import ComponentError
from aiorts.kernel.ports.connector import unread_of
from aiorts.testing import simulated
from aiorts.types import TimedLong, TimedOctetSeq
from aiorts_flexi.recordings import recording
from aiorts_flexi.recordings.recording import Recording
from aiorts_log import RecordingError, RecordingReader, RecordingWriter, info_of
from aiorts_log.mcap.locked_file import LockedFile
from campaign import CAMPAIGN
from log_parts import make, read
from logger_parts import active, closed, ending, feeders, recorder, until, until_error

BURST = 100_000


@pytest.fixture(params=["asyncio", "uvloop"] if CAMPAIGN else ["asyncio"])
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, bool]]:
    return "asyncio", {"use_uvloop": request.param == "uvloop"}


def disk(monkeypatch: pytest.MonkeyPatch, kind: type[LockedFile]) -> None:
    """Every recorder writes to such a disk from now on."""
    monkeypatch.setattr(Recording, "make_writer", partial(RecordingWriter, kind=kind))


def told(caplog: pytest.LogCaptureFixture, level: int) -> list[str]:
    """What components have logged at this level."""
    return [each.getMessage() for each in caplog.records if each.levelno == level]


class Ticker(Component):
    """Notes when it ran."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.ticks: list[float] = []

    def on_execute(self) -> None:
        self.ticks.append(time.perf_counter())

    @property
    def longest(self) -> float:
        """The longest time between two of its cycles in seconds."""
        return max(after - before for before, after in zip(self.ticks, self.ticks[1:], strict=False))


@asynccontextmanager
async def ticking() -> AsyncIterator[tuple[Kernel, Ticker]]:
    """A kernel with a component that shows whether the loop is held up."""
    async with Kernel() as kernel:
        ticker = await kernel.create(Ticker)
        await kernel.start(PeriodicContext(rate=200.0), ticker, activate=True)
        yield kernel, ticker


# -- bursts ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_what_was_lost_on_the_way_to_the_recorder_is_in_the_file_and_told_once")
@pytest.mark.fault("B17")
@pytest.mark.row(115)
@pytest.mark.parametrize("kind", ["event", "periodic", "thread"])
@pytest.mark.anyio
async def test_every_sample_of_a_burst_in_one_tick_is_recorded(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, longest, execute = tmp_path / "run.mcap", 0.0, Recording.execute

    def timed(self: Recording) -> None:
        nonlocal longest
        gc.disable()  # what other tests have left is not this work
        begin = time.thread_time()  # work, whatever else the machine does
        execute(self)
        longest = max(longest, time.thread_time() - begin)
        gc.enable()

    monkeypatch.setattr(Recording, "execute", timed)
    count = BURST if kind == "periodic" or CAMPAIGN else BURST // 5
    made: dict[str, Context] = {
        "event": EventContext(),
        "periodic": PeriodicContext(rate=20.0),
        "thread": ThreadContext(rate=20.0),
    }
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        feed = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger, made[kind])
        await kernel.sleep(0.1)
        samples = [TimedLong(0, number) for number in range(count)]
        for sample in samples:
            feed.write_nowait(sample)
        await kernel.sleep(0.1)
        for number in range(100):  # while most of the burst is still on its way to the file
            feed.write_nowait(TimedLong(0, count + number))
        await until(lambda: not any(unread_of(connector) for connector in logger.ports["input0"].connectors))
        await closed(logger)
        assert longest < 0.05  # to hand on 100,000 one by one is 0.1 s of work and more
    assert [record.data for _, _, record in read(path)] == list(range(count + 100))
    assert ending(path)["dropped"] == {}


class Stuck(LockedFile):
    """A disk that stands still for a while."""

    def put(self, parts: list[memoryview]) -> int:
        if self.size > 2000:
            time.sleep(0.3)
        return super().put(parts)


@pytest.mark.slow(kept_by="test_what_was_lost_on_the_way_to_the_recorder_is_in_the_file_and_told_once")
@pytest.mark.fault("B17")
@pytest.mark.fault("D05")
@pytest.mark.anyio
async def test_what_of_a_burst_finds_no_room_is_counted_and_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.mcap"
    disk(monkeypatch, Stuck)
    async with ticking() as (kernel, _):
        logger = await recorder(kernel, path, queue=5000, chunk=400_000)
        feed = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger)
        for burst in range(2):
            for number in range(10_000):
                feed.write_nowait(TimedLong(0, burst * 10_000 + number))
            await kernel.sleep(0.4)
        await closed(logger)
    stored, said = [record.data for _, _, record in read(path)], ending(path)
    dropped = said["dropped"]["input0"]
    assert len(stored) + dropped == 20_000
    assert dropped > 0
    assert stored == sorted(set(stored))
    (warning,) = told(caplog, logging.WARNING)
    assert "samples are dropped" in warning
    (error,) = told(caplog, logging.ERROR)
    assert f"is not complete: {dropped} samples" in error


@pytest.mark.fault("B17")
@simulated
async def test_what_was_lost_on_the_way_to_the_recorder_is_in_the_file_and_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        feed = (await feeders(kernel, logger, length=8))["input0"]
        context = await active(kernel, logger, PeriodicContext(rate=1.0))
        await kernel.sleep(0.1)
        for number in range(1000):
            feed.write_nowait(TimedLong(0, number))
        await kernel.sleep(1.0)
        await context.deactivate(logger)
        found = ending(path)
        await context.activate(logger)
        feed.write_nowait(TimedLong(0, 1000))
        await kernel.sleep(1.0)
    assert [record.data for _, _, record in read(path)] == list(range(992, 1001))
    assert "dropped_before" not in ending(path)  # nothing was lost of the second segment
    ((name, lost),) = found["dropped_before"].items()
    assert lost == {"overwritten": 992}
    with RecordingReader(path) as reader:
        assert info_of(reader).dropped == {f"{name} (overwritten)": 992}
    (warning,) = told(caplog, logging.WARNING)
    assert f"992 of {name}" in warning
    (error,) = told(caplog, logging.ERROR)  # also of a segment that has ended long ago
    assert "is not complete: 992 samples" in error


@simulated
async def test_time_that_is_simulated_does_not_run_away_from_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path, queue=10)
        feed = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger)
        for burst in range(20):
            for number in range(100):
                feed.write_nowait(TimedLong(0, burst * 100 + number))
            await kernel.sleep(1.0)
    assert [record.data for _, _, record in read(path)] == list(range(2000))


@pytest.mark.slow(kept_by="test_time_that_is_simulated_does_not_run_away_from_the_disk")
@pytest.mark.anyio
async def test_a_writer_that_may_wait_waits_for_the_disk_and_nothing_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Back-pressure goes all the way, as through every filter."""
    path = tmp_path / "run.mcap"
    disk(monkeypatch, Stuck)
    async with ticking() as (kernel, ticker):
        logger = await recorder(kernel, path, queue=100, chunk=4000)
        feed = (await feeders(kernel, logger, full="block", timeout=None, length=50))["input0"]
        await active(kernel, logger)
        for number in range(300):
            await feed.write(TimedLong(0, number))
        await until(lambda: not any(unread_of(connector) for connector in logger.ports["input0"].connectors))
        assert ticker.longest < 0.25
    assert [record.data for _, _, record in read(path)] == list(range(300))


# -- disks -------------------------------------------------------------------------------------------------------------


class Failing(LockedFile):
    """A disk that takes so many bytes and no more."""

    left = 20_000
    error = 28

    def put(self, parts: list[memoryview]) -> int:
        if self.left <= 0:
            raise OSError(self.error, os.strerror(self.error))
        taken = super().put([parts[0][: self.left]])
        self.left -= taken
        return taken


class Broken(Failing):
    """The same with EIO."""

    error = 5


@pytest.mark.slow(kept_by="log/test_writer.py::test_a_disk_that_fails_ends_the_recording_and_leaves_it_valid")
@pytest.mark.row(115)
@pytest.mark.fault("D03")
@pytest.mark.fault("D04")
@pytest.mark.parametrize("kind", [Failing, Broken])
@pytest.mark.parametrize("where", ["event", "periodic", "thread"])
@pytest.mark.anyio
async def test_a_disk_that_fails_stops_the_recording_with_one_error_and_nobody_else(
    where: str,
    kind: type[LockedFile],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    path = tmp_path / "run.mcap"
    disk(monkeypatch, kind)
    made: dict[str, Context] = {
        "event": EventContext(),
        "periodic": PeriodicContext(rate=100.0),
        "thread": ThreadContext(rate=100.0),
    }
    async with ticking() as (kernel, ticker):
        logger = await recorder(kernel, path, chunk=4096)
        feed = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger, made[where])
        for number in range(3000):
            feed.write_nowait(TimedLong(0, number))
        error = await until_error(logger)  # no data come any more: an event context is told, too
        assert isinstance(error, RecordingError)
        assert "samples up to there are whole" in str(error)
        count = len(ticker.ticks)
        await kernel.sleep(0.1)
        assert len(ticker.ticks) > count
        assert ticker.state is LifecycleState.ACTIVE
    stored = [record.data for _, _, record in read(path)]
    assert stored == list(range(len(stored)))
    assert 0 < len(stored) < 3000
    assert len(told(caplog, logging.ERROR)) == 1


@pytest.mark.slow(kept_by="log/test_writer.py::test_a_disk_that_cannot_promise_is_believed_no_more")
@pytest.mark.fault("D03")
@pytest.mark.anyio
async def test_what_fails_when_the_file_is_closed_is_told_once_and_there_is_room_for_another_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.mcap"
    monkeypatch.setattr(Failing, "left", 3000)
    disk(monkeypatch, Failing)
    async with Kernel() as kernel:
        logger = await recorder(kernel, path, flush_age=100.0)
        feed = (await feeders(kernel, logger))["input0"]
        context = await active(kernel, logger)
        for number in range(500):
            feed.write_nowait(TimedLong(0, number))
        await kernel.sleep(0.05)
        await context.deactivate(logger)
        await until(lambda: told(caplog, logging.ERROR))
        assert logger.state is LifecycleState.INACTIVE
        disk(monkeypatch, LockedFile)
        await context.activate(logger)
        feed.write_nowait(TimedLong(0, -1))
        await kernel.sleep(0.05)
        assert logger.last_error is None
    assert [record.data for _, _, record in read(path)] == [-1]
    assert len(told(caplog, logging.ERROR)) == 1


@pytest.mark.fault("D03")
@pytest.mark.anyio
async def test_too_little_free_space_is_an_error_of_the_activation(tmp_path: Path) -> None:
    free = os.statvfs(tmp_path)
    async with Kernel() as kernel:
        logger = await recorder(kernel, tmp_path / "run.mcap", min_free=free.f_bavail * free.f_frsize / 1e6 + 10_000)
        context = await kernel.start(EventContext(), logger)
        with contextlib.suppress(ComponentError):  # on a slow machine it is told a little later
            await context.activate(logger)
        assert "--min-free" in str(await until_error(logger))
        assert list(tmp_path.iterdir()) == []  # nothing is left that a second try would refuse
        await context.reset(logger)
        await logger.configure(min_free=0.0)
        await context.activate(logger)
    assert read(tmp_path / "run.mcap") == []


@pytest.mark.fault("D17")
@pytest.mark.parametrize("when", ["before", "in that very moment"])
@pytest.mark.anyio
async def test_a_file_that_somebody_else_made_meanwhile_is_never_taken_for_its_own(
    when: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        context = await kernel.start(EventContext(), logger)
        make(path, 5)
        raw = path.read_bytes()
        if when != "before":
            monkeypatch.setattr(recording, "check_target", lambda path, existing: None)
        for _ in range(3):
            with contextlib.suppress(ComponentError):  # on a slow machine it is told a little later
                await context.activate(logger)
            assert "exists already" in str(await until_error(logger))
            await context.reset(logger)
    assert path.read_bytes() == raw


class Slow(LockedFile):
    """A disk that takes half a second for each piece, also for the first."""

    def put(self, parts: list[memoryview]) -> int:
        time.sleep(0.5)
        return super().put(parts)


class SlowToBegin(LockedFile):
    """A disk that sleeps when it is asked first."""

    def put(self, parts: list[memoryview]) -> int:
        if not self.size:
            time.sleep(0.5)
        return super().put(parts)


@pytest.mark.slow
@pytest.mark.fault("D05")
@pytest.mark.anyio
async def test_a_slow_disk_holds_up_neither_loop_nor_activation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    disk(monkeypatch, Slow)
    async with ticking() as (kernel, ticker):
        logger = await recorder(kernel, path, queue=100)
        feed = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger)
        for number in range(300):
            feed.write_nowait(TimedLong(0, number))
            await asyncio.sleep(0)
        await kernel.sleep(0.1)
        await closed(logger)
        await kernel.sleep(0.05)
        assert ticker.longest < 0.25
    stored = [record.data for _, _, record in read(path)]
    assert stored == list(range(len(stored)))
    assert len(stored) + sum(ending(path)["dropped"].values()) == 300
    assert 0 < len(stored) < 300


@pytest.mark.slow
@pytest.mark.fault("D05")
@pytest.mark.anyio
async def test_what_waits_for_the_disk_is_bounded_in_bytes_as_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    disk(monkeypatch, SlowToBegin)
    async with Kernel() as kernel:
        logger = await recorder(kernel, path, "TimedOctetSeq")
        feed = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger, PeriodicContext(rate=50.0))
        large = TimedOctetSeq(0, bytes(2**20))
        for _ in range(3):
            for _ in range(30):
                feed.write_nowait(large)
            await kernel.sleep(0.03)
        await kernel.sleep(0.03)
        waiting = logger.role._session.load  # type: ignore[attr-defined]
        await closed(logger)
    with RecordingReader(path) as reader:
        assert waiting <= 1.0
        assert 30 <= reader.count <= 64
        assert reader.count + reader.endings[-1]["dropped"]["input0"] == 90


@pytest.mark.slow
@pytest.mark.fault("D19")
@pytest.mark.parametrize("what", ["deleted", "renamed", "replaced"])
@pytest.mark.anyio
async def test_a_file_that_vanishes_while_it_is_recorded_is_told_once(
    what: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        feed = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger)
        await feed.write(TimedLong(0, 1))
        await until(lambda: path.exists() and path.stat().st_size > 1000)
        if what == "deleted":
            path.unlink()
        else:
            path.rename(tmp_path / "elsewhere.mcap")
            if what == "replaced":
                path.write_text("another")
        await until(lambda: told(caplog, logging.WARNING), 5.0)
        await kernel.sleep(0.6)
        assert logger.state is LifecycleState.ACTIVE
        await feed.write(TimedLong(0, 2))
    (warning,) = told(caplog, logging.WARNING)
    assert "run.mcap" in warning
    if what != "deleted":
        assert [record.data for _, _, record in read(tmp_path / "elsewhere.mcap")] == [1, 2]


# -- samples -----------------------------------------------------------------------------------------------------------


@pytest.mark.fault("G02")
@pytest.mark.anyio
async def test_a_sample_for_which_there_is_no_memory_is_refused_and_the_recorder_lives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"

    class Poor(RecordingWriter):
        """Has no memory for large samples."""

        @staticmethod
        def encoder(encoding: Any, cls: type) -> Any:
            encode = RecordingWriter.encoder(encoding, cls)

            def poorly(record: Any) -> bytes:
                if len(record.data) > 100:
                    raise MemoryError
                return encode(record)

            return poorly

    monkeypatch.setattr(Recording, "make_writer", Poor)
    async with Kernel() as kernel:
        logger = await recorder(kernel, path, "TimedOctetSeq")
        feed = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger)
        for number in range(10):
            await feed.write(TimedOctetSeq(number, b"x" * (1000 if number % 2 else 10)))
        await kernel.sleep(0.05)
        assert logger.last_error is None
    assert [record.tm for _, _, record in read(path)] == [0, 2, 4, 6, 8]
    assert ending(path)["refused"] == {"input0": 5}
