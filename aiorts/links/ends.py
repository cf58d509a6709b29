"""The ends of links: each carries out what the table of its negotiation says, and tells the table what came of it.

`Ends` finds an end by its connector, by the component at its other end, or by the names in its offer.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Generic, TypeAlias, TypeVar

from aiorts.errors import AiortsError, LinkError, StateError, WiringError, format_error
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.ports.connector import unread_of
from aiorts.kernel.ports.far import FarInPort, FarOutPort
from aiorts.kernel.ports.port_types import port_type
from aiorts.links.arrivals import Departure
from aiorts.links.messages import Answer, LinkRequest
from aiorts.links.pulling import PulledWriterLink, PullingReaderLink
from aiorts.links.reaching import new_epoch
from aiorts.links.reader_link import ReaderLink, of_shape
from aiorts.links.writer_link import WriterLink
from aiorts.model.links import READ, versions
from aiorts.model.links.negotiation import LinkAction, LinkEvent, LinkRole, Negotiation, NegotiationState
from aiorts.model.names import MAX_NAME_LENGTH, Path
from aiorts.model.options import chosen_options
from aiorts.model.policy import Dataflow, OnLinkLost
from aiorts.observe import Introspection

if TYPE_CHECKING:
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.ports import InPort, Port
    from aiorts.kernel.ports.connector import Connector
    from aiorts.links.arrivals import Departures
    from aiorts.links.kernels import Kernels
    from aiorts.links.transport import Channel, LinkOffer, Peer
    from aiorts.wire import MsgpackCodec

_LOG: Final = KernelLog()
_ASK_SECONDS: Final = 2.0
_OPEN_SECONDS: Final = 2.0
"""The most seconds in which a transport makes a channel."""
_READ_SECONDS: Final = 0.05
"""Seconds between two checks whether a connector without listeners has been read empty."""
_BY_ONE: Final = 10_000
"""The most connectors of this kernel that one other kernel may have made."""
_BY_ALL: Final = 20_000
"""The most connectors of this kernel that all other kernels together may have made."""
_GIVEN_UP: Final = 1_000
"""The most disconnected reader's ends that are remembered because the offers that they requested are still to come."""
_RECONNECTS: Final = 10.0
"""Seconds in which a kernel that was restarted connects again what it had connected before."""
_READERS: Final = 256
"""The most connectors that others may have made with one out-port: every write goes to all (2 ms with 1,000)."""
_LAST_SECONDS: Final = 1.0
"""The most seconds to wait for acknowledgements at an end."""
Name: TypeAlias = tuple[str, str]
Side = TypeVar("Side", bound="WriterLink | ReaderLink", covariant=True)


class LinkEnd(Generic[Side]):
    """One end of a link in its kernel: its connector, its state, and its names elsewhere.

    Args:
        far: the port at the other end.
        own: whether this kernel, not the other one, has made the connector.
        link: makes the side of the link that carries the samples.
        departures: tells other kernels of ends that were disconnected here.
    """

    def __init__(
        self,
        links: Kernels,
        connector: Connector,
        far: Path,
        role: LinkRole,
        *,
        own: bool,
        link: Callable[..., Side],
        departures: Departures,
    ) -> None:
        self.connector, self.far, self.own = connector, far, own
        self.negotiation = Negotiation(role)
        self.link: Side = link(links.kernel, connector, new_epoch(), self)
        self.first: asyncio.Future[None] = links.kernel.loop.create_future()
        """Done with the first answer, or failed with its refusal."""
        self._links, self._departures = links, departures
        self._peer: Peer | None = None
        """The kernel that was asked last, or whose offer was accepted last."""
        self._offer: LinkOffer | None = None
        """The offer that both ends have agreed on last."""
        self._channel: Channel | None = None
        """A channel that was made and is not in use yet."""
        self._opening: asyncio.Task[Any] | None = None
        self._late = 0
        """The epoch of the other end in an answer that came too late."""
        self._unheard = False
        """Whether the last offer has had no answer: the other kernel may have taken it."""
        self._timer: Cancellable | None = None
        self._watchers: list[asyncio.Future[None]] = []
        self.requested = False
        """Whether the writer's kernel was asked for an offer, and has not declined."""
        self._refused_by = ""
        self._said = ""
        """The last logged reason to wait, since the link was last up."""

    # -- what happens ----------------------------------------------------------------------------------------------

    def on(self, event: LinkEvent, why: str = "") -> None:
        """Handle an event: carry out the negotiation's actions. `why`: the reason that the link is not up."""
        if why:
            self.link.why = why
        step = self.negotiation.step
        actions = self.negotiation.on(event)
        if step != self.negotiation.step:
            self._set_timer()
        for action in actions:
            _CARRIED_OUT[action](self)
        if self.negotiation.is_answered:
            self.answer_first(None)
        if self._watchers and self.negotiation.state in (NegotiationState.UP, NegotiationState.ENDED):
            watchers, self._watchers = self._watchers, []
            for one in watchers:
                if not one.done():
                    one.set_result(None)

    def _on_step(self, step: int, event: LinkEvent, why: str = "") -> None:
        """Handle the outcome of work that was begun in a step, unless a later step has come."""
        if step == self.negotiation.step:
            self.on(event, why)

    def present(self, peer: Peer) -> None:
        """Handle the arrival of a kernel that has the name of the one at the other end."""
        if self._links.peer_of(self.far) != peer:
            return
        if not self.own and self._peer not in (None, peer) and self.negotiation.state is NegotiationState.ABSENT:
            # A restarted peer may be about to connect the link itself, and would be told that it is connected already.
            self._links.kernel.call_later(_RECONNECTS, partial(self._present_still, peer))
        else:
            self.on(LinkEvent.PRESENT)

    def _present_still(self, peer: Peer) -> None:
        if self.negotiation.state is NegotiationState.ABSENT and self._links.peer_of(self.far) == peer:
            self.on(LinkEvent.PRESENT)

    def gone(self, peer: Peer) -> None:
        """Handle the end of a kernel that has the name of the one at the other end."""
        # A link that is agreed with another kernel of this name, or has a channel to that, goes on.
        if self.negotiation.state is NegotiationState.UP:
            if self._peer == peer:  # the transport may say in this moment how its channel was lost
                self._links.kernel.loop.call_soon(self._left_alone, self.negotiation.step, peer)
        elif self.negotiation.state is not NegotiationState.OFFERED or self._peer == peer:
            self._gone("")

    def _left_alone(self, step: int, peer: Peer) -> None:
        now = self.negotiation
        if now.step == step:
            self._gone(f"{peer.kernel}: is gone")
        elif now.step == step + 1 and now.state is NegotiationState.WAITING:  # lost
            self._gone("")

    def _gone(self, why: str) -> None:
        self.on(LinkEvent.GONE, why)
        if (peer := self._links.peer_of(self.far)) is not None:
            self.present(peer)  # the kernel may be back before its former process has gone

    def refused(self, why: str, by: str = "") -> None:
        """The link is refused: `connect` fails with this reason.

        Args:
            by: the kernel that refuses it; "" for the other kernel.
        """
        connector, self._refused_by = self.connector, by or self.far.kernel
        self.answer_first(WiringError(f"{connector.out.path} -> {connector.in_.path}: {why}"))
        self.on(LinkEvent.REFUSED, why)

    def offered(self, offer: LinkOffer, peer: Peer | None) -> None:
        """Handle an offer that was accepted; the answer to the offer says so."""
        self._offer, self._peer, self.requested = offer, peer, False
        self.on(LinkEvent.OFFER)

    @property
    def writer_epoch(self) -> int:
        """The epoch of the writer's end in the last accepted offer; 0: there is none."""
        return 0 if self._offer is None else self._offer.writer_epoch

    def left(self) -> None:
        """Handle the news that the other end was disconnected."""
        tell = _LOG.warning if self.own else _LOG.info  # the kernel that connected it may well disconnect it
        tell("W-LINK: %s: was disconnected by %s", self.connector.name, self.far)
        self.on(LinkEvent.LEFT)

    def lost(self, why: str) -> None:
        """Handle a channel that went down."""
        self.on(LinkEvent.LOST, why)

    def silent(self) -> None:
        """Handle a channel that was given up: no acknowledgement has come on it."""
        self.on(LinkEvent.SILENT)

    def _set_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if (pause := self.negotiation.pause) is not None:
            due = partial(self._on_step, self.negotiation.step, LinkEvent.DUE)
            self._timer = self._links.kernel.call_later(pause, due)

    def is_at(self, host: str) -> bool:
        """Whether the kernel at the other end may be on this host."""
        return self.far.host.lower() in ("", "localhost", host.lower())

    def answer_first(self, error: AiortsError | None) -> None:
        """Settle the first answer: `connect` goes on, or fails with the error."""
        if not self.first.done():
            if error is None:
                self.first.set_result(None)
            else:
                self.first.set_exception(error)
                self.first.exception()  # a caller that did not wait has it in the log

    def up(self) -> asyncio.Future[None]:
        """A future that is done when there is a channel, or never will be."""
        found: asyncio.Future[None] = self._links.kernel.loop.create_future()
        if self.negotiation.state in (NegotiationState.UP, NegotiationState.ENDED):
            found.set_result(None)
        else:
            self._watchers = [one for one in self._watchers if not one.done()]
            self._watchers.append(found)
        return found

    # -- what is carried out ---------------------------------------------------------------------------------------

    def _ask(self) -> None:
        reach = self._links.reach
        reach.open_for(self.far)
        if reach.peer_of(self.far) is None and not reach.is_opening:
            self.on(LinkEvent.MISSING)
        else:
            self._links.run(self._asked(self.negotiation.step), f"aiorts link {self.connector.name}")

    async def _asked(self, step: int) -> None:
        try:
            await self._links.reach.opened_for(self.far)
            peer = self._links.reach.peer_of(self.far)
            if step != self.negotiation.step:
                return None
            self._peer = peer
            if peer is None:
                return self._on_step(step, LinkEvent.MISSING)
            # A call of `connect` waits for the first answer, and not for thousands of links that are offered again.
            async with self._links.turn(peer) if self.first.done() else nullcontext():
                if step == self.negotiation.step:
                    await (self._make_offer if isinstance(self.link, WriterLink) else self._request)(step, peer)
        except Exception as error:  # noqa: BLE001 - whatever a transport raises, a link that is not tried again is lost
            self._on_step(step, LinkEvent.UNANSWERED, self._fault_of(error))
        return None

    def _fault_of(self, error: Exception) -> str:
        """The text of an error. An error other than LinkError is a transport's fault: it is logged, too."""
        if not isinstance(error, LinkError):
            _LOG.error("links: %s failed: %s", self.connector.name, format_error(error), exc_info=error)
        return str(error) if isinstance(error, AiortsError) else format_error(error)

    async def _make_offer(self, step: int, peer: Peer) -> None:
        assert isinstance(self.link, WriterLink)  # noqa: S101 - a reader's end requests
        if refusal := self._links.reach.refusal(peer, READ, self.connector.out):
            return self.refused(refusal, self._links.reached_as)
        offer = self.link.offer(self._links.path_of(self.connector.out, peer), self.far)
        offer = replace(offer, number=next(self._links.numbers))
        self._unheard = True
        answer = await self._question(peer, "offer", offer.to_bytes())
        self._unheard = False
        if step != self.negotiation.step:
            return self._came_late(answer.epoch) if answer.number else None
        if not answer.number:
            return self._not_now(step, answer)
        version = versions.agreed(peer.kernel, answer.protocol)
        agreed = replace(offer, protocol=(version, version), reader_epoch=answer.epoch, number=answer.number)
        self._offer = replace(agreed, reader=replace(offer.reader, host=peer.host))
        self.on(LinkEvent.AGREED)
        if self._opening is not None:
            await asyncio.wait((self._opening,))  # it is this link's turn until then
        return None

    async def _request(self, step: int, peer: Peer) -> None:
        options = chosen_options(self.connector.profile)
        request = LinkRequest(str(self.far), self.reader_path(peer), options, versions.SPOKEN)
        self.requested = True
        answer = await self._question(peer, "request", request.to_bytes())
        if answer.absent or answer.refused:
            self.requested = False
            self._not_now(step, answer)
        else:
            self._on_step(step, LinkEvent.PROMISED)

    async def _question(self, peer: Peer, what: str, body: bytes) -> Answer:
        """The answer of another kernel; a refusal if both share no version of the protocol."""
        answer = Answer.from_bytes(await self._links.ask(peer, what, body, _ASK_SECONDS))
        try:
            versions.agreed(peer.kernel, answer.protocol)
        except WiringError as error:
            return Answer(refused=str(error))
        return answer

    def _not_now(self, step: int, answer: Answer) -> None:
        if step != self.negotiation.step:
            return
        if answer.absent:
            self.on(LinkEvent.LACKING, answer.absent)
        else:
            self.refused(answer.refused)

    def _came_late(self, epoch: int) -> None:
        self._late = epoch
        self.on(LinkEvent.LATE)

    def _open(self) -> None:
        name = f"aiorts link {self.connector.name}"
        self._opening = self._links.run(self._opened(self.negotiation.step, self._peer, self._offer), name)

    async def _opened(self, step: int, peer: Peer | None, offer: LinkOffer | None) -> None:
        assert offer is not None  # noqa: S101 - both ends have agreed on it
        try:
            async with asyncio.timeout(_OPEN_SECONDS):
                channel = await self._links.reach.carrier(peer).channel(offer, self.link)
        except TimeoutError:
            return self._on_step(step, LinkEvent.UNMADE, f"{self.far.kernel}: no channel within {_OPEN_SECONDS:g} s")
        except Exception as error:  # noqa: BLE001 - as above
            return self._on_step(step, LinkEvent.UNMADE, self._fault_of(error))
        if step != self.negotiation.step:
            channel.close()
            if peer is not None:
                self._came_late(offer.reader_epoch)
            return None
        self._channel = channel
        return self.on(LinkEvent.MADE)

    def _connect(self) -> None:
        offer, channel = self._offer, self._channel
        self._channel, self._said = None, ""
        assert offer is not None and channel is not None  # noqa: S101, PT018 - they were made
        epoch = offer.reader_epoch if isinstance(self.link, WriterLink) else offer.writer_epoch
        self.link.connect(channel, offer.number, epoch)

    def _drop(self) -> None:
        self.link.drop(self.link.why or "it is offered anew")

    def _say_waits(self) -> None:
        if self.negotiation.state is NegotiationState.ABSENT:
            self.link.why = self._links.reach.absent(self.far)
        if self.link.why != self._said:
            self._said = self.link.why
            _LOG.warning("W-LINK: %s: waits: %s", self.connector.name, self._said)

    def say_absent(self) -> None:
        """Note that the link waits for an absent kernel, now that other kernels can be reached at last."""
        if self.own and self.negotiation.state is NegotiationState.ABSENT:
            self.link.why = self._links.reach.absent(self.far)

    def _lose(self) -> None:
        _LOG.warning("W-LINK: %s: lost the link: %s", self.connector.name, self.link.why)
        policy = self.connector.profile.on_link_lost
        if policy is OnLinkLost.DISCONNECT:
            self._end()
        elif policy is OnLinkLost.ERROR:
            self._fail()

    def _fail(self) -> None:
        """Move the component at this end to error."""
        connector, kernel = self.connector, self._links.kernel
        port = connector.out if isinstance(self.link, WriterLink) else connector.in_
        component = kernel.components.get(port.path.partition(".")[0])
        if component is not None:
            error = LinkError(f"{connector.name}: lost the link: {self.link.why}")
            kernel.registry.task_failed(component, connector.name, error)

    def _refuse(self) -> None:
        _LOG.error("%s: refused by %s: %s", self.connector.name, self._refused_by, self.link.why)
        self._end()

    def _abandon(self) -> None:
        if not self.own and not self.link.end.peer_epoch:
            self._end()

    def _end(self) -> None:
        self._links.kernel.connections.end(self.connector)

    def _read_out(self) -> None:
        """End the connector; a reader's connector stays until all samples that have come are read."""
        connector, kernel = self.connector, self._links.kernel
        if connector.closed or kernel.closed:
            return
        if not isinstance(self.link, ReaderLink) or not (self.link.busy or unread_of(connector)):
            self._end()
            return
        try:
            kernel.service(Introspection).listening.add(connector, self._look_whether_read, ())
            self.link.settled = self._look_whether_read
        except StateError:  # it is a tap, which the system does not know, or a real-time thread reads
            kernel.call_later(_READ_SECONDS, self._read_out)

    def _look_whether_read(self, _event: object = None) -> None:
        connector = self.connector
        if isinstance(self.link, ReaderLink) and not (connector.closed or self.link.busy or unread_of(connector)):
            self._end()

    def _close(self) -> None:
        # The end of a kernel ends what it has connected; links that other kernels connected wait for its return.
        self.link.close(for_good=self.own or not self._links.kernel.closed)

    def _depart(self) -> None:
        end = self.link.end
        epoch = end.peer_epoch
        if not epoch and self._offer is not None and isinstance(self.link, ReaderLink):
            epoch = self._offer.writer_epoch  # the writer's end has the answer to its offer, or will have it
        if self.own and (epoch or self._unheard) and not end.peer_ended and not self._links.kernel.closed:
            self._departed(epoch)

    def _tell_late(self) -> None:
        self._departed(self._late)

    def _departed(self, epoch: int) -> None:
        self._departures.add(Departure(self.far, self.connector.name, epoch, self.link.end.epoch))

    # -- its names -------------------------------------------------------------------------------------------------

    def reader_path(self, peer: Peer | None = None) -> str:
        """The path of the in-port as the writer's kernel knows it; the in-port may be a third kernel's."""
        port: InPort[Any] = self.connector.in_
        if isinstance(port, FarInPort) and "/" in port.path:
            name = f"{port.far.kernel}-{port.far.component}"[:MAX_NAME_LENGTH]
            return str(replace(port.far, host="", kernel=self._links.reach.name_for(peer), component=name))
        return str(self._links.path_of(port, peer))


_CARRIED_OUT: Final[Mapping[LinkAction, Callable[[LinkEnd[Any]], None]]] = {
    LinkAction.DROP: LinkEnd._drop,
    LinkAction.ASK: LinkEnd._ask,
    LinkAction.ABANDON: LinkEnd._abandon,
    LinkAction.REPORT: LinkEnd._say_waits,
    LinkAction.RETRY: lambda _: None,
    LinkAction.EXPECT: lambda _: None,
    LinkAction.LINGER: lambda _: None,
    LinkAction.OPEN: LinkEnd._open,
    LinkAction.CONNECT: LinkEnd._connect,
    LinkAction.LOSE: LinkEnd._lose,
    LinkAction.REFUSE: LinkEnd._refuse,
    LinkAction.READ_OUT: LinkEnd._read_out,
    LinkAction.CLOSE: LinkEnd._close,
    LinkAction.DEPART: LinkEnd._depart,
    LinkAction.TELL: LinkEnd._tell_late,
}
"""The method that carries out each action; none for pauses, whose timer is set with every step."""


def writer_end(
    links: Kernels, connector: Connector, codec: MsgpackCodec, departures: Departures, *, own: bool
) -> LinkEnd[WriterLink]:
    """The writer's end of a link."""
    port = connector.in_
    assert isinstance(port, FarInPort)  # noqa: S101 - it is one of a link
    kind = PulledWriterLink if connector.profile.dataflow is Dataflow.PULL else WriterLink
    cls = connector.out.type
    link = partial(kind, encode=codec.parts_encoder(cls), encode_all=codec.heads_encoder(cls))
    return LinkEnd(links, connector, port.far, LinkRole.OFFERS, own=own, link=link, departures=departures)


def reader_end(
    links: Kernels, connector: Connector, codec: MsgpackCodec, departures: Departures, *, own: bool
) -> LinkEnd[ReaderLink]:
    """The reader's end of a link."""
    port, kind, shape = connector.out, connector.in_.type, connector.in_.shape
    assert isinstance(port, FarOutPort)  # noqa: S101 - it is one of a link
    decode, decode_all = codec.parts_decoder(kind), codec.heads_decoder(kind)
    if shape is not None:
        decode, decode_all = of_shape(decode, port_type(kind).check_shape, shape), None
    side: Any = PullingReaderLink if connector.profile.dataflow is Dataflow.PULL else ReaderLink

    link = partial(side, decode=decode, decode_all=decode_all)
    role = LinkRole.REQUESTS if own else LinkRole.ANSWERS
    return LinkEnd(links, connector, port.far, role, own=own, link=link, departures=departures)


class NamedEnds:
    """Reader's ends by a name of two parts. An end has one name, the last that it was given; a name has one end."""

    def __init__(self) -> None:
        self._ends: dict[Name, LinkEnd[ReaderLink]] = {}
        self._names: dict[Connector, Name] = {}

    def get(self, name: Name) -> LinkEnd[ReaderLink] | None:
        """The end of this name."""
        return self._ends.get(name)

    def name_of(self, end: LinkEnd[Any]) -> Name | None:
        """The name of this end."""
        return self._names.get(end.connector)

    def put(self, name: Name, end: LinkEnd[ReaderLink]) -> None:
        """Give an end a name."""
        self.forget(end)
        if (before := self._ends.get(name)) is not None:
            del self._names[before.connector]
        self._ends[name], self._names[end.connector] = end, name

    def forget(self, end: LinkEnd[Any]) -> None:
        """Take the name of an end away."""
        if (name := self._names.get(end.connector)) is not None and self._ends[name] is end:
            del self._names[end.connector], self._ends[name]


class Ends:
    """The ends of one kernel, by each key of their look-ups; the state of an end is not kept here."""

    def __init__(self) -> None:
        self.writers: dict[Connector, LinkEnd[WriterLink]] = {}
        self.readers: dict[Connector, LinkEnd[ReaderLink]] = {}
        self.expected = NamedEnds()
        """Reader's ends whose writer is asked to offer, by writer and reader."""
        self.offered = NamedEnds()
        """Reader's ends by the writer's host and kernel, and its name of the link."""
        self._there: dict[str, dict[str, dict[LinkEnd[Any], None]]] = {}
        """All ends by the kernel at the other end, and the component there."""
        self.by_epoch: dict[int, LinkEnd[Any]] = {}
        self._by_ports: dict[tuple[str, str], dict[LinkEnd[WriterLink], None]] = {}
        """Writer's ends by their out-port and the port at the other end; several with `allow_duplicate`."""
        self._given_up: dict[Name, None] = {}
        """Reader's ends, by writer and reader, that asked for an offer and were disconnected before it came."""
        self._readers_of: Counter[str] = Counter()
        """The writer's ends that other kernels have made at each out-port, by its path."""
        self._made: Counter[str] = Counter()
        """The number of ends that each other kernel has connected, by its name."""

    def add(self, end: LinkEnd[Any]) -> None:
        """Add an end."""
        (self.writers if isinstance(end.link, WriterLink) else self.readers)[end.connector] = end
        self._there.setdefault(end.far.kernel, {}).setdefault(end.far.component, {})[end] = None
        self.by_epoch[end.link.end.epoch] = end
        if isinstance(end.link, WriterLink):
            self._by_ports.setdefault((_port_of(end.connector.out), str(end.far)), {})[end] = None
        if not end.own:
            self._made[end.far.kernel] += 1
            self._readers_of.update(_out_of(end))

    def remove(self, end: LinkEnd[Any]) -> None:
        """Remove an end."""
        del (self.writers if isinstance(end.link, WriterLink) else self.readers)[end.connector]
        kernel = self._there[end.far.kernel]
        component = kernel[end.far.component]
        del component[end], self.by_epoch[end.link.end.epoch]
        if not component:
            del kernel[end.far.component]
        if not kernel:
            del self._there[end.far.kernel]
        ports = _port_of(end.connector.out), str(end.far)
        if (between := self._by_ports.get(ports)) is not None and end in between:
            del between[end]
            if not between:
                del self._by_ports[ports]
        if end.requested and (name := self.expected.name_of(end)) is not None:
            self._given_up[name] = None
            if len(self._given_up) > _GIVEN_UP:
                del self._given_up[next(iter(self._given_up))]
        if not end.own:
            _take_one(self._made, end.far.kernel)
            for out in _out_of(end):
                _take_one(self._readers_of, out)
        self.expected.forget(end)
        self.offered.forget(end)

    def all(self) -> list[LinkEnd[Any]]:
        """All ends."""
        return [*self.writers.values(), *self.readers.values()]

    def of(self, connector: Connector) -> list[LinkEnd[Any]]:
        """The ends of a connector: two where both its ports are in other kernels."""
        found = self.writers.get(connector), self.readers.get(connector)
        return [end for end in found if end is not None]

    async def sent(self, connectors: Iterable[Connector], within: float = _LAST_SECONDS) -> None:
        """Wait until all samples of these connectors are acknowledged, but at most `within` seconds, and 1 s."""
        ends = [end for one in connectors if (end := self.writers.get(one)) is not None]
        waits = [idle for one in ends if (idle := one.link.idle()) is not None]
        if waits and within > 0:
            await asyncio.wait(waits, timeout=min(within, _LAST_SECONDS))

    def at(self, kernel: str, component: str | None = None) -> list[LinkEnd[Any]]:
        """The ends of links to kernels of this name, or to a component there."""
        there = self._there.get(kernel, {})
        return [end for name in (there if component is None else (component,)) for end in there.get(name, ())]

    def between(self, out: Port[Any], far: Path) -> LinkEnd[WriterLink] | None:
        """The writer's end from an out-port to a port of another kernel."""
        return next(iter(self._by_ports.get((_port_of(out), str(far)), ())), None)

    def expect(self, name: Name, end: LinkEnd[ReaderLink]) -> None:
        """Note, by writer and reader, that a reader's end asks its writer for an offer."""
        self._given_up.pop(name, None)
        self.expected.put(name, end)

    def was_given_up(self, name: Name) -> bool:
        """Whether a disconnected end had asked for an offer between these two ports; the end is then forgotten."""
        return self._given_up.pop(name, name) is None

    def check_made(self, path: Path) -> None:
        """Raise WiringError if other kernels have made too many connectors here to make one with this port."""
        if self._made[path.kernel] >= _BY_ONE or self._made.total() >= _BY_ALL:
            raise WiringError(f"{path}: other kernels have made {self._made.total():,} connectors; no more are made")

    def check_readers(self, out: str) -> None:
        """Raise WiringError if other kernels read this out-port over too many connectors to make one more."""
        if self._readers_of[out] >= _READERS:
            raise WiringError(f"{out}: other kernels have made {_READERS:,} connectors with it; no more are made")


def _port_of(port: Port[Any]) -> str:
    """The path of a port; for a stand-in the path of the third kernel's port."""
    return str(getattr(port, "far", None) or port.elsewhere or port.path)


def _out_of(end: LinkEnd[Any]) -> tuple[str, ...]:
    """The out-port of a writer's end; () for a reader's."""
    return (end.connector.out.path,) if isinstance(end.link, WriterLink) else ()


def _take_one(counts: Counter[str], name: str) -> None:
    """Lower the count of a name by one; forget the name at zero."""
    counts[name] -= 1
    if not counts[name]:
        del counts[name]
