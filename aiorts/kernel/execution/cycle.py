"""The life of an execution context as a generator of steps; it never waits and never runs user code itself.

A driver (a task in `task_driver.py`, a thread in `contexts/thread.py`) carries the steps out and sends back what a hook
raised. One cycle has three passes (OMG RTC 1.1, 5.2.2.4): transitions, `on_execute` or `on_error` of every member,
`on_state_update` of every active one. Requests and failures are actions; they run between cycles, in the order they
came.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias

from aiorts.clock import SimulatedClock
from aiorts.errors import ComponentError, StateError, format_error
from aiorts.kernel.execution.fairness import LONG_NS, Held
from aiorts.kernel.loop.bus import HookFailed, MemberAdded, MemberRemoved, StateChanged
from aiorts.kernel.loop.deadlines import StopBudget
from aiorts.kernel.loop.exceptions import chain, text_of
from aiorts.kernel.loop.guarded import KernelLog, guarded
from aiorts.kernel.loop.origins import in_brackets, located, origin_of
from aiorts.late import dataclass
from aiorts.model.lifecycle import ADVICE, ON_FAILURE, TRANSITIONS, Event, Failure, LifecycleState, transition

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import KernelSide
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.execution.task_driver import TaskDriver


_LOG = KernelLog()
_FAULTS: Final = 3
"""Faults of the kernel's own, about no member, after each of which a context goes on; at the next it ends in order."""
_TURNS: Final = 16
"""Work of other tasks takes several turns of the loop in sequence: none of them may cost a whole long cycle."""
_NEVER: Final = 1 << 63
"""Nanoseconds, later than any time."""

# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_ACTIVE = LifecycleState.ACTIVE
_ERROR = LifecycleState.ERROR
_INACTIVE = LifecycleState.INACTIVE


@dataclass(slots=True)
class Call:
    """Run one hook and send back what it raised, or None."""

    member: Member
    hook: str
    args: tuple[Any, ...] = ()


@dataclass(slots=True)
class Batch:
    """Run a hook of each of these members, in order; failures go to `Life.failed`."""

    members: Iterator[Member]
    hook_of: Callable[[Member], str]
    """The hook to run, chosen when the member's turn has come; "" for none."""

    @property
    def hooks(self) -> Iterator[tuple[Member, str]]:
        """The hooks that are left to run."""
        for member in self.members:
            hook = self.hook_of(member)
            if hook:
                yield member, hook


@dataclass(slots=True)
class Wait:
    """Wait until the deadline on the kernel's clock (None: forever) or until a request comes."""

    deadline_ns: int | None = None


class OwnStep:
    """A step that carries itself out, so that a room above adds one without the driver knowing it."""

    async def carry_out(self, driver: TaskDriver) -> None:
        """Carry out the step, in the driver's task; the step is over when this returns."""
        raise NotImplementedError


class _WaitForRequest(OwnStep):
    """Wait until something is asked for. A `Wait` of an event context in a task ends with a cycle where data come."""

    async def carry_out(self, driver: TaskDriver) -> None:
        await driver.wait_for_request()


_REQUEST = _WaitForRequest()


class Turn:
    """Let everything else that is ready run once."""


TURN = Turn()
Step: TypeAlias = Call | Batch | Wait | Turn | OwnStep
Done: TypeAlias = Callable[[BaseException | None], None]
Steps: TypeAlias = Generator[Step, "BaseException | None", None]
PassSteps: TypeAlias = "Callable[[Sequence[Member], Callable[[Member], str]], Steps]"
"""A function that gives the steps of a pass over these members; its second argument chooses each member's hook."""
Request: TypeAlias = tuple[str, Callable[[Done], Steps]]
"""A request to a context: its text for messages, and the steps that carry it out."""


class Driver(Protocol):
    """The driver that carries out the steps: a task on the loop (`task_driver.py`) or a thread. It decides nothing."""

    hooks_run: int
    """A count; together with the context's ticks and the current member it identifies the run of a hook."""

    @property
    def ended(self) -> asyncio.Future[None]:
        """Done when the last step was carried out, or the driver gave up."""
        ...

    @property
    def current(self) -> Member | None:
        """The member whose hook runs now."""
        ...

    def held_by(self, member: Member) -> tuple[int, float] | None:
        """When the member's running hook began, on the kernel's clock, and the seconds that it may take; else None."""
        ...

    def update_fast_path(self) -> None:
        """Choose the path of hooks again: observers of hooks came or went."""
        ...

    def update_for_sharing(self) -> None:
        """Note that the component whose hook runs now is in a second context from now on."""
        ...

    def limit_anew(self, member: Member) -> None:
        """Apply changed deadlines of this member's component, also to its running hook."""
        ...

    def kick(self) -> None:
        """Wake up: there is something to do."""
        ...

    def hurry(self, budget: StopBudget) -> None:
        """Limit hooks by the budget of a stop from now on, the running hook included."""
        ...

    def after(self, seconds: float, callback: Callable[[], None]) -> Callable[[], None]:
        """Call back on the loop after so many seconds of the time that hooks take; returns what cancels it."""
        ...

    def give_up_blocking(self, members: Sequence[Member]) -> None:
        """Make hooks of these members that wait for data, or block their thread, give up: the members end soon."""
        ...


@dataclass(slots=True)
class Action:
    """Steps for the time between two cycles; `done` is called with their error or None, also if they never run."""

    steps: Callable[[], Steps]
    done: Done | None = None


class Pause:
    """The time in which a context begins no cycle."""

    def __init__(self, kernel: KernelSide, driver: Driver) -> None:
        self._kernel, self._driver = kernel, driver
        self.begun: asyncio.Future[None] = kernel.loop.create_future()
        """Done when the cycle that ran is over."""
        self.over = False

    def begin(self) -> None:
        """Resolve `begun`: the cycle that ran is over. From any thread."""
        self._kernel.call_on_loop(lambda: None if self.begun.done() else self.begun.set_result(None))

    def resume(self) -> None:
        """Let cycles begin again."""
        self.over = True
        self._driver.kick()


class Life:
    """The life of one context from its start to its end."""

    __slots__ = ("_context",)

    def __init__(self, context: Context) -> None:
        self._context = context

    def steps(self, *, anew: bool = False) -> Steps:
        """The steps from the first `on_startup` to the last `on_shutdown`, or those that are still to come."""
        context = self._context
        for member in context._members:
            if not member.started and not (anew and (member.left or context._stopping)):
                yield from self._contained(self.start(member), member)
        if not anew or context._began is not None:
            context._life_began()
        worked = False
        kernel = context.runner.kernel
        yield from self._side_by_side()
        simulated = isinstance(kernel.clock, SimulatedClock)  # there time waits for everybody
        late_ns = _NEVER  # when the cycle before was found late, with no wait since
        held: Held | None = None  # made where the loop turns slowly
        while not context._stopping:
            if context._actions:
                yield from self.act(context.runner.next_action())
                yield from self._side_by_side()
                continue
            wait = context._next_cause()
            if wait is not None:
                worked = False
                late_ns = _NEVER
                yield wait
            elif worked:
                worked = False
                if held is not None:
                    held.end()
                yield TURN
                now_ns = context._now_ns()
                if now_ns - late_ns < LONG_NS or simulated:
                    late_ns, held = now_ns, None
                    if kernel._stop_due:
                        yield from self.rest()
                        late_ns = context._now_ns()
                else:
                    held = held or Held()
                    if kernel._stop_due or held.on_and_on:
                        yield from self.rest()
                    held.begin()
                    late_ns = context._now_ns()
            else:
                members = context._begin_cycle()
                context.ticks += 1
                yield Batch(iter(members), first_pass)
                if context._updating:
                    yield Batch(iter(members), second_pass)
                context._end_cycle(members)
                worked = True
        yield from self._end()

    def _side_by_side(self) -> Steps:
        """Run the cycles as long as some groups run side by side (`_divided`)."""
        context, worked = self._context, False
        kernel = context.runner.kernel
        while (way := context._divided) is not None and not context._stopping:
            if context._actions:
                yield from self.act(context.runner.next_action())
                continue
            wait = context._next_cause()
            if wait is not None:
                worked = False
                yield wait
            elif worked:
                worked = False
                yield TURN
                if kernel._stop_due:
                    yield from self.rest()
            else:
                members = context._begin_cycle()
                context.ticks += 1
                yield from way(members, first_pass)
                if context._updating:
                    yield from way(members, second_pass)
                context._end_cycle(members)
                worked = True

    def rest(self) -> Steps:
        """Give other tasks, such as the end of the kernel, some turns although the next cycle is due."""
        for _ in range(_TURNS):
            if self._context._stopping or self._context._actions:
                return
            yield TURN

    # -- faults of the kernel's own ----------------------------------------------------------------------------------

    def act(self, action: Action) -> Steps:
        """The steps of an action between two cycles; a fault in them is contained."""
        return self._contained(action.steps(), None, action.done)

    def _contained(self, steps: Steps, member: Member | None, done: Done | None = None) -> Steps:
        """Run these steps and contain a fault in them; `done` gets the fault."""
        try:
            yield from steps
        except GeneratorExit:
            raise
        except BaseException as fault:  # noqa: BLE001 - what comes next is another's, and has its turn all the same
            error = self.faulted(fault, member)
            if done is not None:
                done(error)

    def faulted(self, fault: BaseException, member: Member | None = None, then: str = "it goes on") -> BaseException:
        """Log a fault of the kernel's own code, which may concern a member, and return the error to go on with."""
        kernel = self._context.runner.kernel
        if issubclass(type(fault), KeyboardInterrupt) and not kernel._contain_interrupts:
            kernel.pass_on_interrupt(fault)  # it struck here by chance
            return fault
        kernel._faulted()
        whose = "" if member is None else f", about {member.component.name}"
        text = "context %s: a fault of aiorts itself%s; %s; please report it"
        _LOG.error(text, self._context.name, whose, then, exc_info=fault)
        return fault

    def anew(self, fault: BaseException) -> Steps | None:
        """The steps to go on with after a fault of the kernel's own code between two steps; None: there are none."""
        context = self._context
        context._faults += 1
        if context._faults <= _FAULTS and not context._stopping:
            self.faulted(fault, then="it goes on with its members")
            return self.steps(anew=True)
        over = context._faults > _FAULTS + 1
        self.faulted(fault, then="it has ended" if over else "it ends in order")
        context._ended_by = fault
        if over:
            return None
        context.runner.end_in_order()
        return self.steps(anew=True)

    # -- transitions -----------------------------------------------------------------------------------------------

    def start(self, member: Member) -> Steps:
        """Run `on_startup` of a member of a starting or running context."""
        member.started = True
        error = yield Call(member, "on_startup")
        if error is not None:
            self.failed(member, "on_startup", error)

    def request(self, member: Member, event: Event, done: Done) -> Steps:
        """Carry out a requested transition; calls `done` with its error or None."""
        way = transition(member.state, event)
        if member.left:
            done(StateError(f"{member.component.name}: is no longer in {self._context.name}"))
        elif member.abandoned or way is None or (member.failure is not None and member.state is not _ERROR):
            failing = member.failure is not None and member.state is not _ERROR and not member.abandoned
            refused = (ComponentError if failing else StateError)(self._refusal(member, event))
            refused.__cause__ = member.failure
            done(refused)
        elif event is Event.ACTIVATE:
            done(_because(member, "on_activated", (yield from self.activate(member))))
        elif event is Event.DEACTIVATE:
            yield from self.deactivate(member)
            # Its hook is recorded and no more; what has moved it to error meanwhile is what the caller has to know.
            done(_because(member, "on_deactivated", member.failure))
        else:
            done(_because(member, "on_reset", (yield from self._reset(member))))

    def _refusal(self, member: Member, event: Event) -> str:
        if member.failure is not None and member.state is not _ERROR and not member.abandoned:
            cause = located(member.failure)
            return f"{member.component.name} in {self._context.name}: cannot {event}: it goes to error: {cause}"
        if member.abandoned:
            advice = "one of its hooks was abandoned and it never runs again; remove it"
        else:
            advice = ADVICE.get((member.state, event), "it cannot be asked for here")
        return f"{member.component.name} in {self._context.name}: cannot {event} from {member.state}: {advice}"

    def activate(self, member: Member) -> Generator[Step, BaseException | None, BaseException | None]:
        member.finishing = False
        error = yield Call(member, "on_activated")
        if error is not None:
            self.record(member, "on_activated", error)
            yield from self._abort(member, _ACTIVE)
            return error
        _mend(member)
        self.enter(member, _ACTIVE)
        self._context._set_ports_open(member)
        return None

    def deactivate(self, member: Member) -> Steps:
        self.enter(member, _INACTIVE)
        self._context._set_ports_open(member)
        error = yield Call(member, "on_deactivated")
        if error is not None:
            self.record(member, "on_deactivated", error)

    def _reset(self, member: Member) -> Generator[Step, BaseException | None, BaseException | None]:
        error = yield Call(member, "on_reset")
        if error is not None:
            self.record(member, "on_reset", error)
            return error
        member.failure = None
        _mend(member)
        self.enter(member, _INACTIVE)
        return None

    def fail(self, member: Member) -> Steps:
        """The transition into error after a failure."""
        if member.failure is not None and not member.left and member.state is not _ERROR:
            yield from self._abort(member, member.state)

    def _abort(self, member: Member, left: LifecycleState) -> Steps:
        """Into error, running the hooks on the way out of `left`."""
        hooks = TRANSITIONS[left, Event.FAIL].hooks
        self.enter(member, _ERROR)
        self._context._set_ports_open(member)
        failure = member.failure
        if failure is not None and issubclass(type(failure), KeyboardInterrupt):
            self._context.runner.kernel.pass_on_interrupt(failure)
        for hook in hooks:
            if member.failure is None:
                return  # the code that failed was taken back meanwhile
            error = yield Call(member, hook, (member.failure,) if hook == "on_aborting" else ())
            if error is not None:
                self.record(member, hook, error)
        self._context._member_aborted(member)

    def finish(self, member: Member) -> Steps:
        """Deactivate a source that has called `finish`, unless it was activated again since."""
        if member.finishing and member.active:
            yield from self.deactivate(member)

    # -- members that come and go, and the end ---------------------------------------------------------------------

    def add(self, member: Member, done: Done | None = None) -> Steps:
        """A component joins the running context."""
        self._context.runner.attach(member)
        self._context.runner.publish(MemberAdded(self._context.name, member.component.name))
        yield from self.start(member)
        if done is not None:
            done(None)

    def remove(self, member: Member, done: Done | None = None) -> Steps:
        """A component leaves the running context."""
        if not member.left:
            yield from self.leave(member)
            self._context.runner.detach(member)
            self._context.runner.publish(MemberRemoved(self._context.name, member.component.name))
        if done is not None:
            done(None)

    def change_rate(self, rate: float, done: Done) -> Steps:
        """The context gets another rate."""
        self._context._set_rate_now(rate)
        for member in tuple(self._context._members):
            error = yield Call(member, "on_rate_changed")
            if error is not None:
                self.failed(member, "on_rate_changed", error)
        done(None)

    def pause(self, paused: Pause) -> Steps:
        """Begin no cycle until the pause is over, and do what is to be done between two."""
        paused.begin()
        while not paused.over and not self._context._stopping:
            if self._context._actions:
                yield from self.act(self._context.runner.next_action())
            else:
                yield _REQUEST if self._context.suspends else Wait(None)

    def retire(self, members: Sequence[Member], done: Done) -> Steps:
        """The kernel closes: these members read what they still have to read, and end."""
        for member in members:
            if not member.left:
                yield from self._contained(self._retire(member), member)
        done(None)

    def _retire(self, member: Member) -> Steps:
        context = self._context
        for _ in range(context._unread_by(member)):  # no more: one that feeds itself would never end
            if context._stopping or not context._begin_last_cycle(member):
                break
            yield Batch(iter((member,)), first_pass)
            context._end_cycle((member,))
        member.answers = member.active
        yield from self.leave(member)

    def _end(self) -> Steps:
        for member in reversed(self._context._members):
            yield from self._contained(self.leave(member), member)

    def leave(self, member: Member) -> Steps:
        if member.failure is not None and member.state is not _ERROR:
            yield from self._abort(member, member.state)
        if member.state is _ACTIVE:
            yield from self.deactivate(member)
        if member.started:
            member.started = False
            error = yield Call(member, "on_shutdown")
            if error is not None:
                self.record(member, "on_shutdown", error)

    # -- what a failure leads to -----------------------------------------------------------------------------------

    def failed(self, member: Member, hook: str, error: BaseException, leads_to: Failure | None = None) -> None:
        """A hook raised: record it and do what `leads_to` says, or the table for this hook."""
        leads_to = ON_FAILURE[hook] if leads_to is None else leads_to
        aborts = leads_to is Failure.ABORT and member.state is not _ERROR
        first = member.failure is None
        self.record(member, hook, error, leads_to, aborts=aborts)
        if aborts and first:
            self._context.runner.submit(Action(lambda: self.fail(member)))

    def task_failed(self, member: Member, error: BaseException) -> None:
        """A task that the component started failed."""
        self.failed(member, "task", error, Failure.ABORT)

    def record(
        self,
        member: Member,
        hook: str,
        error: BaseException,
        leads_to: Failure | None = None,
        *,
        aborts: bool | None = None,
    ) -> None:
        """Keep the error, publish and log it: foreign code cannot make that fail."""
        leads_to = ON_FAILURE[hook] if leads_to is None else leads_to
        before = member.failure
        if before is None and leads_to is not Failure.RECORD:
            member.failure = error
        guarded(
            f"could not tell that {hook} failed with {format_error(error)}",
            self._publish_failure,
            member,
            hook,
            error,
            before,
        )
        if aborts is None:
            aborts = leads_to is Failure.ABORT
        if issubclass(type(error), KeyboardInterrupt) and not aborts:
            self._context.runner.kernel.pass_on_interrupt(error)

    def _publish_failure(self, member: Member, hook: str, error: BaseException, before: BaseException | None) -> None:
        """Publish a failure. Failures during the handling of another are chained to that one, not to each other."""
        component = member.component
        chain(error, before)
        member.cell.last_error = error
        self._context.runner.publish(
            HookFailed(component.name, self._context.name, hook, error, origin := origin_of(error, installed=True))
        )
        self._log(member, hook, error, origin)

    def _log(self, member: Member, hook: str, error: BaseException, origin: str) -> None:
        """Log as from inside the hook, which has returned already: the line names hook and tick."""
        component = member.component
        member.cell.failed_in = member, hook
        try:
            # The hook stands in the template: repeats are folded by template, another hook's failure is no repeat.
            said = f"{text_of(error)}{in_brackets(origin)}"
            component.log.error(f"{component.name}.{hook} failed: %s", said, exc_info=error)  # noqa: G004
        finally:
            member.cell.failed_in = None

    def enter(self, member: Member, state: LifecycleState) -> None:
        old, member.state = member.state, state
        if old is not state:
            self._context.runner.publish(StateChanged(member.component.name, self._context.name, old, state))
            if member.cell.group is not None:
                member.cell.group.member_entered(member)


def first_pass(member: Member) -> str:
    """The hook of a member in the first pass of a cycle; "" for none."""
    if member.left:
        return ""
    if member.state is _ACTIVE:
        return "on_execute" if member.failure is None else ""
    return "on_error" if member.state is _ERROR else ""


def second_pass(member: Member) -> str:
    """The hook of a member in the second pass of a cycle; "" for none."""
    return "on_state_update" if member.updates and member.active and not member.left else ""


def _mend(member: Member) -> None:
    """Forget the last failure, where the component is in error in no context, and is going there in none."""
    here = member.cell
    if here.last_error is not None and all(one.failure is None for one in here.members):
        here.mended = here.last_error


def _because(member: Member, hook: str, error: BaseException | None) -> BaseException | None:
    """The error for the caller of a transition whose hook raised."""
    if error is None:
        return None
    refused = ComponentError(f"{member.component.name}: {hook} raised {located(error)}; it is in error")
    refused.__cause__ = error
    return refused
