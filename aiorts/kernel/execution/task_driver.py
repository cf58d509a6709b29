"""The task of a context: it carries out the steps, and contains what components do in their hooks.

The context awaits each hook in its own plain task: no task switch, no cancel scope, no task group that one stray
CancelledError could end. Whether the kernel cancelled is known from the count of `hook_timeout.py`, not from
`task.cancelling()`; who else cancels the task is decided in `DriverTask.cancel`. A hook over its deadline is
cancelled once for each grace step; one that ignores them all is abandoned with its task, and the context goes on in
a new one: repeated delivery, as cancel scopes do it, would pin a core. One that blocks is judged when it returns.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from aiorts.errors import HookAbandoned, HookTimeout
from aiorts.kernel.execution.cycle import TURN, Batch, Call, OwnStep, Wait, first_pass
from aiorts.kernel.execution.file_access import own_context
from aiorts.kernel.execution.hook_timeout import HookTimer, is_cancellation
from aiorts.kernel.execution.hooks import HookKind, bad_return
from aiorts.kernel.loop.bus import Bus, HookAfter, HookBefore
from aiorts.kernel.loop.deadlines import StopBudget
from aiorts.kernel.loop.guarded import KernelLog, guarded
from aiorts.kernel.loop.tasks import abandon_task, current_task, owner_of
from aiorts.kernel.ports.in_port import InPort, receiver_of
from aiorts.kernel.ports.port import give_turn
from aiorts.kernel.ports.receiver import EndingError

if TYPE_CHECKING:
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Steps
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.loop.timers import Cancellable

_LOG = KernelLog()
_ABSENT = HookKind.ABSENT
_ASYNC = HookKind.ASYNC
_NOTHING_LEFT = Batch(iter(()), first_pass)


class Abandoned(BaseException):
    """Ends a task that was abandoned and whose hook has returned after all: it must touch nothing any more."""


NO_FAULT = (Abandoned, asyncio.CancelledError, GeneratorExit)
"""The exceptions that pass through the kernel's code and are no fault of it."""


class DriverTask(asyncio.Task[None]):
    """The task of a context: it knows what a cancellation by other code means."""

    __slots__ = ("_aiorts_driver",)

    def __init__(self, driver: TaskDriver, life: Coroutine[Any, Any, None]) -> None:
        self._aiorts_driver = driver
        super().__init__(life, loop=driver.loop, name=f"aiorts {driver.context.name}", context=own_context())

    def cancel(self, msg: Any | None = None) -> bool:
        """By the host, or because the loop is torn down: the context stops in order. Else it is the hook's affair."""
        driver = self._aiorts_driver
        caller = current_task()
        # A scope entered in the hook belongs to the hook, also where other code ends it: anyio's message says so.
        by_scope = isinstance(msg, str) and "cancel scope" in msg
        by_host = not driver.loop.is_running() or (caller is not None and owner_of(caller) is None and not by_scope)
        if by_host:
            driver.stop_for_host()
        if driver.current is None:
            # Between hooks there is nothing that a component could want to cancel.
            return by_host
        driver.note_cancellation()
        return super().cancel(msg)

    def cancel_hook(self) -> None:
        """Cancel the running hook for its timer."""
        super().cancel()


class TaskDriver:
    """Carries out the steps of a context's life in a task of its own.

    Its methods for other code are called in the loop's thread, and none of them waits.
    """

    __slots__ = (
        "__weakref__",
        "_batch",
        "_careful",
        "_ended",
        "_joined",
        "_kicked",
        "_left",
        "_member",
        "_over",
        "_sleeper",
        "_steps",
        "_stopped_by_host",
        "_timer",
        "budget",
        "bus",
        "call_at",
        "call_later",
        "cancelled_by_others",
        "context",
        "deadline",
        "helpers",
        "hooks_run",
        "loop",
        "task",
        "turn",
    )

    def __init__(
        self,
        context: Context,
        steps: Steps,
        loop: asyncio.AbstractEventLoop,
        call_at: Callable[[int, Callable[[], None]], Cancellable],
        call_later: Callable[[float, Callable[[], None]], Cancellable],
        bus: Bus,
    ) -> None:
        self.context = context
        self.loop = loop
        self.call_later = call_later
        self.deadline: float | None = context.deadline
        self.budget: StopBudget | None = None
        self.hooks_run = 0
        """The number of hooks run on the general path; see `run`."""
        self.helpers: tuple[TaskDriver, ...] = ()
        """Drivers that carry out parts of this driver's steps at the same time; they hurry and end with this driver."""
        self._stopped_by_host = self.cancelled_by_others = False
        self._careful = False
        """Whether hooks take the general path: a deadline, observers, a stop, or a cancellation by other code."""
        self._joined = False
        """Whether the component whose hook runs now came into a second context meanwhile, or has another deadline."""
        self._left = False
        """Whether a hook that was begun quickly was abandoned: its task must find out when it returns after all."""
        self.bus = bus
        self.call_at = call_at
        self._steps = steps
        self._batch: Batch | None = None
        self._member: Member | None = None
        self._timer: HookTimer | None = None
        self._sleeper: asyncio.Future[None] | None = None
        self.turn: asyncio.Future[bool] | None = None
        self._kicked = False
        self._over = False
        self._ended: asyncio.Future[None] | None = None
        self.update_fast_path()
        self.task = DriverTask(self, self._drive(None))

    @property
    def ended(self) -> asyncio.Future[None]:
        """Done when the last step was carried out; made at the first use."""
        if self._ended is None:
            self._ended = self.loop.create_future()
            if self._over:
                self._ended.set_result(None)
        return self._ended

    @property
    def current(self) -> Member | None:
        """The member whose hook runs now."""
        return self._member

    def held_by(self, member: Member) -> tuple[int, float] | None:
        """When the hook of this member that runs now began, and its deadline; None without one."""
        timer = self._timer
        if timer is not None and self._member is member:
            return None if timer.limit is None else (timer.begun_ns, timer.limit)
        return next(filter(None, (helper.held_by(member) for helper in self.helpers)), None)

    @property
    def run(self) -> tuple[int, int, Member | None]:
        """The identity of the present run of a hook: equal at two moments of one run, different for other runs."""
        # In one cycle a member is executed once: what runs quickly need not be counted.
        return self.context.ticks, self.hooks_run, self._member

    def kick(self) -> None:
        """Wake the driver: there is something to do. In the loop's thread only."""
        sleeper = self._sleeper
        if sleeper is not None and not sleeper.done():
            sleeper.set_result(None)
        else:
            self._kicked = True

    def hurry(self, budget: StopBudget) -> None:
        """Limit hooks by the budget of a stop from now on, the running hook included."""
        for helper in self.helpers:
            helper.hurry(budget)
        if self.budget is None:
            self.budget = budget
            self._careful = True
            if self._timer is None and self._member is not None:
                self._timer = HookTimer(self)  # pyright: ignore[reportArgumentType] # it takes the callables for methods
                self._timer.arm()
            elif self._timer is not None:
                self._timer.rearm()
            elif self.turn is not None:
                self.loop.call_later(budget.limit, _resolve, self.turn, False)

    def after(self, seconds: float, callback: Callable[[], None]) -> Callable[[], None]:
        """Call back after so many seconds of the loop's time; returns what cancels it."""
        return self.loop.call_later(seconds, callback).cancel

    def give_up_blocking(self, members: Sequence[Member]) -> None:
        """End the waiting of these members' hooks for samples: the members are about to end."""
        for helper in self.helpers:
            helper.give_up_blocking(members)
        member = self._member
        if member is not None and member in members:
            for port in member.component.ports.values():
                if isinstance(port, InPort):
                    receiver_of(port).end_wait()

    def stop_for_host(self) -> None:
        """Stop the context in order: the application has cancelled its task."""
        context = self.context
        if not context._stopping:
            _LOG.warning("context %s: its task was cancelled by the application; it stops", context.name)
            context._stopping = self._stopped_by_host = True
            self.hurry(StopBudget(self.loop))
            self.kick()

    def end(self) -> None:
        """End this helper: no more steps will come for it."""
        raise NotImplementedError

    def note_cancellation(self) -> None:
        """Note that code other than the kernel's cancels the hook that runs now."""
        self.cancelled_by_others = self._careful = True

    def update_fast_path(self) -> None:
        """Update whether hooks take the general path; also called when observers of hooks come and go."""
        self._careful = (
            self.deadline is not None
            or self.budget is not None
            or self.bus.hooks_wanted
            or self._joined
            or self._left
            or self.cancelled_by_others
        )

    def update_for_sharing(self) -> None:
        """Note that the component whose hook runs now is in a second context from now on."""
        self._joined = self._careful = True

    def limit_anew(self, member: Member) -> None:
        """Apply changed deadlines of this member's component, also to its running hook."""
        for helper in self.helpers:
            helper.limit_anew(member)
        timer, limits = self._timer, member.cell.deadlines
        if self._member is not member:
            return
        limit = self.deadline if limits is None else limits.get(member.hook, self.deadline)
        if timer is not None:
            timer.limit = limit
            timer.rearm()
        elif limit is not None:
            self._timer = HookTimer(self, limit)  # pyright: ignore[reportArgumentType] # it takes the callables for methods
            self._timer.arm()
            self.update_for_sharing()

    # -- the task --------------------------------------------------------------------------------------------------

    async def _drive(self, outcome: BaseException | None) -> None:
        steps = self._steps
        try:
            if self._batch is not None:
                await self._run_batch(self._batch)
            while True:
                step = steps.send(outcome)
                outcome = None
                if isinstance(step, Batch):
                    if step.hook_of is first_pass and not self._careful:
                        self._batch = step
                        await self._run_quickly(step.members)
                        if self._careful:  # for what is left
                            await self._run_batch(step)
                        self._batch = None
                    else:
                        await self._run_batch(step)
                elif isinstance(step, Wait):
                    if step.deadline_ns is not None or self._kicked:
                        await self._sleep(step.deadline_ns)
                    else:
                        # Where an event context idles: one future and no coroutine on the way to its hook.
                        self._sleeper = self.loop.create_future()
                        await self._sleeper
                        self._sleeper = None
                        self._kicked = False
                        alone = self.context._alone()
                        if alone is not None:
                            self._batch = _NOTHING_LEFT  # for who takes over
                            if self._careful or alone.execute is None:
                                await self._run_and_record(alone, "on_execute")
                            else:
                                await self._run_one(alone, alone.execute)
                            self._batch = None
                            self.context._end_cycle((alone,))
                            if self._kicked:  # work is left, or a request waits
                                self._kicked = False
                                await give_turn()
                elif isinstance(step, Call):
                    outcome = await self._run(step.member, step.hook, step.args)
                elif step is TURN:
                    await give_turn()
                elif isinstance(step, OwnStep):
                    await step.carry_out(self)
        except StopIteration:
            self._end(None)
        except Abandoned:
            return
        except (asyncio.CancelledError, GeneratorExit) as error:  # the loop is torn down
            if asyncio.current_task() is self.task:
                self._end(error)
            raise
        except BaseException as fault:  # noqa: BLE001 - of the kernel's own: go on, or say so; never hang a stop
            if asyncio.current_task() is self.task:
                self._begin_anew(fault)

    def _begin_anew(self, fault: BaseException) -> None:
        """Go on in a new task, or end, after a fault of the kernel's own code."""
        error = self._blamed(fault)
        if error is None:
            self._steps.close()
            steps = self.context.runner.life.anew(fault)
            if steps is None:
                self._end(fault)
                return
            self._steps, self._batch, self._kicked = steps, None, True
            for helper in self.helpers:
                helper.end()
            self.helpers = ()
        self.task = DriverTask(self, self._drive(error if self._batch is None else None))

    def _blamed(self, fault: BaseException) -> BaseException | None:
        """Raised round a member's hook, it is as if that hook had raised: the error; None between hooks."""
        member, timer = self._member, self._timer
        if member is None:
            return None
        if timer is not None:
            timer.disarm()
            self._timer = None
        hook, member.hook = member.hook, "on_execute"
        self._leave(member)
        error = self.context.runner.life.faulted(fault, member)
        if self._batch is not None:
            self.context.runner.life.failed(member, hook, error)
        return error

    def _end(self, error: BaseException | None) -> None:
        self._steps.close()
        for helper in self.helpers:
            helper.end()
        guarded(f"{self.context.name}: could not end", self.context._life_ended, error)
        self._over = True
        if self._ended is not None and not self._ended.done():
            self._ended.set_result(None)

    async def wait_for_request(self) -> None:
        """Wait for the next `kick`."""
        await self._sleep(None)

    async def _sleep(self, deadline_ns: int | None) -> None:
        if self._kicked:
            self._kicked = False
            await give_turn()
            return
        sleeper = self._sleeper = self.loop.create_future()
        timer = None if deadline_ns is None else self.call_at(deadline_ns, self.kick)
        try:
            await sleeper
        finally:
            self._sleeper = None
            self._kicked = False
            if timer is not None:
                timer.cancel()

    async def _run_batch(self, batch: Batch) -> None:
        self._batch = batch
        for member, hook in batch.hooks:
            await self._run_and_record(member, hook)
        self._batch = None

    async def _run_and_record(self, member: Member, hook: str) -> None:
        error = await self._run(member, hook, (member.failure,) if hook == "on_error" else ())
        if error is not None:
            self.context.runner.life.failed(member, hook, error)

    async def _run_quickly(self, members: Iterator[Member]) -> None:
        """The first pass of a cycle: `_run_batch` and `_run`, written out for hooks that nothing unusual is about.

        What is unusual was laid out before: in `Member.execute` what is so with the member, in `_careful` the rest;
        it returns early when that is set.
        Between two hooks nothing runs but this: the end of one is the beginning of the next.
        """
        now_ns, timing, task = self.context._now_ns, self.context.timing, self.task
        error: BaseException | None = None
        begun_ns = now_ns() if timing else 0
        for member in members:
            execute = member.execute
            if execute is None:
                hook = first_pass(member)
                if hook:
                    self._member = None
                    if hook == "on_execute" and member.entry_lock.open and member.may_run_at_once:
                        kind, execute = member.hook_of(hook)
                        if kind != _ABSENT:
                            await self._run_one(member, execute)
                    else:
                        await self._run_and_record(member, hook)
                    if self._careful:
                        break
                    begun_ns = now_ns() if timing else 0
                continue
            self._member = member
            try:
                result = await execute() if member.awaits else execute()
            except BaseException as raised:  # noqa: BLE001 - the border round a hook
                error = result = raised
            if result is not None or self._careful:
                if self.task is not task:
                    raise Abandoned
                await self._end_oddly(member, error, result, begun_ns)
                if self._careful:
                    break
                error = None
                begun_ns = now_ns() if timing else 0
            elif timing:
                ended_ns = now_ns()
                times = member.execute_times
                if times is None:
                    times = member.timed("on_execute")
                # `HookTimes.add`, written out.
                elapsed_ns = ended_ns - begun_ns
                begun_ns = ended_ns
                times.count += 1
                times.total_ns += elapsed_ns
                times.last_ns = elapsed_ns
                if elapsed_ns > times.max_ns:
                    times.max_ns = elapsed_ns
        self._member = None

    async def _run_one(self, member: Member, execute: Callable[[], Any]) -> None:
        """`_run_quickly` for one member: this stands between a sample and the hook it is for.

        The entry lock of a component in several contexts is free.
        """
        timing, task, lock = self.context.timing, self.task, member.entry_lock
        begun_ns = self.context._now_ns() if timing else 0
        error: BaseException | None = None
        self._member = member
        if lock.shared:
            lock.inside = member
        try:
            result = await execute() if member.awaits else execute()
        except BaseException as raised:  # noqa: BLE001 - the border round a hook
            error = result = raised
        if result is not None or self._careful:
            if self.task is not task:
                raise Abandoned
            await self._end_oddly(member, error, result, begun_ns)
            return
        self._member = None
        if lock.shared:
            lock.inside = None
            if lock.waiting:
                lock.pass_on()
        if timing:
            member.timed("on_execute").add(self.context._now_ns() - begun_ns)

    async def _end_oddly(self, member: Member, error: BaseException | None, result: object, begun_ns: int) -> None:
        """The end of a hook that was begun quickly and did not simply return, or was not to be left alone meanwhile."""
        error = await self._outcome(member, "on_execute", error, result)
        self._leave(member)
        if self.context.timing:
            member.timed("on_execute").add(self.context._now_ns() - begun_ns)
        if error is not None:
            self.context.runner.life.failed(member, "on_execute", error)

    def _leave(self, member: Member) -> None:
        """Note that no hook of this member runs now."""
        lock = member.entry_lock
        self._member = lock.inside = None
        if self._joined:
            self._joined = False
            self.update_fast_path()
        if lock.waiting:
            lock.pass_on()

    async def _run(self, member: Member, hook: str, args: tuple[Any, ...]) -> BaseException | None:
        """Run one hook and return what it raised, or None; never raises it."""
        try:
            kind, function = member.hooks[hook]
        except KeyError:
            kind, function = member.hook_of(hook)
        context, component, lock = self.context, member.component, member.entry_lock
        watched = self.bus.hooks_wanted
        if (kind == HookKind.ABSENT and not watched) or member.abandoned:
            return None
        if lock.inside is not None or lock.waiting:
            failure = member.failure
            busy = await _wait_for_turn(self, member, hook)
            if busy is not None or member.abandoned:
                return busy
            if failure is not None and member.failure is not failure:
                lock.pass_on()  # what this follows from was taken back, and with it the code that failed
                return None
            component, (kind, function) = member.component, member.hook_of(hook)  # its code may have been replaced
        started_ns = context._now_ns() if context.timing else 0
        if watched:
            context.runner.publish(HookBefore(component.name, context.name, hook))
        limits = member.cell.deadlines
        limit = self.deadline if limits is None else limits.get(hook, self.deadline)
        if limit is not None or self.budget is not None:
            self._timer = HookTimer(self, limit)  # pyright: ignore[reportArgumentType] # it takes the callables for methods
            self._timer.arm()
        self._member = lock.inside = member
        member.hook = hook
        self.hooks_run += 1
        task = self.task
        error: BaseException | None = None
        result = None
        try:
            if kind == _ASYNC:
                result = await function(*args)
            elif kind != _ABSENT:
                result = function(*args)
        except BaseException as raised:  # noqa: BLE001 - the border round a hook
            error = raised
        if self.task is not task:
            raise Abandoned
        if error is not None or result is not None or self._timer is not None or self.cancelled_by_others:
            error = await self._outcome(member, hook, error, result)
        self._leave(member)
        member.hook = "on_execute"
        if context.timing:
            member.timed(hook).add(context._now_ns() - started_ns)
        if watched:
            context.runner.publish(HookAfter(component.name, context.name, hook, error))
        return error

    async def _outcome(
        self, member: Member, hook: str, error: BaseException | None, result: object
    ) -> BaseException | None:
        """The outcome of a hook that did not simply return: its error, or None."""
        timer = self._timer
        if timer is not None:
            timer.disarm()
            self._timer = None
        if self.cancelled_by_others and error is None:
            if self.task.cancelling():
                error = await self._take_cancellation()
            else:
                self._uncancel()  # a scope's or a time-out's, and over
        if error is not None or (timer is not None and timer.cancels):
            return self._judge(member, hook, error, timer)
        if result is not None:
            return bad_return(member.component.name, hook, result)
        return None if timer is None else timer.returned(f"{member.component.name}.{hook}")

    async def _take_cancellation(self) -> BaseException | None:
        """Take a cancellation that a hook sent to its own task as it returned: it must not hit the next member."""
        try:
            await give_turn()
        except asyncio.CancelledError as error:
            return error
        self._uncancel()
        return None

    def _uncancel(self) -> None:
        self.cancelled_by_others = False
        self.update_fast_path()
        while self.task.cancelling():
            self.task.uncancel()

    def _judge(
        self, member: Member, hook: str, error: BaseException | None, timer: HookTimer | None
    ) -> BaseException | None:
        """The outcome of a hook that raised or was cancelled: the component's error, unless the host cancelled it."""
        if error is not None and issubclass(type(error), GeneratorExit) and asyncio._get_running_loop() is None:
            raise error  # the loop is gone and this task with it
        wanted = self.cancelled_by_others and self._stopped_by_host
        self._uncancel()
        if issubclass(type(error), EndingError):  # not isinstance: a component's error may have any `__class__`
            return None
        if timer is not None and timer.cancels:
            return timer.cancelled(f"{member.component.name}.{hook}", error)
        return None if wanted and is_cancellation(error) else error

    # -- leaving a hook behind -------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        """The time on the kernel's clock."""
        return self.context._now_ns()

    def cancel_hook(self) -> None:
        """Cancel the hook that runs now, for its timer."""
        self.task.cancel_hook()

    def abandon(self) -> None:
        """Go on in a new task without the running hook, which ignored every cancellation."""
        member, timer = self._member, self._timer
        if member is None or timer is None:
            return
        hook = member.hook
        error = HookAbandoned(
            f"{member.component.name}.{hook}: ignored {timer.cancels} cancellations; "
            "it was abandoned and never runs again"
        )
        abandon_task(self.task)
        member.cell.abandoned = error
        for other in member.cell.members:
            other.abandoned = True
        self._timer = None
        self.cancelled_by_others = False
        self._left = self._left or self._joined
        self._leave(member)
        member.hook = "on_execute"
        if self.bus.hooks_wanted:
            self.context.runner.publish(HookAfter(member.component.name, self.context.name, hook, error))
        if self._batch is not None:
            self.context.runner.life.failed(member, hook, error)
        self.task = DriverTask(self, self._drive(error if self._batch is None else None))


async def _wait_for_turn(driver: TaskDriver, member: Member, hook: str) -> BaseException | None:
    """Another context is inside the component: wait for it; while this one stops, no longer than it may."""
    turn = driver.turn = driver.loop.create_future()
    timer = None
    if driver.budget is not None:
        timer = driver.loop.call_later(driver.budget.limit, _resolve, turn, False)
    try:
        if await member.entry_lock.wait(turn):
            return None
    finally:
        driver.turn = None
        if timer is not None:
            timer.cancel()
    inside = member.entry_lock.inside
    where = "another context" if inside is None else inside.where
    return HookTimeout(f"{member.component.name}.{hook}: did not run: the component was busy in {where}")


def _resolve(future: asyncio.Future[bool], outcome: bool) -> None:
    """Resolve the future, unless it has an outcome already."""
    if not future.done():
        future.set_result(outcome)
