"""Calls through service ports: answers, deadlines, cancellation, failures told, providers that go."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts import Component, ExternalContext, Kernel, PeriodicContext, Provided, Required
from aiorts.clock import current_clock
from aiorts.errors import (
    AiortsError,
    HookAbandoned,
    InterfaceMismatch,
    ServiceError,
    ServiceFailed,
    ServiceTimeout,
    ServiceUnavailable,
)
from aiorts.events import CallFailed, ServiceCalled
from aiorts.kernel.execution.cell import cell
from aiorts.model.lifecycle import LifecycleState
from aiorts.testing import simulated
from campaign import CAMPAIGN
from services.parts import Arm, Brake, PlainBrake, Quick, Scripted, forever, ignoring_cancellation, wired

LATE = 0.1 if CAMPAIGN else 2.0  # seconds; a machine that runs the whole suite is late at times


def now() -> float:
    return asyncio.get_running_loop().time()


@pytest.mark.row(67)
@simulated
async def test_a_call_goes_to_the_provider_and_its_answer_comes_back() -> None:
    async with Kernel() as kernel:
        brake = PlainBrake()
        arm = await wired(kernel, brake)
        assert await arm.brake.proxy.stop(8.0) == 4.0
        assert await arm.brake.proxy.stop() == 0.5
        assert await arm.brake.proxy.stop(force=3.0) == 1.5
        assert await arm.brake.proxy.held() is True
        assert brake.forces == [8.0, 1.0, 3.0]


@simulated
async def test_the_provider_may_wait_and_time_passes() -> None:
    async def slowly(brake: Scripted) -> float:
        await brake.sleep(0.25)
        return 7.0

    async with Kernel() as kernel:
        arm = await wired(kernel, Scripted(slowly))
        begun = now()
        assert await arm.brake.proxy.stop() == 7.0
        assert now() - begun == pytest.approx(0.25)


@simulated
async def test_a_plain_method_of_the_interface_is_not_awaited() -> None:
    class Counter(Component):
        service = Provided[Quick]()

        def count(self) -> int:
            return 42

    class Asking(Component):
        counter = Required[Quick]()

    async with Kernel() as kernel:
        asking, counter = await kernel.add(Asking()), await kernel.add(Counter())
        await kernel.connect(asking.counter, counter.service)
        assert asking.counter.proxy.count() == 42


@pytest.mark.row(69)
@simulated
async def test_every_call_has_a_deadline_of_its_own() -> None:
    """OpenRTM has one time-out for the whole process, and a hanging servant hangs the caller until then."""
    async with Kernel() as kernel:
        brake = Scripted(forever)
        arm = await wired(kernel, brake)
        for seconds in (0.05, 0.5):
            begun = now()
            with pytest.raises(ServiceTimeout, match=r"arm\.brake -> brake0\.service\.stop: brake0 did not answer"):
                await arm.brake.within(seconds).stop()
            assert now() - begun == pytest.approx(seconds, abs=1e-6)
        begun = now()
        with pytest.raises(TimeoutError):
            await arm.brake.proxy.stop()
        assert now() - begun == pytest.approx(1.0, abs=1e-6)
        await kernel.sleep(0)
        assert brake.notes == ["begun", "cancelled"] * 3
        assert arm.brake.statistics.timeouts == 3


@pytest.mark.row(69)
@simulated
async def test_a_cancelled_caller_cancels_the_method_and_nobody_else() -> None:
    async with Kernel() as kernel:
        brake = Scripted(forever)
        arm = await wired(kernel, brake)
        calling = asyncio.ensure_future(arm.brake.proxy.stop())
        await kernel.sleep(0.01)
        assert brake.notes == ["begun"]
        calling.cancel()
        with pytest.raises(asyncio.CancelledError):
            await calling
        await kernel.sleep(0.01)
        assert brake.notes == ["begun", "cancelled"]
        assert await arm.brake.proxy.held() is False
        assert arm.brake.statistics.cancelled == 1
        assert cell(brake).entry_lock.open


@pytest.mark.fault("B20")
@simulated
async def test_what_the_provider_raises_reaches_the_caller_with_its_text() -> None:
    async def raising(_: Any) -> float:
        raise ValueError("the pads are worn")

    heard: list[CallFailed] = []
    async with Kernel() as kernel:
        kernel.bus.subscribe(CallFailed, heard.append)
        brake = Scripted(raising)
        arm = await wired(kernel, brake)
        loop = await kernel.start(ExternalContext(), brake, activate=True)
        with pytest.raises(ServiceFailed, match=r"brake0\.service\.stop: raised ValueError: the pads are worn") as told:
            await arm.brake.proxy.stop()
        assert isinstance(told.value.__cause__, ValueError)
        assert isinstance(told.value, ServiceError)
        assert loop.state(brake) is LifecycleState.ACTIVE
        assert [(one.caller, one.provider, one.method) for one in heard] == [("arm.brake", "brake0.service", "stop")]
        assert brake.service.statistics.failures == 1


@pytest.mark.fault("B20")
@simulated
async def test_a_provider_that_is_told_to_fails_with_what_its_method_raises() -> None:
    class Strict(Component):
        service = Provided[Brake](failure="error")

        def stop(self, force: float = 1.0) -> float:
            raise ValueError("worn")

        def held(self) -> bool:
            return False

    async with Kernel() as kernel:
        brake = Strict("brake0")
        arm = await wired(kernel, brake)
        loop = await kernel.start(ExternalContext(), brake, activate=True)
        with pytest.raises(ServiceFailed):
            await arm.brake.proxy.stop()
        await kernel.sleep(0)
        assert loop.state(brake) is LifecycleState.ERROR
        with pytest.raises(ServiceUnavailable, match="error"):
            await arm.brake.proxy.stop()


@pytest.mark.fault("B20")
@simulated
async def test_an_answer_of_a_wrong_type_is_an_error_that_names_both() -> None:
    async def wrong(_: Any) -> Any:
        return "much"

    async with Kernel() as kernel:
        arm = await wired(kernel, Scripted(wrong))
        with pytest.raises(InterfaceMismatch) as told:
            await arm.brake.proxy.stop()
        for part in ("arm.brake", "brake0.service", "str 'much'", "float"):
            assert part in str(told.value)


@pytest.mark.fault("B20")
@simulated
async def test_nobody_there_is_said_at_once() -> None:
    async with Kernel() as kernel:
        arm, brake = await kernel.add(Arm()), await kernel.add(PlainBrake())
        begun = now()
        with pytest.raises(ServiceUnavailable, match=r"arm\.brake\.stop: is not connected"):
            await arm.brake.proxy.stop()
        connector = await kernel.connect(arm.brake, brake.service)
        loop = await kernel.start(ExternalContext(name="loop"), brake)
        with pytest.raises(ServiceUnavailable, match="inactive in loop; activate it"):
            await arm.brake.proxy.stop()
        await loop.activate()
        assert await arm.brake.proxy.stop() == 0.5
        await loop.deactivate()
        with pytest.raises(ServiceUnavailable, match="inactive in loop"):
            await arm.brake.proxy.stop()
        await loop.activate()
        await kernel.disconnect(connector)
        with pytest.raises(ServiceUnavailable, match="is not connected"):
            await arm.brake.proxy.stop()
        assert now() == begun
        assert brake.forces == [1.0]


@simulated
async def test_a_provider_may_answer_in_every_state() -> None:
    class Patient(PlainBrake):
        service = Provided[Brake](always=True)

    async with Kernel() as kernel:
        brake = Patient()
        arm = await wired(kernel, brake)
        await kernel.start(ExternalContext(), brake)
        assert await arm.brake.proxy.stop() == 0.5


@pytest.mark.fault("B20")
@pytest.mark.parametrize("how", ["removed", "disconnected", "closed"])
@simulated
async def test_a_provider_that_vanishes_ends_the_call(how: str) -> None:
    class Leaving(Scripted):
        def on_deactivated(self) -> None:
            """A hook that has to wait until the call is over."""

    brake = Leaving(forever)
    async with Kernel() as kernel:
        arm = await wired(kernel, brake)
        await kernel.start(ExternalContext(), brake, activate=True)
        calling = asyncio.ensure_future(arm.brake.within(60.0).stop())
        await kernel.sleep(0.01)
        begun = now()
        if how == "removed":
            await kernel.remove(brake)
        elif how == "disconnected":
            await kernel.disconnect(arm.brake.connectors[0])
        else:
            await kernel.aclose()
        with pytest.raises(ServiceUnavailable):
            await calling
        # The end of a kernel lets a call that runs go on for as long as a hook may take.
        assert now() - begun < (2.1 if how == "closed" else 0.1)
        await asyncio.sleep(0.01)
        assert brake.notes == ["begun", "cancelled"]


@pytest.mark.fault("B20")
@simulated
async def test_a_late_answer_is_ignored_and_the_next_call_gets_its_own() -> None:
    answers = iter([1.0, 2.0])

    async def late(brake: Scripted) -> float:
        answer = next(answers)
        if answer == 1.0:
            try:
                await brake.sleep(10.0)
            except asyncio.CancelledError:
                await brake.sleep(0.2)  # and answers all the same
        return answer

    async with Kernel() as kernel:
        brake = Scripted(late)
        arm = await wired(kernel, brake)
        with pytest.raises(ServiceTimeout):
            await arm.brake.within(0.1).stop()
        begun = now()
        assert await arm.brake.proxy.stop() == 2.0
        assert now() - begun == pytest.approx(0.2, abs=1e-3)


@pytest.mark.fault("B20")
@simulated
async def test_a_method_that_ignores_cancellation_is_left_behind_and_blocks_nobody() -> None:
    free, stubborn = ignoring_cancellation()

    async with Kernel() as kernel:
        brake = Scripted(stubborn)
        arm = await wired(kernel, brake)
        other = await kernel.add(PlainBrake("other"))
        loop = await kernel.start(PeriodicContext(100.0), brake, other, activate=True)
        with pytest.raises(ServiceTimeout):
            await arm.brake.within(0.1).stop()
        with pytest.raises(ServiceTimeout, match=r"busy in service\.stop, called by arm\.brake"):
            await arm.brake.within(0.1).stop()
        await kernel.sleep(3.0)
        assert isinstance(brake.last_error, HookAbandoned)
        assert loop.state(brake) is LifecycleState.ERROR
        ticks = loop.ticks
        await kernel.sleep(0.1)
        assert loop.ticks - ticks == 10
        with pytest.raises(ServiceUnavailable, match="abandoned"):
            await arm.brake.proxy.stop()
        free.set()


@pytest.mark.fault("B20")
@simulated
async def test_a_kernel_closes_in_time_though_a_method_ignores_everything() -> None:
    free, stubborn = ignoring_cancellation()

    class Leaving(Scripted):
        def on_deactivated(self) -> None:
            self.notes.append("deactivated")

    kernel = await Kernel().open()
    brake = Leaving(stubborn)
    arm = await wired(kernel, brake)
    await kernel.start(PeriodicContext(100.0), brake, arm, activate=True)
    calling = asyncio.ensure_future(arm.brake.within(60.0).stop())
    await kernel.sleep(0.1)
    begun = now()
    await kernel.aclose()
    assert now() - begun <= 5.0
    with pytest.raises(ServiceUnavailable, match="is being removed"):
        await calling
    free.set()


@simulated
async def test_what_a_method_starts_belongs_to_its_own_component_and_not_to_who_called() -> None:
    class Starting(PlainBrake):
        def stop(self, force: float = 1.0) -> float:
            self.task = asyncio.ensure_future(self.later())
            return force

        async def later(self) -> None:
            await self.sleep(0.1)
            raise ValueError("later")

    class Calling(Arm):
        async def on_execute(self) -> None:
            await self.brake.proxy.stop()
            self.finish()

    async with Kernel() as kernel:
        brake, calling = await kernel.add(Starting()), await kernel.add(Calling())
        await kernel.connect(calling.brake, brake.service)
        loop = await kernel.start(PeriodicContext(100.0), brake, calling, activate=True)
        await kernel.sleep(1.0)
        assert loop.state(brake) is LifecycleState.ERROR
        assert calling.last_error is None


@simulated
async def test_arguments_that_the_interface_does_not_have_are_the_callers_fault() -> None:
    async with Kernel() as kernel:
        brake = PlainBrake()
        arm = await wired(kernel, brake)
        ask: Any = arm.brake.proxy
        with pytest.raises(TypeError, match=r"brake0\.service\.stop\(force: float = 1\.0\): .*'strength'"):
            await ask.stop(strength=1.0)
        assert brake.service.statistics.failures == 0


@simulated
async def test_calls_are_counted_and_told_to_those_who_ask() -> None:
    heard: list[ServiceCalled] = []
    everything: list[Any] = []

    async def slowly(brake: Scripted) -> float:
        await brake.sleep(0.5)
        return 1.0

    async with Kernel() as kernel:
        arm = await wired(kernel, Scripted(slowly))
        from aiorts.events import Event

        kernel.bus.subscribe(Event, everything.append)
        await arm.brake.proxy.stop()
        stop = kernel.bus.subscribe(ServiceCalled, heard.append)
        await arm.brake.proxy.stop()
        stop()
        await arm.brake.proxy.stop()
        assert [(one.method, one.elapsed_ns, one.error) for one in heard] == [("stop", 500_000_000, None)]
        assert everything == []
        counts = arm.brake.statistics
        assert (counts.calls, counts.max_ns, counts.mean_ns) == (3, 500_000_000, 500_000_000)


@simulated
async def test_waiting_until_somebody_is_there() -> None:
    async with Kernel() as kernel:
        arm, brake = await kernel.add(Arm()), await kernel.add(PlainBrake())
        waiting = asyncio.ensure_future(arm.brake.wait_bound())
        through_port = asyncio.ensure_future(arm.ports["brake"].wait_bound())  # type: ignore[attr-defined]
        await kernel.sleep(0.1)
        assert not waiting.done()
        await kernel.connect(arm.brake, brake.service)
        await waiting
        await through_port
        await arm.brake.wait_bound()
        await kernel.disconnect(arm.brake.connectors[0])
        waiting = asyncio.ensure_future(arm.brake.wait_bound())
        await kernel.sleep(0.1)
        arm.remove_port("brake")
        with pytest.raises(AiortsError):
            await waiting


@pytest.mark.slow
@pytest.mark.fault("B20")
@pytest.mark.anyio
async def test_the_five_ways_to_fail_in_real_time(anyio_backend: Any) -> None:
    """Raises, hangs, vanishes, answers with a wrong type, absent: each told within 100 ms of its deadline."""

    async def raises(_: Any) -> float:
        raise RuntimeError("worn")

    async def wrong(_: Any) -> Any:
        return None

    assert current_clock() is None
    async with Kernel() as kernel:
        arm = await kernel.add(Arm())
        with pytest.raises(ServiceUnavailable):
            await arm.brake.proxy.stop()
        for script, kind, seconds in (
            (raises, ServiceFailed, 0.0),
            (wrong, InterfaceMismatch, 0.0),
            (forever, ServiceTimeout, 0.2),
        ):
            brake = await kernel.add(Scripted(script, kind.__name__))
            connector = await kernel.connect(arm.brake, brake.service)
            begun = now()
            with pytest.raises(kind):
                await arm.brake.within(0.2).stop()
            assert -0.002 <= now() - begun - seconds <= LATE
            await kernel.disconnect(connector)
        gone = await kernel.add(Scripted(forever, "gone"))
        await kernel.connect(arm.brake, gone.service)
        calling = asyncio.ensure_future(arm.brake.within(10.0).stop())
        await asyncio.sleep(0.02)
        begun = now()
        await kernel.remove(gone)
        with pytest.raises(ServiceUnavailable):
            await calling
        assert now() - begun <= LATE


@simulated
async def test_what_a_served_method_logs_says_which(caplog: pytest.LogCaptureFixture) -> None:
    class Talking(PlainBrake):
        def stop(self, force: float = 1.0) -> float:
            self.log.warning("braking")
            return force

    async with Kernel() as kernel:
        arm = await wired(kernel, Talking())
        await arm.brake.proxy.stop()
    said = next(record for record in caplog.records if record.getMessage() == "braking")
    assert (said.component, said.hook) == ("brake0", "service.stop")  # type: ignore[attr-defined]


@pytest.mark.fault("B20")
@pytest.mark.parametrize("fault", ["raises", "hangs", "vanishes", "wrong type", "absent"])
@simulated
async def test_each_way_a_provider_can_fail_is_a_typed_error_by_the_deadline(fault: str) -> None:
    async def script(brake: Any) -> Any:
        if fault == "raises":
            raise ValueError("worn")
        if fault == "hangs":
            await asyncio.Event().wait()
        if fault == "vanishes":
            removing.append(asyncio.ensure_future(kernel.remove(brake)))
            await asyncio.Event().wait()
        return "much"

    removing: list[asyncio.Future[None]] = []
    kinds = {
        "raises": (ServiceFailed, "ValueError: worn", 0.0),
        "hangs": (ServiceTimeout, "did not answer within 0.5 s", 0.5),
        "vanishes": (ServiceUnavailable, "is being removed", 0.0),
        "wrong type": (InterfaceMismatch, "answered with str 'much'", 0.0),
        "absent": (ServiceUnavailable, "is not connected", 0.0),
    }
    async with Kernel() as kernel:
        brake = Scripted(script)
        arm = await wired(kernel, brake)
        loop = await kernel.start(PeriodicContext(100.0), brake, activate=True)
        if fault == "absent":
            await kernel.disconnect(arm.brake.connectors[0])
        kind, text, after = kinds[fault]
        begun = now()
        with pytest.raises(kind, match=text):
            await arm.brake.within(0.5).stop()
        assert now() - begun == pytest.approx(after, abs=0.1)
        await asyncio.gather(*removing)
        cycles = loop.ticks
        await kernel.sleep(0.1)
        assert fault == "vanishes" or loop.ticks - cycles >= 9
