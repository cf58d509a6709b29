"""A function as a component is used as every other: from a system file, as an installed plugin, as a Unix filter."""

from __future__ import annotations

import asyncio
import functools
import json
import os
import pickle
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from aiorts import Component, InPort, Kernel, Param, ThreadContext, component
from aiorts.errors import DeclarationError
from aiorts.testing import check_component, simulated

FUNCTIONS = '''
from collections.abc import Iterator
from aiorts import Param, component

@component
def numbers(*, upto: int = Param(3, ge=1, doc="how many")) -> Iterator[float]:
    """Counts."""
    yield from (float(number) for number in range(upto))

@component
def double(x: float, *, factor: float = 2.0) -> float:
    """Times factor."""
    return x * factor

@component
def show(x: float) -> None:
    print(x, flush=True)

@component
def inverse(x: float) -> float:
    return 1 / x
'''
SYSTEM = """
schema = 1
[components.numbers]
type = "functions.py:numbers"
params.upto = 4
[components.double]
type = "functions.py:double"
[components.show]
type = "functions.py:show"
[[connections]]
from = "numbers.output"
to = "double.x"
full = "block"
[[connections]]
from = "double.output"
to = "show.x"
full = "block"
[contexts.work]
kind = "event"
members = ["show", "double", "numbers"]
"""


def aiorts(folder: Path, *arguments: str, stdin: str = "") -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH", ""))))
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, "PYTHONPATH": path},
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Functions, a system of them, and a package that offers them."""
    (tmp_path / "functions.py").write_text(FUNCTIONS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    installed = tmp_path / "functions-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: functions\nVersion: 1.0\n")
    names = "".join(f"{name} = functions:{name}\n" for name in ("numbers", "double", "show", "inverse"))
    (installed / "entry_points.txt").write_text(f"[aiorts.components]\n{names}")
    return tmp_path


@pytest.mark.slow(kept_by="test_an_installed_one_is_a_filter_whose_parameters_are_options")
@pytest.mark.parametrize("way", [[], ["--simulate"]])
def test_a_system_file_names_them_and_ends_with_its_source(folder: Path, way: list[str]) -> None:
    done = aiorts(folder, "run", str(folder / "system.toml"), "--set", "double.factor=10", *way)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == ["0.0", "10.0", "20.0", "30.0"]


@pytest.mark.slow(kept_by="first")
def test_an_installed_one_is_a_filter_whose_parameters_are_options(folder: Path) -> None:
    done = aiorts(folder, "double", "--factor", "3", stdin='1.0\n{"port": "x", "data": 2.0}\n')
    assert (done.returncode, done.stderr) == (0, "")
    assert [json.loads(line)["data"] for line in done.stdout.splitlines()] == [3.0, 6.0]


@pytest.mark.slow(kept_by="test_an_installed_one_is_a_filter_whose_parameters_are_options")
def test_a_source_is_a_filter_that_ends(folder: Path) -> None:
    done = aiorts(folder, "numbers", "--upto", "2")
    assert (done.returncode, done.stderr) == (0, "")
    assert [json.loads(line)["data"] for line in done.stdout.splitlines()] == [0.0, 1.0]


@pytest.mark.slow(kept_by="cli/test_filter.py::test_a_component_that_fails_ends_the_filter_with_status_3")
def test_an_exception_of_the_function_ends_the_filter_with_3(folder: Path) -> None:
    done = aiorts(folder, "inverse", stdin="2.0\n0.0\n")
    assert done.returncode == 3
    assert "ZeroDivisionError" in done.stderr
    assert "Traceback" not in done.stderr


@component
def scale(a: float, *, gain: float = Param(2.0, ge=0.0)) -> float:
    return a * gain


@component(when="all")
def minimum(a: float, b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)


@component
async def slowly(a: float) -> AsyncIterator[float]:
    for _ in range(2):
        await asyncio.sleep(0.01)
        yield a


@component
def count() -> Iterator[int]:
    yield from range(5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [scale, minimum, slowly, count])
def test_it_conforms(kind: type[Component]) -> None:
    feed = {name: [1.0, 2.0] for name, port in kind("draft0").ports.items() if isinstance(port, InPort)}
    check_component(lambda: kind("checked0"), feed, deterministic=True)


def test_it_conforms_in_a_thread() -> None:
    check_component(lambda: minimum("minimum0"), make_context=functools.partial(ThreadContext, 100.0))


@simulated
async def test_a_kernel_creates_it_by_class_with_parameters() -> None:
    async with Kernel() as kernel:
        made = await kernel.create(scale, "scale7", gain=3.0)
        assert (made.name, made.gain, (await kernel.create(scale)).name) == ("scale7", 3.0, "scale0")


def bounded(a: float, *, gain: float = Param(2.0, ge=0.0)) -> float:
    return a * gain


Bounded = component(bounded)


def test_one_with_bounds_can_be_pickled_and_still_be_called() -> None:
    again = pickle.loads(pickle.dumps(Bounded))
    assert again("bounded0").params["gain"].spec.constraint.ge == 0.0
    assert again.function(2.0) == 4.0


@pytest.mark.parametrize("name", ["function", "max_instance", "state"])
def test_names_that_a_component_has_itself_are_refused(name: str) -> None:
    scope: dict[str, object] = {}
    exec(f"def taken({name}: float) -> None: ...", scope)
    with pytest.raises(DeclarationError, match=f"a component has a {name}|Component has a {name}"):
        component(scope["taken"])  # type: ignore[call-overload]
