"""What an execution context does next, as a generator of steps; it never waits and never runs user code itself.

A driver (a task in `bulkhead.py`, a thread in `contexts/thread.py`) carries the steps out and sends back what a hook
raised. One cycle has three passes (OMG RTC 1.1, 5.2.2.4): transitions, `on_execute` or `on_error` of every member,
`on_state_update` of every active one. Requests and failures are actions; they run between cycles, in the order they
came.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts.clock import SimulatedClock
from aiorts.errors import ComponentError, StateError, said
from aiorts.kernel.bus import HookFailed, MemberAdded, MemberRemoved, StateChanged
from aiorts.kernel.chaining import chain
from aiorts.model.lifecycle import ADVICE, ON_FAILURE, TRANSITIONS, Event, Failure, LifeCycleState, transition

if TYPE_CHECKING:
    from aiorts.kernel.context import Context
    from aiorts.kernel.member import Member

__all__ = (
    "TURN",
    "Action",
    "Batch",
    "Call",
    "Life",
    "Step",
    "Steps",
    "Together",
    "Turn",
    "Wait",
    "first_pass",
    "second_pass",
)

_LONG_NS: Final = 10_000_000
_TURNS_AFTER_LONG: Final = 16
"""What others do takes several turns of the loop one after another: none of them may cost a whole long cycle."""

# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_ACTIVE = LifeCycleState.ACTIVE
_ERROR = LifeCycleState.ERROR
_INACTIVE = LifeCycleState.INACTIVE


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
    """Which hook, asked when the member's turn has come; "" for none."""

    @property
    def hooks(self) -> Iterator[tuple[Member, str]]:
        """What is left to run."""
        for member in self.members:
            hook = self.hook_of(member)
            if hook:
                yield member, hook


@dataclass(slots=True)
class Wait:
    """Wait until the deadline on the kernel's clock (None: for ever) or until somebody wants something."""

    deadline_ns: int | None = None


@dataclass(slots=True)
class Together:
    """Run these groups side by side, in each one member after the other; over when all are."""

    groups: Sequence[Sequence[Member]]
    hook_of: Callable[[Member], str]


class Turn:
    """Let everything else run once."""


TURN = Turn()
Step: TypeAlias = Call | Batch | Wait | Turn | Together
Done: TypeAlias = Callable[[BaseException | None], None]
Steps: TypeAlias = Generator[Step, "BaseException | None", None]


@dataclass(slots=True)
class Action:
    """Something to be done between two cycles; `done` is told the outcome, or why it will never happen."""

    steps: Callable[[], Steps]
    done: Done | None = None


class Life:
    """The life of one context from its start to its end."""

    __slots__ = ("_context",)

    def __init__(self, context: Context) -> None:
        self._context = context

    def steps(self) -> Steps:
        """Everything from the first `on_startup` to the last `on_shutdown`."""
        context = self._context
        for member in context._members:
            yield from self.start(member)
        context._life_began()
        worked = False
        # Simulated time waits for everybody anyhow, and turns that change nothing may let a driver of the clock go on.
        simulated = isinstance(context._require_kernel().clock, SimulatedClock)
        late_ns = 0  # when the cycle before was found late, with no wait since
        while not context._stopping:
            if context._actions:
                yield from context._next_action().steps()
                continue
            wait = context._next_cause()
            if wait is not None:
                worked = False
                late_ns = 0
                yield wait
            elif worked:
                worked = False
                yield TURN
                now_ns = context._now_ns()
                if late_ns and now_ns - late_ns >= _LONG_NS and not simulated:
                    yield from self._rest()
                    now_ns = context._now_ns()
                late_ns = now_ns
            else:
                members = context._begin_cycle()
                context.ticks += 1
                yield Batch(iter(members), first_pass)
                if context._updating:
                    yield Batch(iter(members), second_pass)
                context._end_cycle(members)
                worked = True
        yield from self._end()

    def _rest(self) -> Steps:
        """After a long cycle, with the next one due already: let the others get on, the end included."""
        for _ in range(_TURNS_AFTER_LONG):
            if self._context._stopping or self._context._actions:
                return
            yield TURN

    # -- transitions -----------------------------------------------------------------------------------------------

    def start(self, member: Member) -> Steps:
        """Run `on_startup` of a member of a starting or running context."""
        member.started = True
        error = yield Call(member, "on_startup")
        if error is not None:
            self.failed(member, "on_startup", error)

    def request(self, member: Member, event: Event, done: Done) -> Steps:
        """A transition that somebody asked for; `done` is told how it went."""
        way = transition(member.state, event)
        if member.left:
            done(StateError(f"{member.component.name}: is no longer in {self._context.name}"))
        elif member.abandoned or way is None or (member.failure is not None and member.state is not _ERROR):
            failing = member.failure is not None and member.state is not _ERROR and not member.abandoned
            refused = (ComponentError if failing else StateError)(self._refusal(member, event))
            refused.__cause__ = member.failure
            done(refused)
        elif event is Event.ACTIVATE:
            done(_because(member, "on_activated", (yield from self._activate(member))))
        elif event is Event.DEACTIVATE:
            yield from self._deactivate(member)
            done(None)
        else:
            done(_because(member, "on_reset", (yield from self._reset(member))))

    def _refusal(self, member: Member, event: Event) -> str:
        if member.failure is not None and member.state is not _ERROR and not member.abandoned:
            cause = said(member.failure)
            return f"{member.component.name} in {self._context.name}: cannot {event}: it goes to error: {cause}"
        if member.abandoned:
            advice = "one of its hooks was left behind and it never runs again; remove it"
        else:
            advice = ADVICE.get((member.state, event), "it cannot be asked for here")
        return f"{member.component.name} in {self._context.name}: cannot {event} from {member.state}: {advice}"

    def _activate(self, member: Member) -> Generator[Step, BaseException | None, BaseException | None]:
        member.finishing = False
        error = yield Call(member, "on_activated")
        if error is not None:
            self._record(member, "on_activated", error)
            yield from self._abort(member, _ACTIVE)
            return error
        self._enter(member, _ACTIVE)
        self._context._set_ports_open(member)
        return None

    def _deactivate(self, member: Member) -> Steps:
        self._enter(member, _INACTIVE)
        self._context._set_ports_open(member)
        error = yield Call(member, "on_deactivated")
        if error is not None:
            self._record(member, "on_deactivated", error)

    def _reset(self, member: Member) -> Generator[Step, BaseException | None, BaseException | None]:
        error = yield Call(member, "on_reset")
        if error is not None:
            self._record(member, "on_reset", error)
            return error
        member.failure = None
        self._enter(member, _INACTIVE)
        return None

    def fail(self, member: Member) -> Steps:
        """The transition into error after a failure."""
        if member.failure is not None and not member.left and member.state is not _ERROR:
            yield from self._abort(member, member.state)

    def _abort(self, member: Member, left: LifeCycleState) -> Steps:
        """Into error, running the hooks on the way out of `left`."""
        hooks = TRANSITIONS[left, Event.FAIL].hooks
        self._enter(member, _ERROR)
        self._context._set_ports_open(member)
        if isinstance(member.failure, KeyboardInterrupt):
            self._context._interrupted(member.failure)
        for hook in hooks:
            if member.failure is None:
                return  # the code that failed was taken back meanwhile
            error = yield Call(member, hook, (member.failure,) if hook == "on_aborting" else ())
            if error is not None:
                self._record(member, hook, error)
        self._context._member_aborted(member)

    def finish(self, member: Member) -> Steps:
        """The end of a source that said it is done; said before it was activated anew it means nothing."""
        if member.finishing and member.active:
            yield from self._deactivate(member)

    # -- members that come and go, and the end ---------------------------------------------------------------------

    def add(self, member: Member, done: Done) -> Steps:
        """A component joins the running context."""
        self._context._attach(member)
        self._context._publish(MemberAdded(self._context.name, member.component.name))
        yield from self.start(member)
        done(None)

    def remove(self, member: Member, done: Done) -> Steps:
        """A component leaves the running context."""
        if not member.left:
            yield from self._leave(member)
            self._context._detach(member)
            self._context._publish(MemberRemoved(self._context.name, member.component.name))
        done(None)

    def change_rate(self, rate: float, done: Done) -> Steps:
        """The context gets another rate."""
        self._context._set_rate_now(rate)
        for member in tuple(self._context._members):
            error = yield Call(member, "on_rate_changed")
            if error is not None:
                self.failed(member, "on_rate_changed", error)
        done(None)

    def _end(self) -> Steps:
        for member in reversed(self._context._members):
            yield from self._leave(member)

    def _leave(self, member: Member) -> Steps:
        if member.failure is not None and member.state is not _ERROR:
            yield from self._abort(member, member.state)
        if member.state is _ACTIVE:
            yield from self._deactivate(member)
        if member.started:
            member.started = False
            error = yield Call(member, "on_shutdown")
            if error is not None:
                self._record(member, "on_shutdown", error)

    # -- what a failure leads to -----------------------------------------------------------------------------------

    def failed(self, member: Member, hook: str, error: BaseException) -> None:
        """A hook raised: record it and do what the table says."""
        self._fail(member, hook, error, ON_FAILURE[hook])

    def task_failed(self, member: Member, error: BaseException) -> None:
        """A task that the component started failed."""
        self._fail(member, "task", error, Failure.ABORT)

    def _fail(self, member: Member, hook: str, error: BaseException, leads_to: Failure) -> None:
        aborts = leads_to is Failure.ABORT and member.state is not _ERROR
        first = member.failure is None
        self._record(member, hook, error, leads_to, aborts=aborts)
        if aborts and first:
            self._context._submit(Action(lambda: self.fail(member)))

    def _record(
        self,
        member: Member,
        hook: str,
        error: BaseException,
        leads_to: Failure | None = None,
        *,
        aborts: bool | None = None,
    ) -> None:
        """Keep the error. What fails while a failure is dealt with is chained to that failure, not to each other."""
        component = member.component
        leads_to = ON_FAILURE[hook] if leads_to is None else leads_to
        chain(error, member.failure)
        if member.failure is None and leads_to is not Failure.RECORD:
            member.failure = error
        component._rt_last_error = error
        self._context._publish(HookFailed(component.name, self._context.name, hook, error))
        self._log(member, hook, error)
        if aborts is None:
            aborts = leads_to is Failure.ABORT
        if isinstance(error, KeyboardInterrupt) and not aborts:
            self._context._interrupted(error)

    def _log(self, member: Member, hook: str, error: BaseException) -> None:
        """As from inside the hook, which has returned already: the line tells hook and tick."""
        component = member.component
        component._rt_failed_in = member, hook
        text = "".join(traceback.format_exception_only(error)).strip()
        try:
            # The hook stands in the template: repeats are folded by template, another hook's failure is no repeat.
            component.log.error(f"{component.name}.{hook} failed: %s", text, exc_info=error)  # noqa: G004
        finally:
            component._rt_failed_in = None

    def _enter(self, member: Member, state: LifeCycleState) -> None:
        old, member.state = member.state, state
        if old is not state:
            self._context._publish(StateChanged(member.component.name, self._context.name, old, state))
            if member.component._rt_composite is not None:
                member.component._rt_composite._rt_member_entered(member)


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


def _because(member: Member, hook: str, error: BaseException | None) -> BaseException | None:
    """What the one who asked is told."""
    if error is None:
        return None
    told = ComponentError(f"{member.component.name}: {hook} raised {said(error)}; it is in error")
    told.__cause__ = error
    return told
