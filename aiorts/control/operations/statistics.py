"""Operations that measure: counters, once or at a rate, sizes of samples, and the latency of samples.

Clients read counters again and again while a system works. So counters are lists and dicts that go into a frame as they
are, and reading many of them takes several turns of the loop. These operations take no sample from a buffer.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Generator, Iterable, Iterator, Mapping
from dataclasses import field
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from aiorts.clock import SimulatedClock
from aiorts.control.measuring import SPANS, measure, measure_for
from aiorts.control.operation import Operation, Right
from aiorts.control.operations.wiring import places_of
from aiorts.control.pace import looks_of
from aiorts.control.session import Session, Stream
from aiorts.control.ticking import Ticking
from aiorts.control.turns import answer_in_turns
from aiorts.errors import AiortsError, ConfigurationError
from aiorts.kernel.execution.cell import cell, standing_error
from aiorts.kernel.execution.member import overdue_hooks
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.last_sample import last_written
from aiorts.kernel.ports.port import NOTHING
from aiorts.late import dataclass
from aiorts.model.buffer import MAX_LENGTH
from aiorts.model.lifecycle import OverdueHook
from aiorts.model.plain import empty
from aiorts.model.profile import ThreadWriteStatistics
from aiorts.model.service_profile import ServiceStatistics
from aiorts.model.timing import ConnectorCounters, Size
from aiorts.observe import calls, thread_writes
from aiorts.wire import MsgpackCodec

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.model.timing import Spans

T = TypeVar("T")
_Made: TypeAlias = dict[str, Any]
"""`Counters` as a dict."""
_One: TypeAlias = tuple[str, str, Any]
"""The kind of a counted thing, its name, and its counters."""
_KINDS: Final = ("connectors", "service_connectors", "timed", "links", "contexts", "components")
_NEVER: Final = object()
_FASTEST: Final = 50.0


@dataclass(frozen=True, slots=True)
class Chosen:
    """The things whose counters are wanted; an unknown name is left out."""

    connectors: tuple[str, ...] | None = None
    """Names of connectors, of service ports too; None is all, and an empty list none."""
    contexts: tuple[str, ...] | None = None
    components: tuple[str, ...] | None = None
    timed: tuple[str, ...] = ()
    """Connectors with `measure` whose latency and age are wanted; few, since sorting their spans takes time."""


@dataclass(frozen=True, slots=True)
class ContextCounters:
    """The counters of a context, as `ContextStatistics` has them."""

    rate: float | None
    """Hz; None where it has none."""
    running: bool
    cycles: int
    skipped: int
    overruns: int
    lateness_p50_ns: int
    lateness_p99_ns: int
    lateness_max_ns: int


_COUNTS: Final = tuple(ContextCounters.__annotations__)[2:]
"""The counters that the statistics of a context have under the same names."""


@dataclass(frozen=True, slots=True)
class ComponentCounters:
    """The states of a component, and the counters of its ports."""

    states: Mapping[str, str]
    """Lifecycle state by context."""
    failed: bool
    """Whether the component has failed, and was neither reset nor activated since."""
    overdue: Mapping[str, OverdueHook] = field(default_factory=empty)
    """The hook that runs longer than its deadline, by context."""
    calls: Mapping[str, ServiceStatistics] = field(default_factory=empty)
    """The calls through each interface, as `ComponentReport.calls` has them."""
    thread_writes: Mapping[str, ThreadWriteStatistics] = field(default_factory=empty)
    """The writes of other threads, by out-port."""


@dataclass(frozen=True, slots=True)
class Counters:
    """The counters at one moment, by name."""

    time_ns: int
    """The kernel's clock, in nanoseconds since the epoch."""
    at_ns: int
    """The kernel's monotonic clock in nanoseconds, for rates."""
    simulated: bool
    connectors: Mapping[str, ConnectorCounters]
    service_connectors: Mapping[str, ServiceStatistics]
    timed: Mapping[str, Mapping[str, tuple[int, ...]]]
    """"latency" and "age": the number of samples, p50, p99 and maximum in nanoseconds; "within": the possible error of
    an age by the stamps of another machine; "link": the figures end where the link takes the sample, since the reader
    is in another process."""
    contexts: Mapping[str, ContextCounters]
    components: Mapping[str, ComponentCounters]
    links: Mapping[str, int] = field(default_factory=empty)
    """Samples that were sent and are not acknowledged yet, of connectors whose reader is in another kernel. Samples
    unread there are not in the counts of this kernel; `connectors` with `both_ends` asks the other kernel."""


@dataclass(frozen=True, slots=True)
class CounterChanges(Counters):
    """The counters that have changed since the earlier items; in the first item, and after a loss, all."""

    whole: bool = False
    """Whether the item has all counters and replaces the earlier items."""
    gone: Mapping[str, tuple[str, ...]] = field(default_factory=empty)
    """The names that have gone, by kind: "connectors", "contexts", ..."""


def _statistics(session: Session, given: Chosen) -> _Made | Awaitable[_Made]:
    """Count all connectors at one moment, then the rest, with turns of the loop in between where that takes long."""
    kernel = session.kernel
    made: _Made = {
        **_moment(kernel),
        "connectors": {name: _counted(one) for name, one in _chosen(kernel.connectors, given.connectors)},
    }
    return answer_in_turns(kernel, _put(made, _rest(kernel, given)))


def _moment(kernel: Microkernel) -> _Made:
    """The times at which counters are read, and an empty dict for each kind of counters."""
    clock = kernel.clock
    head = {"time_ns": clock.time_ns(), "at_ns": clock.monotonic_ns(), "simulated": isinstance(clock, SimulatedClock)}
    return {**head, **{kind: {} for kind in _KINDS}}


def _put(made: _Made, counted: Iterable[_One]) -> Generator[None, None, _Made]:
    for kind, name, value in counted:
        made[kind][name] = value
        yield
    return made


def _rest(kernel: Microkernel, given: Chosen) -> Iterator[_One]:
    """All counters except those of connectors; they may be of different moments."""
    for name, wire in tuple(_chosen(kernel.connectors, given.timed)):
        if found := _timed(wire):
            yield "timed", name, found
    for name, wire in tuple(_chosen(kernel.connectors, given.connectors)):
        if wire.profile.far_end == "reader":
            yield "links", name, wire.statistics.in_flight
    for name, service in tuple(_chosen(kernel.service_connectors, given.connectors)):
        yield "service_connectors", name, service.statistics
    for name, context in tuple(_chosen(kernel.contexts, given.contexts)):
        yield "contexts", name, _context(context)
    for name, component in tuple(_chosen(kernel.components, given.components)):
        yield "components", name, _component(component)


def _chosen(known: Mapping[str, T], names: tuple[str, ...] | None) -> Iterable[tuple[str, T]]:
    return known.items() if names is None else [(name, known[name]) for name in dict.fromkeys(names) if name in known]


def _counted(connector: Connector) -> ConnectorCounters:
    transport = transport_of(connector)
    dropped: Mapping[str, int]
    # At a real-time thread or a link, only the statistics have counts of one moment.
    if not transport.listenable or connector.profile.on_link_lost is not None:
        found = connector.statistics
        written, delivered, buffered, dropped = found.written, found.arrived, found.buffered, dict(found.dropped)
    else:
        with transport.guard():
            written, buffered, dropped = transport.glance()
        delivered = written - buffered - sum(dropped.values())
    return ConnectorCounters(written, delivered, buffered, dropped, connector.profile.measure)


def _timed(connector: Connector) -> dict[str, tuple[int, ...]]:
    if not connector.profile.measure:
        return {}
    found = connector.statistics
    both: tuple[tuple[str, Spans | None], ...] = (("latency", found.latency), ("age", found.age))
    made: dict[str, tuple[int, ...]] = {
        what: spans.figures for what, spans in both if spans is not None and spans.count
    }
    if found.age_within_ns is not None:
        made["within"] = (found.age_within_ns,)
    return {**made, "link": ()} if made and connector.profile.far_end == "reader" else made


def _context(context: Context) -> dict[str, Any]:
    counts = {name: getattr(context.counts, name) for name in _COUNTS}
    return {"rate": context.rate, "running": context.running, **counts}


def _component(component: Component) -> dict[str, Any]:
    """The states by context, whether it has failed, and, where there are any, counts of its calls and thread writes."""
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
    """Connectors to measure as long as the session lasts."""

    connectors: tuple[str, ...]
    count: int = SPANS
    """Sends and reads over which latency and age are taken."""


def _measure(session: Session, given: Measured) -> tuple[str, ...]:
    """Switch `measure` on where it is off; returns the connectors that are measured for sessions only."""
    if not 1 <= given.count <= MAX_LENGTH:
        raise ConfigurationError(f"measure: count = {given.count}: expected 1 to {MAX_LENGTH} samples")
    return measure(session, given.connectors, given.count, session.keep)


# -- a stream of counters ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Following(Chosen):
    """Counters to send at a rate."""

    at: tuple[str, ...] = ()
    """Names of components and paths of ports: only connectors at one of them, and only these components, are counted;
    an empty tuple is all. Connectors made later count, too."""
    measured: tuple[str, ...] = ()
    """Connectors to measure and time as long as the stream lasts: at most 16 for all streams of a client, and 64 for
    the streams of all clients."""
    rate: float = 2.0
    """Items a second by the kernel's clock, in simulated time by the real clock: up to 50."""


def _follow(session: Session, given: Following, stream: Stream) -> tuple[str, ...]:
    """Send counters at a rate; returns the connectors that are measured for sessions and streams only."""
    if not 0.0 < given.rate <= _FASTEST:
        raise ConfigurationError(f"counters: rate = {given.rate!r}: expected a number of Hz above 0 and up to 50")
    measured = measure_for(session, given.measured, stream)
    stream.on_close(Ticking(session.kernel, given.rate, _Following(session.kernel, given, stream).look).close)
    return measured


_HOLD: Final = 0.000_1
"""Seconds for which counters are read in one turn of the loop. When a single turn read those of ten contexts, five
times a second, it took 1.1 ms, and so was the p99 of lateness at 100 Hz; with turns of this length the p99 is 0.3
ms."""


class _Following:
    """A stream that reads counters in turns of the loop and sends the changed ones."""

    def __init__(self, kernel: Microkernel, given: Following, stream: Stream) -> None:
        self._kernel, self._given, self._stream = kernel, given, stream
        self._at = frozenset(given.at)
        self._pace = looks_of(kernel)
        self._timed = tuple(dict.fromkeys((*given.timed, *given.measured)))
        self._known: dict[tuple[str, str], Any] = {}
        """The counters that the client has, by kind and name."""
        self._task: asyncio.Task[None] | None = None
        stream.on_close(self._close)

    def look(self) -> None:
        if self._task is not None and not self._task.done():
            return  # the last look still runs
        if self._pace.due():
            return  # looks took more than their share; the next one sends all changes
        if not self._stream.has_room:
            self._stream.miss(1)
            return
        seen: set[tuple[str, str]] = set()
        item = {**_moment(self._kernel), "whole": not self._known}
        made = answer_in_turns(self._kernel, self._steps(item, seen), _HOLD)
        if isinstance(made, dict):
            self._send(item, seen)
        else:
            self._task = kernel_task(self._kernel.loop, self._send_later(made, seen), "aiorts control counters")

    async def _send_later(self, made: Awaitable[_Made], seen: set[tuple[str, str]]) -> None:
        self._send(await made, seen)

    def _send(self, item: _Made, seen: set[tuple[str, str]]) -> None:
        gone: dict[str, list[str]] = {}
        for key in self._known.keys() - seen:
            del self._known[key]
            gone.setdefault(key[0], []).append(key[1])
        if not self._stream.send({**item, "gone": gone}):
            self._known.clear()  # the next item is whole

    def _steps(self, item: _Made, seen: set[tuple[str, str]]) -> Generator[None, None, _Made]:
        took, began = 0.0, perf_counter()
        for kind, name, value in self._counted():
            seen.add((kind, name))
            if self._known.get((kind, name), _NEVER) != value:
                self._known[kind, name] = item[kind][name] = value
            took += perf_counter() - began
            yield
            began = perf_counter()
        self._pace.spend(took)
        return item

    def _counted(self) -> Iterator[_One]:
        kernel, given = self._kernel, self._given
        wires: dict[str, Any] = {**kernel.connectors, **kernel.service_connectors}
        if given.at:
            wires = {name: one for name, one in wires.items() if not self._at.isdisjoint(places_of(one))}
        names = tuple(name for name, _ in _chosen(wires, given.connectors))
        components = tuple(kernel.components) if given.components is None else given.components
        if given.at:
            owners = {path.partition(".")[0] for path in given.at}
            components = tuple(name for name in components if name in owners)
        for name in names:
            if name in kernel.connectors:
                yield "connectors", name, _counted(kernel.connectors[name])
        yield from _rest(kernel, Chosen(names, given.contexts, components, self._timed))

    def _close(self) -> None:
        if self._task is not None:
            self._task.cancel()


@dataclass(frozen=True, slots=True)
class Wires:
    """Connectors by name; a connector that has gone is left out."""

    connectors: tuple[str, ...]


def _sizes(session: Session, given: Wires) -> Mapping[str, Size]:
    return {name: _size(one) for name, one in _chosen(session.kernel.connectors, given.connectors)}


def _size(connector: Connector) -> Size:
    sample = last_written(connector.out)
    if sample is NOTHING:
        return Size(None, "nothing was written yet")
    try:
        return Size(len(MsgpackCodec().encode(sample)), "")
    except AiortsError as error:
        return Size(None, str(error))


ROWS: Final = (
    Operation(
        "counters",
        "Stream the counters at a rate: first all, then those that have changed.",
        Following,
        tuple[str, ...],
        Right.VIEW,
        _follow,
        item=CounterChanges,
    ),
    Operation("measure", "Measure connectors for the session.", Measured, tuple[str, ...], Right.OPERATE, _measure),
    Operation("sizes", "Encoded size of samples.", Wires, Mapping[str, Size], Right.VIEW, _sizes, idempotent=True),
    Operation("statistics", "The counters.", Chosen, Counters, Right.VIEW, _statistics, idempotent=True),
)
