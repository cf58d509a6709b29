"""A plan adds rules of `[[rules]]` to a system that runs, or takes them back with the rest."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.errors import AiortsError
from aiorts.model.wanted.plan import plan
from aiorts.planning import wanted_of
from aiorts.rules import ConnectingRules
from aiorts.system import build, load, prepare, wanted
from aiorts.testing import simulated
from run_parts import folder_of

PARTS = """\
schema = 1
[components.counter]
type = "parts.py:Counter"
params.count = 1000
[components.sink]
type = "parts.py:Sink"
[components.other]
type = "parts.py:Sink"
[contexts.fast]
kind = "periodic"
rate = 100.0
members = ["counter"]
[contexts.slow]
kind = "event"
members = ["sink", "other"]
"""
ONE = '[[rules]]\nfrom = "counter.*"\nto = "sink.*"\n'
MORE = '[[rules]]\nfrom = "counter.*"\nto = "other.*"\nlength = 99\n'


@simulated
@pytest.mark.parametrize("before", ["", ONE])
async def test_further_rules_connect_what_is_there_and_others_keep_their_connectors(
    tmp_path: Path, before: str
) -> None:
    file = folder_of(tmp_path) / "rules.toml"
    file.write_text(PARTS + before)
    async with Kernel() as kernel:
        await build(kernel, load(file))
        await kernel.sleep(0.1)
        there = dict(kernel.connectors)
        file.write_text(PARTS + ONE + MORE)
        goal = wanted(prepare(load(file)))
        applied = await kernel.apply(goal)
        assert applied.done
        assert [step.text for step in applied.plan.steps] == [
            f"add rules: {'' if before else 'counter.* to sink.*, '}counter.* to other.*"
        ]
        await kernel.sleep(0.1)
        assert {one.in_.path for one in kernel.connectors.values()} == {"sink.numbers", "other.numbers"}
        assert all(kernel.connectors[name] is one for name, one in there.items())
        assert wanted_of(kernel) == goal
        (one,) = (one for one in kernel.connectors.values() if one.in_.path == "other.numbers")
        assert one.profile.length == 99
        assert one.statistics.written > 5


@simulated
async def test_rules_go_with_the_reverse_step_and_come_with_the_next_plan(tmp_path: Path) -> None:
    file = folder_of(tmp_path) / "rules.toml"
    file.write_text(PARTS)
    async with Kernel() as kernel:
        await build(kernel, load(file))
        before = wanted_of(kernel)
        file.write_text(PARTS + MORE)
        goal = wanted(prepare(load(file)))
        for _ in range(2):
            assert (await kernel.apply(goal)).done
            await kernel.sleep(0.1)
            assert len(kernel.connectors) == 1
            (step,) = plan(before, goal).reverse().steps
            kernel.service(ConnectingRules).change(step.after)
            await kernel.sleep(0.1)
            assert (len(kernel.connectors), wanted_of(kernel)) == (0, before)


@simulated
async def test_a_rule_that_is_there_can_not_be_changed(tmp_path: Path) -> None:
    file = folder_of(tmp_path) / "rules.toml"
    file.write_text(PARTS + ONE)
    async with Kernel() as kernel:
        await build(kernel, load(file))
        file.write_text(PARTS + MORE)
        with pytest.raises(AiortsError, match=r"\[rules\] is changed"):
            await kernel.apply(wanted(prepare(load(file))))
