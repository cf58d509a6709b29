"""Moving unread samples from one connector to another, in order."""

from __future__ import annotations

from aiorts.kernel.ports.connector import Connector, transport_of
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.wiring import keep_newest
from aiorts.kernel.quality.dated import Dated


def pass_on(connector: Connector, successor: Connector) -> int:
    """Move a connector's unread samples to `successor`, an empty connector of the same in-port, in the same order.

    `connector` counts them as dropped{moved}. If `successor` keeps only the newest, older ones are superseded.

    Returns: how many were moved.
    """
    one, other = transport_of(connector), transport_of(successor)
    one.settle()
    with one.guard():
        if isinstance(other, Dated):
            other.moments.queue.extend([other.moments.now_ns()] * len(one.queue))
        other.queue.extend(one.queue)
        count = len(one.queue)
        other.written += count
        other.dead, one.dead = one.dead, 0
        receiver_of(connector.in_).exchange(one, other)
        one.discard("moved")
        keep_newest(other)
    return count
