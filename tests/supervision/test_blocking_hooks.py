"""A hook that blocks its thread is held to its deadline when it returns; one that hangs already is reached, too."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import (
    Component,
    Composite,
    Context,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    Param,
    PeriodicContext,
    RealtimeContext,
    Supervision,
    ThreadContext,
)
from aiorts.clock import ScaledClock
from aiorts.errors import (
    ComponentError,
    ConfigurationError,
    HookAbandoned,
    HookTimeout,
    ReadTimeout,
    TransitionTimeout,
)
from aiorts.testing import simulated
from aiorts.types import TimedLong

if TYPE_CHECKING:
    from aiorts import SimulatedClock

LIMIT = 0.1
BLOCKS = 0.3


class Blocker(Component):
    """Keeps its thread in one hook, once."""

    input = InPort(TimedLong)

    def __init__(self, name: str = "", where: str = "on_execute") -> None:
        super().__init__(name)
        self.where = where
        self.blocks = BLOCKS
        self.ran = 0

    def _maybe(self, hook: str) -> None:
        if self.where == hook:
            self.where = ""
            time.sleep(self.blocks)

    def on_activated(self) -> None:
        self._maybe("on_activated")

    def on_execute(self) -> None:
        self.ran += 1
        self._maybe("on_execute")

    def on_state_update(self) -> None:
        self._maybe("on_state_update")


class AsyncBlocker(Blocker):
    """The same, with a hook that could wait and does not."""

    async def on_execute(self) -> None:  # type: ignore[override] # both are hooks
        Blocker.on_execute(self)


class Counter(Component):
    """Counts its cycles."""

    ran = 0

    def on_execute(self) -> None:
        self.ran += 1


async def until(done: Callable[[], Any], seconds: float = 10.0) -> None:
    """Wait for something that happens in real time."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it did not happen in time"
        await asyncio.sleep(0.005)


def assert_late(component: Component, hook: str, limit: float = LIMIT) -> None:
    """It is in error for the deadline of this hook, and told so that one knows what to do."""
    error = component.last_error
    assert isinstance(error, HookTimeout), error
    assert str(error).startswith(f"{component.name}.{hook}: returned after 0.")
    assert f"its deadline is {limit:g} s" in str(error)
    assert list(component.states.values()).count(LifecycleState.ERROR) >= 1


CONTEXTS: dict[str, Callable[..., Context]] = {
    "periodic": lambda **more: PeriodicContext(100.0, **more),
    "thread": lambda **more: ThreadContext(100.0, **more),
    "free thread": lambda **more: ThreadContext(**more),
    "realtime": lambda **_: RealtimeContext(100.0, priority=None, lock_memory=False),
}


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.parametrize(
    ("kind", "how", "where"),
    [
        (kind, how, where)
        for kind in CONTEXTS
        for how, where in (
            ("component", "on_activated"),
            ("component", "on_execute"),
            ("hook", "on_state_update"),
            ("context", "on_execute"),
        )
        if (kind, how) != ("realtime", "context")  # that is its cycle's: what is over it is an overrun
    ],
)
async def test_a_hook_that_blocks_longer_than_its_deadline_is_an_error_when_it_returns(
    kind: str, how: str, where: str
) -> None:
    async with Kernel() as kernel:
        blocker, other = await kernel.add(Blocker("blocker", where)), await kernel.add(Counter("other"))
        if how != "context":
            limits = {"component": Supervision(deadline=LIMIT), "hook": Supervision(deadlines={where: LIMIT})}
            kernel.supervise(blocker, limits[how])
        context = CONTEXTS[kind](**({"deadline": LIMIT} if how == "context" else {}))
        await kernel.start(context, blocker, other)
        await context.activate(other)
        asked = asyncio.create_task(context.activate(blocker))
        await until(lambda: context.state(blocker) is LifecycleState.ERROR)
        await asyncio.wait([asked])
        assert (asked.exception() is not None) == (where == "on_activated")
        assert_late(blocker, where)
        ran, others = blocker.ran, other.ran
        await until(lambda: other.ran > others + 3)
        assert blocker.ran == ran


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.parametrize("kind", ["periodic", "event", "external", "shared", "lane", "realtime"])
async def test_an_async_hook_that_does_not_wait_is_held_to_it_too(kind: str) -> None:
    async with Kernel() as kernel:
        blocker = await kernel.add(AsyncBlocker("blocker"))
        source = await kernel.add(Source("source"))
        kernel.supervise(blocker, Supervision(deadline=LIMIT))
        if kind == "lane":
            beside = await kernel.add(Counter("beside"))
            whole = await kernel.add(Composite("whole", blocker, beside, groups=[["blocker"], ["beside"]]))
            await kernel.start(PeriodicContext(100.0), whole, activate=True)
        elif kind in ("event", "external"):
            await kernel.connect(source.output, blocker.input)
            context = await kernel.start(EventContext() if kind == "event" else ExternalContext(), blocker)
            await context.activate()
            if isinstance(context, ExternalContext):
                await context.tick()
            else:
                source.output.write_nowait(TimedLong(0, 1))
        else:
            await kernel.start(CONTEXTS["realtime" if kind == "realtime" else "periodic"](), blocker, activate=True)
            if kind == "shared":
                await kernel.start(EventContext(), blocker)
        await until(lambda: blocker.last_error is not None)
        await until(lambda: LifecycleState.ERROR in blocker.states.values())
        assert_late(blocker, "on_execute")


class Source(Component):
    """Something that sends."""

    output = OutPort(TimedLong)


@pytest.mark.slow(kept_by="test_a_wait_in_a_thread_that_lasts_already_is_judged_when_it_is_over")
@pytest.mark.anyio
async def test_what_the_hook_raised_itself_is_told_and_not_its_deadline() -> None:
    class Raises(Component):
        def on_execute(self) -> None:
            time.sleep(BLOCKS)
            raise ValueError("mine")

    async with Kernel() as kernel:
        one, two = await kernel.add(Raises("one")), await kernel.add(Raises("two"))
        for component in (one, two):
            kernel.supervise(component, Supervision(deadline=LIMIT))
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        await kernel.start(ThreadContext(100.0), two, activate=True)
        await until(lambda: one.last_error is not None and two.last_error is not None)
        assert isinstance(one.last_error, ValueError)
        assert isinstance(two.last_error, ValueError)


@pytest.mark.slow(kept_by="test_a_wait_in_a_thread_takes_the_time_of_a_simulated_clock")
@pytest.mark.anyio
async def test_a_supervised_blocker_is_helped() -> None:
    async with Kernel() as kernel:
        one, two = await kernel.add(Blocker("one")), await kernel.add(Blocker("two"))
        for component in (one, two):
            component.blocks = 1.2
            kernel.supervise(component, Supervision("reset", backoff=0.01, deadline=0.6))
        await kernel.start(PeriodicContext(20.0), one, activate=True)
        await kernel.start(ThreadContext(20.0), two, activate=True)
        for component in (one, two):
            await until(lambda component=component: component.ran > 3)  # type: ignore[misc]
            assert kernel.supervised[component.name].attempts == 1


@pytest.mark.slow(kept_by="testing/test_faults.py::test_blocking_takes_no_virtual_time")
@simulated
async def test_code_that_blocks_takes_no_time_of_a_simulated_clock(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        one, two = await kernel.add(Blocker("one")), await kernel.add(Blocker("two"))
        for component in (one, two):
            kernel.supervise(component, Supervision(deadline=LIMIT))
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        await kernel.start(ThreadContext(100.0), two, activate=True)
        await simulated_clock.advance(1.0)
        assert one.where == two.where == ""  # both did
        assert one.state is two.state is LifecycleState.ACTIVE


class Waiter(Component):
    """Waits in its thread for data that do not come, for `seconds` of the kernel's clock."""

    input = InPort(TimedLong)

    def __init__(self, name: str = "", seconds: float | None = 0.5) -> None:
        super().__init__(name)
        self.seconds = seconds
        self.ran = 0

    def on_execute(self) -> None:
        self.ran += 1
        with contextlib.suppress(ReadTimeout):
            self.input.read_blocking(timeout=self.seconds)


@simulated
async def test_a_wait_in_a_thread_takes_the_time_of_a_simulated_clock(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source = await kernel.add(Source("source"))
        slow, fast = await kernel.add(Waiter("slow", 0.5)), await kernel.add(Waiter("fast", 0.05))
        for waiter in (slow, fast):
            await kernel.connect(source.output, waiter.input)
            kernel.supervise(waiter, Supervision(deadline=0.1))
            await kernel.start(ThreadContext(), waiter, activate=True)
        await simulated_clock.advance(2.0)
        assert_late(slow, "on_execute", 0.1)
        assert "returned after 0.5 s" in str(slow.last_error)
        assert slow.ran == 1
        assert fast.state is LifecycleState.ACTIVE
        assert fast.ran >= 39


@simulated
async def test_one_that_joins_a_running_thread_brings_its_deadline_with_it(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source = await kernel.add(Source("source"))
        slow, other = await kernel.add(Waiter("slow")), await kernel.add(Counter("other"))
        await kernel.connect(source.output, slow.input)
        context = await kernel.start(ThreadContext(10.0), other, activate=True)
        kernel.supervise(slow, Supervision(deadline=0.1))
        await context.add(slow)
        await context.activate(slow)
        await simulated_clock.advance(2.0)
        assert_late(slow, "on_execute", 0.1)
        kernel.supervise(slow, Supervision())
        await context.reset(slow)
        await context.activate(slow)
        await simulated_clock.advance(2.0)
        assert slow.state is LifecycleState.ACTIVE
        assert slow.ran >= 3


@simulated
async def test_a_wait_that_a_stop_ends_is_not_late(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source = await kernel.add(Source("source"))
        waiter = await kernel.add(Waiter("waiter", None))
        await kernel.connect(source.output, waiter.input)
        context = await kernel.start(ThreadContext(), waiter, activate=True)
        kernel.supervise(waiter, Supervision(deadline=1.0))
        await simulated_clock.advance(0.5)
        await context.stop()
        assert waiter.last_error is None


@pytest.fixture
def release() -> Iterator[threading.Event]:
    """Lets go of threads that hang, at the latest when the test is over."""
    event = threading.Event()
    yield event
    event.set()


@pytest.mark.slow(kept_by="test_a_wait_in_a_thread_that_lasts_already_is_judged_when_it_is_over")
@pytest.mark.anyio
@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("kind", ["thread", "realtime"])
async def test_a_hook_that_hangs_in_its_thread_is_told_of_while_it_does(
    kind: str, late: bool, release: threading.Event, caplog: pytest.LogCaptureFixture
) -> None:
    class Hangs(Component):
        inside = False

        def on_execute(self) -> None:
            self.inside = True
            release.wait(30.0)

    async with Kernel() as kernel:
        hangs = await kernel.add(Hangs("hangs"))
        if not late:
            kernel.supervise(hangs, Supervision(deadline=LIMIT))
        context = await kernel.start(CONTEXTS[kind](), hangs, activate=True)
        await until(lambda: hangs.inside)
        if late:
            kernel.supervise(hangs, Supervision(deadline=LIMIT))
        await until(lambda: "hangs.on_execute: runs for" in caplog.text)
        assert "its deadline is 0.1 s" in caplog.text
        await asyncio.sleep(0.5)
        assert caplog.text.count("hangs.on_execute: runs for") == 1
        assert context.state(hangs) is LifecycleState.ACTIVE
        release.set()
        await until(lambda: context.state(hangs) is LifecycleState.ERROR)
        assert_late(hangs, "on_execute")


# -- supervised while it hangs -------------------------------------------------------------------------------------


class Hangs(Component):
    """Waits forever in one hook; `stubborn`, whatever is done about it, until it is let go."""

    input = InPort(TimedLong)

    def __init__(self, name: str = "", where: str = "on_execute", *, stubborn: bool = False) -> None:
        super().__init__(name)
        self.where = where
        self.stubborn = stubborn
        self.inside = False
        self.let_go = asyncio.Event()

    async def _maybe(self, hook: str) -> None:
        if self.where != hook:
            return
        self.inside = True
        while not self.let_go.is_set():
            try:
                await self.let_go.wait()
            except asyncio.CancelledError:
                if not self.stubborn:
                    raise

    async def on_startup(self) -> None:
        await self._maybe("on_startup")

    async def on_activated(self) -> None:
        await self._maybe("on_activated")

    async def on_execute(self) -> None:
        await self._maybe("on_execute")


@pytest.mark.parametrize("where", ["on_startup", "on_activated", "on_execute"])
@pytest.mark.parametrize("kind", ["periodic", "event", "shared", "lane"])
@simulated
async def test_a_hook_that_hangs_already_is_held_to_a_deadline_that_comes_later(
    kind: str, where: str, simulated_clock: SimulatedClock
) -> None:
    async with Kernel() as kernel:
        hangs, beside = await kernel.add(Hangs("hangs", where)), await kernel.add(Counter("beside"))
        source = await kernel.add(Source("source"))
        await kernel.connect(source.output, hangs.input)
        kernel.supervise(hangs, Supervision())
        parts: list[Component] = [hangs, beside]
        if kind == "lane":
            groups = [["hangs"], ["beside"]]
            parts = [await kernel.add(Composite("whole", hangs, beside, groups=groups, errors="isolate"))]
        context = EventContext() if kind == "event" else PeriodicContext(10.0)
        starting = asyncio.create_task(kernel.start(context, *parts, activate=True, timeout=None))
        await simulated_clock.advance(1.0)
        if kind == "shared" and where == "on_execute":
            sharing = asyncio.create_task(kernel.start(EventContext(), hangs, timeout=None))
        source.output.write_nowait(TimedLong(0, 1))
        await simulated_clock.advance(100.0)
        assert hangs.inside
        assert hangs.last_error is None
        kernel.supervise(hangs, Supervision(deadline=0.5))
        await simulated_clock.advance(0.4)
        assert hangs.last_error is None
        await simulated_clock.advance(0.2)
        assert isinstance(hangs.last_error, HookTimeout)
        assert f"hangs.{where}: did not return within 0.5 s" in str(hangs.last_error)
        ran = beside.ran
        await simulated_clock.advance(1.0)
        if kind != "event":
            assert 9 <= beside.ran - ran <= 11
        if kind == "shared" and where == "on_execute":
            await sharing
        assert starting.done()
        assert isinstance(starting.exception(), ComponentError) == (where != "on_execute")


@simulated
async def test_the_deadline_of_a_hook_that_hangs_can_be_changed_and_taken_away(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        hangs = await kernel.add(Hangs("hangs"))
        kernel.supervise(hangs, Supervision(deadline=100.0))
        await kernel.start(PeriodicContext(10.0), hangs, activate=True)
        await simulated_clock.advance(1.0)
        kernel.supervise(hangs, Supervision())
        await simulated_clock.advance(1000.0)
        assert hangs.last_error is None
        kernel.supervise(hangs, Supervision(deadline=2000.0))  # of which it has used up more than half
        await simulated_clock.advance(990.0)
        assert hangs.last_error is None
        await simulated_clock.advance(20.0)
        assert "did not return within 2000.0 s" in str(hangs.last_error)


@simulated
async def test_one_that_was_left_behind_and_returns_after_all_finds_its_context_gone_on(
    simulated_clock: SimulatedClock,
) -> None:
    async with Kernel() as kernel:
        hangs, beside = await kernel.add(Hangs("hangs", stubborn=True)), await kernel.add(Counter("beside"))
        context = await kernel.start(PeriodicContext(10.0), hangs, beside, activate=True)
        await simulated_clock.advance(1.0)
        kernel.supervise(hangs, Supervision(deadline=0.5))
        await simulated_clock.advance(10.0)
        assert isinstance(hangs.last_error, HookAbandoned)
        ran, ticks = beside.ran, context.ticks
        hangs.let_go.set()
        await simulated_clock.advance(10.0)
        assert 99 <= beside.ran - ran <= 101
        assert context.ticks - ticks == beside.ran - ran


@simulated
async def test_a_wait_in_a_thread_that_lasts_already_is_judged_when_it_is_over(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source = await kernel.add(Source("source"))
        waiter = await kernel.add(Waiter("waiter", None))
        await kernel.connect(source.output, waiter.input)
        await kernel.start(ThreadContext(), waiter, activate=True)
        await simulated_clock.advance(5.0)
        kernel.supervise(waiter, Supervision(deadline=0.1))
        await simulated_clock.advance(0.3)
        source.output.write_nowait(TimedLong(0, 1))
        await simulated_clock.advance(0.1)
        assert_late(waiter, "on_execute", 0.1)
        assert "returned after 0.3 s" in str(waiter.last_error)


# -- a start that hangs --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("composed", [False, True])
@pytest.mark.parametrize(("given", "limit"), [({"timeout": 0.5}, 0.5), ({}, 5.0)])
@simulated
async def test_a_start_is_bounded_where_an_activation_hangs(
    given: dict[str, float], limit: float, composed: bool, simulated_clock: SimulatedClock
) -> None:
    async with Kernel() as kernel:
        before, hangs = await kernel.add(Counter("before")), await kernel.add(Hangs("hangs", "on_activated"))
        after = await kernel.add(Counter("after"))
        parts: list[Component] = [before, hangs, after]
        if composed:
            parts = [await kernel.add(Composite("whole", before, hangs, after, errors="isolate"))]
        context = PeriodicContext(10.0, name="loop")
        begun = simulated_clock.monotonic_ns()
        with pytest.raises(TransitionTimeout, match=f"loop: activate hangs did not take effect within {limit} s"):
            await kernel.start(context, *parts, activate=True, **given)
        assert simulated_clock.monotonic_ns() - begun == limit * 1e9
        assert context.running
        assert kernel.contexts["loop"] is context
        hangs.let_go.set()
        await simulated_clock.advance(1.0)
        states = [context.state(component) for component in (before, hangs, after)]
        active, inactive = LifecycleState.ACTIVE, LifecycleState.INACTIVE
        assert states == [active, active, inactive]  # what had not begun was withdrawn
        await context.stop()
        await kernel.start(context, *parts, activate=True)


@simulated
async def test_a_start_is_bounded_where_a_startup_hangs(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        hangs = await kernel.add(Hangs("hangs", "on_startup"))
        context = PeriodicContext(10.0, name="loop")
        with pytest.raises(TransitionTimeout, match=r"loop: .* within 0\.5 s; hangs is still in on_startup"):
            await kernel.start(context, hangs, activate=True, timeout=0.5)
        await context.stop()
        assert not kernel.contexts


@simulated
async def test_a_start_without_a_limit_waits_as_long_as_it_takes(simulated_clock: SimulatedClock) -> None:
    class Slow(Component):
        async def on_activated(self) -> None:
            await self.sleep(1000.0)

    async with Kernel() as kernel:
        slow = await kernel.add(Slow("slow"))
        await kernel.start(PeriodicContext(10.0), slow, activate=True, timeout=None)
        assert slow.state is LifecycleState.ACTIVE


@pytest.mark.anyio
async def test_a_start_is_bounded_where_an_activation_hangs_in_a_thread(release: threading.Event) -> None:
    class Blocks(Component):
        def on_activated(self) -> None:
            release.wait(30.0)

    async with Kernel() as kernel:
        blocks = await kernel.add(Blocks("blocks"))
        with pytest.raises(TransitionTimeout, match="activate blocks"):
            await kernel.start(ThreadContext(), blocks, activate=True, timeout=0.1)
        release.set()
        await until(lambda: blocks.state is LifecycleState.ACTIVE)


@simulated
async def test_a_start_that_a_hook_asks_for_waits_until_the_hook_is_out_of_its_way(
    simulated_clock: SimulatedClock,
) -> None:
    class Starter(Component):
        async def on_execute(self) -> None:
            if len(self.contexts) == 1:
                await self.kernel.start(EventContext(name="second"), self, activate=True)
                await self.sleep(60.0)

    async with Kernel() as kernel:
        starter = await kernel.add(Starter("starter"))
        await kernel.start(PeriodicContext(10.0), starter, activate=True)
        await simulated_clock.advance(100.0)
        assert kernel.contexts["second"].state(starter) is LifecycleState.ACTIVE


# -- an on_initialize that hangs -----------------------------------------------------------------------------------


class Initializes(Component):
    """Takes long to be initialised; `stubborn`, whatever is done about it."""

    seconds = Param(1000.0)
    blocks = Param(0.0)
    stubborn = False

    async def on_initialize(self) -> None:
        time.sleep(self.blocks)
        end = self.clock.monotonic_ns() + self.seconds * 1e9
        while self.clock.monotonic_ns() < end:
            try:
                await self.sleep((end - self.clock.monotonic_ns()) / 1e9)
            except asyncio.CancelledError:
                if not self.stubborn:
                    raise


class Stubborn(Initializes):
    """Ignores cancellations."""

    stubborn = True


@simulated
async def test_an_initialization_that_hangs_is_ended_in_time_and_leaves_nothing(
    simulated_clock: SimulatedClock,
) -> None:
    async with Kernel(initialize_timeout=3.0) as kernel:
        assert kernel.initialize_timeout == 3.0
        told = r"slow\.on_initialize: did not return within 3 s; it was cancelled"
        for made in (True, False):
            begun = simulated_clock.monotonic_ns()
            with pytest.raises(HookTimeout, match=told):
                await (kernel.add(Initializes("slow")) if made else kernel.create(Initializes, "slow"))
            assert simulated_clock.monotonic_ns() - begun == 3.0 * 1e9
            assert not kernel.components
        with pytest.raises(HookAbandoned, match="ignored 4 cancellations"):
            await kernel.create(Stubborn, "slow")
        await kernel.create(Initializes, "slow", seconds=2.9)


@simulated
async def test_an_initialization_takes_as_long_as_it_likes_where_nothing_is_said(
    simulated_clock: SimulatedClock,
) -> None:
    async with Kernel() as kernel:
        assert kernel.initialize_timeout is None
        await kernel.create(Initializes, "slow")
        assert simulated_clock.monotonic_ns() == 1000.0 * 1e9


@pytest.mark.anyio
async def test_the_time_for_an_initialization_is_the_kernels() -> None:
    async with Kernel(clock=ScaledClock(1000.0), initialize_timeout=60.0) as kernel:
        begun = time.monotonic()
        with pytest.raises(HookTimeout):
            await kernel.create(Initializes, "slow", seconds=1_000_000.0)
        assert time.monotonic() - begun < 30.0


@pytest.mark.slow
@pytest.mark.anyio
async def test_an_initialization_that_blocks_is_judged_when_it_returns() -> None:
    async with Kernel(initialize_timeout=LIMIT) as kernel:
        with pytest.raises(HookTimeout, match=r"slow\.on_initialize: returned after 0\.\d+ s, its deadline is 0\.1 s"):
            await kernel.create(Initializes, "slow", seconds=0.0, blocks=BLOCKS)
        assert not kernel.components


@pytest.mark.parametrize("bad", [0, -1.0, float("inf"), float("nan"), True, "30"])
def test_a_time_for_initializations_is_checked(bad: Any) -> None:
    with pytest.raises(ConfigurationError, match="initialize_timeout = "):
        Kernel(initialize_timeout=bad)
