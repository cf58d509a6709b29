"""Operations that measure: counters of what there is, chosen values at a rate, and what a connector is measured by.

The counters are asked for again and again while a system works, so they are made in one look on the loop, as lists and
dicts that go into a frame as they are. None of them takes a sample.
"""

from __future__ import annotations

from collections.abc import Awaitable, Iterable, Iterator, Mapping
from dataclasses import field
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from aiorts.clock import SimulatedClock
from aiorts.control.operation import Operation, Right
from aiorts.control.session import Session, Stream
from aiorts.control.turns import in_turns
from aiorts.control.values import Done
from aiorts.errors import AiortsError, ConfigurationError, StateError, WiringError
from aiorts.kernel.execution.cell import cell, standing_error
from aiorts.kernel.execution.member import overdue_hooks
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.last_sample import last_written
from aiorts.kernel.ports.port import NOTHING
from aiorts.late import dataclass
from aiorts.model.lifecycle import OverdueHook
from aiorts.model.options import MAX_LENGTH
from aiorts.model.profile import ThreadWriteStatistics
from aiorts.model.service_profile import ServiceStatistics
from aiorts.observe import Monitor, Reading, calls, thread_writes
from aiorts.wire import MsgpackCodec

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.model.timing import Spans

T = TypeVar("T")
_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})
_Made: TypeAlias = dict[str, Any]
"""`Counters` as dicts."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """Of what the counters are wanted; what is not there now is left out."""

    connectors: tuple[str, ...] | None = None
    """Names; None is all, and an empty list none."""
    contexts: tuple[str, ...] | None = None
    components: tuple[str, ...] | None = None
    timed: tuple[str, ...] = ()
    """Connectors with `measure` whose latency and age are wanted: putting the spans in order takes time."""


@dataclass(frozen=True, slots=True)
class ContextCounters:
    """What a context has done, as `ContextStatistics` counts it."""

    rate: float | None
    """Hz; None where it has none."""
    running: bool
    cycles: int
    skipped: int
    overruns: int
    lateness_p50_ns: int
    lateness_p99_ns: int
    lateness_max_ns: int


@dataclass(frozen=True, slots=True)
class ComponentCounters:
    """How a component is, and what its ports have counted."""

    states: Mapping[str, str]
    """Lifecycle state by context."""
    failed: bool
    """Whether it has failed, and was neither reset nor activated since."""
    overdue: Mapping[str, OverdueHook] = field(default_factory=lambda: _NOTHING)
    """The hook that runs longer than its deadline, by context."""
    calls: Mapping[str, ServiceStatistics] = field(default_factory=lambda: _NOTHING)
    """Through each interface, as `ComponentReport.calls` has them."""
    thread_writes: Mapping[str, ThreadWriteStatistics] = field(default_factory=lambda: _NOTHING)
    """Of each out-port where a thread wrote."""


@dataclass(frozen=True, slots=True)
class Counters:
    """The counters at one moment, by name."""

    time_ns: int
    """The kernel's clock, since the epoch."""
    at_ns: int
    """The kernel's clock, monotonic: what rates are counted by."""
    simulated: bool
    connectors: Mapping[str, tuple[int, int, int, Mapping[str, int], int]]
    """Written, delivered, buffered, dropped by reason, and the option `measure`."""
    timed: Mapping[str, Mapping[str, tuple[int, ...]]]
    """"latency" and "age": how many, p50, p99 and maximum in nanoseconds; "within": how far the age may be off that
    is by the stamps of another machine."""
    contexts: Mapping[str, ContextCounters]
    components: Mapping[str, ComponentCounters]


def _statistics(session: Session, given: Chosen) -> _Made | Awaitable[_Made]:
    """Connectors are counted at one moment; where the rest takes long, the loop has its turns in between."""
    kernel, clock = session.kernel, session.kernel.clock
    made: _Made = {
        "time_ns": clock.time_ns(),
        "at_ns": clock.monotonic_ns(),
        "simulated": isinstance(clock, SimulatedClock),
        "connectors": {name: _counted(one) for name, one in _chosen(kernel.connectors, given.connectors)},
        "timed": {},
        "contexts": {},
        "components": {},
    }
    return in_turns(kernel, _rest(kernel, given, made), made)


def _rest(kernel: Microkernel, given: Chosen, made: _Made) -> Iterator[None]:
    """Put in what need not be of one moment, one thing at each step."""
    for name, wire in tuple(_chosen(kernel.connectors, given.timed)):
        if found := _timed(wire):
            made["timed"][name] = found
        yield
    for name, context in tuple(_chosen(kernel.contexts, given.contexts)):
        made["contexts"][name] = _context(context)
        yield
    for name, component in tuple(_chosen(kernel.components, given.components)):
        made["components"][name] = _component(component)
        yield


def _chosen(known: Mapping[str, T], names: tuple[str, ...] | None) -> Iterable[tuple[str, T]]:
    return known.items() if names is None else [(name, known[name]) for name in names if name in known]


def _counted(connector: Connector) -> tuple[int, int, int, Mapping[str, int], int]:
    transport, measure = transport_of(connector), connector.profile.measure
    # Of a real-time thread and of a link only the statistics fit together.
    if not transport.listenable or connector.profile.on_link_lost is not None:
        ledger = connector.statistics
        return ledger.written, ledger.arrived, ledger.buffered, dict(ledger.dropped), measure
    with transport.guard():
        written, buffered, dropped = transport.glance()
    return written, written - buffered - sum(dropped.values()), buffered, dropped, measure


def _timed(connector: Connector) -> dict[str, tuple[int, ...]]:
    if not connector.profile.measure:
        return {}
    found = connector.statistics
    both: tuple[tuple[str, Spans | None], ...] = (("latency", found.latency), ("age", found.age))
    made: dict[str, tuple[int, ...]] = {
        what: (spans.count, spans.p50_ns, spans.p99_ns, spans.max_ns)
        for what, spans in both
        if spans is not None and spans.count
    }
    return made if found.age_within_ns is None else {**made, "within": (found.age_within_ns,)}


def _context(context: Context) -> dict[str, Any]:
    found = context.counts
    return {
        "rate": context.rate,
        "running": context.running,
        "cycles": found.cycles,
        "skipped": found.skipped,
        "overruns": found.overruns,
        "lateness_p50_ns": found.lateness_p50_ns,
        "lateness_p99_ns": found.lateness_p99_ns,
        "lateness_max_ns": found.lateness_max_ns,
    }


def _component(component: Component) -> dict[str, Any]:
    """States by context, whether it has failed, and the counts of its calls and of threads where there are any."""
    made: dict[str, Any] = {
        "states": {context: state.value for context, state in component.states.items()},
        "failed": standing_error(component) is not None,
    }
    if late := overdue_hooks(component):
        made["overdue"] = dict(late)
    ports = cell(component).ports
    if answered := calls(ports):
        made["calls"] = dict(answered)
    if written := thread_writes(ports):
        made["thread_writes"] = dict(written)
    return made


@dataclass(frozen=True, slots=True)
class Measured:
    """Connectors that are to be measured as long as the session lasts."""

    connectors: tuple[str, ...]
    count: int = 1000
    """Sends and reads over which latency and age are taken."""


_HELD: Final[dict[Connector, int]] = {}
"""Sessions for which a connector is measured that else is not."""


def _measure(session: Session, given: Measured) -> tuple[str, ...]:
    """Switch `measure` on where it is off; returns the connectors that are measured for sessions only."""
    if not 1 <= given.count <= MAX_LENGTH:
        raise ConfigurationError(f"measure: count = {given.count}: expected 1 to {MAX_LENGTH} samples")
    wires = [_wire(session, name) for name in given.connectors]
    for wire in wires:
        if wire not in _HELD:
            if wire.profile.measure:
                continue  # it was made so
            session.kernel.connections.measure(wire, given.count)
        _HELD[wire] = _HELD.get(wire, 0) + 1
        session.keep(partial(_let_go, session, wire))
    return tuple(wire.name for wire in wires if wire in _HELD)


def _let_go(session: Session, wire: Connector) -> None:
    _HELD[wire] -= 1
    if not _HELD[wire]:
        del _HELD[wire]
        if not wire.closed:
            session.kernel.connections.measure(wire, 0)


def _wire(session: Session, name: str) -> Connector:
    known = session.kernel.connectors
    if name not in known:
        raise WiringError(f"{name}: no such connector; there are {', '.join(tuple(known)[:20]) or 'none'}")
    return known[name]


@dataclass(frozen=True, slots=True)
class Wires:
    """Some connectors, by name; one that is gone is left out."""

    connectors: tuple[str, ...]


Size: TypeAlias = tuple[int | None, str]
"""Bytes of the sample that was written last, encoded; without any, None and why."""


def _sizes(session: Session, given: Wires) -> Mapping[str, Size]:
    return {name: _size(one) for name, one in _chosen(session.kernel.connectors, given.connectors)}


def _size(connector: Connector) -> Size:
    sample = last_written(connector.out)
    if sample is NOTHING:
        return None, "nothing was written yet"
    try:
        return len(MsgpackCodec().encode(sample)), ""
    except AiortsError as error:
        return None, str(error)


@dataclass(frozen=True, slots=True)
class Watched:
    """Values that are looked at, by their paths as `Kernel.monitor` has them."""

    paths: tuple[str, ...]
    rate: float = 10.0
    """Hz of the kernel's clock."""


def _monitor(session: Session, given: Watched, stream: Stream) -> Done:
    kernel = session.kernel
    if isinstance(kernel.clock, SimulatedClock):
        raise StateError("monitor: its timer would change what happens in simulated time; ask for statistics instead")
    monitor = Monitor(kernel, given.paths, given.rate)
    stream.on_close(monitor.close)

    async def send_all() -> None:
        async for reading in monitor:
            stream.send(reading)
        stream.finish()

    kernel_task(kernel.loop, send_all(), "aiorts control monitor")
    return Done()


ROWS: Final = (
    Operation("measure", "Measure connectors for the session.", Measured, tuple[str, ...], Right.OPERATE, _measure),
    Operation("monitor", "Stream chosen values at a rate.", Watched, Done, Right.VIEW, _monitor, item=Reading),
    Operation("sizes", "Encoded size of samples.", Wires, Mapping[str, Size], Right.VIEW, _sizes, idempotent=True),
    Operation("statistics", "The counters.", Chosen, Counters, Right.VIEW, _statistics, idempotent=True),
)
