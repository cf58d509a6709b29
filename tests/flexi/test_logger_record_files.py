"""FlexiLogger: which file samples go into, over activations, contexts, other recordings beside it, and other types."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts import EventContext, Kernel, PeriodicContext
from aiorts.errors import ConfigurationError
from aiorts.testing import simulated
from aiorts.types import TimedDouble, TimedLong
from aiorts_log import RecordingOptions, RecordingWriter
from log_parts import read
from logger_parts import active, feeders, recorder


def recorded(path: Path) -> list[float]:
    """The values in a recording."""
    return [record.data for _, _, record in read(path)]


def other_recording(path: Path, *values: int, **options: int) -> None:
    """A recording of somebody else's."""
    with RecordingWriter(path, RecordingOptions(min_free=0, **options)) as writer:  # type: ignore[arg-type]
        port = writer.add_port("input0", TimedLong)
        for value in values:
            writer.write(port, TimedLong(0, value), value)


@simulated
async def test_in_two_contexts_it_records_once_and_as_long_as_it_is_active_in_one(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        feed = (await feeders(kernel, logger))["input0"]
        first = await active(kernel, logger, EventContext())
        await active(kernel, logger, PeriodicContext(rate=50.0))
        for number in range(3):
            await feed.write(TimedLong(0, number))
            await kernel.sleep(0.1)
            if number == 1:
                await first.deactivate(logger)
    assert recorded(path) == [0, 1, 2]


@simulated
async def test_activated_again_it_goes_on_in_its_own_file_whatever_lies_beside_it(tmp_path: Path) -> None:
    other_recording(tmp_path / "run.1.mcap", 77)
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        feed = (await feeders(kernel, logger))["input0"]
        context = await active(kernel, logger)
        for number in range(2):
            await feed.write(TimedLong(0, number))
            await kernel.sleep(0.1)
            await context.deactivate(logger)
            await context.activate(logger)
    assert recorded(path) == [0, 1]
    assert recorded(tmp_path / "run.1.mcap") == [77]


@simulated
async def test_a_recording_in_several_files_is_continued_in_the_last(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    other_recording(path, *range(200), max_bytes=4096, chunk=4096)
    parts = sorted(tmp_path.iterdir(), key=lambda one: one.stat().st_mtime_ns)
    assert len(parts) > 2
    before = {one: one.read_bytes() for one in parts[:-1]}
    async with Kernel() as kernel:
        logger = await recorder(kernel, path, existing="append")
        feed = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger)
        await feed.write(TimedLong(0, 200))
        await kernel.sleep(0.1)
    assert {one: one.read_bytes() for one in parts[:-1]} == before
    assert recorded(parts[-1])[-1] == 200


@simulated
async def test_a_recording_in_several_files_does_not_begin_among_those_of_another(tmp_path: Path) -> None:
    other_recording(tmp_path / "run.1.mcap", 77)
    async with Kernel() as kernel:
        with pytest.raises(ConfigurationError, match=r"run\.1\.mcap: exists already"):
            await recorder(kernel, tmp_path / "run.mcap", rotate_time=1.0)


@simulated
async def test_deactivated_it_takes_other_types_and_tells_what_it_recorded_of_both(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        context = await active(kernel, logger)
        await (await feeders(kernel, logger))["input0"].write(TimedLong(0, 1))
        await kernel.sleep(0.1)
        await context.deactivate(logger)
        await logger.configure(inputs=("TimedDouble",))
        await context.activate(logger)
        await (await feeders(kernel, logger))["input0"].write(TimedDouble(0, 0.5))
        await kernel.sleep(0.1)
    assert recorded(path) == [1, 0.5]
