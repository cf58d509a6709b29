"""A hook that raises: where its component then is, who is told what, and that nobody else is touched."""

from __future__ import annotations

import asyncio
import gc
import logging
import tracemalloc
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, EventContext, ExternalContext, Kernel, PeriodicContext
from aiorts.errors import ComponentError, StateError
from aiorts.kernel.loop.bus import Event, HookFailed, StateChanged
from aiorts.kernel.loop.log import LOGGER_NAME
from aiorts.model.lifecycle import HOOKS, LifecycleState
from aiorts.testing.simulation import simulate
from campaign import cases
from kernel_parts import AsyncDiary, Diary, PlainDiary, raising

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from aiorts import SimulatedClock

I, A, E = LifecycleState.INACTIVE, LifecycleState.ACTIVE, LifecycleState.ERROR  # noqa: E741
BOTH = pytest.mark.parametrize("kind", [PlainDiary, AsyncDiary], ids=["plain", "async"])

TARGETS = {
    "on_startup": E,
    "on_activated": E,
    "on_execute": E,
    "on_state_update": E,
    "on_rate_changed": E,
    "on_deactivated": I,
    "on_aborting": E,
    "on_error": E,
    "on_reset": E,
}
"""State after the hook raised once, for the hooks that leave a component in a context."""


async def provoke(context: PeriodicContext, clock: SimulatedClock, diary: Diary, hook: str) -> None:
    """Bring the component to the point where `hook` has run."""
    if hook != "on_startup":
        try:
            await context.activate(diary)
        except ComponentError:
            assert hook == "on_activated"
    if hook in ("on_aborting", "on_error", "on_reset"):
        diary.plan["on_execute"] = raising(RuntimeError("first"))
    if hook == "on_rate_changed":
        await context.set_rate(50.0)
    await clock.advance(0.1)
    if hook == "on_deactivated":
        await context.deactivate(diary)
    if hook == "on_reset":
        with pytest.raises(ComponentError):
            await context.reset(diary)
    await clock.advance(0.1)


@pytest.mark.row(11, 13)
@pytest.mark.fault("A01")
@BOTH
@pytest.mark.parametrize("hook", TARGETS)
def test_component_is_in_the_state_of_the_table_and_its_neighbour_runs_on(kind: type[Diary], hook: str) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary, other = await kernel.add(kind("faulty")), await kernel.add(PlainDiary("healthy"))
            error = ValueError(f"in {hook}")
            diary.plan[hook] = raising(error)
            context = await kernel.start(PeriodicContext(100.0), diary, other)
            await context.activate(other)
            await provoke(context, clock, diary, hook)
            assert diary.count(hook) >= 1
            assert context.state(diary) is TARGETS[hook]
            assert diary.last_error is error
            assert error.__traceback__ is not None
            if TARGETS[hook] is E:
                executed = diary.count("on_execute")
                assert diary.count("on_aborting") == 1
                assert diary.count("on_error") >= 1
                await clock.advance(1.0)
                assert diary.count("on_execute") == executed
                first = error if hook in ("on_startup", "on_activated", "on_execute") else diary.told[0][1]
                assert {id(told) for _, told in diary.told} == {id(first)}
            before = other.count("on_execute")
            await clock.advance(1.0)
            assert other.count("on_execute") - before in (50, 51, 100, 101)
            assert context.state(other) is A

    simulate(main)


@pytest.mark.row(13)
@pytest.mark.fault("A01")
@BOTH
def test_failing_on_execute_leads_to_error_within_one_period(kind: type[Diary]) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(kind("faulty"))
            context = await kernel.start(PeriodicContext(10.0), diary, activate=True)
            await clock.advance(0.35)
            diary.plan["on_execute"] = raising(ValueError("now"))
            executed = diary.count("on_execute")
            await clock.advance(0.1)
            assert context.state(diary) is E
            await clock.advance(0.1)
            assert diary.ran[diary.ran.index("on_deactivated") :] == ["on_deactivated", "on_aborting", "on_error"]
            assert diary.count("on_execute") == executed + 1

    simulate(main)


@pytest.mark.row(11)
@pytest.mark.fault("A01")
@BOTH
def test_failing_on_initialize_means_the_component_was_never_there(kind: type[Diary]) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary, error = kind("faulty"), ValueError("no device")
            diary.plan["on_initialize"] = raising(error)
            with pytest.raises(ValueError, match="no device") as caught:
                await kernel.add(diary)
            assert caught.value is error
            assert not kernel.components
            again = await kernel.add(kind("faulty"))
            assert kernel.components == {"faulty": again}

    simulate(main)


@pytest.mark.row(11)
@pytest.mark.fault("A01")
@BOTH
@pytest.mark.parametrize("hook", ["on_shutdown", "on_finalize"])
def test_failing_on_the_way_out_completes_and_is_reported(kind: type[Diary], hook: str) -> None:
    async def main(clock: SimulatedClock) -> None:
        heard: list[HookFailed] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(HookFailed, heard.append)
            diary, error = await kernel.add(kind("faulty")), ValueError("in the way")
            diary.plan[hook] = raising(error)
            context = await kernel.start(PeriodicContext(10.0), diary, activate=True)
            await context.stop()
            assert not context.running
            await kernel.remove(diary)
            assert not kernel.components
        assert diary.last_error is error
        assert [(event.component, event.hook, event.error) for event in heard] == [("faulty", hook, error)]
        assert diary.ran[-3:] == ["on_deactivated", "on_shutdown", "on_finalize"]

    simulate(main)


@pytest.mark.row(11, 20)
def test_all_twelve_hooks_run_in_their_order_and_are_announced_before_and_after() -> None:
    """OpenRTM's listener pairs around every component action."""
    from aiorts.kernel.loop.bus import HookAfter, HookBefore

    async def main(clock: SimulatedClock) -> None:
        heard: list[tuple[str, str]] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(HookBefore, lambda event: heard.append(("before", event.hook)))
            kernel.bus.subscribe(HookAfter, lambda event: heard.append(("after", event.hook)))
            diary = await kernel.add(AsyncDiary("pid0"))
            context = await kernel.start(PeriodicContext(10.0), diary, activate=True)
            await clock.advance(0.05)
            await context.set_rate(20.0)
            diary.plan["on_execute"] = raising(ValueError("x"))
            await clock.advance(0.1)
            await context.reset()
            await kernel.remove(diary)
        assert set(diary.ran) == set(HOOKS)
        assert heard == [pair for hook in diary.ran for pair in (("before", hook), ("after", hook))]

    simulate(main)


@pytest.mark.row(20)
def test_hooks_that_nobody_wrote_are_announced_too_and_fail_nothing() -> None:
    from aiorts.kernel.loop.bus import HookAfter

    async def main(clock: SimulatedClock) -> None:
        heard: list[HookAfter] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(HookAfter, heard.append)
            bare = await kernel.add(Component("bare"))
            context = await kernel.start(PeriodicContext(10.0), bare, activate=True)
            await clock.advance(0.05)
            assert context.state(bare) is A
        assert [event.hook for event in heard][:4] == ["on_initialize", "on_startup", "on_activated", "on_execute"]
        assert [event.error for event in heard if event.error is not None] == []

    simulate(main)


@pytest.mark.slow
@pytest.mark.fault("A02")
def test_component_that_failed_to_activate_never_executes_and_its_ports_stay_closed() -> None:
    """OpenRTM-aist issue 417: on_execute ran once after a failed on_activated."""

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            for number in range(100):
                diary = await kernel.add((AsyncDiary, PlainDiary)[number % 2](f"c{number}"))
                diary.plan["on_activated"] = raising(ValueError("no"))
                context: Any = (PeriodicContext(1000.0), EventContext(), ExternalContext())[number % 3]
                with pytest.raises(ComponentError, match="on_activated raised ValueError: no") as caught:
                    await kernel.start(context, diary, activate=True)
                assert caught.value.__cause__ is diary.last_error
                await clock.advance(0.01)
                assert context.state(diary) is E
                assert diary.count("on_execute") == diary.count("on_state_update") == 0
                await context.stop()

    simulate(main)


@pytest.mark.row(14)
@pytest.mark.fault("A03")
def test_failures_of_on_aborting_and_on_error_are_chained_to_the_cause_and_change_nothing() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(AsyncDiary("faulty"))
            first = ValueError("first")
            diary.plan = {
                "on_execute": raising(first),
                "on_aborting": raising(KeyError("aborting")),
                "on_error": raising(IndexError("error")),
            }
            context = await kernel.start(PeriodicContext(100.0), diary, activate=True)
            await clock.advance(0.015)
            assert isinstance(diary.last_error, IndexError)
            assert diary.last_error.__cause__ is first
            await clock.advance(1.0)
            assert context.state(diary) is E
            assert diary.count("on_aborting") == 1
            assert diary.count("on_error") == 101
            assert {id(told) for _, told in diary.told} == {id(first)}

    simulate(main)


def fresh(diary: Diary) -> None:
    raise IndexError("again")


def same_again(diary: Diary) -> None:
    raise diary.told[-1][1]


def from_the_last(diary: Diary) -> None:
    raise IndexError("again") from diary.last_error


@pytest.fixture
def log_lines() -> Iterator[list[int]]:
    """Counts what components log; pytest's own capture, which keeps every text, is left out."""
    count = [0]

    def tally(record: logging.LogRecord) -> bool:
        count[0] += 1
        return False

    logger = logging.getLogger(LOGGER_NAME)
    logger.addFilter(tally)
    yield count
    logger.removeFilter(tally)


@pytest.mark.slow(kept_by="test_failures_of_on_aborting_and_on_error_are_chained_to_the_cause_and_change_nothing")
@pytest.mark.fault("A03")
@pytest.mark.campaign
@pytest.mark.parametrize("fail", [fresh, same_again, from_the_last])
def test_failing_on_error_for_ever_costs_one_line_a_second_and_no_memory(
    fail: Callable[[Diary], None], log_lines: list[int]
) -> None:
    cycles = max(400, cases(10_000))

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(AsyncDiary("faulty"))
            diary.plan = {"on_execute": raising(ValueError("first")), "on_error": lambda: fail(diary)}
            context = await kernel.start(ExternalContext(timing=False), diary, activate=True)

            async def run(count: int) -> None:
                for _ in range(count // 50):
                    await context.tick(50)
                    await clock.advance(0.5)
                diary.ran.clear()
                del diary.told[:-1]

            await run(200)
            log_lines[0] = 0
            gc.collect()
            before = tracemalloc.get_traced_memory()[0]
            await run(cycles)
            gc.collect()
            assert tracemalloc.get_traced_memory()[0] - before < 10_000
            assert 1 <= log_lines[0] <= cycles // 50 * 0.5 + 1

    tracemalloc.start()
    try:
        simulate(main)
    finally:
        tracemalloc.stop()


@pytest.mark.fault("A04")
def test_second_reset_works_after_the_first_one_failed() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(AsyncDiary("faulty"))
            diary.plan["on_execute"] = raising(ValueError("first"))
            context = await kernel.start(PeriodicContext(100.0), diary, activate=True)
            await clock.advance(0.02)
            diary.plan = {"on_reset": raising(KeyError("not yet"))}
            with pytest.raises(ComponentError, match="on_reset raised KeyError"):
                await context.reset(diary)
            assert context.state(diary) is E
            diary.plan.clear()
            await context.reset(diary)
            assert context.state(diary) is I
            await context.activate(diary)
            await clock.advance(0.02)
            assert context.state(diary) is A

    simulate(main)


def test_one_that_failed_on_its_way_out_and_came_back_fails_like_any_other() -> None:
    """What `on_deactivated` raised is told and over: it is not the cause of an error that comes later."""

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(AsyncDiary("faulty"))
            context = await kernel.start(PeriodicContext(100.0), diary, activate=True)
            diary.plan["on_deactivated"] = raising(ValueError("on the way out"))
            await context.deactivate(diary)
            diary.plan = {"on_execute": raising(cause := KeyError("later"))}
            await context.activate(diary)
            await clock.advance(0.02)
            assert context.state(diary) is E
            assert diary.told == [("on_aborting", cause), ("on_error", cause)]

    simulate(main)


def test_two_failures_before_the_transition_lead_into_error_once_and_reset_in_between_holds() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            diary = await kernel.add(AsyncDiary("faulty"))
            context = await kernel.start(ExternalContext(), diary, activate=True)
            for number in range(2):
                context.runner.life.task_failed(context.runner.members[0], ValueError(str(number)))
            asked = asyncio.create_task(context.reset(diary))
            await asyncio.sleep(0)
            context.runner.life.task_failed(context.runner.members[0], ValueError("late"))
            await asked
            await context.activate(diary)
            await context.tick()
            assert (context.state(diary), diary.count("on_aborting")) == (A, 1)

    simulate(main)


@pytest.mark.row(14)
def test_cause_can_be_asked_for_in_every_view_of_the_component() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard: list[Event] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(HookFailed, heard.append)
            diary = await kernel.add(AsyncDiary("faulty"))
            error = ValueError("bus fault 17")
            diary.plan["on_execute"] = raising(error)
            await kernel.start(PeriodicContext(100.0, name="loop"), diary, activate=True)
            await clock.advance(0.005)
            assert diary.last_error is error
            assert error.__traceback__ is not None
            assert diary.profile.last_error == "ValueError: bus fault 17"
            assert heard == [HookFailed("faulty", "loop", "on_execute", error)]
            assert dict(diary.states) == {"loop": E}
            assert "error" in repr(diary)

    simulate(main)


@pytest.mark.row(13)
def test_failure_is_logged_with_traceback_kernel_component_hook_and_tick(caplog: pytest.LogCaptureFixture) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel("plant") as kernel:
            diary = await kernel.add(AsyncDiary("faulty"))
            await kernel.start(PeriodicContext(100.0), diary, activate=True)
            await clock.advance(0.025)
            diary.plan["on_execute"] = raising(ValueError("bus fault 17"))
            await clock.advance(0.005)

    simulate(main)
    record: Any = caplog.records[0]
    assert record.levelno == logging.ERROR
    assert "on_execute failed: ValueError: bus fault 17" in record.getMessage()
    assert record.exc_info[1].args == ("bus fault 17",)
    assert (record.kernel, record.component, record.tick) == ("plant", "faulty", 4)


# -- whatever can be raised ------------------------------------------------------------------------------------------

ZOO = [
    SystemExit(3),
    KeyboardInterrupt(),
    GeneratorExit(),
    asyncio.CancelledError(),
    MemoryError(),
    RecursionError(),
    StopIteration(7),
    ExceptionGroup("group", [ValueError("inner")]),
    BaseExceptionGroup("group", [SystemExit(4), KeyboardInterrupt()]),
]
IN_A_CONTEXT = ["on_startup", "on_activated", "on_execute", "on_state_update", "on_error", "on_reset", "on_shutdown"]


@pytest.mark.anyio
@pytest.mark.row(13)
@pytest.mark.fault("A05")
@BOTH
@pytest.mark.parametrize("animal", ZOO, ids=lambda animal: type(animal).__name__)
async def test_whatever_a_hook_raises_is_the_error_of_its_component_alone(
    kind: type[Diary], animal: BaseException, anyio_backend: Any
) -> None:
    async with Kernel(contain_interrupts=True) as kernel:
        neighbour = await kernel.add(PlainDiary("healthy"))
        context = await kernel.start(ExternalContext(), neighbour, activate=True)
        for hook in IN_A_CONTEXT:
            diary = await kernel.add(kind(f"faulty_{hook}"))
            diary.plan[hook] = raising(animal)
            if hook in ("on_error", "on_reset"):
                diary.plan["on_execute"] = raising(ValueError("first"))
            await context.add(diary)
            try:
                await context.activate(diary)
            except (ComponentError, StateError):
                assert hook in ("on_activated", "on_startup")
            await context.tick(2)
            if hook == "on_reset":
                with pytest.raises(ComponentError):
                    await context.reset(diary)
            if hook == "on_shutdown":
                await context.remove(diary)
                assert diary.last_error is not None
            else:
                assert context.state(diary) is E
            error = diary.last_error
            assert error is animal or isinstance(error, RuntimeError)  # a coroutine turns StopIteration into one
            assert context.state(neighbour) is A
        assert neighbour.count("on_execute") == 2 * len(IN_A_CONTEXT)
        newcomer = kind("newcomer")
        newcomer.plan["on_initialize"] = raising(animal)
        with pytest.raises(Exception):  # noqa: PT011 - an Exception, whatever was raised
            await kernel.add(newcomer)
        assert "newcomer" not in kernel.components
        leaver = await kernel.add(kind("leaver"))
        leaver.plan["on_finalize"] = raising(animal)
        await kernel.remove(leaver)
        assert leaver.last_error is not None


@pytest.mark.anyio
@pytest.mark.fault("A05")
async def test_hook_that_cancels_its_own_task_fails_alone(anyio_backend: Any) -> None:
    def cancel_myself() -> None:
        task = asyncio.current_task()
        assert task is not None
        task.cancel()

    async with Kernel() as kernel:
        first, second = await kernel.add(PlainDiary("a")), await kernel.add(AsyncDiary("b"))
        context = await kernel.start(ExternalContext(), first, second, activate=True)
        first.plan["on_execute"] = cancel_myself
        await context.tick(3)
        assert context.state(first) is E
        assert isinstance(first.last_error, asyncio.CancelledError)
        assert (context.state(second), second.count("on_execute")) == (A, 3)


@pytest.mark.fault("A05")
@pytest.mark.parametrize("hook", ["on_execute", "on_deactivated"])
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_embedded_interrupt_is_passed_on_after_the_component_went_to_error(loop: str, hook: str) -> None:
    import aiorts

    seen: list[Any] = []
    diaries: list[Diary] = []

    class Interrupted(PlainDiary):  # type: ignore[misc, valid-type]
        async def on_aborting(self, error: BaseException) -> None:
            await asyncio.sleep(0.01)
            seen.append(error)

    async def main() -> None:
        async with Kernel() as kernel:
            kernel.bus.subscribe(HookFailed, lambda event: seen.append(event.hook))
            kernel.bus.subscribe(StateChanged, lambda event: seen.append(event.new))
            diary = await kernel.add(Interrupted("faulty"))
            diaries.append(diary)
            diary.plan[hook] = raising(KeyboardInterrupt())
            context = await kernel.start(ExternalContext(), diary, activate=True)
            try:
                await context.tick()
                await context.deactivate(diary)
                await asyncio.sleep(1.0)
            finally:
                seen.append("interrupted")

    with pytest.raises(KeyboardInterrupt):
        aiorts.run(main, loop=loop)
    assert (E if hook == "on_execute" else I) in seen[: seen.index("interrupted")]
    assert diaries[0].ran[-2:] == ["on_shutdown", "on_finalize"]


@pytest.mark.fault("A05")
def test_contained_interrupt_goes_no_further() -> None:
    async def main(clock: SimulatedClock) -> str:
        async with Kernel(contain_interrupts=True) as kernel:
            diary = await kernel.add(PlainDiary("faulty"))
            diary.plan["on_execute"] = raising(KeyboardInterrupt())
            context = await kernel.start(PeriodicContext(10.0), diary, activate=True)
            await clock.advance(1.0)
            return str(context.state(diary))

    assert simulate(main) == "error"
