"""The reading end of a stream.

Users hold an `InPort`. Its `read` and `read_nowait` write the common case out in full: one connector, no lock, no
writer that waits for room. Its `Receiver` (`receiver.py`) does the rest; a receiver of another kind replaces it when a
real-time thread or a listener comes or goes.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from itertools import repeat
from math import inf
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar, cast, overload

from anyio import WouldBlock

from aiorts.errors import ClosedError, ConfigurationError, DeclarationError, ReadTimeout, StateError
from aiorts.kernel.ports.port import NOTHING, OFF, UNSUSPENDED, Port, give_turn
from aiorts.kernel.ports.receiver import Receiver

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import PortHost


T = TypeVar("T")


class InPort(Port[T]):
    """The reading end of a stream: one bounded queue for each connector, read in the order of arrival.

    One task waits on an in-port at a time.

    Args:
        type, unit, shape, doc, name, max_connectors: see `Port`.
        length: samples that a connector holds unless `connect` gives a length; for readers that need every sample.
    """

    __slots__ = ("_before", "_last", "_receiver", "length")

    direction: ClassVar[str] = "in"
    is_tap: ClassVar[bool] = False
    """Whether a service, not a component, reads at this port."""

    @property
    def connectors(self) -> tuple[Connector, ...]:
        """The live connectors of this port, in order of connection; not parked ones, nor those of services."""
        found = self._connectors
        while found and (found[-1].out.is_tap or found[-1].parked):
            found = found[:-1]
        return found

    _receiver: Receiver

    def __init__(
        self,
        type: type[T],  # noqa: A002 - the word users expect
        *,
        unit: str | None = None,
        shape: tuple[int, ...] | None = None,
        doc: str = "",
        name: str | None = None,
        max_connectors: int | None = None,
        length: int | None = None,
    ) -> None:
        super().__init__(type, unit=unit, shape=shape, doc=doc, name=name, max_connectors=max_connectors)
        if length is not None and (isinstance(length, bool) or not isinstance(length, int) or length < 1):
            raise DeclarationError(f"{name or 'in-port'}: length = {length!r}: expected a whole number from 1, or None")
        self.length = length
        self._last: T = NOTHING
        """The sample read last in this cycle of an event context; `NotifiedPorts` moves it to `_before` at the next."""
        self._before: T | None = None
        self._receiver = Receiver(self)

    def bind(self, host: PortHost, name: str) -> InPort[T]:
        """Make a live port of `host` from this declaration."""
        limits: dict[str, Any] = {"max_connectors": self.max_connectors, "length": self.length}
        port = InPort(self.type, unit=self.unit, shape=self.shape, doc=self.doc, **limits)
        port._attach(host, name)
        return port

    def read_nowait(self) -> T:
        """The oldest unread sample.

        Raises:
            WouldBlock: there is none.
        """
        try:
            sample = self._last = self._fast.popleft()
            return sample
        except IndexError:
            pass
        sample = self._last = cast("T", self._receiver.read())
        return sample

    async def read(self, timeout: float | None = None) -> T:
        """The oldest unread sample, waiting for one. A cancelled read takes nothing.

        Args:
            timeout: seconds of the kernel's clock to wait at most; 0 does not wait, None waits forever.

        Raises:
            ReadTimeout: no sample arrived in time.
            BusyError: another task waits on this port.
            ClosedError: the port was removed.
            ConfigurationError: `timeout` is no number of seconds.
        """
        turns = self._turns
        if turns.left:
            turns.left -= 1
        else:
            turns.left = UNSUSPENDED
            await give_turn()
        while True:
            queue = self._fast
            if queue:
                sample = self._last = queue.popleft()
                return sample
            receiver = self._receiver
            if queue is OFF and receiver.unread():
                try:
                    sample = self._last = receiver.read()
                    return sample
                except WouldBlock:
                    continue  # taken just now, as may be where threads meet without a lock
            if timeout is not None:
                return await self._read_within(timeout)
            if (waiter := receiver.begin_wait()) is None:
                await receiver.wait()
                continue
            try:
                await waiter
            finally:
                if self._receiver.waiter is waiter:
                    self._receiver.stand_down(waiter)

    @property
    def latest(self) -> T | None:
        """The newest sample, dropping older unread ones; it stays until the next arrives; None before the first."""
        queue = self._fast
        if len(queue) == 1:
            sample = self._last = queue.popleft()
            return sample
        if queue or queue is OFF:
            sample = self._receiver.read_newest()
            if sample is not NOTHING:
                self._last = sample
                return sample
        return self._kept()

    def peek(self) -> T | None:
        """The oldest unread sample, which stays unread; None when there is none."""
        return cast("T | None", self._receiver.peek())

    @overload
    def drain(self, *, sources: Literal[False] = False) -> list[T]: ...
    @overload
    def drain(self, *, sources: Literal[True]) -> list[tuple[Connector, T]]: ...
    @overload
    def drain(self, *, sources: bool) -> list[T] | list[tuple[Connector, T]]: ...
    def drain(self, *, sources: bool = False) -> list[T] | list[tuple[Connector, T]]:
        """Every unread sample, oldest first; with `sources`, pairs of the connector it came through and the sample."""
        queue = self._fast
        if sources or queue is OFF:
            self._bound()
            if sources:
                pairs: list[tuple[Connector, T]] = self._receiver.drain_sources()
                return pairs
            samples = self._receiver.drain()
        else:
            samples = list(queue)
            queue.clear()
        if samples:
            self._last = samples[-1]
        return samples

    @property
    def is_new(self) -> bool:
        """Whether there is an unread sample, at a pull connector also at the writer."""
        queue = self._fast
        if queue is not OFF:
            return bool(queue)
        self._bound()
        return self._receiver.unread()

    @property
    def last_source(self) -> Connector | None:
        """The connector that the sample read last came through; None before the first."""
        return self._receiver.last_source

    def read_blocking(self, timeout: float | None = None) -> T:
        """`read` for the thread of a `ThreadContext`: blocks the thread, at most `timeout` seconds (None: forever).

        Raises:
            ReadTimeout: no sample arrived in time.
            ClosedError: the port was removed or its context is stopping.
            StateError: called on the loop, or the component is in no `ThreadContext`.
        """
        host = self._bound()
        if host.on_loop_thread():
            raise StateError(f"{self.path}: read_blocking would block the event loop; await read() here")
        lock = self._receiver.lock
        if lock is None or not host.threaded:
            raise StateError(f"{self.path}: read_blocking is for components of a ThreadContext")
        deadline_ns = host.deadline_ns(timeout)
        with lock:
            while host.wait_in_thread(lock, lambda: self._receiver.unread() or self._is_over(), deadline_ns):
                try:
                    sample = self._last = cast("T", self._receiver.read())
                    return sample
                except WouldBlock:
                    self._open_host()  # else the sample was taken just now, as in `read`
            self._receiver.gave_up()
            raise ReadTimeout(f"{self.path}: no sample within {timeout} s")

    def __aiter__(self) -> AsyncIterator[T]:
        return _Samples(self)

    async def _read_within(self, seconds: float) -> T:
        """Wait at most `seconds` for a sample, at a port without an unread sample, and return it."""
        host = self._bound()
        if not isinstance(seconds, int | float) or not 0 <= seconds < inf:
            raise ConfigurationError(f"{self.path}: read: timeout = {seconds!r}: expected seconds from 0 on, or None")
        if not host.on_loop_thread():
            await self._receiver.wait()  # raises the reason
        is_over = False

        def end() -> None:
            nonlocal is_over
            is_over = True
            self._receiver.wake_waiter()

        timer = host.call_later(seconds, end)
        try:
            while True:
                await self._receiver.wait()
                try:
                    return self.read_nowait()
                except WouldBlock:
                    if is_over:
                        raise ReadTimeout(f"{self.path}: no sample within {seconds:g} s") from None
        finally:
            timer.cancel()

    def _kept(self) -> T | None:
        return self._before if self._last is NOTHING else self._last

    def _is_over(self) -> bool:
        return self._bound().stopping or self._removed()

    def _open_host(self) -> PortHost:
        self._raise_if_removed()
        host = self._bound()
        if host.stopping:
            raise ClosedError(f"{self.path}: its context stops")
        return host

    def _wake_waiter(self) -> None:
        self._receiver.wake_waiter()

    def _make_locked(self) -> None:
        self._receiver.make_locked()

    def _refresh(self) -> None:
        self._receiver.refresh()


class _Samples(AsyncIterator[T]):
    """The samples of a port as they come; the iteration ends when the port is closed."""

    __slots__ = ("_port",)

    def __init__(self, port: InPort[T]) -> None:
        self._port = port

    async def __anext__(self) -> T:
        try:
            return await self._port.read()
        except ClosedError:
            raise StopAsyncIteration from None


def read_all(port: InPort[Any], count: int) -> None:
    """Take `count` samples from the queue that the port reads directly (`Receiver.direct`); the queue holds enough."""
    receiver = port._receiver
    queue = receiver.direct
    for _ in repeat(None, count - 1):
        queue.popleft()
    port._last = queue.popleft()
    if receiver.sole is not None and receiver.sole.waiting:
        receiver.sole.admit_waiting()


def read_alone(port: InPort[Any]) -> Any:
    """Read the only sample of the queue that the port reads directly; NOTHING: there are others, or a writer waits."""
    queue = port._fast
    if len(queue) != 1:
        return NOTHING
    sample = port._last = queue.popleft()
    return sample


def receiver_of(port: InPort[Any]) -> Receiver:
    """The in-port's present receiver; call this each time, since the receiver may be replaced."""
    return port._receiver


def set_open(port: InPort[Any], is_open: bool) -> None:
    """Open the port with empty buffers, or close it: unread and later samples are dropped as inactive."""
    if port._receiver.open is not is_open:
        port._receiver.set_open(is_open)


def in_ports_at(port: Port[Any]) -> tuple[InPort[Any], ...]:
    """The in-ports that the thread of the port's owner uses: `port` itself, or the readers of an out-port."""
    return (port,) if isinstance(port, InPort) else tuple(dict.fromkeys(each.in_ for each in port._connectors))
