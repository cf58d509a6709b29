"""`kernel.monitor([...], rate)`: chosen values at a rate; a look takes no sample.

The values that can be named, by the kernel's own paths:

    component.port                the newest sample that can be seen without reading it
    component.port.field          a field of it
    component.parameter           the value in force
    component.state               lifecycle state, by context where there are several
    connector.written             also delivered, buffered, dropped
    connector.rate                samples written a second since the last reading; at first the mean, with `measure`
    connector.latency             from write to read, the median in seconds; also latency_p99, latency_max
    connector.age                 when read, by the stamp, the median in seconds; also age_p99, age_max
    context.ticks                 also overruns, skipped, rate
    context.lateness              the greatest so far in seconds; also lateness_p50, lateness_p99, of the last cycles

A connector is named by its name, or by its ports: a.out->b.in.latency. Latency and age need its option `measure`.

The newest sample of an in-port is the newest unread one, else the one read last; of an out-port it is the one written
last, also without a reader.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import ConfigurationError, WiringError
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.last_sample import last_written
from aiorts.kernel.ports.port import NOTHING
from aiorts.late import dataclass
from aiorts.model.profile import ConnectorStatistics
from aiorts.observe.iterating import ClosableIterator, Waiter
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.model.timing import Spans

_LEDGER: Final[Mapping[str, Callable[[Connector], Any]]] = {
    "written": lambda connector: connector.statistics.written,
    "delivered": lambda connector: connector.statistics.arrived,
    "buffered": lambda connector: connector.statistics.buffered,
    "dropped": lambda connector: sum(connector.statistics.dropped.values()),
    "rate": lambda connector: connector.statistics,
    "latency": lambda connector: _seconds(connector, "latency", "p50_ns"),
    "latency_p99": lambda connector: _seconds(connector, "latency", "p99_ns"),
    "latency_max": lambda connector: _seconds(connector, "latency", "max_ns"),
    "age": lambda connector: _seconds(connector, "age", "p50_ns"),
    "age_p99": lambda connector: _seconds(connector, "age", "p99_ns"),
    "age_max": lambda connector: _seconds(connector, "age", "max_ns"),
}
_CONTEXT: Final[Mapping[str, Callable[[Context], Any]]] = {
    "ticks": lambda context: context.statistics.cycles,
    "rate": lambda context: context.rate,
    "lateness": lambda context: context.statistics.lateness_max_ns / 1e9,
    "lateness_p50": lambda context: context.statistics.lateness_p50_ns / 1e9,
    "lateness_p99": lambda context: context.statistics.lateness_p99_ns / 1e9,
    "overruns": lambda context: context.statistics.overruns,
    "skipped": lambda context: context.statistics.skipped,
}


@dataclass(frozen=True, slots=True)
class Reading:
    """The values at one moment."""

    time_ns: int
    """The kernel's clock, since the epoch."""
    monotonic_ns: int
    values: Mapping[str, Any]
    """The values by requested path; None for a missing value: no sample yet, or a component that is gone."""
    missed: int = 0
    """Readings left out since the last one: the reader was slower than the rate."""


class Monitor(ClosableIterator):
    """An async iterator of `Reading`, `rate` times a second on the kernel's clock; ends with its kernel, or `close()`.

    `async with` closes it.
    """

    def __init__(self, kernel: Microkernel, paths: Sequence[str], rate: float) -> None:
        if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0.0 < rate <= 10_000.0:
            raise ConfigurationError(f"monitor: rate = {rate!r}: expected a number of Hz above 0 and up to 10,000")
        if isinstance(paths, str) or not paths or not all(isinstance(path, str) for path in paths):
            raise ConfigurationError(f'monitor({paths!r}): expected a list of paths, such as ["pid0.gain"]')
        self._kernel = kernel
        self._paths = tuple(paths)
        self._period_ns = round(1e9 / rate)
        self._due_ns: int | None = None
        self._closed = False
        self._waiter = Waiter()
        self._before: dict[str, ConnectorStatistics] = {}
        """The statistics at the last reading, of connectors whose rate is requested."""
        for path in self._paths:
            _look(kernel, path)

    def close(self) -> None:
        """End the stream; idempotent."""
        self._closed = True
        self._waiter.wake()

    async def __anext__(self) -> Reading:
        kernel, missed = self._kernel, 0
        now_ns = kernel.clock.monotonic_ns()
        if self._due_ns is None:
            self._due_ns = now_ns
        else:
            late = max(0, now_ns - self._due_ns) // self._period_ns
            missed = max(0, late - 1)
            self._due_ns += (missed + 1) * self._period_ns
            if not (kernel.closed or self._closed):
                await self._wait(self._due_ns - now_ns)
        if kernel.closed or self._closed:
            raise StopAsyncIteration
        return self.look(missed)

    def look(self, missed: int = 0) -> Reading:
        """The values at this moment."""
        values = {path: self._value(path) for path in self._paths}
        clock = self._kernel.clock
        return Reading(clock.time_ns(), clock.monotonic_ns(), MappingProxyType(values), missed)

    async def _wait(self, duration_ns: int) -> None:
        if duration_ns <= 0:
            await asyncio.sleep(0)
            return
        timer = self._kernel.call_later(duration_ns / 1e9, self._waiter.wake)
        self._kernel.closing.add_done_callback(self._waiter.wake)
        try:
            await self._waiter.wait()
        finally:
            timer.cancel()
            self._kernel.closing.remove_done_callback(self._waiter.wake)

    def _value(self, path: str) -> Any:
        try:
            found = _look(self._kernel, path)
        except (ConfigurationError, WiringError):
            return None  # it was there when it was asked for, and may be again
        if not isinstance(found, ConnectorStatistics):
            return found
        # The path requests a rate.
        before, self._before[path] = self._before.get(path), found
        try:
            return found.mean_rate if before is None else found.rate_since(before)
        except ConfigurationError:
            return None  # another connector of this name, or in virtual time the same moment


def _look(kernel: Microkernel, path: str) -> Any:
    """The value of a path at this moment.

    Raises:
        WiringError: there is no such value; the text names the values that exist.
    """
    owner, _, rest = path.partition(".")
    first, _, field = rest.partition(".")
    name, _, what = path.rpartition(".")
    component, context, connector = kernel.components.get(owner), kernel.contexts.get(name), kernel.connectors.get(name)
    if "->" in name:
        connector = _between(kernel, path, *name.split("->", 1))
        context = component = None
    if connector is not None and what in _LEDGER and "." in name:
        return _LEDGER[what](connector)  # named by its ports: its name begins with that of a component
    if component is not None and first:
        return _of_component(component, path, first, field)
    if context is not None and what in _CONTEXT:
        return _CONTEXT[what](context)
    if connector is not None and what in _LEDGER:
        return _LEDGER[what](connector)
    if component is not None:
        there = ", ".join((*component.ports, *component.params, "state"))
        raise WiringError(f"{path}: is a component; say what of it, such as {path}.state; it has {there}")
    if context is not None or connector is not None:
        raise WiringError(f"{path}: {name} has no {what!r}; it has {', '.join(_CONTEXT if context else _LEDGER)}")
    known = [*kernel.components, *kernel.contexts, *kernel.connectors]
    advice = suggestion(owner, known, shown=str)
    raise WiringError(f"{path}: there is no component, context or connector {owner!r}; {advice}")


def _between(kernel: Microkernel, path: str, out: str, in_: str) -> Connector:
    """The first connector from one port to the other."""
    ports = (out.strip(), in_.strip())
    for connector in kernel.connectors.values():
        if (connector.out.path, connector.in_.path) == ports:
            return connector
    there = ", ".join(f"{one.out.path}->{one.in_.path}" for one in tuple(kernel.connectors.values())[:20])
    raise WiringError(f"{path}: there is no connector from {ports[0]} to {ports[1]}; there are {there or 'none'}")


def _seconds(connector: Connector, what: str, figure: str) -> float | None:
    """A measured figure in seconds; None where nothing was measured yet."""
    spans: Spans | None = getattr(connector.statistics, what)
    if spans is not None:
        return getattr(spans, figure) / 1e9 if spans.count else None
    if not connector.profile.measure:
        raise WiringError(
            f"{connector.name}.{what}: is not measured; connect with measure=1000, the samples over which it is taken"
        )
    raise WiringError(f"{connector.name}.{what}: {connector.in_.path} has a type without a time stamp tm")


def _of_component(component: Component, path: str, first: str, field: str) -> Any:
    port = component.ports.get(first)
    if port is not None:
        sample = _seen(port)
        for name in field.split(".") if field and sample is not None else ():
            if not hasattr(sample, name):
                raise WiringError(f"{path}: {type(sample).__name__} has no field {name!r}")
            sample = getattr(sample, name)
        return sample
    if not field and first in component.params:
        return component.params[first].value
    if not field and first == "state":
        states = {name: state.value for name, state in component.states.items()}
        return next(iter(states.values()), None) if len(states) < 2 else states
    there = ", ".join((*component.ports, *component.params, "state"))
    raise WiringError(f"{path}: {component.name} has no {first!r}; it has {there}")


def _seen(port: Port[Any]) -> Any:
    """The newest sample of a port, read without an effect: an unread sample stays unread."""
    if isinstance(port, OutPort):
        sample = last_written(port)
        return None if sample is NOTHING else sample
    if not isinstance(port, InPort):
        return None
    return receiver_of(port).look()
