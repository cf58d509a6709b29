"""The ledgers of both ends of a link as one: the number of written samples, and where they are."""

from __future__ import annotations

from aiorts.late import dataclass
from aiorts.model.links.reader import ReaderLedger
from aiorts.model.links.writer import WriterLedger


@dataclass(frozen=True, slots=True)
class Joined:
    """Both ledgers of one link, each at its own moment.

    A sample that the reader's end has received is in flight at the writer's end until its acknowledgement comes.
    """

    offered: int
    acknowledged: int
    dropped: int
    in_flight: int
    received: int
    delivered: int

    @property
    def unexplained(self) -> int:
        """Samples that neither ledger accounts for; 0 unless there is a fault in the protocol."""
        lost = self.offered - self.acknowledged - self.dropped - self.in_flight
        # Acknowledged samples were delivered; delivered samples are acknowledged, in flight or of unknown fate.
        too_few = max(0, self.acknowledged - self.delivered)
        too_many = max(0, self.delivered - self.acknowledged - self.in_flight - self.dropped)
        return abs(lost) + too_few + too_many


def join(writer: WriterLedger, reader: ReaderLedger) -> Joined:
    """Both ledgers as one."""
    return Joined(
        writer.offered, writer.acknowledged, writer.dropped, writer.in_flight, reader.received, reader.delivered
    )
