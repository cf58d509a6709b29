"""Groups of a composite that run side by side: each in a lane of its own, and the cycle ends when all lanes have.

A lane is a task that carries out hooks one after the other as the context's own does, with deadlines, cancellation and
blame of its own. A context without groups knows nothing of this: its cycle is the one in `life.py`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from aiorts.errors import StateError
from aiorts.kernel.bulkhead import LeftBehind, TaskDriver
from aiorts.kernel.life import TURN, Action, Batch, Together, first_pass, second_pass

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.kernel.component import Component
    from aiorts.kernel.context import Context
    from aiorts.kernel.life import Steps
    from aiorts.kernel.member import Member

__all__ = ("Lane", "check_groups", "cycles", "lay_lanes", "run_together")

Section = tuple[tuple["Component", ...], ...]


class Lane(TaskDriver):
    """Runs one group of each cycle; ends with the context's own driver."""

    __slots__ = ("_arrived", "_bell", "_own")

    def __init__(self, own: TaskDriver) -> None:
        self._own = own
        self._bell: asyncio.Future[Batch | None] | None = None
        self._arrived: Callable[[], None] | None = None
        super().__init__(own.context, _nothing(), own.loop, own._call_at, own.call_later, own._bus)

    def begin(self, batch: Batch, arrived: Callable[[], None]) -> None:
        """Run these; `arrived` is called when they are done."""
        self._arrived = arrived
        if self._bell is None:
            self._batch = batch  # its task has not begun yet
        else:
            self._bell.set_result(batch)

    def end(self) -> None:
        """Nothing more will come."""
        if self._bell is not None and not self._bell.done():
            self._bell.set_result(None)
        elif self._bell is None:
            self._over = True

    def stop_for_host(self) -> None:
        """The application cancelled a task of the context's: the context stops."""
        self._own.stop_for_host()
        self._stopped_by_host = self._own._stopped_by_host

    async def _drive(self, outcome: BaseException | None) -> None:
        try:
            while True:
                batch = self._batch
                if batch is None:
                    if self._over:
                        return
                    self._bell = self.loop.create_future()
                    batch = await self._bell
                    if batch is None:
                        return
                await self._run_batch(batch)
                self._own.hooks_run += 1
                if self._arrived is not None:
                    self._arrived()
        except LeftBehind:
            return


def _nothing() -> Steps:
    yield from ()


async def run_together(driver: TaskDriver, step: Together) -> None:
    """Carry out a step of the context's: all groups at once, begun in their order."""
    left = len(step.groups)
    over: asyncio.Future[None] = driver.loop.create_future()

    def arrived() -> None:
        nonlocal left
        left -= 1
        if not left:
            over.set_result(None)

    while len(driver.lanes) < left:
        lane = Lane(driver)
        if driver.budget is not None:
            lane.hurry(driver.budget)
        driver.lanes += (lane,)
    for lane, group in zip(driver.lanes, step.groups, strict=False):
        lane.begin(Batch(iter(group), step.hook_of), arrived)
    await over


# -- the cycle of a context with groups ----------------------------------------------------------------------------


def cycles(context: Context) -> Steps:
    """`Life.steps` from here on, as long as there are groups; itself one action of it."""
    worked = False
    while context._sections and not context._stopping:
        if context._actions:
            yield from context._next_action().steps()
            continue
        wait = context._next_cause()
        if wait is not None:
            worked = False
            yield wait
        elif worked:
            worked = False
            yield TURN
        else:
            members = context._begin_cycle()
            context.ticks += 1
            yield from _pass(members, context._sections, first_pass)
            if context._updating:
                yield from _pass(members, context._sections, second_pass)
            context._end_cycle(members)
            worked = True


def _pass(members: Sequence[Member], sections: Sequence[Section], hook_of: Callable[[Member], str]) -> Steps:
    by_component = {member.component: member for member in members}
    belongs = {part: section for section in sections for group in section for part in group}
    alone: list[Member] = []
    begun: list[Section] = []
    for member in members:
        section = belongs.get(member.component)
        if section is None:
            alone.append(member)
        elif section not in begun:
            begun.append(section)
            if alone:
                yield Batch(iter(alone), hook_of)
                alone = []
            groups = [[by_component[part] for part in group if part in by_component] for group in section]
            yield Together([group for group in groups if group], hook_of)
    if alone:
        yield Batch(iter(alone), hook_of)


def lay_lanes(context: Context) -> None:
    """Lay out which groups of the composites in a context run side by side; between two cycles."""
    had = context._sections
    outers = (member.component._rt_composite for member in context._members)
    roots = dict.fromkeys(outer._rt_root for outer in outers if outer is not None)
    context._sections = tuple(section for root in roots for section in root._rt_sections())
    if context._sections and not had:
        context._submit(Action(partial(cycles, context)))


def check_groups(name: str, groups: Sequence[object], context: Context) -> None:
    """Raise StateError when a composite with these groups cannot run in this context."""
    if groups and not context.suspends:
        raise StateError(
            f"{name}: has groups that run side by side, and {context.name or context.kind} runs in one thread, where "
            "nothing can wait; start it in a periodic, external or event context"
        )
