"""FlexiLogger replays: the ports of a file, when its samples leave, how that is steered, and how it ends."""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from aiorts import (
    Component,
    EventContext,
    InPort,
    Kernel,
    LifecycleState,
    PeriodicContext,
    Required,
    SimulatedClock,
    ThreadContext,
)
from aiorts.errors import ConfigurationError, InvalidNameError, StateError, WiringError, WriteTimeout
from aiorts.testing import simulate, simulated
from aiorts.types import TimedDouble, TimedLong, TimedString, record, wire_name
from aiorts.types.registry import _by_full_name
from aiorts_flexi.recordings.logger import BasicOperations, FlexiLogger
from aiorts_flexi.recordings.replaying import Playback
from aiorts_log import RecordingOptions, RecordingReader, RecordingWriter
from play_parts import BEGIN, MS, S, foreign, recorded, steady

pytestmark = pytest.mark.row(115)


@record
class Reading(TimedLong):
    """A record of a subclass."""

    volts: float = 0.0


async def replay(kernel: Kernel, path: Path, **params: Any) -> FlexiLogger:
    return await kernel.create(FlexiLogger, mode="replay", logfile=str(path), **params)


async def taker(kernel: Kernel, logger: FlexiLogger, **options: Any) -> dict[str, InPort[Any]]:
    """In-ports of a component in no context, one for each out-port."""
    component = await kernel.create(Component)
    ports: dict[str, InPort[Any]] = {}
    for port in logger.ports.values():
        if port.name not in ("Control", "Playback"):
            ports[port.name] = component.add_port(port.name, InPort(port.type, unit=port.unit))
            await kernel.connect(port, ports[port.name], **{"length": 100_000, **options})
    return ports


def values(port: InPort[Any]) -> list[Any]:
    return [sample.data for sample in port.drain()]


@pytest.mark.parametrize(
    ("params", "warned"), [({"begin": "+100"}, True), ({"loop": 0, "begin": "+100"}, True), ({}, False)]
)
@simulated
async def test_who_asks_for_what_is_not_there_is_told(
    params: dict[str, Any], warned: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    steady(tmp_path / "a.mcap", 10)
    async with Kernel() as kernel:
        logger = await replay(kernel, tmp_path / "a.mcap", **params)
        await taker(kernel, logger)
        await kernel.start(EventContext(), logger, activate=True)
        await kernel.sleep(10.0)
    assert any("nothing was replayed" in line for line in caplog.messages) is warned


@simulated
async def test_a_recording_without_any_port_is_refused(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", [])
    async with Kernel() as kernel:
        with pytest.raises(ConfigurationError, match="nothing was recorded in it"):
            await replay(kernel, tmp_path / "a.mcap")


class TestPorts:
    @simulated
    async def test_they_are_those_of_the_file_and_known_as_soon_as_it_is_created(self, tmp_path: Path) -> None:
        with RecordingWriter(tmp_path / "a.mcap", RecordingOptions(min_free=0)) as writer:
            writer.write(writer.add_port("speed", TimedDouble, {"unit": "m/s"}), TimedDouble(0, 1.0), BEGIN)
            writer.write(writer.add_port("name", str), "x", BEGIN)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            assert {(port.name, port.type, port.unit) for port in logger.ports.values()} == {
                ("speed", TimedDouble, "m/s"),
                ("name", str, None),
            }
            other = await kernel.create(Component)
            with pytest.raises(WiringError, match="km/h"):
                await kernel.connect(logger.ports["speed"], other.add_port("in", InPort(TimedDouble, unit="km/h")))

    @simulated
    async def test_chosen_left_out_and_renamed(self, tmp_path: Path) -> None:
        names = ["pid0.command", "/imu/data", "plain"]
        recorded(tmp_path / "a.mcap", [(name, BEGIN, TimedLong(0, i)) for i, name in enumerate(names)])
        async with Kernel() as kernel:
            path = tmp_path / "a.mcap"
            assert [*(await replay(kernel, path)).ports] == ["pid0_command", "imu_data", "plain"]
            chosen = await replay(kernel, path, only=["plain", "/imu/data"], remap=["/imu/data=gyro"])
            assert [*chosen.ports] == ["gyro", "plain"]
            assert [*(await replay(kernel, path, skip=["/imu/data", "plain"])).ports] == ["pid0_command"]

    @pytest.mark.parametrize(
        ("params", "message"),
        [
            ({"only": ["plian"]}, r"has no port 'plian'; did you mean 'plain'\?"),
            ({"skip": ["x"]}, "has no port 'x'; there are 'a.b', 'a_b', 'plain'"),
            ({"skip": ["a_b"], "remap": ["plain"]}, "expected OLD=NEW"),
            ({"skip": ["a_b"], "remap": ["plain=no/name"]}, "expected OLD=NEW"),
            ({"skip": ["a_b"], "remap": ["plain=x", "plain=y"]}, "given two names"),
            ({"only": ["plain"], "skip": ["plain"]}, "leave no port"),
            ({}, "ports 'a.b' and 'a_b' would both be 'a_b'"),
            ({"skip": ["a_b"], "begin": "soon"}, r"expected \+SECONDS"),
            ({"skip": ["a_b"], "begin": "+2", "end": "+1"}, "begin is not before end"),
            ({"logfile": "nix.mcap"}, "nix.mcap: cannot be read"),
        ],
    )
    @simulated
    async def test_what_makes_no_sense_is_refused_when_it_is_created(
        self, params: dict[str, Any], message: str, tmp_path: Path
    ) -> None:
        recorded(tmp_path / "a.mcap", [(name, BEGIN, TimedLong(0, 0)) for name in ("a.b", "a_b", "plain")])
        async with Kernel() as kernel:
            with pytest.raises((ConfigurationError, InvalidNameError), match=message):
                await kernel.create(FlexiLogger, mode="replay", **{"logfile": str(tmp_path / "a.mcap"), **params})

    @simulated
    async def test_a_port_without_samples_needs_no_type_that_is_known(self, tmp_path: Path) -> None:
        @record
        class Unheard:
            data: int = 0

        with RecordingWriter(tmp_path / "a.mcap", RecordingOptions(min_free=0)) as writer:
            assert writer.write(writer.add_port("sent", TimedLong), TimedLong(0, 1), BEGIN)
            writer.add_port("quiet", Unheard)
            writer.add_port("silent", TimedLong)
        del _by_full_name[wire_name(Unheard)]
        async with Kernel() as kernel:
            ports = (await replay(kernel, tmp_path / "a.mcap")).ports
            assert {"sent", "silent"} == set(ports) - {"Control", "Playback"}

    @pytest.mark.fault("D12")
    @simulated
    async def test_a_type_that_is_not_known_here_is_refused_by_its_port_and_never_imported(
        self, tmp_path: Path
    ) -> None:
        path = foreign(tmp_path / "a.mcap", [BEGIN, BEGIN + S], type_name="antigravity.Thing")
        async with Kernel() as kernel:
            (await replay(kernel, steady(tmp_path / "b.mcap", 2))).ports  # noqa: B018 - whatever is loaded by then
            before = set(sys.modules)
            with pytest.raises(ConfigurationError, match=r"port 'b': no type 'antigravity.Thing' .* --skip b$"):
                await replay(kernel, path)
            logger = await replay(kernel, path, skip=["b"])
            ports = await taker(kernel, logger)
            await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(5.0)
            assert values(ports["a"]) == [0, 1]
            assert {name for name in set(sys.modules) - before if not name.startswith("aiorts.")} == set()
        with RecordingReader(path) as reader:
            assert [s.port.plain(s.data)["data"] for s in reader.samples(ports=["b"])] == [0, 1]

    @simulated
    async def test_a_port_that_was_given_records_of_a_subclass_is_one_port(self, tmp_path: Path) -> None:
        samples = [TimedLong(1, 1), Reading(2, 2, 0.5), TimedLong(3, 3)]
        with RecordingWriter(tmp_path / "a.mcap", RecordingOptions(min_free=0)) as writer:
            port = writer.add_port("a", TimedLong)
            for number, sample in enumerate(samples):
                writer.write(port, sample, BEGIN + number)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap", absolute=True)
            ports = await taker(kernel, logger)
            await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(1.0)
            assert ports["a"].drain() == samples

    @simulated
    async def test_of_another_file_they_are_other_ones(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 4)
        recorded(tmp_path / "b.mcap", [("other", BEGIN, TimedString(0, "x"))])
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            await logger.configure(logfile=str(tmp_path / "b.mcap"))
            assert [*logger.ports] == ["other"]


class TestTime:
    @pytest.mark.row(116)
    @pytest.mark.parametrize(
        ("params", "moments"),
        [
            ({}, [0, 1, 2, 3, 4]),
            ({"speed": 4.0}, [0, 0.25, 0.5, 0.75, 1]),
            ({"speed": 0.1}, [0, 10, 20, 30, 40]),
            ({"speed": None}, [0] * 5),
            ({"rate": 8.0}, [0, 0.125, 0.25, 0.375, 0.5]),
            ({"begin": "+2"}, [0, 1, 2]),
            ({"begin": "+1.5", "end": "+4"}, [0.5, 1.5]),
            ({"begin": str(BEGIN // S + 3)}, [0, 1]),
            ({"position": "+3", "loop": 2}, [0, 1, 2, 3, 4, 5, 6]),
            ({"max_gap": 0.5}, [0, 0.5, 1, 1.5, 2]),
        ],
    )
    @simulated
    async def test_samples_leave_on_the_clock_of_the_kernel(
        self, params: dict[str, Any], moments: list[float], tmp_path: Path
    ) -> None:
        recorded(tmp_path / "a.mcap", [("a", BEGIN + i * S, TimedLong(BEGIN + i * S, i)) for i in range(5)])
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap", **params)
            came = Arrivals(kernel)
            await came.listen(logger)
            await kernel.sleep(7.0)
            await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(100.0)
            assert logger.state is LifecycleState.INACTIVE
        assert [moment / S - 7 for moment in came.moments] == moments

    @simulated
    async def test_whatever_context_runs_it(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 100)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            came = Arrivals(kernel)
            await came.listen(logger)
            await kernel.start(PeriodicContext(rate=0.7), logger, activate=True)
            await kernel.sleep(10.0)
        assert came.moments == [i * 10 * MS for i in range(100)]

    @simulated
    async def test_stamps_are_now_and_with_absolute_as_recorded(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            for absolute, first in ((False, 50 * S), (True, BEGIN)):
                logger = await replay(kernel, tmp_path / "a.mcap", absolute=absolute, only=["a"])
                ports = await taker(kernel, logger)
                await kernel.sleep(50.0 - kernel.clock.time() % 50.0)
                await kernel.start(EventContext(), logger, activate=True)
                await kernel.sleep(1.0)
                assert [one.tm - first for one in ports["a"].drain()] == [i * 20 * MS for i in range(5)]

    @simulated
    async def test_a_thread_is_no_place_for_it(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            context = await kernel.start(ThreadContext(), logger)
            with pytest.raises(Exception, match="in an event context"):
                await context.activate()


class Arrivals:
    """When samples come, on the monotonic clock of the kernel."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self.moments: list[int] = []

    async def listen(self, logger: FlexiLogger, length: int = 100) -> None:
        arrivals = self

        class Listener(Component):
            def on_execute(self) -> None:
                for port in self.ports.values():
                    assert isinstance(port, InPort)
                    arrivals.moments += [self.clock.monotonic_ns()] * len(port.drain())

        listener = await self._kernel.create(Listener)
        for port in logger.ports.values():
            await self._kernel.connect(port, listener.add_port(port.name, InPort(port.type)), length=length)
        await self._kernel.start(EventContext(), listener, activate=True)


class TestEnd:
    @simulated
    async def test_it_finishes_without_an_error_and_what_it_sent_can_be_taken(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 100)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            ports = await taker(kernel, logger)
            await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(2.0)
            assert logger.has_finished
            assert logger.state is LifecycleState.INACTIVE
            assert logger.last_error is None
            assert [values(ports["a"]), values(ports["b"])] == [[*range(0, 100, 2)], [*range(1, 100, 2)]]

    @pytest.mark.slow
    @pytest.mark.fault("D18")
    @simulated
    async def test_activated_again_it_plays_from_the_start(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 100)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            ports = await taker(kernel, logger)
            context = await kernel.start(EventContext(), logger, activate=False)
            for cycle in range(10):
                await context.activate()
                if cycle % 2:
                    await kernel.sleep(0.505)  # in the midst of it
                    await context.deactivate()
                    assert values(ports["a"]) == [*range(0, 51, 2)]
                else:
                    await kernel.sleep(2.0)
                    assert values(ports["a"]) == [*range(0, 100, 2)]
                assert logger.state is LifecycleState.INACTIVE
                ports["b"].drain()

    @simulated
    async def test_deactivated_it_sends_nothing_and_leaves_no_task_and_no_file(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 100)
        files = len(os.listdir("/dev/fd"))
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            ports = await taker(kernel, logger)
            before = len(asyncio.all_tasks())
            context = await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(0.105)
            await context.deactivate()
            assert values(ports["a"]) == [0, 2, 4, 6, 8, 10]
            await kernel.sleep(5.0)
            assert values(ports["a"]) == []
            await kernel.stop(context)
            assert len(asyncio.all_tasks()) == before
        assert len(os.listdir("/dev/fd")) == files

    @pytest.mark.slow(kept_by="first")
    @pytest.mark.parametrize("strict", [False, True])
    @pytest.mark.parametrize("torn", [False, True])
    @simulated
    async def test_of_one_that_breaks_off_or_is_damaged_everything_whole_is_played_and_then_that_is_told(
        self, torn: bool, strict: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        path = steady(tmp_path / "a.mcap", 1000, chunk=2000)
        with RecordingReader(path) as reader:
            place = reader.pieces[-1].offset
        raw = bytearray(path.read_bytes())
        if torn:
            del raw[place + 100 :]
        else:
            raw[place + 100] ^= 1
        path.write_bytes(raw)
        async with Kernel() as kernel:
            logger = await replay(kernel, path, strict=strict)
            ports = await taker(kernel, logger)
            await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(20.0)
            assert logger.state is (LifecycleState.ERROR if strict or not torn else LifecycleState.INACTIVE)
            got = len(ports["a"].drain()) + len(ports["b"].drain())
        assert 900 < got < 1000
        told = [line for line in caplog.messages if ("was not closed" if torn else "damaged at byte") in line]
        assert len(told) == 1

    @simulated
    async def test_a_file_that_is_gone_by_then_is_an_error_that_names_it(self, tmp_path: Path) -> None:
        path = steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            logger = await replay(kernel, path)
            path.unlink()
            await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(1.0)
            assert logger.state is LifecycleState.ERROR
            assert "a.mcap: cannot be read" in str(logger.last_error)


@pytest.mark.fault("D15")
class TestReaders:
    @simulated
    async def test_one_that_blocks_gets_everything_in_its_own_time(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 1000, MS)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap", only=["a"])
            ports = await taker(kernel, logger, length=4, full="block", timeout=None)
            await kernel.start(EventContext(), logger, activate=True)
            got = []
            for _ in range(500):
                await kernel.sleep(0.01)
                got.append((await ports["a"].read()).data)
            assert got == [*range(0, 1000, 2)]
            await kernel.sleep(0.01)
            assert logger.has_finished

    @pytest.mark.slow(kept_by="first")
    @pytest.mark.parametrize("params", [{"speed": None}, {"speed": None, "only": ["a"]}, {"rate": 1e6}])
    @simulated
    async def test_one_that_reads_as_it_comes_loses_nothing_at_any_speed(
        self, params: dict[str, Any], tmp_path: Path
    ) -> None:
        steady(tmp_path / "a.mcap", 1000)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap", **params)
            came = Arrivals(kernel)
            await came.listen(logger, length=8)  # what a connector has unless somebody says otherwise
            await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(1.0)
            assert logger.has_finished
        assert len(came.moments) == (500 if "only" in params else 1000)

    @simulated
    async def test_of_one_that_wants_the_newest_the_others_are_counted(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 1000, MS)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap", only=["a"])
            ports = await taker(kernel, logger, length=1, subscription="new", push="new")
            await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(2.0)
            (connector,) = ports["a"].connectors
            assert values(ports["a"]) == [998]
            assert connector.statistics.written == 500
            assert sum(connector.statistics.dropped.values()) == 499

    @simulated
    async def test_one_that_takes_too_long_is_named(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 100)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            await taker(kernel, logger, length=2, full="block", timeout=0.5)
            await kernel.start(EventContext(), logger, activate=True)
            await kernel.sleep(5.0)
            assert logger.state is LifecycleState.ERROR
            assert isinstance(logger.last_error, WriteTimeout)

    @pytest.mark.parametrize("name", ["rate", "speed", "max_gap"])
    @pytest.mark.parametrize("value", [0, -1, 1e19, float("nan"), float("inf")])
    @simulated
    async def test_a_rate_or_speed_that_makes_no_sense_is_refused(
        self, name: str, value: float, tmp_path: Path
    ) -> None:
        steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            with pytest.raises(ConfigurationError, match=name):
                await replay(kernel, tmp_path / "a.mcap", **{name: value})


@pytest.mark.row(116)
class TestWhileItRuns:
    @simulated
    async def test_parameters_pause_step_move_and_hurry_it(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 1000)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            ports = await taker(kernel, logger)
            await kernel.start(EventContext(), logger, activate=True)

            def got() -> list[int]:
                return sorted([*values(ports["a"]), *values(ports["b"])])

            await kernel.sleep(0.095)
            await logger.configure(paused=True)
            await kernel.sleep(10.0)
            assert got() == [*range(10)]
            await logger.configure(step=3)
            await kernel.sleep(10.0)
            assert got() == [10, 11, 12]
            await logger.configure(position="+5")
            await logger.configure(step=4)
            await kernel.sleep(10.0)
            assert got() == [500]
            await logger.configure(paused=False)
            await kernel.sleep(0.095)
            assert got() == [*range(501, 510)]  # no burst: each 10 ms behind the one before
            await logger.configure(speed=10.0)
            await kernel.sleep(0.1)
            assert got() == [*range(510, 610)]
            await logger.configure(rate=100.0)
            await kernel.sleep(0.0999)
            assert got() == [*range(610, 620)]
            await logger.configure(rate=None, speed=None)
            await kernel.sleep(0.001)
            assert got() == [*range(620, 1000)]
            assert logger.has_finished

    @simulated
    async def test_paused_from_the_beginning_it_sends_as_many_as_steps_say(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 100)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap", paused=True, step=3, only=["a"])
            ports = await taker(kernel, logger)
            context = await kernel.start(EventContext(), logger, activate=True)
            for _ in range(2):
                await kernel.sleep(5.0)
                assert values(ports["a"]) == [0, 2, 4]
                await context.deactivate()
                await context.activate()

    @simulated
    async def test_what_says_what_is_replayed_cannot_be_changed_meanwhile_and_all_stays_as_it_was(
        self, tmp_path: Path
    ) -> None:
        steady(tmp_path / "a.mcap", 100)
        steady(tmp_path / "b.mcap", 100)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            ports = await taker(kernel, logger)
            await kernel.start(EventContext(), logger, activate=True)
            for change in (
                {"logfile": str(tmp_path / "b.mcap")},
                {"only": ["a"]},
                {"remap": ["a=x"]},
                {"end": "+0.5"},
                {"absolute": True},
            ):
                with pytest.raises(ConfigurationError, match="is being replayed; deactivate it first"):
                    await logger.configure(paused=True, **change)
            await kernel.sleep(2.0)
            assert len(ports["a"].drain()) == 50
            await logger.configure(only=["a"])
            assert [*logger.ports] == ["a"]

    @simulated
    async def test_through_the_service_ports(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 1000)

        class Operator(Component):
            control = Required[BasicOperations](instance="BasicOperations")
            playback = Required[Playback](instance="Playback")

        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap", use_control=True)
            ports = await taker(kernel, logger)
            operator = await kernel.create(Operator)
            await kernel.connect(operator.ports["control"], logger.ports["Control"])
            await kernel.connect(operator.ports["playback"], logger.ports["Playback"])
            await kernel.start(EventContext(), logger, activate=True)
            control, playback = operator.control.proxy, operator.playback.proxy

            def got() -> list[int]:
                return sorted([*values(ports["a"]), *values(ports["b"])])

            await kernel.sleep(1.0)
            assert got() == []  # as in the original, it waits to be started
            assert await control.start() is True
            assert await control.start() is False
            await kernel.sleep(0.095)
            assert await control.stop() is True
            assert await control.stop() is False
            await kernel.sleep(10.0)
            assert got() == [*range(10)]
            assert await playback.position() == 0.095
            assert await playback.step(2) is True
            assert await playback.seek(5.0) == 5.0
            assert await playback.step(1) is True
            await kernel.sleep(1.0)
            assert got() == [500, 501, 502]
            assert await playback.resume() is True
            await kernel.sleep(0.015)
            assert await playback.pause() is True
            assert await playback.step(1) is True
            await kernel.sleep(1.0)
            assert got() == [503, 504]
            for wrong in (playback.seek(-1.0), playback.seek(float("nan")), playback.step(0)):
                with pytest.raises(Exception, match="expected"):
                    await wrong
            await playback.seek(9.99)
            await control.start()
            await kernel.sleep(1.0)
            assert got() == [999]
            assert logger.has_finished

    @simulated
    async def test_what_is_asked_of_one_that_plays_nothing_is_refused(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            logger = await replay(kernel, tmp_path / "a.mcap")
            for ask in (logger._replaying.position, lambda: logger._replaying.seek(1.0)):
                with pytest.raises(StateError, match="nothing is replayed now"):
                    ask()
            assert logger.start() is False


class Source(Component):
    """Sends from several ports, at odd moments, several in one moment among them."""

    from aiorts import OutPort as _OutPort

    a = _OutPort(TimedDouble)
    b = _OutPort(TimedLong)
    c = _OutPort(TimedString)

    async def send(self) -> None:
        for i in range(300):
            await self.sleep((i * 7919 % 23) / 1000)
            tm = self.clock.time_ns()
            self.a.write_nowait(TimedDouble(tm, i / 3))
            if i % 3 == 0:
                self.b.write_nowait(TimedLong(0, i))
            if i % 7 == 0:
                self.c.write_nowait(TimedString(tm - 5, f"{i} ü"))
                self.c.write_nowait(TimedString(tm - 4, ""))


async def recorder_of(kernel: Kernel, source: Component, path: Path) -> FlexiLogger:
    """A recorder of all out-ports of a component, active."""
    outs = [port for port in source.ports.values() if port.direction == "out"]
    recorder = await kernel.create(
        FlexiLogger,
        inputs=[port.type.__name__ for port in outs],
        names=[port.name for port in outs],
        logfile=str(path),
        min_free=0.0,
    )
    for port in outs:
        await kernel.connect(port, recorder.ports[port.name], length=1000)
    await kernel.start(EventContext(), recorder, activate=True)
    return recorder


def contents(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    with RecordingReader(path) as reader:
        return [
            (sample.port.name, sample.log_time - reader.start, sample.publish_time, sample.sequence, sample.data)
            for sample in reader.samples()
        ]


def replayed_into(source: Path, target: Path, **params: Any) -> list[tuple[str, int, int, int, bytes]]:
    """What a recorder makes of a replay, all of it in virtual time."""

    async def main(clock: SimulatedClock) -> None:
        async with Kernel(clock=clock) as kernel:
            logger = await replay(kernel, source, **params)
            await recorder_of(kernel, logger, target)
            await kernel.start(EventContext(), logger, activate=True)
            while not logger.has_finished:
                await kernel.sleep(1.0)

    simulate(main, clock=SimulatedClock(BEGIN + 12345))
    return contents(target)


class TestDeterminism:
    def recording(self, folder: Path) -> Path:
        async def main(clock: SimulatedClock) -> None:
            async with Kernel(clock=clock) as kernel:
                source = await kernel.create(Source)
                await recorder_of(kernel, source, folder / "first.mcap")
                await source.send()
                await kernel.sleep(1.0)

        simulate(main, clock=SimulatedClock(BEGIN))
        return folder / "first.mcap"

    @pytest.mark.fault("D16")
    @pytest.mark.row(117)
    def test_recorded_replayed_and_recorded_again_is_the_same_to_the_byte(self, tmp_path: Path) -> None:
        first = self.recording(tmp_path)
        assert len(contents(first)) == 300 + 100 + 2 * 43
        assert replayed_into(first, tmp_path / "second.mcap", absolute=True) == contents(first)

    @pytest.mark.slow
    def test_also_from_a_text_recording(self, tmp_path: Path) -> None:
        from aiorts_log.text.text_format import TextWriter

        first = self.recording(tmp_path)
        with (
            RecordingReader(first) as reader,
            TextWriter(tmp_path / "first.txt", RecordingOptions(min_free=0)) as writer,
        ):
            numbers = {name: writer.add_port(name, port.type) for name, port in reader.ports.items()}
            for name, log_time, sample in reader.records():
                writer.write(numbers[name], sample, log_time)
        assert replayed_into(tmp_path / "first.txt", tmp_path / "second.mcap", absolute=True) == contents(first)

    @pytest.mark.slow(kept_by="TestDeterminism::test_recorded_replayed_and_recorded_again_is_the_same_to_the_byte")
    def test_twice_the_same_replay_gives_the_same_with_stamps_of_its_own(self, tmp_path: Path) -> None:
        first = self.recording(tmp_path)
        params: dict[str, Any] = {"speed": 3.0, "loop": 2, "max_gap": 0.01}
        runs = [replayed_into(first, tmp_path / f"{number}.mcap", **params) for number in range(2)]
        assert runs[0] == runs[1]
        assert len(runs[0]) == 2 * len(contents(first))

    @pytest.mark.fault("D14")
    def test_a_recording_over_a_clock_that_was_set_back_replays_as_it_was(self, tmp_path: Path) -> None:
        async def main(clock: SimulatedClock) -> None:
            async with Kernel(clock=clock) as kernel:
                source = await kernel.create(Source)
                await recorder_of(kernel, source, tmp_path / "a.mcap")
                for i in range(20):
                    if i == 10:
                        clock.set_time_ns(clock.time_ns() - 3600 * S)
                    source.b.write_nowait(TimedLong(clock.time_ns(), i))
                    await kernel.sleep(1.0)

        simulate(main, clock=SimulatedClock(BEGIN))
        again = replayed_into(tmp_path / "a.mcap", tmp_path / "b.mcap", absolute=True)
        assert again == contents(tmp_path / "a.mcap")
        assert [log_time for _, log_time, _, _, _ in again] == [i * S for i in range(20)]
