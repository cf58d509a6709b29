"""The timer heap against a sorted list; a simulated clock moved by hand."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.clock import SETTLED_TURNS, SimulatedClock, TimerHeap
from aiorts.errors import BusyError
from campaign import cases

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.clock import Timer

pytestmark = pytest.mark.anyio

OPERATIONS = st.lists(
    st.one_of(
        st.tuples(st.just("add"), st.integers(0, 50)),
        st.tuples(st.just("cancel"), st.integers(0, 60)),
        st.tuples(st.just("run"), st.integers(0, 20)),
    ),
    max_size=80,
)


@pytest.mark.slow(kept_by="test_advance_fires_in_order_of_deadline_then_creation_at_exact_times")
@pytest.mark.campaign
@settings(max_examples=cases(10_000), deadline=None)
@given(OPERATIONS)
def test_heap_fires_what_a_sorted_list_fires(operations: list[tuple[str, int]]) -> None:
    loop = asyncio.new_event_loop()
    heap, now = TimerHeap(), 0
    fired: list[int] = []
    model: list[tuple[int, int]] = []
    expected: list[int] = []
    timers: list[Timer] = []
    for name, value in operations:
        if name == "add":
            number = len(timers)
            timers.append(heap.push(value, lambda number=number: fired.append(number)))  # type: ignore[misc]
            model.append((value, number))
        elif name == "cancel" and timers:
            number = value % len(timers)
            timers[number].cancel()
            model = [entry for entry in model if entry[1] != number]
        elif name == "run":
            now += value
            heap.run_due(now, loop)
            expected += [number for deadline, number in sorted(model) if deadline <= now]
            model = [entry for entry in model if entry[0] > now]
        assert fired == expected
        assert len(heap) == len(model)
        assert heap.next_deadline() == min((deadline for deadline, _ in model), default=None)
        assert [timer.pending for timer in timers] == [
            any(n == number for _, n in model) for number in range(len(timers))
        ]
    loop.close()


def test_heap_of_cancelled_timers_stays_small() -> None:
    heap = TimerHeap()
    kept = [heap.push(10**9 + n, lambda: None) for n in range(10)]
    for n in range(20_000):
        heap.push(n, lambda: None).cancel()
        assert heap.slots <= 2 * len(heap) + 10
    assert len(heap) == len(kept)


def test_rank_goes_before_creation_within_one_deadline() -> None:
    loop, heap, seen = asyncio.new_event_loop(), TimerHeap(), []
    heap.push(5, lambda: seen.append("late"), 2)
    heap.push(5, lambda: seen.append("early"), 1)
    heap.run_due(5, loop)
    loop.close()
    assert seen == ["early", "late"]


def test_callback_may_cancel_and_add_while_its_deadline_fires() -> None:
    loop, heap, seen = asyncio.new_event_loop(), TimerHeap(), []

    def first() -> None:
        seen.append("first")
        second.cancel()
        heap.push(0, lambda: seen.append("added"))

    heap.push(1, first)
    second = heap.push(1, lambda: seen.append("second"))
    heap.push(1, lambda: seen.append("third"))
    heap.run_due(1, loop)
    assert seen == ["first", "third"], "what was added waits for the next call"
    heap.run_due(1, loop)
    loop.close()
    assert seen == ["first", "third", "added"]


def test_timers_behind_a_keyboard_interrupt_stay_pending() -> None:
    loop, heap, seen = asyncio.new_event_loop(), TimerHeap(), []

    def interrupt() -> None:
        raise KeyboardInterrupt

    heap.push(1, interrupt)
    second = heap.push(1, lambda: seen.append("second"))
    third = heap.push(1, lambda: seen.append("third"))
    with pytest.raises(KeyboardInterrupt):
        heap.run_due(1, loop)
    assert (second.pending, third.pending, len(heap)) == (True, True, 2)
    third.cancel()
    heap.run_due(1, loop)
    loop.close()
    assert seen == ["second"]
    assert len(heap) == 0


# -- advance() on the loops of the suite ------------------------------------------------------------------------------


async def test_advance_fires_in_order_of_deadline_then_creation_at_exact_times() -> None:
    clock, seen = SimulatedClock(), []

    def note(name: str) -> Callable[[], None]:
        return lambda: seen.append((name, clock.monotonic_ns()))

    for name, deadline in (("c", 20), ("a", 10), ("b", 10), ("late", 31)):
        clock.call_at(deadline, note(name))
    await clock.advance_to(30)
    assert seen == [("a", 10), ("b", 10), ("c", 20)]
    assert (clock.monotonic_ns(), clock.next_deadline(), clock.pending) == (30, 31, 1)


async def test_advance_lets_woken_tasks_finish_before_the_next_deadline() -> None:
    clock, seen = SimulatedClock(), []
    event = asyncio.Event()

    async def worker() -> None:
        await event.wait()
        for _ in range(SETTLED_TURNS - 4):
            await asyncio.sleep(0)
        seen.append(("worker", clock.monotonic_ns()))

    task = asyncio.ensure_future(worker())
    clock.call_at(10, event.set)
    clock.call_at(20, lambda: seen.append(("next", clock.monotonic_ns())))
    await clock.advance_to(25)
    await task
    assert seen == [("worker", 10), ("next", 20)]


async def test_advance_waits_as_long_as_a_probe_counts() -> None:
    clock, seen, count = SimulatedClock(), [], [0]
    remove = clock.add_probe(lambda: count[0])
    event = asyncio.Event()

    async def worker() -> None:
        await event.wait()
        for _ in range(100):
            for _ in range(5):
                await asyncio.sleep(0)
            count[0] += 1
        seen.append(("worker", clock.monotonic_ns()))

    task = asyncio.ensure_future(worker())
    clock.call_at(10, event.set)
    clock.call_at(20, lambda: seen.append(("next", clock.monotonic_ns())))
    await clock.advance(20e-9)
    await task
    remove()
    assert seen == [("worker", 10), ("next", 20)]


async def test_overdue_timer_fires_without_moving_time() -> None:
    clock, seen = SimulatedClock(), []
    await clock.advance(1)
    clock.call_at(5, lambda: seen.append(clock.monotonic_ns()))
    await clock.advance(0)
    assert seen == [10**9]


async def test_second_task_that_advances_is_refused() -> None:
    clock = SimulatedClock()
    clock.call_at(10, lambda: None)
    first = asyncio.ensure_future(clock.advance(1))
    await asyncio.sleep(0)
    with pytest.raises(BusyError, match="already"):
        await clock.advance(1)
    await first
    await clock.advance(1)
    assert clock.monotonic_ns() == 2 * 10**9


@pytest.mark.parametrize("seconds", [-1, -1e-9, float("nan"), float("inf")])
async def test_time_does_not_go_back_or_nowhere(seconds: float) -> None:
    clock = SimulatedClock()
    await clock.advance(1)
    with pytest.raises(ValueError, match="seconds="):
        await clock.advance(seconds)
    with pytest.raises(ValueError, match="back"):
        await clock.advance_to(5)
    assert clock.monotonic_ns() == 10**9


async def test_advance_waits_while_a_thread_holds_the_clock() -> None:
    clock, seen = SimulatedClock(), []
    loop = asyncio.get_running_loop()
    hold = clock.hold()
    other = clock.hold()
    clock.call_at(10, lambda: seen.append("timer"))

    def work() -> None:
        with hold:
            seen.append("thread")
            other.release()
            other.release()

    advance = asyncio.ensure_future(clock.advance_to(10))
    for _ in range(5 * SETTLED_TURNS):
        await asyncio.sleep(0)
    assert seen == []
    await loop.run_in_executor(None, work)
    await advance
    assert seen == ["thread", "timer"]
    assert not clock.held
    await loop.shutdown_default_executor()


async def test_failing_callback_is_reported_and_the_others_run() -> None:
    clock, seen, reports = SimulatedClock(), [], []
    loop = asyncio.get_running_loop()
    before = loop.get_exception_handler()
    loop.set_exception_handler(lambda _, context: reports.append(context["exception"]))
    clock.call_at(10, lambda: 1 // 0)
    clock.call_at(10, lambda: seen.append("second"))
    await clock.advance_to(10)
    loop.set_exception_handler(before)
    assert seen == ["second"]
    assert [type(report) for report in reports] == [ZeroDivisionError]
