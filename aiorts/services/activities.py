"""The graph of waiting among the calls of a kernel.

A hook that runs and a call that is served are *activities*. An activity that has called waits for the call; a call that
may not enter a component yet waits for the activity inside it. A call that would close a circle of waiting is never
begun.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.member import Member, Visit
from aiorts.kernel.service import KernelService

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel

Activity: TypeAlias = Member | Visit


class CallGraph(KernelService):
    """The calls of one kernel that are waited for, by the activity that waits."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._by_caller: dict[Activity, list[Any]] = {}

    def enter(self, caller: Activity, call: Any) -> None:
        """Note that `caller` waits for `call`."""
        self._by_caller.setdefault(caller, []).append(call)

    def leave(self, caller: Activity, call: Any) -> None:
        """Note that `caller` waits for `call` no more."""
        calls = self._by_caller[caller]
        calls.remove(call)
        if not calls:
            del self._by_caller[caller]

    def way_back(self, holder: Activity | None, caller: Activity) -> list[Any] | None:
        """The calls through which `holder` waits for `caller`; None if `holder` does not wait for it through calls."""
        return self._way(holder, caller, set())

    def _way(self, holder: Activity | None, caller: Activity, seen: set[int]) -> list[Any] | None:
        if holder is caller:
            return []
        if holder is None or id(holder) in seen:
            return None
        seen.add(id(holder))
        for call in self._by_caller.get(holder, ()):
            rest = self._way(call if call.runs else holder_of(call.component), caller, seen)
            if rest is not None:
                return [call, *rest]
        return None


def holder_of(component: Component) -> Activity | None:
    """The activity that keeps others out of a component now."""
    if cell(component).threaded or cell(component).realtime:
        # Calls are served between the cycles of its thread: any hook of that thread is in the way.
        for member in cell(component).members:
            current = member.context.runner.current
            if current is not None:
                return current
    return cast("Activity | None", cell(component).entry_lock.inside)


def activity_of(task: asyncio.Task[Any] | None) -> Activity | None:
    """The activity that runs in this task; None for further tasks that an activity has started."""
    if task is None:
        return None
    visit: Activity | None = getattr(task, "_aiorts_visit", None)
    if visit is not None:
        return visit
    driver = getattr(task, "_aiorts_driver", None)
    member: Member | None = None if driver is None else driver.current
    return member
