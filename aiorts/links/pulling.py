"""Both ends of a link that pulls: the reader's end asks for the writer's newest sample, and holds one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.features import FeaturedTransport
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.links.linked import PULL
from aiorts.links.reader_link import ReaderLink
from aiorts.links.writer_link import WriterLink

if TYPE_CHECKING:
    from aiorts.links.transport import Channel


class PulledWriterLink(WriterLink):
    """Sends a sample for each query. See `WriterLink`."""

    @property
    def busy(self) -> bool:
        return self.end.ledger.in_flight > 0

    def _take(self, now: int) -> None:
        end = self.end
        if not end.query or end.room <= 0:
            return
        transport = self._transport()
        transport.settle()
        if transport.queue:
            end.query = 0
            super()._take(now)
        elif self._channel is not None:
            end.answer_none(self._channel.send)


class PullingReaderLink(ReaderLink):
    """Asks for a sample each time the in-port is read or checked. See `ReaderLink`."""

    quiet = False
    """Whether `look` asks for nothing now: the link itself uses the in-port."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        transport = transport_of(self.connector)
        if isinstance(transport, FeaturedTransport):
            transport.extra[PULL] = self

    def look(self) -> None:
        """Ask the writer's end for its newest sample, unless such a question is under way; on the loop.

        If a task or a thread waits and there is no newer sample, the question asks for the next.
        """
        if not self.quiet and not self._ended and self.end.want(self._now(), wait=self._is_awaited):
            self._wake()

    @property
    def _is_awaited(self) -> bool:
        """Whether a task waits for a sample, or a thread may."""
        receiver = receiver_of(self.connector.in_)
        return receiver.waiter is not None or receiver.lock is not None

    def connect(self, channel: Channel, number: int, peer_epoch: int) -> None:
        super().connect(channel, number, peer_epoch)
        if self._is_awaited:
            self.look()  # the task has waited since before the link was up

    def _deliver(self, now: int) -> None:
        self.quiet = True
        try:
            super()._deliver(now)
        finally:
            self.quiet = False

    def _poll(self, now: int) -> None:
        super()._poll(now)
        if self._channel is not None:
            self._wakening.at(self.end.poll_query(now, self._channel.send))
