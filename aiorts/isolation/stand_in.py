"""The stand-in of a kernel for a component that runs in a process of its own.

It is a component of this kernel like any other: it has the ports and parameters that the class declares, is in one
context, and its hooks ask the process to do the same. No code of the class runs here, and none of its other attributes
are here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.errors import ComponentError, DeclarationError, ProcessError, StateError
from aiorts.isolation.placing import RemoteContext, placed
from aiorts.isolation.ports import fail, follow
from aiorts.isolation.process import text_of
from aiorts.isolation.services import RemoteServices, remote_end
from aiorts.kernel.component import Component, Elsewhere
from aiorts.kernel.declarations import Kind, declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.parameters import Declared
from aiorts.kernel.ports import InPort, OutPort, PortDeclaration
from aiorts.kernel.ports.far import RemoteInPort, RemoteOutPort
from aiorts.links import Links
from aiorts.model.lifecycle import LifecycleState
from aiorts.services import ServiceEnd, ServicePort

if TYPE_CHECKING:
    from aiorts.isolation.messages import Report
    from aiorts.isolation.process import Process
    from aiorts.model.configuration.sets import ConfigurationState

_LINKED: Final = 2.0
"""Seconds that an activation waits for the links of its out-ports."""


class RemoteKind(Kind):
    """Passes on changes of parameters before they are in force; says in which context the component is started."""

    def placed(self, component: Any, context: Any, components: Sequence[Any]) -> Any:
        return placed(context, components)

    def keeps_code(self, component: Any) -> str:
        return "it runs in a process of its own; remove it, and create it anew"

    async def configuring(self, component: RemoteComponent, state: ConfigurationState) -> None:
        process = component._process
        if process is not None and process.runs and not component.kernel.registry.is_arriving(component):
            ports = await process.ask("configure", component=component.name, values={"": dict(state.values)})
            follow(component, ports, process.kernel)


class RemoteComponent(Component, Elsewhere, kind=RemoteKind()):
    """A component that runs in a process of its own, as its kernel sees it. `Kernel.create_isolated` makes it."""

    original: ClassVar[type[Component]]
    """The class whose code runs in the process."""
    type_text: ClassVar[str]
    """The text by which the process finds that class."""
    limits: ClassVar[Mapping[str, Any]]
    """The limits of its process."""
    _process: Process | None = None
    _services: RemoteServices | None = None
    before: Mapping[str, Mapping[str, Any]] = MappingProxyType({})
    """The options of connectors that were made before it was moved into its process, by name."""
    _there = LifecycleState.INACTIVE
    """The state that the process has reported last."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        raise self._not_here(name)

    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith("_") and not hasattr(type(self), name):
            raise self._not_here(name)
        super().__setattr__(name, value)

    def _not_here(self, name: str) -> AttributeError:
        return AttributeError(
            f"{self.name}.{name}: {type(self).__name__} runs in a process of its own: here are its ports, parameters "
            "and lifecycle, and no other attribute",
            name=name,
            obj=self,
        )

    @property
    def pid(self) -> int | None:
        """The number of its process; None before it was started."""
        return None if self._process is None else self._process.pid

    @property
    def busy(self) -> float:
        """Seconds for which a hook has held its process; 0 while it answers."""
        return 0.0 if self._process is None else self._process.busy

    # -- the process -----------------------------------------------------------------------------------------------

    async def on_initialize(self) -> None:
        from aiorts.isolation.isolating import Isolation  # late: that knows this class

        isolation = self.kernel.service(Isolation)
        self._process = isolation.process_of(self)
        if any(isinstance(port, ServicePort) for port in self.ports.values()):
            self._services = RemoteServices(self)
        try:
            await self._begin()
        except BaseException:
            await isolation.end(self)
            raise

    async def rewired(self) -> None:
        """Handle a change of the providers of its required interfaces."""
        if self._services is not None and self._running.runs:
            await self._services.bind(self._running)

    async def on_finalize(self) -> None:
        from aiorts.isolation.isolating import Isolation  # late: that knows this class

        if self._services is not None:
            self._services.end()
        await self.kernel.service(Isolation).end(self)

    async def _begin(self) -> None:
        state, declared = cell(self).configuration, declarations(type(self)).configuration
        params = {name: value for name, value in state.values.items() if value != declared.values.get(name)}
        self._there = LifecycleState.INACTIVE
        await self._running.start(self.type_text, params)
        await self._follow()
        if self._services is not None:
            await self._services.begin(self._running)

    async def _follow(self) -> None:
        """Give the stand-in the ports that the component has in the process."""
        follow(self, await self._running.ask("ports"), self._running.kernel)

    @property
    def _running(self) -> Process:
        if self._process is None:
            raise StateError(f"{self.name}: has no process yet; await kernel.add(...) first")
        return self._process

    def process_ended(self, how: str, last_lines: Sequence[str]) -> None:
        """Note that its process has ended without being asked to."""
        lines = "".join(f"\n  {text_of(line)}" for line in last_lines[-3:])
        self._there = LifecycleState.ERROR
        self._fail(ProcessError(f"{self.name}: its process has ended: {how}{lines}"))

    def unprinted(self, error: Exception) -> None:
        """Fail the component, as standard output takes nothing that it prints, and end its process."""
        if self._there is not LifecycleState.ERROR:
            self._there = LifecycleState.ERROR
            self.kernel.service(Links).run(self._end_with(error), f"aiorts end {self.name}")

    async def _end_with(self, error: Exception) -> None:
        await self._running.end()
        self._fail(error)

    def reported(self, report: Report) -> None:
        """Handle a report of the process on the component."""
        if report.ports is not None:
            follow(self, report.ports, self._running.kernel)
            return
        self._there = LifecycleState(report.state)
        if self._there is LifecycleState.ERROR:
            self._fail(ComponentError(f"{self.name}: {report.error}"))
        elif report.finished and self.state is LifecycleState.ACTIVE:
            self.finish()

    def _fail(self, error: Exception) -> None:
        fail(self, error)

    async def ask(self, operation: str, **arguments: Any) -> Any:
        """The answer of its process. ProcessError: there is none. AiortsError: the error that refused it."""
        return await self._running.ask(operation, **arguments)

    # -- its context -----------------------------------------------------------------------------------------------

    async def on_startup(self) -> None:
        context = self.context
        if not isinstance(context, RemoteContext):
            raise StateError(f"{self.name}: runs in a process of its own, and {context.name} in that of its kernel")
        if not self._running.runs:
            await self._begin()
        self._running.deadline = context.given.deadline
        await self._running.ask("start_context", members=[self.name], **context.as_started())

    async def on_shutdown(self) -> None:
        if self._running.runs:
            await self._running.ask("stop_context", context=self.context.name)

    async def on_activated(self) -> None:
        # What a new process wrote before its links are made again would have no connector that counts it.
        connectors = [one for port in self.ports.values() for one in port.connectors]
        await self.kernel.service(Links).up(connectors, _LINKED)
        await self._ask("activate")

    async def on_deactivated(self) -> None:
        if self._running.runs and self._there is LifecycleState.ACTIVE:
            try:
                await (self._retire() if self.kernel.closed else self._ask("deactivate"))
            except ProcessError as error:
                if self._running.runs:  # else its end is its failure
                    self._fail(error)  # whether it still runs there is not known
                raise

    async def _retire(self) -> None:
        """End the component in the process, after it has received and read all samples written to it before."""
        connectors = [one for port in self.ports.values() for one in port.connectors]
        await self.kernel.service(Links).ends.sent(connectors)
        await self._running.ask("retire", context=self.context.name)

    async def on_reset(self) -> None:
        if self._running.runs:
            if self._there is LifecycleState.ERROR:
                await self._ask("reset")
            elif self._there is LifecycleState.ACTIVE:  # it has not answered when it was to be activated or deactivated
                await self._ask("deactivate")
            return
        await self.on_startup()

    async def on_rate_changed(self) -> None:
        await self._running.ask("set_rate", context=self.context.name, rate=self.context.rate)

    async def _ask(self, operation: str) -> None:
        await self._running.ask(operation, component=self.name, context=self.context.name)


def stand_in_of(cls: type[Component], text: str, limits: Mapping[str, Any]) -> type[RemoteComponent]:
    """The class of stand-ins for components of `cls`, a class that a process finds by `text`.

    Raises:
        DeclarationError: it has what cannot be used across processes.
    """
    body: dict[str, Any] = {"original": cls, "type_text": text, "limits": MappingProxyType(dict(limits))}
    body["configurations"], body["on_link_lost"] = cls.configurations, cls.on_link_lost
    for attribute, port in declarations(cls).ports.items():
        body[attribute] = _remote_port(cls, attribute, port)
    for base in reversed(cls.__mro__):
        body |= {name: value for name, value in vars(base).items() if isinstance(value, Declared)}
    body |= {"__module__": cls.__module__, "__qualname__": cls.__qualname__, "__doc__": cls.__doc__}
    return type(cls.__name__, (RemoteComponent,), body)


def _remote_port(cls: type[Component], attribute: str, port: Any) -> PortDeclaration:
    if isinstance(port, ServiceEnd):
        return remote_end(cls.__qualname__, attribute, port)
    if not isinstance(port, InPort | OutPort):
        raise DeclarationError(
            f"{cls.__qualname__}.{attribute}: a {type(port).__name__} cannot be used from another process"
        )
    alike: dict[str, Any] = {"unit": port.unit, "shape": port.shape, "doc": port.doc, "name": port.name or None}
    alike["max_connectors"] = port.max_connectors
    if isinstance(port, InPort):
        return RemoteInPort(port.type, length=port.length, **alike)
    return RemoteOutPort(port.type, **alike)
