"""The driver of a real-time thread: it carries out a context's steps, waits for deadlines and for nothing else.

For a near deadline the thread sleeps by the system's absolute sleep, which no request cuts short. For a far one it
first waits in slices that a request ends. Garbage is collected before the thread sleeps. A coroutine is stepped once:
if it suspends, there is no event loop to go on.
"""

from __future__ import annotations

import time
from collections.abc import Coroutine
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import SimulatedClock
from aiorts.contexts.thread import ThreadDriver
from aiorts.errors import StateError
from aiorts.kernel.execution.cycle import TURN, Step
from aiorts.kernel.execution.hooks import bad_return
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.realtime.nanosleep import relative_sleep
from aiorts.realtime.privileges import Granted, obtain
from aiorts.realtime.process import SETTINGS

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import KernelSide
    from aiorts.kernel.execution.member import Member
    from aiorts.realtime.realtime_context import RealtimeContext

_LOG = KernelLog()
_FAR_NS: Final = 20_000_000
"""The longest time, if shorter than a period, that a request waits."""
_NEAR_NS: Final = 5_000_000
_SLICE_NS: Final = 50_000_000
"""The longest time between two looks for garbage."""
_BREATH_NS: Final = 50_000
"""The sleep of a thread that is always late, after each cycle: others want the processor, too."""
_UNBOUNDED_TURNS: Final = 1 << 29
_GUARD_SECONDS: Final = 1.0


class RealtimeDriver(ThreadDriver):
    """Carries out the steps of a real-time context's life in its thread; with a simulated clock as any thread does."""

    def __init__(self, context: RealtimeContext, kernel: KernelSide) -> None:
        self._realtime = context
        self._virtual = isinstance(kernel.clock, SimulatedClock)
        self._real_ns = kernel.clock.real_deadline_ns
        self._sleep = relative_sleep
        self._parked = False
        self._acquired = False
        super().__init__(context, kernel)
        # After the thread was made, which may fail.
        self._guard = None if self._virtual else kernel.loop.call_later(_GUARD_SECONDS, self._relieve)

    def kick(self) -> None:
        if self._virtual:
            super().kick()
            return
        # No lock holds up a thread that is about to sleep: it checks the flag before and after.
        self._kicked = True
        if self._parked:
            with self._changed:
                self._changed.notify_all()

    # -- the thread ------------------------------------------------------------------------------------------------

    def _thread_began(self) -> None:
        if self._virtual:
            return
        SETTINGS.acquire()
        self._acquired = True
        granted, self._sleep = obtain(self._realtime._wanted)
        self._realtime._granted = granted
        if granted.denied:
            self._kernel.call_on_loop(lambda: _report_denied(self._realtime.name, granted))

    def _carry_out(self, step: Step) -> BaseException | None:
        if step is TURN and not self._virtual:
            self._sleep(time.monotonic_ns() + _BREATH_NS)
            return None
        return super()._carry_out(step)

    def _wait(self, deadline_ns: int | None) -> None:
        if self._virtual:
            super()._wait(deadline_ns)
            return
        if not self._kicked:
            self._sleep_until(None if deadline_ns is None else self._real_ns(deadline_ns))
        # A request is made first, and the kick follows: a request whose kick is cleared here is seen next.
        self._kicked = False

    def _sleep_until(self, deadline_ns: int | None) -> None:
        while True:
            rest = _SLICE_NS + _FAR_NS if deadline_ns is None else deadline_ns - time.monotonic_ns()
            if SETTINGS.collects:
                SETTINGS.collect(rest)
            if deadline_ns is not None and rest <= _FAR_NS:
                break
            self._park(min(rest - _NEAR_NS, _SLICE_NS))
            if self._kicked:
                return
        spin_ns = self._realtime._longest_spin_ns()
        self._sleep(deadline_ns - spin_ns)
        if spin_ns:
            now_ns = time.monotonic_ns
            while now_ns() < deadline_ns:
                pass

    def _park(self, nanoseconds: int) -> None:
        """Wait for so many nanoseconds, or until a kick."""
        with self._changed:
            self._parked = True
            if not self._kicked:
                self._changed.wait(nanoseconds / 1e9)
            self._parked = False

    def _step(self, member: Member, hook: str, coroutine: Any) -> BaseException | None:
        # Awaited reads and writes would give the loop a turn now and then; there is none here.
        member.cell.turns.left = _UNBOUNDED_TURNS
        try:
            coroutine.send(None)
        except StopIteration as done:
            return None if done.value is None else bad_return(member.component.name, hook, done.value)
        where = _where(coroutine)
        coroutine.close()
        return StateError(
            f"{member.component.name}.{hook}: suspended{where}; hooks of a real-time context run without an event loop "
            "and end in one go: use read_nowait, latest and write_nowait, or run this component in a periodic context"
        )

    # -- on the loop -----------------------------------------------------------------------------------------------

    def _relieve(self) -> None:
        SETTINGS.relieve()
        self._guard = self._kernel.loop.call_later(_GUARD_SECONDS, self._relieve)

    def _let_go(self, fault: BaseException | None) -> None:
        if self._guard is not None:
            self._guard.cancel()
        super()._let_go(fault)
        if self._acquired:
            self._acquired = False
            if self._realtime._granted.locked:
                SETTINGS.unlock_memory()
            SETTINGS.release()


def _report_denied(name: str, granted: Granted) -> None:
    denied = "; ".join(f"no {what}: {reason}" for what, reason in granted.denied.items())
    _LOG.warning("%s: runs with less than was asked for: %s", name, denied)


def _where(coroutine: Coroutine[Any, Any, Any]) -> str:
    """The file and line in which a coroutine of the user's suspended."""
    frame: FrameType | None = coroutine.cr_frame  # type: ignore[attr-defined] # an `async def` function made it
    return "" if frame is None else f" in {frame.f_code.co_filename}:{frame.f_lineno}"
