"""Tells the controller what it was told in another run, and compares its answers with those of then, bit by bit."""

from __future__ import annotations

from pathlib import Path

from aiorts import Component, ExternalContext, InPort, OutPort, Param
from aiorts.errors import ConfigurationError
from aiorts.types import TimedDouble


class Tape(Component):
    """A simulator that knows the future: two forces, one tick of the controller, one answer to compare."""

    push = OutPort(TimedDouble, unit="N")
    force = OutPort(TimedDouble, unit="N")
    command = InPort(TimedDouble, unit="m/s")

    path = Param("", doc="what a Judge recorded")
    drives = Param("loop", doc="the external context to tick")

    def on_initialize(self) -> None:
        if not Path(self.path).is_file():
            text = f"{self.name}.path = {self.path!r}: no file; record one, then --set {self.name}.path=run.csv"
            raise ConfigurationError(text)
        lines = Path(self.path).read_text().splitlines()
        self.rows = [tuple(map(float, line.split(",")[:3])) for line in lines]

    def on_activated(self) -> None:
        self.done = self.same = 0
        self.fault = ""

    async def on_execute(self) -> None:
        if self.done == len(self.rows):
            self.finish()
            return
        push, force, expected = self.rows[self.done]
        now_ns, context = self.clock.time_ns(), self.kernel.contexts[self.drives]
        assert isinstance(context, ExternalContext)
        self.push.write_nowait(TimedDouble(now_ns, push))
        self.force.write_nowait(TimedDouble(now_ns, force))
        await context.tick()
        answers = [sample.data for sample in self.command.drain()]
        if answers == [expected]:
            self.same += 1
        elif not self.fault:
            self.fault = f"tick {self.done}: {answers} m/s, then {[expected]}"
        self.done += 1

    def on_deactivated(self) -> None:
        print(f"the same inputs, the same outputs: {self.same} of {len(self.rows)} ticks, to the last bit")
        right = self.same == len(self.rows) > 0
        if not right:
            print(f"not as promised: {self.fault or 'nothing was compared'}")
        self.kernel.request_stop(0 if right else 1)
