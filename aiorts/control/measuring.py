"""Measures connectors as long as a session or a stream lasts: how long samples take, and how old they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

from aiorts.control.session import Session, Stream
from aiorts.errors import BusyError, ConfigurationError, WiringError

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector

SPANS: Final = 1000
"""Sends and reads over which latency and age are taken, unless a client says another number."""
_MEASURED: Final = 16
"""Connectors that all streams of one client may have measured."""
_MEASURED_IN_ALL: Final = 64
"""Connectors that all streams of a kernel may have measured."""
_HELD: Final[dict[Connector, int]] = {}
"""How many sessions and streams have a connector measured that else is not."""


def measure(
    session: Session, connectors: Sequence[str], count: int, keep: Callable[[Callable[[], object]], object]
) -> tuple[str, ...]:
    """Measure connectors until the functions that `keep` was given are called.

    Returns:
        the connectors that are measured for sessions and streams only; others that are measured stay as they are.
    """
    wires = [_wire(session, name) for name in connectors]
    for wire in wires:
        if wire not in _HELD:
            if wire.profile.measure:
                continue  # it was made so
            session.kernel.connections.measure(wire, count)
        _HELD[wire] = _HELD.get(wire, 0) + 1
        keep(partial(_let_go, session.kernel, wire))
    return tuple(wire.name for wire in wires if wire in _HELD)


def _let_go(kernel: Microkernel, wire: Connector) -> None:
    _HELD[wire] -= 1
    if not _HELD[wire]:
        del _HELD[wire]
        if not wire.closed:
            kernel.connections.measure(wire, 0)


def _wire(session: Session, name: str) -> Connector:
    known = session.kernel.connectors
    if name not in known:
        raise WiringError(f"{name}: no such connector; there are {', '.join(tuple(known)[:20]) or 'none'}")
    return known[name]


_STREAMED: Final[WeakKeyDictionary[Session | Microkernel, int]] = WeakKeyDictionary()
"""How many connectors streams measure, by client and by kernel; one that several measure counts several times."""


def measure_for(session: Session, connectors: tuple[str, ...], stream: Stream) -> tuple[str, ...]:
    """Measure connectors as long as a stream lasts; returns those that are measured for sessions and streams only.

    Raises:
        ConfigurationError: they are more than a client may have measured. BusyError: they are so with those of other
            streams, of this client or of all. WiringError: there is no such connector.
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
