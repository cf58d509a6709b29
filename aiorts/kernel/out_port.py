"""The writing end of a stream.

`write` and `write_nowait` write the common case out in full: one connector, one reader, open, room. A Python call
costs 25-40 ns, so a chain port -> connector -> buffer does not fit the budget. `_deliver` does the same for a full
buffer and for any number of connectors. `_choose_path` decides at the first write after a change what goes which way;
nothing on these paths asks again.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar

from anyio import WouldBlock

from aiorts.errors import ClosedError, DeclarationError, PortTypeError, RecordError, StateError, WriteTimeout
from aiorts.kernel.port import OFF, UNSUSPENDED, Port, give_turn

if TYPE_CHECKING:
    import asyncio
    from collections import deque

    from aiorts.kernel.connector import Connector
    from aiorts.kernel.host import PortHost
    from aiorts.kernel.in_port import InPort
    from aiorts.kernel.waiting import Waiting

__all__ = ("OutPort",)

T = TypeVar("T")


class OutPort(Port[T]):
    """The writing end of a stream.

    Args:
        type, unit, shape, doc, name, max_connectors: see `Port`.
        stamp: "write" puts the kernel's clock into `tm` of a copy; by default `tm` is what the writer said.
    """

    __slots__ = (
        "_blocking",
        "_class",
        "_fan",
        "_merged",
        "_others",
        "_reader",
        "_room",
        "_sent",
        "_shapes",
        "_stale",
        "stamp",
    )

    direction: ClassVar[str] = "out"

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
        """The class of the samples that need no check; none while there must be one."""
        self._reader: InPort[Any] | None = None
        self._room = 0
        self._sent = 0
        """Samples written to all direct connectors at once; each of them counts them as its own."""
        self._stale = True
        """Whether the connectors changed since the path was chosen."""
        self._fan: tuple[_Way, ...] = ()
        """The direct connectors whose reader has no other."""
        self._merged: tuple[_Way, ...] = ()
        """The direct connectors whose reader has several, and keeps the order of arrival."""
        self._others: tuple[Connector, ...] = ()
        """The connectors that have to choose, stamp or lock."""
        self._blocking: tuple[_Way, ...] = ()
        """The direct connectors with full = block."""
        self._shapes: tuple[tuple[Port[Any], tuple[int, ...]], ...] = ()
        """Shapes that a sample must have, and which port says so: this one or a reader."""

    def bind(self, host: PortHost, name: str) -> OutPort[T]:
        """A live port of `host` made after this declaration."""
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

    def write_nowait(self, sample: T) -> bool:
        """Send `sample` to every reader, without waiting.

        Returns:
            False when a connector with full = reject had no room (its statistics say which one), else True.

        Raises:
            WouldBlock: a reader with full = block has no room; nobody got the sample.
            PortTypeError: the sample is not of the port's type or shape; nothing was sent.
        """
        if sample.__class__ is self._class:
            queue = self._fast
            if len(queue) < self._room:
                queue.append(sample)
                self._sent += 1
                if self._reader._armed:  # type: ignore[union-attr] # set where there is room
                    self._reader._notify()  # type: ignore[union-attr]
                return True
        return self._write_general(sample)

    async def write(self, sample: T) -> bool:
        """Send `sample` to every reader, waiting for those with full = block.

        Readers with room have the sample at once; the others are waited for together, each to its timeout. A
        cancelled write wrote nothing to the connectors it was still waiting for.

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
                queue.append(sample)
                self._sent += 1
                if self._reader._armed:  # type: ignore[union-attr] # set where there is room
                    self._reader._notify()  # type: ignore[union-attr]
                return True
        if self._stale:
            self._choose_path()
        if sample.__class__ is not self._class:
            sample = self._checked(sample)
        if (self._blocking or self._others) and self._without_room() is not None:
            return await self._write_waiting(sample)
        return self._deliver(sample)

    def write_blocking(self, sample: T, timeout: float | None = None) -> bool:
        """`write` for the thread of a `ThreadContext`: blocks the thread, at most `timeout` seconds or each
        connector's own.

        Raises:
            WriteTimeout: names the connectors that had no room in time.
        """
        host = self._bound()
        if host.on_loop_thread():
            raise StateError(f"{self.path}: write_blocking would block the event loop; await write() here")
        if not host.threaded:
            raise StateError(f"{self.path}: write_blocking is for components of a ThreadContext")
        done, entries = self._offer(self._checked(sample), None)
        waits = []
        for entry in entries:
            limit = entry.connector.profile.timeout if timeout is None else timeout
            waits.append((entry, limit, host.deadline_ns(limit)))
        late = []
        try:
            for entry, limit, until_ns in waits:
                if not self._wait_in_thread(entry, until_ns) and entry.connector.give_up(entry):
                    entry.connector.refuse("timeout")
                    late.append((entry.connector, limit))
        finally:
            for entry in entries:
                entry.connector.give_up(entry)
        _raise_late(self.path, late)
        return done

    # -- the general path ------------------------------------------------------------------------------------------

    def _write_general(self, sample: T) -> bool:
        if self._stale:
            self._choose_path()
        if sample.__class__ is not self._class:
            sample = self._checked(sample)
        if (self._blocking or self._others) and (full := self._without_room()) is not None:
            raise WouldBlock(f"{self.path}: {full.in_.path} has no room ({full.profile.length} unread)")
        return self._deliver(sample)

    def _without_room(self) -> Connector | None:
        """A connector that a write would have to wait for."""
        for queue, room, _, _, connector in self._blocking:
            if len(queue) >= room:
                return connector
        for connector in self._others:
            if connector.must_wait():
                return connector
        return None

    def _deliver(self, sample: T) -> bool:
        """To every connector; none has to be waited for. All have the sample before anybody is woken."""
        done = True
        rung: list[InPort[Any]] = []
        for queue, room, keeps, reader, connector in self._fan:
            if len(queue) < room:
                queue.append(sample)
            else:
                connector._displaced += 1
                if keeps:
                    done = False
                    continue
                queue.popleft()
                queue.append(sample)
            if reader._armed:
                rung.append(reader)
        for queue, room, keeps, reader, connector in self._merged:
            if len(queue) < room:
                queue.append(sample)
                reader._tokens.append(connector)  # type: ignore[union-attr] # it has several connectors
            else:
                connector._displaced += 1
                if keeps:
                    done = False
                    continue
                queue.popleft()
                queue.append(sample)
            reader._arrivals += 1
            connector._arrived_at = reader._arrivals
            if reader._armed:
                rung.append(reader)
        self._sent += 1
        for reader in rung:
            if reader._armed:
                reader._notify()
        for connector in self._others:
            done &= connector.offer(sample)
        return done

    async def _write_waiting(self, sample: T) -> bool:
        host = self._bound()
        if host.realtime:  # its thread waits for nobody
            return self._write_general(sample)
        if self._blocking and len(self._connectors) == 1:
            done, entries = True, [self._connectors[0].queue_up(sample, host.loop.create_future())]
        else:
            done, entries = self._offer(sample, host.loop)
        if len(entries) == 1 and entries[0].connector.profile.timeout is None:
            entry = entries[0]
            try:
                await entry.future  # type: ignore[misc] # made by the loop
            finally:
                entry.connector.give_up(entry)
        elif entries:
            await self._wait_for(entries)
        return done

    def _offer(self, sample: T, loop: asyncio.AbstractEventLoop | None) -> tuple[bool, list[Waiting]]:
        """Deliver where there is room and queue up where there is none; without a loop a thread is to wait."""
        done = True
        entries = []
        for connector in self._connectors:
            if connector.must_wait():
                entry = connector.wait_for_room(sample, None if loop is None else loop.create_future())
                if entry is not None:
                    entries.append(entry)
            else:
                done &= connector.offer(sample)
        return done, entries

    async def _wait_for(self, entries: list[Waiting]) -> None:
        """Wait until each entry was moved or its time is over; whatever happens, no entry is left behind."""
        host = self._bound()
        late: list[tuple[Connector, float | None]] = []

        def expire(entry: Waiting, limit: float) -> None:
            if entry.connector.give_up(entry):
                entry.connector.refuse("timeout")
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
                entry.connector.give_up(entry)
        _raise_late(self.path, late)

    def _wait_in_thread(self, entry: Waiting, until_ns: int | None) -> bool:
        """Block this thread until `entry` was moved; False when its time is over.

        Raises:
            ClosedError: the thread's context stops.
        """
        host, lock = self._bound(), entry.connector.in_._lock
        assert lock is not None  # noqa: S101 - a connector of a threaded component has one
        in_time = host.wait_in_thread(lock, lambda: entry.connector.moved(entry) or host.stopping, until_ns)
        if in_time and not entry.done:
            raise ClosedError(f"{self.path}: its context stops")
        return in_time

    def _checked(self, sample: T) -> T:
        """The sample as it will travel: of the port's type and shape, stamped, immutable."""
        host = self._bound()
        self._raise_if_removed()
        port_type = self._type
        if not isinstance(sample, self.type):
            raise PortTypeError(
                f"{self.path}: expected a {self.type.__name__}, got {sample.__class__.__name__} ({_short(sample)}); "
                "nothing was sent"
            )
        for port, shape in self._shapes:
            try:
                port_type.check_shape(sample, shape)
            except RecordError as error:
                reason = "" if port is self else f" (the shape of {port.path})"
                raise PortTypeError(f"{self.path}: {error}{reason}; nothing was sent") from error
        if host.debug:
            sample = port_type.copy(sample)
        elif port_type.mutable or sample.__class__ is not self.type:
            sample = port_type.snapshot(sample)
        if self.stamp is None:
            return sample
        stamped: T = port_type.stamped(sample, host.time_ns())
        return stamped

    def _refresh(self) -> None:
        # Only noted: with many connectors each change would else cost as much as all of them.
        self._stale = True
        self._class, self._fast, self._room = _NoClass, OFF, 0

    def _choose_path(self) -> None:
        self._stale = False  # first: what another thread changes from here on marks it once more
        self._class, self._fast, self._room = _NoClass, OFF, 0
        host, connectors = self._host, self._connectors
        if host is None:
            return
        direct = frozenset(() if host.debug else (connector for connector in connectors if connector.direct))
        # Two connectors to one reader keep their order: both go the direct way or none does.
        slow = {connector.in_ for connector in connectors if connector not in direct}
        direct = frozenset(connector for connector in direct if connector.in_ not in slow)
        for *_, connector in (*self._fan, *self._merged):
            connector.share(connector in direct and connector.out is self, self._sent)
        for connector in direct:
            connector.share(True, self._sent)
        ways = [(c._queue, c.room, c.keeps, c.in_, c) for c in connectors if c in direct]
        self._fan = tuple(way for way in ways if way[3]._tokens is None)
        self._merged = tuple(way for way in ways if way[3]._tokens is not None)
        self._others = tuple(connector for connector in connectors if connector not in direct)
        self._blocking = tuple(way for way in ways if way[4].blocks)
        ports: tuple[Port[Any], ...] = (self, *(connector.in_ for connector in connectors))
        self._shapes = tuple((port, port.shape) for port in ports if port.shape is not None)
        if not connectors or self.stamp is not None or self._shapes or self._type.mutable or host.debug:
            return
        self._class = self.type
        if len(connectors) == 1 and self._fan:
            self._fast, self._room, _, self._reader, _ = self._fan[0]


class _NoClass:
    """The class of no sample."""


_Way: TypeAlias = "tuple[deque[Any], int, bool, InPort[Any], Connector]"
"""A direct connector: the queue, how many samples fit, whether it keeps them when full, who to wake, who counts."""


def _raise_late(path: str, late: list[tuple[Connector, float | None]]) -> None:
    if late:
        names = ", ".join(f"{connector.in_.path} ({limit:g} s)" for connector, limit in late)
        raise WriteTimeout(f"{path}: no room in time at {names}; the other readers have the sample")


def _short(sample: object) -> str:
    text = repr(sample)
    return text if len(text) <= 60 else text[:57] + "..."
