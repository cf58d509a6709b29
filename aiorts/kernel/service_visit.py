"""Who is inside a component while it serves a call, and who waits for whom; nothing here waits itself.

A hook that runs and a call that is served are *activities*. An activity that has called waits for the call; a call
that is not let in waits for the activity that is inside. A call that would close such a circle is never begun.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, TypeAlias

from aiorts.errors import StateError
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.context import Context
    from aiorts.kernel.member import Member

__all__ = ("Activity", "Calls", "Visit", "activity_of", "holder_of", "visits")


class Visit:
    """A call that a component serves, as the component sees it."""

    __slots__ = ("component", "hook")

    def __init__(self, component: Component, hook: str) -> None:
        self.component = component
        self.hook = hook
        """Port and method, such as "brake.stop": what stands in logs where a hook would."""

    @property
    def where(self) -> str:
        """For messages."""
        return f"a call of {self.hook}"

    @property
    def tick(self) -> int:
        """A call belongs to no cycle."""
        return 0

    @property
    def context(self) -> Context:
        """The component's context; StateError where it has none or several."""
        contexts = self.component.contexts
        if len(contexts) == 1:
            return contexts[0]
        raise StateError(f"{self.component.name}: is in {len(contexts)} contexts and serves {self.hook}; say which")

    @property
    def state(self) -> LifeCycleState | None:
        """The component's state: active where it is active in any context."""
        states = [member.state for member in self.component._rt_members]
        return LifeCycleState.ACTIVE if LifeCycleState.ACTIVE in states else states[0] if states else None

    def finish(self) -> None:
        """The component said, in a method that others call, that it has nothing more."""
        for member in self.component._rt_members:
            member.finish()


Activity: TypeAlias = "Member | Visit"


class Calls:
    """The calls of one kernel that are waited for, by the activity that waits."""

    __slots__ = ("_by_caller",)

    def __init__(self) -> None:
        self._by_caller: dict[Activity, list[Any]] = {}

    def enter(self, caller: Activity, call: Any) -> None:
        """`caller` waits for `call`."""
        self._by_caller.setdefault(caller, []).append(call)

    def leave(self, caller: Activity, call: Any) -> None:
        """It waits no more."""
        calls = self._by_caller[caller]
        calls.remove(call)
        if not calls:
            del self._by_caller[caller]

    def way_back(self, holder: Activity | None, caller: Activity) -> list[Any] | None:
        """The calls through which `holder` waits for `caller`, or None: it does not, or not through calls alone."""
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
    if component._rt_host.threaded or component._rt_host.realtime:
        # Calls are served between the cycles of its thread: any hook of that thread is in the way.
        for member in component._rt_members:
            driver = member.context._driver
            if driver is not None and driver.current is not None:
                return driver.current
    return component._rt_gate.inside


def activity_of(task: asyncio.Task[Any] | None) -> Activity | None:
    """The activity whose own task this is; None for tasks that one has started beside itself."""
    if task is None:
        return None
    visit: Activity | None = getattr(task, "_aiorts_visit", None)
    if visit is not None:
        return visit
    driver = getattr(task, "_aiorts_driver", None)
    member: Member | None = None if driver is None else driver.current
    return member


def visits(task: Any, context: Context) -> bool:
    """Whether this task, or one that waits for it, serves a call in a component that `context` runs."""
    while task is not None and not isinstance(task, tuple) and not task.done():
        visit = getattr(task, "_aiorts_visit", None)
        if visit is not None and any(member.context is context for member in visit.component._rt_members):
            return True
        task = getattr(task, "_aiorts_creator", None)
    return False
