"""A component: declarations, ports that come and go, parameters, and the twelve hooks.

Logic and logical thread are separate: a component never chooses its execution context; who runs in which context and
in which order is the system's affair.
"""

from __future__ import annotations

import threading
from collections.abc import Awaitable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar, overload

from aiorts.errors import DeclarationError, StateError, WiringError, said
from aiorts.kernel.configuring import OVERRIDABLE, Configurable, declared_state
from aiorts.kernel.gate import Gate
from aiorts.kernel.hooks import check_spelling, hook_kinds
from aiorts.kernel.host import PortHost
from aiorts.kernel.log import ComponentLog, LogFields
from aiorts.kernel.parameters import Declared, Parameters
from aiorts.kernel.ports import InPort, OutPort, Port, Provided, Required, ServiceEnd, ServicePort, Turns
from aiorts.kernel.service_ends import add_end, check_declared
from aiorts.model.configuration import ParameterSpec
from aiorts.model.lifecycle import HOOKS, LifeCycleState
from aiorts.model.names import check_name
from aiorts.model.profile import ComponentProfile

if TYPE_CHECKING:
    from aiorts.clock import Clock
    from aiorts.kernel.composed import Composed
    from aiorts.kernel.context import Context
    from aiorts.kernel.heir import Heir
    from aiorts.kernel.homes import Home
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.member import Member
    from aiorts.kernel.service_visit import Visit

__all__ = ("Component", "Hook")

T = TypeVar("T")
Hook = Awaitable[None] | None
"""What a hook may return: it is `async def` or plain `def`, and the value is None."""


class Component(Configurable):
    """The unit of a system. Derive from it, declare ports and parameters, write the hooks you need.

    Every private name of this class begins with `_rt_`: `self._log` or `self._members` are yours.

    Args:
        name: the instance's name; the kernel gives one ("pid0") where there is none.

    Every hook may be `async def` or plain `def`; the defaults do nothing.
    """

    max_instance: ClassVar[int | None] = None
    _rt_port_declarations: ClassVar[dict[str, Port[Any] | ServiceEnd[Any]]] = {}
    _rt_parameter_specs: ClassVar[dict[str, ParameterSpec]] = {}
    _rt_hook_kinds: ClassVar[dict[str, int]] = {}
    # What few instances ever have stands in the class until then: an instance without it is smaller.
    _rt_last_error: BaseException | None = None
    _rt_abandoned: BaseException | None = None
    """Why it never runs again: a hook ignored every cancellation and was left behind."""
    _rt_failed_in: tuple[Member, str] | None = None
    """The hook whose failure is being logged."""
    _rt_log: ComponentLog | None = None
    _rt_deadlines: Mapping[str, float] | None = None
    """Seconds that single hooks may take; see `Kernel.supervise`."""
    _rt_composes: ClassVar[bool] = False
    """Whether it stands for others: `kernel/composite.py`."""
    _rt_composite: Composed | None = None
    _rt_homes: tuple[Home, ...] = ()
    """Where it ran before it ran with that composite."""
    _rt_heir: Heir | None = None
    """While it is made to take another one's place: what it takes over."""

    def __init_subclass__(cls, *, _rt_redefines: frozenset[str] = frozenset(), **options: Any) -> None:
        super().__init_subclass__(**options)
        cls._rt_port_declarations = dict(cls._rt_port_declarations)
        cls._rt_parameter_specs = dict(cls._rt_parameter_specs)
        for attribute, value in vars(cls).items():
            if attribute in _OURS - _rt_redefines:
                raise DeclarationError(
                    f"{cls.__qualname__}.{attribute}: Component has a {attribute} of its own; choose another name"
                )
            if isinstance(value, Port | ServiceEnd):
                cls._rt_port_declarations[attribute] = value
                check_name(value.name or attribute, "port")
            elif isinstance(value, Declared):
                cls._rt_parameter_specs[attribute] = value.named(attribute, cls.__qualname__)
        check_spelling(cls)
        cls._rt_hook_kinds = hook_kinds(cls, Component)
        check_declared(cls)
        cls._rt_configuration_state = declared_state(cls, cls._rt_parameter_specs)

    def __init__(self, name: str = "") -> None:
        if name:
            check_name(name, "component")
        self._rt_host = PortHost(name or type(self).__name__.lower(), Turns())
        self._rt_named = bool(name)
        self._rt_kernel: Kernel | None = None
        self._rt_members: list[Member] = []
        self._rt_gate = Gate()
        self._rt_params = Parameters(self._rt_host.name, self._rt_configuration_state)
        for parameter, value in self._rt_configuration_state.values.items():
            setattr(self, parameter, value)
        for attribute, declaration in self._rt_port_declarations.items():
            setattr(self, attribute, self.add_port(declaration.name or attribute, declaration))

    # -- who and where ---------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """The instance's name, unique in its kernel."""
        return self._rt_host.name

    @property
    def kernel(self) -> Kernel:
        """The kernel this component belongs to; StateError before it was added."""
        if self._rt_kernel is None:
            raise StateError(f"{self.name}: belongs to no kernel yet; await kernel.add(...) first")
        return self._rt_kernel

    @property
    def clock(self) -> Clock:
        """The kernel's clock."""
        return self.kernel.clock

    @property
    def context(self) -> Context:
        """The execution context that runs this hook; outside of hooks the only one; StateError where that is nobody."""
        running = self._rt_running
        if running is not None:
            return running.context
        if len(self._rt_members) == 1:
            return self._rt_members[0].context
        raise StateError(f"{self.name}: is in {len(self._rt_members)} contexts and no hook runs; say which")

    @property
    def contexts(self) -> tuple[Context, ...]:
        """The contexts this component is in, in the order it was added."""
        return tuple(member.context for member in self._rt_members)

    @property
    def states(self) -> Mapping[str, LifeCycleState]:
        """The life-cycle state in each context, by the context's name."""
        return MappingProxyType({member.context.name: member.state for member in self._rt_members})

    @property
    def state(self) -> LifeCycleState | None:
        """The life-cycle state in the context at hand; None in no context."""
        running = self._rt_running
        if running is not None:
            return running.state
        return self._rt_members[0].state if self._rt_members else None

    @property
    def has_finished(self) -> bool:
        """Whether this source said that it has nothing more (`finish`), was deactivated and not activated since."""
        return any(m.finishing and m.state is not LifeCycleState.ACTIVE for m in self._rt_members)

    @property
    def last_error(self) -> BaseException | None:
        """What made this component fail last, with its traceback; earlier causes are chained to it."""
        return self._rt_last_error

    @property
    def log(self) -> ComponentLog:
        """This component's logger on stdlib logging: kernel, component, hook and tick are fields of each record."""
        if self._rt_log is None:
            kernel = self.kernel
            self._rt_log = ComponentLog(self._rt_log_fields, kernel.clock.monotonic_ns, shared=kernel._log_budget)
        return self._rt_log

    @property
    def _rt_running(self) -> Member | Visit | None:
        """The member whose hook runs now, or the call that is served."""
        gate = self._rt_gate
        if gate.inside is None and not gate.shared and self._rt_members:
            # In one context its hooks may pass by the gate.
            member = self._rt_members[0]
            driver = member.context._driver
            return member if driver is not None and driver.current is member else None
        return gate.inside

    def _rt_log_fields(self) -> LogFields:
        kernel = self._rt_kernel.name if self._rt_kernel is not None else ""
        running = self._rt_running
        if self._rt_failed_in is not None:
            member, hook = self._rt_failed_in
            return LogFields(kernel, self.name, hook, member.tick)
        if running is not None:
            return LogFields(kernel, self.name, running.hook, running.tick)
        return LogFields(kernel, self.name)

    @property
    def profile(self) -> ComponentProfile:
        """What this component is at this moment, frozen."""
        error = self._rt_last_error
        return ComponentProfile(
            self.name,
            type(self).__name__,
            tuple(port.profile for port in self.ports.values()),
            self._rt_params._state.values,
            MappingProxyType({name: state.value for name, state in self.states.items()}),
            None if error is None else said(error),
        )

    def __repr__(self) -> str:
        states = ", ".join(f"{context}: {state}" for context, state in self.states.items())
        return f"<{type(self).__name__} {self.name} {len(self.ports)} ports{' ' + states if states else ''}>"

    def _repr_html_(self) -> str:
        from aiorts.kernel.html import component_html

        return component_html(self)

    # -- ports -----------------------------------------------------------------------------------------------------

    @property
    def ports(self) -> Mapping[str, Port[Any]]:
        """The ports there are now, by name."""
        return MappingProxyType(self._rt_host.ports)

    @overload
    def add_port(self, name: str, port: InPort[T]) -> InPort[T]: ...

    @overload
    def add_port(self, name: str, port: OutPort[T]) -> OutPort[T]: ...

    @overload
    def add_port(self, name: str, port: Provided[T]) -> Provided[T]: ...

    @overload
    def add_port(self, name: str, port: Required[T]) -> Required[T]: ...

    @overload
    def add_port(self, name: str, port: Port[Any] | ServiceEnd[Any]) -> Port[Any] | ServiceEnd[Any]: ...

    def add_port(self, name: str, port: Port[Any] | ServiceEnd[Any]) -> Port[Any] | ServiceEnd[Any]:
        """A live port made after the declaration `port`, at any time; announced on the bus.

        Raises:
            InvalidNameError: the name is not allowed. WiringError: there is one of that name already.
            DeclarationError: a value of the port's type cannot travel.
        """
        if self._rt_kernel is not None:
            self._rt_kernel.check_thread(f"{self.name}.add_port")
        check_name(name, "port")
        if self._rt_heir is not None:
            return self._rt_heir.bind(self, name, port)
        if isinstance(port, ServiceEnd):
            return add_end(self, name, port)
        if name in self._rt_host.ports:
            raise WiringError(f"{self.name}.{name}: there is a port of that name already")
        if not isinstance(port, InPort | OutPort):
            raise DeclarationError(f"{self.name}.{name}: expected InPort, OutPort, Provided or Required, got {port!r}")
        bound: InPort[Any] | OutPort[Any] = port.bind(self._rt_host, name)
        self._rt_host.ports[name] = bound
        if self._rt_kernel is not None:
            self._rt_kernel._roster.port_added(self, bound)
        return bound

    def remove_port(self, name: str) -> None:
        """Take a port away: its connectors are disconnected, a read that waits on it ends with ClosedError.

        Raises:
            WiringError: there is no such port.
        """
        if self._rt_kernel is not None:
            self._rt_kernel.check_thread(f"{self.name}.remove_port")
        port = self._rt_host.ports.get(name)
        if port is None:
            raise WiringError(f"{self.name}.{name}: no such port; there are {', '.join(self._rt_host.ports) or 'none'}")
        if self._rt_heir is not None:
            return self._rt_heir.unbind(self, name)
        if self._rt_kernel is not None:
            for connector in port.connectors:
                self._rt_kernel._connections.end(connector)
        del self._rt_host.ports[name]
        if isinstance(port, InPort | ServicePort):
            port._wake_waiter()
        if self._rt_kernel is not None:
            self._rt_kernel._roster.port_removed(self, port)

    # -- what a hook may ask for -----------------------------------------------------------------------------------

    def finish(self) -> None:
        """Say that this source has nothing more: it is deactivated after this cycle."""
        if self._rt_kernel is not None and self._rt_host.thread_id != threading.get_ident():
            self._rt_kernel.check_thread(f"{self.name}.finish")
        running = self._rt_running
        if running is not None:
            running.finish()
            return
        for member in self._rt_members:
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

    def on_reload(self, old: Self) -> Hook:
        """Its code was replaced (`Kernel.reload`): take over from the instance of the old code, between two cycles."""
        return _nothing()

    # -- called by the kernel --------------------------------------------------------------------------------------

    def _rt_move(self, threaded: bool) -> None:
        """It is about to join a thread context, or has left one."""

    def _rt_unfold(self) -> tuple[Component, ...]:
        """What runs where it is started."""
        return (self,)

    def _rt_leaves(self) -> tuple[Component, ...]:
        """What it is made of."""
        return (self,)

    def _rt_rename(self, name: str) -> None:
        self._rt_host.name = name
        self._rt_params._owner = name
        self._rt_named = True


def _nothing() -> Hook:
    """What a hook that nobody wrote returns: super().on_x() can be awaited all the same."""
    return _DONE


Component._rt_hook_kinds = hook_kinds(Component, Component)


class _Done:
    """An awaitable that is done, any number of times."""

    def __await__(self) -> Any:
        return iter(())


_DONE = _Done()


_OURS = frozenset(name for name in (*vars(Component), *vars(Configurable)) if not name.startswith("_")) - {
    *HOOKS,
    *OVERRIDABLE,
    "max_instance",
    "on_reload",
}
"""What a component cannot redefine: the kernel and every tool rely on it."""
