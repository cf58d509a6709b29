"""What a kernel offers to watch over its components: supervision, names, readiness, ordered start; thin, see elsewhere.

Each part is imported and made when it is first asked for: a kernel that uses none of them has none.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

from aiorts.errors import AiortsError, ConfigurationError, DeclarationError

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.reload_events import Reloaded
    from aiorts.kernel.supervision import Supervised, Supervisor
    from aiorts.kernel.systemd import SystemdLink
    from aiorts.kernel.watchdog import LoopStalls, LoopWatch
    from aiorts.model.naming import NamePolicy
    from aiorts.model.sequence import StartRule
    from aiorts.model.supervision import Supervision

__all__ = ("Supervising",)


class Supervising:
    """The part of a kernel that watches over its components."""

    _supervisor: Supervisor | None = None
    _loop_watch: LoopWatch | None = None
    _systemd: SystemdLink | None = None
    _naming: NamePolicy | None = None
    """None: as `NamePolicy()` says."""
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
            from aiorts.kernel.supervision import Supervisor

            self._supervisor = Supervisor(kernel)
        return self._supervisor.supervise(component, policy, factory)

    @property
    def supervised(self) -> Mapping[str, Supervised]:
        """The supervised components, by name."""
        return MappingProxyType({} if self._supervisor is None else self._supervisor.supervised)

    # -- new code --------------------------------------------------------------------------------------------------

    async def reload(
        self,
        kind: type[Component] | str,
        *,
        cycles: int = 10,
        seconds: float = 1.0,
        timeout: float | None = 5.0,
        import_timeout: float = 30.0,
    ) -> Reloaded:
        """Replace a component type's code while the system runs: its file is read anew, its instances go on with it.

        Each instance gets a new one in its place, between two cycles, all of a context at once: same name, place in the
        order and life-cycle state, parameters in force and sets, and the connectors and unread samples of the ports
        that its code still has. `on_initialize` of the new one runs before, beside the old one; then its `on_reload`,
        which is told the old one; no other transition hook runs. Tasks of the old one are cancelled (beside
        the new one's they would take each other's samples), and its `on_finalize` runs at the end: what `on_reload`
        takes over for good it takes away from the old one. It returns
        when the new code has done its first cycles without a failure; whatever fails before that has everything taken
        back, attributes of the old instance included; where a hook of the new code runs on, 10 s are waited, and then
        the old code comes back when that hook returns. If tasks of it had been cancelled, its `on_deactivated` and
        `on_activated` are run, to start them anew, while it stays active. A caller that is cancelled ends nothing.

        Only the file itself is read anew, not what it imports. Other types in it keep their code; what is created
        afterwards is made of the new, by a supervised restart, too, if its factory is the class or a `partial` of it.

        Args:
            kind: a class, "Pid", "pid.py:Pid", or a name that a plugin offers; there are instances of it.
            cycles: the new code has proved itself after so many cycles of each context, 0 at once,
            seconds: or after so many seconds of the kernel's clock.
            timeout: seconds of the kernel's clock in which `on_initialize` of each new instance has to return, every
                context to come to the end of a cycle, and `on_reload` to return; None is for ever.
            import_timeout: seconds of real time that running the file may take.

        Raises:
            PluginError: no such type, or its file cannot be loaded, or an instance not be made; names file and line.
            ComponentError: `on_reload`, or a hook in the first cycles, failed. StateError: one of them cannot be
            replaced: it is in a real-time context, say. TransitionTimeout: a context did not come to it in time.
            ClosedError: the kernel closes.
        """
        kernel = cast("Kernel", self)
        kernel._require_open("reload")
        from aiorts.kernel import reload  # late: most systems never do

        return await reload.reload(
            kernel, kind, cycles=cycles, seconds=seconds, timeout=timeout, import_timeout=import_timeout
        )

    # -- names, and who is there ------------------------------------------------------------------------------------

    @property
    def naming(self) -> NamePolicy:
        """How instances without a name are named from now on; "{type}{number}" by default. May be set at any time."""
        from aiorts.model.naming import NamePolicy

        return NamePolicy() if self._naming is None else self._naming

    @naming.setter
    def naming(self, policy: NamePolicy) -> None:
        from aiorts.model.naming import NamePolicy

        if not isinstance(policy, NamePolicy):
            raise DeclarationError(f"naming = {policy!r}: expected NamePolicy(...)")
        self._naming = policy

    def _instance_name(self, kind: type) -> str:
        kernel, policy = cast("Kernel", self), self._naming
        if policy is None or policy.plain:
            return kernel._free_name(kind.__name__)
        from aiorts.kernel import naming

        return naming.instance_name(kernel, kind, policy)

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
        from aiorts.kernel import readiness

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
        from aiorts.kernel import sequence
        from aiorts.model.sequence import in_order

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
        from aiorts.kernel import sequence

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
        from aiorts.kernel.watchdog import LoopWatch

        watch = LoopWatch(kernel, limit, policy)
        if not watch.open():
            return False
        self._loop_watch = watch
        return True

    @property
    def loop_stalls(self) -> LoopStalls:
        """How often and how long the loop did not turn, since `watch_loop`."""
        from aiorts.kernel.watchdog import LoopStalls

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
        from aiorts.kernel.systemd import Notifier, SystemdLink, watchdog_interval

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
            from aiorts.kernel import sequence

            with contextlib.suppress(AiortsError):  # its context says so when it stops
                await sequence.stop_in_order(cast("Kernel", self), self._started)
