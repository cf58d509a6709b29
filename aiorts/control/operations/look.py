"""Operations that only look: names, the profile, the system file, and chosen values at a rate.

These operations change nothing, and in simulated time they do not wait.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable
from functools import partial
from time import perf_counter
from types import MappingProxyType
from typing import Final

from aiorts.clock import SimulatedClock
from aiorts.control.operation import Nothing, Operation, Right
from aiorts.control.pace import looks_of
from aiorts.control.session import Session, Stream
from aiorts.control.ticking import Ticking
from aiorts.control.values import Done, Names
from aiorts.kernel.execution.cell import standing_error
from aiorts.kernel.execution.member import overdue_hooks
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.kernel.loop.turns import HOLD_SECONDS
from aiorts.late import dataclass
from aiorts.observe import Monitor, Reading, SystemProfile, system_profile, system_profile_in_turns


def _names(session: Session, _: Nothing) -> Names:
    kernel = session.kernel
    components = {
        name: MappingProxyType({context: state.value for context, state in component.states.items()})
        for name, component in kernel.components.items()
    }
    wires = {name: (one.out.path, one.in_.path) for name, one in kernel.connectors.items()}
    calls = {name: tuple(port.path for port in one.ports) for name, one in kernel.service_connectors.items()}
    far = kernel.connections.far
    return Names(
        address=kernel.address,
        state=kernel.state,
        components=MappingProxyType(components),
        contexts=MappingProxyType({name: one.profile.members for name, one in kernel.contexts.items()}),
        connectors=MappingProxyType({**wires, **calls}),
        in_error=tuple(name for name, one in kernel.components.items() if standing_error(one) is not None),
        finished=tuple(name for name, one in kernel.components.items() if one.has_finished),
        links="" if far is None else far.open_as(elsewhere=session.carried),
        notices=tuple(one.notice for one in kernel.services if one.notice),
        risks=tuple(one.risk for one in kernel.services if one.risk),
        lasting=kernel.registry.lasting,
        assembled=kernel.registry.assembled,
        pid=os.getpid(),
        overdue=MappingProxyType(
            {name: late for name, one in kernel.components.items() if (late := overdue_hooks(one))}
        ),
    )


def _profile(session: Session, _: Nothing) -> SystemProfile | Awaitable[SystemProfile]:
    if isinstance(session.kernel.clock, SimulatedClock):
        return system_profile(session.kernel)  # a task would be one more that is ready at this instant
    return system_profile_in_turns(session.kernel, HOLD_SECONDS)


def _origin(session: Session, _: Nothing) -> str:
    return session.kernel.origin


@dataclass(frozen=True, slots=True)
class Watched:
    """Values to read, by their paths as in `Kernel.monitor`."""

    paths: tuple[str, ...]
    rate: float = 10.0
    """Hz by the kernel's clock; in simulated time by the real clock."""


def _monitor(session: Session, given: Watched, stream: Stream) -> Done:
    kernel = session.kernel
    began = perf_counter()
    monitor = Monitor(kernel, tuple(dict.fromkeys(given.paths)), given.rate)
    took, pace = perf_counter() - began, looks_of(kernel)  # the constructor read each path, which a reading does, too
    stream.on_close(monitor.close)
    if isinstance(kernel.clock, SimulatedClock):

        def look() -> None:
            if not pace.due():
                pace.spend(took)
                stream.send(monitor.look())

        stream.on_close(Ticking(kernel, given.rate, look).close)
        return Done()

    over: asyncio.Future[None] = kernel.loop.create_future()
    stream.on_close(partial(over.set_result, None))

    async def send_all() -> None:
        async for reading in monitor:
            stream.send(reading)
            pace.spend(took)
            if due := pace.due():
                await asyncio.wait((over,), timeout=due)  # readings in this pause are counted as missed
        stream.finish()

    kernel_task(kernel.loop, send_all(), "aiorts control monitor")
    return Done()


ROWS: Final = (
    Operation("monitor", "Stream chosen values at a rate.", Watched, Done, Right.VIEW, _monitor, item=Reading),
    Operation("names", "What is in the kernel, by name.", Nothing, Names, Right.VIEW, _names, idempotent=True),
    Operation("origin", "The text of the system file, if any.", Nothing, str, Right.VIEW, _origin, idempotent=True),
    Operation("profile", "The whole profile.", Nothing, SystemProfile, Right.VIEW, _profile, idempotent=True),
)
