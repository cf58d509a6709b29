"""Connectors with `max_gap`: an event when the writer has not written for longer, one when it writes again.

One timer for each such connector compares how much was written with what it saw before, so a write costs nothing and a
miss is found one to two gaps after the last write. It runs while both ends are active and the writer is not silent. The
next write of a silent writer is noticed, since it has to choose its path again: no timer keeps a simulation going.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import to_ns
from aiorts.kernel.execution.member import is_open
from aiorts.kernel.loop.bus import ContextStarted, ContextStopped, Event, MemberAdded, MemberRemoved, StateChanged
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.far import FarOutPort
from aiorts.kernel.ports.port import host_of, refresh
from aiorts.late import dataclass

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import KernelSide
    from aiorts.kernel.ports import OutPort, Port
    from aiorts.kernel.ports.connector import Connector
    from aiorts.model.profile import ConnectorStatistics

_LOG = KernelLog()
_QUIET_NS: Final = 60_000_000_000
"""The time within which only one gap of a connector is logged; the next line counts the others."""
_NOTED: Final = (StateChanged, MemberAdded, MemberRemoved, ContextStarted, ContextStopped)
"""The events after which components may be active that were not before, or the reverse."""


@dataclass(frozen=True, slots=True)
class WriterSilent(Event):
    """A connector got no sample for longer than its `max_gap`, while both ends were active."""

    connector: str
    writer: str
    """Path of the out-port."""
    max_gap: float
    """Seconds."""


@dataclass(frozen=True, slots=True)
class WriterBack(Event):
    """A connector whose writer was silent got a sample again."""

    connector: str
    writer: str
    """Path of the out-port."""
    max_gap: float
    """Seconds."""


class _Watch:
    """The watch over one connector."""

    __slots__ = ("active", "connector", "gap_ns", "logged_ns", "missed", "seen", "silent", "timer", "unlogged")

    def __init__(self, connector: Connector, gap_ns: int) -> None:
        self.connector = connector
        # One nanosecond more, so that a write at the very end of a gap is in time.
        self.gap_ns = gap_ns + 1
        self.active = self.silent = False
        self.seen = 0
        """The number of samples written at the last check."""
        self.missed = self.unlogged = 0
        self.logged_ns: int | None = None
        self.timer: Any = None

    @property
    def written(self) -> int:
        """The number of samples written so far, including those that wait for room."""
        transport, out = transport_of(self.connector), self.connector.out
        held = out.held() if isinstance(out, FarOutPort) else 0
        return transport.total() + sum(not entry.done for entry in transport.waiting or ()) + held


class Gaps:
    """The connectors with `max_gap` of one kernel."""

    def __init__(self, kernel: KernelSide) -> None:
        self._kernel = kernel
        self._watches: dict[Connector, _Watch] = {}
        self._removers: list[Callable[[], None]] = []
        self._awaited: set[OutPort[Any]] = set()
        """The out-ports of silent writers, whose next write is to be noticed."""

    def add(self, connector: Connector) -> None:
        """Watch the connector, if it has `max_gap`."""
        if connector.profile.max_gap is None:
            return
        if not self._removers:
            self._removers = [self._kernel.bus.subscribe(kind, self._changed) for kind in _NOTED]
        watch = self._watches[connector] = _Watch(connector, to_ns(connector.profile.max_gap))
        self._fit(watch)

    def end(self, connector: Connector) -> None:
        """Stop watching a connector that has ended."""
        watch = self._watches.pop(connector, None)
        if watch is not None:
            self._pause(watch)
            if watch.unlogged:
                self._log(watch, f"was silent {watch.unlogged} times more")
            self._awaited.discard(connector.out)
            if not self._watches:
                for remove in self._removers:
                    remove()
                self._removers = []

    def added(self, statistics: ConnectorStatistics, connector: Connector) -> ConnectorStatistics:
        """The ledger of a connector, with how often its writer was silent."""
        watch = self._watches.get(connector)
        return statistics if watch is None else replace(statistics, missed_gaps=watch.missed, silent=watch.silent)

    def is_silent(self, connector: Connector) -> bool:
        """Whether the connector's writer is silent; from any thread, without a check."""
        watch = self._watches.get(connector)
        return watch is not None and watch.silent

    def writes(self, out: OutPort[Any]) -> None:
        """Note, from any thread, the first write at an out-port since it was refreshed."""
        if out in self._awaited:
            self._awaited.discard(out)
            self._kernel.loop.call_soon_threadsafe(self._look_at, out)

    def _changed(self, event: Event) -> None:
        name = getattr(event, "component", None)
        for watch in tuple(self._watches.values()):
            ends = (host_of(watch.connector.out), host_of(watch.connector.in_))
            if name is None or any(end is not None and end.name == name for end in ends):
                self._fit(watch)

    def _fit(self, watch: _Watch) -> None:
        """Start checking if both ends are active, and pause otherwise."""
        active = self._is_active(watch.connector.out) and self._is_active(watch.connector.in_)
        if active and not watch.active:
            watch.active = True
            if watch.silent:
                self._look(watch)
            else:
                watch.seen = watch.written
                self._go_on(watch)
        elif not active and watch.active:
            self._pause(watch)

    def _is_active(self, port: Port[Any]) -> bool:
        if port.is_far:
            # At a link only the reader's end checks: it sees what arrives, and takes the writer for active.
            return port.direction == "out"
        host = host_of(port)
        component = None if host is None or host.retired else self._kernel.components.get(host.name)
        return component is not None and is_open(component)

    def _pause(self, watch: _Watch) -> None:
        watch.active = False
        if watch.timer is not None:
            watch.timer.cancel()
            watch.timer = None

    def _go_on(self, watch: _Watch) -> None:
        """Check again after a gap or, if the writer is silent, at its next write."""
        if not watch.silent:
            self._set_timer(watch)
            return
        out = watch.connector.out
        self._awaited.add(out)
        refresh(out)
        if watch.written > watch.seen:  # in another thread, before it was asked to say so
            self.writes(out)

    def _set_timer(self, watch: _Watch) -> None:
        if watch.timer is None:
            now_ns = self._kernel.clock.monotonic_ns()
            watch.timer = self._kernel.call_at(now_ns + watch.gap_ns, lambda: self._look(watch))

    def _look(self, watch: _Watch) -> None:
        """Check whether samples were written since the last check; publish an event if the writer's silence changed."""
        watch.timer = None
        written, before = watch.written, watch.seen
        watch.seen = written
        if watch.silent is (written > before):
            watch.silent = not watch.silent
            watch.missed += watch.silent
            self._publish(watch)
        self._go_on(watch)

    def _look_at(self, out: OutPort[Any]) -> None:
        """Check the connectors of an out-port whose silent writer was about to write."""
        for connector in out.connectors:
            watch = self._watches.get(connector)
            if watch is not None and watch.silent and watch.active:
                if watch.written > watch.seen:
                    if watch.timer is not None:
                        watch.timer.cancel()
                    self._look(watch)
                else:  # it was refused, or a thread is not done with it yet
                    self._set_timer(watch)
                    self._awaited.add(out)
                    refresh(out)

    def _publish(self, watch: _Watch) -> None:
        connector, max_gap = watch.connector, watch.connector.profile.max_gap
        assert max_gap is not None  # noqa: S101 - it is why it is watched
        if watch.silent:
            self._log_silence(watch, max_gap)
        elif not watch.unlogged:
            _LOG.info("%s: %s writes again", connector.name, connector.out.path)
        kind = WriterSilent if watch.silent else WriterBack
        self._kernel.bus.publish(kind(connector.name, connector.out.path, max_gap))

    def _log_silence(self, watch: _Watch, max_gap: float) -> None:
        now_ns = self._kernel.clock.monotonic_ns()
        if watch.logged_ns is not None and now_ns - watch.logged_ns < _QUIET_NS:
            watch.unlogged += 1
            return
        watch.logged_ns = now_ns
        self._log(watch, f"has not written for more than {max_gap:g} s{_more(watch.unlogged)}")
        watch.unlogged = 0

    def _log(self, watch: _Watch, text: str) -> None:
        _LOG.warning("%s: %s %s", watch.connector.name, watch.connector.out.path, text)


def _more(count: int) -> str:
    return f", and {count} times more since the line before" if count else ""
