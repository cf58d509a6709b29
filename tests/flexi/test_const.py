"""FlexiConst: what it sends, when it sends it, and that neither depends on the context that runs it."""

from __future__ import annotations

import asyncio
import re
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, EventContext, ExternalContext, InPort, Kernel, LifecycleState, Param, PeriodicContext
from aiorts.errors import ConfigurationError, WriteTimeout
from aiorts.testing import Rig, check_component, simulated
from aiorts.types import Point2D, Pose2D, RangeData, TimedDoubleSeq, TimedLong, TimedPose2D
from aiorts_flexi.common.place import TypedTextError
from aiorts_flexi.const import FlexiConst

if TYPE_CHECKING:
    from pathlib import Path

    from aiorts import Context

S = 1_000_000_000


async def reader(kernel: Kernel, const: FlexiConst, **options: Any) -> list[InPort[Any]]:
    """In-ports of a component in no context, one for each out-port."""
    taker = await kernel.create(Component)
    ports: list[InPort[Any]] = []
    for port in const.ports.values():
        ports.append(taker.add_port(f"of_{port.name}", InPort(port.type)))
        await kernel.connect(port, ports[-1], **{"length": 100_000, **options})
    return ports


def context(kind: str) -> Context:
    return {"event": EventContext, "slow": lambda: PeriodicContext(rate=0.5), "external": ExternalContext}[kind]()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["event", "slow", "external"])
@simulated
async def test_the_rate_is_its_own_whatever_context_runs_it(kind: str) -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["7"], rate=30.0)
        (port,) = await reader(kernel, const)
        await kernel.start(context(kind), const, activate=True)
        await kernel.sleep(99.99)
        samples = port.drain()
    # No drift: sample n at t0 + n / rate, to the nanosecond, for 3,000 samples.
    assert [sample.tm - samples[0].tm for sample in samples] == [-(-n * S // 30) for n in range(3_000)]
    assert {sample.data for sample in samples} == {7}


@pytest.mark.parametrize(("params", "step"), [({"rate": 4.0}, S // 4), ({"seconds": 2.5}, 5 * S // 2), ({}, S)])
@simulated
async def test_a_rate_or_seconds_or_once_a_second(params: dict[str, Any], step: int) -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedDouble"], constants=["6.2"], count=5, **params)
        (port,) = await reader(kernel, const)
        await kernel.start(EventContext(), const, activate=True)
        await kernel.sleep(60.0)
        samples = port.drain()
        assert const.state is LifecycleState.INACTIVE
    assert [sample.tm - samples[0].tm for sample in samples] == [n * step for n in range(5)]


@pytest.mark.anyio
async def test_on_the_real_clock_it_ends_after_its_count_and_is_never_early() -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["7"], rate=200.0, count=5)
        (port,) = await reader(kernel, const)
        began = kernel.clock.time_ns()
        await kernel.start(EventContext(), const, activate=True)
        while const.state is LifecycleState.ACTIVE:
            await kernel.sleep(0.001)
        samples = port.drain()
    assert [sample.data for sample in samples] == [7] * 5
    assert samples[-1].tm - began > 0.015 * S


@simulated
async def test_count_begins_anew_with_each_activation() -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedShort"] * 2, constants=["1", "2"], count=3, rate=10.0)
        ports = await reader(kernel, const)
        ran = await kernel.start(EventContext(), const, activate=True)
        for _ in range(2):
            await kernel.sleep(1.0)
            assert const.state is LifecycleState.INACTIVE
            assert [[sample.data for sample in port.drain()] for port in ports] == [[1] * 3, [2] * 3]
            await ran.activate()


@simulated
async def test_a_deactivated_one_sends_nothing_and_leaves_no_task() -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedShort"], constants=["1"], rate=10.0)
        (port,) = await reader(kernel, const)
        before = len(asyncio.all_tasks())
        ran = await kernel.start(EventContext(), const, activate=True)
        await kernel.sleep(0.95)
        await ran.deactivate()
        assert len(port.drain()) == 10
        await kernel.sleep(5.0)
        assert port.drain() == []
        await kernel.stop(ran)
        assert len(asyncio.all_tasks()) == before


@simulated
async def test_in_two_contexts_it_sends_once_and_as_long_as_it_is_active_in_one() -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedShort"], constants=["1"], rate=10.0)
        (port,) = await reader(kernel, const)
        one = await kernel.start(EventContext(), const, activate=True)
        two = await kernel.start(PeriodicContext(rate=100.0), const, activate=True)
        await kernel.sleep(0.95)
        assert len(port.drain()) == 10
        await one.deactivate()
        await kernel.sleep(1.0)
        assert len(port.drain()) == 10
        await two.deactivate()
        await kernel.sleep(1.0)
        assert port.drain() == []


@pytest.mark.row(123)
@simulated
async def test_several_types_with_and_without_time_or_data() -> None:
    types = ["TimedPose2D", "RangeData", "float", "Point2D", "TimedDoubleSeq:2"]
    constants = ['{"position": {"x": 1}}', '{"ranges": [1, 2]}', "0", '{"y": 3}', "[4, 5]"]
    async with Kernel() as kernel:
        await kernel.sleep(2.0)
        const = await kernel.create(FlexiConst, outputs=types, constants=constants, count=1, names=("pose", "", "f"))
        assert list(const.ports) == ["pose", "output1", "f", "output3", "output4"]
        ports = await reader(kernel, const)
        await kernel.start(EventContext(), const, activate=True)
        await kernel.sleep(1.0)
        assert [port.drain() for port in ports] == [
            [TimedPose2D(2 * S, Pose2D(Point2D(1.0, 0.0), 0.0))],
            [RangeData(2 * S, ranges=[1.0, 2.0])],
            [0.0],
            [Point2D(0.0, 3.0)],
            [TimedDoubleSeq(2 * S, [4.0, 5.0])],
        ]


@simulated
async def test_continuous_is_as_fast_as_the_reader_takes_and_loses_nothing() -> None:
    taken: list[int] = []

    class Slow(Component):
        numbers = InPort(TimedLong)

        async def on_execute(self) -> None:
            taken.append(self.numbers.read_nowait().tm)
            await self.sleep(0.01)

    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["0"], continuous=True, count=200)
        slow = await kernel.create(Slow)
        connector = await kernel.connect(const.ports["output"], slow.numbers, full="block", timeout=None)
        await kernel.start(EventContext(), slow, activate=True)
        await kernel.start(EventContext(), const, activate=True)
        await kernel.sleep(1.0)
        assert 99 <= len(taken) <= 101
        await kernel.sleep(2.0)
        assert len(taken) == 200
        assert connector.statistics.written == connector.statistics.delivered == 200
        assert const.state is LifecycleState.INACTIVE


@pytest.mark.slow(kept_by="test_continuous_is_as_fast_as_the_reader_takes_and_loses_nothing")
@pytest.mark.parametrize("connected", [True, False])
@simulated
async def test_continuous_without_anybody_who_holds_it_back_lets_time_pass(connected: bool) -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["0"], continuous=True)
        ports = await reader(kernel, const, length=4) if connected else []
        await kernel.start(EventContext(), const, activate=True)
        await kernel.sleep(0.05)
        assert const.state is LifecycleState.ACTIVE
        assert [len(port.drain()) for port in ports] == [4] * connected


@simulated
async def test_every_reader_that_drains_gets_each_continuous_sample() -> None:
    got = 0

    class Drains(Component):
        numbers = InPort(TimedLong)

        def on_execute(self) -> None:
            nonlocal got
            got += len(self.numbers.drain())

    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["0"], continuous=True, count=5_000)
        drains = await kernel.create(Drains)
        await kernel.connect(const.ports["output"], drains.numbers)
        await kernel.start(EventContext(), drains, activate=True)
        await kernel.start(EventContext(), const, activate=True)
        await kernel.sleep(1.0)
    assert got == 5_000


@simulated
async def test_a_reader_that_holds_it_up_costs_the_moments_that_passed_and_no_burst(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["0"], rate=10.0, count=6)
        (port,) = await reader(kernel, const, length=2, full="block", timeout=None)
        await kernel.start(EventContext(), const, activate=True)
        start = kernel.clock.time_ns()
        await kernel.sleep(1.05)  # two are in the buffer, the third has waited since 0.2 s
        taken = port.drain()
        await kernel.sleep(1.0)
        taken += port.drain()
        # The one that is late goes out at once, the next ones when they are due.
        assert [(sample.tm - start) * 1000 // S for sample in taken] == [0, 100, 200, 1050, 1100, 1200]
        await kernel.sleep(0.01)
        assert const.state is LifecycleState.INACTIVE
    assert "7 samples were skipped" in caplog.text


@simulated
async def test_a_reader_that_never_takes_is_an_error_and_says_who() -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, "c", outputs=["TimedLong"], constants=["0"], continuous=True)
        await reader(kernel, const, length=2, full="block", timeout=0.5)
        ran = await kernel.start(EventContext(), const, activate=True)
        await kernel.sleep(2.0)
        assert const.state is LifecycleState.ERROR
        assert isinstance(const.last_error, WriteTimeout)
        assert "c.output" in str(const.last_error)
        await ran.reset()
        await ran.activate()
        assert const.state is LifecycleState.ACTIVE


@simulated
async def test_constant_and_rate_change_while_it_runs() -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["1"], seconds=3600.0)
        (port,) = await reader(kernel, const)
        await kernel.start(EventContext(), const, activate=True)
        await kernel.sleep(10.0)
        assert [sample.data for sample in port.drain()] == [1]
        await const.configure(constants=["2"], seconds=0.5)
        await kernel.sleep(1.1)
        assert [sample.data for sample in port.drain()][:1] == [2]
        with pytest.raises(ConfigurationError, match=r"TimedLong\.data"):
            await const.configure(constants=["2.5"])
        port.drain()
        await kernel.sleep(2.0)
        assert [sample.data for sample in port.drain()] == [2, 2, 2, 2]
        assert const.state is LifecycleState.ACTIVE


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({}, "at least one out-port"),
        ({"outputs": ["TimedLong"]}, "0 constants for 1 out-port"),
        ({"outputs": ["TimedLong"], "constants": ["1", "2"]}, "2 constants for 1"),
        ({"outputs": ["TimedLongg"], "constants": ["1"]}, "did you mean TimedLong"),
        ({"outputs": ["TimedLong:3"], "constants": ["1"]}, "no sequence"),
        ({"outputs": ["TimedLongSeq:3"], "constants": ["[1, 2]"]}, "expected 3 items, got 2"),
        ({"outputs": ["TimedLong"], "constants": ["1.5"]}, "constant 0: TimedLong.data"),
        ({"outputs": ["TimedLong"], "constants": ["__import__('os').getpid()"]}, "character 1: expected a literal"),
        ({"outputs": ["TimedLong"], "constants": ["1"], "names": ("a", "b")}, "2 names for 1 out-port"),
        ({"outputs": ["TimedLong"] * 2, "constants": ["1", "2"], "names": ("a", "a")}, "of that name already"),
        ({"outputs": ["TimedLong"], "constants": ["1"], "rate": 5.0, "seconds": 1.0}, "exclude each other"),
        ({"outputs": ["TimedLong"], "constants": ["1"], "continuous": True, "seconds": 1.0}, "exclude each other"),
        ({"outputs": ["TimedLong"], "constants": ["1"], "continuous": True, "rate": 2.0}, "exclude each other"),
        ({"outputs": ["TimedLong"], "constants": ["1"], "continuous": True, "rate": 1.0}, "exclude each other"),
        ({"outputs": ["TimedLong"], "constants": ["1"], "seconds": 2.0, "rate": 1.0}, "exclude each other"),
        ({"outputs": ["TimedLong"], "constants": ["1"], "rate": 0.0}, "rate"),
        ({"outputs": ["TimedLong"], "constants": ["1"], "rate": float("nan")}, "rate"),
        ({"outputs": ["TimedLong"], "constants": ["1"], "count": -1}, "count"),
    ],
)
async def test_bad_parameters_are_refused_at_creation(params: dict[str, Any], said: str) -> None:
    async with Kernel() as kernel:
        error: type[Exception] = ValueError  # ConfigurationError, and what add_port raises
        with pytest.raises(error, match=re.escape(said)):
            await kernel.create("FlexiConst", **params)
        assert not kernel.components


@pytest.mark.anyio
@pytest.mark.row(125)
@pytest.mark.fault("F08")
@pytest.mark.parametrize(
    "text",
    [
        "__import__('pathlib').Path({path!r}).touch()",
        "open({path!r}, 'w')",
        "[open({path!r}, 'w')]",
        "{{'data': open({path!r}, 'w')}}",
        "f\"{{open({path!r}, 'w')}}\"",
        "(lambda: open({path!r}, 'w'))()",
    ],
)
async def test_no_constant_runs_anything(text: str, tmp_path: Path) -> None:
    canary = tmp_path / "canary"
    async with Kernel() as kernel:
        for cls in ("TimedString", "TimedMap", "TimedDoubleSeq"):
            with pytest.raises(TypedTextError):
                await kernel.create(FlexiConst, outputs=[cls], constants=[text.format(path=str(canary))])
    assert not canary.exists()


@simulated
async def test_ports_are_the_same_after_the_context_has_stopped_and_started_again() -> None:
    async with Kernel() as kernel:
        const = await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["1"], rate=10.0)
        (port,) = await reader(kernel, const)
        for _ in range(3):
            ran = await kernel.start(EventContext(), const, activate=True)
            await kernel.sleep(0.95)
            await ran.stop()
            assert len(port.drain()) == 10
            assert list(const.ports) == ["output"]


@simulated
async def test_many_in_one_kernel_do_not_know_each_other() -> None:
    async with Kernel() as kernel:
        consts = [
            await kernel.create(FlexiConst, outputs=["TimedLong"], constants=[str(n)], rate=10.0 + n) for n in range(5)
        ]
        ports = [(await reader(kernel, const))[0] for const in consts]
        await kernel.start(EventContext(), *consts, activate=True)
        await kernel.sleep(9.99)
        for number, port in enumerate(ports):
            samples = port.drain()
            assert {sample.data for sample in samples} == {number}
            assert len(samples) in (100 + 10 * number, 101 + 10 * number)


@simulated
async def test_verbosity_logs_ports_and_constants(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    async with Kernel() as kernel:
        await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["1"])
        assert caplog.text == ""
        await kernel.create(FlexiConst, outputs=["TimedLong"], constants=["1"], verbosity=2)
    assert "out-port output: TimedLong" in caplog.text
    assert "output sends TimedLong(tm=0, data=1)" in caplog.text


class _Ready(FlexiConst):
    """One that needs no parameters."""

    outputs = Param(("TimedLong",), type=tuple[str, ...])
    constants = Param(("1",), type=tuple[str, ...])
    rate = Param(100.0)


def test_it_keeps_what_components_promise() -> None:
    check_component(_Ready, deterministic=True)


@simulated
async def test_in_a_rig_it_is_a_component_like_any_other() -> None:
    async with Rig(_Ready("ready"), context=EventContext()) as rig:
        await rig.advance(0.035)
        assert rig.values("output") == [1, 1, 1, 1]
        assert rig.times("output") == [0.0, 0.01, 0.02, 0.03]
