"""Counts a running system at two moments; costs the system only the time of counting.

It counts a few parts at a time and lets the loop turn in between, so that one snapshot spans a few milliseconds.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Iterable, Mapping
from itertools import islice
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeVar

from aiorts.clock import SimulatedClock
from aiorts.errors import ClosedError, format_error
from aiorts.health.stalls import Stalls
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.bus import Overrun, StateChanged
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.kernel.ports.connector import transport_of
from aiorts.model.health.backlog import Backlog
from aiorts.model.health.windows import ASKED_FOR, ContextCounts, EdgeCounts, Window, context_since, edge_since
from aiorts.model.lifecycle import LifecycleState

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector

_CONNECTORS_AT_ONCE: Final = 200
_COMPONENTS_AT_ONCE: Final = 400
_CONTEXTS_AT_ONCE: Final = 4
"""Numbers of contexts and other parts that are counted before the loop turns: each takes at most 1 ms."""
_HELD: Final = 2
"""Windows that are kept while watching: then one of them is always at least as long as the requested window."""
_ACTIVE, _ERROR = LifecycleState.ACTIVE, LifecycleState.ERROR
_NO_EDGES: Final[Mapping[str, EdgeCounts]] = MappingProxyType({})
_NO_CONTEXTS: Final[Mapping[str, ContextCounts]] = MappingProxyType({})
T = TypeVar("T")


class Health:
    """Measures windows of one kernel, on its clock."""

    def __init__(self, kernel: Microkernel) -> None:
        self._kernel = kernel
        self._rolling: asyncio.Task[None] | None = None
        self._held: deque[_Measurement] = deque()
        """The measurements begun last, the older first, while this object watches."""

    async def window(self, seconds: float) -> Window:
        """The counts of the next so many seconds.

        Raises:
            ClosedError: the kernel closes.
        """
        with _Measurement(self._kernel) as measured:
            await measured.begin()
            await _wait(self._kernel, seconds)
            return await measured.end()

    async def before(self, seconds: float) -> Window:
        """The counts of at least the last `seconds` if they were watched for so long; else those of `window`."""
        now_ns = self._kernel.clock.monotonic_ns()
        for held in self._held:
            if held.began_ns is not None and now_ns - held.began_ns >= seconds * 1e9:
                return await held.end()
        return await self.window(seconds)

    def watch(self, seconds: float) -> None:
        """Keep the counts of the last so many seconds at hand from now on, until `forget` or the kernel's end."""
        self.forget()
        self._rolling = kernel_task(self._kernel.loop, self._roll(seconds), "aiorts health")

    def forget(self) -> None:
        """End watching."""
        if self._rolling is not None:
            self._rolling.cancel()
            self._rolling = None

    async def _roll(self, seconds: float) -> None:
        held = self._held = deque()
        try:
            while True:
                held.append(_Measurement(self._kernel).__enter__())
                await held[-1].begin()
                if len(held) > _HELD:
                    held.popleft().close()
                await _wait(self._kernel, seconds)
        except ClosedError:
            pass  # the watched kernel ends
        finally:
            for one in held:
                one.close()
            held.clear()


class _Measurement:
    """One window, while it is open."""

    def __init__(self, kernel: Microkernel) -> None:
        self._kernel = kernel
        self._errors: dict[str, str] = {}
        self._by_machine: dict[str, tuple[int, int]] = {}
        """By context: overruns caused by the machine, and the ticks that these overruns left out."""
        self._backlogs: dict[str, Backlog] = {}
        self._unsubscribe: tuple[Callable[[], None], ...] = ()
        self._edges: Mapping[str, EdgeCounts] = _NO_EDGES
        self._contexts: Mapping[str, ContextCounts] = _NO_CONTEXTS
        self._real_ns = self._stalled_ns = 0
        self._stalls: Stalls | None = None
        """The stalls of threads; None on a simulated clock, for which no machine is too slow."""
        self.began_ns: int | None = None
        """The time of its beginning, on the kernel's clock; None until all has been counted."""

    def __enter__(self) -> _Measurement:
        kernel, bus = self._kernel, self._kernel.bus
        if not isinstance(kernel.clock, SimulatedClock):
            self._stalls = Stalls(kernel.loop)
        self._unsubscribe = bus.subscribe(Overrun, self._overran), bus.subscribe(StateChanged, self._changed)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the measurement."""
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        if self._stalls is not None:
            self._stalls.close()

    async def begin(self) -> None:
        """Count the system at the beginning, for the comparison at the end."""
        began_ns = self._kernel.clock.monotonic_ns()
        self._real_ns, self._stalled_ns = time.monotonic_ns(), self._stalled()
        self._edges, self._contexts = await self._count_edges(), await self._count_contexts()
        self.began_ns = began_ns

    async def end(self) -> Window:
        """The counts since the beginning; measuring goes on."""
        kernel, began_ns = self._kernel, self.began_ns or 0
        length_ns, real_ns = kernel.clock.monotonic_ns() - began_ns, time.monotonic_ns() - self._real_ns
        stalled = (self._stalled() - self._stalled_ns) / max(1, real_ns)
        edges, contexts = await self._count_edges(), await self._count_contexts()
        errors, idle = await self._look_at_components()
        return Window(
            length_ns,
            MappingProxyType(edges),
            MappingProxyType(contexts),
            MappingProxyType({**self._errors, **errors}),
            frozenset(idle),
            stalled,
        )

    def _stalled(self) -> int:
        return 0 if self._stalls is None else self._stalls.look()

    def _overran(self, event: Overrun) -> None:
        if self._is_by_machine(event):
            count, left_out = self._by_machine.get(event.context, (0, 0))
            self._by_machine[event.context] = count + 1, left_out + event.skipped

    def _is_by_machine(self, event: Overrun) -> bool:
        """Whether the machine caused an overrun: without the threads of others, the cycle had been in time."""
        blamed = event.blame is not None and event.blame.kind == "machine"
        context = self._kernel.contexts.get(event.context)
        if self._stalls is None or context is None:
            return blamed
        speed, now_ns = self._kernel.clock.speed, time.monotonic_ns()
        late_ns = event.late_ns / speed
        period_ns = 1e9 / context.rate / speed if context.rate else 0.0
        since_ns = self._stalls.since(now_ns - int(late_ns + period_ns))
        backlog = self._backlogs.setdefault(event.context, Backlog())
        return blamed | (
            not backlog.late_by_itself(now_ns, late_ns, event.skipped, period_ns, self._stalls.total_ns, since_ns)
        )

    def _changed(self, event: StateChanged) -> None:
        if event.new is _ERROR:
            component = self._kernel.components.get(event.component)
            self._errors[event.component] = "" if component is None else _why(component)

    async def _count_edges(self) -> dict[str, EdgeCounts]:
        found: dict[str, EdgeCounts] = {}
        async for some in _batches(self._kernel.connectors.values(), _CONNECTORS_AT_ONCE):
            found |= {one.name: edge_since(self._edges.get(one.name), _edge(one)) for one in some if not one.closed}
        return found

    async def _count_contexts(self) -> dict[str, ContextCounts]:
        found: dict[str, ContextCounts] = {}
        async for some in _batches(self._kernel.contexts.values(), _CONTEXTS_AT_ONCE):
            found |= {one.name: context_since(self._contexts.get(one.name), self._context(one)) for one in some}
        return found

    def _context(self, context: Context) -> ContextCounts:
        counts = context.counts
        return ContextCounts(
            counts.cycles + counts.skipped,
            counts.overruns,
            *self._by_machine.get(context.name, (0, 0)),
            context.rate,
            counts.policy == "skip" and not context.exclusive,
            tuple(member.component.name for member in context.runner.members),
        )

    async def _look_at_components(self) -> tuple[dict[str, str], set[str]]:
        """The components in error, each with its error, and the components in a context that are not active."""
        errors: dict[str, str] = {}
        idle: set[str] = set()
        async for some in _batches(self._kernel.components.values(), _COMPONENTS_AT_ONCE):
            for component in some:
                states = {member.state for member in cell(component).members}
                if _ERROR in states:
                    errors[component.name] = _why(component)
                elif states and _ACTIVE not in states:
                    idle.add(component.name)
        return errors, idle


def _edge(connector: Connector) -> EdgeCounts:
    written, _, dropped = transport_of(connector).glance()
    lost = sum(count for reason, count in dropped.items() if reason not in ASKED_FOR) if dropped else 0
    return EdgeCounts(connector.out.path, connector.in_.path, written, lost, sum(dropped.values()) - lost)


def _why(component: Component) -> str:
    error = component.last_error
    return "" if error is None else format_error(error)


async def _batches(things: Iterable[T], at_once: int) -> AsyncIterator[tuple[T, ...]]:
    """The present items in batches of at most `at_once`."""
    left = iter(tuple(things))
    while some := tuple(islice(left, at_once)):
        yield some
        await asyncio.sleep(0)


async def _wait(kernel: Microkernel, seconds: float) -> None:
    """Wait on the kernel's clock. ClosedError: the kernel closes."""
    if seconds > 0:
        done = kernel.loop.create_future()
        timer = kernel.call_later(seconds, lambda: None if done.done() else done.set_result(None))
        waited: tuple[asyncio.Future[Any], ...] = done, kernel.closing
        try:
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
        finally:
            timer.cancel()
    kernel.check_open("measure its health")
