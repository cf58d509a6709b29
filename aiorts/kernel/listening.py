"""Listeners of connectors: what becomes of each sample, told soon after it happened, on the loop, in order.

A connector that is listened to is one of the classes here, by a change of its class; every other connector and port
runs the very code it ran before. What happens is only noted where it happens, in whatever thread, and told at the
loop's next turn: no listener runs inside a write or a read, and none can lose a sample or harm a component. At most
10,000 notes wait; those beyond are counted in `missed`.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

from aiorts.errors import ReadTimeout, StateError
from aiorts.kernel.backlog import PeriodicConnector
from aiorts.kernel.bus import Event, Observer
from aiorts.kernel.connector import Connector
from aiorts.kernel.in_port import InPort
from aiorts.kernel.port import OFF
from aiorts.kernel.waiting import admit_each
from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Push

if TYPE_CHECKING:
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.waiting import Waiting

__all__ = ("ConnectorEvent", "Happening", "Listening")

T = TypeVar("T")
_MOST_NOTES: Final = 10_000


class Happening(StrEnum):
    """What happens at a connector; the names are OpenRTM's without ON_."""

    BUFFER_WRITE = "buffer_write"
    """A sample is in the reader's buffer, or in the backlog of a periodic connector."""
    BUFFER_FULL = "buffer_full"
    """A sample met a full buffer."""
    BUFFER_WRITE_TIMEOUT = "buffer_write_timeout"
    """A sample was given up: no room in time. With it RECEIVER_TIMEOUT and SENDER_TIMEOUT: there is one buffer."""
    BUFFER_OVERWRITE = "buffer_overwrite"
    """This older sample made room for a new one."""
    BUFFER_READ = "buffer_read"
    """The reader took this sample."""
    SEND = "send"
    """A sample leaves for the reader."""
    RECEIVED = "received"
    """A sample is where the reader can read it."""
    RECEIVER_FULL = "receiver_full"
    """A sample met a reader without room."""
    RECEIVER_TIMEOUT = "receiver_timeout"
    RECEIVER_ERROR = "receiver_error"
    """The reader takes no sample: it is not active."""
    BUFFER_EMPTY = "buffer_empty"
    """The reader looked and there was nothing."""
    BUFFER_READ_TIMEOUT = "buffer_read_timeout"
    """The reader waited and gave up, by a time-out or cancelled."""
    SENDER_EMPTY = "sender_empty"
    """A reader asked (pull) and the writer had nothing."""
    SENDER_TIMEOUT = "sender_timeout"
    """A reader waited for the writer (pull) in vain, or a writer for room."""
    SENDER_ERROR = "sender_error"
    """A reader asked (pull) and nobody runs the writer any more."""
    CONNECT = "connect"
    DISCONNECT = "disconnect"


@dataclass(frozen=True, slots=True)
class ConnectorEvent(Event):
    """Something happened to a sample; only sent to those who subscribe to this very class, or listen to a connector."""

    quiet: ClassVar[bool] = True
    of_samples: ClassVar[bool] = True
    connector: str
    kind: Happening
    sample: Any = None
    """Where the happening is about one."""


class _Notes:
    """Who listens to one connector."""

    __slots__ = ("hub", "listeners")

    def __init__(self, hub: Listening) -> None:
        self.hub = hub
        self.listeners: list[tuple[Observer, frozenset[str]]] = []


class Listening:
    """The listeners of one kernel's connectors, and what they are still to be told."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._waiting: deque[tuple[Connector, Happening, Any]] = deque()
        self._asked = False
        self.missed = 0
        """Notes that were dropped: more happened in one turn of the loop than is kept."""

    def add(
        self, connector: Connector, listener: Callable[[ConnectorEvent], object], kinds: Iterable[str]
    ) -> Callable[[], None]:
        """Tell `listener` of these kinds, or of all, until the returned function is called."""
        if connector.closed or self._kernel.connectors.get(connector.name) is not connector:
            raise StateError(f"{connector.name}: is not a connector of {self._kernel.name}; nobody can listen to it")
        if connector._crosses:
            raise StateError(f"{connector.name}: a real-time thread is at it, and nothing there may listen")
        entry = (Observer(ConnectorEvent, listener), frozenset(Happening(kind) for kind in kinds or Happening))
        self._listen(connector).append(entry)

        def remove() -> None:
            notes = _notes_of(connector)
            if notes is not None and entry in notes.listeners:
                notes.listeners.remove(entry)
                self._unlisten(connector)

        return remove

    def all_wanted(self, wanted: bool) -> None:
        """The bus has, or has no longer, somebody who wants to hear of every connector."""
        for connector in self._kernel.connectors.values():
            if not wanted:
                self._unlisten(connector)
            elif not connector._crosses:
                self._listen(connector)

    def made(self, connector: Connector) -> None:
        """A connector came into being while the bus wants to hear of all."""
        if not connector._crosses:
            self._listen(connector)
            self.note(connector, Happening.CONNECT, None)

    def note(self, connector: Connector, kind: Happening, sample: Any) -> None:
        """Something happened, in this thread."""
        if len(self._waiting) >= _MOST_NOTES:
            self.missed += 1
            return
        self._waiting.append((connector, kind, sample))
        if not self._asked:
            self._asked = True
            self._kernel.loop.call_soon_threadsafe(self.tell)

    def tell(self) -> None:
        """Tell what was noted so far."""
        self._asked = False
        bus = self._kernel.bus
        for _ in range(len(self._waiting)):
            connector, kind, sample = self._waiting.popleft()
            notes = _notes_of(connector)
            told = () if notes is None else notes.listeners
            event = ConnectorEvent(connector.name, kind, sample)
            bus.publish(event, tuple(observer for observer, kinds in told if kind in kinds))

    def _listen(self, connector: Connector) -> list[tuple[Observer, frozenset[str]]]:
        notes = _notes_of(connector)
        if notes is None:
            notes = connector._listening = _Notes(self)
        if not isinstance(connector, ListenedConnector):
            with connector.in_._guard():
                connector.share(False, connector.out._sent)
                connector._count_displaced()
                kind = ListenedPeriodic if isinstance(connector, PeriodicConnector) else ListenedConnector
                _become(connector, kind)
                if type(connector.in_) is InPort:
                    _become(connector.in_, ListenedInPort)
                _refresh(connector)
        return notes.listeners

    def _unlisten(self, connector: Connector) -> None:
        """Back to what it was, when nobody listens any more."""
        notes = _notes_of(connector)
        if notes is None or notes.listeners or self._kernel.bus.samples_wanted:
            return
        connector._listening = None
        if not isinstance(connector, ListenedConnector):
            return
        with connector.in_._guard():
            _become(connector, PeriodicConnector if isinstance(connector, PeriodicConnector) else Connector)
            others = any(isinstance(other, ListenedConnector) for other in connector.in_._connectors)
            if isinstance(connector.in_, ListenedInPort) and not others:
                _become(connector.in_, InPort)
            _refresh(connector)


class ListenedConnector(Connector):
    """A connector somebody listens to. See `Connector`."""

    __slots__ = ()

    @property
    def direct(self) -> bool:
        return False

    def offer(self, sample: Any) -> bool:
        if not self._crosses and not self.closed and not self.in_._open:
            self._note(Happening.RECEIVER_ERROR, sample)
        return super().offer(sample)

    def queue_up(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting:
        self._note(Happening.BUFFER_FULL, sample)
        self._note(Happening.RECEIVER_FULL, sample)
        return super().queue_up(sample, future)

    def refuse(self, reason: str) -> None:
        super().refuse(reason)
        if reason == "timeout":
            self._note(Happening.BUFFER_WRITE_TIMEOUT)
            self._note(Happening.RECEIVER_TIMEOUT)
            self._note(Happening.SENDER_TIMEOUT)

    def take(self) -> Any:
        sample = super().take()
        self._note(Happening.BUFFER_READ, sample)
        return sample

    def take_newest(self) -> Any:
        sample = super().take_newest()
        self._note(Happening.BUFFER_READ, sample)
        return sample

    def close(self) -> None:
        if not self.closed:
            self._note(Happening.DISCONNECT)
            others = (one for one in self.in_._connectors if one is not self)
            if isinstance(self.in_, ListenedInPort) and not any(isinstance(one, ListenedConnector) for one in others):
                _become(self.in_, InPort)  # whoever closes it has the port choose its path anew
        super().close()

    def found_empty(self) -> None:
        """The reader looked and there was nothing."""
        self._note(Happening.BUFFER_EMPTY)
        if self._quiet:
            host = self.out._host
            gone = host is None or host.retired or not host.alive
            self._note(Happening.SENDER_ERROR if gone else Happening.SENDER_EMPTY)

    def waited_in_vain(self) -> None:
        """The reader gave up."""
        self._note(Happening.BUFFER_READ_TIMEOUT)
        if self._quiet:
            self._note(Happening.SENDER_TIMEOUT)

    def _store(self, sample: Any) -> bool:
        if self._push is Push.NEW:
            for old in self._queue:
                self._note(Happening.BUFFER_OVERWRITE, old)
        return super()._store(sample)

    def _store_bounded(self, sample: Any) -> bool:
        if len(self._queue) >= self._length:
            self._note(Happening.BUFFER_FULL, sample)
            self._note(Happening.RECEIVER_FULL, sample)
            if self._full is FullPolicy.OVERWRITE:
                self._note(Happening.BUFFER_OVERWRITE, self._queue[0])
        return super()._store_bounded(sample)

    def _push_in(self, sample: Any, *, counted: bool = False) -> None:
        self._note(Happening.SEND, sample)
        super()._push_in(sample, counted=counted)
        self._note(Happening.BUFFER_WRITE, sample)
        self._note(Happening.RECEIVED, sample)

    def _admit_waiting(self) -> None:
        """As the connector does it, each by `_push_in`."""
        waiting = self._waiting
        if waiting is not None:
            admit_each(self, waiting)
            if not waiting:
                self.in_._fast = self.in_._direct
            self.in_._room_made()

    def _note(self, kind: Happening, sample: Any = None) -> None:
        notes = _notes_of(self)
        if notes is not None:
            notes.hub.note(self, kind, sample)


class ListenedPeriodic(ListenedConnector, PeriodicConnector):
    """A periodic connector somebody listens to. See `PeriodicConnector`."""

    __slots__ = ()

    def offer(self, sample: Any) -> bool:
        taken = not self.closed and self.in_._open
        if taken and len(self._backlog) >= self.profile.out_length:
            self._note(Happening.BUFFER_FULL, sample)
            if self._full is not FullPolicy.REJECT:
                self._note(Happening.BUFFER_OVERWRITE, self._backlog[0])
        accepted = super().offer(sample)
        if taken and accepted:
            self._note(Happening.BUFFER_WRITE, sample)
        return accepted

    def _takes_all(self) -> bool:
        return False


class ListenedInPort(InPort[T]):
    """An in-port with a connector somebody listens to. See `InPort`."""

    __slots__ = ()

    def read_blocking(self, timeout: float | None = None) -> T:
        try:
            return super().read_blocking(timeout)
        except ReadTimeout:
            self._gave_up()
            raise

    def _read_general(self) -> T:
        if not self._unread():
            self._found_empty()
        return super()._read_general()

    def _latest_general(self) -> T | None:
        if not self._unread():
            self._found_empty()
        return super()._latest_general()

    async def _wait(self) -> None:
        self._found_empty()
        try:
            await super()._wait()
        except asyncio.CancelledError:
            self._gave_up()
            raise

    def _choose_path(self) -> None:
        super()._choose_path()
        self._fast = self._direct = OFF
        self._plain = False

    def _found_empty(self) -> None:
        for connector in self._connectors:
            if isinstance(connector, ListenedConnector):
                connector.found_empty()

    def _gave_up(self) -> None:
        for connector in self._connectors:
            if isinstance(connector, ListenedConnector):
                connector.waited_in_vain()


def mute(port: InPort[Any]) -> bool:
    """A real-time thread comes to this port: nobody can listen there. Whether anybody did."""
    heard = [connector for connector in port._connectors if isinstance(connector, ListenedConnector)]
    for connector in heard:
        _become(connector, PeriodicConnector if isinstance(connector, PeriodicConnector) else Connector)
    if isinstance(port, ListenedInPort):
        _become(port, InPort)
    return bool(heard)


def unmute(port: InPort[Any]) -> None:
    """It has gone: those who listened hear again."""
    for connector in port._connectors:
        notes = _notes_of(connector)
        if notes is not None:
            notes.hub._listen(connector)


def _notes_of(connector: Connector) -> _Notes | None:
    notes: _Notes | None = getattr(connector, "_listening", None)  # few connectors ever have any
    return notes


def _refresh(connector: Connector) -> None:
    connector.in_._refresh()
    for other in connector.in_._connectors:
        other.out._refresh()
    connector.out._refresh()


def _become(thing: Any, kind: type[Any]) -> None:
    thing.__class__ = kind
