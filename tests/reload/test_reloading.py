"""The code of a component type is replaced while the system runs: what stays, what goes, what is told."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from aiorts import Kernel, LifecycleState, PeriodicContext
from aiorts.events import ComponentReloaded
from aiorts.testing import simulated

if TYPE_CHECKING:
    from collections.abc import Callable

    from reload_files import Source

    Make = Callable[[str], Source]

PID = """
class Pid(Component):
    measured = InPort(TimedDouble)
    command = OutPort(TimedDouble)
    gain = Param(1.0)

    def __init__(self, name=""):
        super().__init__(name)
        self.runs = 0
        self.version = 1

    def on_execute(self):
        self.runs += 1

    def on_reload(self, old):
        self.runs = old.runs
"""


@pytest.mark.row(23)
@simulated
async def test_code_is_replaced_while_it_runs(source: Make) -> None:
    file = source(PID)
    events: list[ComponentReloaded] = []
    async with Kernel() as kernel:
        kernel.bus.subscribe(ComponentReloaded, events.append)
        old = await kernel.create(file.get("Pid"), "pid", gain=3.0)
        context = await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        await kernel.sleep(0.1)
        runs = old.runs
        file.replace("self.version = 1", "self.version = 2")
        done = await kernel.reload("Pid")
        new = kernel.components["pid"]
        assert new is not old
        assert (new.version, new.gain, new.state) == (2, 3.0, LifecycleState.ACTIVE)
        assert new.runs >= runs + 10
        assert context.members == (new,)
        assert done.components == tuple(events)
        assert events[0].kept == ("measured", "command", "gain")
        assert (events[0].old, events[0].new, events[0].dropped, events[0].added) == (0, 1, (), ())
        assert new.measured is old.measured
