"""Who is removed while it is restarted is gone: by `remove`, and by a plan that reads the system meanwhile."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from aiorts import Component, Kernel, PeriodicContext, Supervision
from aiorts.supervision import Supervising
from aiorts.system import build, load, prepare, wanted
from aiorts.testing import simulated

PARTS = """
from aiorts import Component

class Idle(Component):
    pass

class Failing(Component):
    async def on_initialize(self):
        await self.sleep(0.003)
    async def on_execute(self):
        raise ValueError("always")
    async def on_shutdown(self):
        await self.sleep(0.002)
    async def on_finalize(self):
        await self.sleep(0.004)
"""
FEW = """\
schema = 1
components.idle.type = "parts.py:Idle"
contexts.a = { kind = "periodic", rate = 10.0, members = ["idle"] }
"""
MORE = """\
components.failing.type = "parts.py:Failing"
components.failing.supervision = { restart = "restart", backoff = 0.004, budget = 1000 }
contexts.b = { kind = "periodic", rate = 200.0, members = ["failing"] }
"""


class Failing(Component):
    async def on_initialize(self) -> None:
        await self.sleep(0.003)

    async def on_execute(self) -> None:
        raise ValueError("always")

    async def on_shutdown(self) -> None:
        await self.sleep(0.002)

    async def on_finalize(self) -> None:
        await self.sleep(0.004)


@pytest.mark.parametrize("before", [0.002, 0.005, 0.007, 0.009])
@simulated
async def test_a_removal_in_the_midst_of_a_restart_is_one(before: float) -> None:
    """The restart went on where it had asked for the same removal: the component came back."""
    async with Kernel() as kernel:
        failing = await kernel.create(Failing, "failing")
        kernel.supervise(failing, Supervision("restart", backoff=0.004, budget=1000))
        context = await kernel.start(PeriodicContext(rate=200.0), failing, activate=True)
        await kernel.sleep(before)
        await kernel.remove(kernel.components["failing"])
        await kernel.sleep(1.0)
        assert (dict(kernel.components), context.members) == ({}, ())


@pytest.mark.parametrize("before", [0.005, 0.007, 0.009])
@simulated
async def test_nobody_waits_on_for_a_restart_that_a_removal_has_ended(before: float) -> None:
    """Nothing would come in its place: the wait took its 10 s."""
    async with Kernel() as kernel:
        failing = await kernel.create(Failing, "failing")
        supervised = kernel.supervise(failing, Supervision("restart", backoff=0.004, budget=1000))
        await kernel.start(PeriodicContext(rate=200.0), failing, activate=True)
        await kernel.sleep(before)
        assert supervised.is_between
        settling = asyncio.ensure_future(kernel.service(Supervising).settle())
        await asyncio.sleep(0)
        assert not settling.done()
        await kernel.remove(kernel.components["failing"])
        removed = kernel.clock.monotonic_ns()
        await settling
        assert kernel.clock.monotonic_ns() - removed < 10_000_000


@pytest.mark.parametrize("steps", range(12))
@simulated
async def test_a_plan_removes_it_with_its_context_whenever_it_is_restarted(tmp_path: Path, steps: int) -> None:
    """Of thirty such plans one or more left it: between two instances it was read as gone, and came afterwards."""
    (tmp_path / "parts.py").write_text(PARTS)
    few, more = tmp_path / "few.toml", tmp_path / "more.toml"
    few.write_text(FEW)
    more.write_text(FEW + MORE)
    async with Kernel() as kernel:
        await build(kernel, load(more))
        await kernel.sleep(0.05 + 0.0015 * steps)
        await kernel.apply(wanted(prepare(load(few))))
        assert (set(kernel.components), set(kernel.contexts)) == ({"idle"}, {"a"})
        await kernel.sleep(1.0)
        assert (set(kernel.components), set(kernel.contexts)) == ({"idle"}, {"a"})
