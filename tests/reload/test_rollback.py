"""New code that does not work is taken back whole: the old instances go on as if nobody had asked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, EventContext, Kernel, LifecycleState, OutPort, PeriodicContext
from aiorts.errors import AiortsError, ComponentError, PluginError
from aiorts.events import ComponentReloaded
from aiorts.testing import simulated
from aiorts.types import Time, TimedDouble

if TYPE_CHECKING:
    from collections.abc import Callable

    from reload_files import Source

    Make = Callable[[str], Source]

ACTIVE = LifecycleState.ACTIVE

WORKER = """
class Worker(Component):
    data = InPort(TimedDouble)
    gain = Param(1.0, le=10.0)

    def __init__(self, name=""):
        super().__init__(name)
        self.log_of = ["old"]
        self.runs = 0
        self.device = object()
        self.got = []

    def on_initialize(self):
        pass  # initialize

    def on_execute(self):
        self.runs += 1
        self.got += [sample.data for sample in self.data.drain()]
        # execute

    def on_state_update(self):
        pass  # update

    def on_finalize(self):
        self.log_of.append("finalized")

    def on_reload(self, old):
        self.runs, self.got = old.runs, old.got
        self.device, old.device = old.device, None
        # reload
"""

BROKEN: dict[str, tuple[tuple[str, str], type[AiortsError], str]] = {
    "syntax": (("class Worker(Component):", "class Worker(Component:"), PluginError, "SyntaxError"),
    "import": (("class Worker(", "import no_such_module_anywhere\nclass Worker("), PluginError, "ModuleNotFoundError"),
    "declaration": (("Param(1.0, le=10.0)", "Param(1.0, le=0.5)"), PluginError, "DeclarationError"),
    "renamed": (("class Worker(", "class Labourer("), PluginError, "Worker is gone (the file has Labourer)"),
    "no component": (("class Worker(Component)", "class Worker"), PluginError, "is no component class any more"),
    "hook": (("def on_reload(self, old):", "def on_reload(self):"), PluginError, "on_reload(self)"),
    "constructor": (('self.log_of = ["old"]', "1 / 0"), PluginError, "cannot be constructed: ZeroDivisionError"),
    "takes more": (('__init__(self, name="")', "__init__(self, name, more)"), PluginError, "cannot be constructed"),
    "initialize": (
        ("pass  # initialize", "raise OSError('busy')"),
        PluginError,
        "on_initialize of the new code raised",
    ),
    "values": (
        ("    def on_init", "    def check_configuration(self, v):\n        raise ValueError('no')\n\n    def on_init"),
        PluginError,
        "refuses the values in force",
    ),
    "reload": (("# reload", "raise KeyError('state')"), ComponentError, "w.on_reload of the new code failed: KeyError"),
    "exit": (("# reload", "raise SystemExit(3)"), ComponentError, "w.on_reload of the new code failed: SystemExit"),
    "first cycle": (("# execute", "raise ValueError('bad')"), ComponentError, "w.on_execute of the new code failed"),
    "fifth cycle": (("# execute", "if self.runs % 5 == 4: 1 / 0"), ComponentError, "w.on_execute of the new code"),
    "returns": (("# execute", "return 1"), ComponentError, "w.on_execute of the new code failed: StateError"),
    "update": (
        ("pass  # update", "raise ValueError('bad')"),
        ComponentError,
        "w.on_state_update of the new code failed",
    ),
    "attribute": (("# execute", "self.made_in_on_activated"), ComponentError, "a reload runs no on_activated"),
    "task": (
        ("# reload", "asyncio.get_running_loop().create_task(self.fail())\n\n    async def fail(self):\n        1 / 0"),
        ComponentError,
        "w.task of the new code failed: ZeroDivisionError",
    ),
}


class Writer(Component):
    """Writes a number in each cycle."""

    out = OutPort(TimedDouble)
    count = 0

    def on_execute(self) -> None:
        self.out.write_nowait(TimedDouble(Time(0, 0), float(self.count)))
        self.count += 1


@pytest.mark.row(23)
@pytest.mark.parametrize("what", BROKEN)
@pytest.mark.parametrize("kind", ["same", "event"])
def test_old_code_is_back_whole(what: str, kind: str, source: Make) -> None:
    edit, error, text = BROKEN[what]

    @simulated
    async def run() -> None:
        file = source(WORKER)
        told: list[Any] = []
        async with Kernel() as kernel:
            writer = await kernel.create(Writer, "writer")
            old = await kernel.create(file.get("Worker"), "w", gain=4.0)
            connector = await kernel.connect(writer.out, old.data, length=1000)
            period = PeriodicContext(rate=100.0)
            context: Any = period
            if kind == "same":
                await kernel.start(period, writer, old, activate=True)
            else:
                context = await kernel.start(EventContext(), old, activate=True)
                await kernel.start(period, writer, activate=True)
            await kernel.sleep(0.1)
            device, attributes = old.device, vars(old).keys() | set()
            kernel.bus.subscribe(ComponentReloaded, told.append)
            file.replace(*edit)
            with pytest.raises(error) as raised:
                # A task that failed is its component's failure half a second later.
                await kernel.reload(file.get("Worker"), cycles=100)
            assert text in str(raised.value)
            assert str(file.path.name) in str(raised.value)
            await kernel.sleep(0.1)
            assert kernel.components["w"] is old
            assert context.state(old) is ACTIVE
            assert old.contexts == (context,)
            assert context.members[-1] is old
            assert old.device is device
            assert vars(old).keys() == attributes
            assert (old.log_of, old.gain) == (["old"], 4.0)
            assert old.data.connectors == (connector,)
            counts = connector.statistics
            assert not sum(counts.dropped.values())
            assert counts.written == counts.delivered + counts.buffered
            assert [type(one).__name__ for one in kernel.registry.tasks] == []
            assert told == []
            runs = old.runs
            await kernel.sleep(0.1)
            assert old.runs >= runs + 9

    run()
