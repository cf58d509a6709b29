"""What a kernel tells of itself: the part of `Kernel` that only looks.

Everything here may be called while the system runs, changes nothing and takes no sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, cast
from weakref import WeakSet

from aiorts.errors import ConfigurationError

if TYPE_CHECKING:
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.heartbeats import Heartbeat
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.listening import ConnectorEvent, Listening
    from aiorts.kernel.monitoring import Monitor
    from aiorts.kernel.watching import Watch
    from aiorts.model.system_profile import SystemProfile

__all__ = ("Introspection",)


class Introspection:
    """See `Kernel`."""

    _opened_ns = 0
    """When the kernel was opened, on its clock's monotonic time."""
    _ended = False
    """Whether everything was given up."""
    origin = ""
    """The text of the system file that it was built from; "" without one."""

    def profile(self) -> SystemProfile:
        """The whole system at this moment, as frozen values; `to_json()` makes one document of it.

        Raises:
            ClosedError: the kernel was never opened. ThreadError: called in another thread than the kernel's.
        """
        from aiorts.kernel.profiling import system_profile

        kernel = cast("Kernel", self)
        kernel.check_thread("profile")
        kernel.loop  # noqa: B018 - raises ClosedError
        return system_profile(kernel)

    async def profile_in_turns(self, hold: float = 0.001) -> SystemProfile:
        """The same, without holding the loop for longer than `hold` seconds (and one component) at a time.

        Everything that an event tells of is as it is when this returns; counters are of moments since the call.
        """
        from aiorts.kernel.watching import system_profile_in_turns

        kernel = cast("Kernel", self)
        kernel._require_open("profile_in_turns")
        return await system_profile_in_turns(kernel, hold)

    def watch(self, *, length: int = 1024) -> Watch:
        """What the system is, and then each change of it: an async iterator of `Fresh` and `Change`.

        The first is a `Fresh` with the profile. Applied one after the other (`profile = change.apply(profile)`) they
        give the profile of each moment, without what changes without an event (`SystemProfile.structure`).

        Args:
            length: changes that wait for a slow reader; beyond that they are dropped for a fresh profile.

        Raises:
            ClosedError: the kernel is not open. ConfigurationError: the length is none.
        """
        from aiorts.kernel.observers import check_length
        from aiorts.kernel.watching import Watch

        kernel = cast("Kernel", self)
        kernel._require_open("watch")
        check_length("watch", length)
        made = Watch(kernel, length)
        self._watches.add(made)
        return made

    @cached_property
    def _watches(self) -> WeakSet[Watch]:
        return WeakSet()

    def monitor(self, paths: Sequence[str], rate: float = 10.0) -> Monitor:
        """Values such as "pid0.command.data", "pid0.gain", "loop.lateness" at a rate: an async iterator of `Reading`.

        Nothing is disturbed: no sample is taken, what is missed is counted. What can be named: `monitoring.py`.

        Args:
            rate: Hz on the kernel's clock, up to 10,000.

        Raises:
            WiringError: there is no such value now. ConfigurationError: the rate is none. ClosedError: not open.
        """
        from aiorts.kernel.monitoring import Monitor

        kernel = cast("Kernel", self)
        kernel._require_open("monitor")
        return Monitor(kernel, paths, rate)

    def heartbeat(self, interval: float = 1.0) -> Callable[[], None]:
        """Send a ContextBeat of each context and a ComponentBeat of each component at this interval, in seconds of
        the kernel's clock, until the returned function is called or the kernel closes.

        Raises:
            ConfigurationError: the interval is not from 0.001 to 86,400. ClosedError: the kernel is not open.
        """
        from aiorts.kernel.heartbeats import Heartbeat

        kernel = cast("Kernel", self)
        kernel._require_open("heartbeat")
        if isinstance(interval, bool) or not isinstance(interval, int | float) or not 0.001 <= interval <= 86_400:
            raise ConfigurationError(f"heartbeat: interval = {interval!r}: expected 0.001 to 86400 seconds")
        made = Heartbeat(kernel, interval)
        self._heartbeats.add(made)
        return made.stop

    @cached_property
    def _heartbeats(self) -> WeakSet[Heartbeat]:
        return WeakSet()

    def listen(
        self, connector: Connector, listener: Callable[[ConnectorEvent], object], *kinds: str
    ) -> Callable[[], None]:
        """Tell `listener` what becomes of the samples of a connector, until the returned function is called.

        It is told on the loop, soon after, in order. One that raises is counted and harms nobody. A connector that is
        listened to is slower; all others are not. For all connectors: `bus.subscribe(ConnectorEvent, listener)`.

        Args:
            kinds: of `Happening`; all by default.

        Raises:
            StateError: the connector is not of this kernel, or a real-time thread is at it.
        """
        cast("Kernel", self).check_thread("listen")
        return self.listening.add(connector, listener, kinds)

    @cached_property
    def listening(self) -> Listening:
        """Who listens to connectors."""
        from aiorts.kernel.listening import Listening

        return Listening(cast("Kernel", self))

    def _repr_html_(self) -> str:
        from aiorts.kernel.html import kernel_html

        return kernel_html(cast("Kernel", self))
