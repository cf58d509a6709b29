"""The supervision service of one kernel: recovery, start in order, and systemd; each part is made on first use."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import SimulatedClock
from aiorts.errors import AiortsError, ConfigurationError
from aiorts.kernel.loop.bus import ContextStarted
from aiorts.kernel.service import KernelService, setting
from aiorts.late import dataclass
from aiorts.model.wanted.start_rules import in_order
from aiorts.supervision import start_sequence
from aiorts.supervision.readiness import until
from aiorts.supervision.start_sequence import Patience
from aiorts.supervision.supervisor import Supervisor

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.wanted.restart_policy import Supervision
    from aiorts.model.wanted.start_rules import StartRule
    from aiorts.supervision.supervisor import Supervised
    from aiorts.supervision.systemd import SystemdLink

_SETTLES: Final = 10.0
"""Seconds for which restarts are waited for."""


@dataclass(frozen=True, slots=True)
class Readiness:
    """The notices to systemd, where the environment names its socket."""

    ready: tuple[str, ...] = setting(
        (), "Components that are active once the system is ready; by default all it activates."
    )

    def __post_init__(self) -> None:
        if not all(isinstance(name, str) for name in self.ready):
            raise ConfigurationError(f"ready: expected names of components, got {self.ready!r:.80}")


class Supervising(KernelService):
    """Supervises the components of a kernel; see the methods of the same names of `aiorts.Kernel`."""

    name = "supervision"
    settings = Readiness

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._supervisor: Supervisor | None = None
        self._systemd: SystemdLink | None = None
        self._started: list[str] = []
        """The components that were started in order; at the end they stop in the reverse order."""
        self.rules: dict[str, StartRule] = {}
        """The rules by which components were started, by the component's name."""

    def configure(self, settings: Readiness) -> None:
        def notify_ready(_event: ContextStarted | None = None) -> None:
            unsubscribe()
            self.notify_systemd(settings.ready, os.environ)

        # If no components are named, all components in a context have to be ready, once a context runs.
        unsubscribe = self.kernel.bus.subscribe(ContextStarted, notify_ready)
        if isinstance(self.kernel.clock, SimulatedClock):
            unsubscribe()
        elif settings.ready:
            notify_ready()

    def report(self) -> Mapping[str, Any]:
        return {name: repr(one) for name, one in self.supervised.items()}

    def supervise(
        self, component: Component, policy: Supervision, factory: Callable[[str], Component] | None
    ) -> Supervised:
        """See `Kernel.supervise`."""
        if self._supervisor is None:
            self._supervisor = Supervisor(self.kernel)
        return self._supervisor.supervise(component, policy, factory)

    @property
    def supervised(self) -> Mapping[str, Supervised]:
        """The supervised components, by name; a component that could not be replaced stays here, as exhausted."""
        return MappingProxyType({} if self._supervisor is None else self._supervisor.supervised)

    async def settle(self, name: str | None = None) -> None:
        """Wait until no component, or not this one, is between two instances; no longer than 10 s."""
        kernel, supervised = self.kernel, self.supervised
        await until(
            kernel, lambda: not any(one.is_between for one in supervised.values() if name in (None, one.name)), _SETTLES
        )

    async def start_in_order(self, rules: Sequence[StartRule], patience: Patience | None = None) -> None:
        """See `Kernel.start_in_order`; `patience` knows how long these rules have waited before."""
        in_order(rules)
        self.rules.update((rule.component, rule) for rule in rules)
        patience = patience or Patience(self.kernel, rules)
        await start_sequence.start_in_order(self.kernel, rules, self._started, patience)

    async def stop_in_order(self, timeout: float | None) -> None:
        """See `Kernel.stop_in_order`."""
        started, self._started = self._started, []
        await start_sequence.stop_in_order(self.kernel, started, timeout)

    def notify_systemd(self, components: Sequence[Component | str], environ: Mapping[str, str]) -> bool:
        """See `Kernel.notify_systemd`."""
        from aiorts.supervision.systemd import Notifier, SystemdLink, watchdog_interval

        if self._systemd is not None:
            raise ConfigurationError(f"{self.kernel.name}: systemd is notified of it already")
        notifier = Notifier.from_environment(environ)
        if notifier is None:
            return False
        self._systemd = SystemdLink(self.kernel, notifier, watchdog_interval(environ), components)
        return True

    def components_replaced(self, pairs: Mapping[Component, Component]) -> None:
        if self._supervisor is not None:
            self._supervisor.replaced(pairs)

    async def closing(self, budget: StopBudget) -> None:
        if self._systemd is not None:
            await self._systemd.close()
        if self._supervisor is not None:
            await self._supervisor.close()
        with contextlib.suppress(AiortsError):  # its context reports that when it stops
            await start_sequence.stop_in_order(self.kernel, self._started)
