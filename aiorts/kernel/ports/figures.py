"""The statistics of a connector: its transport's counts, their time stamp, and the measured times."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

from aiorts.kernel.ports.port_types import port_type
from aiorts.model.profile import ConnectorStatistics
from aiorts.model.timing import Spans, mean_rate

if TYPE_CHECKING:
    from aiorts.clock import Clock
    from aiorts.model.timing import ConnectorTimes


class Counted(Protocol):
    """A transport, as far as its statistics need it."""

    clock: Clock
    connector: Any
    times: ConnectorTimes | None


def statistics_of(
    transport: Counted, written: int, delivered: int, buffered: int, dropped: Mapping[str, int]
) -> ConnectorStatistics:
    """The statistics made of these counts, which were taken now, and of the transport's measured times."""
    now_ns, connector, times = transport.clock.monotonic_ns(), transport.connector, transport.times
    latency = age = rate = within = None
    if times is not None:
        rate = mean_rate(written - times.before, times.since_ns, now_ns)
        latency = Spans.of(tuple(times.latencies))
        if port_type(connector.in_.type).has_tm:
            ahead, within = getattr(connector.out, "clock", None) or (0, None)
            age = Spans.of([one + ahead for one in times.ages])
    return ConnectorStatistics(
        written,
        delivered,
        buffered,
        MappingProxyType(dict(dropped)),
        at_ns=now_ns,
        mean_rate=rate,
        latency=latency,
        age=age,
        age_within_ns=within,
    )
