"""New code that works and does worse than the old is taken back, with the figure; the machine is no fault of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, InPort, Kernel, PeriodicContext
from aiorts.errors import ClosedError, ComponentError, ConfigurationError
from aiorts.events import Overrun
from aiorts.model.blame import Blame
from aiorts.testing import simulated

if TYPE_CHECKING:
    from collections.abc import Callable

    from reload_files import Source

    Make = Callable[[str], Source]

CAMERA = """
class Camera(Component):
    out = OutPort(float)

    async def on_execute(self):
        await self.sleep(0.005)
        for _ in range(1):
            self.out.write_nowait(1.0)
"""
OVERRUNS = r"loop: \d\d of 100 ticks overran in 1 s, and 0 of 100 before"
DROPS = r"c\.out-sink\.into: 100 of 200 samples were dropped in 1 s, and 0 of 100 before"
RATE = r"c\.out-sink\.into: 0 samples a second, and 100 before"
WORSE: dict[str, tuple[tuple[str, str], str]] = {
    "overruns": (("sleep(0.005)", "sleep(0.015)"), OVERRUNS),
    "drops": (("range(1)", "range(2)"), DROPS),
    "rate": (("range(1)", "range(0)"), RATE),
}


class Sink(Component):
    """Reads one sample in each cycle, and fails when it is asked to."""

    into = InPort(float)
    fails = False

    def on_execute(self) -> None:
        if self.fails:
            raise OSError("no disk")
        if self.into.is_new:
            self.into.read_nowait()


async def system(kernel: Kernel, file: Source) -> Any:
    camera, sink = await kernel.create(file.get("Camera"), "c"), await kernel.create(Sink, "sink")
    await kernel.connect(camera.out, sink.into, length=1)
    await kernel.start(PeriodicContext(rate=100.0, name="loop"), camera, activate=True)
    await kernel.start(PeriodicContext(rate=100.0, name="reading"), sink, activate=True)
    await kernel.sleep(0.502)
    return camera


@pytest.mark.parametrize("what", WORSE)
def test_new_code_that_does_worse_is_taken_back_with_the_figure(what: str, source: Make) -> None:
    edit, figure = WORSE[what]

    @simulated
    async def run() -> None:
        file = source(CAMERA)
        async with Kernel() as kernel:
            old = await system(kernel, file)
            file.replace(*edit)
            with pytest.raises(ComponentError, match=rf"Camera: the new code does worse: {figure}; the old code is in"):
                await kernel.reload("Camera", window=1.0)
            assert kernel.components["c"] is old
            assert kernel.bus.observers == ()
            ran = kernel.contexts["loop"].ticks
            await kernel.sleep(1.0)
            assert kernel.contexts["loop"].ticks == pytest.approx(ran + 100, abs=1)
            await kernel.reload("Camera")  # as it is without a window: it does not fail

    run()


def test_new_code_that_does_as_well_is_kept(source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(CAMERA)
        async with Kernel() as kernel:
            old = await system(kernel, file)
            file.replace("0.005", "0.006")
            began = kernel.clock.monotonic_ns()
            done = await kernel.reload("Camera", window=1.0)
            assert [one.component for one in done.components] == ["c"]
            assert kernel.components["c"] is not old
            assert kernel.clock.monotonic_ns() - began == pytest.approx(2e9, rel=0.02)
            assert kernel.bus.observers == ()

    run()


def test_what_the_machine_does_in_the_window_is_no_fault_of_the_new_code(source: Make) -> None:
    """The same overruns, of which nobody but the machine, and then the hook, is the cause."""

    async def reload_with(kind: str, file: Source) -> None:
        async with Kernel() as kernel:
            await system(kernel, file)
            context: Any = kernel.contexts["loop"]

            def stall() -> None:
                if kernel.closed:
                    return
                # As a context reports it: the schedule counts, and the event has the blame.
                context._schedule.overruns += 1
                kernel.bus.publish(Overrun("loop", 0, 10_000_000, "skip", Blame(kind, "c", "on_execute")))
                kernel.call_later(0.05, stall)

            kernel.call_later(1.2, stall)
            await kernel.reload("Camera", window=1.0)

    @simulated
    async def run() -> None:
        file = source(CAMERA)
        await reload_with("machine", file)
        with pytest.raises(ComponentError, match=r"loop: \d\d of 10\d ticks overran in 1\S* s, and 0 of 100 before"):
            await reload_with("hook", file)

    run()


def test_another_component_that_fails_in_the_window_is_a_fault_of_the_new_code(source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(CAMERA)
        async with Kernel() as kernel:
            old = await system(kernel, file)
            sink: Any = kernel.components["sink"]
            kernel.call_later(1.5, lambda: setattr(sink, "fails", True))
            with pytest.raises(ComponentError, match="does worse: sink: in error: OSError: no disk; the old"):
                await kernel.reload("Camera", window=1.0)
            assert kernel.components["c"] is old

    run()


def test_a_failure_in_the_window_takes_all_back_at_once(source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(CAMERA)
        async with Kernel() as kernel:
            old = await system(kernel, file)
            file.replace("range(1)", "range(1 if self.clock.time() < 2.0 else None)")
            with pytest.raises(ComponentError, match=r"c\.on_execute of the new code failed: TypeError"):
                await kernel.reload("Camera", window=1.0)
            assert kernel.clock.time() < 2.1
            assert kernel.components["c"] is old
            assert kernel.bus.observers == ()

    run()


def test_a_kernel_that_closes_in_the_window_gives_the_reload_up(source: Make) -> None:
    @simulated
    async def run() -> None:
        for moment in (0.5, 1.5):
            file = source(CAMERA)
            async with Kernel() as kernel:
                await system(kernel, file)
                task = kernel.loop.create_task(kernel.reload(f"{file.path}:Camera", window=1.0))
                await kernel.sleep(moment)
            with pytest.raises(ClosedError):
                await task

    run()


def test_a_window_is_a_time(source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(CAMERA)
        async with Kernel() as kernel:
            await system(kernel, file)
            for wrong in (-1.0, float("nan"), float("inf"), "5"):
                with pytest.raises(ConfigurationError, match=r"reload: window = .*: expected a number from 0 on"):
                    await kernel.reload("Camera", window=wrong)  # type: ignore[arg-type]

    run()
