"""Operations that stream the events of the bus and the changes of the profile."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterator, Mapping
from dataclasses import field, fields
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import SimulatedClock
from aiorts.control.operation import Nothing, Operation, Right
from aiorts.control.operations.known import absent
from aiorts.control.session import Session, Stream
from aiorts.errors import ControlError, format_error
from aiorts.kernel.loop.bus import Event
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.kernel.loop.turns import HOLD_SECONDS
from aiorts.late import dataclass
from aiorts.observe import (
    Change,
    Changes,
    ProfileSnapshot,
    SystemProfile,
    ToldChange,
    ToldSnapshot,
    system_profile,
    system_profile_in_turns,
)

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel


@dataclass(frozen=True, slots=True)
class Kinds:
    """The events to stream."""

    kinds: tuple[str, ...] = ()
    """Names of classes of events; an empty tuple is all."""


@dataclass(frozen=True, slots=True)
class Happened:
    """One event."""

    sequence: int
    """The number of the event; the numbers of one kernel have no gaps."""
    kind: str
    time_ns: int
    """The kernel's clock, in nanoseconds since the epoch."""
    monotonic_ns: int
    event: Mapping[str, Any] = field(default_factory=dict)
    """The fields of the event."""


def _events(session: Session, given: Kinds, stream: Stream) -> int:
    """Send each event from now on; returns the number of the last earlier event."""
    kernel, kinds = session.kernel, frozenset(given.kinds)
    known = {cls.__name__: cls for cls in _derived(Event)}
    for name in given.kinds:
        if name not in known:
            raise absent(f"{name[:80]}: no such kind of event", name, known)
        if known[name].quiet:
            raise ControlError(f"{name}: is sent only to those in the program who subscribe to this very class")

    def note(event: Event) -> None:
        kind = type(event).__name__
        if not kinds or kind in kinds:
            clock = kernel.clock
            stream.send(Happened(event.sequence, kind, clock.time_ns(), clock.monotonic_ns(), _fields(event)))

    stream.on_close(kernel.bus.subscribe(Event, note))
    return kernel.bus.sequence


def _derived(cls: type[Event]) -> Iterator[type[Event]]:
    for one in cls.__subclasses__():
        yield one
        yield from _derived(one)


def _fields(event: Event) -> Mapping[str, Any]:
    """The fields of an event; exceptions as their type and text."""
    told: dict[str, Any] = {}
    for one in fields(event):
        value = getattr(event, one.name)
        told[one.name] = format_error(value) if isinstance(value, BaseException) else value
    told.pop("sequence", None)
    return told


def _changes(session: Session, _: Nothing, stream: Stream) -> ToldSnapshot | Awaitable[ToldSnapshot]:
    """Send each change from now on; returns the profile to which the first change applies."""
    return _Changing(session.kernel, stream).begin()


class _Changing:
    """A sender of changes to a client that may be too slow: a new profile then replaces the changes it missed.

    A profile takes several turns of the loop; a change that comes meanwhile is in the profile, and is not sent. In
    simulated time a profile takes one turn: a task for it would be a further one that is ready at this instant.
    """

    def __init__(self, kernel: Microkernel, stream: Stream) -> None:
        self._kernel, self._stream = kernel, stream
        self._simulated = isinstance(kernel.clock, SimulatedClock)
        self._looking = not self._simulated
        """Whether a profile is being taken."""
        self._behind = 0
        """Changes that the next profile replaces; 0: the client has them all."""
        self._task: asyncio.Task[None] | None = None
        self._changes = Changes(kernel, 0, self._take)
        stream.on_close(self._close)

    def begin(self) -> ToldSnapshot | Awaitable[ToldSnapshot]:
        """The first profile."""
        return _told(system_profile(self._kernel)) if self._simulated else self._first()

    async def _first(self) -> ToldSnapshot:
        profile = await system_profile_in_turns(self._kernel, HOLD_SECONDS)
        self._looking, self._behind = False, 0
        return _told(profile)

    def _take(self, change: Change) -> None:
        if self._looking or self._behind or not self._stream.has_room:
            self._behind += 1
        else:
            self._stream.send(change.to_plain())
            return
        if self._looking or not self._stream.has_room:
            return
        if self._simulated:
            self._renew(system_profile(self._kernel))
        else:
            self._looking = True
            self._task = kernel_task(self._kernel.loop, self._look(), "aiorts control changes")

    async def _look(self) -> None:
        try:
            profile = await system_profile_in_turns(self._kernel, HOLD_SECONDS)
        finally:
            self._looking = False
        if self._stream.has_room:
            self._renew(profile)

    def _renew(self, profile: SystemProfile) -> None:
        missed, self._behind = self._behind, 0
        self._stream.send(_told(profile, missed))

    def _close(self) -> None:
        self._changes.close()
        if self._task is not None:
            self._task.cancel()


def _told(profile: SystemProfile, missed: int = 0) -> ToldSnapshot:
    """The snapshot of a profile, made plain in the thread that sends it."""
    return ToldSnapshot(profile.sequence, profile, ProfileSnapshot.__name__, missed)


ROWS: Final = (
    Operation(
        "changes",
        "Stream changes of the profile.",
        Nothing,
        ToldSnapshot,
        Right.VIEW,
        _changes,
        item=ToldChange | ToldSnapshot,
    ),
    Operation("events", "Stream what happens.", Kinds, int, Right.VIEW, _events, item=Happened),
)
