"""A plan that is applied to a running system makes the wanted system of it, or leaves it as it was."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.errors import ApplyError
from aiorts.model.wanted.entries import Wanted
from aiorts.model.wanted.plan import plan
from aiorts.planning import wanted_of
from aiorts.planning.applying import Application
from aiorts.testing import simulate
from campaign import cases
from planning.generated import random_system

SEEDS = range(cases(500))


class Broken(Exception):
    """What a test makes a step raise."""


def check_ledgers(kernel: Kernel) -> None:
    """Of every connector, what was written is accounted for; of every port the order of unread samples is whole."""
    for connector in kernel.connectors.values():
        found = connector.statistics
        assert found.written == found.delivered + sum(found.dropped.values()) + found.buffered, connector.name
        assert found.delivered >= 0, connector.name


def check_order(kernel: Kernel) -> None:
    """What came through one connector came once and in order."""
    for component in kernel.components.values():
        last: dict[int, int] = {}
        for source, number in getattr(component, "seen", ()):
            assert number > last.get(id(source), 0), (component.name, number)
            last[id(source)] = number


@pytest.mark.row(109)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_system_is_the_wanted_one_afterwards(seed: int) -> None:
    random = Random(seed)
    systems = [random_system(random) for _ in range(2)]

    async def there_and_back() -> None:
        async with Kernel() as kernel:
            for wanted in (*systems, systems[0]):
                untouched = untouched_by(kernel, wanted)
                applied = await kernel.apply(wanted)
                assert applied.done
                assert not applied.notes
                await kernel.sleep(0.35)
                assert texts(wanted_of(kernel), wanted) == []
                assert not kernel.registry.parked
                assert all(kernel.connectors[one.name] is one for one in untouched)
                check_ledgers(kernel)
                check_order(kernel)

    simulate(there_and_back())


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_that_fails_leaves_the_system_as_it_was(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    random = Random(1000 + seed)
    before, after = random_system(random), random_system(random)
    steps = len(plan(before, after).steps)
    fails_at, does_it_first = random.randrange(max(steps, 1)), random.random() < 0.5
    fail_in_step(monkeypatch, fails_at, does_it_first=does_it_first)

    async def there_and_back() -> None:
        async with Kernel() as kernel:
            await kernel.apply(before)
            await kernel.sleep(0.35)
            objects = {name: one for name, one in kernel.components.items() if name != "group"}
            connectors = dict(kernel.connectors)
            states = {one: dict(one.states) for one in objects.values()}
            fails.append(True)
            with pytest.raises(ApplyError) as refused:
                await kernel.apply(after)
            fails.clear()
            assert refused.value.not_undone == ()
            assert texts(wanted_of(kernel), before) == []
            assert {name: one for name, one in kernel.components.items() if name != "group"} == objects
            assert dict(kernel.connectors) == connectors
            assert {one: dict(one.states) for one in objects.values()} == states
            assert not kernel.registry.parked
            await kernel.sleep(0.35)
            check_ledgers(kernel)
            check_order(kernel)

    fails: list[bool] = FAILS
    fails.clear()
    if steps:
        simulate(there_and_back())


FAILS: list[bool] = []
"""Whether the step that a test has chosen fails now."""


def fail_in_step(monkeypatch: pytest.MonkeyPatch, number: int, *, does_it_first: bool) -> None:
    """Have the step of this number raise, before or after it has done its work, while `FAILS` says so."""
    carry_out = Application.carry_out
    done: list[Any] = []

    async def failing(self: Application, step: Any) -> None:
        if not FAILS:
            await carry_out(self, step)
            return
        done.append(step)
        if len(done) != number + 1:
            await carry_out(self, step)
            return
        if does_it_first:
            await carry_out(self, step)
        raise Broken

    monkeypatch.setattr(Application, "carry_out", failing)


def texts(now: Wanted, wanted: Wanted) -> list[str]:
    """What differs."""
    found = plan(now, wanted)
    return [*(step.text for step in found.steps), *found.refused]


def untouched_by(kernel: Kernel, wanted: Wanted) -> list[Any]:
    """The connectors that the wanted system has, too, with the same options."""
    now = wanted_of(kernel)
    same = {(one.ports, tuple(sorted(one.options.items(), key=str))) for one in wanted.connections}
    return [
        kernel.connectors[f"{one.ports[0]}-{one.ports[1]}"]
        for one in now.connections
        if (one.ports, tuple(sorted(one.options.items(), key=str))) in same
    ]
