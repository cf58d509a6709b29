"""`Kernel.save`: all that a system file can say of a system is in the file; what it cannot say is named."""

from __future__ import annotations

import asyncio
import enum
import os
from pathlib import Path

import pytest

from aiorts import (
    Component,
    Composite,
    EventContext,
    InPort,
    Kernel,
    OutPort,
    Param,
    PeriodicContext,
    RealtimeContext,
    Supervision,
)
from aiorts.errors import ConfigurationError, SystemFileError
from aiorts.system import build, check, load
from aiorts.testing import simulate
from aiorts.types import TimedDouble

PARTS = """
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Protocol
from aiorts import Component, InPort, OutPort, Param, Provided, Required, component
from aiorts.types import TimedDouble

class Colour(Enum):
    RED = 1
    BLUE = 2

class Brake(Protocol):
    async def hold(self) -> None: ...

class Kinds(Component):
    out = OutPort(TimedDouble)
    inp = InPort(TimedDouble)
    brake = Required[Brake]()
    flag: bool = Param(False)
    size: int = Param(3)
    gain: float = Param(1.0)
    text: str = Param("")
    file: Path = Param(Path("none.txt"))
    colour: Colour = Param(Colour.RED)
    names: tuple[str, ...] = Param((), type=tuple[str, ...])
    pair: tuple[int, float] = Param((1, 2.0), type=tuple[int, float])
    table: Mapping[str, float] = Param({"a": 1.0}, type=Mapping[str, float])
    maybe: float | None = Param(1.0, type=float | None)
    configurations = {"slow": {"gain": 0.5}, "fast": {"gain": 5.0}}

class Stop(Component):
    inp = InPort(TimedDouble, length=20)
    out = OutPort(TimedDouble)
    brake = Provided[Brake]()
    async def hold(self) -> None: ...

@component
def twice(value: float) -> float:
    return 2 * value

def half(sample):
    return TimedDouble(sample.tm, sample.data / 2)
"""
SYSTEM = r"""schema = 1

[plugins]
path = [".", "more"]

[clock]
kind = "scaled"
speed = 2.0

[watch_loop]
limit = 3.0

[components.kinds]
type = "parts.py:Kinds"
params.flag = true
params.size = -1
params.gain = inf
params.text = "quote \" back \\ line\nend é"
params.file = "data/in.txt"
params.colour = "BLUE"
params.names = ["a", "b"]
params.pair = [7, 0.1]
params.table = { x = 1.5, "not bare" = 2.0 }
params.maybe = "none"
active = "fast"
sets.slow = { gain = 0.25 }
sets.own = { text = "x", maybe = "none" }
supervision = { restart = "reset", budget = 2, deadlines = { on_execute = 0.5 } }
start = { after = ["stop active"], wait = 0.01 }

[components.stop]
type = "parts.py:Stop"
supervision = { deadline = 2.0 }

[components.twice0]
type = "parts.py:twice"

[components.deep]
type = "sub/pack.py:Deep"

[components.offered]
type = "Offered"

[components.member]
type = "json_like/parts.py:Other"

[composites.inner]
members = ["twice0"]
exported = { "twice0.output" = "result", "*.v*" = "{component}_{port}" }

[composites.outer]
members = ["stop", "inner"]
order = "dataflow"
errors = "isolate"
groups = [["stop"], ["inner"]]
exported = ["stop.inp"]

[[connections]]
from = "kinds.out"
to = "stop.inp"
length = 8

[[connections]]
from = "kinds.out"
to = "twice0.value"
name = "a_name"
subscription = "periodic"
push_rate = 20.0
push = "all"
out_length = 4
lifespan = 0.5

[[connections]]
from = "twice0.output"
to = "kinds.inp"
full = "block"
timeout = inf
stamp = "send"
keep_last = true
convert = "parts.py:half"
"dataport.corba_cdr.x" = "y"

[[connections]]
from = "stop.out"
to = "kinds.inp"
subscription = "new"

[[connections]]
from = "stop.out"
to = "kinds.inp"
subscription = "new"
push = "skip"
skip = 2
allow_duplicate = true

[[connections]]
from = "kinds.brake"
to = "stop.brake"

[contexts.loop]
kind = "periodic"
rate = 50.0
overrun = "catch_up"
deadline = 0.5
timing = false
members = ["kinds", "outer"]

[contexts.quiet]
kind = "event"
every = 0.5
members = ["deep", "offered"]
activate = false

[contexts.threads]
kind = "thread"
members = ["member"]
"""
MORE = """[project]
name = "more"
version = "1"
[project.entry-points."aiorts.components"]
Offered = "offering:Offered"
"""
ONE = "from aiorts import Component\nclass {}(Component):\n    pass\n"


class Plain(Component):
    """A component of this very file."""

    out = OutPort(TimedDouble)
    in_ = InPort(TimedDouble, name="in")
    gain: float = Param(1.0)


class Shade(enum.Enum):
    LIGHT = 1


def laid_out(folder: Path) -> Path:
    """A folder with a system in it that has a bit of everything."""
    files = {
        "parts.py": PARTS,
        "sub/pack.py": ONE.format("Deep"),
        "more/pyproject.toml": MORE,
        "more/offering.py": ONE.format("Offered"),
        "json_like/__init__.py": "",
        "json_like/parts.py": ONE.format("Other"),
        "system.toml": SYSTEM,
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder / "system.toml"


async def saved(file: Path, into: Path) -> str:
    async with Kernel() as kernel:
        await build(kernel, load(file))
        await kernel.save(into)
    return await asyncio.to_thread(into.read_text)


@pytest.mark.slow(kept_by="test_what_a_program_made_is_saved_without_what_is_so_by_default")
def test_a_file_with_a_bit_of_everything_is_saved_as_it_stands(tmp_path: Path) -> None:
    file = laid_out(tmp_path)
    text = simulate(saved(file, tmp_path / "again.toml"))
    assert text == SYSTEM
    assert [one for one in check(tmp_path / "again.toml") if one.severity == "error"] == []
    assert simulate(saved(tmp_path / "again.toml", tmp_path / "once more.toml")) == text


def text_of(path: Path) -> str:
    return path.read_text()


async def text_saved(kernel: Kernel, folder: Path, notes: tuple[str, ...] = ()) -> str:
    """What a kernel saves, in a folder above this file and the test's own."""
    path = folder / "saved.toml"
    assert await kernel.save(path, overwrite=True) == notes
    return await asyncio.to_thread(text_of, path)


@pytest.mark.anyio
async def test_what_a_program_made_is_saved_without_what_is_so_by_default(tmp_path: Path) -> None:
    async with Kernel(services={"watch_loop": {"limit": 60.0}}) as kernel:
        one, two = (
            await kernel.create(Plain, "one", gain=3.0),
            await kernel.create("FlexiDump", "two", inputs=["TimedDouble"]),
        )
        await kernel.connect("one.out", "two.input0")
        await kernel.start(PeriodicContext(10.0, max_rate=20.0, name="beat"), one, activate=True)
        await kernel.start(EventContext(name="screen"), two)
        kernel.supervise(one, Supervision(restart="restart"))
        text = await text_saved(kernel, tmp_path)
    assert (
        text
        == """schema = 1

[watch_loop]
limit = 60.0

[components.one]
type = "tests.planning.test_save:Plain"
params.gain = 3.0
supervision = { restart = "restart" }

[components.two]
type = "FlexiDump"
params.inputs = ["TimedDouble"]

[[connections]]
from = "one.out"
to = "two.input0"

[contexts.beat]
kind = "periodic"
rate = 10.0
max_rate = 20.0
members = ["one"]

[contexts.screen]
kind = "event"
members = ["two"]
activate = false
"""
    )


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_real_time_context_is_saved_with_what_it_asks_for(tmp_path: Path) -> None:
    async with Kernel() as kernel:
        context = RealtimeContext(100.0, priority=7, cpus=[0], lock_memory=False, spin=0.0001, name="fast")
        await kernel.start(context, await kernel.create(Plain, "one"), activate=True)
        text = await text_saved(kernel, tmp_path)
    said = "rate = 100.0\npriority = 7\ncpus = [0]\nlock_memory = false\nspin = 0.0001\nmembers"
    assert f'kind = "realtime"\n{said}' in text


def made_here() -> type[Component]:
    class Local(Component):
        pass

    return Local


class Needy(Component):
    """A component that cannot be made of its name alone."""

    def __init__(self, name: str, speed: float) -> None:
        super().__init__(name)


class Own(Composite):
    """A composite of a class of its own."""


class Strange(PeriodicContext):
    """A context that no plugin offers."""

    kind = "strange"


@pytest.mark.anyio
async def test_all_that_no_file_can_say_is_named_at_once(tmp_path: Path) -> None:
    async with Kernel() as kernel:
        local, needy = await kernel.add(made_here()("local")), await kernel.add(Needy("needy", 1.0))
        one, two = await kernel.create(Plain, "one"), await kernel.create(Plain, "two")
        await kernel.connect(one.out, two.in_, convert=lambda sample: sample)
        await kernel.add(Own("own", two))
        await kernel.start(Strange(name="odd"), one)
        await kernel.start(EventContext(name="usual"), local, needy)
        with pytest.raises(SystemFileError) as caught:
            await kernel.save(tmp_path / "saved.toml")
    said = str(caught.value).splitlines()
    assert [line.partition(":")[0] for line in said] == ["local", "needy", "one.out-two.in", "odd", "own"]
    assert "made_here.<locals>.Local is in no file" in said[0]
    assert "Needy takes speed" in said[1]
    assert "<lambda> is in no file" in said[2]
    assert "kind of context 'strange'" in said[3]
    assert os.listdir(tmp_path) == []


@pytest.mark.anyio
async def test_a_file_that_is_not_below_the_folder_is_named_and_where_to_save(tmp_path: Path) -> None:
    file = laid_out(tmp_path / "here")
    (tmp_path / "there").mkdir()
    async with Kernel() as kernel:
        await kernel.create(f"{file.parent}/parts.py:Stop", "stop")
        with pytest.raises(
            SystemFileError, match=rf"^stop: Stop is in {file.parent}, .*save into {file.parent} or a folder"
        ):
            await kernel.save(tmp_path / "there" / "saved.toml")
        assert 'type = "here/parts.py:Stop"' in await text_saved(kernel, tmp_path)


@pytest.mark.anyio
async def test_what_is_left_out_is_told(tmp_path: Path) -> None:
    async with Kernel() as kernel:
        one, two = await kernel.create(Plain, "one"), await kernel.create(Plain, "two")
        await one.add_param("extra", Param(1.0))
        context = await kernel.start(EventContext(name="work"), one, two, activate=True)
        assert "extra" not in await text_saved(kernel, tmp_path)
        await one.configure(extra=2.0)
        await context.deactivate(two)
        notes = (
            "one.extra = 2.0: the parameter was added at run time",
            "work: two: not active, and active in the saved system with the others",
        )
        assert "extra" not in await text_saved(kernel, tmp_path, notes)


@pytest.mark.anyio
async def test_a_file_that_is_there_stays_unless_it_is_to_be_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "saved.toml"
    path.write_text("mine")
    async with Kernel() as kernel:
        await kernel.create(Plain, "one")
        with pytest.raises(ConfigurationError, match=r"saved.toml: is there already"):
            await kernel.save(path)
        assert path.read_text() == "mine"
        with pytest.raises(ConfigurationError, match="cannot be written"):
            await kernel.save(tmp_path / "no" / "saved.toml")
        await kernel.save(path, overwrite=True)
        await kernel.save(tmp_path / "other.toml")
    assert "test_save:Plain" in path.read_text()
    assert sorted(os.listdir(tmp_path)) == ["other.toml", "saved.toml"]


@pytest.mark.anyio
@pytest.mark.parametrize("turns", [0, 1, 2, 3, 5, 8])
async def test_cancelled_at_any_moment_the_file_is_the_old_one_or_the_new_one(tmp_path: Path, turns: int) -> None:
    file = tmp_path / "system.toml"
    file.write_text("old")
    async with Kernel() as kernel:
        await kernel.create("FlexiDupe", "twice", inputs=("TimedDouble:2",))
        saving = asyncio.ensure_future(kernel.save(file, overwrite=True))
        for _ in range(turns):
            await asyncio.sleep(0)
        saving.cancel()
        await asyncio.wait([saving])
        assert file.read_text() == "old" or "FlexiDupe" in file.read_text()
        for _ in range(500):  # the thread that writes comes to its end all the same
            if os.listdir(tmp_path) == ["system.toml"]:
                break
            await asyncio.sleep(0.01)
        assert os.listdir(tmp_path) == ["system.toml"]
        await kernel.save(file, overwrite=True)
    assert "FlexiDupe" in file.read_text()


@pytest.mark.anyio
async def test_what_a_command_line_chose_for_one_run_is_not_of_the_system(tmp_path: Path) -> None:
    from aiorts.system import prepare

    file = tmp_path / "system.toml"
    file.write_text('schema = 1\n[components.a]\ntype = "FlexiDump"\nparams.inputs = ["TimedDouble"]\n')
    async with Kernel() as kernel:
        await build(kernel, prepare(load(file), services={"watch_loop": {"limit": 9.0}}))
        assert "watch_loop" not in await text_saved(kernel, tmp_path)


@pytest.mark.anyio
async def test_code_that_was_replaced_is_saved_by_its_file(tmp_path: Path) -> None:
    laid_out(tmp_path)
    async with Kernel() as kernel:
        await kernel.create(f"{tmp_path}/parts.py:Stop", "stop")
        before = await text_saved(kernel, tmp_path)
        await asyncio.to_thread((tmp_path / "parts.py").write_text, PARTS + "\n# newer\n")
        await kernel.reload("Stop", cycles=0)
        assert await text_saved(kernel, tmp_path) == before
    assert 'type = "parts.py:Stop"' in before
