"""The service: it ends a run before the battery is flat. Its table of a system file is `[battery]`."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aiorts import KernelService, setting
from aiorts_battery.watch import BatteryWatch

if TYPE_CHECKING:
    from aiorts import Component, Microkernel

__all__ = ("BatteryGuard", "Limits")

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Limits:
    """How much of the battery is left alone."""

    reserve: float = setting(0.1, "Charge, 0 to 1, below which the run ends.", option=True, low=0, high=1)
    interval: float = setting(1.0, "Time between two looks.", unit="s", above=0)


class BatteryGuard(KernelService):
    """Asks for the end of the run when a `BatteryWatch` reports less than the reserve."""

    name = "battery"
    settings = Limits

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._limits = Limits()
        self._watches: list[BatteryWatch] = [one for one in kernel.components.values() if isinstance(one, BatteryWatch)]
        self._looks = 0
        self._timer = kernel.call_later(self._limits.interval, self._look)

    def configure(self, settings: Limits) -> None:
        self._limits = settings
        self._timer.cancel()
        self._timer = self.kernel.call_later(settings.interval, self._look)

    def report(self) -> Mapping[str, Any]:
        return {"reserve": self._limits.reserve, "looks": self._looks}

    def component_added(self, component: Component) -> None:
        if isinstance(component, BatteryWatch):
            self._watches.append(component)

    def component_removed(self, component: Component) -> None:
        self._watches = [one for one in self._watches if one is not component]

    def components_replaced(self, pairs: Mapping[Component, Component]) -> None:
        # New code of a type: its instances are of another class of the same name.
        self._watches = [pairs.get(one, one) for one in self._watches]  # type: ignore[misc]

    def closed(self) -> None:
        self._timer.cancel()

    def _look(self) -> None:
        self._looks += 1
        flat = [one.name for one in self._watches if one.charge < self._limits.reserve]
        if flat:
            _LOG.warning("%s: less than %g of the battery is left; the run ends", flat[0], self._limits.reserve)
            self.kernel.request_stop()
        else:
            self._timer = self.kernel.call_later(self._limits.interval, self._look)
