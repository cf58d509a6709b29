"""Ports that no class declares: of components in processes of their own they are here as well, and go with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from anyio import fail_after

from aiorts import EventContext, Kernel
from aiorts.system import build, load
from aiorts.types import TimedDoubleSeq, TimedLong
from isolation.isolated_parts import Growing, Scale, Sink, Source
from isolation.test_isolated import until
from run_parts import here

pytestmark = [pytest.mark.anyio, pytest.mark.slow]
SYSTEM = """\
schema = 1
[components.const]
type = "FlexiConst"
options = ["-p", "TimedLong", "-c", "5", "-r", "100"]
isolation = "process"
[components.twice]
type = "FlexiFilter"
options = ["-i", "TimedLong", "-o", "TimedDouble", "-m", "0>2>0"]
isolation = "process"
[components.dump]
type = "FlexiDump"
options = ["-p", "TimedDouble"]
isolation = "process"
[[connections]]
from = "const.output"
to = "twice.input0"
[[connections]]
from = "twice.output0"
to = "dump.input0"
[contexts.a]
kind = "periodic"
rate = 10.0
members = ["const"]
[contexts.b]
kind = "event"
members = ["twice"]
[contexts.c]
kind = "event"
members = ["dump"]
"""


async def test_ports_that_it_makes_itself_are_here_and_go_when_it_removes_them() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        growing: Any = await kernel.create_isolated(Growing, "growing")
        first = growing.ports["first"]
        assert (first.type, first.unit, first.shape, first.doc) == (TimedDoubleSeq, "m", (3,), "the first")
        await kernel.connect(source.out, growing.inp)
        await kernel.connect(first, sink.large)
        await kernel.start(EventContext(), growing, activate=True)
        source.out.write_nowait(TimedLong(0, 1))
        assert (await sink.large.read(timeout=5)).data.tolist() == [0.0, 0.0, 0.0]
        await until(lambda: "more" in growing.ports)
        await kernel.connect(growing.ports["more"], sink.inp)
        source.out.write_nowait(TimedLong(0, 0))
        await until(lambda: "more" not in growing.ports)
        assert [one.out.path for one in kernel.connectors.values()] == ["source.out", "growing.first"]


async def test_components_that_are_made_by_options_run_in_processes_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "system.toml"
    path.write_text(SYSTEM)
    checked = here("check", path)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    async with Kernel() as kernel:
        await build(kernel, load(path))
        printed = ""

        def is_dumped() -> bool:
            nonlocal printed
            printed += capsys.readouterr().out
            return "input0 TimedDouble" in printed

        await until(is_dumped)
        twice: Any = kernel.components["twice"]
        assert {name: port.type.__name__ for name, port in twice.ports.items()} == {
            "input0": "TimedLong",
            "output0": "TimedDouble",
        }


async def test_ports_follow_the_parameters() -> None:
    async with Kernel() as kernel:
        const: Any = await kernel.create_isolated("FlexiConst", "const", outputs=("TimedLong",), constants=("1",))
        assert list(const.ports) == ["output"]
        await const.configure(outputs=("TimedLong", "TimedDouble"), constants=("1", "2.5"))
        assert {name: port.type.__name__ for name, port in const.ports.items()} == {
            "output0": "TimedLong",
            "output1": "TimedDouble",
        }


@pytest.mark.slow(kept_by="observe/test_samples.py::test_it_gives_each_sample_from_now_on")
async def test_samples_of_a_component_in_a_process_of_its_own_are_given_here() -> None:
    with fail_after(20.0):
        async with Kernel() as kernel:
            source: Any = await kernel.add(Source("source"))
            scale: Any = await kernel.create_isolated(Scale, "scale")
            await kernel.connect(source.out, scale.inp)
            await kernel.start(EventContext(), scale, activate=True)
            source.out.write_nowait(TimedLong(0, 1))
            stream = kernel.samples("scale.out", keep_last=True)
            assert (await anext(stream)).data == 2
            source.out.write_nowait(TimedLong(0, 3))
            assert (await anext(stream)).data == 6
            assert [one.out.path for one in kernel.connectors.values()] == ["source.out"]
        assert [sample async for sample in stream] == []
