"""A system file and the kernel that was built from it are one and the same `Wanted`: the plan between them is empty."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.model.wanted.plan import plan
from aiorts.planning import wanted_of
from aiorts.system import build, load, parse, prepare, wanted
from aiorts.testing import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"
APART = (EXAMPLES / "manipulator/plant.toml", EXAMPLES / "roomba/isolated.toml")
"""With processes of components, which there are none of in virtual time."""
OTHERS = EXAMPLES / "lrf/station.toml"
"""With services of other kernels, of which there are none in virtual time."""
FILES = sorted(
    {path for path in EXAMPLES.rglob("*.toml") if path.name not in ("pyproject.toml", "replay.toml")} - {*APART, OTHERS}
)


@pytest.mark.row(110)
@pytest.mark.parametrize("file", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_a_file_and_what_was_built_from_it_are_one_system(file: Path) -> None:
    async def both() -> None:
        prepared = prepare(load(file))
        async with Kernel() as kernel:
            await build(kernel, prepared)
            await kernel.sleep(0.1)
            assert wanted_of(kernel) == (of_file := wanted(prepared))
            assert plan(wanted_of(kernel), of_file).empty

    simulate(both())


@pytest.mark.slow(kept_by="test_a_file_and_what_was_built_from_it_are_one_system")
@pytest.mark.anyio
@pytest.mark.parametrize("file", APART, ids=lambda path: path.stem)
async def test_a_file_with_processes_and_what_was_built_from_it_are_one_system(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    prepared = prepare(load(file))
    async with Kernel() as kernel:
        await build(kernel, prepared)
        assert plan(wanted_of(kernel), of_file := wanted(prepared)).empty
        assert wanted_of(kernel) == of_file


@pytest.mark.anyio
async def test_however_a_file_says_it(tmp_path: Path) -> None:
    const = '[components.const]\ntype = "FlexiConst"\nparams = {{ outputs = ["TimedDouble"], constants = ["1"], {} }}\n'
    rest = """
[components.one]
type = "FlexiDump"
options = ["-p", "TimedDouble"]
[components.two]
type = "FlexiDump"
params.inputs = ["TimedDouble", "TimedDouble"]
[composites.all]
members = ["one", "two"]
order = "stated"
own_schedule = false
exported = { "one.input0" = "first", "two.*" = "{component}_{port}" }
"""
    joined = """
[[connections]]
from = "const.output"
to = ["all.first", "all.two_input0", "two.input1"]
subscription = "flush"
name = "wires"
length = 8
full = "overwrite"
[contexts.work]
kind = "event"
every = 0.5
members = ["all", "const"]
"""
    apart = """
[[connections]]
from = "const.output"
to = "one.input0"
name = "wires"
[[connections]]
from = "const.output"
to = "two.input0"
name = "wires-2"
[[connections]]
from = "const.output"
to = "two.input1"
name = "wires-3"
[contexts.work]
kind = "event"
every = 0.5
timing = false
activate = true
members = ["all", "const"]
"""
    first = parse("schema = 1\n" + const.format("rate = 1") + rest + joined, tmp_path / "a.toml")
    second = parse("schema = 1\n" + const.format('rate = "1.0"') + rest + apart, tmp_path / "a.toml")
    of_first, of_second = wanted(first), wanted(second)
    assert of_first == of_second
    async with Kernel() as kernel:
        await build(kernel, first)
        assert plan(wanted_of(kernel), of_second).empty
        await kernel.disconnect(kernel.connectors["wires-3"])
        found = plan(wanted_of(kernel), of_second)
        assert [step.text for step in found.steps] == ["connect const.output -> two.input1 (name wires-3)"]
