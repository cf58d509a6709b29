"""What a kernel offers to watch over its components: supervision, names, readiness, ordered start; thin, see elsewhere.

Each part is made when it is first asked for: a kernel that uses none of them has none.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

from aiorts.errors import AiortsError, ConfigurationError, DeclarationError
from aiorts.kernel import naming, readiness, sequence
from aiorts.kernel.supervision import Supervised, Supervisor
from aiorts.kernel.systemd import Notifier, SystemdLink, watchdog_interval
from aiorts.kernel.watchdog import LoopStalls, LoopWatch
from aiorts.model.naming import NamePolicy
from aiorts.model.sequence import StartRule, in_order

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel
    from aiorts.model.supervision import Supervision

__all__ = ("Supervising",)


class Supervising:
    """The part of a kernel that watches over its components."""

    _supervisor: Supervisor | None = None
    _loop_watch: LoopWatch | None = None
    _systemd: SystemdLink | None = None
    _naming: NamePolicy = NamePolicy()
    _started: list[str] | None = None
    """What was started in order, for the end."""

    # -- components that fail --------------------------------------------------------------------------------------

    def supervise(
        self, component: Component, policy: Supervision, *, factory: Callable[[str], Component] | None = None
    ) -> Supervised:
        """Say what is done when this component fails, and how long its hooks may take; replaces what was said before.

        Args:
            policy: see `Supervision`. Hooks of a thread context cannot be cancelled and have no deadline.
            factory: makes a new instance of the given name, for "restart"; the component's class by default.

        Raises:
            StateError: it is not of this kernel. DeclarationError: the policy is none, the factory is no function, or
                a composite is to be made anew or to have deadlines: its members can, it can be reset.
        """
        kernel = cast("Kernel", self)
        kernel._check_mine(component, "supervise")
        if self._supervisor is None:
            self._supervisor = Supervisor(kernel)
        return self._supervisor.supervise(component, policy, factory)

    @property
    def supervised(self) -> Mapping[str, Supervised]:
        """The supervised components, by name."""
        return MappingProxyType({} if self._supervisor is None else self._supervisor.supervised)

    # -- names, and who is there ------------------------------------------------------------------------------------

    @property
    def naming(self) -> NamePolicy:
        """How instances without a name are named from now on; "{type}{number}" by default. May be set at any time."""
        return self._naming

    @naming.setter
    def naming(self, policy: NamePolicy) -> None:
        if not isinstance(policy, NamePolicy):
            raise DeclarationError(f"naming = {policy!r}: expected NamePolicy(...)")
        self._naming = policy

    def _instance_name(self, kind: type) -> str:
        kernel, policy = cast("Kernel", self), self._naming
        return kernel._free_name(kind.__name__) if policy.plain else naming.instance_name(kernel, kind, policy)

    async def wait_ready(self, *components: Component | str, timeout: float | None = 10.0) -> None:
        """Wait until these components are active in every context they are in; by default all that are in a context.

        A source that has finished counts as ready. A name may be given before there is a component of it.

        Args:
            timeout: seconds of the kernel's clock; None waits for ever.

        Raises:
            TransitionTimeout: says who is not active, and why as far as that is known. ClosedError: the kernel closes.
        """
        kernel = cast("Kernel", self)
        kernel._require_open("wait_ready")
        await readiness.wait_ready(kernel, components, timeout)

    async def start_in_order(self, rules: Sequence[StartRule]) -> None:
        """Activate components one after the other, each once its conditions hold and its `wait` is over.

        They are deactivated in the reverse order by `stop_in_order`, or else when the kernel closes. One that fails
        leaves those before it active.

        Raises:
            ConfigurationError: the rules wait for each other (names them); nothing was started.
            TransitionTimeout: a condition did not come true; names it. StateError: there is no such component.
            ComponentError: its `on_activated` raised.
        """
        kernel = cast("Kernel", self)
        kernel._require_open("start in order")
        in_order(rules)
        if self._started is None:
            self._started = []
        await sequence.start_in_order(kernel, rules, self._started)

    async def stop_in_order(self, *, timeout: float | None = 5.0) -> None:
        """Deactivate what `start_in_order` has activated, the last first, each before the next.

        Raises:
            TransitionTimeout: one was not deactivated within `timeout` seconds; the others were.
        """
        kernel = cast("Kernel", self)
        kernel._require_open("stop in order")
        started, self._started = self._started, None
        await sequence.stop_in_order(kernel, started or (), timeout)

    # -- the event loop --------------------------------------------------------------------------------------------

    def watch_loop(self, limit: float = 5.0, policy: str = "warn") -> bool:
        """Watch the loop: what keeps it from turning for 0.2 s is logged in one line while it does, with its stack.

        Nothing is said while a debugger holds the process. Called again it changes limit and policy.

        Args:
            limit: seconds after which `policy` comes into force.
            policy: "warn" says so once more; "exit" ends the process at once with status 70, for who restarts it.

        Returns:
            Whether it is watched: not in simulated time, and not where the system has no timerfd.

        Raises:
            ConfigurationError: limit or policy out of range.
        """
        kernel = cast("Kernel", self)
        kernel._require_open("watch the loop")
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0 < limit < math.inf:
            raise ConfigurationError(f"limit = {limit!r}: expected seconds above 0")
        if policy not in ("warn", "exit"):
            raise ConfigurationError(f'policy = {policy!r}: expected "warn" or "exit"')
        if self._loop_watch is not None:
            self._loop_watch.limit_ns, self._loop_watch.policy = round(limit * 1e9), policy
            return True
        watch = LoopWatch(kernel, limit, policy)
        if not watch.open():
            return False
        self._loop_watch = watch
        return True

    @property
    def loop_stalls(self) -> LoopStalls:
        """How often and how long the loop did not turn, since `watch_loop`."""
        return LoopStalls() if self._loop_watch is None else self._loop_watch.stalls

    # -- who supervises the process --------------------------------------------------------------------------------

    def notify_systemd(self, *components: Component | str, environ: Mapping[str, str] | None = None) -> bool:
        """Tell systemd of this kernel, if the environment asks for it; False when it does not.

        READY=1 once these components (by default all that are in a context) are active; STOPPING=1 when the kernel
        closes; STATUS= whenever it changes; WATCHDOG=1 four times in WATCHDOG_USEC, while all contexts get on: a hook
        that runs for half of that time is answered for no longer.

        Args:
            environ: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID are taken from it; those of the process by default.

        Raises:
            ConfigurationError: systemd is told of this kernel already.
        """
        kernel = cast("Kernel", self)
        kernel._require_open("notify systemd")
        if self._systemd is not None:
            raise ConfigurationError(f"{kernel.name}: systemd is told of it already")
        given = os.environ if environ is None else environ
        notifier = Notifier.from_environment(given)
        if notifier is None:
            return False
        self._systemd = SystemdLink(kernel, notifier, watchdog_interval(given), components)
        return True

    # -- the end ---------------------------------------------------------------------------------------------------

    def _end_watching(self) -> None:
        """The kernel has closed."""
        if self._loop_watch is not None:
            self._loop_watch.close()

    async def _end_supervision(self) -> None:
        """The kernel closes."""
        if self._systemd is not None:
            await self._systemd.close()
        if self._supervisor is not None:
            await self._supervisor.close()
        if self._started:
            with contextlib.suppress(AiortsError):  # its context says so when it stops
                await sequence.stop_in_order(cast("Kernel", self), self._started)
