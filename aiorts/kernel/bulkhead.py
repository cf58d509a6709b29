"""What contains a component's hook: deadlines, cancellation, blame.

The context awaits each hook in its own plain task: no task switch, no cancel scope, no task group that one stray
CancelledError could end. Whether the kernel cancelled is known from the watch's own count, not from
`task.cancelling()`. A hook over its deadline is cancelled once for each grace step; one that ignores them all is left
behind with its task, and the context goes on in a new one: repeated delivery, as cancel scopes do it, would pin a
core.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Generator, Iterator
from types import coroutine
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import HookAbandoned, HookTimeout, StateError
from aiorts.kernel.bus import HookAfter, HookBefore
from aiorts.kernel.hooks import TAKES_ERROR, HookKind
from aiorts.kernel.life import Batch, Call, Steps, Wait

if TYPE_CHECKING:
    from aiorts.kernel.context import Context
    from aiorts.kernel.host import Cancellable
    from aiorts.kernel.member import Member

__all__ = ("CANCELLATIONS", "GRACE", "STOP_DEADLINE", "StopBudget", "TaskDriver", "bad_return", "leave_behind")

GRACE: Final = 0.5
"""Seconds between two cancellations of a hook that is over its deadline."""
CANCELLATIONS: Final = 4
STOP_DEADLINE: Final = 2.0
"""Seconds that a hook may still take once its context or kernel stops."""
_HURRY: Final = 0.02
"""The grace step once a stop has used up its time: many stuck components must not add up."""


class StopBudget:
    """How long hooks may still take while something stops: shared by all contexts that stop together."""

    def __init__(self, loop: asyncio.AbstractEventLoop, deadline: float = STOP_DEADLINE) -> None:
        self._loop = loop
        self._soft = loop.time() + deadline
        self._hard = self._soft + CANCELLATIONS * GRACE

    @property
    def limit(self) -> float:
        """Seconds until a hook that runs now is cancelled for the first time."""
        return max(0.0, self._soft - self._loop.time())

    @property
    def grace(self) -> float:
        """Seconds between cancellations."""
        return GRACE if self._loop.time() < self._hard else _HURRY


class _LeftBehind(BaseException):
    """This task was abandoned and its hook has returned after all: it must touch nothing any more."""


class _Watch:
    """Cancels the hook that runs now, step by step, when its time is over."""

    __slots__ = ("cancels", "driver", "grace", "stopping", "timer")

    def __init__(self, driver: TaskDriver) -> None:
        self.driver = driver
        self.cancels = 0
        self.stopping = False
        self.timer: Cancellable | None = None

    def arm(self) -> None:
        """Start the countdown that is in force: the stop's, else the hook's own deadline if it has one."""
        budget, deadline = self.driver.budget, self.driver.deadline
        if budget is not None:
            self.stopping = True
            self.timer = self.driver.loop.call_later(budget.limit, self._expire)
        elif deadline is not None:
            self.timer = self.driver.call_later(deadline, self._expire)

    def rearm(self) -> None:
        """A stop began while the hook runs: its countdown replaces the hook's own, once cancelling it goes on."""
        if self.cancels == 0:
            self.disarm()
            self.arm()

    def disarm(self) -> None:
        """The hook returned."""
        if self.timer is not None:
            self.timer.cancel()
            self.timer = None

    def _expire(self) -> None:
        if self.cancels < CANCELLATIONS:
            self.cancels += 1
            self.driver.task.cancel()
            budget = self.driver.budget
            later = self.driver.loop.call_later if self.stopping else self.driver.call_later
            self.timer = later(GRACE if budget is None else budget.grace, self._expire)
        else:
            self.driver.abandon()


class TaskDriver:
    """Carries out the steps of a context's life in a task of its own."""

    def __init__(
        self,
        context: Context,
        steps: Steps,
        loop: asyncio.AbstractEventLoop,
        call_at: Callable[[int, Callable[[], None]], Cancellable],
        call_later: Callable[[float, Callable[[], None]], Cancellable],
    ) -> None:
        self.context = context
        self.loop = loop
        self.call_later = call_later
        self.deadline: float | None = context.deadline
        self.budget: StopBudget | None = None
        self.hooks_run = 0
        self._call_at = call_at
        self._steps = steps
        self._batch: Iterator[tuple[Member, str]] | None = None
        self._member: Member | None = None
        self._watch: _Watch | None = None
        self._sleeper: asyncio.Future[None] | None = None
        self._kicked = False
        self.ended: asyncio.Future[None] = loop.create_future()
        self.task = self._spawn(None)

    def _spawn(self, outcome: BaseException | None) -> asyncio.Task[None]:
        task = self.loop.create_task(self._drive(outcome), name=f"aiorts {self.context.name}")
        task._aiorts_driver = self  # type: ignore[attr-defined] # read by embedding.owner_of
        return task

    @property
    def current(self) -> Member | None:
        """The member whose hook runs now."""
        return self._member

    def kick(self) -> None:
        """Somebody wants something: do not sleep on. In the loop's thread only."""
        sleeper = self._sleeper
        if sleeper is not None and not sleeper.done():
            sleeper.set_result(None)
        else:
            self._kicked = True

    def hurry(self, budget: StopBudget) -> None:
        """A stop began: hooks are limited from now on, the one that runs included."""
        if self.budget is None:
            self.budget = budget
            if self._watch is None and self._member is not None:
                self._watch = _Watch(self)
                self._watch.arm()
            elif self._watch is not None:
                self._watch.rearm()

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
                    await self._run_batch(step.hooks)
                elif isinstance(step, Wait):
                    await self._sleep(step.deadline_ns)
                elif isinstance(step, Call):
                    outcome = await self._run(step.member, step.hook, step.args)
                else:
                    await give_turn()
        except StopIteration:
            self._end(None)
        except _LeftBehind:
            return
        except BaseException as error:
            # The kernel's own fault, or the host ends all tasks: say so, never hang a stop.
            if asyncio.current_task() is self.task:
                self._end(error)
            raise

    def _end(self, error: BaseException | None) -> None:
        self.context._life_ended(error)
        if not self.ended.done():
            self.ended.set_result(None)

    async def _sleep(self, deadline_ns: int | None) -> None:
        if self._kicked:
            self._kicked = False
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

    async def _run_batch(self, hooks: Iterator[tuple[Member, str]]) -> None:
        self._batch = hooks
        for member, hook in hooks:
            args = (member.failure,) if hook == "on_error" else ()
            error = await self._run(member, hook, args)
            if error is not None:
                self.context._life.failed(member, hook, error)
        self._batch = None

    async def _run(self, member: Member, hook: str, args: tuple[Any, ...]) -> BaseException | None:
        kind, function = member.hooks[hook]
        context = self.context
        watched = context._hooks_wanted()
        if (kind == HookKind.ABSENT and not watched) or member.abandoned:
            return None
        component = member.component
        if component._lock is not None:
            await component._lock.acquire()
        started_ns = context._now_ns() if context.timing else 0
        if watched:
            context._publish(HookBefore(component.name, context.name, hook))
        self.hooks_run += 1
        error = await self._contain(member, hook, kind, function, args)
        if component._lock is not None:
            component._lock.release()
        if context.timing:
            member.timed(hook).add(context._now_ns() - started_ns)
        if watched:
            context._publish(HookAfter(component.name, context.name, hook, error))
        return error

    async def _contain(
        self, member: Member, hook: str, kind: int, function: Callable[..., Any], args: tuple[Any, ...]
    ) -> BaseException | None:
        """Run the hook; whatever comes out of it is this component's affair."""
        component = member.component
        task = self.task
        if self.deadline is not None or self.budget is not None:
            self._watch = _Watch(self)
            self._watch.arm()
        self._member = component._running = member
        member.hook = hook
        error: BaseException | None = None
        result = None
        try:
            result = function(*args)
            if kind == HookKind.ASYNC:
                result = await result
        except BaseException as raised:  # noqa: BLE001 - the border round a hook
            error = raised
        if self.task is not task:
            raise _LeftBehind
        self._member = component._running = None
        member.hook = ""
        watch = self._watch
        if watch is not None:
            watch.disarm()
            self._watch = None
        if error is not None or (watch is not None and watch.cancels):
            return self._judge(member, hook, error, watch)
        return None if result is None else bad_return(member, hook, result)

    def _judge(
        self, member: Member, hook: str, error: BaseException | None, watch: _Watch | None
    ) -> BaseException | None:
        """What became of a hook that raised or was cancelled: the component's error, or the host's cancellation."""
        where = f"{member.component.name}.{hook}"
        cancels = watch.cancels if watch is not None else 0
        for _ in range(cancels):
            self.task.uncancel()
        if cancels and (error is None or isinstance(error, asyncio.CancelledError)):
            if watch is not None and watch.stopping:
                late = HookTimeout(
                    f"{where}: still ran {STOP_DEADLINE} s after its context was told to stop; it was cancelled"
                )
            else:
                late = HookTimeout(f"{where}: did not return within {self.deadline} s; it was cancelled")
            late.__cause__ = error
            return late if error is not None or not (watch and watch.stopping) else None
        if isinstance(error, GeneratorExit) and asyncio._get_running_loop() is None:
            raise error  # the loop is gone and this task with it
        if isinstance(error, asyncio.CancelledError) and self.task.cancelling():
            if self.context._host_gone():
                raise error
            while self.task.cancelling():
                self.task.uncancel()
        if isinstance(error, KeyboardInterrupt):
            self.context._interrupted(error)
        return error

    # -- leaving a hook behind -------------------------------------------------------------------------------------

    def abandon(self) -> None:
        """The hook ignored every cancellation: go on without it, in a new task."""
        member, watch = self._member, self._watch
        if member is None or watch is None:
            return
        hook = member.hook
        error = HookAbandoned(
            f"{member.component.name}.{hook}: ignored {watch.cancels} cancellations; it was left behind "
            "and never runs again"
        )
        leave_behind(self.task)
        self._member, self._watch = None, None
        for other in member.component._members:
            other.abandoned = True
        member.component._running = None
        member.hook = ""
        if self._batch is not None:
            self.context._life.failed(member, hook, error)
            self.task = self._spawn(None)
        else:
            self.task = self._spawn(error)


def leave_behind(task: asyncio.Task[Any]) -> None:
    """Take a task that cannot be ended out of the loop's books, or `asyncio.run` would wait for it for ever."""
    asyncio._unregister_task(task)
    task._log_destroy_pending = False  # type: ignore[attr-defined] # it is known and was reported


def bad_return(member: Member, hook: str, result: object) -> BaseException:
    """The error for a hook that returned something."""
    if asyncio.iscoroutine(result):
        result.close()
    advice = "write `async def`, or await inside" if isinstance(result, Awaitable) else "a hook returns nothing"
    takes = "self, error" if hook in TAKES_ERROR else "self"
    return StateError(
        f"{member.component.name}.{hook}({takes}): returned {type(result).__name__} {result!r:.60}; {advice}"
    )


@coroutine
def give_turn() -> Generator[None, None, None]:
    """Let everything else that is ready run once."""
    yield
