"""The sample that a writer wrote last: connectors with `keep_last` offer it, and an out-port shows it.

A write stores no copy: its sample is the newest in a connector's queue, or the one that the reader took last
(`Transport.held`). Each write goes to every connector, so any of them has the sample. A transport that loses the sample
gives it to the out-port (`Transport.miss`) and notes the loss (`missed`). In an out-port without connectors a
`NoReader` keeps the sample.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.ports.port import NOTHING

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import PortHost
    from aiorts.kernel.ports.in_port import InPort
    from aiorts.kernel.ports.out_port import OutPort

_PATIENCE: Final = 1000
"""How often, at most, to check whether a thread has ended its write at an out-port."""


def last_written(out: OutPort[Any]) -> Any:
    """The sample that was written last; NOTHING before the first."""
    for connector in out._connectors:
        if (sample := connector._transport.held()) is not NOTHING:
            return sample
    return out._saved


def offer_last(connector: Connector, written: int) -> None:
    """Offer the writer's last sample to a connector from which nothing was read yet, if its reader takes samples.

    `written` is the count when the reader opened; if it has grown, the reader has a later sample, and none is offered.
    """
    transport, out = connector._transport, connector.out
    if not transport.receiver.open or transport.delivered():
        return
    host = out._host
    for _ in range(_PATIENCE):
        if host is None or not host.writing:
            break
        time.sleep(50e-6)  # lets the thread end its write, which has reached only some connectors
    sample = last_written(out)
    if sample is NOTHING:
        return
    with transport.guard():
        now = connector._transport
        if now.receiver.open and not now.closed and now.total() == written:
            now.put_last(sample)


def to_be_offered(port: InPort[Any]) -> list[tuple[Connector, int]]:
    """The arguments for `offer_last` of an in-port that takes samples from now on; the caller holds the lock."""
    return [(one, one._transport.total()) for one in port._connectors if one.profile.keep_last]


class Beginning:
    """The first transport of an out-port at which a thread writes: marks that a write has begun.

    A connector made after the port chose its paths gets the sample here: `offer_last` may have come too early for it.
    """

    __slots__ = ("_connectors", "_host", "_out")

    def __init__(self, out: OutPort[Any], host: PortHost) -> None:
        self._out, self._host = out, host
        self._connectors = out._connectors

    def must_wait(self) -> bool:
        """Whether a write has to wait: never."""
        return False

    def offer(self, sample: Any) -> bool:
        """Mark the beginning of a write."""
        out = self._out
        self._host.writing = True
        if out._connectors is self._connectors:
            return True
        newcomers = [one for one in out._connectors if one not in self._connectors]
        return sum(not one._transport.offer(sample) for one in newcomers) == 0


class Ending:
    """The last transport of an out-port at which a thread writes: marks the end of a write."""

    __slots__ = ("_host",)

    def __init__(self, host: PortHost) -> None:
        self._host = host

    def must_wait(self) -> bool:
        """Whether a write has to wait: never."""
        return False

    def offer(self, sample: Any) -> bool:
        """Mark the write as ended: all connectors have the sample."""
        self._host.writing = False
        return True


class NoReader:
    """The stand-in for a transport at an out-port without connectors: keeps the last sample."""

    __slots__ = ("_out",)

    def __init__(self, out: OutPort[Any]) -> None:
        self._out = out

    def must_wait(self) -> bool:
        """Whether a write has to wait: never."""
        return False

    def offer(self, sample: Any) -> bool:
        """Keep the sample."""
        self._out._saved = sample
        return True
