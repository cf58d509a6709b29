"""Operations that stream what happens: events of the bus, and changes of the profile."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field, fields
from typing import Any, Final

from aiorts.control.operation import Nothing, Operation, Right
from aiorts.control.operations.known import absent
from aiorts.control.session import Session, Stream
from aiorts.errors import ControlError, format_error
from aiorts.kernel.loop.bus import Event
from aiorts.late import dataclass
from aiorts.observe import Change, Changes, ProfileSnapshot, SystemProfile, ToldChange, ToldProfile, system_profile


@dataclass(frozen=True, slots=True)
class Kinds:
    """Which events are meant."""

    kinds: tuple[str, ...] = ()
    """Names of classes of events; none is all."""


@dataclass(frozen=True, slots=True)
class Happened:
    """One event."""

    sequence: int
    """Its number; those of one kernel have no gaps."""
    kind: str
    time_ns: int
    """The kernel's clock, since the epoch."""
    monotonic_ns: int
    event: Mapping[str, Any] = field(default_factory=dict)
    """Its fields."""


def _events(session: Session, given: Kinds, stream: Stream) -> int:
    """Send each event from now on; returns the number of the last one before."""
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


def _changes(session: Session, _: Nothing, stream: Stream) -> ToldProfile:
    """Send each change from now on; returns the profile that the first belongs to."""
    behind = 0

    def take(change: Change) -> None:
        nonlocal behind
        if not stream.has_room:
            behind += 1
        elif behind:  # a new profile takes the place of what there was no room for
            profile = system_profile(session.kernel)
            stream.send(_told(profile, behind + 1))
            behind = 0
        else:
            stream.send(change.to_plain())

    changes = Changes(session.kernel, 0, take)
    stream.on_close(changes.close)
    profile = system_profile(session.kernel)
    return _told(profile)


def _told(profile: SystemProfile, missed: int = 0) -> ToldProfile:
    """The snapshot, made plain in the thread that sends it."""
    return ToldProfile(profile.sequence, profile, ProfileSnapshot.__name__, missed)


ROWS: Final = (
    Operation(
        "changes",
        "Stream changes of the profile.",
        Nothing,
        ToldProfile,
        Right.VIEW,
        _changes,
        item=ToldChange | ToldProfile,
    ),
    Operation("events", "Stream what happens.", Kinds, int, Right.VIEW, _events, item=Happened),
)
