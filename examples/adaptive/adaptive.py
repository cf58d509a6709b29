"""A component that opens a port when its state asks for it, and a tool that sees it at once.

A gripper watches its force. As long as it holds nothing it has a force port alone; when it feels something it opens
`slip`, and closes it again when it lets go. The tool knows nothing of grippers: it follows `kernel.changes()`, connects
a display to every out-port that appears, and prints each change. Exits with 1 unless it was told of all of it.

Run: python examples/adaptive/adaptive.py
"""

from __future__ import annotations

import asyncio
import sys

from aiorts import Component, EventContext, InPort, Kernel, OutPort, PeriodicContext, SimulatedClock
from aiorts.events import Change, PortAdded, PortRemoved
from aiorts.testing import simulate
from aiorts.types import TimedDouble


class Gripper(Component):
    """Closes, holds something from tick 20 to tick 60, and lets go."""

    force = OutPort(TimedDouble, unit="N")
    ticks = 0

    def on_execute(self) -> None:
        self.ticks += 1
        held = 20 <= self.ticks < 60
        now_ns = self.clock.time_ns()
        self.force.write_nowait(TimedDouble(now_ns, 5.0 if held else 0.0))
        slip = self.ports.get("slip")
        if held and slip is None:
            slip = self.add_port("slip", OutPort(TimedDouble, unit="m", doc="how far it slipped"))
        elif not held and slip is not None:
            self.remove_port("slip")
        if held and isinstance(slip, OutPort):
            slip.write_nowait(TimedDouble(now_ns, 0.001 * (self.ticks - 20)))


class Display(Component):
    """Counts what it was sent."""

    shown = InPort(TimedDouble)
    count = 0

    def on_execute(self) -> None:
        self.count += len(self.shown.drain())


async def follow(kernel: Kernel, told: list[str]) -> None:
    """The tool: print each port that comes or goes, and show what comes."""
    displays = 0
    async with kernel.changes() as watch:
        async for change in watch:
            if not isinstance(change, Change) or not isinstance(change.event, PortAdded | PortRemoved):
                continue
            port, owner = change.event.port, change.event.component
            came = isinstance(change.event, PortAdded)
            if owner != "gripper0":
                continue
            told.append(f"{'+' if came else '-'}{owner}.{port.name}")
            print(f"{kernel.clock.monotonic_ns() / 1e9:5.2f} s  {'opened' if came else 'closed'} {owner}.{port.name}")
            out = kernel.components[owner].ports.get(port.name)
            if came and isinstance(out, OutPort):
                displays += 1
                display = await kernel.create(Display, f"display{displays}")
                await kernel.connect(out, display.shown, keep_last=True)
                await kernel.start(EventContext(), display, activate=True)


async def main(clock: SimulatedClock) -> int:
    told: list[str] = []
    async with Kernel() as kernel:
        tool = asyncio.create_task(follow(kernel, told))
        await asyncio.sleep(0)
        gripper = await kernel.create(Gripper, "gripper0")
        await kernel.start(PeriodicContext(rate=100.0), gripper, activate=True)
        await kernel.sleep(1.0)
        counts = [display.count for display in kernel.components.values() if isinstance(display, Display)]
    await tool
    print(f"shown: {counts[0]} samples of force, {counts[1]} of slip")
    seen = told == ["+gripper0.force", "+gripper0.slip", "-gripper0.slip"]
    return 0 if seen and counts[0] > 90 and counts[1] > 30 else 1


if __name__ == "__main__":
    sys.exit(simulate(main))
