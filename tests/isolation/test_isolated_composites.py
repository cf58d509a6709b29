"""A composite in a process of its own: its members are there, and it is one component here."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from aiorts import EventContext, Kernel, LifecycleState
from aiorts.composites import Composite
from aiorts.errors import StateError
from aiorts.supervision import Supervision
from aiorts.system import build, check, load, prepare, wanted
from aiorts.types import TimedLong
from isolation.composite_parts import Neighbours, Pair, Stage
from isolation.isolated_parts import Sink, Source
from isolation.test_isolated import answer, runs, until

pytestmark = [pytest.mark.anyio, pytest.mark.row(30)]
ACTIVE, INACTIVE, ERROR = LifecycleState.ACTIVE, LifecycleState.INACTIVE, LifecycleState.ERROR


async def chain(kernel: Kernel) -> tuple[Source, Any, Sink, Any]:
    """source -> pair, in a process -> sink, active."""
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    pair = await kernel.create_isolated(Pair, "pair")
    await kernel.connect(source.out, "pair.inp", length=100)
    await kernel.connect("pair.out", sink.inp, length=100)
    context = await kernel.start(EventContext(name="apart"), pair, activate=True)
    return source, pair, sink, context


async def test_its_members_run_in_one_process_and_its_exported_ports_are_here() -> None:
    async with Kernel() as kernel:
        source, pair, sink, context = await chain(kernel)
        assert await answer(source, sink, 5) == 7
        assert (pair.pid != os.getpid(), runs(pair.pid)) == (True, True)
        assert (list(pair.ports), list(kernel.components)) == (["inp", "out"], ["source", "sink", "pair"])
        assert (pair.state, context.members) == (ACTIVE, (pair,))
        await context.deactivate()
        assert pair.state is INACTIVE
        await context.activate()
        assert await answer(source, sink, 6) == 8
        pid = pair.pid
        await kernel.remove(pair)
        assert (dict(kernel.connectors), runs(pid)) == ({}, False)


@pytest.mark.slow
async def test_an_error_of_a_member_is_its_error_and_a_reset_helps() -> None:
    async with Kernel() as kernel:
        source, pair, sink, context = await chain(kernel)
        pid = pair.pid
        source.out.write_nowait(TimedLong(0, -1))
        await until(lambda: pair.state is ERROR)
        assert str(pair.last_error) == "pair: ValueError: first: negative"
        await context.reset()
        await context.activate()
        assert (await answer(source, sink, 1), pair.pid) == (3, pid)


@pytest.mark.slow
async def test_its_own_policy_of_errors_is_kept_there() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        other = await kernel.add(Source("other"))
        both = await kernel.create_isolated(Neighbours, "both")
        await kernel.connect(source.out, "both.first_inp")
        await kernel.connect(other.out, "both.second_inp")
        await kernel.connect("both.second_out", sink.inp)
        await kernel.start(EventContext(name="apart"), both, activate=True)
        source.out.write_nowait(TimedLong(0, -1))
        assert await answer(other, sink, 1) == 2
        assert both.state is ACTIVE
        other.out.write_nowait(TimedLong(0, -1))
        await until(lambda: both.state is ERROR)


@pytest.mark.slow
async def test_the_end_of_its_process_is_its_failure_and_supervision_starts_another() -> None:
    async with Kernel() as kernel:
        source, pair, sink, _ = await chain(kernel)
        kernel.supervise(pair, Supervision(restart="reset"))
        pid = pair.pid
        source.out.write_nowait(TimedLong(0, -3))
        await until(lambda: pair.pid != pid and pair.state is ACTIVE)
        assert "its process has ended: exit status 3" in str(pair.last_error) or pair.last_error is None
        assert (await answer(source, sink, 1), runs(pid)) == (3, False)


@pytest.mark.slow
async def test_one_in_a_context_with_another_is_refused_naming_both() -> None:
    async with Kernel() as kernel:
        pair = await kernel.create_isolated(Pair, "pair")
        here = await kernel.add(Stage("here"))
        with pytest.raises(StateError, match=r"pair runs in a process of its own, and here in that of its kernel"):
            await kernel.start(EventContext(name="apart"), pair, here)


@pytest.mark.slow
async def test_it_cannot_be_moved_and_goes_on_where_it_is() -> None:
    async with Kernel() as kernel:
        source, pair, sink, _ = await chain(kernel)
        with pytest.raises(StateError, match=r"pair: is a composite"):
            await kernel.move(pair, EventContext(name="elsewhere"))
        assert await answer(source, sink, 5) == 7


@pytest.mark.slow
async def test_members_in_two_processes_do_not_share_a_context() -> None:
    async with Kernel() as kernel:
        first, second = await kernel.create_isolated(Stage, "a"), await kernel.create_isolated(Stage, "b")
        whole = await kernel.add(Composite("whole", first, second))
        with pytest.raises(StateError, match=r"a runs in a process of its own, and b in another"):
            await kernel.start(EventContext(name="apart"), whole, activate=True)
        assert (whole.state, dict(kernel.contexts)) == (None, {})


FILE = """
schema = 1

[components.source]
type = "isolated_parts.py:Source"

[components.pair]
type = "composite_parts.py:Pair"
isolation = "process"

[components.sink]
type = "isolated_parts.py:Sink"

[[connections]]
from = "source.out"
to = "pair.inp"

[[connections]]
from = "pair.out"
to = "sink.inp"

[contexts.apart]
kind = "event"
members = ["pair"]

[contexts.here]
kind = "event"
members = ["source", "sink"]
"""


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "inp", "out"), [("Pair", "inp", "out"), ("Neighbours", "first_inp", "first_out")])
async def test_a_system_file_says_it_in_one_line_and_is_saved_with_it(
    tmp_path: Path, kind: str, inp: str, out: str
) -> None:
    for part in ("isolated_parts.py", "composite_parts.py"):
        (tmp_path / part).write_text((Path(__file__).parent / part).read_text())
    file = tmp_path / "robot.toml"
    file.write_text(FILE.replace("Pair", kind).replace("pair.inp", f"pair.{inp}").replace("pair.out", f"pair.{out}"))
    assert [one for one in check(file) if one.severity != "note"] == []
    async with Kernel() as kernel:
        await build(kernel, load(file))
        pair: Any = kernel.components["pair"]
        source: Any = kernel.components["source"]
        sink: Any = kernel.components["sink"]
        assert (pair.state, pair.pid != os.getpid()) == (ACTIVE, True)
        source.out.write_nowait(TimedLong(0, 5))
        await until(lambda: sink.inp.profile.connectors)
        await kernel.save(tmp_path / "saved.toml")
        text = (tmp_path / "saved.toml").read_text()
        assert ('isolation = "process"' in text, "composites" in text) == (True, False)
        for saved in (file, tmp_path / "saved.toml"):
            assert (await kernel.apply(wanted(prepare(load(saved))), dry_run=True)).plan.steps == ()
