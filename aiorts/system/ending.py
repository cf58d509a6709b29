"""Finds out when a system has ended by itself: its sources are done, and none of their samples is still on its way.

A source is a component that writes without input: it has an out-port and none of its in-ports was ever connected. It is
done when it has finished, or is in error and supervision does not help it, or was removed, or its contexts have stopped
or were ended by a fault. A source that is merely not active is not done: it waits for its start, or was deactivated and
may be activated again. To end it for good, remove it, stop its context, or ask for the end.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

from aiorts.assembly import Kernel
from aiorts.contexts import EventContext
from aiorts.kernel.component import Component
from aiorts.kernel.execution.cell import as_group, cell
from aiorts.kernel.execution.context import Context
from aiorts.kernel.loop.bus import ComponentRemoved, ContextStopped, Event, StateChanged
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.ports.connector import Connector, unread_of
from aiorts.model.lifecycle import LifecycleState
from aiorts.services import GoalKeeper
from aiorts.supervision import ComponentRecovered, RestartLimitReached

_LOOK_AGAIN: Final = 0.005
_PATIENCE: Final = 1.0
"""Seconds without a new sample or running hook after which unread samples count as unwanted."""
_TOLD: Final = 1.0
"""Seconds of waiting for unread samples after which the waiting is reported."""
Slow: TypeAlias = Callable[[Sequence[Connector]], float | None]
"""Called when readers are slow to read their last samples, with the connectors that hold these samples. Returns how
many more seconds to wait for the readers at most; None: as long as they go on reading."""
_NOTED: Final = (StateChanged, ComponentRemoved, ContextStopped, ComponentRecovered, RestartLimitReached)


def is_source(component: Component) -> bool:
    """Whether a component is a source: it writes without input."""
    return any(isinstance(port, OutPort) for port in component.ports.values()) and not _is_fed(component)


def ended_in_error(kernel: Kernel) -> dict[str, BaseException | None]:
    """The components in error, by name, each with its exception; for a composite, its members."""
    parts = [one for one in kernel.components.values() if as_group(one) is None]
    gone = [one for name, one in kernel.supervised.items() if name not in kernel.components]
    failed = {one.name: one.last_error for one in parts if LifecycleState.ERROR in one.states.values()}
    return failed | {one.name: one.last_error for one in gone}


async def wait_finished(kernel: Kernel) -> tuple[Connector, ...]:
    """Wait until every source is done, no recovery is due, the queues are empty and no hook runs.

    Without a source, every component has to be done. A component with in-ports and no connection at all counts as a
    source only if there is no other source. Returns the connectors with samples that their readers did not read while
    nothing moved for a second. Samples whose readers' contexts have stopped do not count. Components and contexts that
    were removed or stopped before the call are not known; `Ending` observes them from its creation on.
    """
    ending = Ending(kernel)
    try:
        return await ending.wait()
    finally:
        ending.close()


class Ending:
    """Observes, from its creation on, removed components and stopped contexts; `wait` uses these observations."""

    def __init__(self, kernel: Kernel, slow: Slow = lambda _: None) -> None:
        self._kernel = kernel
        self._slow = slow
        self._look = _Look(kernel)
        self._changed = asyncio.Event()
        self._removers = [kernel.bus.subscribe(kind, self._note) for kind in _NOTED]

    async def wait(self) -> tuple[Connector, ...]:
        """Wait as `wait_finished` does, but for slow readers at most as long as `slow` returns."""
        while True:
            while not self._look.ended():
                await self._changed.wait()
                self._changed.clear()
            unread = await _settled(self._kernel, self._look, self._slow)
            if self._look.ended():  # no component was activated again meanwhile
                return unread

    def close(self) -> None:
        """Stop observing."""
        for remove in self._removers:
            remove()

    def _note(self, event: Event) -> None:
        self._look.note(event)
        self._changed.set()


class _Look:
    """Records of the components of a kernel and their past, from which `ended` decides."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._fed: set[str] = set()
        """Components that were ever connected to a writer: they are no sources, even after the writer is removed."""
        self._finished: set[str] = set()
        """The names of finished components, kept after a component leaves its context or gets other code."""
        self._sources: set[str] = set()
        """The names of the sources, removed ones included."""
        self._contexts: dict[str, set[str]] = {}
        """By component that ran: its last known contexts, except those that have stopped."""

    def note(self, event: Event) -> None:
        """Record an event of a component, or the stop of a context."""
        if isinstance(event, ContextStopped):
            for contexts in self._contexts.values():
                contexts.discard(event.context)
            return
        name: str = getattr(event, "component", "")
        component = self._kernel.components.get(name)
        if component is not None and component.contexts and as_group(component) is None:
            self._see(component)
        if isinstance(event, StateChanged) and event.new is LifecycleState.ACTIVE:
            self._finished.discard(name)
        elif component is not None and component.has_finished:
            self._finished.add(name)

    def ended(self) -> bool:
        """Whether all sources are done, and supervision is not recovering a component."""
        kernel = self._kernel
        # A composite is not counted: its members are.
        runs = [one for one in kernel.components.values() if one.contexts and as_group(one) is None]
        for one in runs:
            self._see(one)
        supervised = kernel.supervised.items()
        if any(one.helping for _, one in supervised):
            return False
        off = {name for name in self._contexts if self.is_off(name)}
        given_up = [one.component for name, one in supervised if name not in kernel.components]
        lost = (off & self._sources | {one.name for one in given_up if is_source(one)}) - self._fed
        sources = [one for one in runs if one.name in self._sources]
        # A source that has in-ports and no connection at all is not waited for, if there is another source.
        sources = [one for one in sources if self._done(one) or not _left_alone(one)] or sources
        if sources or lost:
            return all(map(self._done, sources))
        return all(map(self._done, runs)) if runs else bool(off) and len(off) == len(self._contexts)

    def is_off(self, name: str) -> bool:
        """Whether a component that ran will not run again: it was removed, or each of its contexts has stopped."""
        component = self._kernel.components.get(name)
        return component is None or (not component.contexts and self._contexts.get(name) == set())

    def _see(self, component: Component) -> None:
        """Record the contexts of a component, and whether it is a source."""
        name = component.name
        self._contexts[name] = {context.name for context in component.contexts}
        if _is_fed(component):
            self._fed.add(name)
        if name not in self._fed and is_source(component):
            self._sources.add(name)
        else:
            self._sources.discard(name)

    def _done(self, component: Component) -> bool:
        """Whether a component will not go on, given that no recovery is due."""
        states = component.states.values()
        if LifecycleState.ACTIVE in states:
            return False
        if LifecycleState.ERROR in states or component.name in self._finished or component.has_finished:
            return True
        # A component that was stopped because a member of its composite failed goes on only with that member.
        return any(self._is_dead(name) for member in cell(component).members for name in member.stopped_for)

    def _is_dead(self, name: str) -> bool:
        component = self._kernel.components.get(name)
        return component is None or LifecycleState.ERROR in component.states.values()


def _is_fed(component: Component) -> bool:
    return any(isinstance(port, InPort) and port.connectors for port in component.ports.values())


def _left_alone(component: Component) -> bool:
    ports = component.ports.values()
    takes = any(isinstance(port, InPort) for port in ports)
    return takes and not any(port.connectors for port in ports if isinstance(port, InPort | OutPort))


async def _settled(kernel: Kernel, look: _Look, slow: Slow) -> tuple[Connector, ...]:
    # Periods are in the kernel's time, but this loop sleeps in real time.
    longest = max((2.0 / context.rate for context in kernel.contexts.values() if context.rate), default=0.0)
    patience = _PATIENCE + longest / kernel.clock.speed
    seen, still = -1, 0.0
    tell_at: float | None = time.monotonic() + _TOLD
    until: float | None = None
    cycles: dict[Context, int] = {}
    while True:
        buffered = [c for c in kernel.connectors.values() if unread_of(c) or _is_under_way(c)]
        waiting = tuple(c for c in buffered if c.in_.is_far or not look.is_off(c.in_.path.partition(".")[0]))
        moved = sum(connector.statistics.arrived for connector in kernel.connectors.values())
        if waiting or moved != seen:
            cycles = {context: context.ticks for context in kernel.contexts.values() if _repeats(context)}
        busy = any(_is_busy(one) and one.ticks <= cycles.get(one, one.ticks) for one in kernel.contexts.values())
        busy = busy or _is_cancelled(kernel)
        if not waiting and not busy and not _threads_wait(kernel):
            return ()
        still = 0.0 if moved != seen or busy else still + _LOOK_AGAIN
        seen = moved
        now = time.monotonic()
        if still > patience or (waiting and until is not None and now >= until):
            return waiting
        if waiting and not still and tell_at is not None and now >= tell_at:
            more, tell_at = slow(waiting), None
            until = None if more is None else now + more
        await asyncio.sleep(_LOOK_AGAIN)


def _is_under_way(connector: Connector) -> bool:
    """Whether samples wait in a connector, or are on their way to another kernel."""
    counts = connector.statistics
    return counts.buffered > 0 or counts.in_flight > 0


def _repeats(context: Context) -> bool:
    """Whether a context runs its members without samples, too: then a cycle after the last sample is no work."""
    return isinstance(context, EventContext) and context.every is not None


def _threads_wait(kernel: Kernel) -> bool:
    """Whether samples that foreign threads wrote wait to be passed on."""
    ports = (port for component in kernel.components.values() for port in component.ports.values())
    return any(port.thread_writes.waiting for port in ports if isinstance(port, OutPort))


def _is_cancelled(kernel: Kernel) -> bool:
    """Whether a goal that its client cancelled is still ending."""
    keeper = kernel.attached(GoalKeeper)
    return keeper is not None and keeper.cancelling


def _is_busy(context: Context) -> bool:
    """Whether a hook runs, or an effect of a hook, such as its failure, is not handled yet."""
    return context.running and (context.runner.current is not None or context.runner.pending)
