"""The component: voltages in, states of the battery out."""

from __future__ import annotations

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble
from aiorts_battery.records import BatteryState

__all__ = ("BatteryWatch",)


class BatteryWatch(Component):
    """Says how full a battery is, by its voltage, and when it is low."""

    voltage = InPort(TimedDouble, unit="V")
    battery = OutPort(BatteryState)

    cells = Param(3, ge=1, doc="cells in series")
    empty = Param(3.3, gt=0.0, unit="V", doc="of an empty cell")
    full = Param(4.2, gt=0.0, unit="V", doc="of a full cell")
    low = Param(0.2, ge=0.0, le=1.0, doc="charge below which it is low")

    charge = 1.0
    """Of the last sample, 0 empty to 1 full."""

    async def on_execute(self) -> None:
        for sample in self.voltage.drain():
            state = self.judge(sample)
            self.charge = state.charge
            await self.battery.write(state)

    def judge(self, sample: TimedDouble) -> BatteryState:
        """The state that a voltage stands for; its charge is linear between empty and full."""
        charge = (sample.data / self.cells - self.empty) / (self.full - self.empty)
        charge = min(1.0, max(0.0, charge))
        return BatteryState(tm=sample.tm, voltage=sample.data, charge=charge, low=charge < self.low)
