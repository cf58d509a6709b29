"""A context whose hooks run in one thread of its own and may block: what reads serial ports and cameras.

The same steps as everywhere (`kernel/life.py`), carried out by a thread. Hooks are plain `def`. Their ports have a
lock, so every write and read takes the general path. A thread cannot be cancelled: a hook that does not return when
its context stops is left behind, and the steps that would have followed in that thread are not run.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.clock import current_clock
from aiorts.contexts.periodic import PeriodicContext
from aiorts.contexts.schedule import MAX_RATE
from aiorts.errors import ClosedError, HookAbandoned, StateError
from aiorts.kernel.blocking import PortLock, blocking_for
from aiorts.kernel.bus import HookAfter, HookBefore
from aiorts.kernel.crossings import lock_all
from aiorts.kernel.hooks import HookKind, bad_return, coroutine_hooks
from aiorts.kernel.life import Action, Batch, Call, Step, Wait
from aiorts.kernel.ports import InPort, ServicePort
from aiorts.kernel.service_ends import unanswerable

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.deadlines import StopBudget
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.member import Member
    from aiorts.kernel.ports import Port

__all__ = ("ThreadContext", "ThreadDriver")

_ON_LOOP: Final = ("on_initialize", "on_finalize")
"""Hooks that belong to no context and run on the kernel's loop."""
_ABSENT: Final = HookKind.ABSENT
_ASYNC: Final = HookKind.ASYNC
_FOR_EVER: Final = Wait(None)
_LEAST_NS: Final = 1_000_000
"""What a cycle without a rate takes at least of a clock that stands still while hooks run."""


class ThreadContext(PeriodicContext):
    """Runs its members in a thread of its own: `rate` times a second, or again as soon as they return.

    Args:
        rate: Hz; None runs a cycle as soon as the one before is over, while a member is active.
        overrun, max_rate, name, timing: see `PeriodicContext`.
    """

    kind: ClassVar[str] = "thread"
    exclusive: ClassVar[bool] = True
    suspends: ClassVar[bool] = False

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
        self._actions = deque()  # made now and kept: the loop and the thread both put in what they wish
        self._plan = self._schedule
        self._aborted = False
        self._begun_ns = -1
        if rate is None:
            self._schedule = None

    def _next_cause(self) -> Wait | None:
        if self._schedule is not None:
            return super()._next_cause()
        # Without a rate one that is in error runs `on_error` once; again and again would be a busy loop.
        if not self._aborted and not any(member.active for member in self._members):
            return _FOR_EVER
        if self._now_ns() <= self._begun_ns:
            # A simulated clock has not moved: hooks that wait for nothing would keep it from ever moving.
            return Wait(self._begun_ns + _LEAST_NS)
        return None

    def _submit(self, action: Action) -> None:
        super()._submit(action)
        for member in tuple(self._members):
            for port in member.component.ports.values():
                if isinstance(port, InPort) and port._lock is not None:
                    with port._lock:  # who rests there until data come looks at what is asked, too
                        port._lock.notify_all()

    def _next_action(self) -> Action:
        assert self._actions is not None  # noqa: S101 - made in __init__
        return self._actions.popleft()

    def _begin_cycle(self) -> Sequence[Member]:
        self._begun_ns = self._now_ns()
        self._aborted = False
        return super()._begin_cycle()

    def _member_aborted(self, member: Member) -> None:
        self._aborted = True

    def _max_rate(self) -> float:
        return super()._max_rate() if self._plan is None else self._plan.max_rate

    def _set_rate_now(self, rate: float) -> None:
        if self._schedule is None and self._plan is not None:
            self._schedule = self._plan
            self._schedule.start(self._now_ns())
        super()._set_rate_now(rate)

    def _check_can_add(self, component: Component) -> None:
        super()._check_can_add(component)
        component._rt_move(True)
        awaiting = [hook for hook in coroutine_hooks(component._rt_hook_kinds) if hook not in _ON_LOOP]
        if awaiting:
            raise StateError(
                f"{component.name}: {', '.join(awaiting)} is `async def`; the hooks of a thread context are plain `def`"
            )
        served = ", ".join(unanswerable(component))
        if served:
            raise StateError(
                f"{component.name}: {served} is `async def`; what a thread context serves is plain `def`, or concurrent"
            )

    def _make_driver(self, kernel: Kernel) -> ThreadDriver:
        return ThreadDriver(self, kernel)

    def _new_member(self, component: Component) -> Member:
        # On the loop, before the thread has anything to do with the component: who writes to its ports, or reads them,
        # without a lock is there, too, and is not in the middle of it.
        component._rt_host.locked = True
        for port in component.ports.values():
            lock_all(port)
        return super()._new_member(component)

    def _port_added(self, member: Member, port: Port[Any]) -> None:
        member.component._rt_host.threaded = True
        lock_all(port)
        super()._port_added(member, port)

    def _set_ports_open(self, member: Member) -> None:
        super()._set_ports_open(member)
        # One whose hook was left behind is still in its thread.
        if member.left and member.component._rt_abandoned is None:
            member.component._rt_host.threaded = member.component._rt_host.locked = False
            member.component._rt_host.thread_id = None
            member.component._rt_move(False)


class ThreadDriver:
    """Carries out the steps of a context's life in a thread."""

    def __init__(self, context: PeriodicContext, kernel: Kernel) -> None:
        self.context = context
        self.hooks_run = 0
        self.ended: asyncio.Future[None] = kernel.loop.create_future()
        self._kernel = kernel
        self._bus = kernel.bus
        self._now_ns = kernel.clock.monotonic_ns
        self._steps = context._life.steps()
        self._changed = PortLock()
        self._kicked = False
        self._gone = False
        self._hurried = False
        self._member: Member | None = None
        self._ident = 0
        self._blocking = blocking_for(kernel.clock, kernel.loop, kernel._timers.call_at)
        for member in context._members:
            member.component._rt_host.stopping = False
        self.thread = threading.Thread(target=self._run, name=f"aiorts {context.name}", daemon=True)
        try:
            self.thread.start()
        except BaseException:
            self._blocking.end()
            raise

    @property
    def current(self) -> Member | None:
        """The member whose hook runs now."""
        return self._member

    def beware(self) -> None:
        """Observers of hooks came or went: looked at before each hook."""

    def beware_of_sharing(self) -> None:
        """Not of a thread's."""

    def kick(self) -> None:
        """Somebody wants something: do not wait on. From any thread."""
        with self._changed:
            self._kicked = True
            self._changed.notify_all()

    def hurry(self, budget: StopBudget) -> None:
        """A stop began: wake reads that block, and after the budget go on without the thread."""
        # While contexts before it stop, this one goes on as it was: its hooks are not told to give up yet.
        if self._hurried or not self.context._stopping:
            return
        self._hurried = True
        for member in tuple(self.context._members):
            member.component._rt_host.stopping = True
            for port in member.component.ports.values():
                if isinstance(port, ServicePort):
                    from aiorts.kernel.service_thread import give_up_waiting  # late: few threads call services

                    give_up_waiting(port)
                    continue
                for connector in port.connectors:
                    connector.in_._wake_waiter()
                if isinstance(port, InPort):
                    port._wake_waiter()
        cancel = self._in_real_seconds(budget.limit + budget.grace, self._abandon)
        self.ended.add_done_callback(lambda _: cancel())

    def _in_real_seconds(self, seconds: float, callback: Callable[[], None]) -> Callable[[], None]:
        """Call back on the loop; returns what cancels it. A thread takes real time, whatever the loop's own is."""
        loop = self._kernel.loop
        if current_clock() is None:
            return loop.call_later(seconds, callback).cancel
        timer = threading.Timer(seconds, lambda: loop.call_soon_threadsafe(callback))
        timer.daemon = True
        timer.start()
        return timer.cancel

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        self._ident = threading.get_ident()
        fault: BaseException | None = None
        outcome: BaseException | None = None
        try:
            self._thread_began()
            while not self._gone:
                outcome = self._carry_out(self._steps.send(outcome))
        except StopIteration:
            pass
        except BaseException as error:  # noqa: BLE001 - the kernel's own fault: the context ends and says so
            fault = error
        if not self._gone:
            self._kernel._on_loop(lambda: self._end(fault))
        self._blocking.end()

    def _thread_began(self) -> None:
        """The first thing that is done in the thread."""

    def _carry_out(self, step: Step) -> BaseException | None:
        if isinstance(step, Batch):
            for member, hook in step.hooks:
                error = self._call(member, hook, (member.failure,) if hook == "on_error" else ())
                if self._gone:
                    return None
                if error is not None:
                    self.context._life.failed(member, hook, error)
        elif isinstance(step, Wait):
            self._wait(step.deadline_ns)
        elif isinstance(step, Call):
            return self._call(step.member, step.hook, step.args)
        else:
            time.sleep(0)
        return None

    def _call(self, member: Member, hook: str, args: tuple[Any, ...]) -> BaseException | None:
        context, component = self.context, member.component
        try:
            kind, function = member.hooks[hook]
        except KeyError:
            kind, function = member.hook_of(hook)
        watched = self._bus.hooks_wanted
        if (kind == _ABSENT and not watched) or member.abandoned:
            return None
        host = component._rt_host
        if host.thread_id != self._ident:
            host.thread_id = self._ident
            host.blocking = self._blocking
        timing = context.timing
        started_ns = self._now_ns() if timing else 0
        if watched:
            context._publish(HookBefore(component.name, context.name, hook))
        self.hooks_run += 1
        self._member = member.gate.inside = member
        member.hook = hook
        error: BaseException | None = None
        try:
            if kind == _ASYNC:
                error = self._step(member, hook, function(*args))
            else:
                result = function(*args)
                if result is not None and kind != _ABSENT:
                    error = bad_return(member, hook, result)
        except BaseException as raised:  # noqa: BLE001 - the border round a hook
            error = raised
        if self._gone:
            return None
        self._member = member.gate.inside = None
        member.hook = "on_execute"
        if context._stopping and isinstance(error, ClosedError):
            error = None  # a blocking read or write was woken to let the context stop
        if timing:
            # `HookTimes.add`, written out: it is a good part of what a short hook costs.
            elapsed_ns = self._now_ns() - started_ns
            times = member.times.get(hook) or member.timed(hook)
            times.count += 1
            times.total_ns += elapsed_ns
            times.last_ns = elapsed_ns
            if elapsed_ns > times.max_ns:
                times.max_ns = elapsed_ns
        if watched:
            context._publish(HookAfter(component.name, context.name, hook, error))
        return error

    def _step(self, member: Member, hook: str, coroutine: Any) -> BaseException | None:
        """What became of an `async def` hook; a thread context has refused it before."""
        return bad_return(member, hook, coroutine)

    def _wait(self, deadline_ns: int | None) -> None:
        with self._changed:
            self._blocking.until(self._changed, lambda: self._kicked, deadline_ns)
            self._kicked = False

    # -- the end ---------------------------------------------------------------------------------------------------

    def _end(self, fault: BaseException | None) -> None:
        if self.ended.done():
            return  # given up in the very moment it came to its end
        self._let_go(fault)
        # The thread has nothing left to do but return.
        self.thread.join()
        self.ended.set_result(None)

    def _let_go(self, fault: BaseException | None) -> None:
        for member in self.context._members:
            member.component._rt_host.stopping = False
            member.component._rt_host.blocking = None
        self.context._life_ended(fault)

    def _abandon(self) -> None:
        """The hook did not return in time: the thread is left behind, and so are the steps that were to follow."""
        if self.ended.done():
            return
        self._gone = True
        member = self._member
        if member is not None:
            error = HookAbandoned(
                f"{member.component.name}.{member.hook}: did not return when its context stopped; its thread was "
                "left behind"
            )
            member.abandoned = True
            self.context._life._record(member, member.hook, error)
            member.component._rt_abandoned = error
            member.gate.inside = None
        self._blocking.end()
        self._let_go(None)
        self.ended.set_result(None)
