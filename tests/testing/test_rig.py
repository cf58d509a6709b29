"""The rig: feeds ports, steps time, tells what was written and when; on any loop and in virtual time."""

from __future__ import annotations

import threading
import warnings
from typing import Any, ClassVar

import numpy as np
import pytest

from aiorts import (
    Component,
    Context,
    EventContext,
    ExternalContext,
    InPort,
    LifecycleState,
    OutPort,
    Param,
    PeriodicContext,
    SimulatedClock,
    ThreadContext,
    run,
)
from aiorts.errors import (
    ClosedError,
    ComponentError,
    ConfigurationError,
    PortTypeError,
    RecordError,
    StateError,
    ThreadError,
    WiringError,
)
from aiorts.testing import Rig, faults, simulate
from aiorts.types import Pose2D, TimedDouble, TimedDoubleSeq, TimedLong, TimedMap, TimedPose2D

pytestmark = [pytest.mark.anyio, pytest.mark.row(7)]


class Pid(Component):
    """Proportional controller."""

    measured = InPort(TimedDouble, unit="m")
    command = OutPort(TimedDouble, unit="m/s")
    gain = Param(1.0)

    async def on_execute(self) -> None:
        if (sample := self.measured.latest) is not None:
            await self.command.write(TimedDouble(sample.tm, -self.gain * sample.data))


class Plant(Component):
    """Integrates what it is told."""

    input = InPort(TimedDouble, unit="m/s")
    position = OutPort(TimedDouble, unit="m")
    x = 1.0

    def on_execute(self) -> None:
        if (sample := self.input.latest) is not None:
            self.x += 0.5 * sample.data
        self.position.write_nowait(TimedDouble(0, self.x))


class Pipe(Component):
    """Has two ports and leaves them alone."""

    out = OutPort(TimedDouble)
    input = InPort(TimedDouble)


class PlainEcho(Component):
    """Echoes in plain hooks, for every kind of context."""

    input = InPort(TimedLong)
    output = OutPort(TimedLong)

    def on_execute(self) -> None:
        for sample in self.input.drain():
            self.output.write_nowait(sample)


async def test_parameters_are_in_force_before_on_initialize_and_a_bad_one_is_refused() -> None:
    class Early(Pid):
        seen = 0.0

        def on_initialize(self) -> None:
            self.seen = self.gain

    early = Early("early")
    async with Rig(early, params={"gain": 2.0}) as rig:
        rig.feed("measured", 3.0)
        await rig.tick()
        assert (early.seen, rig.values("command")) == (2.0, [-6.0])
    with pytest.raises(ConfigurationError, match="gian"):
        async with Rig(Pid("pid0"), params={"gian": 2.0}):
            pass
    with pytest.raises(ValueError, match="is for one component, there are 2"):
        Rig(Pid("pid0"), Plant("plant0"), params={"gain": 2.0})


async def test_a_configuration_set_is_chosen_by_its_own_method_and_a_parameter_active_says_so() -> None:
    class Soft(Pid):
        configurations: ClassVar[dict[str, dict[str, float]]] = {"soft": {"gain": 0.5}}

    with pytest.raises(
        ConfigurationError, match=r"soft0.active: no such parameter; .* configuration\.activate\(NAME\)"
    ):
        async with Rig(Soft("soft0"), params={"active": "soft"}):
            pass
    soft = Soft("soft0")
    await soft.configuration.activate("soft")
    async with Rig(soft) as rig:
        rig.feed("measured", 2.0)
        await rig.tick()
        assert rig.values("command") == [-1.0]


async def test_component_in_a_rig_is_fed_ticked_and_asked() -> None:
    async with Rig(Pid("pid0"), rate=100.0) as rig:
        rig.feed("measured", 1.0, 2.0)
        await rig.tick()
        assert rig.received("command") == [TimedDouble(0, -2.0)]
        assert rig.times("command") == [0.01]


async def test_bare_values_become_records_stamped_by_the_clock() -> None:
    async with Rig(Pipe(), rate=4.0) as rig:
        await rig.tick()
        rig.feed("input", 5, TimedDouble(7, 1.5))
        assert rig.received("input") == [TimedDouble(250_000_000, 5.0), TimedDouble(7, 1.5)]


async def test_records_with_several_fields_are_fed_by_mapping() -> None:
    class Follower(Component):
        pose = InPort(TimedPose2D)
        text = InPort(str)
        entries = InPort(TimedMap)

    async with Rig(Follower()) as rig:
        pose = Pose2D()
        rig.feed("pose", pose)
        rig.feed("text", "a", "b")
        rig.feed("entries", {"x": 1})
        assert rig.values("pose") == [pose]
        assert rig.received("text") == ["a", "b"]
        assert [dict(value) for value in rig.values("entries")] == [{"x": 1}]


async def test_value_that_does_not_fit_is_refused_where_it_is_fed() -> None:
    async with Rig(Pid("pid0")) as rig:
        with pytest.raises(RecordError, match=r"TimedDouble\.data"):
            rig.feed("measured", "much")


async def test_shape_of_a_port_holds_for_what_is_fed() -> None:
    class Imu(Component):
        rates = InPort(TimedDoubleSeq, shape=(3,))

    async with Rig(Imu("imu0")) as rig:
        rig.feed("rates", [1.0, 2.0, 3.0])
        with pytest.raises(PortTypeError, match=r"expected shape \(3,\), got \(2,\)"):
            rig.feed("rates", [1.0, 2.0])
        assert len(rig.received("rates")) == 1


async def test_received_is_all_since_the_start_or_clear() -> None:
    async with Rig(Pid("pid0")) as rig:
        for value in (1.0, 2.0):
            rig.feed("measured", value)
            await rig.tick()
        assert rig.values("command") == rig.values("command") == [-1.0, -2.0]
        rig.clear()
        rig.feed("measured", 3.0)
        await rig.tick()
        assert rig.values("command") == [-3.0]


async def test_several_components_run_in_order_and_are_connected() -> None:
    async with Rig(Plant("plant0"), Pid("pid0"), rate=10.0) as rig:
        rig.connect("position", "measured", subscription="new")
        rig.connect("pid0.command", "plant0.input", subscription="new")
        await rig.tick(4)
        assert rig.values("position") == [1.0, 0.5, 0.25, 0.125]
        assert rig.times("plant0.position") == [0.1, 0.2, 0.3, 0.4]


async def test_new_subscription_sends_only_the_newest() -> None:
    async with Rig(Pipe("a"), Pipe("b")) as rig:
        rig.connect("a.out", "b.input", subscription="new", push="new")
        rig.feed("a.out", 1.0, 2.0, 3.0)
        await rig.tick()
        assert rig.values("b.input") == [3.0]
        assert rig.values("a.out") == [1.0, 2.0, 3.0]


async def test_advance_runs_every_tick_that_is_due() -> None:
    async with Rig(Plant(), rate=100.0) as rig:
        await rig.advance(0.5)
        assert rig.context.ticks == 50
        assert rig.times("position") == [n / 100 for n in range(1, 51)]
        await rig.advance(0.005)
        assert (rig.context.ticks, rig.clock.monotonic_ns()) == (50, 505_000_000)
        await rig.tick()
        assert rig.clock.monotonic_ns() == 510_000_000


@pytest.mark.slow(kept_by="first")
async def test_ticks_of_a_rate_do_not_drift() -> None:
    async with Rig(Plant(), rate=3.0) as rig:
        await rig.tick(300)
        assert rig.clock.monotonic_ns() == 100 * 10**9


async def test_advance_gives_every_kind_of_context_its_time() -> None:
    async with Rig(Plant(), context=PeriodicContext(50.0)) as rig:
        await rig.advance(1)
        assert rig.times("position") == [n / 50 for n in range(1, 51)]


async def test_advance_back_in_time_is_refused() -> None:
    async with Rig(Plant(), rate=3.0) as rig:
        with pytest.raises(ValueError, match="expected 0 or more"):
            await rig.advance(-1.0)


@pytest.mark.parametrize(
    "make", [ExternalContext, lambda: PeriodicContext(100.0), EventContext, lambda: ThreadContext(100.0)]
)
async def test_one_test_serves_every_kind_of_context(make: Any) -> None:
    context: Context = make()
    async with Rig(PlainEcho(), context=context) as rig:
        for number in range(1, 4):
            rig.feed("input", number, -number)
            await rig.tick()
        assert rig.values("output") == [1, -1, 2, -2, 3, -3]
        if context.rate is not None:
            assert rig.times("output") == [0.01, 0.01, 0.02, 0.02, 0.03, 0.03]


async def test_hook_that_waits_gets_the_virtual_time_it_needs() -> None:
    async with Rig(faults.Slow("on_execute", 0.25), Plant()) as rig:
        await rig.tick(2)
        assert rig.times("position") == [0.25, 0.5]


async def test_hook_that_waits_at_the_end_gets_its_time_too() -> None:
    async with Rig(faults.Slow("on_deactivated", 0.5), faults.Slow("on_shutdown", 1.0), Plant()) as rig:
        await rig.tick()
    assert rig.failures == ()
    assert rig.clock.monotonic_ns() == 1_500_000_000


async def test_failure_is_raised_by_the_tick_it_happened_in() -> None:
    async with Rig(faults.Failing("on_execute", ValueError("no camera"), after=1, name="cam")) as rig:
        await rig.tick()
        with pytest.raises(ValueError, match="no camera"):
            await rig.tick()
        await rig.tick()
        assert [failure.component for failure in rig.failures] == ["cam"]


async def test_an_await_that_is_missing_is_raised_with_hook_line_and_remedy() -> None:
    class Lazy(Component):
        out = OutPort(TimedLong)

        async def on_execute(self) -> None:
            self.out.write(TimedLong(0, 1))  # type: ignore[unused-coroutine]

        async def on_deactivated(self) -> None:
            self.sleep(1.0)  # type: ignore[unused-coroutine]

    said = r"^lazy0.on_execute: .*test_rig.py:\d+: OutPort.write was never awaited and did nothing; use write_nowait"
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        async with Rig(Lazy("lazy0"), Lazy("lazy1")) as rig:
            with pytest.raises(ComponentError, match=said):
                await rig.tick()
            with pytest.raises(ComponentError, match=r"lazy0.on_deactivated: .* Component.sleep was never awaited"):
                await rig.deactivate()
        assert warned == []
        async with Rig(Lazy("lazy0"), strict=False) as rig:
            await rig.tick()
            rig.tick()  # type: ignore[unused-coroutine]
        texts = [str(one.message) for one in warned]
    assert [text.split("'")[1] for text in texts] == ["OutPort.write", "Rig.tick", "Component.sleep"]
    assert warnings.showwarning.__module__ != "aiorts.diagnostics.unawaited"


async def test_failure_of_another_kind_than_an_exception_is_wrapped() -> None:
    async with Rig(faults.Failing("on_execute", KeyboardInterrupt(), name="cam")) as rig:
        with pytest.raises(ComponentError, match=r"cam\.on_execute: raised KeyboardInterrupt") as caught:
            await rig.tick()
        assert isinstance(caught.value.__cause__, KeyboardInterrupt)


async def test_expected_error_is_caught_and_told() -> None:
    async with Rig(faults.Failing("on_execute", OSError("gone"), times=1)) as rig:
        with rig.expect_error(OSError) as caught:
            await rig.tick()
        assert str(caught.error) == "gone"
        assert rig.context.state(rig.components[0]) is LifecycleState.ERROR
        await rig.reset()
        await rig.activate()
        await rig.tick()


async def test_expected_error_that_does_not_come_fails_the_test() -> None:
    async with Rig(Plant()) as rig:
        with (
            pytest.raises(AssertionError, match="expected a hook to fail with OSError, none failed"),
            rig.expect_error(OSError),
        ):
            await rig.tick()


async def test_unexpected_error_is_raised_as_it_is() -> None:
    async with Rig(faults.Failing("on_execute", OSError("gone"), times=1)) as rig:
        with pytest.raises(OSError, match="gone"), rig.expect_error(ValueError):
            await rig.tick()


async def test_lenient_rig_goes_on() -> None:
    async with Rig(faults.Failing("on_execute"), Plant(), strict=False) as rig:
        await rig.tick(3)
        assert len(rig.values("position")) == 3
        assert len(rig.failures) == 1


async def test_failure_on_the_way_in_or_out_is_raised() -> None:
    with pytest.raises(OSError, match="no device"):
        async with Rig(faults.Failing("on_activated", OSError("no device"))):
            pass
    with pytest.raises(OSError, match="no device"):
        async with Rig(faults.Failing("on_initialize", OSError("no device"))):
            pass
    with pytest.raises(OSError, match="stuck"):
        async with Rig(faults.Failing("on_deactivated", OSError("stuck"))) as rig:
            await rig.tick()


async def test_failing_activation_can_be_expected() -> None:
    async with Rig(faults.Failing("on_activated", OSError("no device")), activate=False) as rig:
        with rig.expect_error(OSError):
            await rig.activate()


async def test_port_added_while_running_is_heard_from_its_first_sample() -> None:
    class Grows(Component):
        def on_execute(self) -> None:
            port = self.add_port(f"out{self.context.ticks}", OutPort(TimedLong))
            port.write_nowait(TimedLong(0, self.context.ticks))

    async with Rig(Grows()) as rig:
        await rig.tick(2)
        assert (rig.values("out1"), rig.values("out2")) == ([1], [2])


async def test_port_with_one_connector_can_be_connected_and_then_not_be_heard() -> None:
    class Narrow(Component):
        out = OutPort(TimedDouble, max_connectors=1)

    async with Rig(Narrow("narrow0"), Pipe("pipe0")) as rig:
        rig.feed("narrow0.out", 1.0)
        assert rig.values("narrow0.out") == [1.0]
        rig.connect("narrow0.out", "pipe0.input")
        rig.feed("narrow0.out", 2.0)
        assert rig.values("pipe0.input") == [2.0]
        with pytest.raises(WiringError, match=r"narrow0\.out: all 1 connectors are used"):
            rig.values("narrow0.out")


async def test_port_is_found_by_name_path_or_itself_and_said_to_be_unknown() -> None:
    pipe = Pipe("a")
    async with Rig(pipe, Pipe("b")) as rig:
        assert rig.port("a.out") is rig.port(pipe.out) is pipe.out
        with pytest.raises(WiringError, match=r"out: 2 ports have this name; there are a\.out, b\.out"):
            rig.port("out")
        with pytest.raises(WiringError, match="speed: no ports have this name"):
            rig.feed("speed", 1.0)
        with pytest.raises(WiringError, match=r"in-port; only what an out-port writes has a time"):
            rig.times("a.input")


async def test_rig_is_used_open_and_once() -> None:
    rig = Rig(Plant())
    with pytest.raises(ClosedError, match="is not open"):
        rig.feed("position", 1.0)
    async with rig:
        pass
    with pytest.raises(StateError, match="was opened already"):
        async with rig:
            pass
    with pytest.raises(ValueError, match=r"rate=5\.0: is for contexts that are ticked"):
        Rig(Plant(), rate=5.0, context=EventContext())


@pytest.mark.fault("A16")
async def test_port_used_in_another_thread_is_found() -> None:
    class Strays(Component):
        out = OutPort(TimedLong)

        def on_execute(self) -> None:
            errors: list[BaseException] = []

            def write() -> None:
                try:
                    self.out.write_nowait(TimedLong(0, 1))
                except ThreadError as error:
                    errors.append(error)

            thread = threading.Thread(target=write, name="stray")
            thread.start()
            thread.join()
            raise errors[0]

    async with Rig(Strays("strays0")) as rig:
        with pytest.raises(ThreadError, match=r"strays0\.out: used from thread 'stray'"):
            await rig.tick()


async def test_debug_mode_copies_what_is_written() -> None:
    async with Rig(faults.Aliasing()) as rig:
        await rig.tick(2)
        assert [list(value) for value in rig.values("out")] == [[0.0, 0.0, 0.0]] * 2


async def test_sample_changed_after_it_was_written_is_found() -> None:
    async with Rig(faults.Aliasing()) as rig:
        with pytest.raises(StateError, match="debug mode copies"):
            rig.find_aliasing()
    async with Rig(faults.Aliasing(name="liar"), Plant(), debug=False) as rig:
        await rig.tick(2)
        found = rig.find_aliasing()
        assert len(found) == 2
        assert found[1].startswith("liar.out: sample 1: TimedDoubleSeq.data[0]: '2.0 (bytes")


async def test_find_aliasing_says_nothing_of_an_honest_writer() -> None:
    class Honest(Component):
        out = OutPort(TimedDoubleSeq)

        def on_execute(self) -> None:
            self.out.write_nowait(TimedDoubleSeq(0, np.arange(3.0)))

    async with Rig(Honest(), debug=False) as rig:
        await rig.tick(3)
        assert rig.find_aliasing() == []


async def test_given_clock_is_used() -> None:
    clock = SimulatedClock(start_ns=1_000)
    async with Rig(Pipe(), clock=clock) as rig:
        rig.feed("input", 1.0)
        assert rig.clock is rig.kernel.clock is clock
        assert rig.received("input") == [TimedDouble(1_000, 1.0)]


async def _play() -> list[tuple[float, float]]:
    async with Rig(Plant("plant0"), Pid("pid0"), faults.Slow("on_execute", 0.003), rate=100.0) as rig:
        rig.connect("position", "measured", subscription="periodic", push_rate=40.0)
        rig.connect("command", "input", subscription="new")
        await rig.advance(0.3)
        return list(zip(rig.times("position"), rig.values("position"), strict=True))


@pytest.mark.slow(kept_by="test_one_test_serves_every_kind_of_context")
def test_every_loop_plays_the_same() -> None:
    """The standard loop and the fastest there is, both moved by hand, and the simulated loop."""
    played = [run(_play(), loop="asyncio"), run(_play(), loop="auto"), simulate(_play())]
    assert len(played[0]) == 30
    assert played[1] == played[0]
    assert played[2] == played[0]
