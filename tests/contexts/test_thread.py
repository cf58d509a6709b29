"""Thread contexts: hooks that block, in one thread of their own, and how that thread ends."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable

import pytest

from aiorts import Component, InPort, Kernel, LifecycleState, OutPort, Param, PeriodicContext, SimulatedClock
from aiorts.contexts.thread import ThreadContext
from aiorts.errors import ClosedError, ComponentError, HookAbandoned, StateError
from aiorts.kernel.loop.bus import Event, HookFailed, StateChanged
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from contexts.parts import Doer, Idle, Reader, Sender, Ticker

pytestmark = pytest.mark.anyio


class Plain(Component):
    """Every hook is a plain function that notes its thread."""

    def __init__(self, name: str = "", execute: Callable[[], None] | None = None) -> None:
        super().__init__(name)
        self.execute = execute
        self.threads: list[tuple[str, int]] = []

    def _note(self, hook: str) -> None:
        self.threads.append((hook, threading.get_ident()))

    def on_initialize(self) -> None:
        self._note("initialize")

    def on_startup(self) -> None:
        self._note("startup")

    def on_activated(self) -> None:
        self._note("activated")

    def on_execute(self) -> None:
        self._note("execute")
        if self.execute is not None:
            self.execute()

    def on_deactivated(self) -> None:
        self._note("deactivated")

    def on_rate_changed(self) -> None:
        self._note("rate")

    def on_shutdown(self) -> None:
        self._note("shutdown")

    def on_finalize(self) -> None:
        self._note("finalize")


class Device(Component):
    """Blocks for a request, answers it."""

    input = InPort(TimedLong)
    output = OutPort(TimedLong)

    def on_execute(self) -> None:
        sample = self.input.read_blocking()
        self.output.write_blocking(TimedLong(sample.tm, -sample.data))


async def until(done: Callable[[], bool], seconds: float = 5.0) -> None:
    """Wait for something that a thread does in real time."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it did not happen in time"
        await asyncio.sleep(0.002)


async def test_all_hooks_of_the_context_run_in_one_thread_of_its_own_and_the_others_on_the_loop() -> None:
    async with Kernel() as kernel:
        plain, other = await kernel.add(Plain("plain")), await kernel.add(Plain("other"))
        context = await kernel.start(ThreadContext(200.0), plain, other, activate=True)
        await context.set_rate(500.0)
        await until(lambda: len(plain.threads) > 10)
        await context.stop()
        assert not [thread for thread in threading.enumerate() if thread.name.startswith("aiorts")]
    here = threading.get_ident()
    for component in (plain, other):
        on_loop = {hook for hook, thread in component.threads if thread == here}
        assert on_loop == {"initialize", "finalize"}
        assert {hook for hook, _ in component.threads} == {
            *on_loop,
            *("startup", "activated", "execute", "rate", "deactivated", "shutdown"),
        }
    assert len({thread for _, thread in plain.threads + other.threads}) == 2


@pytest.mark.slow(kept_by="test_all_hooks_of_the_context_run_in_one_thread_of_its_own_and_the_others_on_the_loop")
async def test_a_hook_that_blocks_its_thread_does_not_hold_up_the_loop() -> None:
    async with Kernel() as kernel:
        blocker = await kernel.add(Plain("blocker", lambda: time.sleep(0.4)))
        ticker = await kernel.add(Ticker("ticker"))
        await kernel.start(ThreadContext(), blocker, activate=True)
        await kernel.start(PeriodicContext(100.0), ticker, activate=True)
        await asyncio.sleep(0.3)
        assert len(ticker.begun) >= 20


@pytest.mark.slow(kept_by="first")
async def test_blocking_reads_and_writes_cross_between_thread_and_loop() -> None:
    async with Kernel() as kernel:
        device, sender, reader = (
            await kernel.add(Device("device")),
            await kernel.add(Sender("sender")),
            await kernel.add(Reader("reader")),
        )
        await kernel.connect(sender.output, device.input, length=1000)
        connector = await kernel.connect(device.output, reader.input, full="block", length=4, timeout=None)
        await kernel.start(ThreadContext(), device, activate=True)
        await kernel.start(PeriodicContext(1000.0), reader, activate=True)
        sender.send(*range(500))
        await until(lambda: sum(map(len, reader.runs)) == 500)
        assert [value for run in reader.runs for value in run] == [-value for value in range(500)]
        assert connector.statistics.dropped == {}


async def test_an_async_hook_is_refused_with_its_name() -> None:
    async with Kernel() as kernel:
        doer, plain = await kernel.add(Doer("doer")), await kernel.add(Plain("plain"))
        with pytest.raises(
            StateError, match=r"doer: on_activated, on_deactivated, on_execute, on_reset is `async def`"
        ):
            await kernel.start(ThreadContext(), doer)
        context = await kernel.start(ThreadContext(), plain)
        with pytest.raises(StateError, match="plain `def`"):
            await context.add(doer)
        assert context.members == (plain,)


async def test_a_component_of_a_thread_context_is_in_no_other() -> None:
    async with Kernel() as kernel:
        plain, idle = await kernel.add(Plain("plain")), await kernel.add(Idle("idle"))
        thread = await kernel.start(ThreadContext(), plain)
        other = await kernel.start(PeriodicContext(10.0), idle)
        with pytest.raises(StateError, match="is in no other"):
            await other.add(plain)
        with pytest.raises(StateError, match="is in no other"):
            await thread.add(idle)


async def test_stop_wakes_a_read_that_blocks_and_a_write_that_blocks() -> None:
    class Stuffed(Component):
        output = OutPort(TimedLong)

        def on_execute(self) -> None:
            self.output.write_blocking(TimedLong(0, 1))

    async with Kernel() as kernel:
        device, stuffed, sink = (
            await kernel.add(Device("device")),
            await kernel.add(Stuffed("stuffed")),
            await kernel.add(Reader("sink")),
        )
        await kernel.connect(stuffed.output, sink.input, full="block", length=1, timeout=None)
        contexts = [await kernel.start(ThreadContext(), component, activate=True) for component in (device, stuffed)]
        await asyncio.sleep(0.05)
        began = time.monotonic()
        for context in contexts:
            await context.stop()
        assert time.monotonic() - began < 1.0
        assert device.last_error is None
        assert stuffed.last_error is None


async def test_blocking_calls_outside_of_a_thread_context_are_refused() -> None:
    async with Kernel() as kernel:
        device = await kernel.add(Device("device"))
        with pytest.raises(StateError, match="would block the event loop"):
            device.input.read_blocking()
        with pytest.raises(StateError, match="would block the event loop"):
            device.output.write_blocking(TimedLong(0, 1))


async def test_an_error_in_the_thread_moves_the_component_to_error_and_is_told_on_the_loop() -> None:
    def fail() -> None:
        raise ValueError("no camera")

    heard: list[tuple[Event, int]] = []
    async with Kernel() as kernel:
        kernel.bus.subscribe(Event, lambda event: heard.append((event, threading.get_ident())))
        plain = await kernel.add(Plain("plain", fail))
        context = await kernel.start(ThreadContext(100.0, name="cam"), plain, activate=True)
        await until(lambda: context.state(plain) is LifecycleState.ERROR)
        await asyncio.sleep(0.02)
        await context.reset(plain)
        assert context.state(plain) is LifecycleState.INACTIVE
        assert isinstance(plain.last_error, ValueError)
        assert plain.last_error.__traceback__ is not None
    told = [event for event, _ in heard]
    assert {thread for _, thread in heard} == {threading.get_ident()}
    assert [event.hook for event in told if isinstance(event, HookFailed)] == ["on_execute"]
    assert StateChanged("plain", "cam", LifecycleState.ACTIVE, LifecycleState.ERROR) in told


async def test_without_a_rate_one_in_error_is_told_once_and_the_thread_rests() -> None:
    class Failing(Component):
        told: int = 0

        def on_execute(self) -> None:
            raise ValueError("no")

        def on_error(self, error: BaseException) -> None:
            self.told += 1

    async with Kernel() as kernel:
        failing = await kernel.add(Failing("failing"))
        context = await kernel.start(ThreadContext(), failing, activate=True)
        await until(lambda: failing.told > 0)
        cycles = context.statistics.cycles
        await asyncio.sleep(0.05)
        assert failing.told == 1
        assert context.statistics.cycles == cycles


async def test_what_on_activated_raises_reaches_the_one_who_asked() -> None:
    class Broken(Component):
        def on_activated(self) -> None:
            raise OSError("no such device")

    async with Kernel() as kernel:
        broken = await kernel.add(Broken("broken"))
        with pytest.raises(ComponentError, match="no such device"):
            await kernel.start(ThreadContext(), broken, activate=True)


async def test_members_rate_and_parameters_change_while_the_thread_runs() -> None:
    class Tuned(Component):
        gain = Param(1.0, ge=0.0)

        def __init__(self, name: str) -> None:
            super().__init__(name)
            self.seen: list[float] = []

        def on_execute(self) -> None:
            first = self.gain
            time.sleep(0.001)
            self.seen.append(self.gain - first)

    async with Kernel() as kernel:
        tuned, late = await kernel.add(Tuned("tuned")), await kernel.add(Tuned("late"))
        context = await kernel.start(ThreadContext(200.0), tuned, activate=True)
        for number in range(20):
            await tuned.configure(gain=float(number))
            assert tuned.gain == float(number)
        await context.add(late)
        await context.activate(late)
        await until(lambda: len(late.seen) > 3)
        await context.remove(tuned)
        assert context.members == (late,)
        await context.set_rate(1000.0)
        assert context.rate == 1000.0
        assert set(tuned.seen) == {0.0}  # never changed within an execution


async def test_a_context_without_a_rate_can_be_given_one_up_to_its_own_ceiling() -> None:
    async with Kernel() as kernel:
        plain = await kernel.add(Plain("plain"))
        context = await kernel.start(ThreadContext(max_rate=20_000.0), plain)
        assert context.rate is None
        await context.set_rate(15_000.0)
        assert context.rate == 15_000.0


@pytest.mark.slow(
    kept_by="supervision/test_blocking_hooks.py::test_a_start_is_bounded_where_an_activation_hangs_in_a_thread"
)
@pytest.mark.parametrize("virtual", [False, True])
def test_a_hook_that_never_returns_is_left_behind_and_the_kernel_closes(virtual: bool) -> None:
    release = threading.Event()
    began = time.monotonic()

    async def main(*_: SimulatedClock) -> None:
        async with Kernel() as kernel:
            stuck = await kernel.add(Plain("stuck", lambda: void(release.wait())))
            context = await kernel.start(ThreadContext(name="io"), stuck, activate=True)
            while not [hook for hook, _ in stuck.threads if hook == "execute"]:
                await asyncio.sleep(0)
            asked = asyncio.create_task(context.deactivate(timeout=None))
            await asyncio.sleep(0)
        with pytest.raises(ClosedError, match="io: the context has stopped"):
            await asked
        assert isinstance(stuck.last_error, HookAbandoned)
        assert "stuck.on_execute: did not return" in str(stuck.last_error)
        assert "finalize" not in [hook for hook, _ in stuck.threads]  # its hook may still be inside

    try:
        simulate(main) if virtual else asyncio.run(main())
        assert time.monotonic() - began <= 5.0
    finally:
        release.set()


def void(_: object) -> None:
    """Forget a result: a hook returns nothing."""


@pytest.mark.slow(
    kept_by="supervision/test_blocking_hooks.py::test_a_start_is_bounded_where_an_activation_hangs_in_a_thread"
)
def test_an_activation_that_never_returns_does_not_hang_the_one_who_started_the_context() -> None:
    release = threading.Event()

    class Stuck(Component):
        def on_activated(self) -> None:
            release.wait()

    async def main() -> None:
        async with Kernel() as kernel:
            stuck = await kernel.add(Stuck("stuck"))
            starting = asyncio.create_task(kernel.start(ThreadContext(), stuck, activate=True))
            await asyncio.sleep(0.05)
        with pytest.raises(ClosedError):
            await starting

    try:
        asyncio.run(main())
    finally:
        release.set()


async def test_a_thread_context_can_be_started_again() -> None:
    async with Kernel() as kernel:
        device, sender, reader = (
            await kernel.add(Device("device")),
            await kernel.add(Sender("sender")),
            await kernel.add(Reader("reader")),
        )
        await kernel.connect(sender.output, device.input)
        await kernel.connect(device.output, reader.input)
        await kernel.start(PeriodicContext(500.0), reader, activate=True)
        context = ThreadContext()
        for number in range(3):
            await kernel.start(context, device, activate=True)
            sender.send(number)
            await until(lambda number=number: [-number] in reader.runs)  # type: ignore[misc]
            await context.stop()
        # out of its context it is an ordinary component again
        await kernel.connect(sender.output, reader.input)
        assert device.contexts == ()
