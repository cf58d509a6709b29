"""Joins accepted goals to the rest of a kernel: their provider and client, their counts, their ends from outside.

A goal outlives the call by which it was accepted. When its client goes, its provider is asked to cancel it; when its
provider goes, it has failed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol

from aiorts.errors import InterfaceMismatch
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.bus import Event, HookFailed, StateChanged
from aiorts.kernel.loop.tasks import current_task, waiting_driver
from aiorts.kernel.service import KernelService
from aiorts.late import dataclass
from aiorts.model.lifecycle import LifecycleState
from aiorts.services.goals import Goal, Outcome
from aiorts.services.service_arguments import GoalTypes
from aiorts.services.tallies import count_in

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.services.tallies import Tally

_FORSAKEN: Final = "its client was gone before it was accepted"


@dataclass(frozen=True, slots=True)
class GoalAccepted(Event):
    """A provider has accepted a goal."""

    caller: str
    """The path of the required interface."""
    provider: str
    """The path of the provided interface."""
    method: str


@dataclass(frozen=True, slots=True)
class GoalEnded(Event):
    """A goal has ended."""

    caller: str
    provider: str
    method: str
    state: str
    """ "succeeded", "failed" or "cancelled"."""
    reason: str
    """The key of a failed goal in `GoalStatistics.failed`; else ""."""
    elapsed_ns: int
    """The time since the goal was accepted."""


class Link(Protocol):
    """A required interface bound to a provided one: the part of a link that goals use."""

    kernel: Microkernel
    component: Component
    required: Any
    provided: Any
    closed: bool
    tally: Tally
    now_ns: Callable[[], int]

    def named(self, method: str) -> str:
        """The name of a call over the link, for messages."""
        ...


class Acceptance:
    """An accepted goal: its two ends, and the time at which it began."""

    __slots__ = ("_begun_ns", "_keeper", "_method", "_task", "_timer", "_types", "kernel", "link")

    def __init__(self, link: Link, method: str, types: GoalTypes, keeper: GoalKeeper) -> None:
        self.link = link
        self.kernel = link.kernel
        self._method = method
        self._types = types
        self._keeper = keeper
        self._begun_ns = link.now_ns()
        self._task: tuple[asyncio.Task[Any], Any] | None = None
        self._timer: Cancellable | None = None

    @property
    def name(self) -> str:
        """The two ends and the method, for messages."""
        return self.link.named(self._method)

    @property
    def provider(self) -> str:
        """The name of the provider's component."""
        name: str = self.link.provided.port._component.name
        return name

    @property
    def client(self) -> str:
        """The name of the component that the goal was accepted for."""
        name: str = self.link.required.port._component.name
        return name

    @property
    def held_up(self) -> str:
        """The remark for messages that the client's running hook keeps the provider's from running; else ""."""
        driver = waiting_driver(current_task())
        for member in cell(self.link.component).members:
            if driver is not None and member.context.runner.driver is driver:
                return f"; {self.provider} does not run while a hook in {member.context.name} waits: wait elsewhere"
        return ""

    def misfit(self, what: str, value: object) -> InterfaceMismatch | None:
        """The error for a value that is not of the interface's type of feedback or result; else None."""
        wrong = self._types.misfit(what, value)
        return InterfaceMismatch(f"{self.name}: {wrong}") if wrong else None

    def count(self, what: str, reason: str = "") -> None:
        """Count an event of the goal for the connector and, after the connector's end, for both its ends."""
        count_in(tallies(self.link), what, reason)

    def begin(self, goal: Goal[Any, Any]) -> None:
        """Begin the goal for the task of its client: the goal's client counts as gone when the task is cancelled."""
        self._keeper.running[goal] = self
        task = current_task()
        if task is not None:
            self._task = task, partial(_client_task_ended, goal)
            task.add_done_callback(self._task[1])

    def requested(self, goal: Goal[Any, Any]) -> None:
        """Wake the provider to cancel the goal, within `cancel_timeout` seconds."""
        seconds = self.link.provided.cancel_timeout
        text = f"was asked to cancel ({goal._requested}) and did not end within {seconds} s"
        self._timer = self.kernel.call_later(seconds, lambda: goal._end_from_outside("cancel_timeout", text))
        self.wake()

    def ended(self, goal: Goal[Any, Any], outcome: Outcome) -> None:
        """Count and publish the end of the goal."""
        self._keeper.running.pop(goal, None)
        if self._timer is not None:
            self._timer.cancel()
        if self._task is not None:
            self._task[0].remove_done_callback(self._task[1])
        self.count(outcome.state, outcome.reason)
        link, elapsed_ns = self.link, self.link.now_ns() - self._begun_ns
        if not outcome.own:
            self.wake()
        self.kernel.bus.publish(
            GoalEnded(
                *(link.required.path, link.provided.path, self._method),
                *(outcome.state, outcome.reason, elapsed_ns),
            )
        )

    def wake(self) -> None:
        """Let the event contexts of the provider execute it."""
        from aiorts.contexts import EventContext  # late: a caller has it loaded, a provider need not

        for member in cell(self.link.component).members:
            if isinstance(member.context, EventContext) and member.context.running:
                member.context.trigger(self.link.component)


def _client_task_ended(goal: Goal[Any, Any], task: asyncio.Task[Any]) -> None:
    if task.cancelled():
        goal._request("its client was cancelled")


def tallies(link: Link) -> tuple[Tally, ...]:
    """The tallies in which a link counts: also those of its two interfaces after they took over its counts."""
    return (link.tally, link.required._tally, link.provided._tally) if link.closed else (link.tally,)


def forsake(value: object) -> None:
    """End the value if it is a goal: a method has returned it after its caller had gone."""
    if isinstance(value, Goal) and value._acceptance is None:
        value._end_from_outside("refused", _FORSAKEN)


def answer_offer(
    link: Link, method: str, types: GoalTypes, value: Any, error: BaseException | None
) -> BaseException | None:
    """End a call that offers a goal: the goal runs from now on, or was refused; returns the caller's error."""
    count_in(tallies(link), "offered")
    if error is not None:
        return error
    if value._acceptance is not None or value.state == "failed":
        return InterfaceMismatch(
            f"{link.named(method)}: {link.provided.path} answered with a goal that it has returned before; "
            "make a Goal() in each call"
        )
    count_in(tallies(link), "accepted")
    acceptance = Acceptance(link, method, types, link.kernel.service(GoalKeeper))
    acceptance.begin(value)
    link.kernel.bus.publish(GoalAccepted(link.required.path, link.provided.path, method))
    value._accept(acceptance)
    if reason := link.provided._refusal:
        value._end_from_outside("deactivated", reason)
    elif link.closed:
        value._request("it was disconnected")
    else:
        acceptance.wake()
    return None


class GoalKeeper(KernelService):
    """The running goals of a kernel."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.running: dict[Goal[Any, Any], Acceptance] = {}
        kernel.bus.subscribe(StateChanged, self._state_changed)
        kernel.bus.subscribe(HookFailed, self._hook_failed)

    @property
    def cancelling(self) -> bool:
        """Whether a running goal is to be cancelled; it ends within its `cancel_timeout`."""
        return any(goal.cancel_requested for goal in self.running)

    def _state_changed(self, event: StateChanged) -> None:
        if event.new is LifecycleState.ACTIVE or not self.running:
            return
        name, text = event.component, f"{event.component} went to {event.new} in {event.context}"
        for goal, acceptance in tuple(self.running.items()):
            link, error = acceptance.link, event.new is LifecycleState.ERROR
            if acceptance.provider == name and not _is_active(link.provided):
                if error:
                    goal._end_from_outside("error", text, cell(link.component).last_error)
                elif not link.provided.always:
                    goal._end_from_outside(*self._reason("deactivated", text, name))
            elif acceptance.client == name and not _is_active(link.required):
                goal._request(text)

    def _hook_failed(self, event: HookFailed) -> None:
        if event.context:
            return  # the failure changes the component's state
        for goal, acceptance in tuple(self.running.items()):
            if acceptance.provider == event.component:
                goal._end_from_outside("error", f"{event.component}: its {event.hook} failed", event.error)

    def components_replaced(self, pairs: Mapping[Component, Component]) -> None:
        names = {component.name for component in pairs}
        for goal, acceptance in tuple(self.running.items()):
            if acceptance.provider in names:
                goal._end_from_outside("reloaded", f"{acceptance.provider} was replaced by another instance")
            elif acceptance.client in names:
                goal._request(f"{acceptance.client} was replaced by another instance")

    def leaves(self, end: Any) -> None:
        """Fail or cancel the goals of an interface whose component is about to go."""
        for goal, acceptance in tuple(self.running.items()):
            provider, client = acceptance.provider, acceptance.client
            if acceptance.link.provided is end:
                goal._end_from_outside(*self._reason("removed", f"{provider}: it is being removed", provider))
            elif acceptance.link.required is end:
                goal._request(self._reason("removed", f"{client}: it is being removed", client)[1])

    def _reason(self, reason: str, text: str, component: str) -> tuple[str, str]:
        """The reason and text for the end of a goal; where the kernel closes, that is the reason."""
        return ("closed", f"{component}: its kernel closes") if self.kernel.closed else (reason, text)

    def disconnected(self, link: Link) -> None:
        """Cancel the goals of a link that has ended: there is no client any more."""
        for goal, acceptance in tuple(self.running.items()):
            if acceptance.link is link:
                goal._request("it was disconnected")

    def stopped(self) -> None:
        for goal in tuple(self.running):
            goal._end_from_outside("closed", "its kernel has closed")


def _is_active(end: Any) -> bool:
    return any(member.active for member in cell(end.port._component).members)
