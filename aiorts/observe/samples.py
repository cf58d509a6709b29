"""`kernel.samples(port)`: the samples of an out-port as an async iterator, for tests, WebSockets and notebooks.

The samples come over a tap, which changes nothing in the system: no writer waits.
"""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from aiorts.errors import ConfigurationError, WiringError
from aiorts.kernel.loop.bus import ComponentRemoved, PortRemoved
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.ports.port import host_of
from aiorts.model.declared import kinds_of
from aiorts.model.profile import ConnectorProfile
from aiorts.observe.iterating import ClosableIterator, Waiter

if TYPE_CHECKING:
    from aiorts.kernel.loop.bus import Bus
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.service import KernelService
    from aiorts.model.connect_options import ConnectOptions

T = TypeVar("T")


class Samples(ClosableIterator, AsyncIterator[T], Generic[T]):
    """An async iterator of the samples that an out-port writes, for one task; see `Kernel.samples`.

    It ends with its kernel, with its port, with `close()` or `aclose()`, at the end of `async with`, and when nothing
    refers to it any more, as after a `break` out of `async for sample in kernel.samples(...)`. Samples that wait then
    are still given, but not after `close`.
    """

    def __init__(self, feed: Feed[T]) -> None:
        self._feed = feed
        self._forgotten = weakref.finalize(self, feed.forget)
        self._forgotten.atexit = False

    @property
    def dropped(self) -> int:
        """Samples that were dropped here since more than `length` waited; the oldest are dropped first."""
        return self._feed.dropped

    @property
    def closed(self) -> bool:
        """Whether no sample comes any more; some may wait."""
        return self._feed.ended

    def close(self) -> None:
        """End the iterator; samples that wait are not given any more. Idempotent."""
        self._forgotten.detach()
        self._feed.end()
        self._feed.clear()

    async def aclose(self) -> None:
        """As `close`, as asynchronous generators have it."""
        self.close()

    async def __anext__(self) -> T:
        return await self._feed.next()

    def __repr__(self) -> str:
        feed = self._feed
        state = "closed" if feed.ended else "open"
        return f"<Samples {feed.path} {state} {feed.waiting} waiting {feed.dropped} dropped>"


class Feed(Generic[T]):
    """The tap of one `Samples`; it does not refer to the iterator, which may go unclosed."""

    def __init__(self, service: KernelService, out: OutPort[T], options: ConnectOptions) -> None:
        self.path = out.path
        self._rest: deque[T] = deque()
        """The samples that waited when the tap was closed."""
        self._waiter = Waiter()
        self._kernel: Microkernel = service.kernel
        self._connector: Connector = service.kernel.connections.tap(service, out, lambda _: self._wake(), **options)
        self._unsubscribe = when_removed(service.kernel.bus, out.path, lambda _: self.end())

    @property
    def dropped(self) -> int:
        """Samples that found no room in the tap."""
        return sum(self._connector.statistics.dropped.values())

    @property
    def waiting(self) -> int:
        """Samples that can be given at once."""
        return len(self._rest) if self.ended else self._kernel.connections.unread(self._connector)

    @property
    def ended(self) -> bool:
        """Whether no sample comes any more."""
        return self._connector.closed

    def end(self) -> None:
        """Take no more samples; those that wait are still given. Idempotent."""
        if not self.ended:
            self._rest.extend(self._connector.in_.drain())
            self._connector.close()
        self._unsubscribe()
        self._wake()

    def clear(self) -> None:
        """Forget the samples that wait, once the feed has ended."""
        self._rest.clear()

    def forget(self) -> None:
        """As `end`, from any thread: the iterator is gone."""
        self._kernel.call_on_loop(self.end)

    async def next(self) -> T:
        """The oldest sample that waits; StopAsyncIteration when none comes any more."""
        self._waiter.check_free(f"{self.path}: another task iterates these samples")
        while not self.waiting:
            if self.ended:
                raise StopAsyncIteration
            await self._waiter.wait()
        sample: T = self._rest.popleft() if self.ended else self._connector.in_.read_nowait()
        return sample

    def _wake(self) -> None:
        if self.waiting or self.ended:
            self._waiter.wake()


def out_port_of(kernel: Microkernel, path: str) -> OutPort[Any]:
    """The out-port of a path, to be tapped.

    Raises:
        WiringError: no out-port of this kernel has that path; for an in-port, the text names its writers.
    """
    out = kernel.find(path)
    if isinstance(out, InPort):
        writers = ", ".join(connector.out.path for connector in out.connectors) or "none is connected"
        raise WiringError(f"{path}: is an in-port; look at the out-port that writes to it: {writers}")
    if not isinstance(out, OutPort):
        raise WiringError(f"{path}: is no out-port of samples")
    return out


def when_removed(bus: Bus, path: str, call: Callable[[str], object]) -> Callable[[], None]:
    """Call `call` with a text when a port or its component is removed; return a function that ends this."""
    component, _, name = path.rpartition("/")[2].partition(".")

    def component_removed(event: ComponentRemoved) -> None:
        if event.component == component:
            call("its component was removed")

    def port_removed(event: PortRemoved) -> None:
        if (event.component, event.port.name) == (component, name):
            call("was removed")

    ends = bus.subscribe(ComponentRemoved, component_removed), bus.subscribe(PortRemoved, port_removed)

    def end() -> None:
        for one in ends:
            one()

    return end


def samples_of(
    service: KernelService, port: OutPort[Any] | str, options: ConnectOptions
) -> tuple[Feed[Any], Samples[Any]]:
    """The feed of an out-port of this kernel and the iterator over it. See `Kernel.samples`."""
    kernel = service.kernel
    if isinstance(port, str) and kernel.registry.is_elsewhere(port):
        owner = port.rpartition(".")[0]
        raise WiringError(
            f"{port}: is in another kernel, whose types this one does not know; "
            f'have its component here: await kernel.stand_in("{owner}"), and take the samples of its port'
        )
    out = out_port_of(kernel, port) if isinstance(port, str) else port
    host = host_of(out) if isinstance(out, OutPort) else None
    if host is None or host.kernel is not kernel:
        raise WiringError(f"samples({out!r:.100}): expected an out-port of a component of this kernel, or its path")
    for key, value in options.items():
        if kinds_of(ConnectorProfile)[key] == (bool,) and type(value) is not bool:
            raise ConfigurationError(f"samples: {key} = {value!r:.60}: expected True or False")
    feed: Feed[Any] = Feed(service, out, options)
    return feed, Samples(feed)
