"""What the kernel keeps on a component is one object, which neither takes a name from the user nor can be lost."""

from __future__ import annotations

import pytest

from aiorts import Component, EventContext, InPort, Kernel, LifecycleState, Param
from aiorts.kernel.execution.cell import cell, exchange_cells, has_cell
from aiorts.testing import simulated
from aiorts.types import TimedDouble


class Mine(Component):
    """Names of its own, like those that the kernel might have wanted."""

    inp = InPort(TimedDouble)
    gain = Param(1.0)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self._log = self._members = self._kernel = self._cell = "mine"
        self.cell = self.members = self.group = self.kernel_ = "mine"
        self.cycles = 0

    def on_execute(self) -> None:
        self.cycles += 1


@simulated
async def test_every_name_but_one_is_the_users() -> None:
    async with Kernel() as kernel:
        mine = await kernel.create(Mine)
        context = await kernel.start(EventContext(), mine, activate=True)
        context.trigger(mine)
        await kernel.sleep(0.1)
        assert mine.cycles == 1
        assert {mine._log, mine._members, mine._kernel, mine._cell, mine.cell, mine.members, mine.kernel_} == {"mine"}
        assert [name for name in vars(mine) if name.startswith("_rt")] == ["_rt"]


@simulated
async def test_a_component_that_clears_its_attributes_gets_its_cell_back() -> None:
    async with Kernel() as kernel:
        mine = await kernel.create(Mine)
        context = await kernel.start(EventContext(), mine, activate=True)
        kept = cell(mine)
        vars(mine).clear()
        assert cell(mine) is kept
        assert mine.contexts == (context,)
        assert mine.state is LifecycleState.ACTIVE
        await kernel.remove(mine)
        assert kernel.components == {}


def test_one_whose_constructor_has_not_run_has_none() -> None:
    class Forgetful(Component):
        def __init__(self, name: str) -> None:
            """Without `super().__init__(name)`."""

    assert not has_cell(Forgetful("x"))
    assert not has_cell(Component)
    assert not has_cell("component")
    assert has_cell(Component("x"))
    with pytest.raises(AttributeError, match="_rt"):
        cell(Forgetful("x"))


def test_two_that_change_places_take_their_code_along_and_nothing_else() -> None:
    one, other = Mine("one"), Mine("one")
    first, second = cell(one), cell(other)
    first.hook_kinds, second.hook_kinds = {"on_execute": 1}, {"on_execute": 2}
    first.last_error = error = ValueError("of the place")
    exchange_cells(one, other)
    assert (cell(one), cell(other)) == (second, first)
    assert (cell(one).hook_kinds, cell(other).hook_kinds) == ({"on_execute": 1}, {"on_execute": 2})
    assert (cell(one).last_error, cell(other).last_error) == (None, error)
    exchange_cells(one, other)
    assert (cell(one), cell(other)) == (first, second)
    assert first.hook_kinds == {"on_execute": 1}
