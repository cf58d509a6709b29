"""Loops that are neither asyncio's nor uvloop's: their timers serve, and time is theirs."""

from __future__ import annotations

import asyncio
import contextvars
import time
from typing import TYPE_CHECKING, Any, NoReturn

import pytest

from aiorts import Component, Kernel, PeriodicContext, SystemClock
from aiorts.testing import SimulatedLoop

if TYPE_CHECKING:
    from collections.abc import Callable

S = 1_000_000_000


class Simulator(asyncio.SelectorEventLoop):
    """A simulator's loop: when nothing is ready its time jumps to the next timer. It polls no descriptors."""

    def __init__(self, start: float) -> None:
        super().__init__()
        self.now = start
        self._clock_resolution = 1e-6  # a float of 1.7e9 s is good for a quarter of a microsecond

    def time(self) -> float:
        return self.now

    def add_reader(self, *_: object) -> NoReturn:
        raise RuntimeError("no descriptors here")

    def _run_once(self) -> None:
        scheduled: list[Any] = self._scheduled  # type: ignore[attr-defined]
        if not self._ready and scheduled:  # type: ignore[attr-defined]
            self.now = max(self.now, scheduled[0].when())
        super()._run_once()  # type: ignore[misc]


class Browser(asyncio.AbstractEventLoop):
    """As Pyodide's: no loop of asyncio's is a base, timers are the browser's (here another loop's), and no files."""

    def __init__(self) -> None:
        self._under = asyncio.new_event_loop()

    def time(self) -> float:
        return time.monotonic()

    def call_soon(self, callback: Callable[..., object], *args: Any, context: Any = None) -> asyncio.Handle:
        return self._under.call_soon(
            self._call, contextvars.copy_context() if context is None else context, callback, args
        )

    call_soon_threadsafe = call_soon

    def call_later(  # type: ignore[override]
        self, delay: float, callback: Callable[..., object], *args: Any, context: Any = None
    ) -> asyncio.Handle:
        given = contextvars.copy_context() if context is None else context
        return self._under.call_later(delay, self._call, given, callback, args)

    def call_at(  # type: ignore[override]
        self, when: float, callback: Callable[..., object], *args: Any, context: Any = None
    ) -> asyncio.Handle:
        return self.call_later(when - self.time(), callback, *args, context=context)

    def _call(self, context: contextvars.Context, callback: Callable[..., object], args: Any) -> None:
        asyncio._set_running_loop(self)
        try:
            context.run(callback, *args)
        finally:
            asyncio._set_running_loop(self._under)

    def create_future(self) -> asyncio.Future[Any]:
        return asyncio.Future(loop=self)

    def create_task(self, coroutine: Any, *, name: str | None = None, context: Any = None) -> asyncio.Task[Any]:
        return asyncio.Task(coroutine, loop=self, name=name, context=context)

    def get_task_factory(self) -> None:
        return None

    def set_task_factory(self, factory: object) -> None:
        """It makes its tasks itself."""

    def get_exception_handler(self) -> None:
        return None

    def set_exception_handler(self, handler: object) -> None:
        """What goes wrong is in the console."""

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        raise AssertionError(context)

    def get_debug(self) -> bool:
        return False

    def is_running(self) -> bool:
        return True

    def is_closed(self) -> bool:
        return False

    def run(self, main: Any) -> Any:
        async def wait() -> Any:
            done = self._under.create_future()
            self.call_soon(lambda: self.create_task(main).add_done_callback(done.set_result))
            return (await asyncio.wait_for(done, 60.0)).result()

        try:
            return self._under.run_until_complete(wait())
        finally:
            self._under.close()


class Ticker(Component):
    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.ticks: list[tuple[int, int]] = []

    def on_execute(self) -> None:
        self.ticks.append((self.clock.monotonic_ns(), self.clock.time_ns()))


async def tick_for(seconds: float, rate: float, **options: Any) -> tuple[Ticker, PeriodicContext]:
    async with Kernel(**options) as kernel:
        ticker = await kernel.create(Ticker, "ticker")
        context = await kernel.start(PeriodicContext(rate), ticker, activate=True)
        await kernel.sleep(seconds)
        return ticker, context


@pytest.mark.slow(kept_by="test_a_loop_that_is_not_asyncios_at_all_serves_with_its_own_timers")
@pytest.mark.parametrize("start", [0.0, 1e3, 1.7e9], ids=str)
def test_on_a_simulators_loop_time_is_the_simulators(start: float) -> None:
    loop = Simulator(start)
    try:
        begun = time.monotonic()
        ticker, context = loop.run_until_complete(asyncio.wait_for(tick_for(60.0, 100.0), 120.0))
        assert time.monotonic() - begun < 50.0, "a minute of the loop's time is no minute"
    finally:
        loop.close()
    assert loop.now - start == pytest.approx(60.0, abs=2e-6)
    first, stamp = ticker.ticks[0]
    assert len(ticker.ticks) in (6000, 6001)
    for number, (now, stamped) in enumerate(ticker.ticks):
        assert abs(now - first - number * S // 100) < 2000
        assert stamped - stamp == now - first
    assert context.statistics.skipped == 0


def test_kernels_on_one_loop_share_its_time() -> None:
    async def main() -> None:
        async with Kernel() as one, Kernel() as other:
            assert one.clock is other.clock
            await one.sleep(3600.0)
            assert abs(one.clock.monotonic_ns() - 3600 * S) < 1000

    loop = Simulator(0.0)
    try:
        loop.run_until_complete(asyncio.wait_for(main(), 7200.0))
    finally:
        loop.close()


def test_a_kernel_that_is_given_the_machines_clock_waits_in_real_time_on_any_loop() -> None:
    loop = Simulator(0.0)
    begun = time.monotonic()
    try:
        loop.run_until_complete(tick_for(0.05, 100.0, clock=SystemClock()))
    finally:
        loop.close()
    assert time.monotonic() - begun >= 0.05


def test_a_loop_that_is_not_asyncios_at_all_serves_with_its_own_timers() -> None:
    async def main() -> Ticker:
        async with Kernel() as kernel:
            ticker = await kernel.create(Ticker, "ticker")
            await kernel.start(PeriodicContext(100.0), ticker, activate=True)
            while len(ticker.ticks) < 3:
                await kernel.sleep(0.01)
            return ticker

    ticker = Browser().run(main())
    assert all(later > earlier for (earlier, _), (later, _) in zip(ticker.ticks, ticker.ticks[1:], strict=False))


@pytest.mark.parametrize("kind", ["asyncio", "uvloop", "simulated"])
def test_on_the_known_loops_nothing_is_different(kind: str) -> None:
    if kind == "uvloop":
        loop: asyncio.AbstractEventLoop = pytest.importorskip("uvloop").new_event_loop()
    else:
        loop = SimulatedLoop() if kind == "simulated" else asyncio.new_event_loop()

    async def main() -> str:
        async with Kernel() as kernel:
            return type(kernel.clock).__name__

    try:
        expected = "SimulatedClock" if kind == "simulated" else "SystemClock"
        assert loop.run_until_complete(main()) == expected
    finally:
        loop.close()
