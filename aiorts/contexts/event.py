"""A context that runs a component for a cause: new data, `trigger()`, a failure to handle.

Members with a cause are on a ready list and run in the order of addition, each at most once in a cycle. A member is
ready again when unread data remains and it read at least one sample; a component that leaves its data unread runs again
only when more arrives. With `every`, a member that has had no cause for so long is triggered.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Annotated, ClassVar, cast

from aiorts.clock import to_ns
from aiorts.contexts.schedule import MAX_RATE
from aiorts.kernel.execution.context import Context, Deadline, Timing
from aiorts.kernel.execution.cycle import Wait
from aiorts.kernel.execution.member import Member
from aiorts.kernel.ports import InPort
from aiorts.kernel.ports.connector import unread_at
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.notified_ports import NotifiedPorts
from aiorts.model.declared import Option
from aiorts.model.lifecycle import LifecycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.cell import ComponentSide
    from aiorts.kernel.ports import Port

_FOR_EVER = Wait(None)
_order = attrgetter("order")
# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_INACTIVE = LifecycleState.INACTIVE


class EventMember(Member):
    """A member that runs when it has a cause."""

    __slots__ = ("ready", "triggered")
    context: EventContext
    in_ports: NotifiedPorts

    def __init__(self, component: ComponentSide, context: EventContext, order: int) -> None:
        super().__init__(component, context, order)
        self.in_ports = NotifiedPorts()  # pyright: ignore[reportIncompatibleVariableOverride] # it is made once
        self.ready = False
        """Whether it is on the ready list."""
        self.triggered = False

    def notify(self, port: InPort[object]) -> None:
        """Record that a sample came in, which is a cause for this member to run."""
        # Written out: every sample waits for this before its hook runs.
        self.in_ports.notified.append(port)
        if not self.ready:
            self.ready = True
            context = self.context
            ready = context._ready
            driver = context.runner.driver
            if not ready and driver is not None:
                driver.kick()
            ready.append(self)


class _RepeatedMember(EventMember):
    """A member of a context with `every`."""

    __slots__ = ()

    def settle(self) -> None:
        super().settle()
        due = self.context._due
        if not self.active or self.left:
            due.pop(self, None)
        elif self not in due:
            due[self] = self.context._now_ns() + self.context._every_ns


class EventContext(Context):
    """Runs a member when it has a cause: new data, `trigger()`, or a failure that it has to handle.

    Raises:
        ConfigurationError: an option is out of range.
    """

    kind: ClassVar[str] = "event"
    _member_class = EventMember
    _members: list[EventMember]  # type: ignore[assignment] # all that it makes are

    def __init__(
        self,
        *,
        every: Annotated[
            float | None,
            Option(
                "The time by the kernel's clock after which an active member runs without another cause, counted from "
                "the cycle it ran in last or its activation; by default never. A run that was missed is not caught up. "
                "A member is no source for it: where the sources are done, the run ends.",
                unit="s",
                low=1.0 / MAX_RATE,
            ),
        ] = None,
        name: str = "",
        deadline: Deadline = None,
        timing: Timing = False,
    ) -> None:
        super().__init__(name=name, deadline=deadline, timing=timing)
        self.every = every
        if every is not None:
            self._check_options(EventContext, every=every)
            self._every_ns = to_ns(every)
            self._due: dict[_RepeatedMember, int] = {}
            """The time at which each active member runs without another cause; the next one first."""
            # These replace attributes of the class, so that a context without `every` pays nothing for `every`.
            self._member_class = _RepeatedMember  # type: ignore[misc]
            self._next_cause = self._next_cause_or_due  # type: ignore[method-assign]
            self._begin_cycle = self._begin_with_due  # type: ignore[method-assign]
        self._ready: list[EventMember] = []
        """Members marked ready. Empty while the context sleeps: the first entry wakes it."""
        self._everyone: Sequence[EventMember] = ()
        """All members, if all were triggered at once: then they count as ready without a mark on each."""
        self._listening = 0
        """In-ports that wake members."""

    def trigger(self, *components: Component) -> None:
        """Give these members, or all, a cause to run. Triggers before the next cycle coalesce."""
        self.runner.check("trigger")
        if components:
            self._make_ready([cast("EventMember", self.runner.member(component)) for component in components])
        else:
            self._everyone = self._members.copy()
            if self.runner.driver is not None:
                self.runner.driver.kick()

    def _make_ready(self, members: Sequence[EventMember]) -> None:
        self._mark(members)
        if self.runner.driver is not None:
            self.runner.driver.kick()

    def _mark(self, members: Sequence[EventMember]) -> None:
        ready = self._ready
        for member in members:
            member.triggered = True
            if not member.ready:
                member.ready = True
                ready.append(member)

    def _member_aborted(self, member: EventMember) -> None:  # type: ignore[override] # all that it makes are
        self._make_ready((member,))

    def _port_added(self, member: EventMember, port: Port[object]) -> None:  # type: ignore[override] # as above
        super()._port_added(member, port)
        if isinstance(port, InPort):
            self._listening += 1
            receiver_of(port).add_callback(member.notify)

    def _port_removed(self, member: EventMember, port: Port[object]) -> None:  # type: ignore[override] # as above
        known = port in member.in_ports
        super()._port_removed(member, port)
        if isinstance(port, InPort) and known:
            self._listening -= 1
            receiver_of(port).remove_callback(member.notify)

    def _next_cause(self) -> Wait | None:
        if self._everyone:
            if any(member.execute is not None or _can_run(member) for member in self._everyone):
                return None
            self._everyone = ()
        ready = self._ready
        while ready:
            if _has_cause(ready[-1]):
                return None
            ready.pop()
        return _FOR_EVER

    def _next_cause_or_due(self) -> Wait | None:
        cause = type(self)._next_cause(self)
        if cause is None or not self._due:
            return cause
        due_ns = next(iter(self._due.values()))
        return Wait(due_ns) if due_ns > self._now_ns() else None

    def _alone(self) -> Member | None:
        # Written out: every sample waits for this before its hook runs.
        ready = self._ready
        if len(ready) != 1 or self._everyone or self._actions or self._stopping or self._updating:
            return None
        member = ready[0]
        if member.execute is None or not member.in_ports.begin_alone():
            return None
        ready.clear()
        member.ready = member.triggered = False
        self.ticks += 1
        return member

    def _begin_cycle(self) -> Sequence[EventMember]:
        everyone, self._everyone = self._everyone, ()
        if everyone:
            if not self._ready:
                return self._begin_for_all(everyone)
            self._mark(everyone)
        ready, self._ready = self._ready, []
        if len(ready) > 1:
            ready.sort(key=_order)
        members = []
        for member in ready:
            ports = member.in_ports
            if not ports.notified or member.execute is None or not ports.begin_alone():
                if not (member.triggered and member.execute is not None) and not _has_cause(member):
                    continue
                if ports:
                    ports.begin()
            members.append(member)
            member.ready = member.triggered = False
        return members

    def _begin_with_due(self) -> Sequence[EventMember]:
        now_ns, due = self._now_ns(), self._due
        self._mark([member for member, due_ns in due.items() if due_ns <= now_ns])
        members = type(self)._begin_cycle(self)
        for member in members:
            if isinstance(member, _RepeatedMember) and due.pop(member, None) is not None:
                due[member] = now_ns + self._every_ns
        return members

    def _unread_by(self, member: EventMember) -> int:  # type: ignore[override] # as above
        return sum(map(unread_at, member.in_ports))

    def _begin_last_cycle(self, member: EventMember) -> bool:  # type: ignore[override] # as above
        member.triggered = False  # it runs for data alone
        if not member.ready or member.execute is None or not _can_run(member) or not self._unread_by(member):
            # `_has_cause` asks which ports have notified; after a cycle that left samples unread, none has.
            return False
        self._ready.remove(member)
        member.ready = False
        self.ticks += 1
        member.in_ports.begin()
        return True

    def _begin_for_all(self, everyone: Sequence[EventMember]) -> Sequence[EventMember]:
        """Begin a cycle triggered for all, when no member has another cause: no flag is set, no port was notified."""
        if not self._listening:
            return everyone  # members that cannot run are passed over
        members = [member for member in everyone if member.execute is not None or _can_run(member)]
        for member in members:
            if member.in_ports:
                member.in_ports.begin()
        return members

    def _end_cycle(self, members: Sequence[EventMember]) -> None:  # type: ignore[override] # as above
        if not self._listening:
            return
        again = []
        for member in members:  # no comprehension: this ends every cycle, and before CPython 3.12 it is a call
            if member.in_ports.queue and member.active and member.in_ports.left_unread():
                again.append(member)  # noqa: PERF401
        if again:
            self._make_ready(again)


def _can_run(member: EventMember) -> bool:
    return member.state is not _INACTIVE and not member.left


def _has_cause(member: EventMember) -> bool:
    """Whether a member was triggered or has unread data; a sample that notified may have been read in its cycle.

    A member that is inactive or has left has no cause: a trigger does not wait for an activation.
    """
    if member.state is _INACTIVE or member.left:
        member.ready = member.triggered = False
        member.in_ports.enable_notify()
        return False
    if member.triggered:
        return True
    # The mark is cleared before the check: a sample that a thread writes in between puts the member on the list again.
    member.ready = False
    if member.in_ports.find_data():
        member.ready = True
        return True
    return False
