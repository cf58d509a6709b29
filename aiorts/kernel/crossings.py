"""How a port and its connectors become crossing ones (`crossing.py`), and ordinary ones again: on the loop, in place.

Users hold the objects, so their class is changed. A thread that is inside with the port's lock leaves first.
"""

from __future__ import annotations

import sys
from collections import deque
from typing import Any, Final

from aiorts.kernel.backlog import PeriodicConnector
from aiorts.kernel.blocking import PortLock
from aiorts.kernel.connector import Connector
from aiorts.kernel.crossing import Arrivals, CrossingConnector, Sides
from aiorts.kernel.crossing_periodic import CrossingPeriodic
from aiorts.kernel.crossing_port import CrossingInPort
from aiorts.kernel.ports import InPort, Port, ServicePort

__all__ = ("cross", "cross_all", "fit", "lock_all", "uncross", "uncross_all", "uncross_unneeded")

_LISTENING: Final = "aiorts.kernel.listening"
"""Asked only where it was imported: where it was not, nobody listens."""


def cross_all(port: Port[Any]) -> None:
    """A component with this port is about to run in a real-time thread."""
    if isinstance(port, ServicePort):
        return
    if isinstance(port, InPort):
        cross(port)
    for connector in port.connectors:
        cross(connector.in_)


def uncross_all(port: Port[Any]) -> None:
    """A component with this port has left its real-time thread."""
    if isinstance(port, ServicePort):
        return
    for in_port in {id(p): p for p in (port, *(c.in_ for c in port.connectors)) if isinstance(p, InPort)}.values():
        uncross_unneeded(in_port)


def uncross_unneeded(port: InPort[Any]) -> None:
    """One of its connectors has ended: no thread may be left at this port."""
    if isinstance(port, CrossingInPort) and not _needed(port):
        uncross(port)


def cross(port: InPort[Any]) -> None:
    """From now on no path at this port has a lock; a thread that is inside with its lock leaves first."""
    if isinstance(port, CrossingInPort):
        return
    if (listening := sys.modules.get(_LISTENING)) is not None:
        listening.mute(port)
    with port._guard():
        source = port.last_source
        tokens = port._tokens
        unread = sum(len(connector._queue) for connector in port._connectors)
        port._cross = Arrivals(port._arrivals + unread + 1, port._lock is not None)
        for connector in port._connectors:
            _convert(connector)
            if tokens is None:
                connector._cross.places.extend(range(len(connector._queue)))
        for place, connector in enumerate(tokens or ()):
            connector._cross.places.append(place)
        port._tokens = None
        if port._lock is None:
            port._lock = PortLock()
        _become(port, CrossingInPort)
        port._source = source
        port._refresh()
    for connector in port._connectors:
        connector.out._refresh()


def lock_all(port: Port[Any]) -> None:
    """More than one thread will use what hangs on this port."""
    if isinstance(port, InPort):
        port._make_locked()
    if not isinstance(port, ServicePort):
        for connector in port.connectors:
            connector.in_._make_locked()


def fit(connector: Connector) -> None:
    """A new connector: crossing where its in-port is."""
    if isinstance(connector.in_, CrossingInPort):
        _convert(connector)


def _convert(connector: Connector) -> None:
    # What the out-port counts for several connectors it cannot count for one that crosses.
    connector.share(False, connector.out._sent)
    connector._count_displaced()
    connector._dropped = dict(connector._dropped)
    connector._waiting = connector._waiting or deque()
    connector._cross = sides = Sides()
    sides.wanted = bool(connector._waiting)
    if isinstance(connector, PeriodicConnector):
        numbered = list(enumerate(connector._backlog, connector._first))
        connector._backlog.clear()
        connector._backlog.extend(numbered)
        _become(connector, CrossingPeriodic)
    else:
        _become(connector, CrossingConnector)


def _needed(port: InPort[Any]) -> bool:
    hosts = [port._host, *(connector.out._host for connector in port._connectors)]
    return any(host is not None and (host.realtime or host.threaded) for host in hosts)


def uncross(port: InPort[Any]) -> None:
    """All that is left at this port runs on the loop."""
    places: list[tuple[int, Connector]] = []
    for connector in port._connectors:
        sides = connector._cross
        places += [(place, connector) for place in sides.places]
        for side in (sides.by_reader, sides.by_loop):
            for reason, number in side.items():
                connector._drop(reason, number)
        if isinstance(connector, CrossingPeriodic):
            numbered = list(connector._backlog)
            connector._first = numbered[0][0] if numbered else 1
            connector._backlog.clear()
            connector._backlog.extend(sample for _, sample in numbered)
            kind: type[Connector] = PeriodicConnector
        else:
            kind = Connector
        _become(connector, kind)
    source = port._source
    port._arrivals = next(port._cross.numbers)
    port._lock = None
    _become(port, InPort)
    port._sole = None
    port._source = source
    if len(port._connectors) > 1:
        port._tokens = deque(connector for _, connector in sorted(places, key=lambda one: one[0]))
    port._refresh()
    for connector in port._connectors:
        connector.out._refresh()
    if (listening := sys.modules.get(_LISTENING)) is not None:
        listening.unmute(port)


def _become(thing: Any, kind: type[Any]) -> None:
    thing.__class__ = kind
