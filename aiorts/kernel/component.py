"""A component: declarations, ports that come and go, parameters, and the twelve hooks.

Logic and logical thread are separate: a component never chooses its execution context; who runs in which context and
in which order is the system's affair.
"""

from __future__ import annotations

import threading
from collections.abc import Awaitable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, overload

from aiorts.errors import DeclarationError, StateError, WiringError
from aiorts.kernel.gate import Gate
from aiorts.kernel.hooks import hook_kinds
from aiorts.kernel.host import PortHost
from aiorts.kernel.joint import between_cycles
from aiorts.kernel.log import ComponentLog, LogFields
from aiorts.kernel.parameters import Declared, Parameters
from aiorts.kernel.ports import InPort, OutPort, Port, Turns
from aiorts.model.configuration import ParameterSpec
from aiorts.model.lifecycle import LifeCycleState
from aiorts.model.names import check_name
from aiorts.model.profile import ComponentProfile

if TYPE_CHECKING:
    from aiorts.clock import Clock
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.member import Member

__all__ = ("Component", "Hook")

T = TypeVar("T")
Hook = Awaitable[None] | None
"""What a hook may return: it is `async def` or plain `def`, and the value is None."""


class Component:
    """The unit of a system. Derive from it, declare ports and parameters, write the hooks you need.

    Args:
        name: the instance's name; the kernel gives one ("pid0") where there is none.

    Every hook may be `async def` or plain `def`; the defaults do nothing.
    """

    max_instance: ClassVar[int | None] = None
    _port_declarations: ClassVar[dict[str, Port[Any]]] = {}
    _parameter_specs: ClassVar[dict[str, ParameterSpec]] = {}
    _hook_kinds: ClassVar[dict[str, int]] = {}

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls._port_declarations = dict(cls._port_declarations)
        cls._parameter_specs = dict(cls._parameter_specs)
        for attribute, value in vars(cls).items():
            if isinstance(value, Port):
                cls._declare_port(attribute, value)
            elif isinstance(value, Declared):
                cls._parameter_specs[attribute] = value.named(attribute, cls.__qualname__)
        cls._hook_kinds = hook_kinds(cls, Component)

    @classmethod
    def _declare_port(cls, attribute: str, port: Port[Any]) -> None:
        if hasattr(Component, attribute):
            raise DeclarationError(
                f"{cls.__qualname__}.{attribute}: Component has a {attribute} of its own; choose another name"
            )
        check_name(port.name or attribute, "port")
        cls._port_declarations[attribute] = port

    def __init__(self, name: str = "") -> None:
        if name:
            check_name(name, "component")
        self._host = PortHost(name or type(self).__name__.lower(), Turns())
        self._named = bool(name)
        self._kernel: Kernel | None = None
        self._members: list[Member] = []
        self._running: Member | None = None
        self._last_error: BaseException | None = None
        self._gate = Gate(self)
        self._abandoned: BaseException | None = None
        """Why it never runs again: a hook ignored every cancellation and was left behind."""
        self._finished = False
        self._log: ComponentLog | None = None
        self._params = Parameters(self._host.name, self._parameter_specs)
        for parameter in self._params.values():
            setattr(self, parameter.name, parameter.value)
        for attribute, declaration in self._port_declarations.items():
            setattr(self, attribute, self.add_port(declaration.name or attribute, declaration))

    # -- who and where ---------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """The instance's name, unique in its kernel."""
        return self._host.name

    @property
    def kernel(self) -> Kernel:
        """The kernel this component belongs to; StateError before it was added."""
        if self._kernel is None:
            raise StateError(f"{self.name}: belongs to no kernel yet; await kernel.add(...) first")
        return self._kernel

    @property
    def clock(self) -> Clock:
        """The kernel's clock."""
        return self.kernel.clock

    @property
    def context(self) -> Context:
        """The execution context that runs this hook; outside of hooks the only one; StateError where that is nobody."""
        if self._running is not None:
            return self._running.context
        if len(self._members) == 1:
            return self._members[0].context
        raise StateError(f"{self.name}: is in {len(self._members)} contexts and no hook runs; say which")

    @property
    def contexts(self) -> tuple[Context, ...]:
        """The contexts this component is in, in the order it was added."""
        return tuple(member.context for member in self._members)

    @property
    def states(self) -> Mapping[str, LifeCycleState]:
        """The life-cycle state in each context, by the context's name."""
        return MappingProxyType({member.context.name: member.state for member in self._members})

    @property
    def state(self) -> LifeCycleState | None:
        """The life-cycle state in the context at hand; None in no context."""
        if self._running is not None:
            return self._running.state
        return self._members[0].state if self._members else None

    @property
    def last_error(self) -> BaseException | None:
        """What made this component fail last, with its traceback; earlier causes are chained to it."""
        return self._last_error

    @property
    def log(self) -> ComponentLog:
        """This component's logger on stdlib logging: kernel, component, hook and tick are fields of each record."""
        if self._log is None:
            kernel = self.kernel
            self._log = ComponentLog(self._log_fields, kernel.clock.monotonic_ns, shared=kernel._log_budget)
        return self._log

    def _log_fields(self) -> LogFields:
        member = self._running
        kernel = self._kernel.name if self._kernel is not None else ""
        if member is None:
            return LogFields(kernel, self.name)
        return LogFields(kernel, self.name, member.hook, member.context.ticks)

    @property
    def profile(self) -> ComponentProfile:
        """What this component is at this moment, frozen."""
        error = self._last_error
        return ComponentProfile(
            self.name,
            type(self).__name__,
            tuple(port.profile for port in self.ports.values()),
            MappingProxyType(self._params.values_in_force),
            MappingProxyType({name: state.value for name, state in self.states.items()}),
            None if error is None else f"{type(error).__name__}: {error}",
        )

    def __repr__(self) -> str:
        states = ", ".join(f"{context}: {state}" for context, state in self.states.items())
        return f"<{type(self).__name__} {self.name} {len(self.ports)} ports{' ' + states if states else ''}>"

    def _repr_html_(self) -> str:
        from aiorts.kernel.html import component_html

        return component_html(self)

    # -- ports and parameters --------------------------------------------------------------------------------------

    @property
    def ports(self) -> Mapping[str, Port[Any]]:
        """The ports there are now, by name."""
        return MappingProxyType(self._host.ports)

    @property
    def params(self) -> Parameters:
        """The parameters, by name: value in force, default, unit, bounds."""
        return self._params

    @overload
    def add_port(self, name: str, port: InPort[T]) -> InPort[T]: ...

    @overload
    def add_port(self, name: str, port: OutPort[T]) -> OutPort[T]: ...

    @overload
    def add_port(self, name: str, port: Port[Any]) -> Port[Any]: ...

    def add_port(self, name: str, port: Port[Any]) -> Port[Any]:
        """A live port made after the declaration `port`, at any time; announced on the bus.

        Raises:
            InvalidNameError: the name is not allowed. WiringError: there is one of that name already.
            DeclarationError: a value of the port's type cannot travel.
        """
        if self._kernel is not None:
            self._kernel.check_thread(f"{self.name}.add_port")
        check_name(name, "port")
        if name in self._host.ports:
            raise WiringError(f"{self.name}.{name}: there is a port of that name already")
        if not isinstance(port, InPort | OutPort):
            raise DeclarationError(f"{self.name}.{name}: expected InPort(...) or OutPort(...), got {port!r}")
        bound: InPort[Any] | OutPort[Any] = port.bind(self._host, name)
        self._host.ports[name] = bound
        if self._kernel is not None:
            self._kernel._roster.port_added(self, bound)
        return bound

    def remove_port(self, name: str) -> None:
        """Take a port away: its connectors are disconnected, a read that waits on it ends with ClosedError.

        Raises:
            WiringError: there is no such port.
        """
        if self._kernel is not None:
            self._kernel.check_thread(f"{self.name}.remove_port")
        port = self._host.ports.get(name)
        if port is None:
            raise WiringError(f"{self.name}.{name}: no such port; there are {', '.join(self._host.ports) or 'none'}")
        if self._kernel is not None:
            for connector in port.connectors:
                self._kernel._connections.end(connector)
        del self._host.ports[name]
        if isinstance(port, InPort):
            port._wake_waiter()
        if self._kernel is not None:
            self._kernel._roster.port_removed(self, port)

    async def configure(self, **changes: object) -> None:
        """Change parameters: all of them between two cycles, or, when any value is bad, none.

        Called from a hook of this component it is queued and returns at once.

        Raises:
            ConfigurationError: names every change that was refused; the old values stay.
            TransitionTimeout: no cycle ended within 5 s; the old values stay.
        """
        if self._kernel is not None:
            self._kernel.check_thread(f"{self.name}.configure")
        checked = self._params.check(changes)
        if self._kernel is None:
            self._put(checked)
        else:
            await between_cycles(self._kernel, self, lambda: self._put(checked))

    def _put(self, checked: Mapping[str, Any]) -> None:
        self._params._put(checked)
        for name, value in checked.items():
            setattr(self, name, value)
        if self._kernel is not None and checked:
            self._kernel._roster.parameters_changed(self, checked)

    # -- what a hook may ask for -----------------------------------------------------------------------------------

    def finish(self) -> None:
        """Say that this source has nothing more: it is deactivated after this cycle."""
        if self._kernel is not None and self._host.thread_id != threading.get_ident():
            self._kernel.check_thread(f"{self.name}.finish")
        self._finished = True
        if self._running is not None:
            self._running.finish()
            return
        for member in self._members:
            member.finish()

    async def sleep(self, seconds: float) -> None:
        """Wait on the kernel's clock; ValueError for NaN and infinities."""
        await self.kernel.sleep(seconds)

    # -- the hooks -------------------------------------------------------------------------------------------------

    def on_initialize(self) -> Hook:
        """Once, when the component is created. Raising means that it is not created."""
        return _nothing()

    def on_finalize(self) -> Hook:
        """Once, when the component is removed."""
        return _nothing()

    def on_startup(self) -> Hook:
        """The execution context starts, or the component is added to a running one."""
        return _nothing()

    def on_shutdown(self) -> Hook:
        """The execution context stops, or the component leaves it."""
        return _nothing()

    def on_activated(self) -> Hook:
        """On the way from inactive to active."""
        return _nothing()

    def on_deactivated(self) -> Hook:
        """On the way out of active, also through a failure; the in-ports are closed already."""
        return _nothing()

    def on_execute(self) -> Hook:
        """One tick of the execution context, while active."""
        return _nothing()

    def on_state_update(self) -> Hook:
        """After every member's `on_execute` of the same cycle, while active."""
        return _nothing()

    def on_rate_changed(self) -> Hook:
        """The execution context has another rate."""
        return _nothing()

    def on_aborting(self, error: BaseException) -> Hook:
        """On the way into error, with what went wrong."""
        return _nothing()

    def on_error(self, error: BaseException) -> Hook:
        """Each cycle while in error, with what went wrong."""
        return _nothing()

    def on_reset(self) -> Hook:
        """On the way from error to inactive. Raising means that the component stays in error."""
        return _nothing()

    # -- called by the kernel --------------------------------------------------------------------------------------

    def _rename(self, name: str) -> None:
        self._host.name = name
        self._params._rename(name)
        self._named = True


def _nothing() -> Hook:
    """What a hook that nobody wrote returns: super().on_x() can be awaited all the same."""
    return _DONE


Component._hook_kinds = hook_kinds(Component, Component)


class _Done:
    """An awaitable that is done, any number of times."""

    def __await__(self) -> Any:
        return iter(())


_DONE = _Done()
