"""A component that is a state machine: an automatic door with a button, a light barrier, timers and a motor.

Run: python examples/door/door.py

It prints the diagram of the table that runs (Mermaid), then what the door does in 14 simulated seconds.
"""

from __future__ import annotations

from aiorts import Component, EventContext, EventPort, Kernel, OutPort, Param, SimulatedClock, StateMachineComponent
from aiorts.events import MachineChanged
from aiorts.statechart import After, Chart, On, State
from aiorts.testing import simulate
from aiorts.types import TimedBoolean, TimedDouble


class Door(StateMachineComponent):
    """Opens at a button, closes by itself, opens again when something is in the way."""

    button = EventPort(TimedBoolean)
    barrier = EventPort(TimedDouble, unit="m")
    motor = OutPort(TimedDouble, unit="m/s")
    dwell = Param(5.0, unit="s", gt=0.0)

    chart = Chart(
        State("closed", On("button", to="opening"), initial=True),
        State(
            "moving",
            State("opening", After(2.0, to="open"), entry="drive_out", initial=True),
            State("closing", After(2.0, to="closed"), On("barrier", to="opening", guard="is_near"), entry="drive_in"),
            exit="halt",
        ),
        State("open", After("dwell", to="closing"), On("button", to="closing")),
    )

    async def drive_out(self) -> None:
        await self.drive(0.5)

    async def drive_in(self) -> None:
        await self.drive(-0.5)

    async def halt(self) -> None:
        await self.drive(0.0)

    async def drive(self, speed: float) -> None:
        await self.motor.write(TimedDouble(self.clock.time_ns(), speed))

    def is_near(self, distance: TimedDouble) -> bool:
        return distance.data < 0.8


class Visitor(Component):
    """Presses the button, and stands in the way."""

    finger = OutPort(TimedBoolean)
    feet = OutPort(TimedDouble, unit="m")


async def main(clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        door, visitor = await kernel.add(Door("door")), await kernel.add(Visitor("visitor"))
        print(door.chart.to_mermaid())
        await kernel.connect(visitor.finger, door.button)
        await kernel.connect(visitor.feet, door.barrier)
        kernel.bus.subscribe(MachineChanged, lambda change: show(clock, change))
        await kernel.start(EventContext(), door, activate=True)
        await kernel.sleep(1.0)
        await visitor.finger.write(TimedBoolean(clock.time_ns(), True))
        await kernel.sleep(8.0)  # opening 2 s, open 5 s, closing for 1 s
        await visitor.feet.write(TimedDouble(clock.time_ns(), 0.3))
        await kernel.sleep(5.0)


def show(clock: SimulatedClock, change: MachineChanged) -> None:
    print(f"{clock.monotonic_ns() / 1e9:5.1f} s  {change.event or '(lifecycle)':16} {'/'.join(change.new) or '-'}")


if __name__ == "__main__":
    simulate(main)
