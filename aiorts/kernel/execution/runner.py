"""The runner of one context, for services, contexts and drivers: `context.runner`.

It knows the members, queues requests, and starts and stops the context. A request is carried out between two cycles, or
withdrawn; its caller waits for the outcome. A hook that waited for its own context, or for one that runs its component,
would deadlock: its requests are only queued, and their failures logged.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from aiorts.errors import ClosedError, StateError, TransitionTimeout, format_error
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.cycle import TURN, Action, Done, Life, Pause, Request, Steps
from aiorts.kernel.loop.bus import ContextStarted, ContextStopped
from aiorts.kernel.loop.deadlines import StopBudget
from aiorts.kernel.loop.guarded import KernelLog, guarded
from aiorts.kernel.loop.tasks import waiting_driver
from aiorts.model.lifecycle import Event

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import ComponentSide, KernelSide
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Driver, PassSteps
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.loop.bus import Event as BusEvent


_LOG = KernelLog()


class Runner:
    """The runner of one context. Applications use the context itself."""

    __slots__ = ("_context", "_pending", "driver", "life", "named")

    def __init__(self, context: Context, *, named: bool) -> None:
        self._context = context
        self.named = named
        """Whether the context was given its name; else the kernel gives it one."""
        self._pending: dict[_Awaited, None] | None = None
        self.driver: Driver | None = None
        """The driver of the steps; None while the context does not run."""
        self.life = Life(context)
        """The steps that a driver carries out."""

    # -- what there is -----------------------------------------------------------------------------------------------

    @property
    def kernel(self) -> KernelSide:
        """The kernel that runs the context, or did last. StateError when none ever has."""
        kernel = self._context._kernel
        if kernel is None:
            raise StateError(f"{self._where}: was never started")
        return kernel

    @property
    def members(self) -> list[Member]:
        """The members, in order of execution."""
        return self._context._members

    @property
    def current(self) -> Member | None:
        """The member whose hook runs now."""
        driver = self.driver
        return None if driver is None else driver.current

    @property
    def stopping(self) -> bool:
        """Whether a stop has begun, or is over."""
        return self._context._stopping

    @property
    def pending(self) -> bool:
        """Whether an action is queued for the time between two cycles."""
        return bool(self._context._actions)

    def member(self, component: ComponentSide) -> Member:
        """A component as a member of this context; StateError when it is none.

        Found through the component, which is in few contexts, never by walking a context that may have ten thousand.
        """
        for member in cell(component).members:
            if member.context is self._context:
                return member
        raise StateError(f"{component.name}: is not in {self._context.name or 'this context'}")

    def activity(self) -> int:
        """A number that changes with each hook and cycle: a watchdog compares two of them."""
        driver, ticks = self.driver, self._context.ticks
        if driver is None:
            return ticks
        member = driver.current
        return hash((ticks, driver.hooks_run, 0 if member is None else member.order))

    @property
    def _where(self) -> str:
        return self._context.name or type(self._context).__name__

    def check(self, what: str) -> KernelSide:
        """Return the kernel of a running context. StateError when it does not run; ThreadError in another thread."""
        context = self._context
        if context._kernel is None or self.driver is None:
            raise StateError(f"{self._where}: cannot {what}: the context does not run; kernel.start it")
        context._kernel.check_thread(f"{context.name}.{what}")
        return context._kernel

    def check_kernel(self, kernel: KernelSide) -> None:
        """Raise StateError when another kernel than this one runs the context."""
        if self._context._kernel not in (None, kernel):
            raise StateError(f"{self._context.name}: runs in another kernel than {kernel.name}; stop it there")

    def new_member(self, component: ComponentSide) -> Member:
        """Make a member for a component that is to join; the context does not change yet."""
        return self._context._new_member(component)

    def check_can_add(self, component: ComponentSide) -> None:
        """Raise StateError when the component cannot run here."""
        self._context._check_can_add(component)

    def check_may_join(self, component: ComponentSide) -> None:
        """Raise StateError when the component cannot run here, or is not of this kernel."""
        here = cell(component)
        if here.kernel is not self._context._kernel or not here.alive:
            where = f"the kernel of {self._context.name}"
            raise StateError(self.kernel.registry.stranger(component, component.name, where))
        self._context._check_can_add(component)

    # -- what others ask for -----------------------------------------------------------------------------------------

    def transition(self, member: Member, event: Event) -> Request:
        """The request for a lifecycle transition of a member."""
        return f"{event} {member.component.name}", partial(self.life.request, member, event)

    def joining(self, member: Member) -> Request:
        """The request that a component joins."""

        def steps(done: Done) -> Steps:
            try:
                # Checked again: this may run long after the request was made.
                self.check_may_join(member.component)
            except StateError as error:
                done(error)
                return
            yield from self.life.add(member, done)

        return f"add {member.component.name}", steps

    def leaving(self, member: Member) -> Request:
        """The request that a component leaves."""
        return f"remove {member.component.name}", partial(self.life.remove, member)

    def arranging(self, components: Sequence[ComponentSide]) -> Request:
        """The request that components get this order, as `arrange` says."""

        def steps(done: Done) -> Steps:
            self.arrange(components)
            done(None)
            yield from ()

        return f"lay out the order of {self._context.name}", steps

    async def release(self, components: Sequence[ComponentSide], timeout: float | None = 5.0) -> None:
        """Make these components leave the context, even members of a composite."""
        await self.ask([self.leaving(self.member(component)) for component in components], timeout)

    def submit(self, action: Action) -> None:
        """Queue an action for the time between two cycles, after earlier ones. On the loop, or in its own thread."""
        context = self._context
        if context._actions is None:
            context._actions = deque()
        context._actions.append(action)
        if self.driver is not None:
            self.driver.kick()
        context._request_came()

    def next_action(self) -> Action:
        """Take the oldest action out of the queue, which is not empty."""
        actions = self._context._actions
        assert actions is not None  # noqa: S101 - the caller has looked
        action = actions.popleft()
        if not actions and self._context.suspends:  # else a thread takes out what the loop puts in meanwhile
            self._context._actions = None
        return action

    def finished(self, member: Member) -> None:
        """Deactivate a source after this cycle: it has called `finish`."""
        self.submit(Action(lambda: self.life.finish(member)))

    def publish(self, event: BusEvent) -> None:
        """Put an event on the kernel's bus. From any thread."""
        kernel = self.kernel
        kernel.call_on_loop(lambda: kernel.bus.publish(event))

    def observers_changed(self) -> None:
        """Note that observers of hooks came or went; the fields that a cycle reads are updated between two cycles."""
        if self.driver is not None:
            self.driver.update_fast_path()
            self.submit(Action(self._settle_updates))

    def _settle_updates(self) -> Steps:
        for member in self._context._members:
            member.settle_updates()
        yield from ()

    async def ask(self, requests: Sequence[Request], timeout: float | None) -> None:
        """Carry out these requests between two cycles and wait for their end, at most `timeout` seconds.

        For a hook that would wait for itself they are queued, and a failure is logged.

        Raises:
            TransitionTimeout: they were not done in time. The error of the first that failed.
        """
        kernel = self.check("request")
        if self.inside():
            for what, steps in requests:
                logged = Logged(self._context, what)
                self.submit(Action(partial(_after_a_turn, steps, logged), logged))
            return
        awaited = self._submit_each(kernel, requests)
        await self._wait_for(kernel, awaited, timeout)
        for one in awaited:
            one.result(self._context.name, timeout)

    def _submit_each(self, kernel: KernelSide, requests: Sequence[Request]) -> list[_Awaited]:
        """Queue the requests for a caller who waits."""
        awaited = [_Awaited(what, steps, kernel) for what, steps in requests]
        if self._pending is None and awaited:
            self._pending = {}
        for one in awaited:
            self._pending[one] = None  # type: ignore[index] # made above
            self.submit(Action(one.steps, one.done))
        return awaited

    async def _wait_for(
        self,
        kernel: KernelSide,
        awaited: Sequence[_Awaited],
        timeout: float | None,
        before: Sequence[asyncio.Future[Any]] = (),
    ) -> None:
        """Wait for the futures `before` these requests and for the requests; withdraws those not begun in time."""
        try:
            await _settled(kernel, [*before, *(one.future for one in awaited)], timeout)
        finally:
            for one in awaited:
                one.withdraw()
            self._forget(awaited)

    def _forget(self, awaited: Sequence[_Awaited]) -> None:
        if self._pending is None:
            return
        for one in awaited:
            self._pending.pop(one, None)
        if not self._pending:
            self._pending = None

    def _refuse_pending(self) -> None:
        """Fail the requests that were not carried out: the context has ended."""
        pending, self._pending = self._pending, None
        for one in pending or ():
            one.done(ClosedError(f"{self._context.name}: the context has stopped; {one.what} was not done"))

    def inside(self) -> bool:
        """Whether the caller is a hook of this context or of a component in it, so that waiting would deadlock."""
        task = asyncio.current_task()
        if _visits(task, self._context):
            return True
        driver = waiting_driver(task)
        if driver is None:
            return False
        if driver is self.driver:
            return True
        member = driver.current
        return member is not None and any(other.context is self._context for other in member.cell.members)

    # -- who takes part, between two cycles --------------------------------------------------------------------------

    def attach(self, member: Member) -> None:
        """Let a member take part from now on; between two cycles."""
        context, here = self._context, member.cell
        context._members.append(member)
        here.members.append(member)
        here.retired = False
        if len(here.members) > 1:
            here.entry_lock.share(here.members)
        member.settle_updates()
        for port in member.component.ports.values():
            context._port_added(member, port)
        context._set_ports_open(member)

    def detach(self, member: Member) -> None:
        """Let a member take part no more; between two cycles."""
        member.left = True
        context, here = self._context, member.cell
        if member in here.members:
            here.members.remove(member)
            # A context that ends removes its members from the last to the first: the last is found at once.
            if context._members[-1] is member:
                context._members.pop()
            else:
                context._members.remove(member)
            context._updating -= member.updates
        here.retired = not here.members and not here.held_open
        for port in member.component.ports.values():
            context._port_removed(member, port)
        context._set_ports_open(member)

    def divide(self, way: PassSteps | None) -> None:
        """Set how a pass of later cycles goes over the members; None: one member after the other.

        Between two cycles only.
        """
        if way is not self._context._divided:
            self._context._divided = way

    def arrange(self, components: Sequence[ComponentSide]) -> None:
        """Put these components one after the other, at the place of the first of them. Between two cycles only."""
        place = {component: index for index, component in enumerate(components)}
        members = self._context._members
        mine = [member for member in members if member.component in place]
        if not mine:
            return
        first = members.index(mine[0])
        mine.sort(key=lambda member: place[member.component])
        others = [member for member in members if member.component not in place]
        members[:] = [*others[:first], *mine, *others[first:]]
        for order, member in enumerate(members, 1):
            member.order = order
        self._context._order = len(members)

    # -- beginning and ending ----------------------------------------------------------------------------------------

    async def begin(
        self, kernel: KernelSide, components: Sequence[ComponentSide], *, activate: bool, timeout: float | None
    ) -> None:
        """Start with these members; `activate` has them active before the first cycle.

        Returns or raises within `timeout` seconds; what has begun by then goes on.
        """
        context = self._context
        context._kernel = kernel
        context._now_ns = kernel.clock.monotonic_ns
        context._stopping = False
        if context._faults:
            context._faults, context._ended_by = 0, None
        while context._actions:
            self.next_action()  # what was requested of it before does not count
        for component in components:
            context._check_can_add(component)
            self.attach(context._new_member(component))
        first = context._members if activate else ()
        awaited = self._submit_each(kernel, [self.transition(member, Event.ACTIVATE) for member in first])
        context._began = kernel.loop.create_future()
        self.driver = context._make_driver(kernel)
        await self._wait_for(kernel, awaited, timeout, before=[context._began])
        if not context._began.done():
            member = self.current
            where = "" if member is None else f"; {member.component.name} is still in {member.hook}"
            raise TransitionTimeout(f"{context.name}: did not begin within {timeout} s{where}; wait for it, or stop it")
        context._began = None
        for one in awaited:
            one.result(context.name, timeout)

    def began(self) -> None:
        """Note that every `on_startup` has run."""
        self.publish(ContextStarted(self._context.name))
        self.kernel.call_on_loop(self._report_began)

    def _report_began(self) -> None:
        began = self._context._began
        if began is not None and not began.done():
            began.set_result(None)

    async def pause(self, budget: StopBudget) -> Callable[[], None]:
        """Begin no cycle from now on, once the running one is over; what is to be done between two cycles is done.

        Wait for the running cycle no longer than a hook may take; return the function that lets cycles begin again.
        """
        driver = self.driver
        if driver is None:
            return lambda: None
        paused = Pause(self.kernel, driver)
        self.submit(Action(partial(self.life.pause, paused)))
        await _first_of(budget, driver, paused.begun)
        return paused.resume

    async def retire(self, members: Sequence[Member], budget: StopBudget) -> None:
        """End these members between two cycles, in this order; wait no longer than a hook may take."""
        driver = self.driver
        if driver is None:
            return
        awaited = _Awaited("end", partial(self.life.retire, members), self.kernel)
        self.submit(Action(awaited.steps, awaited.done))
        driver.give_up_blocking(members)
        if self.inside():
            return
        await _first_of(budget, driver, awaited.future)
        awaited.withdraw()

    async def end(self, budget: StopBudget) -> None:
        """Stop the context within the budget and wait for its end; a hook of the context does not wait."""
        driver = self.driver
        if driver is None:
            return
        self._context._stopping = True
        driver.hurry(budget)
        driver.kick()
        if not self.inside():
            await asyncio.shield(driver.ended)

    def end_in_order(self) -> None:
        """Stop a context in which the kernel's own code keeps failing."""
        kernel, driver = self.kernel, self.driver
        self._context._stopping = True
        if driver is not None:
            kernel.call_on_loop(lambda: driver.hurry(StopBudget(kernel.loop)))

    def ended(self, error: BaseException | None) -> None:
        """Note that the last step was carried out, or that the kernel's own code failed with `error`."""
        context, kernel = self._context, self.kernel
        error = context._ended_by if error is None else error
        context._last_hooks = context._hook_statistics()
        self.driver = None
        self.let_go()
        while context._actions:
            action = self.next_action()
            if action.done is not None:
                action.done(ClosedError(f"{context.name}: the context has stopped"))
        self._refuse_pending()
        self._report_began()
        kernel._context_ended(context)
        self.publish(ContextStopped(context.name, None if error is None else format_error(error)))

    def let_go(self) -> None:
        """Remove all members: the context does not run."""
        for member in tuple(reversed(self._context._members)):
            guarded(f"{self._context.name}: could not let go of a member", self.detach, member)


def _after_a_turn(steps: Callable[[Done], Steps], done: Done) -> Steps:
    """Give the loop a turn first: hooks that request one another's transitions without end would hold it up."""
    yield TURN
    yield from steps(done)


async def _settled(kernel: KernelSide, futures: Sequence[asyncio.Future[Any]], timeout: float | None) -> None:
    """Wait until all are done, at most `timeout` seconds of the kernel's clock."""
    late: asyncio.Future[None] = kernel.loop.create_future()
    timer = None if timeout is None else kernel.call_later(timeout, partial(_resolve, late))
    try:
        for one in futures:
            await asyncio.wait([one, late], return_when=asyncio.FIRST_COMPLETED)
    finally:
        late.cancel()
        if timer is not None:
            timer.cancel()


async def _first_of(budget: StopBudget, driver: Driver, done: asyncio.Future[Any]) -> None:
    """Wait until `done` is done or the context has ended, no longer than a hook may take."""
    late: asyncio.Future[None] = done.get_loop().create_future()
    cancel = driver.after(budget.limit, partial(_resolve, late))
    try:
        await asyncio.wait([done, driver.ended, late], return_when=asyncio.FIRST_COMPLETED)
    finally:
        cancel()


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


class _Awaited:
    """One request that its caller waits for."""

    __slots__ = ("_chance", "_kernel", "_request", "_withdrawn", "future", "what")

    def __init__(self, what: str, request: Callable[[Done], Steps], kernel: KernelSide) -> None:
        self.what = what
        self._request = request
        self._kernel = kernel
        self._chance = [True]
        self._withdrawn = False
        self.future: asyncio.Future[BaseException | None] = kernel.loop.create_future()

    def steps(self) -> Steps:
        """The steps of the request; none once it was withdrawn."""
        if self._claim():
            yield from self._request(self.done)

    def _claim(self) -> bool:
        """Claim the request, to begin or to withdraw it; True only at the first call. From any thread."""
        try:
            return self._chance.pop()
        except IndexError:
            return False

    def done(self, error: BaseException | None) -> None:
        """Resolve the request with its error, or None. From any thread."""
        self._kernel.call_on_loop(lambda: None if self.future.done() else self.future.set_result(error))

    def withdraw(self) -> None:
        """Keep the request from beginning, unless it has begun."""
        self._withdrawn = self._claim()

    def result(self, context: str, timeout: float | None) -> None:
        """Raise the error of the request; TransitionTimeout when it has not ended."""
        if not self.future.done():
            how = "it was withdrawn" if self._withdrawn else "it has begun and may still end"
            raise TransitionTimeout(f"{context}: {self.what} did not take effect within {timeout} s; {how}")
        error = self.future.result()
        if error is not None:
            raise error


class Logged:
    """Logs the failure of a request to a context or component that no caller waits for."""

    def __init__(self, owner: Context | ComponentSide, what: str) -> None:
        self._owner = owner
        self._what = what

    def __call__(self, error: BaseException | None) -> None:
        if error is not None:
            _LOG.warning("%s: queued request to %s failed: %s", self._owner.name, self._what, error)


def _visits(task: Any, context: Context) -> bool:
    """Whether this task, or one that waits for it, runs code in a component that `context` runs."""
    while task is not None and not isinstance(task, tuple) and not task.done():
        visit = getattr(task, "_aiorts_visit", None)
        if visit is not None and any(member.context is context for member in cell(visit.component).members):
            return True
        task = getattr(task, "_aiorts_creator", None)
    return False
