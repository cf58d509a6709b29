"""Looks into a kernel while it runs: streams of changes, chosen values and samples, heart-beats, listeners.

Nothing here changes the system: samples are copied by a tap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from aiorts.errors import ConfigurationError
from aiorts.kernel.loop.observers import check_length
from aiorts.kernel.service import KernelService
from aiorts.model.buffer import DEFAULT_LENGTH

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports import OutPort
    from aiorts.kernel.ports.connector import Connector
    from aiorts.model.connect_options import ConnectOptions
    from aiorts.observe.changes import Changes
    from aiorts.observe.heartbeats import Heartbeat
    from aiorts.observe.listening import Listening
    from aiorts.observe.monitor import Monitor
    from aiorts.observe.samples import Feed, Samples


class Introspection(KernelService):
    """The service that looks into one kernel; see the methods of the same names of `aiorts.Kernel`."""

    name = "observe"

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._changes: WeakSet[Changes] = WeakSet()
        self._heartbeats: WeakSet[Heartbeat] = WeakSet()
        self._feeds: WeakSet[Feed[Any]] = WeakSet()
        self._listening: Listening | None = None

    def changes(self, length: int) -> Changes:
        """See `Kernel.changes`."""
        from aiorts.observe.changes import Changes

        check_length("changes", length)
        made = Changes(self.kernel, length)
        self._changes.add(made)
        return made

    def samples(self, port: OutPort[Any] | str, options: ConnectOptions) -> Samples[Any]:
        """See `Kernel.samples`."""
        from aiorts.observe.samples import samples_of

        check_length("samples", options.get("length", DEFAULT_LENGTH))
        feed, made = samples_of(self, port, options)
        self._feeds.add(feed)
        return made

    def monitor(self, paths: Sequence[str], rate: float) -> Monitor:
        """See `Kernel.monitor`."""
        from aiorts.observe.monitor import Monitor

        return Monitor(self.kernel, paths, rate)

    def heartbeat(self, interval: float) -> Callable[[], None]:
        """See `Kernel.heartbeat`."""
        from aiorts.observe.heartbeats import Heartbeat

        if isinstance(interval, bool) or not isinstance(interval, int | float) or not 0.001 <= interval <= 86_400:
            raise ConfigurationError(f"heartbeat: interval = {interval!r}: expected 0.001 to 86400 seconds")
        made = Heartbeat(self.kernel, interval)
        self._heartbeats.add(made)
        return made.stop

    @property
    def listening(self) -> Listening:
        """The listeners of connectors, made at the first use."""
        if self._listening is None:
            from aiorts.observe.listening import Listening

            self._listening = Listening(self.kernel)
        return self._listening

    def connector_made(self, connector: Connector) -> None:
        if self.kernel.bus.samples_wanted:
            self.listening.made(connector)

    def observers_changed(self) -> None:
        if self.kernel.bus.samples_wanted or self._listening is not None:
            self.listening.all_wanted(self.kernel.bus.samples_wanted)

    def stopped(self) -> None:
        for heartbeat in tuple(self._heartbeats):
            heartbeat.stop()
        for feed in tuple(self._feeds):
            feed.end()
        if self._listening is not None:
            self._listening.report()

    def closed(self) -> None:
        for changes in tuple(self._changes):
            changes.end()
