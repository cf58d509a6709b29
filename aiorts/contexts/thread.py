"""A context whose hooks run in one thread of its own and may block: for serial ports, cameras and such.

It has the same steps as every context (`kernel/execution/cycle.py`), carried out by a thread. Hooks are plain `def`.
Their ports have a lock, so every write and read takes the general path. A thread cannot be cancelled: a hook over its
deadline is reported while it runs and goes to error when it returns; one that does not return when its context stops is
abandoned, and the steps that would have followed in that thread are not run.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from aiorts.clock import SimulatedClock, SystemClock, clock_of
from aiorts.contexts.periodic import PeriodicContext
from aiorts.contexts.schedule import MAX_RATE, Ceiling, OverrunPolicy, Rate
from aiorts.errors import ClosedError, HookAbandoned, StateError
from aiorts.kernel.declarations import kinds_of
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.context import Timing
from aiorts.kernel.execution.cycle import Batch, Call, Step, Wait
from aiorts.kernel.execution.hook_timeout import too_late
from aiorts.kernel.execution.hooks import HookKind, bad_return, coroutine_hooks
from aiorts.kernel.loop.blocking import PortLock, blocking_for
from aiorts.kernel.loop.bus import HookAfter, HookBefore
from aiorts.kernel.loop.guarded import KernelLog, guarded
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.port import give_up_blocking, lock_all, unanswerable
from aiorts.late import dataclass
from aiorts.model.declared import Option

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import ComponentSide, KernelSide
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.ports import Port

_LOG = KernelLog()
_ON_LOOP: Final = ("on_initialize", "on_finalize")
"""Hooks that belong to no context and run on the kernel's loop."""
_ABSENT: Final = HookKind.ABSENT
_ASYNC: Final = HookKind.ASYNC
_FOR_EVER: Final = Wait(None)
_LEAST_NS: Final = 1_000_000
"""The least time that a cycle without a rate takes on a clock that stands still while hooks run."""
_LOOK_SECONDS: Final = 0.1
"""Seconds between two checks for a hook that is over its deadline and has not returned."""


class ThreadContext(PeriodicContext):
    """Runs its members in a thread of its own: `rate` times a second; without one, again as soon as they return.

    Without a rate it waits while no member is active.
    """

    kind: ClassVar[str] = "thread"
    exclusive: ClassVar[bool] = True
    suspends: ClassVar[bool] = False

    def __init__(
        self,
        rate: Rate | None = None,
        *,
        overrun: OverrunPolicy = "skip",
        max_rate: Ceiling = MAX_RATE,
        name: str = "",
        deadline: Annotated[
            float | None,
            Option(
                "The longest that a hook may take; one that took longer is in error when it returns: a thread cannot "
                "be cancelled.",
                unit="s",
                above=0,
            ),
        ] = None,
        timing: Timing = True,
    ) -> None:
        first = 1.0 if rate is None else rate
        super().__init__(first, overrun=overrun, max_rate=max_rate, name=name, deadline=deadline, timing=timing)
        self._actions = deque()  # made now and kept: both the loop and the thread add requests
        self._plan = self._schedule
        self._aborted = False
        self._begun_ns = -1
        if rate is None:
            self._schedule = None

    def _next_cause(self) -> Wait | None:
        if self._schedule is not None:
            return super()._next_cause()
        # Without a rate a member in error runs `on_error` once; again and again would be a busy loop.
        if not self._aborted and not any(member.active for member in self._members):
            return _FOR_EVER
        if self._now_ns() <= self._begun_ns:
            # A simulated clock has not moved: hooks that wait for nothing would keep it from ever moving.
            return Wait(self._begun_ns + _LEAST_NS)
        return None

    def _request_came(self) -> None:
        for member in tuple(self._members):
            for port in tuple(member.in_ports):
                receiver_of(port).wake_threads()  # a thread that waits there for data checks for requests, too

    def _begin_cycle(self) -> Sequence[Member]:
        self._begun_ns = self._now_ns()
        self._aborted = False
        return super()._begin_cycle()

    def _member_aborted(self, member: Member) -> None:
        self._aborted = True

    def _set_rate_now(self, rate: float) -> None:
        if self._schedule is None and self._plan is not None:
            self._schedule = self._plan
            self._schedule.start(self._now_ns())
        super()._set_rate_now(rate)

    def _check_can_add(self, component: ComponentSide) -> None:
        super()._check_can_add(component)
        for kind in kinds_of(component):
            kind.moved(component, threaded=True)
        awaiting = [hook for hook in coroutine_hooks(cell(component).hook_kinds) if hook not in _ON_LOOP]
        if awaiting:
            raise StateError(
                f"{component.name}: {', '.join(awaiting)} is `async def`; the hooks of a thread context are plain `def`"
            )
        served = ", ".join(unanswerable(component.ports.values()))
        if served:
            raise StateError(
                f"{component.name}: {served} is `async def`; what a thread context serves is plain `def`, or concurrent"
            )

    def _make_driver(self, kernel: KernelSide) -> ThreadDriver:
        return ThreadDriver(self, kernel, self.deadline)

    def _new_member(self, component: ComponentSide) -> Member:
        # On the loop, before the thread uses the component: tasks that use its ports without a lock are on the loop,
        # too, and so not in the middle of a write or read.
        cell(component).locked = True
        for port in component.ports.values():
            lock_all(port)
        return super()._new_member(component)

    def _port_added(self, member: Member, port: Port[Any]) -> None:
        member.cell.threaded = True
        lock_all(port)
        super()._port_added(member, port)

    def _set_ports_open(self, member: Member) -> None:
        super()._set_ports_open(member)
        # A member whose hook was abandoned is still in its thread.
        if member.left and member.cell.abandoned is None:
            member.cell.threaded = member.cell.locked = False
            member.cell.thread_id = None
            for kind in kinds_of(member.component):
                kind.moved(member.component, threaded=False)


@dataclass(slots=True)
class _Since:
    """One run of a hook: its start and its deadline."""

    run: int
    where: str
    begun_ns: int
    limit: float | None


class ThreadDriver:
    """Carries out the steps of a context's life in a thread."""

    def __init__(self, context: PeriodicContext, kernel: KernelSide, deadline: float | None = None) -> None:
        self.context = context
        self.hooks_run = 0
        self.ended: asyncio.Future[None] = kernel.loop.create_future()
        self._kernel = kernel
        self._bus = kernel.bus
        self._now_ns = kernel.clock.monotonic_ns
        self._steps = context.runner.life.steps()
        self._changed = PortLock()
        self._kicked = False
        self._gone = False
        self._hurried = False
        self._member: Member | None = None
        self._ident = 0
        self._deadline = deadline
        self._limited = deadline is not None or any(m.cell.deadlines is not None for m in context.runner.members)
        """Whether a hook has a deadline, or ever had one."""
        self._observed = False
        """Whether observers were notified of the hook that runs now."""
        self._since: _Since | None = None
        """The run of the present hook, if it has a deadline."""
        self._since_anew: _Since | None = None
        """The run of a hook that got a deadline while it ran; a field of its own, since the loop writes it."""
        self._looks: asyncio.TimerHandle | None = None
        self.update_fast_path()
        self._blocking = blocking_for(kernel.clock, kernel.loop, kernel.call_at)
        for member in context.runner.members:
            member.cell.stopping = False
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

    def update_fast_path(self) -> None:
        """Decide again whether hooks take the general path: they have observers or a deadline. On the loop only."""
        self._careful = self._bus.hooks_wanted or self._limited
        if self._limited and self._looks is None and not isinstance(self._kernel.clock, SimulatedClock):
            self._looks = self._kernel.loop.call_later(_LOOK_SECONDS, self._look, 0)

    def limit_anew(self, member: Member) -> None:
        """Apply new deadlines of this member's component, also to its hook that runs now."""
        limits = member.cell.deadlines
        if limits is not None:
            self._limited = True
            self.update_fast_path()
        run, since = self.hooks_run, self._since
        if self._member is member:
            begun_ns = self._now_ns() if since is None or since.run != run else since.begun_ns
            limit = self._deadline if limits is None else limits.get(member.hook, self._deadline)
            self._since_anew = _Since(run, f"{member.component.name}.{member.hook}", begun_ns, limit)

    def _look(self, told: int) -> None:
        """Log a hook that is over its deadline and has not returned: a thread cannot be interrupted."""
        since = None if self._member is None else self._held_to(self.hooks_run)
        took_ns = 0 if since is None else self._now_ns() - since.begun_ns
        if since is None or since.run == told or too_late(since.where, took_ns, since.limit) is None:
            self._looks = self._kernel.loop.call_later(_LOOK_SECONDS, self._look, told)
            return
        self._looks = self._kernel.loop.call_later(_LOOK_SECONDS, self._look, since.run)
        text = "%s: runs for %.3g s now, its deadline is %g s; nothing can cancel a thread: wait, or stop its context"
        _LOG.warning(text, since.where, took_ns / 1e9, since.limit)

    def _held_to(self, run: int) -> _Since | None:
        """The deadline that holds for this run of a hook: the one that came last."""
        for since in (self._since_anew, self._since):
            if since is not None and since.run == run:
                return since
        return None

    def update_for_sharing(self) -> None:
        """Do nothing: a component of a thread context is in no second context."""

    def kick(self) -> None:
        """Interrupt the wait: there is a request. From any thread."""
        with self._changed:
            self._kicked = True
            self._changed.notify_all()

    def hurry(self, budget: StopBudget) -> None:
        """Wake reads that block, since the context stops, and after the budget go on without the thread."""
        # While contexts before it stop, this one goes on: its hooks are not interrupted yet.
        if self._hurried or not self.context.runner.stopping:
            return
        self._hurried = True
        self.give_up_blocking(tuple(self.context.runner.members))
        cancel = self.after(budget.limit + budget.grace, self._abandon)
        self.ended.add_done_callback(lambda _: cancel())

    def give_up_blocking(self, members: Sequence[Member]) -> None:
        """End reads and writes that block the thread by ClosedError: these members are about to end."""
        for member in members:
            member.cell.stopping = True
            for port in member.component.ports.values():
                give_up_blocking(port)

    def after(self, seconds: float, callback: Callable[[], None]) -> Callable[[], None]:
        """Call `callback` on the loop after real seconds, whatever the loop's clock is; return what cancels this."""
        loop = self._kernel.loop
        if isinstance(clock_of(loop), SystemClock):
            return loop.call_later(seconds, callback).cancel
        timer = threading.Timer(seconds, lambda: loop.call_soon_threadsafe(callback))
        timer.daemon = True
        timer.start()
        return timer.cancel

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        self._ident = threading.get_ident()
        try:
            self._thread_began()
        except BaseException as error:  # noqa: BLE001 - the kernel's own: the context ends and logs it
            self.context.runner.life.faulted(error, then="it has ended")
            fault: BaseException | None = error
        else:
            fault = self._go_on()
        if not self._gone:
            self._kernel.call_on_loop(lambda: self._end(fault))
        self._blocking.end()

    def _go_on(self) -> BaseException | None:
        """Carry out step after step; return a fault of the kernel's own after which it cannot go on."""
        outcome: BaseException | None = None
        while True:
            try:
                while not self._gone:
                    outcome = self._carry_out(self._steps.send(outcome))
                return None
            except StopIteration:
                return None
            except BaseException as fault:  # noqa: BLE001 - the kernel's own: go on, or the context ends and logs it
                steps = None if self._gone else self.context.runner.life.anew(fault)
                if steps is None:
                    return fault
                self._steps, outcome = steps, None

    def _thread_began(self) -> None:
        """Prepare the thread: the first call in it."""

    def _carry_out(self, step: Step) -> BaseException | None:
        if isinstance(step, Batch):
            member: Member | None = None
            hook = ""
            try:
                for member, hook in step.hooks:
                    error = self._call(member, hook, (member.failure,) if hook == "on_error" else ())
                    if self._gone:
                        return None
                    if error is not None:
                        self.context.runner.life.failed(member, hook, error)
            except BaseException as fault:
                if member is None:
                    raise
                if not self._gone:
                    self.context.runner.life.failed(member, hook, self._faulted(member, fault))
                    return self._carry_out(step)  # the rest of the batch
        elif isinstance(step, Wait):
            self._wait(step.deadline_ns)
        elif isinstance(step, Call):
            try:
                return self._call(step.member, step.hook, step.args)
            except BaseException as fault:  # noqa: BLE001 - as above
                return self._faulted(step.member, fault)
        else:
            time.sleep(0)
        return None

    def _faulted(self, member: Member, fault: BaseException) -> BaseException:
        self._member = member.entry_lock.inside = None
        return self.context.runner.life.faulted(fault, member)

    def _call(self, member: Member, hook: str, args: tuple[Any, ...]) -> BaseException | None:
        context, component = self.context, member.component
        try:
            kind, function = member.hooks[hook]
        except KeyError:
            kind, function = member.hook_of(hook)
        if (kind == _ABSENT and not self._careful) or member.abandoned:
            return None
        host = cell(component)
        if host.thread_id != self._ident:
            host.thread_id = self._ident
            host.blocking = self._blocking
        timing = context.timing
        started_ns = self._now_ns() if timing else 0
        self.hooks_run += 1
        if self._careful:
            self._begin_carefully(member, hook)
        self._member = member.entry_lock.inside = member
        member.hook = hook
        error: BaseException | None = None
        try:
            if kind == _ASYNC:
                error = self._step(member, hook, function(*args))
            else:
                result = function(*args)
                if result is not None and kind != _ABSENT:
                    error = bad_return(member.component.name, hook, result)
        except BaseException as raised:  # noqa: BLE001 - the border round a hook
            error = raised
        if self._gone:
            return None
        self._member = member.entry_lock.inside = None
        member.hook = "on_execute"
        if error is not None and host.stopping and issubclass(type(error), ClosedError):
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
        if self._careful:
            error = self._end_carefully(member, hook, error)
        return error

    def _begin_carefully(self, member: Member, hook: str) -> None:
        """Begin a hook that has observers or a deadline."""
        if self._bus.hooks_wanted:
            self._observed = True
            self.context.runner.publish(HookBefore(member.component.name, self.context.name, hook))
        limits = member.cell.deadlines
        limit = self._deadline if limits is None else limits.get(hook, self._deadline)
        if limit is not None:
            self._since = _Since(self.hooks_run, f"{member.component.name}.{hook}", self._now_ns(), limit)

    def held_by(self, member: Member) -> tuple[int, float] | None:
        """The start and the deadline of this member's present hook; None without a deadline. From any thread."""
        since = self._held_to(self.hooks_run) if self._member is member else None
        return None if since is None or since.limit is None else (since.begun_ns, since.limit)

    def _end_carefully(self, member: Member, hook: str, error: BaseException | None) -> BaseException | None:
        """End a hook that has observers or a deadline. Once a stop began, only the stop's countdown counts."""
        since = self._held_to(self.hooks_run)
        self._since = None
        if since is not None and error is None and not self.context.runner.stopping:
            error = too_late(since.where, self._now_ns() - since.begun_ns, since.limit)
        if self._observed:
            self._observed = False
            self.context.runner.publish(HookAfter(member.component.name, self.context.name, hook, error))
        return error

    def _step(self, member: Member, hook: str, coroutine: Any) -> BaseException | None:
        """The result of an `async def` hook; a thread context has refused it before."""
        return bad_return(member.component.name, hook, coroutine)

    def _wait(self, deadline_ns: int | None) -> None:
        with self._changed:
            self._blocking.until(self._changed, lambda: self._kicked, deadline_ns)
            self._kicked = False

    # -- the end ---------------------------------------------------------------------------------------------------

    def _end(self, fault: BaseException | None) -> None:
        if self.ended.done():
            return  # abandoned in the very moment in which it ended
        guarded(f"{self.context.name}: could not end", self._let_go, fault)
        # The thread has nothing left to do but return.
        self.thread.join()
        self.ended.set_result(None)

    def _let_go(self, fault: BaseException | None) -> None:
        if self._looks is not None:
            self._looks.cancel()
        for member in self.context.runner.members:
            member.cell.stopping = False
            member.cell.blocking = None
        self.context._life_ended(fault)

    def _abandon(self) -> None:
        """Abandon the thread, whose hook did not return in time, and the steps that were to follow."""
        if self.ended.done():
            return
        self._gone = True
        member = self._member
        if member is not None:
            error = HookAbandoned(
                f"{member.component.name}.{member.hook}: did not return when its context stopped; its thread was "
                "abandoned"
            )
            member.abandoned = True
            self.context.runner.life.record(member, member.hook, error)
            member.cell.abandoned = error
            member.entry_lock.inside = None
        self._blocking.end()
        guarded(f"{self.context.name}: could not end", self._let_go, None)
        self.ended.set_result(None)
