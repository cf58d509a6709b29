"""The service of links: connectors whose other end is in another kernel.

A connector with a far port is made at once, and its link then looks for the other kernel: the kernel of the writer
offers, the kernel of the reader answers, and both open a channel. A link that has no channel, since the other kernel or
component is not there, is offered again when it comes.
"""

from __future__ import annotations

import asyncio
import os
from collections import Counter, defaultdict
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, LinkError, WiringError, format_error
from aiorts.kernel.connection import Connection
from aiorts.kernel.loop.bus import Disconnected
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.kernel.ports.connector import unread_of
from aiorts.kernel.ports.far import FarInPort, FarOutPort, far_ends, far_port
from aiorts.kernel.ports.port_types import port_type
from aiorts.kernel.service import KernelService, setting
from aiorts.late import dataclass
from aiorts.links import versions
from aiorts.links.answering import EndsByComponent, NamedEnds, check_theirs, is_end, name_of, refusal, sent
from aiorts.links.arrivals import Arrivals, Departures, Link
from aiorts.links.calls import Calls
from aiorts.links.layout import difference, layout_of
from aiorts.links.ledgers import Ledgers, LinkLedger
from aiorts.links.messages import Answer, LinkRequest, versions_of
from aiorts.links.pulling import PulledWriterLink, PullingReaderLink
from aiorts.links.reaching import Reach, new_epoch
from aiorts.links.reader_link import ReaderLink, of_shape, reader_options
from aiorts.links.serving import Serving
from aiorts.links.transport import Caller, LinkOffer, Peer, Transport
from aiorts.links.writer_link import WriterLink
from aiorts.model.links import READ, WRITE
from aiorts.model.names import MAX_NAME_LENGTH, Path, check_name
from aiorts.model.options import chosen_options, link_options
from aiorts.model.policy import Dataflow, OnLinkLost
from aiorts.services import is_service
from aiorts.wire import LINK, MsgpackCodec

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector

_LOG: Final = KernelLog()
_report: Final = partial(_LOG.warning, "W-LINK: %s")
_ASK_SECONDS: Final = 2.0
_FIRST_SECONDS: Final = 5.0
"""How long `connect` waits at the most for what the other kernel answers."""
_RETRY: Final = (0.2, 0.4, 0.8, 1.6, 2.0)
"""Seconds until an offer without an answer is made again."""
_AT_ONCE: Final = 64
"""Links that are offered to one kernel at once: of thousands, the last would have no answer in time."""
_READ_SECONDS: Final = 0.05
"""How often it is looked whether a connector without a writer was read empty."""
_BY_ONE: Final = 10_000
"""Connectors of this kernel that another one may have made."""
_BY_ALL: Final = 20_000
"""Connectors of this kernel that others may have made, all together."""
_LAST_SECONDS: Final = 1.0
"""How long a kernel that ends waits for acknowledgements."""


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
        self._writers: dict[Connector, WriterLink] = {}
        self._readers: dict[Connector, ReaderLink] = {}
        self._own: set[Link] = set()
        """Those that this kernel has connected, and not the other one."""
        self._made: Counter[str] = Counter()
        """How many each of the others has connected, by its name."""
        self._asking: set[Link] = set()
        self._turns: defaultdict[Peer, asyncio.Semaphore] = defaultdict(partial(asyncio.Semaphore, _AT_ONCE))
        """Held by each link that is being offered anew, by its other kernel."""
        self._tried: dict[Link, int] = {}
        """How often a link was offered in vain since it was up last."""
        self._first: dict[Link, asyncio.Future[None]] = {}
        """Done with the first answer, or with what refused it."""
        self._expected = NamedEnds()
        """Reader's ends whose writer was asked to offer, by writer and reader."""
        self._offers = NamedEnds()
        """Reader's ends by the writer's kernel and its name of the link."""
        self._ends = EndsByComponent()
        self._number = int.from_bytes(os.urandom(3), "big")
        self._accepting = False
        self.calls, self._serving = Calls(self), Serving(self)
        self._ledgers = Ledgers(self, self._writers, self._offers)
        self._arrivals, self._departures = Arrivals(self), Departures(self, self._all, self._own, self._ended)
        self.reach = Reach(self, self._handlers, self._present, self._waits_again)
        """The other kernels, and the transports that reach them."""
        kernel.connections.far = self
        kernel.bus.subscribe(Disconnected, self.calls.disconnected)

    def owns(self, connector: Connector) -> bool:
        """Whether another kernel has connected it: not saved, and nothing that a plan looks at."""
        return any(link not in self._own for link in self._links_of(connector))

    def report(self) -> Mapping[str, Any]:
        """The state of each link, by the name of its connector."""
        now = self.kernel.clock.monotonic_ns()
        data: dict[str, str] = {}
        for one in self._all():
            connector, said = one.connector, f"{one.end.state(now)}{f': {one.why}' if one.why else ''}"
            if not (connector.in_.is_tap or connector.out.is_tap):
                before = data.get(connector.name, said)
                data[connector.name] = said if said == before else f"{before}; {said}"
        return data | self.calls.report()

    async def ledger(self, connector: Connector, within: float = _ASK_SECONDS) -> LinkLedger:
        """The ledger of a link from end to end, asked for at either end; the other kernel answers in `within` seconds.

        Raises:
            LinkError: it does not answer, or the connector is none of a link.
        """
        if not (links := self._links_of(connector)):
            raise LinkError(f"{connector.name}: ledger: both ports are in this kernel; look at its statistics")
        writer, reader = self._writers.get(connector), self._readers.get(connector)
        if writer is not None and reader is not None:
            return await self._ledgers.through(reader, writer, within)
        return await self._ledgers.of(links[0], within)

    async def up(self, connectors: Iterable[Connector], within: float) -> None:
        """Wait until the writers of these connectors are linked with them, or so many seconds have passed."""
        until = self.kernel.loop.time() + within
        waiting = [link for one in connectors if (link := self._readers.get(one)) is not None]
        while any(not link.is_connected for link in waiting) and self.kernel.loop.time() < until:  # noqa: ASYNC110
            await asyncio.sleep(0.005)

    # -- opening ---------------------------------------------------------------------------------------------------

    def configure(self, settings: LinksSettings) -> None:
        if settings.name:
            check_name(settings.name, "[links]: kernel")  # no other kernel would take it
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
        """The other kernels that are there."""
        return tuple(self.reach.peers)

    async def opened(self) -> None:
        """Wait until other kernels can be reached.

        Raises:
            LinkError: the transport cannot be opened; it is tried again while the kernel runs.
        """
        await self.reach.opened()

    def use(self, transport: Transport) -> None:
        """Carry links with this transport, which is not open yet; before anything else is done."""
        self.reach.use(transport)

    def _handlers(self) -> Mapping[str, Callable[[bytes, Caller], Awaitable[bytes]]]:
        """What other kernels may ask."""
        own = {"offer": self._offered, "request": self._requested, "come": self._come, "left": self._departures.left}
        return {**own, **self.calls.handlers(), **self._serving.handlers(), **self._ledgers.handlers()}

    def _waits_again(self) -> None:
        """Other kernels can be reached at last: what waits for one that is not there says so now."""
        for link in self._all():
            if link in self._own and not link.is_connected and self._peer(link) is None:
                link.why = self.absent(self.far_of(link))

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
        # A process of this kernel does what the writer's end does alone; another kernel is to be asked there.
        from_reader = not near or any(
            isinstance(end, FarOutPort) and isinstance(port, str) for end, port in zip(ends, ports, strict=True)
        )
        return ends, link_options(where, options, from_reader=from_reader, through=not near)

    def connector_made(self, connector: Connector) -> None:
        if self._links_of(connector):
            return  # it is in force again
        if isinstance(connector.in_, FarInPort):
            writer = self._write_end(connector)
            if not self._accepting or self._is_carried(writer):
                self._own.add(writer)
            self._start(writer)
        out = connector.out
        if isinstance(out, FarOutPort) and (not self._accepting or out.far.kernel in self.reach.carried):
            reader = self._read_end(connector)
            self._own.add(reader)
            self._expected.put((str(out.far), self._as_reader(connector.in_)), reader)
            self._start(reader)

    def connector_ended(self, connector: Connector) -> None:
        for link in self._links_of(connector):
            self._end(link)

    async def connect(
        self, connect: Callable[..., Awaitable[Any]], ports: Sequence[Any], options: Mapping[str, Any]
    ) -> Any:
        """Connect with `connect`; return when the other kernel, if it is there, has answered.

        Raises:
            LinkError: the transport cannot be opened.
            WiringError: as `Kernel.connect`, or the other kernel refused a connector; those of this call were ended.
        """
        for port in ports:
            if isinstance(port, str) and self.is_far(port):
                await self.reach.opened_for(Path.parse(port))
        made = await connect(*ports, **options)
        connectors = made.connectors if isinstance(made, Connection) else (made,)
        waits = [self._first[link] for one in connectors for link in self._links_of(one) if link in self._first]
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

    async def ask(self, peer: Peer, what: str, body: bytes, within: float) -> bytes:
        """See `Kernels.ask`."""
        return await self.reach.carrier(peer).ask(peer, what, body, within=within)

    def _all(self) -> list[Link]:
        return [*self._writers.values(), *self._readers.values()]

    def _links_of(self, connector: Connector) -> list[Link]:
        """Two where both ends are in other kernels."""
        found = self._writers.get(connector), self._readers.get(connector)
        return [link for link in found if link is not None]

    # -- one end of a link ---------------------------------------------------------------------------------------------

    def _write_end(self, connector: Connector) -> WriterLink:
        encode = self._codec.parts_encoder(connector.out.type)
        kind = PulledWriterLink if connector.profile.dataflow is Dataflow.PULL else WriterLink
        link = self._writers[connector] = kind(
            self.kernel,
            connector,
            new_epoch(),
            encode,
            lost=self._lost,
            unanswered=self._retry,
            ended=self._ended,
            report=_report,
        )
        self._ends.add(self.far_of(link), link)
        return link

    def _read_end(self, connector: Connector) -> ReaderLink:
        kind, shape = connector.in_.type, connector.in_.shape
        decode = self._codec.parts_decoder(kind)
        if shape is not None:
            decode = of_shape(decode, port_type(kind).check_shape, shape)
        pulls = connector.profile.dataflow is Dataflow.PULL
        link = self._readers[connector] = (PullingReaderLink if pulls else ReaderLink)(
            self.kernel, connector, new_epoch(), decode, lost=self._lost, ended=self._ended, report=_report
        )
        self._ends.add(self.far_of(link), link)
        return link

    def _start(self, link: Link) -> None:
        self._first[link] = self.kernel.loop.create_future()
        self.reach.open_for(self.far_of(link))
        self._try(link)
        if link not in self._asking:
            self._answer_first(link, None)
            self._waits(link)

    def _waits(self, link: Link) -> None:
        link.why = self.absent(self.far_of(link))
        _LOG.warning("W-LINK: %s: waits: %s", link.connector.name, link.why)

    def absent(self, path: Path) -> str:
        """See `Kernels.absent`."""
        return self.reach.absent(path)

    def far_of(self, link: Link) -> Path:
        """See `Kernels.far_of`."""
        port = link.connector.in_ if isinstance(link, WriterLink) else link.connector.out
        assert isinstance(port, FarInPort | FarOutPort)  # noqa: S101 - it is one of a link
        return port.far

    def _is_carried(self, link: Link) -> bool:
        return self.far_of(link).kernel in self.reach.carried

    def _lost(self, link: Link, why: str) -> None:
        connector = link.connector
        policy = connector.profile.on_link_lost
        _LOG.warning("W-LINK: %s: lost the link: %s", connector.name, why)
        if policy is OnLinkLost.DISCONNECT:
            self.kernel.connections.end(connector)
        elif policy is OnLinkLost.ERROR:
            self._fail(link, why)
        if isinstance(link, WriterLink):
            self._retry(link)

    def _fail(self, link: Link, why: str) -> None:
        """Move the component at this end to error."""
        connector = link.connector
        port = connector.out if isinstance(link, WriterLink) else connector.in_
        component = self.kernel.components.get(port.path.partition(".")[0])
        if component is not None:
            error = LinkError(f"{connector.name}: lost the link: {why}")
            self.kernel.registry.task_failed(component, connector.name, error)

    def _ended(self, link: Link) -> None:
        """The other end was disconnected."""
        tell = _LOG.warning if link in self._own else _LOG.info  # whoever connected it may well disconnect it
        tell("W-LINK: %s: was disconnected by %s", link.connector.name, self.far_of(link))
        self._end_when_read(link)

    def _end_when_read(self, link: Link) -> None:
        """End the connector; one of a reader stays until what has come is read."""
        connector = link.connector
        if connector.closed or self.kernel.closed:
            return
        if isinstance(link, ReaderLink) and (link.busy or unread_of(connector)):
            self.kernel.call_later(_READ_SECONDS, lambda: self._end_when_read(link))
        else:
            self.kernel.connections.end(connector)

    def _end(self, link: Link) -> None:
        """Its connector has ended."""
        (self._writers if isinstance(link, WriterLink) else self._readers).pop(link.connector)
        far = self.far_of(link)
        self._ends.remove(far, link)
        self._departures.add(link, far)
        # The end of a kernel ends what it has connected; whoever connected from elsewhere waits for its return.
        link.close(for_good=link in self._own or not self.kernel.closed)
        if link in self._own:
            self._own.remove(link)
        else:
            self._made -= Counter((far.kernel,))
        self._answer_first(link, None)
        self._tried.pop(link, None)
        self._expected.forget(link)
        self._offers.forget(link)

    def _answer_first(self, link: Link, error: AiortsError | None) -> None:
        first = self._first.pop(link, None)
        if first is not None and not first.done():
            if error is None:
                first.set_result(None)
            else:
                first.set_exception(error)
                first.exception()  # whoever did not wait for it has read it in the log

    # -- offering ------------------------------------------------------------------------------------------------------

    def _present(self, peer: Peer, up: bool) -> None:
        self.calls.present(peer, up)
        if not up:
            self._serving.gone(peer)
            self._arrivals.gone(peer)
            self._end_unanswered(peer)
            self._turns.pop(peer, None)
            return
        self._departures.back(peer)
        for link in self._all():
            if self._peer(link) == peer:
                self._try(link)

    def _end_unanswered(self, peer: Peer) -> None:
        """End what a kernel that has gone connected, and never had a channel for."""
        for link in self._all():
            if link not in self._own and not link.end.peer_epoch and self.far_of(link).kernel == peer.kernel:
                self.kernel.connections.end(link.connector)

    def _check_made(self, path: Path) -> None:
        """WiringError: another kernel has connected too many of its ports here to connect this one, too."""
        if self._made[path.kernel] >= _BY_ONE or self._made.total() >= _BY_ALL:
            raise WiringError(f"{path}: other kernels have made {self._made.total():,} connectors; no more are made")

    def _peer(self, link: Link) -> Peer | None:
        return self.peer_of(self.far_of(link))

    def peer_of(self, path: Path) -> Peer | None:
        """See `Kernels.peer_of`."""
        return self.reach.peer_of(path)

    def _try(self, link: Link) -> None:
        """Offer it, or ask the writer's kernel to, unless that is under way, or the other kernel is not there."""
        if link.is_connected or link in self._asking or (isinstance(link, ReaderLink) and link not in self._own):
            return
        peer = self._peer(link)
        if peer is None and not self.reach.is_opening:
            return
        self._asking.add(link)
        self.run(self._ask(link), f"aiorts link {link.connector.name}")

    async def _ask(self, link: Link) -> None:
        will_be_offered = False
        try:
            await self.reach.opened_for(self.far_of(link))
            peer = self._peer(link)
            if link not in self._links_of(link.connector):
                return
            if peer is None:
                return self._waits(link) if link in self._own else None
            # Where somebody waits for the first answer, thousands of others that are offered anew hold nothing up.
            async with nullcontext() if link in self._first else self._turns[peer]:
                if link not in self._links_of(link.connector) or link.is_connected:
                    return
                if isinstance(link, WriterLink):
                    await self._offer(link, peer)
                else:
                    will_be_offered = await self._request(link, peer)
        except LinkError as error:
            link.why = str(error)
            self._retry(link)
        finally:
            self._asking.discard(link)
            if not will_be_offered:
                self._answer_first(link, None)

    def _retry(self, link: Link) -> None:
        tried = self._tried[link] = self._tried.get(link, 0) + 1
        self.run(self._try_again(link, _RETRY[min(tried, len(_RETRY)) - 1]), f"aiorts retry {link.connector.name}")

    async def _try_again(self, link: Link, seconds: float) -> None:
        await self.kernel.sleep(seconds)
        if link in self._links_of(link.connector):
            self._try(link)

    async def _offer(self, link: WriterLink, peer: Peer) -> None:
        if refused := self.reach.refusal(peer, READ, link.connector.out):
            return self._not_now(link, Answer(refused=refused), self.reached_as)
        offer = link.offer(self.path_of(link.connector.out, peer), self.far_of(link))
        answer = await self._question(peer, "offer", offer.to_bytes())
        if not answer.number:
            return self._not_now(link, answer)
        version = versions.agreed(peer.kernel, answer.protocol)
        agreed = replace(offer, protocol=(version, version), reader_epoch=answer.epoch, number=answer.number)
        agreed = replace(agreed, reader=replace(offer.reader, host=peer.host))
        channel = await self.reach.carrier(peer).channel(agreed, link)
        if self._writers.get(link.connector) is not link:
            channel.close()
            await self._departures.tell(peer, answer.epoch)
            return None
        self._tried.pop(link, None)
        link.connect(channel, answer.number, answer.epoch)
        return None

    async def _request(self, link: ReaderLink, peer: Peer) -> bool:
        """Ask the writer's kernel for an offer; returns whether it will make one."""
        connector = link.connector
        options = chosen_options(connector.profile)
        request = LinkRequest(str(self.far_of(link)), self._as_reader(connector.in_, peer), options, versions.SPOKEN)
        answer = await self._question(peer, "request", request.to_bytes())
        if answer.absent or answer.refused:
            self._not_now(link, answer)
            return False
        return not link.is_connected

    async def _question(self, peer: Peer, what: str, body: bytes) -> Answer:
        """The answer of another kernel; where it speaks no version of this one, that is why it is refused."""
        answer = Answer.from_bytes(await self.ask(peer, what, body, _ASK_SECONDS))
        try:
            versions.agreed(peer.kernel, answer.protocol)
        except WiringError as error:
            return Answer(refused=str(error))
        return answer

    def _not_now(self, link: Link, answer: Answer, by: str = "") -> None:
        connector = link.connector
        link.why = answer.refused or answer.absent
        if answer.absent:
            _LOG.warning("W-LINK: %s: waits: %s", connector.name, answer.absent)
            return
        self._answer_first(link, WiringError(f"{connector.out.path} -> {connector.in_.path}: {answer.refused}"))
        _LOG.error("%s: refused by %s: %s", connector.name, by or self.far_of(link).kernel, answer.refused)
        self.kernel.connections.end(connector)

    # -- answering -------------------------------------------------------------------------------------------------

    async def _offered(self, body: bytes, caller: Caller) -> bytes:
        """The answer to an offer of another kernel."""
        offer = None
        try:
            version = versions.agreed(name_of(caller), versions_of(body))
            offer = replace(LinkOffer.from_bytes(body), protocol=(version, version))
            answer, link = self._accept(offer, caller)
        except WiringError as error:
            expected = None if offer is None else self._awaited(offer, caller)
            if expected is not None and self._peer(expected) == caller.peer:
                self._not_now(expected, Answer(refused=str(error)), self.reached_as)
                return sent(Answer(refused=str(error)))  # it is in the log, as that of the connector
            return refusal("an offer", caller, error)
        if (asked := link or self._awaited(offer, caller)) is not None:
            self._answer_first(asked, None)  # also where it has to come again, since the reader does not run yet
        if link is not None:
            writer = replace(offer.writer, host="" if caller.peer is None else caller.peer.host)
            agreed = replace(offer, writer=writer, reader_epoch=answer.epoch, number=answer.number)
            self.run(self._join(link, agreed, caller.peer), "aiorts link")
        return sent(answer)

    def _accept(self, offer: LinkOffer, caller: Caller) -> tuple[Answer, ReaderLink | None]:
        check_theirs(offer.writer, caller)
        writer = replace(offer.writer, host=self.reach.host_of(caller.peer))
        key = (f"{writer.host}/{writer.kernel}", offer.link)
        link = self._offers.get(key) or self._awaited(offer, caller)
        found: Any = None if link is None else self._awaits(link, caller)
        found = found or self.there(offer.reader, caller, WRITE)
        if isinstance(found, Answer):
            return found, None
        if not isinstance(found, InPort):
            raise WiringError(f"{offer.reader}: is no in-port")
        schema, text = layout_of(found.type)
        if offer.schema != schema:
            raise WiringError(f"types differ: {difference(offer.type_text, text) or 'their hashes differ'}")
        if link is None or not is_end(link.connector.in_, found):
            self._check_made(offer.writer)
            link = self._new_reader(replace(offer, writer=writer), found)
            self._made[offer.writer.kernel] += 1
        self._offers.put(key, link)  # which may have had another name there
        self._number = self._number % 0xFFFFFFFF + 1
        return Answer(number=self._number, epoch=link.end.epoch), link

    def _awaited(self, offer: LinkOffer, caller: Caller) -> ReaderLink | None:
        """The reader's end that expects this offer, with the writer's host in its path or without."""
        hosts = ("",) if caller.peer is None else ("", caller.peer.host)
        reader = str(replace(offer.reader, host="", kernel=self.reached_as))
        ends = [(str(replace(offer.writer, host=host)), reader) for host in hosts]
        return next(filter(None, map(self._expected.get, ends)), None)

    def _awaits(self, link: ReaderLink, caller: Caller) -> InPort[Any] | None:
        """The reader of a link that this kernel has asked this caller for, where no component has it."""
        in_ = link.connector.in_
        return in_ if (in_.is_tap or in_.is_far) and link in self._own and self._peer(link) == caller.peer else None

    def _new_reader(self, offer: LinkOffer, in_: InPort[Any]) -> ReaderLink:
        out = far_port(self.kernel, in_, offer.writer, offer.unit, offer.shape)
        self._accepting = True
        try:
            (connector,) = self.kernel.connections.make((out, in_), reader_options(offer.profile))
        finally:
            self._accepting = False
        return self._read_end(connector)

    async def _join(self, link: ReaderLink, offer: LinkOffer, peer: Peer | None) -> None:
        try:
            channel = await self.reach.carrier(peer).channel(offer, link)
        except LinkError as error:
            link.why = str(error)
            return
        if self._readers.get(link.connector) is not link:
            channel.close()
            return
        link.connect(channel, offer.number, offer.writer_epoch)

    async def _requested(self, body: bytes, caller: Caller) -> bytes:
        """The answer to another kernel that wants one of its in-ports to be connected with an out-port of this one."""
        try:
            versions.agreed(name_of(caller), versions_of(body))
            return sent(self._connected(LinkRequest.from_bytes(body), caller))
        except WiringError as error:
            return refusal("a request", caller, error)

    def _connected(self, request: LinkRequest, caller: Caller) -> Answer:
        try:
            reader = Path.parse(request.reader)
        except AiortsError as error:
            raise WiringError(str(error)) from None
        check_theirs(reader, caller)
        found = self.there(Path.parse(request.writer), caller, READ)
        if isinstance(found, Answer):
            return found
        if not isinstance(found, OutPort):
            raise WiringError(f"{request.writer}: is no out-port")
        full = replace(reader, host=self.reach.host_of(caller.peer))
        for link in self._ends.at(reader.component):
            is_writer = isinstance(link, WriterLink) and is_end(link.connector.out, found)
            if is_writer and self.far_of(link) in (reader, full):
                self._try(link)
                return Answer()
        self._accepting = True
        try:
            self._check_made(reader)
            self.kernel.connections.make((found, str(full)), request.options)
            self._made[reader.kernel] += 1
        except AiortsError as error:
            raise WiringError(str(error)) from None
        finally:
            self._accepting = False
        return Answer()

    def there(self, path: Path, caller: Caller, right: str) -> Port[Any] | Answer:
        return self._arrivals.there(path, caller, right)

    def making(self) -> AbstractContextManager[None]:
        return self._arrivals.making()

    def component_added(self, component: Component) -> None:
        self._arrivals.added(component.name)

    def started(self) -> None:
        self._arrivals.started()

    async def _come(self, body: bytes, caller: Caller) -> bytes:
        """A component has come that links of this kernel waited for."""
        component = body.decode(errors="replace")
        for link in self._ends.at(component):
            if caller.peer is not None and self.far_of(link).kernel == caller.peer.kernel:  # by whatever way
                if link in self._asking:
                    self._retry(link)  # the answer that it was not there has come, and was not looked at yet
                self._try(link)
        self.calls.come(component, caller.peer)
        return b""

    # -- ending --------------------------------------------------------------------------------------------------------

    async def ending(self, budget: StopBudget) -> None:
        """Wait until what was written is acknowledged, for a short time."""
        until = self.kernel.loop.time() + min(_LAST_SECONDS, budget.rest)
        loop, ends = self.kernel.loop, self._writers.values()
        while loop.time() < until and any(one.is_connected and one.busy for one in ends):  # noqa: ASYNC110
            await asyncio.sleep(0.005)

    def stopped(self) -> None:
        for link in self._all():
            link.close(for_good=link in self._own)
        self.calls.stopped()
        self._serving.stopped()
        for task in self._tasks:
            task.cancel()

    async def leaving(self, budget: StopBudget) -> None:
        await self.reach.close()

    # -- helpers -------------------------------------------------------------------------------------------------------

    def run(self, coroutine: Any, name: str) -> asyncio.Task[Any]:
        task = kernel_task(self.kernel.loop, coroutine, name)
        self._tasks.add(task)
        task.add_done_callback(self._done)
        return task

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _LOG.error("links: %s failed: %s", task.get_name(), format_error(error), exc_info=error)

    def path_of(self, port: Port[Any], peer: Peer | None = None) -> Path:
        return replace(Path.parse(port.path), kernel=self.reach.name_for(peer))

    def _as_reader(self, port: InPort[Any], peer: Peer | None = None) -> str:
        """What the kernel of the writer is told that this in-port is, which may stand for one of a third kernel."""
        if isinstance(port, FarInPort) and "/" in port.path:
            name = f"{port.far.kernel}-{port.far.component}"[:MAX_NAME_LENGTH]
            return str(replace(port.far, host="", kernel=self.reach.name_for(peer), component=name))
        return str(self.path_of(port, peer))
