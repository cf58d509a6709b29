"""A context whose hooks run in one thread of its own and may block: what reads serial ports and cameras.

The same steps as everywhere (`kernel/life.py`), carried out by a thread. Hooks are plain `def`. Their ports have a
lock, so every write and read takes the general path. A thread cannot be cancelled: a hook that does not return when
its context stops is left behind, and the steps that would have followed in that thread are not run.
"""

from __future__ import annotations

import asyncio
import threading
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.clock import Hold, SimulatedClock
from aiorts.contexts.periodic import PeriodicContext
from aiorts.contexts.schedule import MAX_RATE
from aiorts.errors import ClosedError, HookAbandoned, StateError
from aiorts.kernel.bulkhead import bad_return
from aiorts.kernel.bus import HookAfter, HookBefore
from aiorts.kernel.hooks import HookKind, is_plain
from aiorts.kernel.life import Batch, Call, Step, Wait
from aiorts.kernel.ports import InPort

if TYPE_CHECKING:
    from aiorts.kernel.bulkhead import StopBudget
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.member import Member
    from aiorts.kernel.ports import Port

__all__ = ("ThreadContext",)

_ON_LOOP: Final = ("on_initialize", "on_finalize")
"""Hooks that belong to no context and run on the kernel's loop."""
_FOR_EVER: Final = Wait(None)


class ThreadContext(PeriodicContext):
    """Runs its members in a thread of its own: `rate` times a second, or again as soon as they return.

    Args:
        rate: Hz; None runs a cycle as soon as the one before is over, while a member is active.
        overrun, max_rate, name, timing: see `PeriodicContext`.
    """

    kind: ClassVar[str] = "thread"

    def __init__(
        self,
        rate: float | None = None,
        *,
        overrun: str = "skip",
        max_rate: float = MAX_RATE,
        name: str = "",
        timing: bool = True,
    ) -> None:
        super().__init__(1.0 if rate is None else rate, overrun=overrun, max_rate=max_rate, name=name, timing=timing)
        if rate is None:
            self._schedule = None

    def _next_cause(self) -> Wait | None:
        if self._schedule is None and not any(member.active for member in self._members):
            return _FOR_EVER
        return super()._next_cause()

    def _check_can_add(self, component: Component) -> None:
        super()._check_can_add(component)
        awaiting = [hook for hook in is_plain(component._hook_kinds) if hook not in _ON_LOOP]
        if awaiting:
            raise StateError(
                f"{component.name}: {', '.join(awaiting)} is `async def`; the hooks of a thread context are plain `def`"
            )

    def _make_driver(self, kernel: Kernel) -> _ThreadDriver:
        return _ThreadDriver(self, kernel)

    def _port_added(self, member: Member, port: Port[Any]) -> None:
        member.component._host.threaded = True
        kernel = self._require_kernel()
        kernel._lock_ports(port)
        super()._port_added(member, port)

    def _set_ports_open(self, member: Member) -> None:
        super()._set_ports_open(member)
        if member.left:
            member.component._host.threaded = False
            member.component._host.thread_id = None

    def _inside(self) -> bool:
        driver = self._driver
        return isinstance(driver, _ThreadDriver) and driver.thread is threading.current_thread()


class _ThreadDriver:
    """Carries out the steps of a context's life in a thread."""

    def __init__(self, context: ThreadContext, kernel: Kernel) -> None:
        self.context = context
        self.hooks_run = 0
        self.ended: asyncio.Future[None] = kernel.loop.create_future()
        self._kernel = kernel
        self._steps = context._life.steps()
        self._changed = threading.Condition()
        self._kicked = False
        self._gone = False
        self._member: Member | None = None
        self._clock = kernel.clock
        # A simulated clock stands still while the thread works; who wakes it holds the clock on its behalf.
        self._hold: Hold | None = self._hold_clock()
        self.thread = threading.Thread(target=self._run, name=f"aiorts {context.name}", daemon=True)
        self.thread.start()

    @property
    def current(self) -> Member | None:
        """The member whose hook runs now."""
        return self._member

    def kick(self) -> None:
        """Somebody wants something: do not wait on. From any thread."""
        with self._changed:
            self._kicked = True
            if self._hold is None:
                self._hold = self._hold_clock()
            self._changed.notify_all()

    def hurry(self, budget: StopBudget) -> None:
        """A stop began: wake reads that block, and after the budget go on without the thread."""
        for member in self.context._members:
            member.component._host.stopping = True
            for port in member.component.ports.values():
                for connector in port.connectors:
                    connector.in_._wake_waiter()
                if isinstance(port, InPort):
                    port._wake_waiter()
        timer = self._kernel.loop.call_later(budget.limit + budget.grace, self._abandon)
        self.ended.add_done_callback(lambda _: timer.cancel())

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        for member in self.context._members:
            member.component._host.thread_id = threading.get_ident()
        fault: BaseException | None = None
        outcome: BaseException | None = None
        try:
            while not self._gone:
                outcome = self._carry_out(self._steps.send(outcome))
        except StopIteration:
            pass
        except BaseException as error:  # noqa: BLE001 - the kernel's own fault: the context ends and says so
            fault = error
        if not self._gone:
            self._kernel._on_loop(lambda: self._end(fault))
        self._let_clock_go()

    def _carry_out(self, step: Step) -> BaseException | None:
        if isinstance(step, Batch):
            for member, hook in step.hooks:
                error = self._call(member, hook, (member.failure,) if hook == "on_error" else ())
                if error is not None:
                    self.context._life.failed(member, hook, error)
                if self._gone:
                    return None
        elif isinstance(step, Wait):
            self._wait(step.deadline_ns)
        elif isinstance(step, Call):
            return self._call(step.member, step.hook, step.args)
        return None

    def _call(self, member: Member, hook: str, args: tuple[Any, ...]) -> BaseException | None:
        context, component = self.context, member.component
        component._host.thread_id = threading.get_ident()
        kind, function = member.hooks[hook]
        watched = context._hooks_wanted()
        if (kind == HookKind.ABSENT and not watched) or member.abandoned:
            return None
        started_ns = context._now_ns() if context.timing else 0
        if watched:
            context._publish(HookBefore(component.name, context.name, hook))
        self.hooks_run += 1
        self._member = component._running = member
        member.hook = hook
        error: BaseException | None = None
        try:
            result = function(*args)
            if result is not None and kind != HookKind.ABSENT:
                error = bad_return(member, hook, result)
        except BaseException as raised:  # noqa: BLE001 - the border round a hook
            error = raised
        self._member = component._running = None
        member.hook = ""
        if context._stopping and isinstance(error, ClosedError):
            error = None  # a blocking read or write was woken to let the context stop
        if context.timing:
            member.timed(hook).add(context._now_ns() - started_ns)
        if watched:
            context._publish(HookAfter(component.name, context.name, hook, error))
        return error

    def _wait(self, deadline_ns: int | None) -> None:
        clock = self._clock
        with self._changed:
            if not self._kicked:
                if isinstance(clock, SimulatedClock):
                    self._wait_simulated(deadline_ns)
                elif deadline_ns is None:
                    self._changed.wait_for(lambda: self._kicked)
                else:
                    rest = (deadline_ns - clock.monotonic_ns()) / 1e9 / clock.speed
                    self._changed.wait_for(lambda: self._kicked, max(0.0, rest))
            self._kicked = False

    def _wait_simulated(self, deadline_ns: int | None) -> None:
        """Virtual time is the loop's: its timer kicks, and the clock is let go only once that timer is set."""
        if deadline_ns is None:
            self._let_clock_go()
        else:
            deadline = deadline_ns

            def arm() -> None:
                self._kernel._timers.call_at(deadline, self.kick)
                self._let_clock_go()

            self._kernel.loop.call_soon_threadsafe(arm)
        self._changed.wait_for(lambda: self._kicked)

    def _hold_clock(self) -> Hold | None:
        return self._clock.hold() if isinstance(self._clock, SimulatedClock) else None

    def _let_clock_go(self) -> None:
        with self._changed:
            hold, self._hold = self._hold, None
        if hold is not None:
            hold.release()

    # -- the end ---------------------------------------------------------------------------------------------------

    def _end(self, fault: BaseException | None) -> None:
        for member in self.context._members:
            member.component._host.stopping = False
        self.context._life_ended(fault)
        # The thread has nothing left to do but return.
        self.thread.join()
        if not self.ended.done():
            self.ended.set_result(None)

    def _abandon(self) -> None:
        """The hook did not return in time: the thread is left behind, and so are the steps that were to follow."""
        if self.ended.done():
            return
        self._gone = True
        member = self._member
        if member is not None:
            error = HookAbandoned(
                f"{member.component.name}.{member.hook}: blocks its thread and did not return when its context "
                "stopped; "
                "the thread was left behind"
            )
            member.abandoned = True
            self.context._life._record(member, member.hook, error)
        self._let_clock_go()
        self.context._life_ended(None)
        self.ended.set_result(None)
