"""Calls where one side runs in a thread: served between its cycles, blocked for in its hooks, ended when it stops."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest

from aiorts import (
    Component,
    ExternalContext,
    Kernel,
    PeriodicContext,
    Provided,
    RealtimeContext,
    Required,
    ThreadContext,
)
from aiorts.errors import (
    ClosedError,
    ServiceCycle,
    ServiceError,
    ServiceFailed,
    ServiceTimeout,
    ServiceUnavailable,
    StateError,
    ThreadError,
)
from aiorts.testing import simulated
from services.parts import Arm, Brake, PlainBrake, Quick, Scripted, wired


class Threaded(Component):
    """Serves in the thread of its context; notes in which one, and whether a hook ran meanwhile."""

    service = Provided[Brake]()

    def __init__(self, name: str = "brake0", seconds: float = 0.0) -> None:
        super().__init__(name)
        self.threads: set[int] = set()
        self.seconds = seconds
        self.inside = self.most = self.cycles = 0

    def on_execute(self) -> None:
        self.cycles += 1
        self.inside += 1
        self.most = max(self.most, self.inside)
        self.inside -= 1

    def stop(self, force: float = 1.0) -> float:
        self.threads.add(threading.get_ident())
        if force < 0:
            raise ValueError("negative")
        self.inside += 1
        self.most = max(self.most, self.inside)
        time.sleep(self.seconds)
        self.inside -= 1
        return force * 3

    def held(self) -> bool:
        return self.context is self.contexts[0] and self.state is not None


KINDS = [lambda: ThreadContext(200.0), ThreadContext, lambda: RealtimeContext(200.0, priority=None, lock_memory=False)]
NAMES = ["thread", "freely", "realtime"]


@pytest.mark.slow(kept_by="first")
@pytest.mark.anyio
@pytest.mark.parametrize("make", KINDS, ids=NAMES)
async def test_a_provider_in_a_thread_answers_between_its_cycles_in_that_thread(anyio_backend: Any, make: Any) -> None:
    async with Kernel() as kernel:
        brake = Threaded()
        arm = await wired(kernel, brake)
        context = await kernel.start(make(), brake)
        with pytest.raises(ServiceUnavailable, match="it is inactive"):
            await arm.brake.proxy.stop()
        await context.activate()
        for number in range(20):
            assert await arm.brake.proxy.stop(number) == number * 3
        assert await arm.brake.proxy.held() is True
        with pytest.raises(ServiceFailed, match="ValueError: negative"):
            await arm.brake.proxy.stop(-1.0)
        assert str(context.state(brake)) == "active"
        assert len(brake.threads) == 1
        assert threading.get_ident() not in brake.threads
        assert brake.most == 1
        assert context.statistics.hooks["brake0.service.stop"].count == 21
        await context.stop()
        # In no context its methods are plain application code again.
        assert await arm.brake.proxy.stop() == 3.0
        assert threading.get_ident() in brake.threads


@pytest.mark.slow(kept_by="services/test_service_call.py::test_every_call_has_a_deadline_of_its_own")
@pytest.mark.anyio
async def test_a_thread_that_is_long_in_a_call_costs_the_caller_its_deadline_and_no_more(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        brake = Threaded(seconds=0.3)
        arm = await wired(kernel, brake)
        await kernel.start(ThreadContext(200.0), brake, activate=True)
        begun = time.monotonic()
        first = asyncio.ensure_future(arm.brake.within(5.0).stop(2.0))
        await asyncio.sleep(0.05)
        with pytest.raises(ServiceTimeout):
            await arm.brake.within(0.1).stop(5.0)
        assert time.monotonic() - begun < 0.28
        assert await first == 6.0
        cycles = brake.cycles
        await asyncio.sleep(0.1)
        assert brake.cycles > cycles
        assert brake.service.statistics.timeouts == 1


@pytest.mark.anyio
async def test_what_a_thread_cannot_run_is_refused(anyio_backend: Any) -> None:
    async def quick(_: Any) -> float:
        return 1.0

    async with Kernel() as kernel:
        brake = Scripted(quick)
        await kernel.add(brake)
        with pytest.raises(StateError, match=r"brake0: stop, held is `async def`"):
            await kernel.start(ThreadContext(), brake)

        class Beside(Scripted):
            service = Provided[Brake](concurrent=True)

        beside = Beside(quick, "beside")
        arm = await wired(kernel, beside)
        await kernel.start(ThreadContext(100.0), beside, activate=True)
        assert await arm.brake.proxy.stop() == 1.0
        host = await kernel.add(Component("host"))
        await kernel.start(ThreadContext(100.0), host, activate=True)
        late = host.add_port("late", Provided[Brake](brake))
        other = await kernel.add(Arm("other"))
        await kernel.connect(other.brake, late)
        with pytest.raises(ServiceUnavailable, match="runs in a thread; write `def` there"):
            await other.brake.proxy.stop()


class Blocking(Component):
    """Calls from the thread of its context."""

    brake = Required[Brake]()
    counter = Required[Quick]()

    def __init__(self, name: str = "arm", seconds: float = 1.0) -> None:
        super().__init__(name)
        self.seconds = seconds
        self.outcomes: list[Any] = []

    def on_execute(self) -> None:
        try:
            self.outcomes.append(self.brake.call_blocking(lambda brake: brake.stop(4.0), self.seconds))
        except (ServiceError, ClosedError, ThreadError) as error:
            self.outcomes.append(error)
        self.finish()


class Counter(Component):
    service = Provided[Quick]()

    def count(self) -> int:
        return 42


async def until(done: Any) -> None:
    for _ in range(500):
        if done():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("it did not come to it within 5 s")


@pytest.mark.anyio
async def test_a_hook_in_a_thread_blocks_for_its_answer(anyio_backend: Any) -> None:
    async def slowly(brake: Scripted) -> float:
        await brake.sleep(0.02)
        return 9.0

    async with Kernel() as kernel:
        arm, brake = await kernel.add(Blocking()), await kernel.add(Scripted(slowly))
        await kernel.connect(arm.brake, brake.service)
        loop = await kernel.start(ThreadContext(), arm, activate=True)
        await until(lambda: arm.outcomes)
        assert arm.outcomes == [9.0]
        arm.seconds = 0.005
        await loop.activate()
        await until(lambda: len(arm.outcomes) == 2)
        assert isinstance(arm.outcomes[1], ServiceTimeout)
        assert arm.brake.statistics.calls == 2


@pytest.mark.anyio
async def test_a_plain_method_called_from_a_thread_waits_there(anyio_backend: Any) -> None:
    class Counting(Blocking):
        def on_execute(self) -> None:
            self.outcomes.append(self.counter.proxy.count())
            self.finish()

    class Served(Counter):
        thread = 0

        def count(self) -> int:
            self.thread = threading.get_ident()
            return super().count()

    async with Kernel() as kernel:
        arm, counter = await kernel.add(Counting()), await kernel.add(Served())
        await kernel.connect(arm.counter, counter.service)
        await kernel.start(ThreadContext(), arm, activate=True)
        await until(lambda: arm.outcomes)
        assert arm.outcomes == [42]
        assert counter.thread == threading.get_ident()  # the provider is served on the loop, as ever


@pytest.mark.anyio
async def test_two_threads_call_one_another(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        arm, brake = await kernel.add(Blocking()), await kernel.add(Threaded())
        await kernel.connect(arm.brake, brake.service)
        await kernel.start(ThreadContext(500.0), brake, activate=True)
        await kernel.start(ThreadContext(), arm, activate=True)
        await until(lambda: arm.outcomes)
        assert arm.outcomes == [12.0]


@pytest.mark.anyio
async def test_a_thread_that_would_wait_for_itself_is_told_at_once(anyio_backend: Any) -> None:
    class Both(Blocking):
        service = Provided[Brake]()

        def stop(self, force: float = 1.0) -> float:
            return force

        def held(self) -> bool:
            return False

    async with Kernel() as kernel:
        both = await kernel.add(Both("both"))
        through = await kernel.add(Through("through"))
        await kernel.connect(both.brake, through.service)
        await kernel.connect(through.brake, both.service)
        both.seconds = 30.0
        begun = time.monotonic()
        await kernel.start(ThreadContext(), both, activate=True)
        await until(lambda: both.outcomes)
        assert time.monotonic() - begun < 5.0
        assert isinstance(both.outcomes[0], ServiceFailed)
        assert isinstance(both.outcomes[0].__cause__, ServiceCycle)


class Through(Component):
    service = Provided[Brake]()
    brake = Required[Brake]()

    async def stop(self, force: float = 1.0) -> float:
        return await self.brake.proxy.stop(force)

    async def held(self) -> bool:
        return False


@pytest.mark.anyio
async def test_a_thread_that_waits_for_an_answer_can_be_stopped(anyio_backend: Any) -> None:
    async def never(_: Any) -> float:
        await asyncio.Event().wait()
        return 0.0

    async with Kernel() as kernel:
        arm, brake = await kernel.add(Blocking(seconds=60.0)), await kernel.add(Scripted(never))
        await kernel.connect(arm.brake, brake.service)
        loop = await kernel.start(ThreadContext(), arm, activate=True)
        await until(lambda: brake.notes)
        begun = time.monotonic()
        await loop.stop()
        assert time.monotonic() - begun < 1.0
        assert isinstance(arm.outcomes[0], ClosedError)
        await until(lambda: brake.notes == ["begun", "cancelled"])


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_call_that_is_served_when_the_thread_stops_ends(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        brake = Threaded(seconds=0.2)
        arm = await wired(kernel, brake)
        loop = await kernel.start(ThreadContext(), brake, activate=True)
        calls = [asyncio.ensure_future(arm.brake.within(30.0).stop()) for _ in range(3)]
        await asyncio.sleep(0.05)
        await loop.stop()
        done, late = await asyncio.wait(calls, timeout=2.0)
        assert not late
        outcomes = [call.exception() for call in done]
        assert outcomes.count(None) == 1
        assert sum(isinstance(error, ServiceUnavailable) for error in outcomes) == 2


@pytest.mark.anyio
async def test_only_the_thread_of_a_hook_may_block(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        arm = await wired(kernel, PlainBrake())
        with pytest.raises(StateError, match="only a hook of a ThreadContext"):
            arm.brake.call_blocking(lambda brake: brake.stop())

        def elsewhere() -> None:
            with pytest.raises(StateError, match="only a hook of a ThreadContext"):
                arm.brake.call_blocking(lambda brake: brake.stop())

        await asyncio.to_thread(elsewhere)


@pytest.mark.slow(kept_by="test_what_a_thread_cannot_run_is_refused")
@pytest.mark.anyio
async def test_a_real_time_hook_waits_for_nobody(anyio_backend: Any) -> None:
    class Hurried(Blocking):
        async def on_execute(self) -> None:  # type: ignore[override] # a hook may be either
            try:
                await self.brake.proxy.stop()
            except ThreadError as error:
                self.outcomes.append(error)
            try:
                self.brake.call_blocking(lambda brake: brake.stop())
            except StateError as error:
                self.outcomes.append(error)
            self.finish()

    async with Kernel() as kernel:
        arm, brake = await kernel.add(Hurried()), await kernel.add(PlainBrake())
        await kernel.connect(arm.brake, brake.service)
        await kernel.start(RealtimeContext(100.0, priority=None, lock_memory=False), arm, activate=True)
        await until(lambda: len(arm.outcomes) == 2)
        assert "must not wait" in str(arm.outcomes[0])
        assert brake.forces == []


@simulated
async def test_threads_and_calls_in_virtual_time() -> None:
    """Time stands still while a thread serves, and passes while one blocks for an answer."""

    async def slowly(brake: Scripted) -> float:
        await brake.sleep(2.5)
        return 1.0

    async with Kernel() as kernel:
        slow, quick, arm = await kernel.add(Scripted(slowly)), Threaded("quick"), await kernel.add(Blocking())
        asking = await kernel.add(Arm("asking"))
        await kernel.add(quick)
        await kernel.connect(arm.brake, slow.service)
        await kernel.connect(asking.brake, quick.service)
        arm.seconds = 10.0
        begun = asyncio.get_running_loop().time()
        await kernel.start(ThreadContext(10.0), quick, activate=True)
        await kernel.start(ThreadContext(), arm, activate=True)
        assert await asking.brake.proxy.stop(5.0) == 15.0
        assert asyncio.get_running_loop().time() - begun < 0.2
        await kernel.sleep(2.6)
        assert arm.outcomes == [1.0]
        arm.seconds = 0.5


@simulated
async def test_a_component_goes_from_a_thread_to_the_loop_and_is_serialised_there() -> None:
    async with Kernel() as kernel:
        brake = Threaded()
        arm = await wired(kernel, brake)
        first = await kernel.start(ThreadContext(100.0), brake, activate=True)
        assert await arm.brake.proxy.stop(1.0) == 3.0
        await first.remove(brake)
        loop = await kernel.start(PeriodicContext(100.0), brake, activate=True)
        assert await arm.brake.proxy.stop(1.0) == 3.0
        assert len(brake.threads) == 2
        other = await kernel.start(ExternalContext(), brake)
        await other.stop()
        await loop.stop()
