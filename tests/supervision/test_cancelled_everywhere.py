"""As test_cancelled_calls.py, for what came later: sets, composites, modes, files, profiles; complete."""

from __future__ import annotations

import asyncio
import inspect
from typing import TYPE_CHECKING, Any

import pytest

import aiorts
from aiorts import (
    Composite,
    ExternalContext,
    Kernel,
    LifecycleState,
    MultiModeComponent,
    Param,
    PeriodicContext,
    Supervision,
)
from aiorts.testing.simulation import simulate
from supervision.test_cancelled_calls import CALLS as FIRST_CALLS
from supervision.test_cancelled_calls import Part, World, cancelled_after

if TYPE_CHECKING:
    from pathlib import Path

    from aiorts import SimulatedClock
    from supervision.test_cancelled_calls import Call


class Mode(MultiModeComponent):
    modes = ("manual", "automatic")

    async def on_mode_changed(self) -> None:
        await self.sleep(0.001)


class Whole(World):
    """With a composite that runs, a component with modes, and a context that is ticked."""

    async def build(self) -> Whole:
        await super().build()
        kernel = self.kernel
        self.mode = await kernel.add(Mode("mode"))
        await kernel.start(PeriodicContext(100.0), self.mode, activate=True)
        self.inner = [await kernel.create(Part, f"inner{number}") for number in range(2)]
        self.composite = await kernel.add(Composite("whole", *self.inner, exported={"*.out": "{component}_out"}))
        self.ticked = await kernel.start(ExternalContext(), await kernel.create(Part, "ticked"), activate=True)
        await kernel.start(PeriodicContext(200.0), self.composite, activate=True)
        await self.one.configuration.add("soft", {"gain": 0.5})
        await self.one.add_param("speed", Param(1.0))
        return self


async def _deactivated(w: Any) -> None:
    await w.composite.deactivate()
    await w.composite.activate()


async def _failed(w: Any) -> None:
    context, member = w.composite.context, w.inner[0]
    context.runner.life.failed(context.runner.member(member), "on_execute", RuntimeError("told to"))
    await w.kernel.sleep(0.02)
    await w.composite.reset()


async def _quietened(w: Any) -> None:
    await w.kernel.activate("two")
    await w.kernel.deactivate(w.two)


async def _repaired(w: Any) -> None:
    await w.kernel.activate("two")
    w.context.runner.life.failed(w.context.runner.member(w.two), "on_execute", RuntimeError("told to"))
    await w.kernel.sleep(0.02)
    await w.kernel.reset("two")


async def _opened(w: Any) -> None:
    other = Kernel("other")
    try:
        await other.open()
        await other.create(Part, "part")
    finally:
        await other.aclose()


async def _entered(w: Any) -> None:
    async with Kernel("other") as other:
        await other.create(Part, "part")


async def _observed(w: Any) -> None:
    async def slow(event: object) -> None:
        await asyncio.sleep(0.002)

    w.kernel.bus.subscribe(aiorts.events.Event, slow)
    w.free.add_port("more", aiorts.InPort(aiorts.types.TimedDouble))
    await w.kernel.bus.aclose()


async def _watched(w: Any) -> None:
    async with w.kernel.changes() as watch:
        await anext(watch)
        await w.kernel.create(Part, "new")
        await anext(watch)


async def _monitored(w: Any) -> None:
    readings = w.kernel.monitor(["one.gain"], rate=1000.0)
    for _ in range(2):
        await anext(readings)


async def _helped(w: Any) -> None:
    """A restart is no public coroutine, but what it consists of is cancelled by whoever supervises anew."""
    w.kernel.supervise(w.two, Supervision("restart", backoff=0.001))
    await w.context.activate(w.two)
    w.context.runner.life.failed(w.context.runner.member(w.two), "on_execute", RuntimeError("told to"))
    await w.kernel.sleep(0.02)


CALLS: dict[str, Call] = {
    "Configuration.activate": lambda w: w.one.configuration.activate("soft"),
    "Configuration.add": lambda w: w.one.configuration.add("hard", {"gain": 9.0}),
    "Configuration.change": lambda w: w.one.configuration.change("soft", {"gain": 9.0}),
    "Configuration.remove": lambda w: w.one.configuration.remove("soft"),
    "Configuration.replace": lambda w: w.one.configuration.replace({"hard": {"gain": 9.0}}, "hard"),
    "Configuration.merge": lambda w: w.one.configuration.merge({"hard": {"gain": 9.0}}, "hard"),
    "Configurable.add_param": lambda w: w.one.add_param("mass", Param(1.0)),
    "Configurable.remove_param": lambda w: w.one.remove_param("speed"),
    "MultiModeComponent.set_mode": lambda w: w.mode.set_mode("automatic"),  # type: ignore[attr-defined]
    "Composite.activate": _deactivated,
    "Composite.deactivate": lambda w: w.composite.deactivate(),  # type: ignore[attr-defined]
    "Composite.reset": _failed,
    "Composite.change": lambda w: w.composite.change(members=[*reversed(w.inner), w.free]),  # type: ignore[attr-defined]
    "Composite.add_members": lambda w: w.composite.add_members(w.free),  # type: ignore[attr-defined]
    "Composite.remove_members": lambda w: w.composite.remove_members(w.inner[0]),  # type: ignore[attr-defined]
    "ExternalContext.tick": lambda w: w.ticked.tick(),  # type: ignore[attr-defined]
    "Introspection.profile_in_turns": lambda w: w.kernel.profile_in_turns(hold=0.0),
    "Microkernel.activate": lambda w: w.kernel.activate("two"),
    "Microkernel.deactivate": _quietened,
    "Microkernel.reset": _repaired,
    "Kernel.move": lambda w: w.kernel.move(w.two, aiorts.PeriodicContext(100.0, name="elsewhere")),
    "Kernel.open": _opened,
    "Kernel.__aenter__": _entered,
    "Kernel.__aexit__": _entered,
    "Bus.aclose": _observed,
    "watch": _watched,
    "monitor": _monitored,
    "restart": _helped,
}
FILES = {
    "ConfigurationFiles.save_configuration",
    "ConfigurationFiles.load_configuration",
    "ConfigurationFiles.diff_configuration",
}
ELSEWHERE = {
    "SimulatedClock.advance": "the clock of the tests: what it moves is what is cancelled here",
    "SimulatedClock.advance_to": "the same",
    "RealtimeContext.add": "Context.add, after a check that waits for nothing",
    "Kernel.create_isolated": "isolation/test_isolated.py",
    "Kernel.stand_in": "remote/test_members.py",
    "Microkernel.stand_in": "remote/test_members.py",
    "Kernel.apply": "planning/test_apply_cancelled.py",
    "Kernel.reload": "reload/test_cancelled.py",
    "Kernel.save": "planning/test_save.py",
    "KernelService.starting": "a service's part of a start; whoever is cancelled in a start has it cancelled, too",
    "KernelService.closing": "the kernel's own, while it closes; nobody who is cancelled awaits it",
    "KernelService.leaving": "the kernel's own, while it closes; nobody who is cancelled awaits it",
    "KernelService.ending": "the kernel's own, while it closes; nobody who is cancelled awaits it",
    "Goal.__anext__": "services/test_goals.py",
    "Goal.result": "services/test_goals.py",
    "Synchronizer.match": "sync/test_synchronizer.py",
    "Required.wait_bound": "services/test_cancelled_anywhere.py",
    "ServicePort.wait_bound": "services/test_cancelled_anywhere.py",
}


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("G05")
@pytest.mark.parametrize("name", CALLS)
def test_cancelled_at_every_turn_it_leaves_nothing_behind(name: str) -> None:
    at = 0
    while simulate(lambda clock, turns=at: cancelled_after(turns, CALLS[name], clock, Whole)):  # type: ignore[misc]
        at += 1
        assert at < 400
    assert at > 0


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("G05")
@pytest.mark.parametrize("name", sorted(FILES))
def test_files_are_whole_or_untouched_whenever_it_is_cancelled(name: str, tmp_path: Path) -> None:
    file = tmp_path / "values.toml"

    async def whole(clock: SimulatedClock, turns: int) -> bool:
        before = asyncio.all_tasks()
        async with Kernel() as kernel:
            world = await Whole(kernel).build()
            await kernel.save_configuration(file)
            text = file.read_text()
            await world.one.configure(gain=3.0)
            task = asyncio.ensure_future(getattr(kernel, name.partition(".")[2])(file))
            for _ in range(turns):
                await asyncio.sleep(0)
            under_way = not task.done()
            task.cancel()
            await asyncio.wait([task], timeout=10.0)
            assert task.done()
            assert file.read_text() in (text, text.replace("gain = 1.0", "gain = 3.0", 1))
            assert world.one.configuration.values["gain"] in (1.0, 3.0)
            assert [path.name for path in tmp_path.iterdir()] == ["values.toml"]
            assert world.one.state is LifecycleState.INACTIVE
            await world.one.configure(gain=4.0)
        assert asyncio.all_tasks() == before
        return under_way

    for turns in range(12):
        simulate(lambda clock, turns=turns: whole(clock, turns))  # type: ignore[misc]


@pytest.mark.fault("G05")
def test_no_public_coroutine_was_forgotten() -> None:
    covered = {name.rpartition(".")[2] for name in (*FIRST_CALLS, *CALLS, *FILES)}
    forgotten = set()
    for public in aiorts.__all__:
        thing = getattr(aiorts, public)
        for base in thing.__mro__ if isinstance(thing, type) else ():
            for name, value in vars(base).items() if base.__module__.startswith("aiorts.") else ():
                function = getattr(value, "__func__", value)
                private = name.startswith("_") and name not in ("__aenter__", "__aexit__", "__anext__")
                if inspect.iscoroutinefunction(function) and not private:
                    said = f"{base.__qualname__}.{name}"
                    if said not in (*CALLS, *FILES, *ELSEWHERE) and name not in covered:
                        forgotten.add(said)
    forgotten = {name for name in forgotten if not name.rpartition(".")[2].startswith("on_")}
    assert forgotten == set()
