"""When a system has ended of itself: all its sources have finished, and nothing they sent is still on its way.

A source is a component that produces of itself: it has an out-port and none of its in-ports is connected.
"""

from __future__ import annotations

import asyncio
from typing import Final

from aiorts.kernel.bus import ComponentRemoved, StateChanged
from aiorts.kernel.component import Component
from aiorts.kernel.connector import Connector
from aiorts.kernel.kernel import Kernel
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.unfold import is_composite
from aiorts.model.lifecycle import LifeCycleState

__all__ = ("is_source", "wait_finished")

_LOOK_AGAIN: Final = 0.005
_PATIENCE: Final = 1.0
"""Seconds without any movement after which unread samples are taken for samples that nobody wants."""


def is_source(component: Component) -> bool:
    """Whether a component produces of itself."""
    ports = component.ports.values()
    return any(isinstance(port, OutPort) for port in ports) and not any(
        isinstance(port, InPort) and port.connectors for port in ports
    )


async def wait_finished(kernel: Kernel) -> tuple[Connector, ...]:
    """Wait until every source was active and is no more, the queues are empty and no hook runs; or all are in error.

    Without any source it waits for ever. One with in-ports and no connection at all counts as a source only where there
    is no other. Returns the connectors with samples that their readers left alone: when
    nothing has moved for a second, it is not waited for them any longer.
    """
    changed = asyncio.Event()
    began = {component.name for component in kernel.components.values() if _active(component)}

    def note(event: StateChanged | ComponentRemoved) -> None:
        if isinstance(event, StateChanged) and event.new is LifeCycleState.ACTIVE:
            began.add(event.component)
        changed.set()

    removers = [kernel.bus.subscribe(StateChanged, note), kernel.bus.subscribe(ComponentRemoved, note)]
    try:
        while not _ended(kernel, began):
            await changed.wait()
            changed.clear()
        return await _settled(kernel)
    finally:
        for remove in removers:
            remove()


def _ended(kernel: Kernel, began: set[str]) -> bool:
    # A composite is its members, and no source beside them.
    runs = [one for one in kernel.components.values() if one.contexts and not is_composite(one)]
    sources = [component for component in runs if is_source(component)]
    # One that was to be fed and that nothing is connected to is not waited for, if there is anybody else.
    sources = [source for source in sources if source.has_finished or not _left_alone(source)] or sources
    # Asked of the component, too: it may have finished before anybody looked.
    if sources and all((s.name in began or s.has_finished) and not _active(s) for s in sources):
        return True
    return bool(runs) and all(set(c.states.values()) == {LifeCycleState.ERROR} for c in runs)


def _left_alone(component: Component) -> bool:
    ports = component.ports.values()
    takes = any(isinstance(port, InPort) for port in ports)
    return takes and not any(port.connectors for port in ports if isinstance(port, InPort | OutPort))


def _active(component: Component) -> bool:
    return LifeCycleState.ACTIVE in component.states.values()


async def _settled(kernel: Kernel) -> tuple[Connector, ...]:
    # Periods are in the kernel's time, and it is looked again in real time.
    longest = max((2.0 / context.rate for context in kernel.contexts.values() if context.rate), default=0.0)
    patience = _PATIENCE + longest / kernel.clock.speed
    seen, still = -1, 0.0
    while True:
        waiting = tuple(c for c in kernel.connectors.values() if c.statistics.buffered and c.in_ is not None)
        busy = any(_in_hook(context) for context in kernel.contexts.values())
        if not waiting and not busy:
            return ()
        moved = sum(connector.statistics.delivered for connector in kernel.connectors.values())
        still = 0.0 if moved != seen or busy else still + _LOOK_AGAIN
        seen = moved
        if still > patience:
            return waiting
        await asyncio.sleep(_LOOK_AGAIN)


def _in_hook(context: object) -> bool:
    driver = getattr(context, "_driver", None)
    return driver is not None and driver.current is not None
