"""The pytest plugin and `@simulated`: found by entry point, light to load, and fixtures keep working."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from aiorts.clock import SimulatedClock
from aiorts.testing import current_clock, pytest_plugin, simulated

ROOT = Path(__file__).parents[2]
SUITE = """
import asyncio
import pytest
from aiorts import Component, OutPort
from aiorts.testing import current_clock, simulated
from aiorts.types import TimedLong

class Counter(Component):
    out = OutPort(TimedLong)
    n = 0
    def on_execute(self):
        self.n += 1
        self.out.write_nowait(TimedLong(0, self.n))

@pytest.fixture
def anyio_backend():
    return "asyncio"

@pytest.fixture
def wait():
    return 3600.0

@simulated
async def test_simulated(wait, simulated_clock, tmp_path):
    await asyncio.sleep(wait)
    assert simulated_clock.time() == 3600.0
    assert current_clock() is simulated_clock

@pytest.mark.parametrize("n", [1, 2])
@simulated
async def test_rig(rig_factory, n):
    async with rig_factory(Counter(), rate=10.0) as rig:
        await rig.tick(n)
        assert rig.values("out")[-1] == n

@pytest.mark.anyio
async def test_kernel(aiorts_kernel, simulated_clock):
    await aiorts_kernel.add(Counter("c"))
    assert aiorts_kernel.clock is simulated_clock
    assert aiorts_kernel.debug

@simulated
async def test_left_open(rig_factory):
    await rig_factory(Counter()).__aenter__()
"""


def _run_suite(folder: Path) -> str:
    """What pytest says of the suite, with the plugin found as if aiorts were installed, and warnings as errors."""
    offers = folder / "site" / "aiorts_as_installed-0.dist-info"
    offers.mkdir(parents=True)
    (offers / "METADATA").write_text("Metadata-Version: 2.1\nName: aiorts-as-installed\nVersion: 0\n")
    (offers / "entry_points.txt").write_text(f"[pytest11]\naiorts = {pytest_plugin.__name__}\n")
    (folder / "test_user.py").write_text(SUITE)
    paths = os.pathsep.join(map(str, (offers.parent, ROOT, ROOT / "plugins")))
    command = [sys.executable, "-W", "error", "-m", "pytest", "-q", "-rE", "-p", "no:cacheprovider", "-W", "error"]
    environment = {**os.environ, "PYTHONPATH": paths, "PYTEST_ADDOPTS": ""}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=50)
    return done.stdout + done.stderr


@pytest.mark.slow(kept_by="test_simulated_test_runs_in_virtual_time")
def test_fixtures_of_the_plugin_work_in_a_suite_of_a_user(tmp_path: Path) -> None:
    report = _run_suite(tmp_path)
    assert "5 passed, 1 error" in report, report
    assert "1 rigs were not closed" in report


def test_plugin_is_declared_as_entry_point() -> None:
    with open(ROOT / "pyproject.toml", "rb") as file:
        declared = tomllib.load(file)["project"]["entry-points"]["pytest11"]
    assert declared == {"aiorts": pytest_plugin.__name__}


@pytest.mark.slow
def test_plugin_loads_nothing_of_the_test_kit() -> None:
    code = (
        "import sys, aiorts; before = set(sys.modules); import aiorts.testing.pytest_plugin;"
        "print(*sorted(m for m in set(sys.modules) - before if m.startswith(('aiorts', 'numpy', 'uvloop', 'msgpack'))))"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True, timeout=100
    )
    assert done.stdout.split() == ["aiorts.testing", "aiorts.testing.pytest_plugin"]


@simulated
async def test_simulated_test_runs_in_virtual_time() -> None:
    await asyncio.sleep(3600.0)
    clock = current_clock()
    assert clock is not None
    assert clock.time() == 3600.0


def test_simulated_takes_the_clock_it_is_given_and_returns_the_result() -> None:
    @simulated
    async def ends(clock: SimulatedClock, seconds: float) -> float:
        """Its documentation."""
        await asyncio.sleep(seconds)
        return clock.time()

    assert ends(SimulatedClock(start_ns=10**9), seconds=1.5) == 2.5
    assert ends.__doc__ == "Its documentation."


def test_simulated_refuses_an_ordinary_function() -> None:
    with pytest.raises(TypeError, match="expected an `async def` function"):
        simulated(lambda: None)  # type: ignore[arg-type,return-value]
