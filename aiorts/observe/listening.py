"""Listeners of connectors are called for each event of a sample: soon after the event, on the loop, in order.

A connector with listeners has a transport of the kind here; the code of all other connectors and ports is unchanged. An
event is only noted where it happens, in any thread, and reported at the loop's next turn: no listener runs inside a
write or a read, and no listener can lose a sample or harm a component. At most 10,000 notes wait; further notes are
counted in `missed`.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Collection, Iterable
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.errors import StateError
from aiorts.kernel.loop.bus import Event, Observer
from aiorts.kernel.ports.connector import Connector, transport_of
from aiorts.kernel.ports.features import PLAIN, TransportKind
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.periodic_transport import PeriodicTransport
from aiorts.kernel.ports.port import host_of
from aiorts.kernel.ports.receiver import Receiver
from aiorts.kernel.ports.transport import Transport
from aiorts.late import dataclass
from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Push

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.transport import Waiting


_MOST_NOTES: Final = 10_000


class ConnectorEventKind(StrEnum):
    """The kind of an event at a connector; the names are OpenRTM's without ON_, but for SKIPPED, UNCONVERTED,
    SUPERSEDED and EXPIRED."""

    BUFFER_WRITE = "buffer_write"
    """A sample is in the reader's buffer, or in the backlog of a periodic connector."""
    BUFFER_FULL = "buffer_full"
    """A sample met a full buffer."""
    BUFFER_WRITE_TIMEOUT = "buffer_write_timeout"
    """This sample had no room in time. RECEIVER_TIMEOUT and SENDER_TIMEOUT come with it: there is one buffer."""
    BUFFER_OVERWRITE = "buffer_overwrite"
    """This older sample made room for a new one."""
    SKIPPED = "skipped"
    """The push policy leaves this sample out."""
    UNCONVERTED = "unconverted"
    """The connector's converter failed on this sample."""
    SUPERSEDED = "superseded"
    """A newer sample was sent, or read, in the place of this one."""
    EXPIRED = "expired"
    """This sample was not read within the connector's lifespan."""
    BUFFER_READ = "buffer_read"
    """The reader took this sample."""
    SEND = "send"
    """A sample leaves for the reader."""
    RECEIVED = "received"
    """A sample can be read by the reader from now on."""
    RECEIVER_FULL = "receiver_full"
    """A sample met a reader without room."""
    RECEIVER_TIMEOUT = "receiver_timeout"
    RECEIVER_ERROR = "receiver_error"
    """The reader takes no sample: it is not active."""
    BUFFER_EMPTY = "buffer_empty"
    """The reader read, and there was no sample."""
    BUFFER_READ_TIMEOUT = "buffer_read_timeout"
    """The reader waited and gave up, by a time-out or cancelled."""
    SENDER_EMPTY = "sender_empty"
    """A reader pulled, and the writer had no sample."""
    SENDER_TIMEOUT = "sender_timeout"
    """A reader waited in vain for the writer (pull), or a writer waited in vain for room."""
    SENDER_ERROR = "sender_error"
    """A reader pulled and no context runs the writer any more."""
    CONNECT = "connect"
    DISCONNECT = "disconnect"


_LEFT_OUT: Final = {
    "skipped": ConnectorEventKind.SKIPPED,
    "superseded": ConnectorEventKind.SUPERSEDED,
    "unconverted": ConnectorEventKind.UNCONVERTED,
    "expired": ConnectorEventKind.EXPIRED,
}
"""The reasons for dropping a sample that are reported where the drop is counted."""


@dataclass(frozen=True, slots=True)
class ConnectorEvent(Event):
    """An event of a sample or connector; only for subscribers to this very class and for listeners of the connector."""

    quiet: ClassVar[bool] = True
    of_samples: ClassVar[bool] = True
    connector: str
    kind: ConnectorEventKind
    sample: Any = None
    """The sample, where the event is about one."""


class _Notes:
    """The listeners of one connector."""

    __slots__ = ("hub", "listeners")

    def __init__(self, hub: Listening) -> None:
        self.hub = hub
        self.listeners: list[tuple[Observer, frozenset[str]]] = []

    def resume(self, connector: Connector) -> None:
        """Listen again to a connector that was mute."""
        self.hub._listen(connector)


class Listening:
    """The listeners of one kernel's connectors, and the notes that are still to be reported to them."""

    def __init__(self, kernel: Microkernel) -> None:
        self._kernel = kernel
        self._waiting: deque[tuple[Connector, ConnectorEventKind, Any]] = deque()
        self._requested = False
        self.missed = 0
        """The number of dropped notes: one turn of the loop brought more notes than are kept."""

    def add(
        self, connector: Connector, listener: Callable[[ConnectorEvent], object], kinds: Iterable[str]
    ) -> Callable[[], None]:
        """Call `listener` for events of these kinds, or of all, until the returned function is called."""
        if connector.closed or self._kernel.connectors.get(connector.name) is not connector:
            raise StateError(f"{connector.name}: is not a connector of {self._kernel.name}; it takes no listener")
        if not transport_of(connector).listenable:
            raise StateError(f"{connector.name}: a real-time thread is at it, and nothing there may listen")
        entry = (
            Observer(ConnectorEvent, listener),
            frozenset(ConnectorEventKind(kind) for kind in kinds or ConnectorEventKind),
        )
        self._listen(connector).append(entry)

        def remove() -> None:
            notes = _notes_of(transport_of(connector))
            if notes is not None and entry in notes.listeners:
                notes.listeners.remove(entry)
                self._unlisten(connector)

        return remove

    def all_wanted(self, wanted: bool) -> None:
        """Begin or end listening to every connector: the bus has an observer of all, or none any more."""
        for connector in self._kernel.connectors.values():
            if not wanted:
                self._unlisten(connector)
            elif transport_of(connector).listenable:
                self._listen(connector)

    def made(self, connector: Connector) -> None:
        """Listen to a new connector, while the bus has an observer of all."""
        if transport_of(connector).listenable:
            self._listen(connector)
            self.note(connector, ConnectorEventKind.CONNECT, None)

    def note(self, connector: Connector, kind: ConnectorEventKind, sample: Any) -> None:
        """Note an event, in this thread."""
        if len(self._waiting) >= _MOST_NOTES:
            self.missed += 1
            return
        self._waiting.append((connector, kind, sample))
        if not self._requested:
            self._requested = True
            self._kernel.loop.call_soon_threadsafe(self.report)

    def report(self) -> None:
        """Report the notes so far."""
        self._requested = False
        bus = self._kernel.bus
        for _ in range(len(self._waiting)):
            connector, kind, sample = self._waiting.popleft()
            notes = _notes_of(transport_of(connector))
            listeners = () if notes is None else notes.listeners
            event = ConnectorEvent(connector.name, kind, sample)
            bus.publish(event, tuple(observer for observer, kinds in listeners if kind in kinds))

    def _listen(self, connector: Connector) -> list[tuple[Observer, frozenset[str]]]:
        transport, receiver = transport_of(connector), receiver_of(connector.in_)
        if transport.listeners is None:
            transport.listeners = _Notes(self)
        notes: _Notes = transport.listeners
        if not isinstance(transport, ListenedTransport):
            with receiver.guard():
                if not isinstance(receiver, ListenedReceiver):
                    receiver = receiver.replace(LISTENED, all_transports=False)
                transport.replace(LISTENED, receiver)
                receiver.refresh_all()
        return notes.listeners

    def _unlisten(self, connector: Connector) -> None:
        """Put back the plain kind of transport, when the last listener has gone."""
        transport, receiver = transport_of(connector), receiver_of(connector.in_)
        notes = _notes_of(transport)
        if notes is None or notes.listeners or self._kernel.bus.samples_wanted:
            return
        transport.listeners = None
        if isinstance(transport, ListenedTransport):
            with receiver.guard():
                transport.replace(PLAIN, receiver)
                receiver.connector_ended()
                receiver_of(connector.in_).refresh_all()


class ListenedTransport(Transport):
    """A transport with listeners. See `Transport`."""

    __slots__ = ()
    admits_plainly = False

    @property
    def direct(self) -> bool:
        return False

    def offer(self, sample: Any) -> bool:
        if not self.closed and not self.receiver.open:
            self._note(ConnectorEventKind.RECEIVER_ERROR, sample)
        return super().offer(sample)

    def queue_up(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting:
        self._note(ConnectorEventKind.BUFFER_FULL, sample)
        self._note(ConnectorEventKind.RECEIVER_FULL, sample)
        return super().queue_up(sample, future)

    def time_out(self, entry: Waiting) -> None:
        super().time_out(entry)
        self._note(ConnectorEventKind.BUFFER_WRITE_TIMEOUT, entry.sample)
        self._note(ConnectorEventKind.RECEIVER_TIMEOUT, entry.sample)
        self._note(ConnectorEventKind.SENDER_TIMEOUT)

    def take(self) -> Any:
        sample = super().take()
        self._note(ConnectorEventKind.BUFFER_READ, sample)
        return sample

    def take_newest(self) -> Any:
        sample = super().take_newest()
        self._note(ConnectorEventKind.BUFFER_READ, sample)
        return sample

    def close(self) -> None:
        if not self.closed:
            self._note(ConnectorEventKind.DISCONNECT)
        super().close()

    def mute(self) -> None:
        self.replace(PLAIN, self.receiver)

    def found_empty(self) -> None:
        """Note that the reader read, and there was no sample."""
        self._note(ConnectorEventKind.BUFFER_EMPTY)
        if self.pulls:
            host = host_of(self.connector.out)
            gone = host is None or host.retired or not host.alive
            self._note(ConnectorEventKind.SENDER_ERROR if gone else ConnectorEventKind.SENDER_EMPTY)

    def waited_in_vain(self) -> None:
        """Note that the reader gave up."""
        self._note(ConnectorEventKind.BUFFER_READ_TIMEOUT)
        if self.pulls:
            self._note(ConnectorEventKind.SENDER_TIMEOUT)

    def drop_these(self, reason: str, samples: Collection[Any]) -> None:
        kind = _LEFT_OUT.get(reason)
        if kind is not None:
            for sample in samples:
                self._note(kind, sample)
        super().drop_these(reason, samples)

    def store(self, sample: Any) -> bool:
        if self.push is Push.NEW:
            for old in self.queue:
                self._note(ConnectorEventKind.BUFFER_OVERWRITE, old)
        return super().store(sample)

    def store_bounded(self, sample: Any) -> bool:
        if len(self.queue) >= self.length:
            self._note(ConnectorEventKind.BUFFER_FULL, sample)
            self._note(ConnectorEventKind.RECEIVER_FULL, sample)
            if self.connector.profile.full is FullPolicy.OVERWRITE:
                self._note(ConnectorEventKind.BUFFER_OVERWRITE, self.queue[0])
        return super().store_bounded(sample)

    def push_in(self, sample: Any, *, displaced: int = 0) -> None:
        self._note(ConnectorEventKind.SEND, sample)
        super().push_in(sample, displaced=displaced)
        self._note(ConnectorEventKind.BUFFER_WRITE, sample)
        self._note(ConnectorEventKind.RECEIVED, sample)

    def _note(self, kind: ConnectorEventKind, sample: Any = None) -> None:
        notes = _notes_of(self)
        if notes is not None:
            notes.hub.note(self.connector, kind, sample)


class ListenedPeriodic(ListenedTransport, PeriodicTransport):
    """A periodic transport with listeners. See `PeriodicTransport`."""

    __slots__ = ()

    def offer(self, sample: Any) -> bool:
        taken = not self.closed and self.receiver.open
        if taken and len(self.backlog) >= self.connector.profile.out_length:
            self._note(ConnectorEventKind.BUFFER_FULL, sample)
            if self.connector.profile.full is not FullPolicy.REJECT:
                self._note(ConnectorEventKind.BUFFER_OVERWRITE, self.backlog[0])
        accepted = super().offer(sample)
        if taken and accepted:
            self._note(ConnectorEventKind.BUFFER_WRITE, sample)
        return accepted

    def takes_all(self) -> bool:
        return False


class ListenedReceiver(Receiver):
    """The receiver of an in-port with a connector that has listeners. See `Receiver`."""

    __slots__ = ()
    has_fast_path = False

    def read(self) -> Any:
        if not self.unread():
            self._found_empty()
        return super().read()

    def read_newest(self) -> Any:
        if not self.unread():
            self._found_empty()
        return super().read_newest()

    def stand_by(self, waiter: asyncio.Future[None]) -> bool:
        self._found_empty()
        return super().stand_by(waiter)

    async def wait(self) -> None:
        try:
            await super().wait()
        except asyncio.CancelledError:
            receiver_of(self.port).gave_up()
            raise

    def gave_up(self) -> None:
        for transport in self.transports:
            if isinstance(transport, ListenedTransport):
                transport.waited_in_vain()

    def connector_ended(self) -> None:
        if not any(isinstance(transport, ListenedTransport) for transport in self.transports):
            with self.guard():
                self.replace(PLAIN, all_transports=False).refresh_all()

    def mute(self) -> None:
        super().mute()
        self.replace(PLAIN, all_transports=False)

    def _found_empty(self) -> None:
        for transport in self.transports:
            if isinstance(transport, ListenedTransport):
                transport.found_empty()


LISTENED = TransportKind(ListenedReceiver, ListenedTransport, ListenedPeriodic)
"""The transports of connectors with listeners."""


def _notes_of(transport: Transport) -> _Notes | None:
    notes: _Notes | None = transport.listeners
    return notes
