"""The joint ledger of a link: the writer's kernel asks the reader's kernel, and joins both ledgers.

Both ends count up to the same sample number, not up to the same time. Samples that the reader's end has not received
when it answers count as in flight, whatever becomes of them later.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

from aiorts.errors import LinkError
from aiorts.kernel.ports.connector import transport_of
from aiorts.late import dataclass
from aiorts.links.linked import added
from aiorts.links.messages import fields, packed
from aiorts.links.writer_link import WriterLink

if TYPE_CHECKING:
    from aiorts.kernel.loop.bus import ConnectorChanged
    from aiorts.links.ends import Ends, LinkEnd
    from aiorts.links.kernels import Kernels
    from aiorts.links.reader_link import ReaderLink
    from aiorts.links.transport import Caller
    from aiorts.model.profile import ConnectorStatistics

_LARGEST: Final = 2**63
_FIGURES: Final[Mapping[object, int]] = {"waited": 4, "age": 4, "within": 1}
"""How many numbers each entry of `LinkLedger.read` has."""
T = TypeVar("T")
_WITHIN: Final = 2.0
"""Seconds in which the reader's kernel answers that of the writer."""


@dataclass(frozen=True, slots=True)
class LinkLedger:
    """The ledger of a link, from the writer to the reader: written = delivered + sum(dropped.values()) + buffered +
    in_flight + acknowledged_before."""

    written: int
    """Samples that the writer wrote, those that `keep_last` offered again, those of writers before this one that the
    reader has counted, and those that were unread when the connector got other options."""
    delivered: int
    """Samples that the reader read."""
    dropped: Mapping[str, int]
    """Samples that were lost at either end, by reason."""
    buffered: int
    """Samples that wait at either end: to be sent, or to be read."""
    in_flight: int
    """Samples that were taken to be sent, and had not come when the reader's end was asked."""
    acknowledged_before: int
    """Samples that were in the buffers of former readers: whether they were read is not known any more."""
    read: Mapping[str, Sequence[int]] | None = field(default=None, compare=False)
    """The ages of samples when they were read ("age", by their stamps; "within": its possible error) and their waits in
    the reader's buffer ("waited"), where the connector is measured: count, p50, p99 and maximum in ns. None: the
    kernel of the reader does not say it."""

    @property
    def unexplained(self) -> int:
        """Samples that neither end accounts for; 0 unless there is a fault in the protocol."""
        known = self.delivered + sum(self.dropped.values()) + self.buffered + self.in_flight
        return self.written - known - self.acknowledged_before

    def __str__(self) -> str:
        lost = ", ".join(f"{reason} {count}" for reason, count in self.dropped.items())
        before = f" + {self.acknowledged_before} acknowledged before" if self.acknowledged_before else ""
        return (
            f"{self.written} written = {self.delivered} delivered + {sum(self.dropped.values())} dropped"
            f"{f' ({lost})' if lost else ''} + {self.buffered} buffered + {self.in_flight} in flight{before}"
        )


@dataclass(frozen=True, slots=True)
class _Report:
    """The counts of the reader's end. `besides`: counts of samples that are not from the present writer's end."""

    writer_epoch: int
    reader_epoch: int
    received: int
    delivered: int
    buffered: int
    besides: int
    dropped: dict[str, int]
    read: Mapping[str, Sequence[int]] | None = None
    """See `LinkLedger.read`."""

    def to_bytes(self) -> bytes:
        counts = [self.received, self.delivered, self.buffered, self.besides]
        return packed([self.writer_epoch, self.reader_epoch, *counts, self.dropped, self.read])

    @classmethod
    def from_bytes(cls, body: bytes) -> _Report:
        kinds = (int, int, int, int, int, int, dict)
        writer, reader, *counts, dropped = fields(body, kinds, longer=True)
        _check_counts(counts, dropped)
        received, delivered, buffered, besides = counts
        return cls(writer, reader, received, delivered, buffered, besides, dropped, _read_of(body, kinds))


class Ledgers:
    """Asks for the ledgers of one kernel's links, and answers such questions."""

    def __init__(self, links: Kernels, ends: Ends) -> None:
        self._links, self._ends = links, ends

    def handlers(self) -> Mapping[str, Callable[[bytes, Caller], Awaitable[bytes]]]:
        """The questions that other kernels may ask, and their handlers."""
        return {"ledger": self._reported, "joined": self._joined}

    async def of(self, end: LinkEnd[WriterLink | ReaderLink], within: float) -> LinkLedger:
        """The ledger of a link, asked for at either end.

        Raises:
            LinkError: the other kernel is not there or does not answer, or either end was replaced.
        """
        connector, link = end.connector, end.link
        peer = self._links.peer_of(end.far)
        if peer is None:
            raise LinkError(f"{connector.name}: ledger: there is no kernel {end.far.kernel!r}")
        if isinstance(link, WriterLink):
            asked = packed([connector.name, connector.profile.measure])
            return _join(link, _Report.from_bytes(await self._links.ask(peer, "ledger", asked, within)))
        name = self._ends.offered.name_of(end)
        if name is None:
            raise LinkError(f"{connector.name}: ledger: {link.why}")
        # The writer's kernel asks this one in turn.
        joined = _read(await self._links.ask(peer, "joined", packed([name[1]]), 2 * within))
        return replace(joined, read=_ages(connector.statistics))

    def changed(self, changed: ConnectorChanged) -> None:
        """Ask the reader's end, since each question says whether the writer's end, and so the reader's, is measured."""
        connector = self._links.kernel.connectors.get(changed.connector.name)
        if connector is None or changed.connector.measure == changed.before.measure:
            return
        if (end := self._ends.writers.get(connector)) is not None:
            self._links.run(self._tell(end), f"aiorts link {connector.name}")

    async def _tell(self, end: LinkEnd[WriterLink]) -> None:
        with suppress(LinkError):  # the other end is absent or was replaced: a later question tells it
            await self.of(end, _WITHIN)

    async def through(self, reader: LinkEnd[ReaderLink], writer: LinkEnd[WriterLink], within: float) -> LinkLedger:
        """The ledger of a connector whose both ends are in other kernels; errors as those of `of`.

        The ledgers of its two links both contain the counts of this kernel, which are subtracted once.
        """
        one = await self.of(reader, within)
        here = reader.link.reported
        two = await self.of(writer, within)
        dropped = added(added(one.dropped, two.dropped), {reason: -count for reason, count in here.dropped.items()})
        return LinkLedger(
            one.written + two.written - here.written,
            two.delivered,
            MappingProxyType({reason: count for reason, count in dropped.items() if count}),
            one.buffered + two.buffered - here.buffered - here.in_flight,
            one.in_flight + two.in_flight,
            one.acknowledged_before + two.acknowledged_before,
            two.read,
        )

    async def _reported(self, body: bytes, caller: Caller) -> bytes:
        (name,) = fields(body, (str,), longer=True)
        end = self._ends.offered.get((caller.address, name))
        if end is None:
            raise LinkError(f"has no link {name!r:.80}")
        end.link.measure(_further(body, (str,), int) or 0)
        return _report(end.link).to_bytes()

    async def _joined(self, body: bytes, caller: Caller) -> bytes:
        (name,) = fields(body, (str,), longer=True)
        for end in () if caller.peer is None else self._ends.at(caller.peer.kernel):
            is_meant = isinstance(end.link, WriterLink) and end.connector.name == name
            if is_meant and self._links.peer_of(end.far) == caller.peer:
                ledger = await self.of(end, _WITHIN)
                counts = [ledger.written, ledger.delivered, ledger.buffered, ledger.in_flight]
                return packed([*counts, ledger.acknowledged_before, dict(ledger.dropped)])
        raise LinkError(f"has no link {name!r:.80}")


def _report(link: ReaderLink) -> _Report:
    end = link.end
    found = link.reported = link.connector.statistics
    counted = end.ledger
    return _Report(
        end.peer_epoch,
        end.epoch,
        end.received,
        found.arrived,
        found.buffered + found.in_flight + link.held,
        counted.received - end.received + transport_of(link.connector).offered + link.taken_over,
        added(found.dropped, {"undecodable": link.undecodable} if link.undecodable else {}),
        _ages(found),
    )


def _join(link: WriterLink, there: _Report) -> LinkLedger:
    """The ledger of both ends, at the number up to which the reader's end has received."""
    end, here = link.end, link.connector.statistics
    if (end.epoch, end.peer_epoch) != (there.writer_epoch, there.reader_epoch) or there.received > end.numbered:
        raise LinkError(f"{link.connector.name}: ledger: one of its ends is another one now; ask again")
    # Samples that the reader's end has refused or lost are counted at both ends.
    known = added(link.refused, link.lost)
    lost = added(here.dropped, {reason: -count for reason, count in known.items()})
    dropped = {reason: count for reason, count in added(lost, there.dropped).items() if count}
    return LinkLedger(
        here.written + there.besides,
        there.delivered,
        MappingProxyType(dropped),
        here.buffered + there.buffered,
        end.numbered - there.received,
        link.acknowledged_before,
        there.read,
    )


def _ages(found: ConnectorStatistics) -> dict[str, tuple[int, ...]]:
    """The spans measured at the reader's end, as `LinkLedger.read` has them."""
    both = (("waited", found.latency), ("age", found.age))
    made: dict[str, tuple[int, ...]] = {
        what: spans.figures for what, spans in both if spans is not None and spans.count
    }
    return made if found.age_within_ns is None else {**made, "within": (found.age_within_ns,)}


def _further(body: bytes, kinds: tuple[type, ...], kind: type[T]) -> T | None:
    """The field after the fields of these kinds; None: the other kernel does not send it."""
    try:
        *_, found = fields(body, (*kinds, kind), longer=True)
    except LinkError:
        return None
    return cast("T", found)


def _read_of(body: bytes, kinds: tuple[type, ...]) -> Mapping[str, Sequence[int]] | None:
    found = _further(body, kinds, dict)
    if found is None:
        return None
    if not all(type(spans) is list and len(spans) == _FIGURES.get(what) for what, spans in found.items()) or not all(
        type(one) is int and abs(one) < _LARGEST for spans in found.values() for one in spans
    ):
        raise LinkError("no ledger of a link")
    return MappingProxyType(found)


def _read(body: bytes) -> LinkLedger:
    *counts, dropped = fields(body, (int, int, int, int, int, dict), longer=True)
    _check_counts(counts, dropped)
    written, delivered, buffered, in_flight, before = counts
    return LinkLedger(written, delivered, MappingProxyType(dropped), buffered, in_flight, before)


def _check_counts(counts: list[Any], dropped: dict[Any, Any]) -> None:
    if any(type(reason) is not str or type(count) is not int for reason, count in dropped.items()) or not all(
        0 <= count < _LARGEST for count in (*counts, *dropped.values())
    ):
        raise LinkError("no ledger of a link")
