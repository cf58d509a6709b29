"""A component: declarations, ports that come and go, parameters, and the twelve hooks.

Logic and logical thread are separate: a component never chooses its execution context; who runs in which context and
in which order is the system's affair.
"""

from __future__ import annotations

import threading
from collections.abc import Awaitable, Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, Self, TypeVar, cast

from aiorts.errors import (
    AiortsError,
    ComponentError,
    DeclarationError,
    PluginError,
    StateError,
    WiringError,
    format_error,
)
from aiorts.kernel.configuring import OVERRIDABLE, Configurable, declared_state
from aiorts.kernel.declarations import Declarations, Kind, declarations
from aiorts.kernel.execution.cell import ATTRIBUTE, Cell, cell, has_cell, log_fields
from aiorts.kernel.execution.hooks import check_spelling, hook_kinds
from aiorts.kernel.loop.exceptions import presentable, trace_of
from aiorts.kernel.loop.log import ComponentLog
from aiorts.kernel.loop.origins import located
from aiorts.kernel.parameters import Declared
from aiorts.kernel.ports import Port, PortDeclaration
from aiorts.kernel.ports.port import wake_waiter
from aiorts.model.configuration.sets import ConfigurationState
from aiorts.model.lifecycle import HOOKS, LifecycleState, joint
from aiorts.model.names import check_name
from aiorts.model.profile import ComponentProfile

if TYPE_CHECKING:
    from aiorts.clock import Clock
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel

C = TypeVar("C", bound="Component")
D = TypeVar("D", bound=PortDeclaration)
Hook = Awaitable[None] | None
"""The result of a hook: it is `async def` or plain `def`, and the value is None."""


LINK_LOST: Final = ("continue", "deactivate", "error")


class Elsewhere:
    """The further interface of a stand-in, whose component runs in another process or in another kernel."""

    async def ask(self, operation: str, **arguments: Any) -> Any:
        """The answer of the component's process or kernel to an operation of control."""
        raise NotImplementedError


class Component(Configurable):
    """The unit of a system. Derive from it, declare ports and parameters, write the hooks you need.

    Its one private attribute is `_rt`: `self._log` or `self._members` are yours.

    Args:
        name: the instance's name; the kernel gives one ("pid0") where there is none.

    Every hook may be `async def` or plain `def`; the defaults do nothing.
    """

    max_instance: ClassVar[int | None] = None
    parks: ClassVar[bool] = True
    """Whether it is kept whole while a plan that takes it out may still be taken back.

    False: it holds a device that its replacement needs, and is finalized first.
    """
    on_link_lost: ClassVar[Literal["continue", "deactivate", "error"]] = "continue"
    """The reaction of an active component to the loss of its operator's link: `aiorts check` shows it.

    Its operator is the control session that has changed it last, while that is open; a session that ends in order is
    not lost.
    """
    alone: ClassVar[Mapping[str, object]] = MappingProxyType({})
    """The context that it runs in alone, by `aiorts run` or as a filter, as the table of a system file: {"rate": 50.0}.

    Without `kind` it is a periodic one. Where nothing is said, one with in-ports runs on data, any other 10 times a
    second.
    """
    _rt: Cell
    """The cell of the component; of a class: its `Declarations`."""

    def __init_subclass__(
        cls, *, kind: Kind | None = None, redefines: frozenset[str] = frozenset(), **options: Any
    ) -> None:
        super().__init_subclass__(**options)
        inherited = declarations(cls)
        ports, parameters = dict(inherited.ports), dict(inherited.parameters)
        for attribute in sorted(vars(cls).keys() & (_OURS - redefines)):
            raise DeclarationError(
                f"{cls.__qualname__}.{attribute}: Component has a {attribute} of its own; choose another name"
            )
        # What the first base has is inherited; that of others is found as Python finds attributes.
        for body in reversed(cls.__mro__) if len(cls.__bases__) > 1 else (cls,):
            for attribute, value in vars(body).items():
                if isinstance(value, PortDeclaration):
                    ports[attribute] = value
                    check_name(value.name or attribute, "port")
                elif isinstance(value, Declared):
                    parameters[attribute] = value.named(attribute, body.__qualname__)
        check_spelling(cls)
        if cls.on_link_lost not in LINK_LOST:
            said = f"expected {', '.join(map(repr, LINK_LOST))}, got {cls.on_link_lost!r:.80}"
            raise DeclarationError(f"{cls.__qualname__}.on_link_lost: {said}")
        kinds = [
            one for base in reversed(cls.__mro__[1:]) if issubclass(base, Component) for one in declarations(base).kinds
        ]
        for attribute, declared in ports.items():
            declared.check_declared(cls, attribute)
        overrides = frozenset(name for name in OVERRIDABLE if getattr(cls, name) is not getattr(Configurable, name))
        all_of_it = Declarations(
            ports,
            parameters,
            hook_kinds(cls, Component),
            declared_state(cls, parameters),
            overrides,
            tuple(dict.fromkeys((*kinds, *(() if kind is None else (kind,))))),
        )
        setattr(cls, ATTRIBUTE, all_of_it)

    def __init__(self, name: str = "") -> None:
        if name:
            check_name(name, "component")
        declared = declarations(type(self))
        self._rt = Cell(name or type(self).__name__.lower(), bool(name), declared.hook_kinds, declared.configuration)
        for parameter, value in declared.configuration.values.items():
            setattr(self, parameter, value)
        for attribute, declaration in declared.ports.items():
            setattr(self, attribute, self.add_port(declaration.name or attribute, declaration))

    # -- who and where ---------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """The instance's name, unique in its kernel."""
        return cell(self).name

    @property
    def kernel(self) -> Microkernel:
        """The kernel this component belongs to; StateError before it was added."""
        kernel = cell(self).kernel
        if kernel is None:
            raise StateError(f"{self.name}: belongs to no kernel yet; await kernel.add(...) first")
        return cast("Microkernel", kernel)

    @property
    def clock(self) -> Clock:
        """The kernel's clock."""
        return self.kernel.clock

    @property
    def context(self) -> Context:
        """The execution context that runs this hook; outside of hooks the only one; StateError where there is none."""
        here = cell(self)
        running = here.running
        if running is not None:
            return running.context
        if len(here.members) == 1:
            return here.members[0].context
        raise StateError(f"{self.name}: is in {len(here.members)} contexts and no hook runs; say which")

    @property
    def contexts(self) -> tuple[Context, ...]:
        """The contexts this component is in, in the order it was added."""
        return tuple(member.context for member in cell(self).members)

    @property
    def states(self) -> Mapping[str, LifecycleState]:
        """The lifecycle state in each context, by the context's name."""
        return MappingProxyType({member.context.name: member.state for member in cell(self).members})

    @property
    def state(self) -> LifecycleState | None:
        """The lifecycle state in the context whose hook runs, else of all its contexts; None in no context.

        Of several it is in error where one is, else active where one is; `states` has each. In a call that it serves it
        is active where it is active in any.
        """
        here = cell(self)
        running = here.running
        return joint(member.state for member in here.members) if running is None else running.state

    @property
    def has_finished(self) -> bool:
        """Whether this source said that it has nothing more (`finish`), was deactivated and not activated since."""
        return any(m.finishing and m.state is not LifecycleState.ACTIVE for m in cell(self).members)

    @property
    def last_error(self) -> BaseException | None:
        """The error by which this component failed last, with its traceback; earlier causes are chained to it."""
        return cell(self).last_error

    @property
    def log(self) -> ComponentLog:
        """This component's logger on stdlib logging: kernel, component, hook and tick are fields of each record."""
        here = cell(self)
        if here.log is None:
            kernel = self.kernel
            # Of the component, not of the cell: a reload gives the new instance the cell of the old one.
            here.log = ComponentLog(partial(log_fields, self), kernel.clock.monotonic_ns, shared=kernel._log_budget)
        return here.log

    @property
    def profile(self) -> ComponentProfile:
        """A frozen description of this component at this moment."""
        error = cell(self).last_error
        return ComponentProfile(
            self.name,
            type(self).__name__,
            tuple(port.profile for port in self.ports.values()),
            cell(self).configuration.values,
            MappingProxyType({name: state.value for name, state in self.states.items()}),
            None if error is None else format_error(error),
        )

    def __repr__(self) -> str:
        states = ", ".join(f"{context}: {state}" for context, state in self.states.items())
        return f"<{type(self).__name__} {self.name} {len(self.ports)} ports{' ' + states if states else ''}>"

    def _repr_html_(self) -> str | None:
        kernel = cell(self).kernel
        return None if kernel is None else kernel.html_of(self)

    # -- ports -----------------------------------------------------------------------------------------------------

    @property
    def ports(self) -> Mapping[str, Port[Any]]:
        """The ports there are now, by name."""
        return MappingProxyType(cell(self).ports)

    def add_port(self, name: str, port: D) -> D:
        """A live port made after the declaration `port`, at any time; announced on the bus.

        Raises:
            InvalidNameError: the name is not allowed.
            WiringError: there is one of that name already.
            DeclarationError: a value of the port's type cannot travel.
        """
        kernel, here = cell(self).kernel, cell(self)
        if kernel is not None:
            kernel.check_thread(f"{self.name}.add_port")
        check_name(name, "port")
        if not isinstance(port, PortDeclaration):
            raise DeclarationError(f"{self.name}.{name}: expected InPort, OutPort, Provided or Required, got {port!r}")
        maker = here.port_maker or declarations(type(self)).port_maker
        if maker is not None:
            return cast("D", maker.bind(self, name, port))
        bound = port.add_to(self, here, name)
        if kernel is not None:
            kernel.registry.port_added(self, here.ports[name])
        return bound

    def remove_port(self, name: str) -> None:
        """Take a port away: its connectors are disconnected, a read that waits on it ends with ClosedError.

        Raises:
            WiringError: there is no such port.
        """
        kernel, here = cell(self).kernel, cell(self)
        if kernel is not None:
            kernel.check_thread(f"{self.name}.remove_port")
        port = here.ports.get(name)
        if port is None:
            raise WiringError(f"{self.name}.{name}: no such port; there are {', '.join(here.ports) or 'none'}")
        if here.port_maker is not None:
            here.port_maker.unbind(self, name)
            return
        if kernel is not None:
            for connector in port.connectors:
                kernel.connections.end(connector)
        del here.ports[name]
        wake_waiter(port)
        if kernel is not None:
            kernel.registry.port_removed(self, port)

    # -- what a hook may ask for -----------------------------------------------------------------------------------

    def finish(self) -> None:
        """End this source: it is deactivated after this cycle."""
        kernel, here = cell(self).kernel, cell(self)
        if kernel is not None and here.thread_id != threading.get_ident():
            kernel.check_thread(f"{self.name}.finish")
        running = here.running
        if running is not None:
            running.finish()
            return
        for member in here.members:
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


def _nothing() -> Hook:
    """The result of a hook that the class does not define: super().on_x() can be awaited all the same."""
    return _DONE


setattr(
    Component,
    ATTRIBUTE,
    Declarations({}, {}, hook_kinds(Component, Component), ConfigurationState.of({}), frozenset(), ()),
)


def construct(cls: type[C], name: str) -> C:
    """A component of this class, which belongs to no kernel yet.

    Raises:
        ComponentError: its own `__init__` raises.
        PluginError: it forgets `super().__init__(name)`, or takes no name.
        AiortsError: what `__init__` raises of that kind, as it is.
    """
    try:
        component = cls(name)
    except AiortsError:
        raise
    except BaseException as error:  # a component's border: its constructor is the user's
        if issubclass(type(error), KeyboardInterrupt):
            raise
        advice = _advice(cls, error)
        kind = PluginError if advice else ComponentError
        raise kind(f"{cls.__name__} cannot be constructed: {located(error)}{advice}") from presentable(error)
    if not has_cell(component):
        raise PluginError(f"{cls.__name__}.__init__ must call super().__init__(name)")
    return component


def _advice(cls: type[Component], error: BaseException) -> str:
    """For an `__init__` that was not even entered."""
    trace = trace_of(error)
    entered = trace is not None and trace.tb_next is not None
    if entered or not issubclass(type(error), TypeError) or cls.__init__ is Component.__init__:
        return ""
    return "; write def __init__(self, name) and call super().__init__(name)"


class _Done:
    """An awaitable that is done, any number of times."""

    def __await__(self) -> Any:
        return iter(())


_DONE = _Done()


_OURS = frozenset(name for name in (*vars(Component), *vars(Configurable)) if not name.startswith("_")) - {
    *HOOKS,
    *OVERRIDABLE,
    "alone",
    "max_instance",
    "on_link_lost",
    "parks",
    "on_reload",
}
"""The names that a component cannot redefine: the kernel and every tool rely on them."""
