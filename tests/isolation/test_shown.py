"""A system with components in processes of their own, as the commands show, save and plan it."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from typing import Any

import pytest
from anyio import fail_after, sleep

from aiorts import EventContext, Kernel, LifecycleState
from aiorts.errors import WiringError
from aiorts.system import build, load, prepare, wanted
from aiorts.types import TimedLong
from control_parts import commanded
from isolation.isolated_parts import Door, Lamp, Scale, Sink, Source
from isolation.test_isolated import until
from run_parts import here

pytestmark = pytest.mark.anyio
SYSTEM = """\
schema = 1

[control]
name = "unit"

[components.source]
type = "isolated_parts.py:Source"

[components.one]
type = "isolated_parts.py:Scale"
params.factor = 3
isolation = "process"

[components.two]
type = "isolated_parts.py:Scale"
isolation = "process"

[components.sink]
type = "isolated_parts.py:Sink"

[[connections]]
from = "source.out"
to = "one.inp"

[[connections]]
from = "one.out"
to = "two.inp"

[[connections]]
from = "one.out"
to = "sink.inp"
length = 20
subscription = "flush"

[contexts.a]
kind = "event"
members = ["one"]

[contexts.b]
kind = "event"
members = ["two"]
"""


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_it_is_shown_saved_and_planned_as_any_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts = tmp_path / "isolated_parts.py"
    parts.write_text(Path(__file__).with_name("isolated_parts.py").read_text())
    path, saved = tmp_path / "system.toml", tmp_path / "saved.toml"
    path.write_text(SYSTEM)
    async with Kernel() as kernel:
        await build(kernel, load(path))
        one: Any = kernel.components["one"]
        status, text = await commanded(capsys, "cat", "one")
        assert (status, f"process  {one.pid}\n" in text, "one.out -> two.inp" in text) == (0, True, True), text
        status, text = await commanded(capsys, "plan", str(path), "--live", "unit")
        assert (status, text) == (0, ""), text
        status, text = await commanded(capsys, "save", "-o", str(saved))
        assert status == 0, text
        assert await commanded(capsys, "plan", str(saved), "--live", "unit") == (0, "")
        assert "on_link_lost" not in saved.read_text()
        checked = here("check", saved)
        assert checked.returncode == 0, checked.stdout
        source: Any = kernel.components["source"]
        source.out.write_nowait(TimedLong(0, -4))
        await until(lambda: one.busy)
        status, text = await commanded(capsys, "cat", "one")
        assert f"process  {one.pid}, busy for" in text


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["Scale", "Stubborn"])
async def test_a_hook_over_its_deadline_in_a_process_is_told_with_the_state(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where it holds the process nobody can ask which hook it is."""
    (tmp_path / "isolated_parts.py").write_text(Path(__file__).with_name("isolated_parts.py").read_text())
    path = tmp_path / "system.toml"
    text = SYSTEM.replace('[contexts.a]\nkind = "event"', '[contexts.a]\nkind = "event"\ndeadline = 0.3')
    path.write_text(text.replace(".py:Scale", f".py:{kind}", 1).replace("params.factor = 3\n", ""))
    async with Kernel() as kernel:
        await build(kernel, load(path))
        one: Any = kernel.components["one"]
        await until(lambda: one.state is LifecycleState.ACTIVE)
        source: Any = kernel.components["source"]
        source.out.write_nowait(TimedLong(0, -4))
        await until(lambda: kernel.profile().components["one"].overdue)
        late = kernel.profile().components["one"].overdue["a"]
        assert (late.hook, late.deadline_ns) == ("" if kind == "Scale" else "on_execute", 300_000_000)
        _, text = await commanded(capsys, "ls", "-l", "one")
        word = "a hook" if kind == "Scale" else "on_execute"
        assert re.search(rf"active, {word} for \d\.\d s \(deadline 0\.3 s\)", text), text
    # The kernel waits for no hook that swallows its end; what waits for the process's end goes on a little longer.
    assert [name for task in asyncio.all_tasks() if (name := task.get_name()).startswith("aiorts")] == []


async def test_a_plan_changes_a_value_in_the_process_too(tmp_path: Path) -> None:
    """It was changed in the kernel's stand-in alone: the process went on with the old value."""
    (tmp_path / "isolated_parts.py").write_text(Path(__file__).with_name("isolated_parts.py").read_text())
    path = tmp_path / "system.toml"
    path.write_text(SYSTEM)
    async with Kernel() as kernel:
        await build(kernel, load(path))
        one: Any = kernel.components["one"]
        await until(lambda: one.state is LifecycleState.ACTIVE)
        path.write_text(path.read_text().replace("params.factor = 3", "params.factor = 7"))
        await kernel.apply(wanted(prepare(load(path))))
        source: Any = kernel.components["source"]
        sink: Any = kernel.components["sink"]
        source.out.write_nowait(TimedLong(0, 2))
        assert (await sink.inp.read(timeout=20.0)).data == 14


@pytest.mark.slow(kept_by="test_a_plan_changes_a_value_in_the_process_too")
async def test_a_plan_adds_one_with_its_context_and_takes_both_away(tmp_path: Path) -> None:
    """The plan made a context of this process, in which the component could not run."""
    (tmp_path / "isolated_parts.py").write_text(Path(__file__).with_name("isolated_parts.py").read_text())
    whole, less = tmp_path / "whole.toml", tmp_path / "less.toml"
    whole.write_text(SYSTEM)
    less.write_text("schema = 1\n[control]\nname = 'unit'\n[components.source]\ntype = 'isolated_parts.py:Source'\n")
    async with Kernel() as kernel:
        await build(kernel, load(whole))
        for _ in range(2):
            await kernel.apply(wanted(prepare(load(less))))
            assert (set(kernel.components), set(kernel.contexts)) == ({"source"}, set())
            await kernel.apply(wanted(prepare(load(whole))))
            source: Any = kernel.components["source"]
            sink: Any = kernel.components["sink"]
            source.out.write_nowait(TimedLong(0, 2))
            assert (await sink.inp.read(timeout=20.0)).data == 6


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_what_a_file_asks_of_a_connector_between_processes_and_cannot_be_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "isolated_parts.py").write_text(Path(__file__).with_name("isolated_parts.py").read_text())
    path = tmp_path / "system.toml"
    path.write_text(SYSTEM.replace('to = "two.inp"', 'to = "two.inp"\ndataflow = "pull"'))
    done = here("check", path)
    assert done.returncode != 0
    assert "dataflow = pull: both ends are in other processes" in done.stdout + done.stderr


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_a_connection_fans_out_to_components_here_and_in_a_process() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        one, two = [await kernel.create_isolated(Scale, name) for name in ("one", "two")]
        made: Any = await kernel.connect(source.out, sink.inp, "one.inp", name="fan")
        assert [each.name for each in made] == ["fan", "fan-2"]
        await kernel.connect("one.out", "two.inp", sink.inp)
        assert [each.profile.ports[:2] for each in kernel.connectors.values()] == [
            ("source.out", "sink.inp"),
            ("source.out", "one.inp"),
            ("one.out", "two.inp"),
            ("one.out", "sink.inp"),
        ]
        with pytest.raises(WiringError, match="types differ"):
            await kernel.connect(source.large, "two.inp", sink.large)
        assert len(kernel.connectors) == 4
        assert [len(each.ports["inp"].connectors) for each in (one, two)] == [1, 1]


@pytest.mark.parametrize("where", ["process", "kernel"])
async def test_a_state_machine_and_modes_elsewhere_are_shown_and_changed_as_those_here(
    where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    services = {"control": {"name": "house"}, "links": {}}
    async with Kernel(services={"control": {"name": "far"}, "links": {}}) as far, Kernel(services=services) as kernel:
        if where == "process":
            ends = [await kernel.create_isolated(kind, kind.__name__.lower()) for kind in (Door, Lamp, Scale)]
        else:
            for kind in (Door, Lamp, Scale):
                await far.start(EventContext(), await far.create(kind, kind.__name__.lower()))
            ends = [await kernel.stand_in(f"far/{name}") for name in ("door", "lamp", "scale")]
        for one in ends:
            await kernel.start(EventContext(), one, activate=True)
        assert (await commanded(capsys, "fsm", "house/door"))[1].split()[:5] == [
            *("house/door", "states", "closed", "events", "button")
        ]
        assert await commanded(capsys, "fsm", "house/door", "button") == (0, "")
        with fail_after(5):
            while (await commanded(capsys, "fsm", "house/door"))[1].split()[2] != "open":
                await sleep(0.01)
        assert await commanded(capsys, "fsm", "house/door", "button", '{"by": 1}') == (0, "")
        status, text = await commanded(capsys, "fsm", "house/door", "buton")
        assert (status, "did you mean button?" in text) == (6, True)
        assert await commanded(capsys, "fsm", "house/lamp", "--mode", "bright") == (0, "")
        assert "bright of dark, bright" in (await commanded(capsys, "fsm", "house/lamp"))[1]
        assert (await commanded(capsys, "fsm", "house/lamp", "--mode", "off"))[0] == 6
        status, text = await commanded(capsys, "fsm", "house/scale")
        assert (status, "has no state machine and no modes; it is a Scale" in text) == (2, True)
