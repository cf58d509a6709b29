"""An asyncio loop whose time jumps: when nothing is ready, the next timer is now.

The rule of a jump, in this order: callbacks that are ready run; while a thread, a connected socket or a hold is waited
for, time stands still; then the kernel timers of the earliest deadline fire, all together in the order of their
creation; callbacks that they made ready run; then the loop's own timers (`asyncio.sleep`, timeouts) of that moment
fire. When nothing is left that could ever happen, StateError names the tasks that wait, instead of hanging. Callbacks
from other threads (`call_between_instants`) run before a jump, one at a time, and never hold time.

    async def main(clock: SimulatedClock) -> float:
        await asyncio.sleep(3600)
        return clock.time()

    assert simulate(main) == 3600.0

With a seed, tasks that are ready at one instant run in another order, always the same one (`order.py` says what stays):
code that fails under some seed relies on an order that asyncio does not promise.
"""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import inspect
import math
import selectors
import time
from collections import deque
from collections.abc import Coroutine
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, TypeVarTuple, Unpack

from aiorts.clock import Hold, SimulatedClock, current_clock, to_ns
from aiorts.errors import BusyError, StateError
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.testing.order import Shuffle
from aiorts.testing.outside import AnyioThreads, listens

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping
    from concurrent.futures import Executor
    from contextvars import Context

__all__ = ("SimulatedLoop", "current_clock", "simulate")

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

_log = KernelLog(__name__)

_SAY_SO_AFTER_S = 5.0
"""Real seconds for which time stands still before the log states what it waits for."""

_NEVER_S = 1e15
"""Delays of thirty million years and more, infinity included, are not waited for."""

_POLL_EVERY = 256
"""Turns between looks at the loop's own wake-up socket while there is nothing else to poll."""

_WAY_S = 0.0002
"""Real seconds that the interpreter is left to a thread that wants it."""


def simulate(
    main: Callable[[SimulatedClock], Awaitable[T]] | Coroutine[Any, Any, T],
    *,
    clock: SimulatedClock | None = None,
    seed: int | None = None,
) -> T:
    """Run `main` to its end on a new `SimulatedLoop` and return its result; `asyncio.run` in virtual time.

    `main` is a coroutine, or a function that is given the clock and returns something to await: `simulate(main())` for
    `async def main()`, `simulate(main)` for `async def main(clock)`. Tasks left over are cancelled, asynchronous
    generators and the default executor shut down, the event loop policy is never touched. `seed` shuffles the tasks
    ready at one instant (see `SimulatedLoop`); an exception then names the seed. Raises StateError when called from a
    running loop, or when nothing will ever happen again; TypeError when `main` is neither of the two.
    """
    clock = SimulatedClock() if clock is None else clock
    coroutine = main if isinstance(main, Coroutine) else _call(_taking_a_clock(main), clock)
    if _inside_a_loop():
        coroutine.close()
        raise StateError("simulate(): a loop is running in this thread; await the code, or call simulate from outside")
    try:
        with asyncio.Runner(loop_factory=lambda: SimulatedLoop(clock, seed=seed)) as runner:
            return runner.run(coroutine)
    except BaseException as error:
        if seed is not None:
            error.add_note(f"simulate(..., seed={seed}) runs what is ready at one instant in this order again")
        raise


def _inside_a_loop() -> bool:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True


def _taking_a_clock(main: Callable[[SimulatedClock], Awaitable[T]]) -> Callable[[SimulatedClock], Awaitable[T]]:
    """Return `main` as a function of a clock; TypeError unless it can be called with a clock as its only argument."""
    if not callable(main):
        raise TypeError(f"simulate(): expected a coroutine, or a function that takes the clock, got {main!r:.200}")
    try:
        signature = inspect.signature(main)
    except ValueError:
        return main  # written in C: the call itself refuses a wrong argument
    name = getattr(main, "__name__", "main")
    try:
        signature.bind(None)
    except TypeError as error:
        what = f"simulate({name}) calls {name} with the clock alone, but it is {name}{signature}"
        form = f"simulate({name}())" if not signature.parameters else f"simulate({name}(...)) with its arguments"
        raise TypeError(f"{what} ({error}); write {form}, or give it one parameter: {name}(clock)") from None
    return main


async def _call(main: Callable[[SimulatedClock], Awaitable[T]], clock: SimulatedClock) -> T:
    found = main(clock)
    if not inspect.isawaitable(found):
        name = getattr(main, "__name__", "main")
        raise TypeError(f"simulate({name}): {name} returned {found!r:.200}, nothing to await; write async def {name}")
    return await found


class _OwnTimer(asyncio.TimerHandle):
    """A loop timer; `_scheduled` says that it lies in the loop's heap."""

    if TYPE_CHECKING:
        _scheduled: bool


class SimulatedLoop(asyncio.SelectorEventLoop):
    """A selector event loop in virtual time; `loop.time()` is `aiorts_clock.monotonic_ns() / 1e9`.

    Delays are rounded once to whole nanoseconds and kept as integers, so that sums of them are exact. Threads started
    by `run_in_executor`, `asyncio.to_thread` and `anyio.to_thread` and child processes stop time while they run; a
    thread of your own does with `clock.hold()`. So does every registered reader or writer, listening sockets excepted.

    Args:
        clock: the clock to move; a new one by default.
        seed: shuffle the tasks that are ready at one instant, reproducibly, within what asyncio promises
            (`aiorts.testing.order`); None leaves them in the order in which they became ready.
    """

    if TYPE_CHECKING:
        _ready: deque[asyncio.Handle]

        def _check_closed(self) -> None: ...

        def _write_to_self(self) -> None: ...

        _process_events: Callable[[list[Any]], None]

    def __init__(self, clock: SimulatedClock | None = None, *, seed: int | None = None) -> None:
        self.aiorts_clock = SimulatedClock() if clock is None else clock
        self._timers: list[tuple[int, int, _OwnTimer]] = []
        self._timers_made = 0
        self._timers_cancelled = 0
        self._anyio = AnyioThreads(self)
        self._outside: deque[Callable[[], object]] = deque()
        """Callbacks from other threads, to be called between two instants."""
        self._ways: list[Callable[[], bool]] = []
        """Functions that return whether a thread wants to run, which a loop that never waits would not let it do."""
        super().__init__(_JumpingSelector(self))
        if seed is not None:
            self._process_events = partial(_shuffled, self, self._process_events, Shuffle(seed))
        try:
            self._detach = self.aiorts_clock.attach(self._sleep_until)
        except BusyError:
            super().close()
            raise
        self._remove_listener = self.aiorts_clock.on_release(self._wake)

    def close(self) -> None:
        if not self.is_closed():
            self._remove_listener()
            self._detach()
        super().close()

    # -- time -----------------------------------------------------------------------------------------------------

    def time(self) -> float:
        return self.aiorts_clock.now_ns / 1e9

    def call_later(
        self, delay: float, callback: Callable[[Unpack[Ts]], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.TimerHandle:
        if delay >= _NEVER_S:
            return self._call_at_ns(None, callback, args, context)
        return self._call_at_ns(self.aiorts_clock.now_ns + to_ns(delay, "delay"), callback, args, context)

    def call_at(
        self, when: float, callback: Callable[[Unpack[Ts]], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.TimerHandle:
        if when >= _NEVER_S:
            return self._call_at_ns(None, callback, args, context)
        deadline = to_ns(when, "when")
        # The callback must find loop.time() >= when, or it would set a timer again and again.
        step = 1
        while deadline / 1e9 < when:
            deadline += step
            step *= 2  # far in the future a float is many nanoseconds wide
        return self._call_at_ns(deadline, callback, args, context)

    def _call_at_ns(
        self,
        deadline_ns: int | None,
        callback: Callable[[Unpack[Ts]], object],
        args: tuple[*Ts],
        context: Context | None,
    ) -> asyncio.TimerHandle:
        """Make a timer; with `deadline_ns` None it never fires."""
        self._check_closed()
        when = math.inf if deadline_ns is None else deadline_ns / 1e9
        handle = _OwnTimer(when, callback, args, self, context)
        if deadline_ns is not None:
            self._timers_made += 1
            heapq.heappush(self._timers, (deadline_ns, self._timers_made, handle))
            handle._scheduled = True
        return handle

    def _timer_handle_cancelled(self, handle: _OwnTimer) -> None:
        if not handle._scheduled:
            return
        self._timers_cancelled += 1
        if self._timers_cancelled > 64 and self._timers_cancelled * 2 > len(self._timers):
            self._timers = [entry for entry in self._timers if not entry[2].cancelled()]
            heapq.heapify(self._timers)
            self._timers_cancelled = 0

    async def _sleep_until(self, monotonic_ns: int) -> None:
        # This runs twice: before the second run, everything that the timers of that moment made ready has run.
        for _ in range(2):
            future = self.create_future()
            handle = self._call_at_ns(monotonic_ns, _wake_future, (future,), None)
            try:
                await future
            finally:
                handle.cancel()

    def _next_own(self) -> int | None:
        timers = self._timers
        while timers:
            if not timers[0][2].cancelled():
                return timers[0][0]
            heapq.heappop(timers)[2]._scheduled = False
            self._timers_cancelled -= 1
        return None

    def _jump(self) -> bool:
        """Move time to the next moment at which something happens; False when there is none."""
        clock = self.aiorts_clock
        kernel, own = clock.next_deadline(), self._next_own()
        if kernel is not None and (own is None or kernel <= max(own, clock.now_ns)):
            clock.fire(self)
        elif own is not None:
            clock.move_to(own)
            self._fire_own(clock.now_ns)
        else:
            return False
        return True

    def _fire_own(self, now_ns: int) -> None:
        timers = self._timers
        while timers and timers[0][0] <= now_ns:
            handle = heapq.heappop(timers)[2]
            handle._scheduled = False
            if handle.cancelled():
                self._timers_cancelled -= 1
            else:
                self._ready.append(handle)

    # -- calls from outside ---------------------------------------------------------------------------------------

    def call_between_instants(self, callback: Callable[[], object]) -> None:
        """Call `callback` before time goes on, when nothing is ready any more. From any thread; it holds no time.

        RuntimeError when the loop is closed.
        """
        self._check_closed()
        self._outside.append(callback)
        self._write_to_self()

    def give_way(self, wanted: Callable[[], bool]) -> Callable[[], None]:
        """Let a thread run whenever `wanted()` says that it has work, until the returned function is called."""
        self._ways.append(wanted)
        return lambda: self._ways.remove(wanted)

    def _give_way(self) -> None:
        for wanted in self._ways:
            if wanted():
                time.sleep(_WAY_S)

    def _take_outside(self) -> bool:
        """Make the next callback from outside ready; False when there is none."""
        if not self._outside:
            return False
        self.call_soon(self._outside.popleft())
        return True

    # -- what stops time ------------------------------------------------------------------------------------------

    def _standing_still(self) -> bool:
        return self.aiorts_clock.held or self._anyio.busy()

    def _wake(self) -> None:
        if not self.is_closed():
            self.call_soon_threadsafe(_nothing)

    def run_in_executor(
        self, executor: Executor | None, func: Callable[[Unpack[Ts]], T], *args: *Ts
    ) -> asyncio.Future[T]:
        future = super().run_in_executor(executor, func, *args)
        hold = self.aiorts_clock.hold()
        future.add_done_callback(lambda _: hold.release())
        return future

    async def subprocess_exec(self, protocol_factory: Callable[[], Any], *args: Any, **options: Any) -> Any:
        return await self._spawned(super().subprocess_exec, protocol_factory, *args, **options)

    async def subprocess_shell(self, protocol_factory: Callable[[], Any], *args: Any, **options: Any) -> Any:
        return await self._spawned(super().subprocess_shell, protocol_factory, *args, **options)

    async def _spawned(
        self, spawn: Callable[..., Awaitable[Any]], protocol_factory: Callable[[], Any], *args: Any, **options: Any
    ) -> Any:
        with contextlib.ExitStack() as stack:
            hold = stack.enter_context(self.aiorts_clock.hold())
            made = await spawn(_until_exit(protocol_factory, hold), *args, **options)
            stack.pop_all()
        return made

    async def shutdown_default_executor(self, *args: Any, **options: Any) -> None:
        with self.aiorts_clock.hold():
            await super().shutdown_default_executor(*args, **options)

    def _deadlock(self) -> StateError:
        waiting = sorted(_where(task) for task in asyncio.all_tasks(self))
        more = f" and {len(waiting) - 8} more" if len(waiting) > 8 else ""
        return StateError(
            f"simulated loop at {self.time():.9f} s: nothing will ever happen: no timer, no thread, no socket is left"
            f" and these tasks still wait: {'; '.join(waiting[:8]) or 'none'}{more}. A thread of your own that is to"
            " wake the loop must hold the clock: with clock.hold(): ..."
        )


def _shuffled(
    loop: SimulatedLoop, process_events: Callable[[list[Any]], None], shuffle: Shuffle, event_list: list[Any]
) -> None:
    """Process events, then shuffle: the last step of a loop with a seed before it runs the ready handles."""
    process_events(event_list)
    shuffle(loop._ready)


def _until_exit(protocol_factory: Callable[[], Any], hold: Hold) -> Callable[[], Any]:
    """A factory of the same protocols, which release `hold` when their process has exited."""

    def factory() -> Any:
        protocol = protocol_factory()
        exited = protocol.process_exited

        def process_exited() -> None:
            hold.release()
            exited()

        protocol.process_exited = process_exited
        return protocol

    return factory


def _nothing() -> None:
    """Do nothing: the call itself wakes a loop."""


def _wake_future(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _where(task: asyncio.Task[Any]) -> str:
    """The chain of coroutines that a task is suspended in, each with file and line."""
    steps = []
    step: Any = task.get_coro()
    while (frame := getattr(step, "cr_frame", None)) is not None:
        code = frame.f_code
        if code is not _call.__code__:
            steps.append(f"{code.co_qualname} ({code.co_filename.rpartition('/')[2]}:{frame.f_lineno})")
        step = step.cr_await
    return " > ".join(steps) or task.get_name()


class _JumpingSelector(selectors.BaseSelector):
    """The default selector, except that time jumps where it would wait."""

    def __init__(self, loop: SimulatedLoop) -> None:
        self._loop = loop
        self._real = selectors.DefaultSelector()
        self._turns = 0
        self._awaited = 0
        self._passive: set[int] = set()

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        key = self._real.register(fileobj, events, data)
        # The first descriptor is the loop's own wake-up socket.
        if len(self._real.get_map()) == 1 or listens(key.fd):
            self._passive.add(key.fd)
        else:
            self._awaited += 1
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        key = self._real.unregister(fileobj)
        if key.fd in self._passive:
            self._passive.discard(key.fd)
        else:
            self._awaited -= 1
        return key

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.modify(fileobj, events, data)

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._real.get_map()

    def close(self) -> None:
        self._real.close()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self._turns += 1
        if self._turns % _POLL_EVERY == 0:
            self._loop._give_way()
        if self._awaited or len(self._passive) > 1 or self._turns % _POLL_EVERY == 0:
            events = self._real.select(0)
            if events:
                return events
        if timeout == 0:
            return []
        loop = self._loop
        if loop._take_outside():
            return []
        if self._awaited or loop._standing_still():
            return self._wait()
        # Checked after the holds: a callback that a thread handed over before it released its hold precedes the jump.
        if loop._ready or loop._jump():
            return []
        if len(self._passive) > 1:
            return self._wait()
        raise loop._deadlock()

    def _wait(self) -> list[tuple[selectors.SelectorKey, int]]:
        events = self._real.select(_SAY_SO_AFTER_S)
        if not events:
            descriptors = sorted(key.fd for key in self._real.get_map().values() if key.fd not in self._passive)
            _log.warning(
                "simulated time stands still at %.9f s: waiting for %s",
                self._loop.time(),
                f"descriptors {descriptors}" if descriptors else "a thread, a hold or a client",
            )
        return events
