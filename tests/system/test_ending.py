"""When a system has ended of itself, also when its source was faster than who waits for the end."""

from __future__ import annotations

from aiorts import Component, EventContext, InPort, Kernel, OutPort
from aiorts.system import wait_finished
from aiorts.testing import simulated
from aiorts.types import TimedLong


class Brief(Component):
    """A source that has nothing to say."""

    out = OutPort(TimedLong)

    def on_activated(self) -> None:
        self.finish()


class Sink(Component):
    inp = InPort(TimedLong)


@simulated
async def test_a_source_that_finished_before_anybody_looked_has_finished() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.create(Brief), await kernel.create(Sink)
        await kernel.connect(source.out, sink.inp)
        assert not source.has_finished
        context = await kernel.start(EventContext(), source, activate=True)
        await kernel.sleep(1.0)
        assert source.has_finished
        assert await wait_finished(kernel) == ()
        await context.activate(source)
        await kernel.sleep(1.0)
        assert source.has_finished  # said once more


@simulated
async def test_a_source_that_was_deactivated_by_others_has_not_finished() -> None:
    class Endless(Brief):
        def on_activated(self) -> None:
            """Go on."""

    async with Kernel() as kernel:
        source = await kernel.create(Endless)
        context = await kernel.start(EventContext(), source, activate=True)
        await context.deactivate()
        assert not source.has_finished
