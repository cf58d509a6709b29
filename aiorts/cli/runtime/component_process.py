"""The process of one component: a kernel that its starting kernel operates over a socket.

The process has no socket that others can find, and ends when the socket to its starting kernel closes.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import io
import logging
import socket
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, Final

from aiorts.assembly import Kernel
from aiorts.control import Right, Session
from aiorts.control.operations import operations_of
from aiorts.errors import AiortsError, ComponentError, LinkError, format_error
from aiorts.isolation import (
    MARK,
    OPERATE,
    REPORT,
    First,
    Report,
    asked,
    described,
    done,
    give_state,
    hold,
    packed,
    refused,
    release,
    state_of,
    taken,
)
from aiorts.kernel.component import Component
from aiorts.kernel.execution.context import Context
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.loop.bus import PortAdded, PortRemoved, StateChanged
from aiorts.kernel.loop.deadlines import StopBudget
from aiorts.kernel.ports import InPort
from aiorts.links import Caller, Links, Peer, UnixTransport
from aiorts.model.lifecycle import LifecycleState, OverdueHook
from aiorts.model.reading import from_plain
from aiorts.processes import DESCRIPTOR, limit_memory
from aiorts.running import run
from aiorts.services import ServiceConnector, ServicePort

_REPORT_SECONDS: Final = 5.0
_ASKED: Final = operations_of("components", "configuration", "contexts", "lifecycle")
"""The operations that every process needs; importing the whole table would delay its start."""


def main() -> None:
    """Serve the kernel at the other end of the socket until that ends. `prepare` was called before."""
    sock = socket.socket(fileno=DESCRIPTOR)
    first = First.receive(sock)
    sys.path[:] = first.path
    _log_to_stderr(first.log_level)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)  # prints are seen at once, even if it crashes next
    run(_Process(first, sock).serve(), loop=first.loop)


class _Process:
    """The kernel of one component."""

    def __init__(self, first: First, sock: socket.socket) -> None:
        self._first, self._socket = first, sock
        self._transport = UnixTransport(listens=False)
        self._transport.program = bytes.fromhex(first.program)
        self._over = asyncio.Event()
        self._parent: Peer | None = None
        self._told = False
        """Whether the kernel that started this process has asked for the ports: then changes are reported to it."""
        self._reports: set[asyncio.Task[None]] = set()
        self._own: dict[str, Callable[..., Awaitable[Any]]] = {
            "bind": self._bind,
            "configure": self._configure,
            "hold": self._hold,
            "state": self._state,
            "unread": self._unread,
            "give": self._give,
            "retire": self._retire,
        }
        """The operations that the control table lacks, or carries out otherwise."""

    async def serve(self) -> None:
        first = self._first
        plugins = Catalogue(folders=tuple(map(Path, first.plugins)))
        async with Kernel(first.kernel, plugins=plugins, contain_interrupts=True) as kernel:
            self._kernel = kernel
            self._session = Session(kernel, Right.CODE, "the kernel that started this process", _unsent)
            self._links = kernel.service(Links)
            self._links.use(self._transport)
            self._transport.answer(OPERATE, self._operate)
            await self._links.opened()
            self._links.expect(first.component)
            self._transport.presence(self._present)
            kernel.bus.subscribe(StateChanged, self._changed)
            kernel.bus.subscribe(PortAdded, self._ports_changed)
            kernel.bus.subscribe(PortRemoved, self._ports_changed)
            greeted = self._transport.take(self._socket).greeted
            greeted.add_done_callback(self._is_greeted)
            await self._over.wait()
            self._session.end()

    def _is_greeted(self, _: asyncio.Future[None]) -> None:
        if self._parent is None:  # the connection ended before the other kernel said hello
            self._over.set()

    def _present(self, peer: Peer, up: bool) -> None:
        self._parent = peer
        if not up:
            self._over.set()

    async def _operate(self, body: bytes, caller: Caller) -> bytes:
        name, given = asked(body)
        try:
            if name == "end":
                self._over.set()
                return done(None)
            if name == "ping":
                return done([(one.statistics, _overdue(one)) for one in self._kernel.contexts.values()])
            if name == "ports":
                self._told = True
                return done(described(self._kernel.components[self._first.component]))
            own = self._own.get(name)
            return done(await (self._run(name, given) if own is None else own(**given)))
        except AiortsError as error:
            return refused(error)
        except Exception as error:  # noqa: BLE001 - a hook of the component may raise any exception
            return refused(ComponentError(format_error(error)))

    async def _run(self, name: str, given: dict[str, Any]) -> Any:
        if (operation := _ASKED.get(name)) is None:
            from aiorts.control.operations import OPERATIONS  # late: few are asked for another one

            operation = OPERATIONS[name]
        with self._links.making() if name == "create" and self._first.awaited else contextlib.nullcontext():
            value = operation.run(self._session, from_plain(operation.arguments, given))
            if inspect.isawaitable(value):
                value = await value
        if name == "create" and self._first.memory is not None:
            limit_memory(self._first.memory)
        return value

    async def _configure(self, **given: Any) -> list[list[Any]]:
        """Put parameters in force; returns the ports of the component, so that a busy process is asked only once."""
        await self._run("configure", given)
        return described(self._component)

    async def _bind(self, required: str, provided: str) -> str:
        """Connect an interface that the component requires; returns the connector's name."""
        made: ServiceConnector
        component = self._component
        ends = [end for port in component.ports.values() if isinstance(port, ServicePort) for end in port.interfaces]
        made = await self._kernel.connect(next(end for end in ends if end.path == required), provided)
        return made.name

    @property
    def _component(self) -> Component:
        return self._kernel.components[self._first.component]

    async def _hold(self, holds: bool) -> None:
        """Make the in-ports take samples in any state of the component, or only in their usual states again."""
        (hold if holds else release)(self._component)

    async def _state(self) -> dict[str, Any]:
        """The attributes of the component, for its next instance."""
        return state_of(self._component)

    async def _unread(self) -> list[Any]:
        """Take out the unread samples; returns them by in-port and writer."""
        ports = [port for port in self._component.ports.values() if isinstance(port, InPort)]
        return [
            [port.name, str(getattr(one.out, "far", "")), [packed(sample, port.path) for sample in taken(one)]]
            for port in ports
            for one in port.connectors
        ]

    async def _give(self, state: dict[str, Any]) -> None:
        """Set these attributes of the component."""
        await give_state(self._kernel, self._component, state)

    async def _retire(self, context: str) -> None:
        """End the members: they first read all unread samples, and their last samples have arrived on return."""
        runner, budget = self._kernel.contexts[context].runner, StopBudget(self._kernel.loop)
        await runner.retire(tuple(runner.members), budget)
        await self._links.ends.sent(self._kernel.connectors.values(), budget.rest)

    def _changed(self, event: StateChanged) -> None:
        component = self._kernel.components.get(event.component)
        if component is None or component.name != self._first.component:
            return
        error = component.last_error if event.new is LifecycleState.ERROR else None
        report = Report(event.new.value, component.has_finished, "" if error is None else format_error(error))
        self._send(report)

    def _ports_changed(self, event: PortAdded | PortRemoved) -> None:
        if self._told and event.component == self._first.component:
            component = self._kernel.components[event.component]
            self._send(Report("", finished=False, error="", ports=described(component)))

    def _send(self, report: Report) -> None:
        task = self._links.run(self._report(report), "aiorts report")
        self._reports.add(task)
        task.add_done_callback(self._reports.discard)

    async def _report(self, report: Report) -> None:
        if self._parent is None:
            return
        try:
            await self._links.ask(self._parent, REPORT, report.to_bytes(), _REPORT_SECONDS)
        except LinkError as error:
            logging.getLogger(__name__).warning("%s: not reported: %s", report.state, error)


def _overdue(context: Context) -> OverdueHook | None:
    """The hook of the context's member that runs longer than its deadline."""
    return next(filter(None, map(context._overdue, context.runner.members)), None)


def _unsent(_message: object, _sent: object) -> None:
    """Send nothing: no operation of this session streams."""


def _log_to_stderr(level: int) -> None:
    handler = logging.StreamHandler()
    handler.setFormatter(_Marked())
    logging.basicConfig(level=level, handlers=[handler], force=True)


class _Marked(logging.Formatter):
    """One line for each line of a record, with its level."""

    def format(self, record: logging.LogRecord) -> str:
        head = f"{MARK}{record.levelno} "
        return "\n".join(head + line for line in super().format(record).split("\n"))
