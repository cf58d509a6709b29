"""A context that runs a component because something happened to it: new data, `trigger()`, a failure to be dealt with.

Components with a cause stand on a ready list and run in the order of addition, each at most once in a cycle. One is
ready again when unread data remains and it took at least one sample; a component that leaves its data alone is not
asked again before more comes.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, ClassVar

from aiorts.kernel.context import Context
from aiorts.kernel.life import Wait
from aiorts.kernel.port import NOTHING, OFF
from aiorts.kernel.ports import InPort
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.member import Member
    from aiorts.kernel.ports import Port

__all__ = ("EventContext",)

_FOR_EVER = Wait(None)
_order = attrgetter("order")
# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_INACTIVE = LifeCycleState.INACTIVE


class EventContext(Context):
    """Runs members that have a cause. Args: see `Context`."""

    kind: ClassVar[str] = "event"

    def __init__(self, *, name: str = "", deadline: float | None = None, timing: bool = False) -> None:
        super().__init__(name=name, deadline=deadline, timing=timing)
        self._ready: list[Member] = []
        """Each of these is marked ready. Empty while the context sleeps: whoever makes the first entry wakes it."""
        self._everyone: Sequence[Member] = ()
        """Who was there when all were triggered at once: as good as ready and triggered, without a mark on each."""
        self._listening = 0
        """In-ports that wake members."""

    def trigger(self, *components: Component) -> None:
        """Give these members, or all, a cause to run. Triggers before the next cycle coalesce."""
        self._check("trigger")
        if components:
            self._make_ready([self._member(component) for component in components])
        else:
            self._everyone = self._members.copy()
            if self._driver is not None:
                self._driver.kick()

    def _make_ready(self, members: Sequence[Member]) -> None:
        self._mark(members)
        if self._driver is not None:
            self._driver.kick()

    def _mark(self, members: Sequence[Member]) -> None:
        ready = self._ready
        for member in members:
            member.triggered = True
            if not member.ready:
                member.ready = True
                ready.append(member)

    def _member_ready(self, member: Member) -> None:
        ready = self._ready
        ready.append(member)
        if len(ready) == 1 and self._driver is not None:
            self._driver.kick()

    def _member_aborted(self, member: Member) -> None:
        self._make_ready((member,))

    def _port_added(self, member: Member, port: Port[object]) -> None:
        super()._port_added(member, port)
        if isinstance(port, InPort):
            self._listening += 1
            port._wakes += (member.ring,)
            port._arm()

    def _port_removed(self, member: Member, port: Port[object]) -> None:
        known = port in member.in_ports
        super()._port_removed(member, port)
        if isinstance(port, InPort) and known:
            self._listening -= 1
            port._wakes = tuple(wake for wake in port._wakes if wake != member.ring)
            port._arm()

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

    def _alone(self) -> Member | None:
        # Written out: this stands between a sample and the hook it is for.
        ready = self._ready
        if len(ready) != 1 or self._everyone or self._actions or self._stopping or self._updating:
            return None
        member = ready[0]
        rung = member.rung
        if len(rung) != 1 or not rung[0]._direct or member.execute is None:
            return None
        ready.clear()
        rung[0]._armed = True
        rung.clear()
        member.ready = member.triggered = False
        for port in member.in_ports:
            if port._last is not NOTHING:
                port._before, port._last = port._last, NOTHING
        self.ticks += 1
        return member

    def _begin_cycle(self) -> Sequence[Member]:
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
            rung = member.rung
            if member.execute is not None and len(rung) == 1 and rung[0]._direct:
                # Written out: the one that data came for, through the port that nobody else writes or reads.
                rung[0]._armed = True
                rung.clear()
            elif (member.triggered and member.execute is not None) or _has_cause(member):
                if rung:
                    member.rearm()
            else:
                continue
            members.append(member)
            member.ready = member.triggered = False
            for port in member.in_ports:
                if port._last is not NOTHING:
                    port._before, port._last = port._last, NOTHING
        return members

    def _begin_for_all(self, everyone: Sequence[Member]) -> Sequence[Member]:
        """All were triggered and nobody has another cause: no flag is set, no port has rung."""
        if not self._listening:
            return everyone  # who cannot run is passed over
        members = [member for member in everyone if member.execute is not None or _can_run(member)]
        for member in members:
            for port in member.in_ports:
                if port._last is not NOTHING:
                    port._before, port._last = port._last, NOTHING
        return members

    def _end_cycle(self, members: Sequence[Member]) -> None:
        if not self._listening:
            return
        again = []
        # Written out: this ends every cycle.
        for member in members:
            for port in member.in_ports:
                if port._last is not NOTHING:
                    queue = port._direct
                    if (queue or queue is OFF or len(member.in_ports) > 1) and member.active and _left_unread(member):
                        again.append(member)
                    break
        if again:
            self._make_ready(again)


def _can_run(member: Member) -> bool:
    return member.state is not _INACTIVE and not member.left


def _has_cause(member: Member) -> bool:
    """Whether it was triggered or has unread data; data that rang may have been read in the cycle it came in.

    Who is inactive or has left has no cause: a trigger does not wait for an activation.
    """
    if member.state is _INACTIVE or member.left:
        member.ready = member.triggered = False
        member.rearm()
        return False
    if member.triggered:
        return True
    # Armed before looked at: what a thread writes in between rings again, and is not left lying.
    member.ready = False
    rung = member.rung.copy()
    member.rearm()
    for port in rung:
        if port.is_new:
            member.ready = True
            member.rung.append(port)  # asked again before the cycle begins, the answer is the same
            return True
    return False


def _left_unread(member: Member) -> bool:
    for port in member.in_ports:
        queue = port._direct
        if queue or (queue is OFF and port._unread()):
            return True
    return False
