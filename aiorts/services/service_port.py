"""A service port, and the common part of its ends: declared, bound, described, waited for; nothing is called here.

One port has one interface or, where several name the same `port=`, any number.
"""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeAlias, TypeVar

from aiorts.errors import ClosedError, DeclarationError, WiringError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.ports.port import Connecting, Port, PortDeclaration
from aiorts.model.names import check_name
from aiorts.model.profile import InterfaceProfile, PortProfile
from aiorts.services.tallies import Tally

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.connection import Connection
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.host import PortHost
    from aiorts.model.interface import Interface
    from aiorts.model.service_profile import ServiceConnectorProfile, ServiceStatistics
    from aiorts.services.service_wiring import Link

I = TypeVar("I")  # noqa: E741 - an interface
E = TypeVar("E", bound="ServiceEnd[Any]")


class Keeper(Protocol):
    """The keeper of running goals."""

    def leaves(self, end: ServiceEnd[Any]) -> None:
        """Take note that the component of this interface is about to go."""

    def disconnected(self, link: Link) -> None:
        """Take note that a connection has ended."""


class ServicePort(Port[Any]):
    """One port of a component with the interfaces that belong to it; `component.ports` has it under its name."""

    __slots__ = ("_cell", "_component", "_ends", "_services", "_waiting")

    direction: ClassVar[str] = "service"

    def __init__(self, component: Component, name: str) -> None:
        super().__init__(object, name=name)
        self._component = component
        self._host = self._cell = cell(component)  # every call looks into it
        self._ends: dict[str, ServiceEnd[Any]] = {}
        self._services: tuple[ServiceConnector, ...] = ()
        self._waiting: list[asyncio.Future[None]] = []

    @property
    def interfaces(self) -> tuple[ServiceEnd[Any], ...]:
        """Its provided and required interfaces, in the order they were declared."""
        return tuple(self._ends.values())

    @property
    def connectors(self) -> tuple[ServiceConnector, ...]:  # type: ignore[override]
        """The live service connectors, in order of connection."""
        return self._services

    @property
    def is_bound(self) -> bool:
        """Whether every required interface of this port has its provider."""
        return all(end._links for end in self._ends.values() if end.polarity == "required")

    async def wait_bound(self) -> None:
        """Wait until every required interface of this port has its provider; ClosedError when the port is removed."""
        await self._until(lambda: self.is_bound)

    @property
    def profile(self) -> PortProfile:
        return PortProfile(
            self.name,
            self.direction,
            ", ".join(end.spec.name for end in self._ends.values()),
            doc=self.doc,
            connectors=tuple(connector.name for connector in self._services),
            interfaces=tuple(end.profile for end in self._ends.values()),
        )

    def __repr__(self) -> str:
        ends = ", ".join(f"{end.polarity} {end.spec.name}" for end in self._ends.values())
        return f"<ServicePort {self.path} {ends} {len(self._services)} connectors>"

    async def _until(self, ready: Callable[[], bool]) -> None:
        host = self._bound()
        host.check_loop_thread(f"{self.path}.wait_bound()")
        self._raise_if_removed()
        while not ready():
            changed: asyncio.Future[None] = host.loop.create_future()
            self._waiting.append(changed)
            try:
                await changed
            finally:
                if changed in self._waiting:
                    self._waiting.remove(changed)
            self._raise_if_removed()

    def _changed(self) -> None:
        """Wake waiting tasks: interfaces were bound or set free, or the port is removed."""
        waiting, self._waiting = self._waiting, []
        for changed in waiting:
            if not changed.done():
                changed.set_result(None)

    def _wake_waiter(self) -> None:
        self._changed()

    def _vacate(self, leaving: bool = True) -> None:
        """End calls in progress and begin no other, since the component is about to go; False begins calls again."""
        for end in self._ends.values():
            end._vacant = leaving
            for link in end._links if leaving and end.polarity == "provided" else ():
                link.end_calls("its component is being removed")
            if leaving and end._goals is not None:
                end._goals.leaves(end)

    def _give_up_blocking(self) -> None:
        from aiorts.services.service_thread import give_up_waiting  # late: few threads call services

        give_up_waiting(self)

    def _unanswerable(self) -> Iterator[str]:
        return (name for end in self._ends.values() for name in end._unanswerable())

    @property
    def connecting(self) -> Connecting:
        return service_connecting()

    def _refresh(self) -> None:
        """Do nothing: there is no path to choose."""


class ServiceEnd(PortDeclaration, Generic[I]):
    """One interface of a service port: in a class body a declaration, on an instance the live end."""

    __slots__ = (
        "_attribute",
        "_blocked",
        "_goals",
        "_interface",
        "_links",
        "_port",
        "_tally",
        "_vacant",
        "doc",
        "instance",
        "max_connectors",
        "name",
    )

    polarity: ClassVar[str] = ""

    if not TYPE_CHECKING:

        def __class_getitem__(cls, interface: Any) -> Any:
            """Make `Required[Brake]` a callable: the interface has to be known when the declaration is made."""
            if interface is Any or isinstance(interface, TypeVar):
                return super().__class_getitem__(interface)
            return _Of(cls, interface)

    def __init__(self, port: str, instance: str, doc: str, max_connectors: int | None) -> None:
        if not hasattr(self, "_interface"):
            kind = type(self).__name__
            raise DeclarationError(f"{kind}(...): say which interface, such as {kind}[Brake]()")
        self._interface: tuple[Any, Interface]
        self.name = port
        self.instance = instance
        self.doc = doc
        self.max_connectors = max_connectors
        self._attribute = ""
        self._port: ServicePort | None = None
        self._links: tuple[Link, ...] = ()
        self._tally = Tally()
        """The tally of calls over links that have ended, and of calls without a link."""
        self._blocked: set[Any] = set()
        """The calls that threads of its component block for."""
        self._goals: Keeper | None = None
        """The keeper of the interface's goals, from its first connection on, where a method answers with a goal."""
        self._vacant = False
        """Whether its component is about to go."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._attribute = name

    @property
    def interface(self) -> type[I]:
        """The Protocol of the interface."""
        protocol: type[I] = self._interface[0]
        return protocol

    @property
    def spec(self) -> Interface:
        """The methods of the interface."""
        return self._interface[1]

    @property
    def port(self) -> ServicePort:
        """The port this belongs to; ClosedError for a declaration."""
        if self._port is None:
            raise ClosedError(
                f"{self.instance or type(self).__name__}: this interface belongs to no component; "
                "was super().__init__() called in the component's __init__?"
            )
        return self._port

    @property
    def path(self) -> str:
        """`component.port`, with `.interface` where the port has another name; the bare name of a declaration."""
        if self._port is None:
            return self.instance or self._attribute
        path = self._port.path
        return path if self.instance == self._port.name else f"{path}.{self.instance}"

    @property
    def connectors(self) -> tuple[ServiceConnector, ...]:
        """The live connectors over which this interface is bound."""
        return tuple(dict.fromkeys(link.connector for link in self._links))

    @property
    def statistics(self) -> ServiceStatistics:
        """The calls through this interface so far."""
        whole = Tally()
        for tally in (self._tally, *(link.tally for link in self._links)):
            whole.take_over(tally)
        return whole.statistics

    @property
    def profile(self) -> InterfaceProfile:
        """A description of this interface, with the ends that it is bound to, as plain data."""
        spec = self.spec
        methods = tuple(method.profile for method in spec.methods.values())
        return InterfaceProfile(
            self.instance, self.polarity, spec.name, methods, self._bound_to(), self.doc or spec.doc
        )

    def declared_profile(self, attribute: str, ports: Mapping[str, PortProfile]) -> PortProfile:
        """The profile of the port with this interface: those that share a service port are one port."""
        name = self.name or attribute
        one = replace(self.profile, name=self.instance or (attribute if self.name else "") or name)
        port = ports.get(name, PortProfile(name, "service", "", doc=one.doc))
        kinds = ", ".join((*filter(None, (port.type,)), one.type))
        return replace(port, type=kinds, interfaces=(*port.interfaces, one))

    def add_to(self: E, component: Component, host: PortHost, name: str) -> E:
        """Add the live interface to the port of that name; the first interface makes the port."""
        ports = host.ports
        known = ports.get(name)
        instance = self.instance or (self._attribute if self.name else "") or name
        if known is not None and (not isinstance(known, ServicePort) or instance in known._ends):
            raise WiringError(f"{component.name}.{name}: there is a port of that name already")
        check_name(instance, "port")
        end = self._copy()
        end.name, end.instance = name, instance
        end._port = port = known if isinstance(known, ServicePort) else ServicePort(component, name)
        port._ends[instance] = end
        port.max_connectors = end.max_connectors if end.max_connectors is not None else port.max_connectors
        port.doc = port.doc or end.doc or end.spec.doc
        ports[name] = port
        end._enter_port(component)
        return end

    @property
    def connecting(self) -> Connecting:
        return service_connecting()

    def _enter_port(self, component: Component) -> None:
        """Prepare the component for the live interface; by default there is nothing to do."""

    def _unanswerable(self) -> Iterator[str]:
        """The provided methods that a thread cannot run: `async def`, and not run on the loop."""
        return iter(())

    def _bound_to(self) -> tuple[str, ...]:
        raise NotImplementedError

    def __repr__(self) -> str:
        bound = "unbound" if self._port is None else f"{len(self._links)} bound"
        return f"<{type(self).__name__}[{self.spec.name}] {self.path or '?'} {bound}>"

    @property
    def _kernel(self) -> Microkernel:
        return self.port._component.kernel

    def _copy(self: E) -> E:
        """A copy of the declaration, bound to nothing yet."""
        again = copy.copy(self)
        again._port, again._links, again._tally = None, (), Tally()
        again._blocked, again._vacant, again._goals = set(), False, None
        return again


class _Of:
    """`Required[Brake]`: called, it makes the declaration."""

    __slots__ = ("_interface", "_kind")

    def __init__(self, kind: type[ServiceEnd[Any]], interface: Any) -> None:
        self._kind = kind
        self._interface = interface

    def __call__(self, *args: Any, **options: Any) -> ServiceEnd[Any]:
        from aiorts.model.interface import read_interface, spelled  # late: most components have no services

        interface = read_interface(self._interface)
        for method in interface.methods.values():
            if "Goal" in spelled(method.returns):
                from aiorts.services.service_arguments import goal_types  # late: most services have no goals

                goal_types(method.returns, f"{interface.name}.{method.name}")
        end = self._kind.__new__(self._kind)
        end._interface = self._interface, interface
        end.__init__(*args, **options)  # type: ignore[misc] # as the class would, once it knows the interface
        return end

    def __repr__(self) -> str:
        return f"{self._kind.__name__}[{getattr(self._interface, '__name__', self._interface)}]"


class ServiceConnector:
    """One live connection of two service ports."""

    def __init__(self, profile: ServiceConnectorProfile, ports: tuple[ServicePort, ServicePort]) -> None:
        self.profile = profile
        self.ports = ports
        self.closed = False
        self.links: tuple[Link, ...] = ()
        """The links: a required and a provided end each, with the calls over them."""

    @property
    def name(self) -> str:
        """The name of the connector, unique in its kernel."""
        return self.profile.name

    @property
    def statistics(self) -> ServiceStatistics:
        """The calls over this connector so far."""
        whole = Tally()
        for link in self.links:
            whole.take_over(link.tally)
        return whole.statistics

    def __repr__(self) -> str:
        pairs = ", ".join(f"{required} -> {provided}" for required, provided in self.profile.mapping)
        return f"<ServiceConnector {self.name} {pairs}{' closed' if self.closed else ''}>"

    def _close(self) -> None:
        self.closed = True
        for link in self.links:
            link.closed = True
            for end in (link.required, link.provided):
                end._tally.take_over(link.tally)
            link.required._links = tuple(other for other in link.required._links if other is not link)
            link.provided._links = tuple(other for other in link.provided._links if other is not link)
            link.end_calls("was disconnected")
            if link.provided._goals is not None:
                link.provided._goals.disconnected(link)
        for port in self.ports:
            port._services = tuple(other for other in port._services if other is not self)


Service: TypeAlias = ServicePort | ServiceEnd[Any]
"""The parts of services that can be connected: a port with all its interfaces, or a single interface."""


Made: TypeAlias = "Connection[ServiceConnector]"


def service_connecting() -> Connecting:
    """The module that connects service ports."""
    from aiorts.services import service_wiring  # late: most systems have no services

    return service_wiring


def is_service(port: object) -> bool:
    """Whether this is an end of a service."""
    return isinstance(port, ServicePort | ServiceEnd)
