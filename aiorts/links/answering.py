"""Answers to other kernels' questions about links, with the versions that this kernel speaks; a refusal is logged."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, LinkError, WiringError
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.ports.far import far_port
from aiorts.links.layout import difference, layout_of
from aiorts.links.messages import Answer, LinkRequest, fields, versions_of
from aiorts.links.reader_link import ReaderLink, reader_options
from aiorts.links.transport import LinkOffer
from aiorts.model.links import READ, WRITE, versions
from aiorts.model.links.negotiation import LinkEvent
from aiorts.model.names import Path

if TYPE_CHECKING:
    from aiorts.kernel.ports import Port
    from aiorts.kernel.ports.connector import Connector
    from aiorts.links.ends import Ends, LinkEnd
    from aiorts.links.kernels import Kernels
    from aiorts.links.transport import Caller

_LOG: Final = KernelLog()
_LONGEST: Final = 16_384
"""The most bytes of a connector's name, ports and options from another kernel; the connector keeps them."""


def name_of(caller: Caller) -> str:
    """The name of the caller's kernel; its identity where no kernel asks."""
    return caller.identity if caller.peer is None else caller.peer.kernel


def sent(answer: Answer) -> bytes:
    """The answer as one frame."""
    return replace(answer, protocol=versions.SPOKEN).to_bytes()


def refusal(what: str, caller: Caller, error: WiringError) -> bytes:
    """The answer that gives the reason of a refusal, which is logged."""
    _LOG.warning("W-LINK: refused %s of %s: %s", what, name_of(caller), error)
    return sent(Answer(refused=str(error)))


def _check_theirs(path: Path, caller: Caller) -> None:
    """Raise WiringError if the port is not in the kernel that asks."""
    if caller.peer is None or path.kernel != caller.peer.kernel:
        raise WiringError(f"{path}: is no port of {name_of(caller)}, which asks")


def _check_length(what: str, length: int) -> None:
    """Raise WiringError if a message about a connector is longer than this kernel keeps."""
    if length > _LONGEST:
        raise WiringError(f"{what} of {length:,} bytes; at most {_LONGEST:,} are allowed")


def _is_end(port: Port[Any], found: Port[Any]) -> bool:
    """Whether a connector's port is the found port, or stands for the found port."""
    return port is found or (found.elsewhere is not None and getattr(port, "far", None) == found.elsewhere)


class Answering:
    """The answers of one kernel to offers of links, requests for offers, and news of arrivals and disconnections.

    Args:
        read_end: makes the reader's end of a connector.
        start: the number before the first that this kernel gives to a channel.
    """

    def __init__(
        self, links: Kernels, ends: Ends, read_end: Callable[[Connector], LinkEnd[ReaderLink]], start: int
    ) -> None:
        self._links, self._ends, self._read_end, self._number = links, ends, read_end, start
        self.is_connecting = False
        """Whether a connector is being made because another kernel wants it."""

    def handlers(self) -> Mapping[str, Callable[[bytes, Caller], Awaitable[bytes]]]:
        """The questions that other kernels may ask, and what answers them."""
        return {"offer": self._offered, "request": self._requested, "come": self._come, "left": self._left}

    @contextmanager
    def _connecting(self) -> Iterator[None]:
        self.is_connecting = True
        try:
            yield
        finally:
            self.is_connecting = False

    # -- offers ----------------------------------------------------------------------------------------------------

    async def _offered(self, body: bytes, caller: Caller) -> bytes:
        """The answer to an offer of another kernel."""
        offer = None
        try:
            version = versions.agreed(name_of(caller), versions_of(body))
            offer = replace(LinkOffer.from_bytes(body), protocol=(version, version))
            _check_length("an offer without its type", len(body) - len(offer.type_text.encode()))
            answer, end = self._accept(offer, caller)
        except WiringError as error:
            expected = None if offer is None else self._expected(offer, caller)
            if expected is not None and self._is_of(expected, caller):
                expected.refused(str(error), self._links.reached_as)
                return sent(Answer(refused=str(error)))  # logged already, as the connector's refusal
            return refusal("an offer", caller, error)
        if end is not None:
            writer = replace(offer.writer, host="" if caller.peer is None else caller.peer.host)
            agreed = replace(offer, writer=writer, reader_epoch=answer.epoch, number=answer.number, type_text="")
            end.offered(agreed, caller.peer)
        elif (expected := self._expected(offer, caller)) is not None:
            expected.answer_first(None)  # the offer has to come again: the reader does not run yet
        return sent(answer)

    def _accept(self, offer: LinkOffer, caller: Caller) -> tuple[Answer, LinkEnd[ReaderLink] | None]:
        _check_theirs(offer.writer, caller)
        self._links.reach.carrier(caller.peer)  # LinkError: the caller is gone, or not found yet and has to ask again
        writer = replace(offer.writer, host=self._links.reach.host_of(caller.peer))
        # The end may have a name without a host: chance decides at each start which transport finds a kernel first.
        key = (caller.address, offer.link)
        end = before = self._ends.offered.get(key) or self._expected(offer, caller)
        if end is not None and not end.negotiation.takes_offers:
            end = None
        epoch = 0 if caller.peer is None else caller.peer.epoch
        if end is not None and end.negotiation.is_stale(epoch, offer.number):
            raise LinkError(f"{offer.link}: was offered again since")
        found: Any = None if end is None else self._awaits(end, caller)
        found = found or self._links.there(offer.reader, caller, WRITE)
        if isinstance(found, Answer):
            return found, None
        if not isinstance(found, InPort):
            raise WiringError(f"{offer.reader}: is no in-port")
        schema, text = layout_of(found.type)
        if offer.schema != schema:
            raise WiringError(f"types differ: {difference(offer.type_text, text) or 'their hashes differ'}")
        if end is None or not _is_end(end.connector.in_, found):
            if any(map(self._ends.was_given_up, self._names(offer, caller))):
                raise WiringError(f"{offer.reader}: was disconnected before this offer came, which it had asked for")
            self._ends.check_made(offer.writer)
            end = self._new_reader(replace(offer, writer=writer), found)
            end.negotiation.is_stale(epoch, offer.number)
            if before is not None and before.connector.in_ is found:
                end.link.take_over(before.link)
        self._ends.offered.put(key, end)  # the end may have had another name there
        self._number = self._number % 0xFFFFFFFF + 1
        return Answer(number=self._number, epoch=end.link.end.epoch), end

    def _expected(self, offer: LinkOffer, caller: Caller) -> LinkEnd[ReaderLink] | None:
        """The reader's end that expects this offer."""
        return next(filter(None, map(self._ends.expected.get, self._names(offer, caller))), None)

    def _names(self, offer: LinkOffer, caller: Caller) -> list[tuple[str, str]]:
        """The names (writer, reader) of an offer: without the writer's host, and with it."""
        hosts = ("",) if caller.peer is None else ("", caller.peer.host)
        reader = str(replace(offer.reader, host="", kernel=self._links.reached_as))
        return [(str(replace(offer.writer, host=host)), reader) for host in hosts]

    def _is_of(self, end: LinkEnd[Any], caller: Caller) -> bool:
        """Whether the other end is in the kernel that asks."""
        return self._links.peer_of(end.far) == caller.peer

    def _awaits(self, end: LinkEnd[ReaderLink], caller: Caller) -> InPort[Any] | None:
        """The in-port of a link that this kernel requested from the caller, if no component owns the in-port."""
        in_ = end.connector.in_
        return in_ if (in_.is_tap or in_.is_far) and end.own and self._is_of(end, caller) else None

    def _new_reader(self, offer: LinkOffer, in_: InPort[Any]) -> LinkEnd[ReaderLink]:
        out = far_port(self._links.kernel, in_, offer.writer, offer.unit, offer.shape)
        with self._connecting():
            (connector,) = self._links.kernel.connections.make((out, in_), reader_options(offer.profile))
        return self._ends.readers.get(connector) or self._read_end(connector)

    # -- requests --------------------------------------------------------------------------------------------------

    async def _requested(self, body: bytes, caller: Caller) -> bytes:
        """The answer to a request of another kernel to connect one of its in-ports with an out-port of this one."""
        try:
            versions.agreed(name_of(caller), versions_of(body))
            _check_length("a request", len(body))
            return sent(self._connect(LinkRequest.from_bytes(body), caller))
        except WiringError as error:
            return refusal("a request", caller, error)

    def _connect(self, request: LinkRequest, caller: Caller) -> Answer:
        try:
            reader = Path.parse(request.reader)
        except AiortsError as error:
            raise WiringError(str(error)) from None
        _check_theirs(reader, caller)
        found = self._links.there(Path.parse(request.writer), caller, READ)
        if isinstance(found, Answer):
            return found
        if not isinstance(found, OutPort):
            raise WiringError(f"{request.writer}: is no out-port")
        full = replace(reader, host=self._links.reach.host_of(caller.peer))
        hosts = dict.fromkeys((full.host, reader.host, "" if caller.peer is None else caller.peer.host))
        ends = (self._ends.between(found, replace(reader, host=host)) for host in hosts)
        end = next(filter(None, ends), None)
        if end is not None:
            end.on(LinkEvent.WANTED)
            return Answer()
        try:
            self._ends.check_made(reader)
            self._ends.check_readers(found.path)
            with self._connecting():
                self._links.kernel.connections.make((found, str(full)), request.options)
        except AiortsError as error:
            raise WiringError(str(error)) from None
        return Answer()

    # -- arrivals and disconnections --------------------------------------------------------------------------------

    async def _come(self, body: bytes, caller: Caller) -> bytes:
        """Handle the news that another kernel has a component for which links here waited."""
        component = body.decode(errors="replace")
        for end in () if caller.peer is None else self._ends.at(caller.peer.kernel, component):  # over any transport
            end.on(LinkEvent.COME)
        self._links.come(component, caller.peer)
        return b""

    async def _left(self, body: bytes, caller: Caller) -> bytes:
        """Handle the news that the asking kernel has disconnected its end of a link."""
        (epoch,) = fields(body, (int,), longer=True)
        end = self._ends.by_epoch.get(epoch) if epoch else self._departed(body, caller)
        if end is not None and not end.own and self._is_of(end, caller):  # this kernel connects its own again
            end.left()
        return b""

    def _departed(self, body: bytes, caller: Caller) -> LinkEnd[Any] | None:
        """The reader's end of a link whose writer's end was disconnected before the answer to its offer came."""
        _, link, epoch = fields(body, (int, str, int), longer=True)
        end = self._ends.offered.get((caller.address, link))
        return end if end is not None and end.writer_epoch == epoch else None
