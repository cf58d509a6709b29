"""The receiver of an in-port: one bounded queue for each connector, read in the order of arrival.

With several connectors the receiver keeps a line of tokens, one for each unread sample: the token is the sample's
transport. So reading in order costs the same at any number of connectors. The token of an overwritten sample is dead: a
transport counts its dead tokens, its oldest ones, in `dead`, and a read passes over them. A new token goes to the end.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from operator import attrgetter
from threading import current_thread, get_ident
from typing import TYPE_CHECKING, Any, ClassVar, Final

from anyio import WouldBlock

from aiorts.errors import BusyError, ClosedError, ThreadError
from aiorts.kernel.loop.blocking import PortLock
from aiorts.kernel.ports.current import at_current
from aiorts.kernel.ports.last_sample import offer_last, to_be_offered
from aiorts.kernel.ports.port import NOTHING, OFF, UNLOCKED
from aiorts.model.policy import Dataflow

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.in_port import InPort
    from aiorts.kernel.ports.transport import Kind, Transport


_PULL: Final = Dataflow.PULL
_THE_READER: Final = (
    "the reader, which sleeps on the kernel's loop, and nothing was sent; write with port.write_from_thread(sample)"
)
_THE_WRITER: Final = "the writer, which waits on the kernel's loop for room, and nothing was read; read on that loop"


class EndingError(ClosedError):
    """Ends a hook that waits for a sample while its component is to end: the writers have ended, none will come."""


class Receiver:
    """The general path of an in-port: which sample is the next, which task waits for it, which callbacks are notified.

    The receiver class of each `Kind` derives from this class. `replace` puts a receiver of another kind in its place.
    """

    __slots__ = (
        "arrivals",
        "callback",
        "direct",
        "extra",
        "lock",
        "notify_enabled",
        "open",
        "plain",
        "port",
        "read_stamps",
        "sole",
        "sole_delivered",
        "source",
        "thread",
        "tokens",
        "waiter",
    )

    kind: ClassVar[Kind]
    """The row of the table of transports that names this class."""
    has_fast_path: ClassVar[bool] = True
    """Whether a port of this kind may read straight from a queue."""

    def __init__(self, port: InPort[Any]) -> None:
        self.port = port
        self.lock: PortLock | None = None
        self.open = True
        """Whether samples are taken: the component is active, or in no context."""
        self.direct: deque[Any] = OFF
        """The queue that the port reads directly, as its `_fast`, while no writer waits for room; else `OFF`."""
        self.plain = False
        """Whether reading needs no lock, no stamp and no check at any connector."""
        self.read_stamps = 0
        """The number of connectors that stamp a sample when it is read."""
        self.tokens: deque[Transport] | None = None
        self.arrivals = 0
        """The number of samples that came while there were several connectors."""
        self.source: Connector | None = None
        self.sole: Transport | None = None
        self.sole_delivered = 0
        self.thread = 0
        """The number of the loop's thread, in which tasks that wait at a port without a lock are woken."""
        self.waiter: asyncio.Future[None] | None = None
        self.callback: Callable[[InPort[Any]], object] | None = None
        """The only callback, or a `_Callbacks` for several. Most in-ports have one: a tuple would take 64 bytes."""
        self.notify_enabled = False
        """Whether the next sample wakes waiting readers and calls the callbacks."""
        self.extra: Any = None
        """Data that another kind of receiver keeps in addition."""

    @property
    def current(self) -> Receiver:
        """The receiver that the port has now."""
        return self.port._receiver

    def replace(self, kind: Kind, *, all_transports: bool) -> Receiver:
        """Put a receiver of another kind in this one's place, with all that it holds; `all_transports`: those, too.

        On the loop; the caller holds the lock, and calls `refresh_all` afterwards.
        """
        self.hand_over()
        new_class = kind.receiver_of(self.port._connectors)
        new = new_class.__new__(new_class)
        new.take_over(self)
        for transport in self.transports:
            if all_transports:
                transport.replace(kind, new)
            else:
                transport.receiver = new
        self.port._receiver = new
        return new

    def hand_over(self) -> None:
        """Bring what this holds into the form that every kind takes over."""

    def take_over(self, old: Receiver) -> None:
        """Take the state of the receiver `old`, which is used no more."""
        for name in Receiver.__slots__:
            setattr(self, name, getattr(old, name))
        self.extra = None

    def exchange(self, old: Transport, new: Transport) -> None:
        """Put the transport `new` in the place of `old`."""
        if self.sole is old:
            self.sole = new
        if self.tokens is not None:
            self.tokens = deque(new if token is old else token for token in self.tokens)

    @property
    def transports(self) -> tuple[Transport, ...]:
        """The transports of the port's connectors, in order of connection."""
        return tuple(connector._transport for connector in self.port._connectors)

    # -- reading ---------------------------------------------------------------------------------------------------

    def check_thread(self) -> None:
        """Raise ClosedError if the port is a declaration; in debug mode, ThreadError outside the component's thread."""
        host = self.port._host
        if host is None or host.debug:
            self.port._bound()

    def empty(self) -> WouldBlock:
        """The WouldBlock to raise when there is no sample. ClosedError: the port was removed."""
        self.port._raise_if_removed()
        return WouldBlock(f"{self.port.path}: no unread sample")

    def guard(self) -> Any:
        """The lock, where there is one."""
        return self.lock or UNLOCKED

    def unread(self) -> bool:
        """Whether there is an unread sample."""
        tokens = self.tokens
        if tokens is not None:
            return bool(tokens)
        sole = self.sole
        return sole is not None and bool(sole.queue)

    def next(self) -> Transport | None:
        """The transport that has the oldest unread sample, or None; the caller holds the lock."""
        tokens = self.tokens
        if tokens is not None:
            while tokens and tokens[0].dead:
                tokens.popleft().dead -= 1
            return tokens[0] if tokens else None
        sole = self.sole
        return sole if sole is not None and sole.queue else None

    def newest(self) -> Transport | None:
        """The transport that has the newest unread sample, or None; the caller holds the lock."""
        # A queue that is not empty ends with its transport's last arrival: reading takes the oldest.
        return max((one for one in self.transports if one.queue), key=attrgetter("arrived_at"), default=None)

    def read(self) -> Any:
        """The oldest unread sample. WouldBlock: there is none."""
        if self.plain:
            # Several connectors, or a writer waits for room: still no lock and nothing to stamp.
            transport: Transport | None
            if tokens := self.tokens:
                transport = tokens.popleft()
                while transport.dead:
                    transport.dead -= 1
                    transport = tokens.popleft()
                self.source = transport.connector
                if transport.waiting and get_ident() != self.thread:
                    raise self._cannot_wake(_THE_WRITER)
                sample = transport.last = transport.queue.popleft()
                if transport.waiting:
                    transport.admit_waiting()
                return sample
            transport = self.sole
            if transport is not None and (queue := transport.queue):
                if transport.waiting and get_ident() != self.thread:
                    raise self._cannot_wake(_THE_WRITER)
                sample = queue.popleft()
                if transport.waiting:
                    transport.admit_waiting()
                return sample
        self.check_thread()
        with self.guard():
            if (now := self.port._receiver) is not self:
                return now.read()
            self._check_writers()
            transport = self.next()
            if transport is None:
                raise self.empty()
            if self.tokens is not None:
                self.tokens.popleft()
            sample = transport.take()
            self.source = transport.connector
            return sample

    def read_newest(self) -> Any:
        """The newest unread sample, older ones superseded; NOTHING when there is none."""
        self.check_thread()
        with self.guard():
            if (now := self.port._receiver) is not self:
                return now.read_newest()
            self._check_writers()
            transport = self.newest()
            if transport is None:
                return NOTHING
            sample = transport.take_newest()
            if self.tokens is not None:
                for other in self.transports:
                    if other is not transport:
                        other.discard("superseded")
                self.settle_tokens()
            self.source = transport.connector
            return sample

    @at_current
    def peek(self) -> Any:
        """The oldest unread sample, which stays unread; None when there is none."""
        self.check_thread()
        transport = self.next()
        return None if transport is None else transport.queue[0]

    @at_current
    def drain(self) -> list[Any]:
        """Every unread sample, oldest first."""
        samples: list[Any] = []
        while self.unread():
            samples.append(self.port.read_nowait())
        return samples

    @at_current
    def drain_sources(self) -> list[tuple[Connector, Any]]:
        """Every unread sample, oldest first, with the connector that it came through."""
        pairs: list[tuple[Connector, Any]] = []
        while self.unread():
            sample, source = self.port.read_nowait(), self.last_source
            assert source is not None  # noqa: S101 - it was read
            pairs.append((source, sample))
        return pairs

    @at_current
    def look(self) -> Any:
        """The newest unread sample, which stays unread; else the sample read last; None before the first sample."""
        transport = self.newest() or self.next()
        return self.last_read if transport is None else transport.queue[-1]

    @property
    def last_read(self) -> Any:
        """The sample read last; None before the first."""
        return self.port._kept()

    @property
    def last_source(self) -> Connector | None:
        """See `InPort.last_source`."""
        sole = self.sole
        # The fast path notes no source: a grown count of delivered samples shows that it read from the only connector.
        return self.source if sole is None or sole.delivered() == self.sole_delivered else sole.connector

    def settle_tokens(self) -> None:
        """Rebuild the order of arrival after samples left the queues in another way than one by one from the front."""
        if self.tokens is None:
            return
        left = {id(transport): len(transport.queue) for transport in self.transports}
        kept: deque[Transport] = deque()
        for token in reversed(self.tokens):
            if left.get(id(token), 0) > 0:
                left[id(token)] -= 1
                kept.appendleft(token)
        self.tokens = kept
        for transport in self.transports:
            transport.dead = 0

    def bury(self, transport: Transport) -> None:
        """Remove the dead tokens of `transport`, which has more dead tokens than its length.

        The search goes from the end to the oldest dead token of `transport`, and removes other dead tokens on the way.
        """
        if transport.dead <= len(transport.queue):
            return  # it has more samples than its length, which was larger before
        tokens, kept = self.tokens, []
        assert tokens is not None  # noqa: S101 - it has several connectors
        met: dict[Transport, int] = {}
        while transport.dead:
            token = tokens.pop()
            met[token] = met.get(token, 0) + 1
            if met[token] > len(token.queue):
                token.dead -= 1
            else:
                kept.append(token)
        tokens.extend(reversed(kept))

    # -- waiting for a sample --------------------------------------------------------------------------------------

    async def wait(self) -> None:
        """Wait until a sample is there, or the port is removed.

        Raises:
            BusyError: another task waits.
            ClosedError: the port was removed.
            WouldBlock: the component runs in a real-time thread, which never waits.
        """
        waiter = self.port._open_host().loop.create_future()
        try:
            if not self.stand_by(waiter):
                await waiter
        finally:
            self.port._receiver.stand_down(waiter)

    def begin_wait(self) -> asyncio.Future[None] | None:
        """The future that the next sample completes, for the usual case: a task of the loop, a port without a lock.

        None: call `wait`, which waits or raises. The ten calls of `wait` take as long as the wake-up itself.
        """
        port = self.port
        host = port._host
        if (
            not self.plain  # it is not plain in a thread, real-time or other
            or self.waiter is not None
            or host is None
            or (kernel := host.kernel) is None
            or kernel.debug
            or not host.alive
            or host.ports.get(port.name) is not port
        ):
            return None
        waiter = self.waiter = kernel.loop.create_future()
        self.notify_enabled = True
        return waiter

    def stand_by(self, waiter: asyncio.Future[None]) -> bool:
        """Complete `waiter` when a sample comes or the port is removed; return whether a sample is there already.

        The caller calls `stand_down` in any case, on the receiver that the port has by then.

        Raises:
            BusyError: another task waits.
            WouldBlock: the component runs in a real-time thread, which never waits.
        """
        port = self.port
        host = port._bound()
        if host.realtime and not host.on_loop_thread():
            raise WouldBlock(f"{port.path}: no unread sample, and a hook of a real-time context cannot wait for one")
        if self.waiter is not None:
            raise BusyError(f"{port.path}: another task waits on this port; one at a time")
        with self.guard():
            # Enabled before the check: a sample that another thread writes in between completes the waiter.
            self.waiter = waiter
            self.notify_enabled = True
            return self.unread()

    def end_wait(self) -> None:
        """Raise EndingError in the task that waits for a sample."""
        waiter = self.waiter
        if waiter is not None and not waiter.done():
            waiter.set_exception(EndingError(f"{self.port.path}: its component ends, and no sample has come"))

    def stand_down(self, waiter: asyncio.Future[None]) -> None:
        """End the waiting of `waiter`, if it ever waited."""
        if self.waiter is waiter:
            self.waiter = None
            self.enable_notify()

    def rest(self, wanted: Callable[[], bool], deadline_ns: int | None, *, for_data: bool) -> None:
        """Block this thread of a ThreadContext until the port is removed, the context stops or `wanted` returns true.

        With `for_data`, unread data end the wait, too. The deadline ends it in any case.
        """
        host, lock = self.port._bound(), self.lock
        if lock is not None:
            with lock:
                host.wait_in_thread(
                    lock,
                    lambda: (for_data and self.port._receiver.unread()) or self.port._is_over() or wanted(),
                    deadline_ns,
                )

    def gave_up(self) -> None:
        """Note that a reader waited in vain."""

    def arrived(self, transport: Transport, displaced: int) -> None:
        """Note a new sample in the queue of `transport`, which `displaced` so many of the oldest samples there.

        The writer holds the lock.
        """
        if self.tokens is not None:
            self.arrivals += 1
            transport.arrived_at = self.arrivals
            self.tokens.append(transport)
            if displaced:
                transport.dead += displaced
                if transport.dead > transport.length:
                    self.bury(transport)
        if self.lock is not None:
            self.lock.notify_all()
        if self.notify_enabled and (self.waiter is not None or transport.connector.profile.dataflow is not _PULL):
            self.notify_across() if self.lock is not None else self.notify()

    def notify_across(self) -> None:
        """`notify` from any thread: the loop's thread does it soon."""
        # All samples written before the reader runs make one wake-up; the reader enables the next wake-up.
        self.notify_enabled = False
        self.on_loop(lambda: self.port._receiver.notify())

    def notify(self) -> None:
        """Wake readers that wait for data and call the callbacks; reading on enables the next notification.

        Raises:
            ThreadError: called in another thread than the loop's, which can wake no reader; notification stays enabled.
        """
        if get_ident() != self.thread:
            raise self.cannot_wake()
        self.wake()

    def wake(self) -> None:
        """`notify` in the loop's thread."""
        self.notify_enabled = False
        if self.waiter is not None:
            waiter, self.waiter = self.waiter, None
            if not waiter.done():
                waiter.set_result(None)
        callback = self.callback
        if callback is not None and callback(self.port):
            self.notify_enabled = True

    def add_callback(self, callback: Callable[[InPort[Any]], object]) -> None:
        """Call `callback` with the port at the next sample; again if the call returns True, or after `enable_notify`.

        Samples that another thread writes before the loop turns make one call together.
        """
        self._call_each((*self._callbacks, callback))

    def remove_callback(self, callback: Callable[[InPort[Any]], object]) -> None:
        """Stop calling `callback`."""
        self._call_each(tuple(each for each in self._callbacks if each != callback))

    @property
    def _callbacks(self) -> tuple[Callable[[InPort[Any]], object], ...]:
        callback = self.callback
        return callback.each if isinstance(callback, _Callbacks) else () if callback is None else (callback,)

    def _call_each(self, callbacks: tuple[Callable[[InPort[Any]], object], ...]) -> None:
        self.callback = _Callbacks(callbacks) if len(callbacks) > 1 else callbacks[0] if callbacks else None
        self.enable_notify()

    def enable_notify(self) -> None:
        """Let the next sample notify, if a reader waits or there is a callback."""
        self.notify_enabled = self.waiter is not None or self.callback is not None

    def end_waiting(self) -> None:
        """Remove a waiter that was woken but whose task has not run yet, so that another task may wait."""
        if self.waiter is not None and self.waiter.done():
            self.waiter = None
            self.enable_notify()

    def wake_waiter(self) -> None:
        """Wake reads that wait: the port was removed, or calls that block are to give up."""
        self.wake_threads()
        waiter, self.waiter = self.waiter, None
        if waiter is not None and not waiter.done():
            waiter.set_result(None)

    def wake_threads(self) -> None:
        """Wake threads that sleep at this port: each checks again."""
        if self.lock is not None:
            with self.lock:
                self.lock.notify_all()

    def room_made(self) -> None:
        """Wake threads: a queue has room again; the caller holds the lock."""
        if self.lock is not None:
            self.lock.notify_all()

    def _check_writers(self) -> None:
        """Raise ThreadError if a read in this thread would make room for a waiting writer but could not wake it."""
        if self.lock is None and get_ident() != self.thread and any(one.waiting for one in self.transports):
            raise self._cannot_wake(_THE_WRITER)

    def cannot_wake(self) -> ThreadError:
        """The error for a write in a thread that cannot wake the reader."""
        return self._cannot_wake(_THE_READER)

    def _cannot_wake(self, whom: str) -> ThreadError:
        thread = current_thread().name
        return ThreadError(f"{self.port.path}: thread {thread!r} cannot wake {whom}, or use a ThreadContext")

    # -- what changes ----------------------------------------------------------------------------------------------

    @property
    def has_threads(self) -> bool:
        """Whether the component of this port, or one that writes to it, runs in a thread of its own."""
        hosts = [self.port._host, *(connector.out._host for connector in self.port._connectors)]
        return any(host is not None and (host.realtime or host.threaded) for host in hosts)

    def on_loop(self, callback: Callable[[], object]) -> None:
        """Run `callback` on the kernel's loop: now if this is its thread, soon otherwise."""
        self.port._on_loop(callback)

    def make_locked(self) -> None:
        """Add a lock: from now on more than one thread uses this port's queues."""
        if self.lock is None:
            self.lock = PortLock()
            self.refresh_all()

    def fit(self, transport: Transport) -> None:
        """Replace the transport of a new connector, if necessary, by one of the receiver's kind."""

    def connector_ended(self) -> None:
        """Note that a connector of this port has ended."""

    def mute(self) -> None:
        """Silence all listeners at this port from now on."""
        for transport in self.transports:
            transport.mute()

    def set_open(self, is_open: bool) -> None:
        """Open the port with empty buffers, or close it and drop unread samples as inactive."""
        with self.guard():
            if (now := self.port._receiver) is not self:
                return now.set_open(is_open)
            self.open = is_open
            for transport in self.transports:
                transport.suspend()
                transport.dead = 0
            if self.tokens is not None:
                self.tokens.clear()
            if is_open:
                self.forget()
            self.refresh()
            due = to_be_offered(self.port) if is_open else ()
        self.refresh_writers()
        for connector, written in due:
            offer_last(connector, written)

    def forget(self) -> None:
        """Forget the samples read before: nothing counts as read yet."""
        port = self.port
        port._last, port._before = NOTHING, None
        self.source = self.sole = None

    def refresh_all(self) -> None:
        """Choose again the read path of this port and the write paths of all ports that write to it."""
        self.refresh()
        self.refresh_writers()

    def refresh_writers(self) -> None:
        """Make all ports that write to this port choose their write paths again."""
        for connector in self.port._connectors:
            connector.out._refresh()

    def refresh(self) -> None:
        """Adapt to changed connectors or options."""
        connectors = self.port._connectors  # ten thousand of them cost nothing: none is looked at
        source = self.source = self.last_source
        if self.plain and source is not None and not source.closed:
            source._transport.last = self.last_read  # the port's own last sample may be of another connector soon
        self.sole = connectors[0]._transport if len(connectors) == 1 else None
        self.sole_delivered = 0 if self.sole is None else self.sole.delivered()
        if len(connectors) > 1 and self.tokens is None:
            self.tokens = deque(transport for transport in self.transports for _ in transport.queue)
        elif len(connectors) <= 1 and self.tokens is not None:
            self.tokens = None
            if self.sole is not None:
                self.sole.dead = 0
        self.update_fast_path()

    def update_fast_path(self) -> None:
        """Decide whether the port reads straight from a queue."""
        port, sole = self.port, self.sole
        port._fast = self.direct = OFF
        host = port._host
        self.plain = (
            self.has_fast_path and self.lock is None and host is not None and not host.debug and not self.read_stamps
        )
        if self.plain and sole is not None:
            self.direct = sole.queue
            port._fast = OFF if sole.waiting else self.direct


class _Callbacks:
    """Several callbacks that are called as one."""

    __slots__ = ("each",)

    def __init__(self, each: tuple[Callable[[InPort[Any]], object], ...]) -> None:
        self.each = each

    def __call__(self, port: InPort[Any]) -> bool:
        again = [callback(port) for callback in self.each]
        return any(again)
