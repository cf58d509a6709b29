"""Measure connectors as long as a session or a stream lasts: the latency and the age of samples."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

from aiorts.control.session import Session, Stream
from aiorts.errors import BusyError, ConfigurationError, WiringError
from aiorts.kernel.service import KernelService

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector

SPANS: Final = 1000
"""The number of sends and reads from which latency and age are computed, unless a client gives another."""
_MEASURED: Final = 16
"""The most connectors that all streams of one client together may measure."""
_MEASURED_IN_ALL: Final = 64
"""The most connectors that all streams of a kernel together may measure."""


class Measuring(KernelService):
    """The connectors of one kernel that are measured for sessions and streams."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.held: Counter[Connector] = Counter()
        """The number of sessions and streams that measure a connector made without `measure`."""

    def end(self, wire: Connector) -> None:
        """End the measuring of a connector for one session or stream."""
        self.held[wire] -= 1
        if not self.held[wire]:
            del self.held[wire]
            if not wire.closed:
                self.kernel.connections.measure(wire, 0)


def measure(
    session: Session, connectors: Sequence[str], count: int, keep: Callable[[Callable[[], object]], object]
) -> tuple[str, ...]:
    """Measure connectors until the functions given to `keep` are called.

    Returns:
        The connectors that are measured for sessions and streams only; connectors made with `measure` stay as they are.
    """
    measuring = session.kernel.service(Measuring)
    wires = [_wire(session, name) for name in connectors]
    for wire in wires:
        if wire not in measuring.held:
            if wire.profile.measure:
                continue  # it was made with `measure`
            session.kernel.connections.measure(wire, count)
        measuring.held[wire] += 1
        keep(partial(measuring.end, wire))
    return tuple(wire.name for wire in wires if wire in measuring.held)


def _wire(session: Session, name: str) -> Connector:
    known = session.kernel.connectors
    if name not in known:
        raise WiringError(f"{name}: no such connector; there are {', '.join(tuple(known)[:20]) or 'none'}")
    return known[name]


_STREAMED: Final[WeakKeyDictionary[Session | Microkernel, int]] = WeakKeyDictionary()
"""The number of connectors that streams measure, by client and by kernel; a connector counts once for each stream."""


def measure_for(session: Session, connectors: tuple[str, ...], stream: Stream) -> tuple[str, ...]:
    """Measure connectors as long as a stream lasts; returns those that are measured for sessions and streams only.

    Raises:
        ConfigurationError: these are more connectors than one client may measure. BusyError: they are too many together
            with those of other streams, of this client or of all clients. WiringError: there is no such connector.
    """
    count = len(connectors)
    if count > _MEASURED:
        raise ConfigurationError(f"counters: {count} connectors to be measured; at most {_MEASURED} for a client")
    bounds = ((session, _MEASURED, "this client"), (session.kernel, _MEASURED_IN_ALL, "all clients"))
    for one, most, who in bounds:
        if (held := _STREAMED.get(one, 0)) + count > most:
            raise BusyError(
                f"counters: {held} connectors are measured for streams of {who}, {count} more asked for; at most {most}"
            )

    def count_for(more: int) -> None:
        for one, _, _ in bounds:
            _STREAMED[one] = _STREAMED.get(one, 0) + more

    count_for(count)
    stream.on_close(partial(count_for, -count))
    return measure(session, connectors, SPANS, stream.on_close)
