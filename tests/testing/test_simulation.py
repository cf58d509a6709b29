"""The loop whose time jumps: exact virtual time for asyncio and anyio, real threads and sockets, clear ends."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import anyio
import anyio.to_thread
import pytest

from aiorts.clock import SimulatedClock, SystemClock, current_clock
from aiorts.errors import BusyError, StateError
from aiorts.kernel.loop.timers import sleep, sleep_until, timers_for
from aiorts.testing import simulation
from aiorts.testing.simulation import SimulatedLoop, simulate

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

S = 10**9


# -- time -------------------------------------------------------------------------------------------------------------


def test_main_gets_the_clock_and_its_result_comes_back() -> None:
    async def main(clock: SimulatedClock) -> float:
        assert current_clock() is clock
        await asyncio.sleep(3600)
        return clock.time()

    started = time.monotonic()
    assert simulate(main) == 3600.0
    assert time.monotonic() - started < 5


def test_coroutine_and_own_clock_are_accepted() -> None:
    clock = SimulatedClock(start_ns=7 * S)

    async def main() -> None:
        await sleep(clock, 2)

    simulate(main(), clock=clock)
    assert (clock.monotonic_ns(), clock.time_ns()) == (2 * S, 9 * S)


async def _takes_nothing() -> None: ...


async def _takes_two(clock: SimulatedClock, other: int) -> None: ...


def _awaits_nothing(clock: SimulatedClock) -> int:
    return 5


@pytest.mark.parametrize(
    ("main", "said"),
    [
        (_takes_nothing, r"_takes_nothing\(\) .*; write simulate\(_takes_nothing\(\)\), or .*_takes_nothing\(clock\)"),
        (_takes_two, r"'other'.*; write simulate\(_takes_two\(\.\.\.\)\) with its arguments"),
        (_awaits_nothing, r"_awaits_nothing returned 5, nothing to await; write async def"),
        (None, r"expected a coroutine, or a function that takes the clock, got None"),
    ],
)
def test_a_main_of_another_form_is_told_what_to_write(main: Any, said: str) -> None:
    with pytest.raises(TypeError, match=said):
        simulate(main)


@pytest.mark.slow(kept_by="test_asyncio_and_anyio_deadlines_are_exact")
@pytest.mark.campaign
def test_sleeps_add_up_exactly() -> None:
    """10^6 times a tenth of a second: no drift and no spinning turn."""
    from campaign import cases

    count = cases(1_000_000)

    async def main(clock: SimulatedClock) -> tuple[int, float]:
        for _ in range(count):
            await asyncio.sleep(0.1)
        return clock.monotonic_ns(), asyncio.get_running_loop().time()

    assert simulate(main) == (count * S // 10, count * S // 10 / 1e9)


@pytest.mark.slow(kept_by="contexts/test_ten_hours.py::test_ticks_counted_one_by_one_neither_drift_nor_get_lost")
def test_hour_at_100_hz_takes_seconds() -> None:
    async def main(clock: SimulatedClock) -> int:
        ticks = 0
        for n in range(1, 360_001):
            await sleep_until(clock, n * 10_000_000)
            ticks += 1
        return ticks

    started = time.process_time()
    assert simulate(main) == 360_000
    assert time.process_time() - started < 20


@pytest.mark.parametrize("start", [0, 3, 10**5, 10**7, 10**9])
def test_timeouts_never_ring_early_and_never_spin(start: int) -> None:
    async def main(clock: SimulatedClock) -> None:
        loop = asyncio.get_running_loop()
        await clock.advance(start)
        for n in range(1, 200):
            when = loop.time() + n / 7
            rung = loop.create_future()
            loop.call_at(when, lambda rung=rung: rung.set_result(loop.time()))
            assert when <= await rung <= when + max(2e-9, 2 * math.ulp(when))
            with anyio.move_on_after(n / 7) as scope:
                await anyio.sleep_forever()
            assert scope.cancelled_caught

    simulate(main)


def test_positive_delay_moves_time_however_small() -> None:
    async def main(clock: SimulatedClock) -> None:
        loop = asyncio.get_running_loop()
        end = loop.time() + 1
        while loop.time() < end:
            await asyncio.sleep((end - loop.time()) / 2)

    simulate(main)


def test_asyncio_and_anyio_deadlines_are_exact() -> None:
    async def main(clock: SimulatedClock) -> list[int]:
        at = []
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(2):
                await asyncio.sleep(5)
        at.append(clock.monotonic_ns())
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(asyncio.Event().wait(), 1)
        at.append(clock.monotonic_ns())
        with pytest.raises(TimeoutError):
            with anyio.fail_after(1):
                await anyio.sleep(2)
        at.append(clock.monotonic_ns())
        async with anyio.create_task_group() as group:
            group.start_soon(anyio.sleep, 4)
            group.start_soon(sleep, clock, 3)
        at.append(clock.monotonic_ns())
        with anyio.move_on_after(0.5):
            async with anyio.create_task_group() as group:
                group.start_soon(anyio.sleep, 4)
        at.append(clock.monotonic_ns())
        return at

    assert simulate(main) == [2 * S, 3 * S, 4 * S, 8 * S, 8 * S + S // 2]


def test_kernel_timers_come_before_loop_timers_of_the_same_moment() -> None:
    async def main(clock: SimulatedClock) -> list[str]:
        seen: list[str] = []
        loop, event = asyncio.get_running_loop(), asyncio.Event()

        async def woken() -> None:
            await event.wait()
            for _ in range(50):
                await asyncio.sleep(0)
            seen.append("woken")

        task = asyncio.ensure_future(woken())
        loop.call_later(1, seen.append, "loop")
        timers_for(clock).call_at(S, lambda: seen.append("first"))
        timers_for(clock).call_at(S, event.set)
        timers_for(clock).call_at(S, lambda: timers_for(clock).call_at(0, lambda: seen.append("again")) and None)
        await clock.advance(1)
        await task
        return seen

    assert simulate(main) == ["first", "woken", "again", "loop"]


def test_cancelled_loop_timers_neither_run_nor_pile_up() -> None:
    async def main(clock: SimulatedClock) -> int:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, SimulatedLoop)
        for _ in range(10_000):
            loop.call_later(100, pytest.fail, "cancelled").cancel()
        piled = len(loop._timers)
        await asyncio.sleep(200)
        return piled

    assert simulate(main) < 200


@pytest.mark.fault("C14")
@pytest.mark.parametrize("delay", [math.nan])
def test_delay_that_is_no_number_is_refused(delay: float) -> None:
    async def main(clock: SimulatedClock) -> None:
        with pytest.raises(ValueError, match="delay"):
            await asyncio.sleep(delay)
        with pytest.raises(ValueError, match="when="):
            asyncio.get_running_loop().call_at(delay, lambda: None)
        await asyncio.sleep(-1)

    simulate(main)


def test_infinite_delay_never_ends() -> None:
    async def main(clock: SimulatedClock) -> None:
        with anyio.move_on_after(5):
            await asyncio.sleep(math.inf)
        with anyio.move_on_after(5):
            await asyncio.sleep(1e300)

    clock = SimulatedClock()
    simulate(main, clock=clock)
    assert clock.monotonic_ns() == 10 * S


# -- threads, sockets, holds -------------------------------------------------------------------------------------------


async def _executor() -> str:
    return await asyncio.get_running_loop().run_in_executor(None, _work)


async def _own_executor() -> str:
    with ThreadPoolExecutor(1) as executor:
        return await asyncio.get_running_loop().run_in_executor(executor, _work)


async def _asyncio_thread() -> str:
    return await asyncio.to_thread(_work)


async def _anyio_thread() -> str:
    return await anyio.to_thread.run_sync(_work)


async def _anyio_thread_of_a_limiter() -> str:
    return await anyio.to_thread.run_sync(_work, limiter=anyio.CapacityLimiter(1))


async def _own_thread() -> str:
    loop, clock = asyncio.get_running_loop(), current_clock()
    assert clock is not None
    done, hold = loop.create_future(), clock.hold()

    def run() -> None:
        with hold:
            result = _work()
            loop.call_soon_threadsafe(done.set_result, result)

    thread = threading.Thread(target=run)
    thread.start()
    result = await done
    thread.join()
    return str(result)


def _work() -> str:
    time.sleep(0.05)
    return "done"


@pytest.mark.slow
@pytest.mark.parametrize(
    "work", [_executor, _own_executor, _asyncio_thread, _anyio_thread, _anyio_thread_of_a_limiter, _own_thread]
)
def test_time_stands_still_while_a_thread_works(work: Callable[[], object]) -> None:
    async def main(clock: SimulatedClock) -> None:
        ticker = asyncio.ensure_future(asyncio.sleep(0.001))
        for _ in range(2):
            before = clock.monotonic_ns()
            with anyio.fail_after(0.0005):
                assert await work() == "done"  # type: ignore[misc]
            assert clock.monotonic_ns() == before
            assert not ticker.done()
        await ticker
        assert clock.monotonic_ns() == S // 1000

    simulate(main)


def test_loopback_sockets_work_and_stop_time_while_data_is_on_its_way() -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(await reader.readline())
        await writer.drain()
        writer.close()
        await writer.wait_closed()

    async def main(clock: SimulatedClock) -> bytes:
        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        async with server:
            await asyncio.sleep(10)  # a listening socket alone does not stop time
            assert clock.monotonic_ns() == 10 * S
            reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname()[:2])
            writer.write(b"hello\n")
            async with asyncio.timeout(0.001):
                line = await reader.readline()
            writer.close()
            await writer.wait_closed()
        assert clock.monotonic_ns() == 10 * S
        await asyncio.sleep(1)
        return line

    assert simulate(main) == b"hello\n"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="pipes are no readers there")
def test_registered_reader_stops_time_until_it_is_removed(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(simulation, "_SAY_SO_AFTER_S", 0.02)
    read, write = os.pipe()

    async def main(clock: SimulatedClock) -> int:
        loop = asyncio.get_running_loop()
        got = loop.create_future()
        loop.add_reader(read, lambda: got.done() or got.set_result(os.read(read, 1)))
        thread = threading.Timer(0.1, os.write, (write, b"x"))
        thread.start()
        async with asyncio.timeout(1):
            assert await got == b"x"
        at = clock.monotonic_ns()
        loop.remove_reader(read)
        thread.join()
        await asyncio.sleep(1)
        return at

    with caplog.at_level(logging.WARNING):
        assert simulate(main) == 0
    os.close(read)
    os.close(write)
    assert f"waiting for descriptors [{read}]" in caplog.text


@pytest.mark.slow
def test_time_stands_still_while_a_child_process_runs() -> None:
    async def main(clock: SimulatedClock) -> int:
        code = "import time; time.sleep(0.1)"
        async with asyncio.timeout(0.001):
            child = await asyncio.create_subprocess_exec(sys.executable, "-c", code)
            assert await child.wait() == 0
            child = await asyncio.create_subprocess_shell("exit 3", stdout=subprocess.PIPE)
            await child.communicate()
        with pytest.raises(FileNotFoundError):
            await asyncio.create_subprocess_exec("/does/not/exist")
        assert clock.monotonic_ns() == 0
        await asyncio.sleep(1)
        return child.returncode or 0

    assert simulate(main) == 3


def test_real_clock_on_the_simulated_loop_waits_in_real_time() -> None:
    async def main(clock: SimulatedClock) -> None:
        start = time.monotonic()
        async with asyncio.timeout(0.001):
            await sleep(SystemClock(), 0.02)
        assert time.monotonic() - start >= 0.02
        assert clock.monotonic_ns() == 0
        await asyncio.sleep(1)

    simulate(main)


# -- ends -------------------------------------------------------------------------------------------------------------


def test_nothing_left_to_happen_is_an_error_that_says_who_waits() -> None:
    async def stuck() -> None:
        await asyncio.Event().wait()

    async def main(clock: SimulatedClock) -> None:
        task = asyncio.ensure_future(stuck())
        await asyncio.sleep(2)
        await task

    with pytest.raises(StateError, match=r"2\.0+ s: nothing will ever happen.*stuck \(test_simulation\.py:\d+\)"):
        simulate(main)


def test_everything_is_closed_in_order() -> None:
    log: list[str] = []
    policy = asyncio.get_event_loop_policy()

    async def stream() -> AsyncIterator[int]:
        try:
            yield 1
            yield 2
        finally:
            await asyncio.sleep(1)
            log.append("stream closed")

    async def forever() -> None:
        try:
            await asyncio.sleep(1000)
        finally:
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(1)
            log.append("task cancelled")

    async def main(clock: SimulatedClock) -> None:
        global _kept_task, _kept_stream
        _kept_task = asyncio.ensure_future(forever())
        _kept_stream = stream()
        await anext(_kept_stream)
        await asyncio.to_thread(log.append, "thread ran")

    threads = set(threading.enumerate())
    simulate(main)
    assert log == ["thread ran", "task cancelled", "stream closed"]
    assert set(threading.enumerate()) == threads
    assert asyncio.get_event_loop_policy() is policy


_kept_task: asyncio.Task[None]
_kept_stream: AsyncIterator[int]


def test_error_of_main_comes_out() -> None:
    async def main(clock: SimulatedClock) -> None:
        await asyncio.sleep(1)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        simulate(main)


def test_failing_kernel_timer_is_reported_and_the_loop_goes_on() -> None:
    async def main(clock: SimulatedClock) -> list[type]:
        reports: list[type] = []
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: reports.append(type(context["exception"])))
        clock.call_at(1, lambda: 1 // 0)
        await sleep(clock, 1)
        return reports

    assert simulate(main) == [ZeroDivisionError]


def test_simulate_inside_of_a_loop_is_refused() -> None:
    async def main(clock: SimulatedClock) -> None:
        with pytest.raises(StateError, match="running"):
            simulate(asyncio.sleep(0))

    simulate(main)


def test_clock_belongs_to_one_loop_at_a_time() -> None:
    clock = SimulatedClock()
    loop = SimulatedLoop(clock)
    with pytest.raises(BusyError):
        SimulatedLoop(clock)
    with pytest.raises(BusyError, match="own simulated loop"):
        asyncio.run(clock.advance(1))
    loop.close()
    loop.close()
    SimulatedLoop(clock).close()
    asyncio.run(clock.advance(1))
    assert clock.monotonic_ns() == S


def test_another_simulated_clock_on_the_loop_moves_by_advance_only() -> None:
    other = SimulatedClock()

    async def main(clock: SimulatedClock) -> None:
        task = asyncio.ensure_future(sleep(other, 5))
        await asyncio.sleep(100)
        assert not task.done()
        await other.advance(5)
        assert task.done()

    simulate(main)


# -- the same everywhere ---------------------------------------------------------------------------------------------

SCENARIO = """
import asyncio, random, sys
from aiorts.clock import SimulatedClock
from aiorts.kernel.loop.timers import sleep_until, timers_for
from aiorts.testing.simulation import simulate

async def scenario(clock):
    rng, queue, log, pending = random.Random(5), timers_for(clock), [], []
    def fire(name):
        log.append((clock.monotonic_ns(), name))
        if rng.random() < 0.5:
            pending.append(queue.call_at(clock.monotonic_ns() + rng.randrange(-5, 40), lambda: fire(name + "'")))
        if pending and rng.random() < 0.3:
            pending.pop(rng.randrange(len(pending))).cancel()
    async def periodic(name, period):
        for n in range(1, 40):
            await sleep_until(clock, n * period)
            log.append((clock.monotonic_ns(), name))
    tasks = [asyncio.ensure_future(periodic(f"task{p}", p)) for p in (7, 5, 35, 10)]
    for n in range(200):
        pending.append(queue.call_at(rng.randrange(1400), lambda n=n: fire(f"timer{n}")))
    await clock.advance_to(1400)
    await asyncio.gather(*tasks)
    return log

if sys.argv[1] == "simulated":
    log = simulate(scenario)
elif sys.argv[1] == "uvloop":
    import uvloop
    log = uvloop.run(scenario(SimulatedClock()))
else:
    log = asyncio.run(scenario(SimulatedClock()))
print(len(log), log)
"""


@pytest.mark.slow(kept_by="determinism/test_determinism.py::test_two_processes_on_two_loops_each_give_the_same_bytes")
def test_order_is_the_same_on_every_loop_and_with_every_hash_seed() -> None:
    loops = ["simulated", "asyncio"]
    with contextlib.suppress(ImportError):
        import uvloop  # noqa: F401

        loops.append("uvloop")
    outputs = {
        subprocess.run(
            [sys.executable, "-c", SCENARIO, loop],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
            timeout=60,
        ).stdout
        for loop in loops
        for seed in ("1", "2")
    }
    assert len(outputs) == 1
    assert int(next(iter(outputs)).split(maxsplit=1)[0]) > 300
