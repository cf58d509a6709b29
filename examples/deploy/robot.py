"""A small system that runs as a service: ordered start, supervision, a watched loop, and systemd told of it all.

Run: python examples/deploy/robot.py --seconds 1
"""

from __future__ import annotations

import argparse
import logging
import math
import signal

import aiorts
from aiorts import Component, EventContext, InPort, Kernel, OutPort, PeriodicContext, StartRule, Supervision
from aiorts.types import TimedDouble


class Sensor(Component):
    """A sensor that is read 50 times a second."""

    out = OutPort(TimedDouble, unit="V")

    async def on_execute(self) -> None:
        seconds = self.clock.time()
        self.out.write_nowait(TimedDouble(0, math.sin(seconds)))


class Controller(Component):
    """Counts what it gets; a real one would steer."""

    inp = InPort(TimedDouble, unit="V")

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.samples = 0

    async def on_execute(self) -> None:
        self.samples += len(self.inp.drain())

    def on_deactivated(self) -> None:
        print(f"controller has stopped after {'some' if self.samples else 'no'} samples", flush=True)


async def main(seconds: float | None) -> int:
    async with Kernel("robot") as kernel:
        sensor, controller = await kernel.create(Sensor, "sensor"), await kernel.create(Controller, "controller")
        await kernel.connect(sensor.out, controller.inp)
        # A loop that is blocked for 5 s ends the process with status 70; the unit file has it started again.
        kernel.watch_loop(limit=5.0, policy="exit")
        kernel.supervise(sensor, Supervision("restart", deadline=1.0))
        kernel.supervise(controller, Supervision("reset"))
        for number in (signal.SIGTERM, signal.SIGINT):
            kernel.loop.add_signal_handler(number, kernel.request_stop)
        await kernel.start(PeriodicContext(50.0), sensor)
        await kernel.start(EventContext(), controller)
        kernel.notify_systemd(sensor, controller)
        await kernel.start_in_order([StartRule("sensor", after="controller active"), StartRule("controller")])
        await kernel.wait_ready()
        print("robot is ready", flush=True)
        if seconds is not None:
            kernel.loop.call_later(seconds, kernel.request_stop)
        status = await kernel.wait_stop_requested()
        samples = getattr(kernel.components["controller"], "samples", 0)
    return status if samples else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=None, help="stop after so many; by default at SIGTERM")
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    raise SystemExit(aiorts.run(main(parser.parse_args().seconds)))
