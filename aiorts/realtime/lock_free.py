"""The receiver of lock-free transports, and how a port becomes lock-free and ordinary again: on the loop, in place.

One thread reads in the order of arrival, without a lock. A sample that it finds may be gone in the next step,
overwritten or disconnected: then it looks again. A thread that is inside with the port's lock leaves before the switch.
"""

from __future__ import annotations

from collections import deque
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from anyio import WouldBlock

from aiorts.kernel.loop.blocking import PortLock
from aiorts.kernel.ports import InPort, Port
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.features import PLAIN, TransportKind
from aiorts.kernel.ports.in_port import in_ports_at, receiver_of
from aiorts.kernel.ports.port import NOTHING, UNLOCKED
from aiorts.kernel.ports.receiver import Receiver
from aiorts.kernel.ports.transport import Transport
from aiorts.realtime.lock_free_periodic import LockFreePeriodic
from aiorts.realtime.lock_free_transport import LockFreeTransport, Numbers

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector


class LockFreeReceiver(Receiver):
    """The receiver of an in-port that a real-time thread reads, or writes to. See `Receiver`."""

    __slots__ = ()
    has_fast_path = False
    extra: Numbers

    def take_over(self, old: Receiver) -> None:
        old.settle_tokens()
        super().take_over(old)
        self.source = old.last_source
        transports = old.transports
        unread = sum(len(transport.queue) for transport in transports)
        self.extra = Numbers(self.arrivals + unread + 1, self.lock is not None)
        self.extra.transports = transports
        tokens = [transport for transport in transports for _ in transport.queue] if old.tokens is None else old.tokens
        for place, transport in enumerate(tokens):
            self.extra.unread.setdefault(transport, []).append(place)
        self.tokens = None
        if self.lock is None:
            self.lock = PortLock()

    def hand_over(self) -> None:
        transports = self.extra.transports
        places = [(place, transport) for transport in transports for place in transport.extra.places]
        places.sort(key=itemgetter(0))
        self.tokens = deque(transport for _, transport in places) if len(transports) > 1 else None
        self.arrivals = next(self.extra.numbers)
        self.lock = self.sole = None

    def exchange(self, old: Transport, new: Transport) -> None:
        self.extra.transports = tuple(new if one is old else one for one in self.extra.transports)

    def peek(self) -> Any:
        self.check_thread()
        while (transport := self.next()) is not None:
            try:
                return transport.queue[0]
            except IndexError:
                continue
        return None

    def look(self) -> Any:
        oldest = self.peek()
        return self.last_read if oldest is None else oldest

    def drain(self) -> list[Any]:
        return [sample for _, sample in self.drain_sources()]

    def drain_sources(self) -> list[tuple[Connector, Any]]:
        pairs: list[tuple[Connector, Any]] = []
        try:
            # Samples written meanwhile are for the next time: a fast writer must not keep the reader here.
            for _ in range(sum(len(transport.queue) for transport in self.extra.transports)):
                sample = self.port._last = self.read()
                pairs.append((self.source, sample))  # type: ignore[arg-type] # it was read
        except WouldBlock:
            pass
        return pairs

    def fit(self, transport: Transport) -> None:
        transport.replace(LOCK_FREE, self)

    def connector_ended(self) -> None:
        if not self.has_threads:
            let_go(self.port)  # no thread is left at this port

    def guard(self) -> Any:
        return UNLOCKED

    def unread(self) -> bool:
        return any(transport.queue for transport in self.extra.transports)

    def next(self) -> Transport | None:
        first, least = None, 0
        for transport in self.extra.transports:
            if transport.queue:
                places = transport.extra.places
                try:
                    place = places[0]
                except IndexError:
                    place = 0
                if first is None or place < least:
                    first, least = transport, place
        return first

    def read(self) -> Any:
        self.check_thread()
        while (transport := self.next()) is not None:
            try:
                sample = transport.take()
            except IndexError:
                continue  # overwritten or disconnected in this moment
            self.source = transport.connector
            return sample
        raise self.empty()

    def read_newest(self) -> Any:
        self.check_thread()
        taken: list[tuple[int, Any, LockFreeTransport, int]] = []
        for transport in self.extra.transports:
            if transport.queue:
                transport.extra.reading = True
                sample, number = transport.take_all()
                taken.append((transport.arrived_at if number else -1, sample, transport, number))
        newest = max(taken, key=lambda one: one[0], default=None)
        for one in taken:
            one[2].superseded(one[3] - (one is newest))
        if newest is None or newest[0] < 0:
            return NOTHING
        self.source = newest[2].connector
        return newest[2].stamp_out(newest[1])

    def arrived(self, transport: Transport, displaced: int) -> None:
        if self.extra.threads:
            self.room_made()
        if self.notify_enabled and (self.waiter is not None or not transport.pulls):
            self.notify_across()

    def room_made(self) -> None:
        """Let the loop wake threads that sleep at this port: a real-time thread may not take their lock."""
        shared = self.extra
        if not shared.requested:
            shared.requested = True
            self.on_loop(lambda: self._wake_threads(shared))

    def _wake_threads(self, shared: Numbers) -> None:
        shared.requested = False
        self.wake_threads()

    def make_locked(self) -> None:
        self.extra.threads = True

    def settle_tokens(self) -> None:
        """Do nothing: there are no tokens, each transport knows the places of its samples."""

    def set_open(self, is_open: bool) -> None:
        if not is_open:
            self.open = False
        for transport in self.extra.transports:
            transport.suspend()
            if transport.waiting:
                transport.extra.wanted = True
                transport.room_made()
        if is_open:
            self.forget()
            self.open = True

    def refresh(self) -> None:
        self.sole = None
        self.extra.transports = self.transports
        self.update_fast_path()


LOCK_FREE = TransportKind(LockFreeReceiver, LockFreeTransport, LockFreePeriodic, featured=False)
"""The kind of transport at ports of a real-time thread."""


def make_all_lock_free(port: Port[Any]) -> None:
    """Make the in-ports at a port lock-free: its component is about to run in a real-time thread."""
    for in_port in in_ports_at(port):
        make_lock_free(in_port)


def let_go_all(port: Port[Any]) -> None:
    """Make the in-ports at a port ordinary if no thread is left: its component has left its real-time thread."""
    for in_port in in_ports_at(port):
        receiver_of(in_port).connector_ended()


def make_lock_free(port: InPort[Any]) -> None:
    """Make an in-port lock-free: no path at it has a lock. A thread that is inside with its lock leaves first."""
    receiver = receiver_of(port)
    if isinstance(receiver, LockFreeReceiver):
        return
    with receiver.guard():
        receiver.mute()
        receiver = receiver_of(port).replace(LOCK_FREE, all_transports=True)
        receiver.refresh()
    receiver.refresh_writers()


def let_go(port: InPort[Any]) -> None:
    """Make an in-port ordinary: all that is left at it runs on the loop."""
    receiver_of(port).replace(PLAIN, all_transports=True).refresh_all()
    for connector in port.connectors:
        transport_of(connector).unmute()
