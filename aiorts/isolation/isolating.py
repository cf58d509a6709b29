"""The service of isolation: starts processes for components, and ends them with their kernel."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import SimulatedClock
from aiorts.errors import DeclarationError, LinkError
from aiorts.isolation.messages import REPORT, Report
from aiorts.isolation.placing import RemoteContext
from aiorts.isolation.printing import Printing
from aiorts.isolation.process import Process
from aiorts.isolation.stand_in import RemoteComponent, stand_in_of
from aiorts.kernel.component import Component
from aiorts.kernel.extensions.loading import load_aside
from aiorts.kernel.extensions.type_names import extension_of
from aiorts.kernel.extensions.type_texts import type_text
from aiorts.kernel.loop.bus import Connected, Disconnected
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.kernel.ports.connector import unread_of
from aiorts.kernel.service import KernelService
from aiorts.links import Caller, Links, UnixTransport
from aiorts.model.lifecycle import OverdueHook
from aiorts.model.profile import ContextStatistics
from aiorts.model.reading import from_plain
from aiorts.model.service_profile import ServiceConnectorProfile
from aiorts.processes import Launcher, Limits

if TYPE_CHECKING:
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector

_LOG: Final = KernelLog()
_STARTS: Final = 2 * (os.cpu_count() or 1)
"""The most processes that come up at the same time; the time limit of each begins with its turn."""

_READ_SECONDS: Final = 0.05
"""Seconds between two checks whether all samples that a component wrote before its move have been read."""


class Isolation(KernelService):
    """The processes of one kernel's components."""

    name = "isolation"

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._launcher: Launcher | None = None
        self._transport = UnixTransport(listens=False)
        self._transport.program = os.urandom(32)
        self._transport.answer(REPORT, self._reported)
        self._opening: asyncio.Task[None] | None = None
        self._processes: dict[str, Process] = {}
        """The processes, by the names of their kernels."""
        self._components: dict[Process, RemoteComponent] = {}
        self._delays: dict[str, str] = {}
        """By component: how its process delayed its own end."""
        self._stand_ins: dict[tuple[Any, ...], type[RemoteComponent]] = {}
        """The classes of stand-ins, by class, text and limits."""
        self._starts = asyncio.Semaphore(_STARTS)
        self._printing = Printing()
        self._said = False
        self._leftover: dict[Connector, Cancellable] = {}
        """Connectors that end once they are read, each with the timer of its next check."""
        kernel.bus.subscribe(Connected, self._rewired)
        kernel.bus.subscribe(Disconnected, self._rewired)

    def report(self) -> Mapping[str, Any]:
        """The process of each component, the seconds that a hook has held it, and the lines that were not printed."""
        lost = self._printing.left_out
        return {
            one.name: {"pid": one.pid, "runs": one.runs, "busy": round(one.busy, 1), "unprinted": lost[one.name]}
            for one in self._processes.values()
        }

    async def create(
        self, kind: type[Component] | str, name: str, limits: Mapping[str, Any], params: Mapping[str, object]
    ) -> Component:
        """See `Kernel.create_isolated`."""
        kernel = self.kernel
        if isinstance(kind, str):
            cls: type[Component] = await load_aside(extension_of(kind, kernel.plugins), kernel.clock, Component)
            kernel.check_open("create_isolated")
        else:
            cls = kind
        if not (isinstance(cls, type) and issubclass(cls, Component)):
            raise DeclarationError(f"{cls!r}: expected a class derived from Component")
        return await kernel.create(self.stand_in(cls, limits), name, **params)

    def stand_in(self, cls: type[Component], limits: Mapping[str, Any]) -> type[Component]:
        """The class of stand-ins for components of `cls`; on a simulated clock it is `cls` itself.

        Args:
            limits: what the process of each may use.

        Raises:
            DeclarationError: a process cannot import the class, or it has what cannot be used across processes.
        """
        if isinstance(self.kernel.clock, SimulatedClock):
            if not self._said:
                self._said = True
                _LOG.warning("W-ISOLATION: on a simulated clock isolated components run in this process")
            return cls
        text = "" if cls.__module__ == "__main__" else type_text(cls, self.kernel.plugins)
        if not text:
            raise DeclarationError(
                f"{cls.__module__}.{cls.__qualname__}: a process of its own cannot import it; write it into a module "
                'or a file of its own, and create it from there, or as "FILE.py:Class"'
            )
        key = cls, text, *sorted(limits.items())
        if key not in self._stand_ins:
            self._stand_ins[key] = stand_in_of(cls, text, limits)
        return self._stand_ins[key]

    def process_of(self, component: RemoteComponent) -> Process:
        """The process of a component, which is not started yet."""
        self._delays.pop(component.name, None)
        if self._launcher is None:
            self._launcher = Launcher()
        if self._opening is None:
            self._opening = kernel_task(
                self.kernel.loop, self.kernel.service(Links).reach.carry(self._transport), "aiorts isolation"
            )
        process = Process(
            self.kernel,
            self._launcher,
            self._transport,
            component.name,
            Limits(**component.limits),
            starts=self._starts,
            ended=component.process_ended,
            line=partial(_log_line, component),
            printed=partial(self._printing.put, component),
            counted=partial(_count, component),
            holder=partial(self._holder, component.name),
        )
        self._processes[process.kernel] = process
        self._components[process] = component
        return process

    def _holder(self, name: str) -> str:
        """Names of other processes that keep this one's end waiting, and how; "" where none does."""
        delays = self._delays | {one.name: one.delay for one in self._processes.values() if one.delay}
        return "; ".join(f"{other}: {delay}" for other, delay in delays.items() if other != name)

    async def end(self, component: RemoteComponent) -> None:
        """End the process of a component; with the last process, end what starts processes, too."""
        process = next((one for one, other in self._components.items() if other is component), None)
        if process is None:
            return
        del self._components[process]
        try:
            await process.end()
        finally:
            if process.delay:
                self._delays[process.name] = process.delay
        await self._printing.flush(component)
        if self._processes.get(process.kernel) is process:
            del self._processes[process.kernel]
        if not self._components and self._launcher is not None:
            self._printing.end()
            launcher, self._launcher = self._launcher, None
            await launcher.close()

    def end_when_read(self, connector: Connector) -> None:
        """End a connector whose writer has moved, once what was written before is read."""
        self._leftover.pop(connector, None)
        if connector.closed or self.kernel.closed:
            return
        if unread_of(connector):
            look = partial(self.end_when_read, connector)
            self._leftover[connector] = self.kernel.call_later(_READ_SECONDS, look)
        else:
            self.kernel.connections.end(connector)

    def stopped(self) -> None:
        for timer in self._leftover.values():
            timer.cancel()
        self._leftover.clear()

    async def leaving(self, budget: StopBudget) -> None:
        if self._launcher is not None:
            await self._launcher.close(budget.rest)

    def _rewired(self, event: Connected | Disconnected) -> None:
        """Tell isolated components that the providers of the interfaces they call may have changed."""
        if not isinstance(event.connector, ServiceConnectorProfile):
            return
        for name in {required.partition(".")[0] for required, _ in event.connector.mapping}:
            component = self.kernel.components.get(name)
            if isinstance(component, RemoteComponent):
                task = kernel_task(self.kernel.loop, component.rewired(), f"aiorts bind {name}")
                awaited = self.kernel.service(Links).calls.awaited
                awaited.add(task)
                task.add_done_callback(awaited.discard)

    async def _reported(self, body: bytes, caller: Caller) -> bytes:
        process = None if caller.peer is None else self._processes.get(caller.peer.kernel)
        component = None if process is None else self._components.get(process)
        if component is None:
            raise LinkError("no process of this kernel")
        component.reported(Report.from_bytes(body))
        return b""


def _log_line(component: RemoteComponent, level: int, text: str) -> None:
    component.log.log(level, "%s", text)


def _count(component: RemoteComponent, counted: list[Any]) -> None:
    for context, (plain, late) in zip(component.contexts, counted, strict=False):
        if isinstance(context, RemoteContext):
            context.counted(
                from_plain(ContextStatistics, plain), None if late is None else from_plain(OverdueHook, late)
            )
