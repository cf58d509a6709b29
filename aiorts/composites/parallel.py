"""Runs groups of a composite side by side: each in a lane of its own; the cycle ends when all lanes are done.

A lane is a task that carries out hooks one after the other, as the context's driver does, with deadlines and
cancellation of its own. A context without groups does not use it: its cycle is that of `kernel/execution/cycle.py`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from aiorts.composites.composition_check import outer_of
from aiorts.errors import StateError
from aiorts.kernel.execution.cycle import Batch, OwnStep
from aiorts.kernel.execution.task_driver import NO_FAULT, Abandoned, TaskDriver
from aiorts.late import dataclass

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.composites.group import CompositeGroup
    from aiorts.kernel.execution.cell import ComponentSide
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Steps
    from aiorts.kernel.execution.member import Member

Section = tuple[tuple["ComponentSide", ...], ...]


class ParallelDriver(TaskDriver):
    """Runs one group of each cycle; ends with the context's own driver."""

    __slots__ = ("_arrived", "_bell", "_own")

    def __init__(self, own: TaskDriver) -> None:
        self._own = own
        self._bell: asyncio.Future[Batch | None] | None = None
        self._arrived: Callable[[], None] | None = None
        super().__init__(own.context, _nothing(), own.loop, own.call_at, own.call_later, own.bus)

    def begin(self, batch: Batch, arrived: Callable[[], None]) -> None:
        """Run these members, and call `arrived` when they are done."""
        self._arrived = arrived
        if self._bell is None:
            self._batch = batch  # its task has not begun yet
        else:
            self._bell.set_result(batch)

    def end(self) -> None:
        """End after the present group."""
        if self._bell is not None and not self._bell.done():
            self._bell.set_result(None)
        elif self._bell is None:
            self._over = True

    def stop_for_host(self) -> None:
        """Stop the context: the application cancelled one of its tasks."""
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
                try:
                    await self._run_batch(batch)
                except NO_FAULT:
                    raise
                except BaseException as fault:  # noqa: BLE001 - of the kernel's own: the other lanes' cycle goes on
                    if self._blamed(fault) is None:
                        self.context.runner.life.faulted(fault)
                    continue  # with the rest of the batch
                self._own.hooks_run += 1
                if self._arrived is not None:
                    self._arrived()
        except Abandoned:
            return


def _nothing() -> Steps:
    yield from ()


@dataclass(slots=True)
class Together(OwnStep):
    """A step that runs groups side by side, and in each group one member after the other; done when all groups are."""

    groups: Sequence[Sequence[Member]]
    hook_of: Callable[[Member], str]

    async def carry_out(self, driver: TaskDriver) -> None:
        """Run all groups, begun in their order."""
        left = len(self.groups)
        over: asyncio.Future[None] = driver.loop.create_future()

        def arrived() -> None:
            nonlocal left
            left -= 1
            if not left:
                over.set_result(None)

        lanes = [helper for helper in driver.helpers if isinstance(helper, ParallelDriver)]
        while len(lanes) < left:
            lane = ParallelDriver(driver)
            if driver.budget is not None:
                lane.hurry(driver.budget)
            lanes.append(lane)
            driver.helpers += (lane,)
        for lane, group in zip(lanes, self.groups, strict=False):
            lane.begin(Batch(iter(group), self.hook_of), arrived)
        await over


# -- the passes of a cycle with groups -----------------------------------------------------------------------------


def _pass(sections: Sequence[Section], members: Sequence[Member], hook_of: Callable[[Member], str]) -> Steps:
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


def lay_out_parallel(context: Context) -> None:
    """Lay out which groups of the composites in a context run side by side; between two cycles."""
    outers = (outer_of(member.component) for member in context.runner.members)
    divide(context, dict.fromkeys(outer.root for outer in outers if outer is not None))


def divide(context: Context, composites: Iterable[CompositeGroup]) -> None:
    """Run the groups of these composites side by side in this context, from its next cycle on."""
    sections = tuple(section for composite in composites for section in composite.sections())
    context.runner.divide(partial(_pass, sections) if sections else None)


def check_groups(name: str, groups: Sequence[object], context: Context) -> None:
    """Raise StateError when a composite with these groups cannot run in this context."""
    if groups and not context.suspends:
        raise StateError(
            f"{name}: has groups that run side by side, and {context.name or context.kind} runs in one thread, where "
            "nothing can wait; start it in a periodic, external or event context"
        )
