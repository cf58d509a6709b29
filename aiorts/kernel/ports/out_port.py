"""The writing end of a stream.

`write` and `write_nowait` write the common case out in full: one connector, one reader, open, room. A Python call
costs 25-40 ns, so a chain port -> connector -> buffer does not fit the budget. `_deliver` does the same for a full
buffer and for any number of connectors. `_update_fast_path` decides at the first write after a change which connectors
take which path; later writes decide nothing.
"""

from __future__ import annotations

from functools import partial
from threading import get_ident
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias, TypeVar

from anyio import WouldBlock

from aiorts.errors import ClosedError, DeclarationError, PortTypeError, RecordError, StateError, WriteTimeout
from aiorts.kernel.ports.last_sample import Beginning, Ending, NoReader
from aiorts.kernel.ports.port import NOTHING, OFF, UNSUSPENDED, Port, give_turn
from aiorts.kernel.ports.thread_writes import ThreadWrites, thread_writes_of
from aiorts.model.profile import NO_THREAD_WRITES

if TYPE_CHECKING:
    import asyncio
    from collections import deque
    from collections.abc import Callable, Sequence

    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import PortHost
    from aiorts.kernel.ports.receiver import Receiver
    from aiorts.kernel.ports.transport import LossListener, Transport, Waiting
    from aiorts.model.profile import ThreadWriteStatistics

T = TypeVar("T")


class OutPort(Port[T]):
    """The writing end of a stream.

    Args:
        type, unit, shape, doc, name, max_connectors: see `Port`.
        stamp: "write" puts the kernel's clock into `tm` of a copy; by default `tm` is the writer's.

    Raises:
        DeclarationError: `stamp` is neither "write" nor None.
    """

    __slots__ = (
        "_answering",
        "_blocking",
        "_class",
        "_fan",
        "_look",
        "_merged",
        "_others",
        "_receiver",
        "_room",
        "_saved",
        "_sent",
        "_shapes",
        "_shared",
        "_stale",
        "_thread",
        "_thread_writes",
        "_unlocked",
        "stamp",
    )

    direction: ClassVar[str] = "out"
    is_tap: ClassVar[bool] = False
    """Whether a service, not a component, writes at this port."""

    def __init__(
        self,
        type: type[T],  # noqa: A002
        *,
        unit: str | None = None,
        shape: tuple[int, ...] | None = None,
        doc: str = "",
        name: str | None = None,
        max_connectors: int | None = None,
        stamp: str | None = None,
    ) -> None:
        super().__init__(type, unit=unit, shape=shape, doc=doc, name=name, max_connectors=max_connectors)
        if stamp not in (None, "write"):
            raise DeclarationError(f'{name or "out-port"}: stamp is "write" or None, got {stamp!r}')
        self.stamp = stamp
        self._class: Any = _NoClass
        """The class of the samples that need no check; `_NoClass` while all need one."""
        self._look: Callable[[Any], Any] | None = None
        """The only check that samples of exactly the port's class need; None: they need no check, or the full one."""
        self._receiver: Receiver | None = None
        self._room = 0
        self._saved: Any = NOTHING
        """The sample written last, if no connector holds it (`last_sample.py`)."""
        self._sent = 0
        """The number of samples written to all direct connectors alike; each of them adds it to its own count."""
        self._stale = True
        """Whether the connectors or their options changed since the paths were chosen."""
        self._shared: tuple[Transport, ...] = ()
        """The direct transports, for which `_sent` counts."""
        self._fan: tuple[tuple[deque[Any], int, bool | LossListener, Receiver], ...] = ()
        """The direct transports whose reader has no other connector: each is its receiver's `sole`."""
        self._merged: tuple[_Way, ...] = ()
        """The direct transports whose reader has several connectors, and keeps the order of arrival."""
        self._others: tuple[Transport, ...] = ()
        """The transports that are not direct: they have to choose samples, stamp them or take a lock."""
        self._answering: Transport | None = None
        """The port's only transport, if it answers writes (`Transport.answers`); else None."""
        self._blocking: tuple[_Way, ...] = ()
        """The direct transports with full = block."""
        self._shapes: tuple[tuple[Port[Any], tuple[int, ...]], ...] = ()
        """Shapes that a sample must have, each with the port that declares it: this one or a reader."""
        self._unlocked: tuple[Transport, ...] = ()
        """The transports to receivers without a lock, whose readers can be woken only on the loop."""
        self._thread = 0
        """The number of the loop's thread if `_unlocked` is not empty, else 0."""
        self._thread_writes: ThreadWrites | None = None
        """The writes of foreign threads; None before the first."""

    def bind(self, host: PortHost, name: str) -> OutPort[T]:
        """Make a live port of `host` from this declaration.

        Raises:
            DeclarationError: the type cannot travel, or has no `tm` to stamp.
        """
        port = OutPort(
            self.type,
            unit=self.unit,
            shape=self.shape,
            doc=self.doc,
            max_connectors=self.max_connectors,
            stamp=self.stamp,
        )
        port._attach(host, name)
        if port.stamp is not None and not port._type.has_tm:
            raise DeclarationError(
                f"{port.path}: stamp = {port.stamp}: {port.type.__name__} has no field tm to put it in"
            )
        port._refresh()
        return port

    @property
    def connectors(self) -> tuple[Connector, ...]:
        """The live connectors of this port, in order of connection, without taps of services."""
        found = self._connectors
        while found and found[-1].in_.is_tap:
            found = found[:-1]
        return found

    def write_nowait(self, sample: T) -> bool:
        """Send `sample` to every reader, without waiting.

        Returns:
            False when a connector with full = reject had no room (its statistics say which one), else True.

        Raises:
            WouldBlock: a reader with full = block has no room, or no read waits at one with length = 0; no reader got
                the sample.
            PortTypeError: the sample is not of the port's type or shape; nothing was sent.
            RecordError: a field of a dataclass does not match its declaration; nothing was sent.
            ThreadError: called in a foreign thread, which cannot wake a reader that sleeps; nothing was sent.
        """
        if sample.__class__ is self._class:
            queue = self._fast
            if len(queue) < self._room:
                if self._receiver.notify_enabled:  # type: ignore[union-attr] # set where there is room
                    if get_ident() != self._receiver.thread:  # type: ignore[union-attr]
                        raise self._receiver.cannot_wake()  # type: ignore[union-attr]
                    queue.append(sample)
                    self._sent += 1
                    self._receiver.wake()  # type: ignore[union-attr]
                    return True
                queue.append(sample)
                self._sent += 1
                return True
            return self._write_checked(sample)
        return self._write_general(sample)

    async def write(self, sample: T) -> bool:
        """Send `sample` to every reader, waiting for those with full = block.

        Readers with room have the sample at once; the write waits for the others together, each to its timeout. A
        cancelled write wrote nothing to the connectors for which it was still waiting.

        Returns:
            False when a connector with full = reject had no room, else True.

        Raises:
            WriteTimeout: names the connectors that had no room in time.
            PortTypeError: the sample is not of the port's type or shape; nothing was sent.
        """
        turns = self._turns
        if turns.left:
            turns.left -= 1
        else:
            turns.left = UNSUSPENDED
            await give_turn()
        if sample.__class__ is self._class:
            queue = self._fast
            if len(queue) < self._room:
                if self._receiver.notify_enabled:  # type: ignore[union-attr] # set where there is room
                    if get_ident() != self._receiver.thread:  # type: ignore[union-attr]
                        raise self._receiver.cannot_wake()  # type: ignore[union-attr]
                    queue.append(sample)
                    self._sent += 1
                    self._receiver.wake()  # type: ignore[union-attr]
                    return True
                queue.append(sample)
                self._sent += 1
                return True
        if self._stale:
            self._update_fast_path()
        if sample.__class__ is not self._class:
            sample = self._checked(sample)
        if get_ident() != self._thread and self._unlocked:
            self._check_can_wake()
        if self._answering is not None and (entry := self._answering.send_now(sample)) is not None:
            return await self._wait_for_answer(entry)
        if (self._blocking or self._others) and self._without_room() is not None:
            return await self._write_waiting(sample)
        return self._deliver(sample)

    def write_blocking(self, sample: T, timeout: float | None = None) -> bool:
        """`write` for the thread of a `ThreadContext`: blocks the thread, at most `timeout` seconds or each
        connector's own.

        Raises:
            WriteTimeout: names the connectors that had no room in time.
            PortTypeError: the sample is not of the port's type or shape; nothing was sent.
            StateError: called on the loop, or the component is in no `ThreadContext`.
            ClosedError: the port was removed or its context is stopping.
        """
        host = self._bound()
        if host.on_loop_thread():
            raise StateError(f"{self.path}: write_blocking would block the event loop; await write() here")
        if not host.threaded:
            raise StateError(f"{self.path}: write_blocking is for components of a ThreadContext")
        if self._stale:
            self._update_fast_path()
        sample = self._checked(sample)
        host.writing = True
        done, entries = self._offer(sample, None)
        host.writing = False
        waits = []
        for entry in entries:
            limit = entry.connector.profile.timeout if timeout is None else timeout
            waits.append((entry, limit, host.deadline_ns(limit)))
        late = []
        try:
            for entry, limit, until_ns in waits:
                if not self._wait_in_thread(entry, until_ns) and time_out(entry):
                    late.append((entry.connector, limit))
        finally:
            for entry in entries:
                if not entry.done:
                    _give_up_all(entries, bool(late))
        _raise_late(self.path, late)
        return done and not any(entry.refused for entry in entries)

    def write_from_thread(self, sample: T, full: Literal["reject", "block"] = "reject") -> bool:
        """Write from any thread, such as the callback thread of a device's SDK: the loop passes the sample on soon.

        The sample is checked, copied and stamped in the calling thread. At most 1,024 samples wait for the loop, which
        takes at most 256 in one turn. The samples of one thread stay in their order; a write on the loop overtakes
        those that wait. While a reader with full = block has no room, the other samples wait, each to the connector's
        timeout. `thread_writes` has the counts.

        Args:
            full: with 1,024 waiting, "reject" refuses this sample, "block" blocks the thread until there is room.

        Returns:
            False when the sample was refused, else True.

        Raises:
            ThreadError: `full` is "block" on the loop's own thread, which would wait for itself.
            ClosedError: the kernel is closing, or the component or port is being removed; also while it blocks.
            PortTypeError: the sample is not of the port's type or shape; nothing was sent.
            RecordError: a field of a dataclass does not match its declaration; nothing was sent.
            ConfigurationError: `full` is another word.
            StateError: the component runs in a `ThreadContext` or `RealtimeContext`, whose thread alone writes there.
        """
        return thread_writes_of(self).write(sample, full)

    @property
    def thread_writes(self) -> ThreadWriteStatistics:
        """The counts of `write_from_thread` at this moment.

        Raises:
            ThreadError: read in another thread than the loop's.
        """
        return NO_THREAD_WRITES if self._thread_writes is None else self._thread_writes.statistics()

    # -- the general path ------------------------------------------------------------------------------------------

    def _write_general(self, sample: T) -> bool:
        if self._stale:
            self._update_fast_path()
        if sample.__class__ is not self._class:
            sample = self._checked(sample)
        return self._write_checked(sample)

    def _write_checked(self, sample: T) -> bool:
        """Send a sample that needs no further check, by the chosen paths."""
        if get_ident() != self._thread and self._unlocked:
            self._check_can_wake()
        if (self._blocking or self._others) and self._without_room() is not None:
            self._raise_unless_awaited()
        return self._deliver(sample)

    def _check_can_wake(self) -> None:
        """Called outside the loop's thread: raise ThreadError if a write would have to wake a reader of the loop."""
        for transport in self._unlocked:
            if transport.wakes:
                raise transport.receiver.cannot_wake()

    def _without_room(self) -> Connector | None:
        """A connector at which a write would have to wait for room; None: there is none."""
        for queue, room, _, _, transport in self._blocking:
            if len(queue) >= room:
                return transport.connector
        for transport in self._others:
            if transport.must_wait():
                return transport.connector
        return None

    def _raise_unless_awaited(self) -> None:
        """Raise WouldBlock, unless each reader without room awaits the sample."""
        for connector in self._connectors:
            transport = connector._transport
            if transport.must_wait() and not transport.is_awaited:
                length = connector.profile.length
                why = f"has no room ({length} unread)" if length else "does not await a sample (length = 0)"
                what = "room" if length else "that"
                raise WouldBlock(
                    f"{self.path}: {connector.in_.path} {why}, and no reader got this sample; "
                    f"await write(), or write_blocking() in a thread, waits for {what}"
                )

    def _deliver(self, sample: T) -> bool:
        """Write to every connector; all have room. Every queue has the sample before the first reader is woken."""
        done = True
        notified: list[Receiver] = []
        for queue, room, keeps, receiver in self._fan:
            if len(queue) < room:
                queue.append(sample)
            else:
                transport = receiver.sole
                transport.displaced += 1  # type: ignore[union-attr] # the only one there
                if keeps:
                    if keeps is True:
                        transport.miss(sample, 1)  # type: ignore[union-attr]
                        done = False
                        continue
                    keeps.begin(transport.connector)  # type: ignore[union-attr]
                queue.popleft()
                queue.append(sample)
            if receiver.notify_enabled:
                notified.append(receiver)
        for queue, room, keeps, receiver, transport in self._merged:
            if len(queue) < room:
                queue.append(sample)
                receiver.tokens.append(transport)  # type: ignore[union-attr] # it has several connectors
            else:
                transport.displaced += 1
                if keeps:
                    if keeps is True:
                        transport.miss(sample, 1)
                        done = False
                        continue
                    keeps.begin(transport.connector)
                queue.popleft()
                queue.append(sample)
                receiver.tokens.append(transport)  # type: ignore[union-attr] # as above
                transport.dead += 1
                if transport.dead > room:
                    receiver.bury(transport)
            receiver.arrivals += 1
            transport.arrived_at = receiver.arrivals
            if receiver.notify_enabled:
                notified.append(receiver)
        self._sent += 1
        for receiver in notified:
            if receiver.notify_enabled:
                receiver.wake()
        for transport in self._others:
            done &= transport.offer(sample)
        return done

    async def _write_waiting(self, sample: T) -> bool:
        host = self._host
        assert host is not None  # noqa: S101 - it has connectors
        if host.realtime:  # its thread never waits
            return self._write_general(sample)
        if not self._blocking or len(self._connectors) > 1:
            done, entries = self._offer(sample, host.loop)
            if entries:
                await self._wait_for(entries)
            return done and not any(entry.refused for entry in entries)
        entry = self._blocking[0][4].queue_up(sample, host.loop.create_future())
        if entry.connector.profile.timeout is not None:
            await self._wait_for([entry])
            return True
        try:
            await entry.future  # type: ignore[misc] # made by the loop
        finally:
            if not entry.done:  # else the reader has moved it in: nothing is left to give up
                _give_up(entry, False)
        return True

    async def _wait_for_answer(self, entry: Waiting) -> bool:
        """Wait until the reader has the sample, or has refused it; its transport keeps the timeout."""
        assert entry.future is not None  # noqa: S101 - `send_now` has made it
        try:
            await entry.future
        finally:
            if not (entry.done or entry.late):
                _give_up(entry, False)
        if entry.late:
            _raise_late(self.path, [(entry.connector, entry.connector.profile.timeout)])
        return not entry.refused

    def _offer(self, sample: T, loop: asyncio.AbstractEventLoop | None) -> tuple[bool, list[Waiting]]:
        """Write to connectors with room, and queue up at the others; `loop` is None where a thread waits.

        Returns:
            Whether no connector rejected the sample, and the entries that wait.
        """
        done = True
        entries: list[Waiting] = []
        for connector in self._connectors:
            transport = connector._transport
            if transport.must_wait():
                entry = transport.wait_for_room(sample, None if loop is None else loop.create_future())
                if entry is not None:
                    entries.append(entry)
            else:
                done &= transport.offer(sample)
        return done, entries if len(entries) == len(self._connectors) else _Others(entries)

    async def _wait_for(self, entries: list[Waiting]) -> None:
        """Wait until each entry's sample was moved in or its time is over; afterwards none of the entries waits."""
        host = self._bound()
        late: list[tuple[Connector, float | None]] = []

        def expire(entry: Waiting, limit: float) -> None:
            if time_out(entry):
                late.append((entry.connector, limit))
            if entry.future is not None and not entry.future.done():
                entry.future.set_result(None)

        timers = [
            host.call_later(entry.connector.profile.timeout, partial(expire, entry, entry.connector.profile.timeout))
            for entry in entries
            if entry.connector.profile.timeout is not None
        ]
        try:
            for entry in entries:
                if entry.future is not None:
                    await entry.future
        finally:
            for timer in timers:
                timer.cancel()
            for entry in entries:
                if not entry.done:
                    _give_up_all(entries, bool(late))
        _raise_late(self.path, late)

    def _wait_in_thread(self, entry: Waiting, until_ns: int | None) -> bool:
        """Block this thread until the sample of `entry` was moved in; False: `until_ns` came first.

        Raises:
            ClosedError: the thread's context stops.
        """
        host, lock = self._bound(), entry.connector.in_._receiver.lock
        assert lock is not None  # noqa: S101 - a connector of a threaded component has one
        in_time = host.wait_in_thread(lock, lambda: entry.connector._transport.moved(entry) or host.stopping, until_ns)
        if in_time and not entry.done:
            raise ClosedError(f"{self.path}: its context stops")
        return in_time

    def _checked(self, sample: T, host: PortHost | None = None) -> T:
        """The sample as it will travel: of the port's type and shape, stamped, immutable.

        A foreign thread gives `host`: then the check reads nothing that the loop may change meanwhile.
        """
        look = self._look
        try:
            if look is not None and host is None and sample.__class__ is self.type:
                looked_at: T = look(sample)
                return looked_at
            return self._checked_in_full(sample, host)
        except RecordError as error:
            raise type(error)(f"{self.path}: {error}; nothing was sent") from None

    def _checked_in_full(self, sample: T, foreign: PortHost | None) -> T:
        host = foreign or self._bound()
        self._raise_if_removed()
        port_type = self._type
        if not isinstance(sample, self.type):
            from aiorts.types import type_name

            raise PortTypeError(
                f"{self.path}: expected a {type_name(self.type)}, got {sample.__class__.__name__} ({_short(sample)}); "
                "nothing was sent"
            )
        for port, shape in self._shapes if foreign is None else self._shapes_now():
            try:
                port_type.check_shape(sample, shape)
            except RecordError as error:
                reason = "" if port is self else f" (the shape of {port.path})"
                raise PortTypeError(f"{self.path}: {error}{reason}; nothing was sent") from error
        if host.debug:
            sample = port_type.copy(sample)
        elif port_type.look is not None or sample.__class__ is not self.type:
            sample = port_type.snapshot(sample)
        if self.stamp is None:
            return sample
        stamped: T = port_type.stamped(sample, host.time_ns())
        return stamped

    def _refresh(self) -> None:
        """Note that the connectors or their options have changed."""
        # The paths are chosen at the next write, not here: else each change would walk all connectors.
        self._stale = True
        self._class, self._look, self._fast, self._room = _NoClass, None, OFF, 0

    def _update_fast_path(self) -> None:
        """Decide which transports a write reaches directly, and whether the fast path is on."""
        self._stale = False  # first: a change by another thread from here on sets it again
        self._class, self._look, self._fast, self._room = _NoClass, None, OFF, 0
        host, connectors = self._host, self._connectors
        if host is None:
            return
        if host.kernel is not None:
            host.kernel.connections.gaps.writes(self)
        transports = tuple(connector._transport for connector in connectors)
        direct = frozenset(() if host.debug else (transport for transport in transports if transport.direct))
        # Connectors to one reader are all direct or none is: so their samples keep the order of arrival.
        slow = {transport.receiver for transport in transports if transport not in direct}
        direct = frozenset(transport for transport in direct if transport.receiver not in slow)
        for transport in self._shared:
            transport.share(transport in direct, self._sent)
        for transport in direct:
            transport.share(True, self._sent)
        self._shared = tuple(direct)
        ways = [(t.queue, t.room, t.when_full, t.receiver, t) for t in transports if t in direct]
        self._fan = tuple(way[:4] for way in ways if way[3].tokens is None)
        self._merged = tuple(way for way in ways if way[3].tokens is not None)
        self._others = tuple(transport for transport in transports if transport not in direct)
        self._unlocked = tuple(transport for transport in transports if transport.receiver.lock is None)
        self._thread = self._unlocked[0].receiver.thread if self._unlocked else 0
        first: Any
        last: Any
        if not connectors:
            first = NoReader(self)
            self._others = (first,)
        elif host.locked:
            first, last = Beginning(self, host), Ending(host)
            self._others = (first, *self._others, last)
        self._answering = transports[0] if len(transports) == 1 and transports[0].answers else None
        self._blocking = tuple(way for way in ways if way[4].blocks)
        self._shapes = self._shapes_now()
        if not connectors or self.stamp is not None or self._shapes or host.debug:
            return
        if self._type.look is not None:
            self._look = self._type.look
            return
        self._class = self.type
        if len(connectors) == 1 and self._fan:
            self._fast, self._room, _, self._receiver = self._fan[0]

    def _shapes_now(self) -> tuple[tuple[Port[Any], tuple[int, ...]], ...]:
        readers = (connector.in_ for connector in self._connectors if connector.profile.convert is None)
        ports: tuple[Port[Any], ...] = (self, *readers)
        return tuple((port, port.shape) for port in ports if port.shape is not None)

    def _vacate(self, leaving: bool = True) -> None:
        if self._thread_writes is not None:
            self._thread_writes.set_open(not leaving)

    def _wake_waiter(self) -> None:
        if self._thread_writes is not None and self._removed():
            self._thread_writes.set_open(False)


def write_alone(port: OutPort[Any], sample: Any) -> bool:
    """Write a sample straight into one queue, in the loop's thread; False: not sent, `write_nowait` is needed."""
    queue = port._fast
    if sample.__class__ is not port._class or len(queue) >= port._room:
        return False
    queue.append(sample)
    port._sent += 1
    receiver = port._receiver
    if receiver is not None and receiver.notify_enabled:
        receiver.wake()
    return True


def write_all(port: OutPort[Any], samples: Sequence[Any]) -> int:
    """Write the first of these samples, as many as go straight into one queue; return how many.

    Only the first sample notifies the reader. If every sample has to notify, at most one is written.
    """
    if port._stale:
        port._update_fast_path()
    queue, receiver = port._fast, port._receiver
    count = min(len(samples), port._room - len(queue))
    if count <= 0 or receiver is None or {*map(type, samples)} != {port._class}:
        return 0
    if not receiver.notify_enabled:
        queue.extend(samples if count == len(samples) else samples[:count])
        port._sent += count
        return count
    port.write_nowait(samples[0])
    if receiver.notify_enabled or port._fast is not queue:
        return 1
    queue.extend(samples[1:count])
    port._sent += count - 1
    return count


class _Others(list["Waiting"]):
    """The entries of a write that waits at some connectors, while other connectors have its sample already."""


def _give_up_all(entries: list[Waiting], late: bool) -> None:
    """End the waiting of all these entries; `late`: an entry of their write has timed out."""
    written = late or isinstance(entries, _Others) or any(entry.done for entry in entries)
    for entry in entries:
        if not entry.done:
            _give_up(entry, written)


def _give_up(entry: Waiting, written: bool) -> bool:
    """End the waiting of an entry; `written`: other connectors have the sample, or the write timed out.

    Returns:
        False when the sample was moved in meanwhile.
    """
    transport = entry.connector._transport
    with transport.guard():
        missed = transport.missed == transport.position
        newest = transport.waiting and next(reversed(transport.waiting)) is entry
        if not transport.give_up(entry):
            return False
        if missed:
            transport.missed = transport.position
        elif newest and written:
            transport.miss(entry.sample)
        return True


def time_out(entry: Waiting) -> bool:
    """End the waiting of a write whose time is over; False when its sample was moved in the meantime."""
    transport = entry.connector._transport
    with transport.guard():
        if not _give_up(entry, True):
            return False
        missed = transport.missed == transport.position
        transport.time_out(entry)
        if missed:
            transport.missed = transport.position
        return True


class _NoClass:
    """A class that no sample has."""


_Way: TypeAlias = "tuple[deque[Any], int, bool | LossListener, Receiver, Transport]"
"""A direct transport, as a write needs it: its queue, `room`, `when_full`, the receiver to wake, and the transport,
which counts."""


def _raise_late(path: str, late: list[tuple[Connector, float | None]]) -> None:
    if late:
        names = ", ".join(f"{connector.in_.path} ({limit:g} s)" for connector, limit in late)
        raise WriteTimeout(f"{path}: no room in time at {names}; the other readers have the sample")


def _short(sample: object) -> str:
    text = repr(sample)
    return text if len(text) <= 60 else text[:57] + "..."
