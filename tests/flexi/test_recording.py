"""FlexiLogger records: every sample once and in order, into one file, in every kind of context, started and stopped."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import aiorts_flexi
from aiorts import (
    Component,
    Context,
    EventContext,
    ExternalContext,
    Kernel,
    LifecycleState,
    OutPort,
    PeriodicContext,
    Required,
    ThreadContext,
)
from aiorts.errors import ComponentError, ConfigurationError, ServiceError
from aiorts.testing import simulated
from aiorts.types import Point2D, Pose2D, RangeData, TimedDouble, TimedDoubleSeq, TimedLong, TimedPose2D, TimedString
from aiorts_flexi.recordings.logger import BasicOperations, FlexiLogger
from aiorts_flexi.recordings.recording import Recording
from aiorts_log import RecordingReader, info_of, open_recording
from aiorts_log.text.opening import format_of
from log_parts import read
from logger_parts import active, ending, feeders, metadata, recorder

SECOND = 10**9


class Operator(Component):
    """Starts and stops a recorder."""

    control = Required[BasicOperations]()


@pytest.mark.row(115)
@pytest.mark.row(123)
@simulated
async def test_any_mix_of_ports_and_types_is_recorded_each_sample_once(tmp_path: Path) -> None:
    samples: dict[str, Any] = {
        "input0": TimedDouble(7, 1.5),
        "pose": TimedPose2D(8, Pose2D(Point2D(1.0, 2.0), 3.0)),
        "arm": TimedDoubleSeq(9, [1.0, 2.0]),
        "text": TimedString(10, "\x1b[2Jü"),
        "scan": RangeData(11, ranges=[1.0, 2.0]),
        "bare": 2.5,
    }
    path = tmp_path / "run.mcap"
    types = ("TimedDouble", "TimedPose2D", "TimedDoubleSeq", "TimedString", "RangeData", "float")
    async with Kernel() as kernel:
        logger = await recorder(kernel, path, *types, names=("", "pose", "arm", "text", "scan", "bare"))
        feed = await feeders(kernel, logger)
        assert not path.exists()
        await active(kernel, logger)
        for _ in range(3):
            for name, sample in samples.items():
                await feed[name].write(sample)
            await kernel.sleep(0.5)
    found = read(path)
    assert [(name, record) for name, _, record in found] == list(samples.items()) * 3
    times = [log_time for _, log_time, _ in found]
    assert times == sorted(times)
    assert [after - before for before, after in zip(times[::6], times[6::6], strict=False)] == [SECOND // 2] * 2
    with RecordingReader(path) as reader:
        # Publish time is the sample's own; what has none was published when it came.
        published = [(sample.publish_time, sample.log_time) for sample in reader.samples()][:6]
    assert [tm for tm, _ in published[:5]] == [7, 8, 9, 10, 11]
    assert published[5][0] == published[5][1]


@pytest.mark.slow
@pytest.mark.row(115)
@pytest.mark.fault("D18")
@pytest.mark.parametrize("kind", ["event", "periodic", "external", "thread"])
@simulated
async def test_activated_again_it_goes_on_in_the_same_file_in_every_context(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    made: dict[str, Context] = {
        "event": EventContext(),
        "periodic": PeriodicContext(rate=100.0),
        "external": ExternalContext(),
        "thread": ThreadContext(rate=100.0),
    }
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        feed = await feeders(kernel, logger)
        context: Any = await kernel.start(made[kind], logger)
        for cycle in range(10):
            await context.activate(logger)
            for number in range(5):
                await feed["input0"].write(TimedLong(0, cycle * 5 + number))
            await (context.tick() if kind == "external" else kernel.sleep(0.05))
            await context.deactivate(logger)
            await feed["input0"].write(TimedLong(0, -1))  # nobody records it
            assert [record.data for _, _, record in read(path)] == list(range(cycle * 5 + 5))
        assert logger.last_error is None
    assert [each["segment"] for each in metadata(path)] == list(range(1, 11))
    with RecordingReader(path) as reader:
        assert reader.clean
        assert [each["stored"] for each in reader.endings] == [5] * 10


@pytest.mark.fault("D14")
@simulated
async def test_a_clock_that_is_put_back_does_not_turn_log_time_back(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        clock: Any = kernel.clock
        clock.set_time_ns(10_000 * SECOND)
        logger = await recorder(kernel, path)
        feed = await feeders(kernel, logger)
        context = await active(kernel, logger)
        for number in range(6):
            await feed["input0"].write(TimedLong(0, number))
            await kernel.sleep(1.0)
            if number == 1:
                clock.set_time_ns(6_400 * SECOND)  # an hour back, while it records
            if number == 3:
                clock.set_time_ns(2_800 * SECOND)  # and once more, while it does not
                await context.deactivate(logger)
                await context.activate(logger)
    times = [log_time / SECOND - 10_000 for _, log_time, _ in read(path)]
    assert times[:4] == [0.0, 1.0, 2.0, 3.0]
    assert times[4] >= 3.0
    assert times[5] - times[4] == 1.0


@simulated
async def test_two_activations_in_different_contexts_and_a_stop_of_the_context(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        feed = await feeders(kernel, logger)
        for number, context in enumerate((PeriodicContext(rate=10.0), EventContext())):
            await active(kernel, logger, context)
            await feed["input0"].write(TimedLong(0, number))
            await kernel.sleep(0.5)
            await kernel.stop(context)
    assert [record.data for _, _, record in read(path)] == [0, 1]


@simulated
async def test_several_recorders_in_a_kernel_are_nothing_to_each_other(tmp_path: Path) -> None:
    async with Kernel() as kernel:
        loggers = [await recorder(kernel, tmp_path / f"{number}.mcap") for number in range(3)]
        for number, logger in enumerate(loggers):
            feed = await feeders(kernel, logger)
            await active(kernel, logger)
            await feed["input0"].write(TimedLong(0, number))
        await kernel.sleep(0.1)
    assert [read(tmp_path / f"{number}.mcap")[0][2].data for number in range(3)] == [0, 1, 2]


@simulated
async def test_a_recorder_begins_disabled_with_control_and_records_nothing_of_a_pause(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path, use_control=True)
        feed = await feeders(kernel, logger)
        operator = await kernel.create(Operator)
        await kernel.connect(operator.control, logger.ports["Control"])
        (offered,) = logger.ports["Control"].profile.interfaces
        assert (offered.name, offered.type) == ("BasicOperations", "BasicOperations")
        control = operator.control.proxy
        # At 1 Hz: what comes between two cycles waits in the port when the recorder is told.
        await active(kernel, logger, PeriodicContext(rate=1.0))
        await kernel.sleep(0.1)
        said = []
        for number, ask in enumerate((control.start, control.stop, control.stop, control.start, control.start)):
            await feed["input0"].write(TimedLong(0, number))
            said.append(await ask())
            await feed["input0"].write(TimedLong(0, 10 + number))
        await kernel.sleep(1.0)
    assert said == [True, True, False, True, False]
    assert [record.data for _, _, record in read(path)] == [10, 1, 13, 4, 14]


@simulated
async def test_nobody_starts_a_recorder_that_is_not_active(tmp_path: Path) -> None:
    async with Kernel() as kernel:
        logger = await recorder(kernel, tmp_path / "run.mcap", use_control=True)
        operator = await kernel.create(Operator)
        await kernel.connect(operator.control, logger.ports["Control"])
        await kernel.start(EventContext(), logger)
        with pytest.raises(ServiceError):
            await operator.control.proxy.start()
    assert not (tmp_path / "run.mcap").exists()


@pytest.mark.parametrize("kind", ["event", "periodic", "thread"])
@simulated
async def test_a_pause_by_parameter_leaves_no_stale_sample(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    made: dict[str, Context] = {
        "event": EventContext(),
        "periodic": PeriodicContext(rate=1.0),
        "thread": ThreadContext(rate=1.0),
    }
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        feed = await feeders(kernel, logger)
        await active(kernel, logger, made[kind])
        await kernel.sleep(0.1)
        await feed["input0"].write(TimedLong(0, 1))
        await logger.configure(paused=True)
        await feed["input0"].write(TimedLong(0, 2))
        await logger.configure(paused=False)
        await feed["input0"].write(TimedLong(0, 3))
        await kernel.sleep(2.0)
        assert sum(connector.statistics.delivered for connector in logger.ports["input0"].connectors) == 3
    assert [record.data for _, _, record in read(path)] == [1, 3]


@simulated
async def test_ports_come_and_go_while_it_records(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path)
        first = (await feeders(kernel, logger))["input0"]
        await active(kernel, logger)
        await first.write(TimedLong(0, 1))
        await kernel.sleep(0.1)
        await logger.configure(inputs=("TimedLong", "TimedDouble"))
        second = (await kernel.create(Component)).add_port("out", OutPort(TimedDouble))
        await kernel.connect(second, logger.ports["input1"])
        await first.write(TimedLong(0, 2))
        await second.write(TimedDouble(0, 0.5))
        await kernel.sleep(0.1)
        with pytest.raises(ConfigurationError, match="is recorded as TimedDouble"):
            await logger.configure(inputs=("TimedLong", "TimedString"))
        await logger.configure(inputs=("TimedLong",))
        await first.write(TimedLong(0, 3))
        await kernel.sleep(0.1)
        await logger.configure(inputs=("TimedLong", "TimedDouble"))
        await kernel.connect(second, logger.ports["input1"])
        await second.write(TimedDouble(0, 1.5))
        await kernel.sleep(0.1)
        assert logger.last_error is None
    found = [(name, record.data) for name, _, record in read(path)]
    assert found == [("input0", 1), ("input0", 2), ("input1", 0.5), ("input0", 3), ("input1", 1.5)]


@simulated
async def test_the_system_is_told_in_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel("robot") as kernel:
        kernel.origin = 'schema = 1\n[components.log]\ntype = "FlexiLogger"\n'
        logger = await recorder(kernel, path, "TimedLong")
        await feeders(kernel, logger)
        await active(kernel, logger)
    (said,) = metadata(path)
    assert (said["kernel"], said["recorder"], said["segment"]) == ("robot", "flexilogger0", 1)
    assert said["components"]["flexilogger0"]["type"] == "FlexiLogger"
    assert said["components"]["flexilogger0"]["params"]["inputs"] == ["TimedLong"]
    assert said["connections"][0]["to"] == "flexilogger0.input0"
    with RecordingReader(path) as reader:
        files = {each.name: each.data.decode() for each in reader.attachments()}
    assert files["system.toml"].startswith("schema = 1\n[components.log]")


@pytest.mark.parametrize("form", ["mcap", "json", "text"])
@simulated
async def test_forms_of_a_recording(form: str, tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    params = {"mcap": {}, "json": {"encoding": "json"}, "text": {"text": True}}[form]
    async with Kernel() as kernel:
        logger = await recorder(kernel, path, **params)
        feed = await feeders(kernel, logger)
        context = await active(kernel, logger)
        for number in range(2):
            await feed["input0"].write(TimedLong(5, number))
            await kernel.sleep(0.1)
            await context.deactivate(logger)
            await context.activate(logger)
    assert format_of(path) == ("text" if form == "text" else "mcap")
    with open_recording(path) as reader:
        assert [record for _, _, record in reader.records()] == [TimedLong(5, 0), TimedLong(5, 1)]
        if form != "text":
            assert isinstance(reader, RecordingReader)
            assert {sample.encoding for sample in reader.ports.values()} == {"json" if form == "json" else "msgpack"}


@simulated
async def test_files_of_a_size_or_a_time_and_a_later_activation_goes_on_in_the_last(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        logger = await recorder(kernel, path, rotate_time=1.0, flush_age=0.001, chunk=1)
        feed = await feeders(kernel, logger)
        context = await active(kernel, logger)
        for number in range(6):
            await feed["input0"].write(TimedLong(0, number))
            await kernel.sleep(0.5)
            if number == 3:
                await context.deactivate(logger)
                await context.activate(logger)
    names = sorted(each.name for each in tmp_path.iterdir())
    assert names == ["run.1.mcap", "run.mcap"] or names == ["run.1.mcap", "run.2.mcap", "run.mcap"]
    found = [record.data for name in ("run.mcap", *names[:-1]) for _, _, record in read(tmp_path / name)]
    assert found == list(range(6))


@simulated
async def test_a_file_that_is_there_is_refused_before_anything_runs(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("the only copy")
    async with Kernel() as kernel:
        with pytest.raises(ConfigurationError, match="--append continues it, --overwrite replaces it"):
            await recorder(kernel, path)
        logger = await recorder(kernel, path, existing="overwrite")
        assert path.read_text() == "the only copy"  # a recorder that was created has done nothing to it
        await active(kernel, logger)
    assert read(path) == []


@pytest.mark.parametrize("where", ["no/such/folder/run.mcap", "folder", "link.mcap", "", "pipe"])
@simulated
async def test_what_cannot_be_a_recording_is_refused_before_anything_runs(where: str, tmp_path: Path) -> None:
    import os

    (tmp_path / "folder").mkdir()
    (tmp_path / "link.mcap").symlink_to(tmp_path / "target.mcap")
    os.mkfifo(tmp_path / "pipe")
    async with Kernel() as kernel:
        for existing in ("refuse", "append", "overwrite"):
            with pytest.raises(ConfigurationError, match="logfile"):
                await kernel.create(
                    FlexiLogger,
                    inputs=("TimedLong",),
                    logfile=str(tmp_path / where) if where else "",
                    existing=existing,
                )
    assert not (tmp_path / "target.mcap").exists()


@pytest.fixture
def same_code() -> Iterator[None]:
    """Other tests find the classes that they have imported."""
    module = sys.modules["aiorts_flexi.recordings.logger"]
    yield
    sys.modules["aiorts_flexi.recordings.logger"] = module
    aiorts_flexi.recordings.logger = module  # type: ignore[attr-defined]


@pytest.mark.usefixtures("same_code")
@simulated
async def test_its_code_is_replaced_while_it_records(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        old = await recorder(kernel, path)
        feed = await feeders(kernel, old)
        await active(kernel, old)
        await feed["input0"].write(TimedLong(0, 1))
        await kernel.sleep(0.1)
        await kernel.reload("FlexiLogger")
        new: Any = kernel.components[old.name]
        assert new is not old
        for number in (2, 3):
            await feed["input0"].write(TimedLong(0, number))
            await kernel.sleep(0.1)
        await new.configure(paused=True)
        await feed["input0"].write(TimedLong(0, 4))
        await kernel.sleep(2.0)
        assert (new.state, new.last_error) == (LifecycleState.ACTIVE, None)
    assert [record.data for _, _, record in read(path)] == [1, 2, 3]
    assert len(metadata(path)) == 1
    assert ending(path)["stored"] == 3


@pytest.mark.usefixtures("same_code")
@simulated
async def test_new_code_that_fails_gives_the_recording_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        old = await recorder(kernel, path)
        feed = await feeders(kernel, old)
        await active(kernel, old)
        await feed["input0"].write(TimedLong(0, 1))
        await kernel.sleep(0.1)
        execute = Recording.execute

        def failing(self: Recording) -> None:
            if self._logger is not old:
                raise RuntimeError("new")
            execute(self)

        monkeypatch.setattr(Recording, "execute", failing)
        reloading = asyncio.ensure_future(kernel.reload("FlexiLogger"))
        for number in (2, 3, 4):
            await kernel.sleep(0.1)
            await feed["input0"].write(TimedLong(0, number))
        with pytest.raises(ComponentError, match="the old code is in force again"):
            await reloading
        await kernel.sleep(0.1)
        assert kernel.components[old.name] is old
        await feed["input0"].write(TimedLong(0, 5))
        await kernel.sleep(0.1)
        assert old.last_error is None
    assert [record.data for _, _, record in read(path)] == [1, 2, 3, 4, 5]


@pytest.mark.fault("B17")
@simulated
async def test_what_lay_unread_when_it_was_deactivated_is_told_and_in_the_file(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        logger = await recorder(kernel, tmp_path / "run.mcap")
        feed = (await feeders(kernel, logger))["input0"]
        context = await active(kernel, logger, PeriodicContext(rate=1.0))
        await kernel.sleep(1.5)
        for number in range(7):
            feed.write_nowait(TimedLong(0, number))
        await context.deactivate(logger)
        await logger.wait_closed()
    assert "samples were not recorded: 7 of " in caplog.text
    with open_recording(tmp_path / "run.mcap") as reader:
        assert list(info_of(reader).dropped.values()) == [7]


@pytest.mark.parametrize(
    ("params", "named"),
    [
        ({"speed": 2.0}, "speed (--speed): does nothing unless mode = 'replay'"),
        ({"mode": "replay", "existing": "append"}, "existing (--append): does nothing unless mode = 'record'"),
    ],
)
@simulated
async def test_a_parameter_of_the_other_mode_is_refused(params: dict[str, Any], named: str, tmp_path: Path) -> None:
    async with Kernel() as kernel:
        with pytest.raises(ConfigurationError) as refused:
            await kernel.create(FlexiLogger, inputs=["TimedLong"], logfile=tmp_path / "run.mcap", **params)
    assert named in str(refused.value)


@simulated
async def test_with_control_that_nothing_is_connected_to_it_says_why_it_stands_still(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        await active(kernel, await recorder(kernel, tmp_path / "run.mcap", use_control=True))
    assert caplog.text.count("stands still until Control.start() is called") == 1
