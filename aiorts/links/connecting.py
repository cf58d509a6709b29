"""The service of links: connectors whose other end is in another kernel.

A connector with a far port is made at once, and its link then looks for the other kernel: the kernel of the writer
offers, the kernel of the reader answers, and both open a channel. A link that has no channel, since the other kernel or
component is not there, is offered again when it comes.
"""

from __future__ import annotations

import asyncio
import os
from collections import defaultdict
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import LinkError, WiringError, format_error
from aiorts.kernel.connection import Connection
from aiorts.kernel.loop.bus import ConnectorChanged, Disconnected
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.kernel.ports.far import FarInPort, FarOutPort, far_ends
from aiorts.kernel.service import KernelService, setting
from aiorts.late import dataclass
from aiorts.links.answering import Answering
from aiorts.links.arrivals import Arrivals, Departures
from aiorts.links.calls import Calls
from aiorts.links.ends import Ends, reader_end, writer_end
from aiorts.links.ledgers import Ledgers, LinkLedger
from aiorts.links.reaching import Reach
from aiorts.links.serving import Serving
from aiorts.model.links.negotiation import LinkEvent
from aiorts.model.names import Path, check_name
from aiorts.model.options import link_options
from aiorts.services import is_service
from aiorts.wire import LINK, MsgpackCodec

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports import Port
    from aiorts.kernel.ports.connector import Connector
    from aiorts.links.ends import LinkEnd
    from aiorts.links.messages import Answer
    from aiorts.links.reader_link import ReaderLink
    from aiorts.links.transport import Caller, Peer, Transport

_LOG: Final = KernelLog()
_LEDGER_SECONDS: Final = 2.0
_FIRST_SECONDS: Final = 5.0
"""The most seconds that `connect` waits for the answer of the other kernel."""
_AT_ONCE: Final = 64
"""The most links offered to one kernel at once: the last of thousands would have no answer in time."""


@dataclass(frozen=True, slots=True)
class LinksSettings:
    """Whether other kernels can connect to ports of this one, and how they reach it."""

    transport: str = setting("unix", "What carries links: unix, or the name of a transport that a plugin offers.")
    name: str = setting("", "The name by which other kernels reach this one; by default that of its address.")


class Links(KernelService):
    """The links of one kernel. See `aiorts help links`."""

    name = "links"
    settings = LinksSettings

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._settings = LinksSettings()
        self._codec = MsgpackCodec(LINK)
        self._tasks: set[asyncio.Task[Any]] = set()
        self._turns: defaultdict[Peer, asyncio.Semaphore] = defaultdict(partial(asyncio.Semaphore, _AT_ONCE))
        self.numbers: Iterator[int] = count(1)
        """The numbers of this kernel's offers."""
        self.ends = Ends()
        """The ends of links in this kernel."""
        self.calls, self._serving = Calls(self), Serving(self)
        self._ledgers, self._arrivals = Ledgers(self, self.ends), Arrivals(self)
        self._departures = Departures(self, lambda: {end.connector.name for end in self.ends.all()})
        self._answering = Answering(self, self.ends, self._read_end, int.from_bytes(os.urandom(3), "big"))
        self.reach = Reach(self, self._handlers, self._present, self._reachable)
        """The kernels in reach, and the transports that reach them."""
        kernel.connections.far = self
        kernel.bus.subscribe(Disconnected, self.calls.disconnected)
        kernel.bus.subscribe(ConnectorChanged, self._ledgers.changed)

    def owns(self, connector: Connector) -> bool:
        """Whether another kernel has made the connector, which is then not saved, and not changed by plans."""
        return any(not end.own for end in self.ends.of(connector))

    def report(self) -> Mapping[str, Any]:
        """The state of each link, by the name of its connector."""
        now = self.kernel.clock.monotonic_ns()
        data: dict[str, str] = {}
        for one in self.ends.all():
            connector, why = one.connector, one.link.why
            said = f"{one.link.end.state(now)}{f': {why}' if why else ''}"
            if not (connector.in_.is_tap or connector.out.is_tap):
                before = data.get(connector.name, said)
                data[connector.name] = said if said == before else f"{before}; {said}"
        return data | self.calls.report()

    async def ledger(self, connector: Connector, within: float = _LEDGER_SECONDS) -> LinkLedger:
        """The ledger of a link from end to end, asked for at either end; the other kernel answers in `within` seconds.

        Raises:
            LinkError: the other kernel does not answer, or the connector has no link.
        """
        if not (ends := self.ends.of(connector)):
            raise LinkError(f"{connector.name}: ledger: both ports are in this kernel; look at its statistics")
        writer, reader = self.ends.writers.get(connector), self.ends.readers.get(connector)
        if writer is not None and reader is not None:
            return await self._ledgers.through(reader, writer, within)
        return await self._ledgers.of(ends[0], within)

    async def up(self, connectors: Iterable[Connector], within: float) -> None:
        """Wait until the links from the writers to these connectors are up, or so many seconds have passed."""
        waits = [end.up() for one in connectors if (end := self.ends.readers.get(one)) is not None]
        if waits:
            await asyncio.wait(waits, timeout=within)
        for wait in waits:
            wait.cancel()

    # -- opening ---------------------------------------------------------------------------------------------------

    def configure(self, settings: LinksSettings) -> None:
        if settings.name:
            check_name(settings.name, "[links]: kernel")  # other kernels would refuse a bad name
        self._settings = settings
        self.reach.open_soon(settings.transport)

    @property
    def reached_as(self) -> str:
        """The name by which other kernels reach this one."""
        return self._settings.name or self.kernel.address.rpartition("/")[2] or self.kernel.name

    def open_as(self, *, elsewhere: bool) -> str:
        """See `FarPorts.open_as`."""
        return ((elsewhere and self.reach.known_as) or self.reached_as) if self.reach.is_open else ""

    @property
    def peers(self) -> tuple[Peer, ...]:
        """The kernels that are there besides this one."""
        return tuple(self.reach.peers)

    async def opened(self) -> None:
        """Wait until other kernels can be reached.

        Raises:
            LinkError: the transport cannot be opened; it is tried again while the kernel runs.
        """
        await self.reach.opened()

    def use(self, transport: Transport) -> None:
        """Carry links with this transport, which is not open yet; to be called before all else."""
        self.reach.use(transport)

    def _handlers(self) -> Mapping[str, Callable[[bytes, Caller], Awaitable[bytes]]]:
        """The questions that other kernels may ask, and their handlers."""
        answering = self._answering.handlers()
        return {**answering, **self.calls.handlers(), **self._serving.handlers(), **self._ledgers.handlers()}

    def _reachable(self) -> None:
        """Let links that wait for an absent kernel say so, now that other kernels can be reached at last."""
        for end in self.ends.all():
            end.say_absent()

    # -- the ports of other kernels ------------------------------------------------------------------------------------

    def is_far(self, path: str) -> bool:
        """Whether this is the path of a port in another kernel."""
        return self.kernel.registry.is_elsewhere(path) and Path.parse(path).kernel != self._settings.name

    def resolve(self, ports: Sequence[Any], options: Mapping[str, Any]) -> tuple[list[Any], Mapping[str, Any]]:
        """See `FarPorts.resolve`."""
        near = [port for port in ports if not (isinstance(port, str) or port.elsewhere)]
        if near and is_service(near[0]):
            given = [port if port in near else str(getattr(port, "elsewhere", port)) for port in ports]
            return self.calls.resolve(given), options
        where = " -> ".join(port if isinstance(port, str) else port.path for port in ports)
        ends = far_ends(self.kernel, where, ports)
        # Options of the writer's end reach a process of this kernel; at another kernel the reader cannot set them.
        from_reader = not near or any(
            isinstance(end, FarOutPort) and isinstance(port, str) for end, port in zip(ends, ports, strict=True)
        )
        return ends, link_options(where, options, from_reader=from_reader, through=not near)

    def connector_made(self, connector: Connector) -> None:
        if self.ends.of(connector):
            return  # a connector that is in force again has its link
        for_others, carried = self._answering.is_connecting, self.reach.carried
        if isinstance(connector.in_, FarInPort):
            own = not for_others or connector.in_.far.kernel in carried
            writer = writer_end(self, connector, self._codec, self._departures, own=own)
            self.ends.add(writer)
            writer.on(LinkEvent.PRESENT)
        if isinstance(connector.out, FarOutPort) and (not for_others or connector.out.far.kernel in carried):
            reader = self._read_end(connector, own=True)
            self.ends.expect((str(reader.far), reader.reader_path()), reader)
            reader.on(LinkEvent.PRESENT)

    def _read_end(self, connector: Connector, *, own: bool = False) -> LinkEnd[ReaderLink]:
        end = reader_end(self, connector, self._codec, self._departures, own=own)
        self.ends.add(end)
        return end

    def connector_ended(self, connector: Connector) -> None:
        for end in self.ends.of(connector):
            self.ends.remove(end)
            end.on(LinkEvent.DISCONNECTED)

    async def connect(
        self,
        connect: Callable[[Sequence[Any], Mapping[str, Any]], Awaitable[Any]],
        ports: Sequence[Any],
        options: Mapping[str, Any],
    ) -> Any:
        """Connect with `connect`; return when the other kernel, if it is there, has answered.

        Raises:
            LinkError: the transport cannot be opened.
            WiringError: as `Kernel.connect`, or the other kernel refused a connector; all of this call were ended.
        """
        for port in ports:
            if isinstance(port, str) and self.is_far(port):
                await self.reach.opened_for(Path.parse(port))
        made = await connect(ports, options)
        connectors = made.connectors if isinstance(made, Connection) else (made,)
        waits = [end.first for one in connectors for end in self.ends.of(one)]
        waits += self.calls.first_answers(connectors)
        try:
            if waits:
                done, _ = await asyncio.wait(waits, timeout=_FIRST_SECONDS, return_when=asyncio.FIRST_EXCEPTION)
                for wait in done:
                    wait.result()
        except WiringError:
            for one in connectors:
                self.kernel.connections.end(one)
            raise
        return made

    # -- other kernels ---------------------------------------------------------------------------------------------

    def is_there(self, peer: Peer) -> bool:
        """See `Kernels.is_there`."""
        return peer in self.reach.peers

    async def ask(self, peer: Peer, what: str, body: bytes, within: float) -> bytes:
        """See `Kernels.ask`."""
        try:
            return await self.reach.carrier(peer).ask(peer, what, body, within=within)
        except LinkError:
            raise
        except Exception as error:
            _LOG.error("links: %s to %s failed: %s", what, peer.kernel, format_error(error), exc_info=error)
            raise LinkError(f"{peer.kernel}: {format_error(error)}") from error

    def turn(self, peer: Peer) -> asyncio.Semaphore:
        """See `Kernels.turn`."""
        return self._turns[peer]

    def _present(self, peer: Peer, up: bool) -> None:
        self.calls.present(peer, up)
        if up:
            self._departures.back(peer)
        else:
            self._serving.gone(peer)
            self._arrivals.gone(peer)
            self._turns.pop(peer, None)
        for end in self.ends.at(peer.kernel):
            if end.is_at(peer.host):
                (end.present if up else end.gone)(peer)

    def peer_of(self, path: Path) -> Peer | None:
        """See `Kernels.peer_of`."""
        return self.reach.peer_of(path)

    def path_of(self, port: Port[Any], peer: Peer | None = None) -> Path:
        """See `Kernels.path_of`."""
        return replace(Path.parse(port.path), kernel=self.reach.name_for(peer))

    def there(self, path: Path, caller: Caller, right: str) -> Port[Any] | Answer:
        return self._arrivals.there(path, caller, right)

    def come(self, component: str, peer: Peer | None) -> None:
        """See `Kernels.come`."""
        self.calls.come(component, peer)

    def making(self) -> AbstractContextManager[None]:
        return self._arrivals.making()

    def expect(self, component: str) -> None:
        """Expect a component that is about to be made: other kernels that ask for it meanwhile hear so."""
        self._arrivals.expect(component)

    def component_added(self, component: Component) -> None:
        self._arrivals.added(component.name)

    def started(self) -> None:
        self._arrivals.started()

    # -- ending --------------------------------------------------------------------------------------------------------

    async def ending(self, budget: StopBudget) -> None:
        await self.ends.sent(self.ends.writers, budget.rest)

    def stopped(self) -> None:
        for end in self.ends.all():
            end.on(LinkEvent.DISCONNECTED)
        self.calls.stopped()
        self._serving.stopped()
        for task in self._tasks:
            task.cancel()

    async def leaving(self, budget: StopBudget) -> None:
        await self.reach.close()

    def run(self, coroutine: Any, name: str) -> asyncio.Task[Any]:
        """See `Kernels.run`."""
        task = kernel_task(self.kernel.loop, coroutine, name)
        self._tasks.add(task)
        task.add_done_callback(self._done)
        return task

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _LOG.error("links: %s failed: %s", task.get_name(), format_error(error), exc_info=error)
