"""What contains a component's hook: deadlines, cancellation, blame.

The context awaits each hook in its own plain task: no task switch, no cancel scope, no task group that one stray
CancelledError could end. Whether the kernel cancelled is known from the watch's own count, not from
`task.cancelling()`; who else cancels the task is decided in `DriverTask.cancel`. A hook over its deadline is
cancelled once for each grace step; one that ignores them all is left behind with its task, and the context goes on in
a new one: repeated delivery, as cancel scopes do it, would pin a core.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from aiorts.kernel.bus import HookAfter, HookBefore
from aiorts.kernel.driver_state import DriverState
from aiorts.kernel.driver_task import DriverTask, wait_for_turn
from aiorts.kernel.hooks import HookKind, bad_return
from aiorts.kernel.life import TURN, Batch, Call, Together, Wait, first_pass
from aiorts.kernel.port import give_turn
from aiorts.kernel.tasks import leave_behind
from aiorts.kernel.verdict import judged, left_behind
from aiorts.kernel.watch import Watch

if TYPE_CHECKING:
    from aiorts.kernel.member import Member

__all__ = ("LeftBehind", "TaskDriver")

_ABSENT = HookKind.ABSENT
_ASYNC = HookKind.ASYNC
_NOTHING_LEFT = Batch(iter(()), first_pass)


class LeftBehind(BaseException):
    """This task was abandoned and its hook has returned after all: it must touch nothing any more."""


class TaskDriver(DriverState):
    """Carries out the steps of a context's life in a task of its own."""

    __slots__ = ()

    def _begin(self) -> DriverTask:
        return DriverTask(self, self._drive(None))

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
                            if self._kicked:  # work is left, or somebody wants something
                                self._kicked = False
                                await give_turn()
                elif isinstance(step, Call):
                    outcome = await self._run(step.member, step.hook, step.args)
                elif step is TURN:
                    await give_turn()
                elif isinstance(step, Together):
                    from aiorts.kernel.lanes import run_together

                    await run_together(self, step)
        except StopIteration:
            self._end(None)
        except LeftBehind:
            return
        except BaseException as error:
            # The kernel's own fault: say so, never hang a stop.
            if asyncio.current_task() is self.task:
                self._end(error)
            raise

    def _end(self, error: BaseException | None) -> None:
        self._steps.close()
        for lane in self.lanes:
            lane.end()
        self.context._life_ended(error)
        self._over = True
        if self._ended is not None and not self._ended.done():
            self._ended.set_result(None)

    async def _sleep(self, deadline_ns: int | None) -> None:
        if self._kicked:
            self._kicked = False
            await give_turn()
            return
        sleeper = self._sleeper = self.loop.create_future()
        timer = None if deadline_ns is None else self._call_at(deadline_ns, self.kick)
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
            self.context._life.failed(member, hook, error)

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
                    if hook == "on_execute" and member.gate.open and member.may_run_at_once:
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
                    raise LeftBehind
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

        A component that is in several contexts has nobody inside.
        """
        timing, task, gate = self.context.timing, self.task, member.gate
        begun_ns = self.context._now_ns() if timing else 0
        error: BaseException | None = None
        self._member = member
        if gate.shared:
            gate.inside = member
        try:
            result = await execute() if member.awaits else execute()
        except BaseException as raised:  # noqa: BLE001 - the border round a hook
            error = result = raised
        if result is not None or self._careful:
            if self.task is not task:
                raise LeftBehind
            await self._end_oddly(member, error, result, begun_ns)
            return
        self._member = None
        if gate.shared:
            gate.inside = None
            if gate.waiting:
                gate.pass_on()
        if timing:
            member.timed("on_execute").add(self.context._now_ns() - begun_ns)

    async def _end_oddly(self, member: Member, error: BaseException | None, result: object, begun_ns: int) -> None:
        """The end of a hook that was begun quickly and did not simply return, or was not to be left alone meanwhile."""
        error = await self._outcome(member, "on_execute", error, result)
        self._leave(member)
        if self.context.timing:
            member.timed("on_execute").add(self.context._now_ns() - begun_ns)
        if error is not None:
            self.context._life.failed(member, "on_execute", error)

    def _leave(self, member: Member) -> None:
        """No hook of this member runs now."""
        gate = member.gate
        self._member = gate.inside = None
        if self._joined:
            self._joined = False
            self.beware()
        if gate.waiting:
            gate.pass_on()

    async def _run(self, member: Member, hook: str, args: tuple[Any, ...]) -> BaseException | None:
        """Run one hook; whatever comes out of it is this component's affair."""
        try:
            kind, function = member.hooks[hook]
        except KeyError:
            kind, function = member.hook_of(hook)
        context, component, gate = self.context, member.component, member.gate
        watched = self._bus.hooks_wanted
        if (kind == HookKind.ABSENT and not watched) or member.abandoned:
            return None
        if gate.inside is not None or gate.waiting:
            failure = member.failure
            busy = await wait_for_turn(self, member, hook)
            if busy is not None or member.abandoned:
                return busy
            if failure is not None and member.failure is not failure:
                gate.pass_on()  # what this follows from was taken back, and with it the code that failed
                return None
            component, (kind, function) = member.component, member.hook_of(hook)  # its code may have been replaced
        started_ns = context._now_ns() if context.timing else 0
        if watched:
            context._publish(HookBefore(component.name, context.name, hook))
        limits = component._rt_deadlines
        limit = self.deadline if limits is None else limits.get(hook, self.deadline)
        if limit is not None or self.budget is not None:
            self._watch = Watch(self, limit)
            self._watch.arm()
        self._member = gate.inside = member
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
            raise LeftBehind
        if error is not None or result is not None or self._watch is not None or self.cancelled_by_others:
            error = await self._outcome(member, hook, error, result)
        self._leave(member)
        member.hook = "on_execute"
        if context.timing:
            member.timed(hook).add(context._now_ns() - started_ns)
        if watched:
            context._publish(HookAfter(component.name, context.name, hook, error))
        return error

    async def _outcome(
        self, member: Member, hook: str, error: BaseException | None, result: object
    ) -> BaseException | None:
        """What became of a hook that did not simply return."""
        watch = self._watch
        if watch is not None:
            watch.disarm()
            self._watch = None
        if self.cancelled_by_others and error is None:
            if self.task.cancelling():
                error = await self._take_cancellation()
            else:
                self._uncancel()  # a scope's or a time-out's, and over
        if error is not None or (watch is not None and watch.cancels):
            return self._judge(member, hook, error, watch)
        return None if result is None else bad_return(member, hook, result)

    async def _take_cancellation(self) -> BaseException | None:
        """A hook that cancelled its own task and returned before it could be told must not hit who comes next."""
        try:
            await give_turn()
        except asyncio.CancelledError as error:
            return error
        self._uncancel()
        return None

    def _uncancel(self) -> None:
        self.cancelled_by_others = False
        self.beware()
        while self.task.cancelling():
            self.task.uncancel()

    def _judge(
        self, member: Member, hook: str, error: BaseException | None, watch: Watch | None
    ) -> BaseException | None:
        """What became of a hook that raised or was cancelled: the component's error, unless the host wanted it."""
        if isinstance(error, GeneratorExit) and asyncio._get_running_loop() is None:
            raise error  # the loop is gone and this task with it
        wanted = self.cancelled_by_others and self._stopped_by_host
        self._uncancel()
        return judged(member, hook, error, watch, wanted=wanted)

    # -- leaving a hook behind -------------------------------------------------------------------------------------

    def abandon(self) -> None:
        """The hook ignored every cancellation: go on without it, in a new task."""
        member, watch = self._member, self._watch
        if member is None or watch is None:
            return
        hook = member.hook
        error = left_behind(member, hook, watch.cancels)
        leave_behind(self.task)
        component = member.component
        component._rt_abandoned = error
        for other in component._rt_members:
            other.abandoned = True
        self._watch = None
        self.cancelled_by_others = False
        self._leave(member)
        member.hook = "on_execute"
        if self.context._hooks_wanted():
            self.context._publish(HookAfter(component.name, self.context.name, hook, error))
        if self._batch is not None:
            self.context._life.failed(member, hook, error)
        self.task = DriverTask(self, self._drive(error if self._batch is None else None))
