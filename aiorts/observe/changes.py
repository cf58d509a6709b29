"""`kernel.changes()`: a stream of changes after one profile; a reader that is too slow gets a new profile.

Every event of the bus that names a component, a context or a connector becomes one change with the new reports of all
things that the event touches, whatever its kind: new kinds of events need no code here.
"""

from __future__ import annotations

from collections import deque
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.bus import Assembled, Closing, Event
from aiorts.kernel.loop.turns import in_turns
from aiorts.model.profile import ConnectorProfile
from aiorts.model.service_profile import ServiceConnectorProfile
from aiorts.observe.change_values import Change, Part, ProfileSnapshot
from aiorts.observe.iterating import ClosableIterator, Waiter
from aiorts.observe.profiling import (
    component_report,
    connector_report,
    context_report,
    profile_with,
    service_report,
    system_profile,
    visible,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable

    from aiorts.kernel.microkernel import Microkernel
    from aiorts.observe.profiles import SystemProfile

_COUNTS: Final = frozenset(
    {
        *("CallFailed", "ConversionFailed", "GoalAccepted", "GoalEnded", "MachineAfter", "MachineBefore", "Overrun"),
        "ThreadsExhausted",
    }
)
"""Kinds of events that change nothing but counters, or are followed by an event of the change itself."""

_ONE: Final = ("component", "composite")
"""Fields of events that name a component."""


class Changes(ClosableIterator):
    """An async iterator of `ProfileSnapshot` and `Change`, for one task; ends with its kernel, or with `close()`."""

    def __init__(self, kernel: Microkernel, length: int, sink: Callable[[Change], object] | None = None) -> None:
        self._kernel = kernel
        self._length = length
        self._queue: deque[Change] = deque()
        self._members = {name: _members(kernel, name) for name in kernel.contexts}
        """The members of each context as last reported: a context that has stopped has none any more."""
        self._sink = sink
        """The function that takes each change at once, instead of a queue; or None."""
        self._stale = sink is None
        """Whether a new snapshot is due."""
        self._missed = 0
        self._waiter = Waiter()
        self._closed = False
        self._unsubscribe = kernel.bus.subscribe(Event, self._note)

    def close(self) -> None:
        """End the stream; idempotent."""
        if not self._closed:
            self._closed = True
            self._unsubscribe()
            self._waiter.wake()

    def end(self) -> None:
        """End the stream, since the kernel is closed; waiting changes can still be read."""
        self.close()

    async def __anext__(self) -> ProfileSnapshot | Change:
        self._waiter.check_free(f"{self._kernel.name}: another task iterates these changes")
        while not self._stale and not self._queue:
            if self._closed:
                raise StopAsyncIteration
            await self._waiter.wait()
        if self._stale:
            self._stale = False
            missed, self._missed = self._missed, 0
            self._queue.clear()
            profile = system_profile(self._kernel)
            return ProfileSnapshot(profile.sequence, profile, missed)
        return self._queue.popleft()

    def _note(self, event: Event) -> None:
        if type(event).__name__ in _COUNTS:
            return
        parts = self._parts(event)
        if self._stale:
            self._missed += 1
            return
        if not (parts or isinstance(event, (Assembled, Closing))):
            return
        if self._sink is not None:
            self._sink(Change(event.sequence, event, parts))
        elif len(self._queue) >= self._length:
            self._missed += len(self._queue) + 1
            self._stale = True
            self._queue.clear()
        else:
            self._queue.append(Change(event.sequence, event, parts))
        self._waiter.wake()

    # -- what an event touches -------------------------------------------------------------------------------------

    def _parts(self, event: Any) -> tuple[Part, ...]:
        kernel = self._kernel
        components: dict[str, None] = {}
        contexts: dict[str, None] = {}
        parts: list[Part] = []
        for field in _ONE:
            if name := getattr(event, field, ""):
                components[name] = None
        if name := getattr(event, "context", ""):
            contexts[name] = None
            before, now = self._members.get(name, ()), _members(kernel, name)
            if now:
                self._members[name] = now
            else:
                self._members.pop(name, None)
            if before != now:
                components |= dict.fromkeys((*before, *now))
        profile = getattr(event, "connector", None)
        if isinstance(profile, ConnectorProfile):
            one = kernel.connectors.get(profile.name)
            parts.append(Part("connectors", profile.name, None if one is None else connector_report(one)))
        elif isinstance(profile, ServiceConnectorProfile):
            service = kernel.service_connectors.get(profile.name)
            parts.append(Part("service_connectors", profile.name, None if service is None else service_report(service)))
        if isinstance(profile, ConnectorProfile | ServiceConnectorProfile):
            components |= dict.fromkeys(path.rpartition(".")[0] for path in profile.ports)
        parts += self._components(components)
        for name in contexts:
            context = kernel.contexts.get(name)
            parts.append(Part("contexts", name, None if context is None else context_report(context)))
        return tuple(parts)

    def _components(self, names: Iterable[str]) -> list[Part]:
        """The parts of these components and of the composites around them, whose state and ports follow from theirs."""
        kernel = self._kernel
        parts, todo = [], dict.fromkeys(names)
        for name in tuple(todo):
            inner = kernel.components.get(name)
            while inner is not None and (outer := cell(inner).group) is not None:
                todo[outer.name] = None
                inner = kernel.components.get(outer.name)
        for name in todo:
            component = kernel.components.get(name)
            here = component is not None and visible(kernel, component)
            parts.append(Part("components", name, component_report(component) if component and here else None))
        return parts


async def system_profile_in_turns(kernel: Microkernel, hold: float) -> SystemProfile:
    """Take the profile as `system_profile`, in turns of `hold` seconds; changes meanwhile are applied."""
    changes: list[Change] = []
    with closing(Changes(kernel, 0, changes.append)):
        reports = await in_turns(_reports(kernel), hold)
    profile = profile_with(kernel, *reports)
    for change in changes:
        profile = change.apply(profile)
    return replace(profile, sequence=kernel.bus.sequence)


def _reports(kernel: Microkernel) -> Generator[None, None, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]]:
    """The reports of all components, connectors and service connectors, by name; each report is one step."""
    components: dict[str, Any] = {}
    connectors: dict[str, Any] = {}
    services: dict[str, Any] = {}
    for things, reports, report in (
        (kernel.components, components, component_report),
        (kernel.connectors, connectors, connector_report),
        (kernel.service_connectors, services, service_report),
    ):
        for name in tuple(things):
            thing: Any = things.get(name)
            if thing is not None and (reports is not components or visible(kernel, thing)):
                reports[name] = report(thing)
                yield
    return components, connectors, services


def _members(kernel: Microkernel, name: str) -> tuple[str, ...]:
    context = kernel.contexts.get(name)
    return () if context is None else tuple(member.component.name for member in context.runner.members)
