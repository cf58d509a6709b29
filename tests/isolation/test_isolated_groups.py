"""Groups of a composite side by side: each has a schedule of its own, and its member a process of its own."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from aiorts import EventContext, Kernel, LifecycleState
from aiorts.composites import Composite
from aiorts.errors import StateError
from aiorts.kernel.loop.bus import StateChanged
from aiorts.supervision import Supervision
from aiorts.system import build, check, load, prepare, wanted
from aiorts.types import TimedLong
from isolation.composite_parts import Pair, Stage
from isolation.digging import Digger
from isolation.isolated_parts import Sink, Source
from isolation.test_isolated import answer, until

pytestmark = [pytest.mark.anyio, pytest.mark.row(30)]
ACTIVE, INACTIVE, ERROR = LifecycleState.ACTIVE, LifecycleState.INACTIVE, LifecycleState.ERROR
GROUPS = ("left", "right")
TURNS = 1_500_000
"""Turns of a loop that one portion of work has."""
BARE = """
import sys
sys.path.insert(0, sys.argv[1])
from digging import dig
for line in sys.stdin:
    print(dig(int(line)), flush=True)
"""


async def whole(kernel: Kernel, left: Any, right: Any, errors: str = "stop") -> Any:
    """A composite of two groups, started and active, each in a process of its own and between a source and a sink."""
    groups = [
        Composite(name, member, exported=["*.*"], own_schedule=True)
        for name, member in zip(GROUPS, (left, right), strict=True)
    ]
    exported = {"*.inp": "{component}_inp", "*.out": "{component}_out"}
    made = await kernel.add(Composite("whole", *groups, exported=exported, errors=errors))
    for name in GROUPS:
        source, sink = await kernel.add(Source(f"{name}_source")), await kernel.add(Sink(f"{name}_sink"))
        await kernel.connect(source.out, f"whole.{name}_inp", length=100)
        await kernel.connect(f"whole.{name}_out", sink.inp, length=100)
    for group in groups:
        await kernel.start(EventContext(name=f"of_{group.name}"), group, activate=True)
    return made


async def asked(kernel: Kernel, group: str, value: int) -> int:
    """What a group answers."""
    source: Any = kernel.components[f"{group}_source"]
    sink: Any = kernel.components[f"{group}_sink"]
    return int(await answer(source, sink, value))


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_its_ports_lead_to_members_in_two_processes() -> None:
    async with Kernel() as kernel:
        left: Any = await kernel.create_isolated(Stage, "stage")
        right: Any = await kernel.create_isolated(Pair, "pair")
        both = await whole(kernel, left, right)
        assert list(both.ports) == ["left_inp", "left_out", "right_inp", "right_out"]
        assert (left.pid != right.pid, left.state, right.state) == (True, ACTIVE, ACTIVE)
        assert (await asked(kernel, "left", 1), await asked(kernel, "right", 1)) == (2, 3)


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_their_work_takes_as_long_as_in_two_bare_processes() -> None:
    async with Kernel() as kernel:
        left, right = await kernel.create_isolated(Digger, "one"), await kernel.create_isolated(Digger, "two")
        await whole(kernel, left, right)
        sources: list[Any] = [kernel.components[f"{name}_source"] for name in GROUPS]
        sinks: list[Any] = [kernel.components[f"{name}_sink"] for name in GROUPS]

        async def isolated() -> float:
            began = time.perf_counter()
            for source in sources:
                source.out.write_nowait(TimedLong(0, TURNS))
            for sink in sinks:
                await sink.inp.read(timeout=30)
            return time.perf_counter() - began

        command = [sys.executable, "-c", BARE, str(Path(__file__).parent)]
        bare = [
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
            for _ in GROUPS
        ]

        def in_bare_processes() -> float:
            began = time.perf_counter()
            for one in bare:
                one.stdin.write(f"{TURNS}\n")  # type: ignore[union-attr]
            for one in bare:
                one.stdout.readline()  # type: ignore[union-attr]
            return time.perf_counter() - began

        try:
            await isolated()  # what is cold at first is no part of it
            in_bare_processes()
            ours, theirs = [], []
            for _ in range(30):
                ours.append(await isolated())
                theirs.append(in_bare_processes())
                beside = median(ours) / median(theirs)
                if len(ours) >= 10 and beside <= 1.15:
                    break
            print(f"{median(ours):.3f} s beside {median(theirs):.3f} s: {beside:.3f}, {len(ours)} rounds")
            assert beside <= 1.15
        finally:
            for one in bare:
                one.communicate(timeout=30)


@pytest.mark.slow(kept_by="composites/test_nesting.py::test_one_whose_members_all_run_apart_is_what_they_are_together")
async def test_it_is_activated_and_deactivated_as_a_whole() -> None:
    async with Kernel() as kernel:
        left, right = await kernel.create_isolated(Stage, "one"), await kernel.create_isolated(Stage, "two")
        both = await whole(kernel, left, right)
        assert (both.state, dict(both.states)) == (ACTIVE, {"of_left": ACTIVE, "of_right": ACTIVE})
        assert kernel.profile().components["whole"].states == {"of_left": "active", "of_right": "active"}
        await both.deactivate()
        assert (both.state, left.state, right.state) == (INACTIVE, INACTIVE, INACTIVE)
        await both.activate()
        assert (both.state, await asked(kernel, "left", 1), await asked(kernel, "right", 1)) == (ACTIVE, 2, 2)
        with pytest.raises(StateError, match=r"whole: each member has a schedule of its own; start left, right, each"):
            await kernel.start(EventContext(name="of_both"), both)


def changes_of(kernel: Kernel, name: str) -> list[LifecycleState]:
    """The states that this one is said to have from now on; the list grows."""
    states: list[LifecycleState] = []
    kernel.bus.subscribe(StateChanged, lambda event: states.append(event.new) if event.component == name else None)
    return states


@pytest.mark.slow(kept_by="composites/test_nesting.py::test_one_whose_members_all_run_apart_is_what_they_are_together")
@pytest.mark.parametrize(
    ("errors", "state", "other"), [("stop", ERROR, INACTIVE), ("report", ERROR, ACTIVE), ("isolate", ACTIVE, ACTIVE)]
)
async def test_the_policy_of_errors_holds_for_a_process_that_is_lost(errors: str, state: Any, other: Any) -> None:
    async with Kernel() as kernel:
        left, right = await kernel.create_isolated(Stage, "one"), await kernel.create_isolated(Stage, "two")
        both = await whole(kernel, left, right, errors)
        changes = changes_of(kernel, "whole")
        source: Any = kernel.components["left_source"]
        source.out.write_nowait(TimedLong(0, -3))
        await until(lambda: left.state is ERROR and both.state is state and right.state is other)
        assert set(changes) == ({ERROR} if state is ERROR else set())
        assert "one: its process has ended: exit status 3" in str(both.last_error)
        if other is ACTIVE:
            assert await asked(kernel, "right", 1) == 2
        await both.reset()
        await both.activate()
        assert (both.state, await asked(kernel, "left", 1), await asked(kernel, "right", 1)) == (ACTIVE, 2, 2)


@pytest.mark.slow(kept_by="composites/test_nesting.py::test_one_whose_members_all_run_apart_is_what_they_are_together")
@pytest.mark.parametrize("restart", ["reset", "restart"])
async def test_a_group_that_is_supervised_comes_back_and_the_other_with_it(restart: Any) -> None:
    async with Kernel() as kernel:
        left, right = await kernel.create_isolated(Stage, "one"), await kernel.create_isolated(Stage, "two")
        both = await whole(kernel, left, right)
        kernel.supervise(left, Supervision(restart=restart))
        stopped = changes_of(kernel, "two")
        source: Any = kernel.components["left_source"]
        source.out.write_nowait(TimedLong(0, -3))
        await until(lambda: stopped[-1:] == [ACTIVE] and both.state is ACTIVE)
        assert stopped == [INACTIVE, ACTIVE]
        assert (await asked(kernel, "left", 1), await asked(kernel, "right", 1)) == (2, 2)


@pytest.mark.slow(kept_by="composites/test_nesting.py::test_one_whose_members_all_run_apart_is_what_they_are_together")
async def test_one_activation_that_fails_takes_the_others_back() -> None:
    async with Kernel() as kernel:
        left, right = await kernel.create_isolated(Stage, "one"), await kernel.create_isolated(Stage, "two")
        both = await whole(kernel, left, right)
        await both.deactivate()
        await kernel.contexts["of_right"].stop()
        with pytest.raises(StateError, match=r"right: is in no context"):
            await both.activate()
        assert (left.state, both.state) == (INACTIVE, INACTIVE)


FILE = """
schema = 1

[components.source]
type = "isolated_parts.py:Source"

[components.one]
type = "composite_parts.py:Stage"
isolation = "process"

[components.two]
type = "composite_parts.py:Pair"
isolation = "process"

[components.sink]
type = "isolated_parts.py:Sink"

[composites.left]
members = ["one"]
own_schedule = true
exported = ["*.*"]

[composites.right]
members = ["two"]
own_schedule = true
exported = ["*.*"]

[composites.whole]
members = ["left", "right"]
exported = {"*.inp" = "{component}_inp", "*.out" = "{component}_out"}

[[connections]]
from = "source.out"
to = "whole.left_inp"

[[connections]]
from = "whole.left_out"
to = "whole.right_inp"

[[connections]]
from = "whole.right_out"
to = "sink.inp"

[contexts.of_left]
kind = "event"
members = ["left"]

[contexts.of_right]
kind = "event"
members = ["right"]

[contexts.here]
kind = "event"
members = ["source", "sink"]
"""


def file_of(folder: Path, text: str) -> Path:
    """A system file with this text, in this folder, with the parts that it names."""
    for part in ("isolated_parts.py", "composite_parts.py"):
        (folder / part).write_text((Path(__file__).parent / part).read_text())
    (folder / "robot.toml").write_text(text)
    return folder / "robot.toml"


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_a_system_file_has_them_and_is_saved_and_planned_with_them(tmp_path: Path) -> None:
    file = file_of(tmp_path, FILE)
    assert [str(one) for one in check(file) if one.severity != "note" or one.code == "N-PORTS"] == []
    async with Kernel() as kernel:
        await build(kernel, load(file))
        there: Any = kernel.components
        assert (there["whole"].state, there["one"].pid != there["two"].pid) == (ACTIVE, True)
        assert await answer(there["source"], there["sink"], 5) == 8
        await kernel.save(tmp_path / "saved.toml")
        for name in ("robot.toml", "saved.toml"):
            applied = await kernel.apply(wanted(prepare(load(tmp_path / name))), dry_run=True)
            assert applied.plan.steps == ()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'members = ["left"]\n\n[contexts.of_right]\nkind = "event"\nmembers = ["right"]',
            'members = ["left", "right"]',
            "45:11: contexts.of_left.members: one has a process of its own, and two has one, too: a context runs where "
            "its members are; give each one of its own, and in left as a composite with own_schedule = true",
        ),
        (
            'members = ["left"]',
            'members = ["whole"]',
            "45:12: contexts.of_left.members[1]: each member of whole has own_schedule; name left, right, each in its",
        ),
        (
            'members = ["left", "right"]',
            'members = ["left", "right"]\nisolation = "process"\nlimits = {cpu = 0.5}',
            "29:1: composites.whole.isolation: members that a file lists have no process together; write a class "
            'derived from Composite, and make it a component: [components.whole], type = "FILE.py:Class"',
        ),
    ],
    ids=["two in one context", "the whole in one context", "isolation of a composite"],
)
def test_what_a_file_cannot_say_is_an_error_with_its_place(tmp_path: Path, old: str, new: str, said: str) -> None:
    found = check(file_of(tmp_path, FILE.strip().replace(old, new)))
    errors = [one for one in found if one.severity == "error"]
    assert [f"{one.line}:{one.column}: {one.where}: {one.cause}; {one.remedy}"[: len(said)] for one in errors] == [said]
