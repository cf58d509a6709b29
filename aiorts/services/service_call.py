"""A call that may wait, on the kernel's loop: it enters the provider's component, runs, and is answered or given up.

An `async def` has a task of its own, so that a deadline, a caller that is cancelled and a provider that goes end it
without harm to others. A task that ignores cancellation is cancelled once for each grace step and then abandoned, as a
hook is; a late answer is ignored.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from aiorts.clock import to_ns
from aiorts.errors import HookAbandoned, ServiceCycle, ServiceTimeout, ServiceUnavailable
from aiorts.kernel.embedding import creator_of
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.member import Visit
from aiorts.kernel.loop.deadlines import CANCELLATIONS, GRACE
from aiorts.kernel.loop.tasks import abandon_task, current_task, kernel_task
from aiorts.services.activities import Activity, activity_of, holder_of
from aiorts.services.goal_keeper import forsake
from aiorts.services.service_proxy import Outcome, failed, inside, run_in_step, settle, wrong_argument
from aiorts.services.service_thread import serve_in_thread

if TYPE_CHECKING:
    from aiorts.kernel.execution.entry_lock import EntryLock
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.services.service_wiring import Answer, Link


def seconds_left(task: asyncio.Task[Any] | None) -> float:
    """Seconds until the deadline of the call that runs in this task."""
    call = activity_of(task)
    assert isinstance(call, ServiceCall)  # noqa: S101 - a provider's method asks
    return call.seconds - (call.link.now_ns() - call.begun_ns) / 1e9


class ServiceCall(Visit):
    """A call that may wait: to enter the provider's component, for the provider's own task, or for its thread."""

    __slots__ = (
        "_caller",
        "_cancels",
        "_grace",
        "_lock",
        "_timer",
        "_turn",
        "answer",
        "args",
        "begun_ns",
        "kwargs",
        "link",
        "over",
        "reply",
        "runs",
        "seconds",
        "task",
    )

    def __init__(
        self, link: Link, answer: Answer, args: tuple[Any, ...], kwargs: dict[str, Any], seconds: float
    ) -> None:
        super().__init__(link.component, answer.visit.hook)
        self.link = link
        self.answer = answer
        self.args = args
        self.kwargs = kwargs
        self.seconds = seconds
        self.begun_ns = 0
        self.runs = False
        """Whether the call has entered the provider's component and is not over."""
        self.over = False
        self.reply: asyncio.Future[Outcome] | None = None
        self.task: asyncio.Task[None] | None = None
        self._lock: EntryLock | None = None
        self._turn: asyncio.Future[bool] | None = None
        self._timer: Cancellable | None = None
        self._caller: Activity | None = None
        self._cancels = 0
        self._grace: Cancellable | None = None

    @property
    def where(self) -> str:
        return f"{self.hook}, called by {self.link.required.path}"

    @property
    def kernel(self) -> Microkernel:
        """The kernel of both components."""
        return self.link.kernel

    async def result(self) -> Any:
        """Wait for the provider's answer until the deadline; returns it, or raises the caller's error."""
        link, kernel = self.link, self.kernel
        self.begun_ns = link.now_ns()
        reply = self.reply = kernel.loop.create_future()
        caller = activity_of(current_task())
        value = None
        error: BaseException | None = None
        link.calls[self] = None
        if caller is not None:
            link.graph.enter(caller, self)
            self._caller = caller
        self._timer = kernel.call_at(self.begun_ns + to_ns(self.seconds), self._expire)
        try:
            await self._begin()
            value, error = await reply
        except asyncio.CancelledError as cancelled:
            error = cancelled
            if reply.done() and not reply.cancelled():
                forsake(reply.result()[0])
            self.give_up()
        finally:
            self._timer.cancel()
            link.calls.pop(self, None)
            if caller is not None:
                link.graph.leave(caller, self)
        return settle(link, self.answer, self.begun_ns, value, error)

    async def _begin(self) -> None:
        """Begin the provider's method, or answer in `reply` why not."""
        link = self.link
        reason = link.provided._refusal
        if reason:
            self.conclude(None, ServiceUnavailable(f"{link.named(self.answer.name)}: {reason}"))
            return
        look = self.answer.look
        if look is not None and (wrong := look(self.args, self.kwargs)):
            self.conclude(None, wrong_argument(link, self.answer, wrong, self.args, self.kwargs))
            return
        if link.threaded:
            if not self._closes_a_circle():
                serve_in_thread(self)
            return
        if not link.provided.concurrent and not await self._enter(link.entry_lock):
            return
        self.runs = True
        if self.answer.plain:
            self._run_plain()
        else:
            self._run_in_task()

    async def _enter(self, lock: EntryLock) -> bool:
        if not lock.open:
            if self._closes_a_circle():
                return False
            turn = self._turn = self.kernel.loop.create_future()
            try:
                granted = await lock.wait(turn)
            finally:
                self._turn = None
            if not granted:
                return False
            reason = self.link.provided._refusal
            if reason or self.reply_done:
                lock.pass_on()
                self.conclude(None, ServiceUnavailable(f"{self.link.named(self.answer.name)}: {reason}"))
                return False
        lock.inside = self
        self._lock = lock
        return True

    def _closes_a_circle(self) -> bool:
        caller = self._caller
        if caller is None:
            return False
        holder = holder_of(self.component)
        way = self.link.graph.way_back(holder, caller)
        if way is None or holder is None:
            return False
        steps = "".join(f", which calls {call.component.name}.{call.hook}" for call in way)
        self.conclude(
            None,
            ServiceCycle(
                f"{self.link.named(self.answer.name)}: would wait for itself: {self.component.name} is in "
                f"{holder.where}{steps}, which makes this call; call from elsewhere, or declare one of them "
                "concurrent=True"
            ),
        )
        return True

    def _run_plain(self) -> None:
        """Run a plain method whose call had to wait for another activity of the component."""
        value, error = run_in_step(self.answer, self, self.args, self.kwargs)
        self._ended(value, error)

    def _run_in_task(self) -> None:
        kernel, component = self.kernel, self.component
        task: Any = kernel_task(kernel.loop, self._serve(), f"aiorts {component.name}.{self.hook}")
        task._aiorts_component = component
        task._aiorts_visit = self
        task._aiorts_creator = creator_of(current_task())
        self.task = task
        task.add_done_callback(self._task_done)

    async def _serve(self) -> None:
        """Run the method. Never raises: the end of the task is no failure of a component."""
        value = None
        error: BaseException | None = None
        try:
            value = await self.answer.function(*self.args, **self.kwargs)
        except BaseException as raised:  # noqa: BLE001 - the border round a provider's method
            error = raised
        self._ended(value, error)

    def _task_done(self, task: asyncio.Task[None]) -> None:
        if not self.over:  # cancelled before it began
            self._ended(None, asyncio.CancelledError())

    def _ended(self, value: Any, error: BaseException | None) -> None:
        if self.over:
            return
        self.over = True
        if self._grace is not None:
            self._grace.cancel()
        if self.reply_done:
            forsake(value)
        failure = None if self.reply_done else failed(self.link, self.answer, self.args, self.kwargs, error)
        self._leave()
        self.conclude(value, failure)

    def _leave(self) -> None:
        self.runs = False
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.inside = None
            if lock.waiting:
                lock.pass_on()

    # -- ended from outside ----------------------------------------------------------------------------------------

    @property
    def reply_done(self) -> bool:
        """Whether the caller has its answer, or has gone."""
        return self.reply is None or self.reply.done()

    def conclude(self, value: Any, error: BaseException | None) -> None:
        """Answer the caller, unless there is an answer already."""
        if self.reply is not None and not self.reply.done():
            self.reply.set_result((value, error))
        if self._turn is not None and not self._turn.done():
            self._turn.set_result(False)

    def _expire(self) -> None:
        if self.reply_done:
            return
        how = "did not answer" if self.runs else f"did not come to it, since it was busy{inside(self.component)},"
        self.conclude(
            None,
            ServiceTimeout(f"{self.link.named(self.answer.name)}: {self.component.name} {how} within {self.seconds} s"),
        )
        self.give_up()

    def end(self, reason: str) -> None:
        """End the call, whose provider or connector goes: the caller gets an error, the method is cancelled."""
        if not self.reply_done:
            self.conclude(None, ServiceUnavailable(f"{self.link.named(self.answer.name)}: {reason}"))
        self.give_up()

    def give_up(self) -> None:
        """Cancel the provider's method again and again, then abandon it: its caller waits no more."""
        task = self.task
        if task is None or task.done() or self._cancels:
            return
        self.kernel.registry.adopt(self.component, task)
        self._cancel_again()

    def _cancel_again(self) -> None:
        task = self.task
        if task is None or task.done():
            return
        if self._cancels < CANCELLATIONS:
            self._cancels += 1
            task.cancel()
            self._grace = self.kernel.call_later(GRACE, self._cancel_again)
        else:
            self._abandon(task)

    def _abandon(self, task: asyncio.Task[None]) -> None:
        component = self.component
        error = HookAbandoned(
            f"{component.name}.{self.hook}: ignored {CANCELLATIONS} cancellations; it was abandoned"
            f"{'' if self.link.provided.concurrent else ' and its component never runs again'}"
        )
        abandon_task(task)
        self.kernel.registry.disown(component, task)
        self.over = True
        if self.link.provided.concurrent:
            component.log.error("%s", error)
            return
        cell(component).abandoned = error
        for member in tuple(cell(component).members):
            member.abandoned = True
            member.context.runner.life.task_failed(member, error)
        self._leave()
