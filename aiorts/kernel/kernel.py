"""The kernel: it owns components, contexts and connectors, and gives them up in reverse order.

It knows no concrete context, transport, format or command. There are as many kernels as you like in a process and on
a loop; each belongs to the thread and the loop it was opened in, and everything that changes the system is called
there.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar, overload

from aiorts.clock import Clock, SystemClock, current_clock
from aiorts.errors import ClosedError, DeclarationError, InvalidNameError, StateError, ThreadError, WiringError
from aiorts.kernel import embedding, wiring
from aiorts.kernel.bulkhead import StopBudget, leave_behind
from aiorts.kernel.bus import (
    Bus,
    ComponentAdded,
    ComponentRemoved,
    Connected,
    Disconnected,
    HookFailed,
    ParametersChanged,
    PortAdded,
    PortRemoved,
)
from aiorts.kernel.component import Component
from aiorts.kernel.context import Context
from aiorts.kernel.plugins import load_extension
from aiorts.kernel.ports import InPort, Port
from aiorts.kernel.solo import run_alone
from aiorts.kernel.timers import sleep, timers_for
from aiorts.model.names import Path, check_name

if TYPE_CHECKING:
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.host import Cancellable

__all__ = ("Kernel",)

C = TypeVar("C", bound=Component)
X = TypeVar("X", bound=Context)
_LOG = logging.getLogger("aiorts.kernel")


class Kernel:
    """Owner of a system in this process. `async with Kernel() as kernel:` or `await Kernel().open()` and `await
    kernel.aclose()`.

    Args:
        name: for logs and paths.
        clock: SystemClock by default; on a simulated loop that loop's clock.
        debug: check the thread of every port call and copy every sample: slow, finds writers that change what they
            have written.
        contain_interrupts: a KeyboardInterrupt raised in a hook is that component's error and goes no further
            (`aiorts run` takes SIGINT
            itself). By default it is passed on after the component went to error.
    """

    def __init__(
        self, name: str = "kernel", *, clock: Clock | None = None, debug: bool = False, contain_interrupts: bool = False
    ) -> None:
        self.name = check_name(name, "kernel")
        self.debug = debug
        self.bus = Bus()
        self._clock = clock
        self._contain_interrupts = contain_interrupts
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread_id: int | None = None
        self._opener: asyncio.Task[Any] | None = None
        self._components: dict[str, Component] = {}
        self._contexts: dict[str, Context] = {}
        self._connectors: dict[str, Connector] = {}
        self._timers: Any = None
        self._tasks: set[asyncio.Task[Any]] = set()
        self._serial = 0
        self._closed = False
        self._stop_requested: asyncio.Event = asyncio.Event()
        self._finished: set[str] = set()
        self.exit_status = 0
        """What `request_stop` said."""
        self._remove_probe: Callable[[], None] | None = None

    # -- opening and closing ---------------------------------------------------------------------------------------

    async def open(self) -> Self:
        """Take the running loop; returns the kernel itself."""
        if self._loop is not None:
            raise StateError(f"{self.name}: is open already, or was; make another Kernel")
        self._loop = asyncio.get_running_loop()
        self._thread_id = threading.get_ident()
        self._opener = asyncio.current_task()
        if self._clock is None:
            self._clock = current_clock() or SystemClock()
        self._timers = timers_for(self._clock)
        self._timers.acquire()
        add_probe = getattr(self._clock, "add_probe", None)
        if add_probe is not None:
            self._remove_probe = add_probe(self._activity)
        embedding.enter(self, self._loop)
        return self

    async def aclose(self) -> None:
        """Stop contexts, disconnect, finalise components, each in reverse order, within 5 s; idempotent.

        A hook gets 2 s, then it is cancelled four times at 0.5 s, then left behind and reported.
        """
        if self._loop is None or self._closed:
            return
        self.check_thread("aclose")
        if asyncio.get_running_loop() is not self._loop:
            raise ThreadError(f"{self.name}: aclose() on another loop than the one it was opened on")
        self._closed = True
        self._stop_requested.set()
        budget = StopBudget(self._loop)
        for context in self._contexts.values():
            if context._driver is not None:
                context._driver.hurry(budget)
        try:
            await self._tear_down(budget)
        finally:
            self._timers.release()
            embedding.leave(self, self._loop)
            if self._remove_probe is not None:
                self._remove_probe()

    async def _tear_down(self, budget: StopBudget) -> None:
        for context in reversed(tuple(self._contexts.values())):
            await context._stop(budget)
        for connector in reversed(tuple(self._connectors.values())):
            self._disconnect(connector)
        for component in reversed(tuple(self._components.values())):
            await self._finalize(component, budget)
        await self._end_tasks(budget)

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.aclose()

    def request_stop(self, status: int = 0) -> None:
        """Ask for an orderly end, from any thread; whoever runs the kernel (`wait_stop_requested`) ends it."""
        self.exit_status = status
        self._on_loop(self._stop_requested.set)

    async def wait_stop_requested(self) -> int:
        """Wait until somebody asks for the end; the exit status given."""
        await self._stop_requested.wait()
        return self.exit_status

    # -- what there is ---------------------------------------------------------------------------------------------

    @property
    def clock(self) -> Clock:
        """The clock that all periods, time-outs and stamps of this kernel go by."""
        return self._clock if self._clock is not None else SystemClock()

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The loop this kernel was opened on."""
        if self._loop is None:
            raise ClosedError(f"{self.name}: is not open; use `async with` or await open()")
        return self._loop

    @property
    def components(self) -> Mapping[str, Component]:
        """The components, by name, in order of creation."""
        return MappingProxyType(self._components)

    @property
    def contexts(self) -> Mapping[str, Context]:
        """The contexts that run, by name, in order of start."""
        return MappingProxyType(self._contexts)

    @property
    def connectors(self) -> Mapping[str, Connector]:
        """The connectors, by name, in order of connection."""
        return MappingProxyType(self._connectors)

    def find(self, path: str) -> Component | Port[Any]:
        """The component or port of a path such as "pid0" or "pid0.command".

        Raises:
            InvalidNameError: not a path. WiringError: there is no such component or port; says what there is.
        """
        where = Path.parse(path)
        component = self._components.get(where.component)
        if component is None:
            raise WiringError(
                f"{path}: no component {where.component!r}; there are {', '.join(self._components) or 'none'}"
            )
        if where.port is None:
            return component
        port = component.ports.get(where.port)
        if port is None:
            raise WiringError(
                f"{path}: {where.component} has no port {where.port!r}; it has {', '.join(component.ports) or 'none'}"
            )
        return port

    def __repr__(self) -> str:
        state = "closed" if self._closed else "open" if self._loop is not None else "not open"
        return (
            f"<Kernel {self.name} {state} {len(self._components)} components {len(self._contexts)} contexts "
            f"{len(self._connectors)} connectors>"
        )

    def _repr_html_(self) -> str:
        from aiorts.kernel.html import kernel_html

        return kernel_html(self)

    # -- components ------------------------------------------------------------------------------------------------

    @overload
    async def create(self, kind: type[C], name: str = "", **params: object) -> C: ...

    @overload
    async def create(self, kind: str, name: str = "", **params: object) -> Component: ...

    async def create(self, kind: type[Component] | str, name: str = "", **params: object) -> Component:
        """Make a component of a class, or of a type that an installed package offers by name, and add it.

        Args:
            kind: the class, which keeps its type, or the name. name: the instance's; made from the type's where there
                is none.
            params: values of parameters.

        Raises:
            PluginError: no such type. ConfigurationError: a parameter is bad. What `on_initialize` raises.
        """
        self.check_thread("create")
        cls: type[Component] = load_extension("components", kind) if isinstance(kind, str) else kind
        if not (isinstance(cls, type) and issubclass(cls, Component)):
            raise DeclarationError(f"{kind!r}: expected a class derived from Component, got {cls!r}")
        component = cls(name)
        if name == "" and not component._named:
            component._rename(self._free_name(cls.__name__))
        return await self.add(component, **params)

    async def add(self, component: C, **params: object) -> C:
        """Take a component in and run its `on_initialize`; returns it.

        Raises:
            InvalidNameError: the name is taken. ConfigurationError: a parameter is bad. What `on_initialize` raises:
                then it is not added.
        """
        self._require_open("add")
        if not isinstance(component, Component):
            raise DeclarationError(f"{component!r}: expected a Component instance, got {type(component).__name__}")
        if not hasattr(component, "_host"):
            raise DeclarationError(f"{type(component).__name__}: super().__init__(name) was not called in its __init__")
        if component._kernel is not None:
            raise StateError(f"{component.name}: belongs to {component._kernel.name} already")
        if not component._named:
            component._rename(self._free_name(type(component).__name__))
        self._check_free(component)
        component._put(component.params.check(params))
        component._kernel = self
        component._host.kernel = self
        self._components[component.name] = component
        try:
            await self._initialize(component)
        except BaseException:
            self._forget(component)
            raise
        for port in component.ports.values():
            self.bus.publish(PortAdded(component.name, port.profile))
        self.bus.publish(ComponentAdded(component.name))
        return component

    async def remove(self, component: Component) -> None:
        """Take a component out: out of its contexts, its ports disconnected, `on_finalize` run."""
        self._check_mine(component)
        for context in component.contexts:
            await context.remove(component)
        await self._finalize(component, None)

    def _check_free(self, component: Component) -> None:
        if component.name in self._components:
            raise InvalidNameError(
                f"{component.name}: there is a component of that name in {self.name}; choose another"
            )
        limit = type(component).max_instance
        if limit is not None:
            count = sum(type(other) is type(component) for other in self._components.values())
            if count >= limit:
                raise StateError(
                    f"{component.name}: {type(component).__name__} allows {limit} instances, {count} exist"
                )

    def _free_name(self, stem: str) -> str:
        stem, number = stem.lower(), 0
        while f"{stem}{number}" in self._components or f"{stem}{number}" in self._contexts:
            number += 1
        return f"{stem}{number}"

    async def _initialize(self, component: Component) -> None:
        error = await run_alone(self, component, "on_initialize", None)
        if error is not None:
            self.bus.publish(HookFailed(component.name, "", "on_initialize", error))
            raise error

    async def _finalize(self, component: Component, budget: StopBudget | None) -> None:
        for port in component.ports.values():
            for connector in port.connectors:
                self._disconnect(connector)
        error = await run_alone(self, component, "on_finalize", budget or StopBudget(self.loop))
        if error is not None:
            component._last_error = error
            self.bus.publish(HookFailed(component.name, "", "on_finalize", error))
            component.log.error("on_finalize failed: %s: %s", type(error).__name__, error, exc_info=error)
        component.log.flush()
        for task in [task for task in self._tasks if getattr(task, "_aiorts_component", None) is component]:
            task.cancel()
        self._forget(component)
        self.bus.publish(ComponentRemoved(component.name))

    def _forget(self, component: Component) -> None:
        self._components.pop(component.name, None)
        component._host.alive = False
        for port in component.ports.values():
            if isinstance(port, InPort):
                port._wake_waiter()

    # -- connecting ------------------------------------------------------------------------------------------------

    @overload
    async def connect(self, one: Port[Any], two: Port[Any], /, **options: Any) -> Connector: ...

    @overload
    async def connect(
        self, one: Port[Any], two: Port[Any], three: Port[Any], /, *more: Port[Any], **options: Any
    ) -> tuple[Connector, ...]: ...

    async def connect(
        self, one: Port[Any], two: Port[Any], /, *more: Port[Any], **options: Any
    ) -> Connector | tuple[Connector, ...]:
        """Connect ports: every out-port with every in-port, all or none.

        Options (the same keys in system files and profiles; OpenRTM's keys are aliases):
            dataflow: "push", or "pull": the reader asks, the writer's latest unread sample is taken.
            subscription: "flush", "new", "periodic". push: "all", "fifo", "skip", "new".
            push_rate: Hz, for periodic. skip: n, send every (n + 1)-th.
            length: samples the reader's buffer holds, 1 to 1,000,000. out_length: the backlog of a periodic connector.
            full: "overwrite", "reject", "block". timeout: seconds an awaited write waits with block; None for ever.
            stamp: "send", "received", "read": when `tm` is set to the kernel's clock.
            name: the connector's. allow_duplicate: a second connector between the same two ports.

        Returns:
            The connector, or a tuple of them when more than two ports were given.

        Raises:
            WiringError: says which ports or options do not go together and why; nothing was connected.
        """
        self._require_open("connect")
        plans = wiring.plan(self, (one, two, *more), options)
        made = []
        for out, in_, profile in plans:
            name = self._connector_name(profile.name, f"{out.path}-{in_.path}", len(plans))
            connector = wiring.wire(self, out, in_, replace(profile, name=name))
            self._connectors[name] = connector
            made.append(connector)
            self.bus.publish(Connected(connector.profile))
        return tuple(made) if more else made[0]

    def _connector_name(self, given: str, path: str, count: int) -> str:
        base = given or path
        if given and count == 1 and given in self._connectors:
            raise WiringError(f"{path}: there is a connector named {given!r}")
        name, number = base, 2
        while name in self._connectors:
            name, number = f"{base}-{number}", number + 1
        return name

    async def disconnect(self, connector: Connector) -> None:
        """End a connector: what is queued in it is dropped as disconnected, who waits for room goes on. Idempotent."""
        self._require_open("disconnect")
        if not connector.closed and self._connectors.get(connector.name) is not connector:
            raise WiringError(f"{connector.name}: is not a connector of {self.name}")
        self._disconnect(connector)

    def _disconnect(self, connector: Connector) -> None:
        if connector.closed:
            return
        wiring.unwire(connector)
        del self._connectors[connector.name]
        self.bus.publish(Disconnected(connector.profile))

    # -- contexts --------------------------------------------------------------------------------------------------

    async def start(self, context: X, *components: Component, activate: bool = False) -> X:
        """Start an execution context with these members, in this order of execution; returns it.

        Args:
            activate: have the members active before the first cycle.

        Raises:
            StateError: the context runs already, or a component cannot run in it.
            ComponentError: with `activate`, `on_activated` raised; the context runs all the same.
        """
        self._require_open("start")
        if not isinstance(context, Context):
            raise DeclarationError(f"{context!r}: expected an execution context such as PeriodicContext(rate=100.0)")
        if context.running:
            raise StateError(f"{context.name}: runs already")
        for component in components:
            self._check_mine(component)
            context._check_can_add(component)
        if len(set(map(id, components))) != len(components):
            raise StateError(f"{context.name or context.kind}: a component was given twice")
        if not context.name:
            context.name = self._free_name(context.kind or type(context).__name__)
        if context.name in self._contexts:
            raise InvalidNameError(f"{context.name}: there is a context of that name in {self.name}; choose another")
        self._contexts[context.name] = context
        await context._start(self, components, activate=activate)
        return context

    async def stop(self, context: Context) -> None:
        """Stop one context: see `Context.stop`."""
        self._require_open("stop")
        await context.stop()

    async def sleep(self, seconds: float) -> None:
        """Wait on the kernel's clock; a negative time is 0. ValueError for NaN and infinities."""
        self._require_open("sleep")
        await sleep(self.clock, seconds)

    # -- threads ---------------------------------------------------------------------------------------------------

    def on_loop_thread(self) -> bool:
        """Whether this is the thread of the kernel's loop."""
        return self._thread_id is None or threading.get_ident() == self._thread_id

    def check_thread(self, what: str) -> None:
        """Raise ThreadError unless this is the thread of the kernel's loop."""
        if not self.on_loop_thread():
            raise ThreadError(
                f"{self.name}: {what} called from thread {threading.current_thread().name!r}; "
                "call it on the kernel's loop (asyncio.run_coroutine_threadsafe)"
            )

    def _on_loop(self, callback: Callable[[], object]) -> None:
        if self.on_loop_thread():
            callback()
        elif self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(callback)

    def _require_open(self, what: str) -> None:
        self.check_thread(what)
        if self._loop is None:
            raise ClosedError(f"{self.name}: cannot {what}: is not open; use `async with` or await open()")
        if self._closed:
            raise ClosedError(f"{self.name}: cannot {what}: is closed")

    def _check_mine(self, component: Component) -> None:
        self._require_open("use a component")
        if self._components.get(component.name) is not component:
            raise StateError(f"{component.name}: does not belong to {self.name}; await kernel.add(...) first")

    # -- called by components, contexts and ports ------------------------------------------------------------------

    def time_ns(self) -> int:
        """The kernel clock's time, nanoseconds since the epoch."""
        return self.clock.time_ns()

    def call_later(self, seconds: float, callback: Callable[[], None]) -> Cancellable:
        """Call back after `seconds` of the kernel's clock."""
        timer: Cancellable = self._timers.call_at(self.clock.monotonic_ns() + round(seconds * 1e9), callback)
        return timer

    def _activity(self) -> int:
        return sum(context._activity() for context in self._contexts.values())

    def _port_added(self, component: Component, port: Port[Any]) -> None:
        for member in component._members:
            member.context._port_added(member, port)
        self.bus.publish(PortAdded(component.name, port.profile))

    def _port_removed(self, component: Component, port: Port[Any]) -> None:
        for member in component._members:
            member.context._port_removed(member, port)
        self.bus.publish(PortRemoved(component.name, port.profile))

    def _lock_ports(self, port: Port[Any]) -> None:
        """More than one thread will use what hangs on this port."""
        if isinstance(port, InPort):
            port._make_locked()
        for connector in port.connectors:
            connector.in_._make_locked()

    async def _between_cycles(self, component: Component, change: Callable[[], None]) -> None:
        """Run `change` while no hook of the component runs; from one of its own hooks: afterwards."""
        contexts = component.contexts
        if not contexts:
            change()
        elif component._lock is None:
            await contexts[0]._between_cycles(change)
        elif any(context._inside() for context in contexts):
            self._adopt(self.loop.create_task(_locked(component, change)))
        else:
            await _locked(component, change)

    def _parameters_changed(self, component: Component, values: Mapping[str, Any]) -> None:
        self._on_loop(lambda: self.bus.publish(ParametersChanged(component.name, tuple(values.items()))))

    def _context_ended(self, context: Context) -> None:
        if self._contexts.get(context.name) is context:
            del self._contexts[context.name]

    def _source_finished(self, component: Component) -> None:
        self._finished.add(component.name)

    def _host_gone(self) -> bool:
        return self._opener is None or self._opener.done()

    def _interrupted(self, error: KeyboardInterrupt) -> None:
        if not self._contain_interrupts:
            self.loop.call_soon(_raise, error)

    def _adopt(self, task: asyncio.Task[Any]) -> None:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _task_failed(self, component: Component, task: asyncio.Task[Any], error: BaseException) -> None:
        """A task that a component started has failed and nobody asked for its exception."""
        error.add_note(f"in task {task.get_name()!r} started by component {component.name}")
        for member in component._members:
            member.context._life.failed(member, "on_execute", error)
        if not component._members:
            component._last_error = error
            self.bus.publish(HookFailed(component.name, "", "task", error))
            component.log.error(
                "its task %s failed: %s: %s", task.get_name(), type(error).__name__, error, exc_info=error
            )

    async def _end_tasks(self, budget: StopBudget) -> None:
        tasks = [task for task in self._tasks if not task.done()]
        for task in tasks:
            owner: Component | None = getattr(task, "_aiorts_component", None)
            if owner is not None:
                _LOG.warning("%s: left task %s running; it is cancelled", owner.name, task.get_name())
            task.cancel()
        if tasks:
            _, stuck = await asyncio.wait(tasks, timeout=max(0.1, budget.limit))
            for task in stuck:
                _LOG.error("task %s ignored its cancellation and was left behind", task.get_name())
                leave_behind(task)


async def _locked(component: Component, change: Callable[[], None]) -> None:
    async with component._lock:
        change()


def _raise(error: BaseException) -> None:
    raise error
