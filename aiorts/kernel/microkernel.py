"""The microkernel: it owns components, contexts and connectors, and gives them up in reverse order.

It knows no service, concrete context, transport, format or command; services are attached to it (`service.py`). There
are as many kernels as you like in a process and on a loop; each belongs to the thread and loop it was opened in, where
everything that changes the system is called.
"""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Awaitable, Callable, Mapping, Sequence
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar, TypeVarTuple, Unpack, cast, overload

from aiorts.clock import Clock, SystemClock, clock_of, to_ns
from aiorts.errors import ClosedError, ConfigurationError, DeclarationError, StateError, ThreadError
from aiorts.kernel import embedding, naming, start_context
from aiorts.kernel.component import Component
from aiorts.kernel.connection import Connection, joined
from aiorts.kernel.connections import Connections
from aiorts.kernel.ending import end_members
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.context import Context
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.loop import calls
from aiorts.kernel.loop.bus import Bus, Closing
from aiorts.kernel.loop.deadlines import StopBudget, StopRequest
from aiorts.kernel.loop.guarded import guarded
from aiorts.kernel.loop.log import SharedBudget
from aiorts.kernel.loop.tasks import current_task, kernel_task, owner_of, see_through, throw
from aiorts.kernel.loop.timers import sleep, timers_for
from aiorts.kernel.pool import PoolMonitor
from aiorts.kernel.ports import Port
from aiorts.kernel.registry import Registry
from aiorts.kernel.service import KernelService, TimedHook, attach_services, notify, plan_service, report_fault
from aiorts.model.names import check_name
from aiorts.model.naming import NamePolicy, Numbering
from aiorts.model.values import shown

if TYPE_CHECKING:
    import typing_extensions

    from aiorts.kernel.connection import AnyConnector
    from aiorts.kernel.execution.deadline_timer import DeadlineTimer
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.port import End
    from aiorts.model.connect_options import ConnectOptions

C = TypeVar("C", bound=Component)
S = TypeVar("S", bound=KernelService)
T = TypeVar("T")
Ts = TypeVarTuple("Ts")
X = TypeVar("X", bound=Context)
if TYPE_CHECKING:
    Made = typing_extensions.TypeVar("Made", bound=AnyConnector, default=Connector)


class Microkernel:
    """Owner of components, contexts and connectors. `aiorts.Kernel` is this with all services of aiorts.

    Args:
        name: for logs and paths.
        clock: SystemClock by default; on a loop that keeps its own time, a simulated one or another's, that loop's.
        debug: check the thread of every port call, copy every sample: slow; finds writers that change what they wrote.
        contain_interrupts: a KeyboardInterrupt raised in a hook is that component's error and goes no further (`aiorts
            run` takes SIGINT itself). By default it is passed on after the component went to error.
        initialize_timeout: seconds of the kernel's clock that an `on_initialize` may take; None waits forever (`aiorts
            run`: 30). One over it is cancelled, or refused when it returns if it blocks, and its component not added.
        plugins: where types asked for by name come from; installed packages by default.
        services: the services to attach when it opens, by the name that a plugin offers each by, with its settings.

    Raises:
        PluginError: no plugin offers a service of that name.
        ConfigurationError: names each setting that is wrong.
    """

    def __init__(
        self,
        name: str = "kernel",
        *,
        clock: Clock | None = None,
        debug: bool = False,
        contain_interrupts: bool = False,
        initialize_timeout: float | None = None,
        plugins: Catalogue | None = None,
        services: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    ) -> None:
        self.name = check_name(name, "kernel")
        self.initialize_timeout = _checked("initialize_timeout", initialize_timeout)
        self.debug = debug
        self.bus = Bus(self._hooks_wanted_changed, self.check_thread)
        self.exit_status = 0
        """The status that `request_stop` gave; 1 instead of 0 once aiorts itself has failed."""
        self._has_faulted = False
        self.address = ""
        """"host/name", under which other processes reach it; "" as long as no socket or transport is open."""
        self.epoch = 0
        """64 random bits, other ones each time the kernel becomes reachable; 0 as long as it is not."""
        self.origin = ""
        """The text of the system file that it was built from; "" without one."""
        self.plugins = Catalogue.default() if plugins is None else plugins
        self._planned = [
            plan_service(self.plugins, one, dict(given))._replace(table=given) for one, given in services.items()
        ]
        self._clock = clock
        self._contain_interrupts = contain_interrupts
        self._loop: asyncio.AbstractEventLoop | None = None
        self.thread_id: int | None = None
        """The thread of its loop, once it is open."""
        self._services: dict[type[KernelService], KernelService] = {}
        self._naming = NamePolicy()
        self.opened_ns = 0
        """When it was opened, on its clock."""
        self.registry = Registry(self)
        """Its components, and what is known of them: for services."""
        self.connections: Connections = Connections(self)
        """Its connectors, made and ended: for services. Applications call `connect` and `disconnect`."""
        self._contexts: dict[str, Context] = {}
        self._numbering = Numbering(lambda name: name in self.registry.components or name in self._contexts)
        self._log_budget = SharedBudget(self.name, lambda: self.call_on_loop(self._summarize_soon))
        self._summary: Cancellable | None = None
        self._timers: Any = None
        self._pool = PoolMonitor(self)
        self.call_at: Callable[[int, Callable[[], None]], Cancellable]
        """Call back at a time of the kernel's clock in nanoseconds (`clock.monotonic_ns`). On the loop only."""
        self._call_later: Callable[[float, Callable[[], None]], Cancellable]
        self.closed = self._ended = False
        """Whether `aclose` was called: nothing new begins."""
        self.closing: asyncio.Future[StopBudget]
        """Done when the kernel begins to close, with the time that is left for it. There once it is open."""
        self._closing: asyncio.Task[None] | None = None
        self._stop_requested = StopRequest()
        self._stop_due = False
        """Whether a stop was requested: contexts leave it more turns of the loop from then on."""
        self._interrupt: BaseException | None = None
        self._remove_probe: Callable[[], None] | None = None

    # -- opening and closing ---------------------------------------------------------------------------------------

    async def open(self) -> Self:
        """Take the running loop; returns the kernel itself. StateError when it is or was open: make another."""
        if self._loop is not None:
            raise StateError(f"{self.name}: is open already, or was; make another Kernel")
        loop = asyncio.get_running_loop()
        clock = self._clock or clock_of(loop)
        self._timers = timers_for(clock)
        self._loop, self._clock, self.thread_id = loop, clock, threading.get_ident()
        # Made once: each look-up of a method makes another, and every connector and context keeps them.
        self.call_at, self._call_later = self._timers.call_at, self.call_later
        self.closing = loop.create_future()
        self.opened_ns = clock.monotonic_ns()
        self._timers.acquire()
        if (add_probe := getattr(clock, "add_probe", None)) is not None:
            self._remove_probe = add_probe(lambda: sum(one.runner.activity() for one in self._contexts.values()))
        embedding.enter(self, loop)
        try:
            attach_services(self, self._planned)
        except BaseException:
            await self.aclose()
            raise
        return self

    async def aclose(self) -> None:
        """End components, stop contexts, disconnect, finalise components, within 5 s; idempotent.

        A component finishes its running cycle, and ends while all ports still work: who calls before who answers, who
        writes before who reads, else and in circles in reverse order. A hook that waits for a sample waits no longer;
        any other gets 2 s, then it is cancelled four times at 0.5 s, then abandoned and reported. A caller that is
        cancelled is cancelled when all is closed. Called by a component of this kernel it is queued.

        Raises:
            ThreadError: called in another thread, or on another loop, than the kernel was opened on.
        """
        if self._loop is None:
            return
        self.check_thread("aclose")
        if asyncio.get_running_loop() is not self._loop:
            raise ThreadError(f"{self.name}: aclose() on another loop than the one it was opened on")
        if self._closing is None:
            self.closed = True
            self._closing = kernel_task(self._loop, self._close(), f"aiorts close {self.name}")
        caller = owner_of(current_task())
        if caller is None or cell(caller).kernel is not self:
            await see_through(self._closing)

    async def _close(self) -> None:
        """Give everything up, in reverse order, within one budget of time."""
        budget, contexts = StopBudget(self.loop), tuple(self.contexts.values())
        self._await_stop()
        self.closing.set_result(budget)
        self.bus.publish(Closing())
        for driver in filter(None, (context.runner.driver for context in contexts)):
            driver.hurry(budget)
        try:
            await self._end_services("closing", budget)
            await self.registry.through(end_members(self, budget))
            for context in reversed(contexts):
                await self.registry.through(context.runner.end(budget))
            await self._end_services("ending", budget)
            guarded("could not disconnect everything", self.connections.end_all)
            await self.registry.through(self.registry.close(budget))
        finally:
            if self._summary is not None:
                self._summary.cancel()
            self._log_budget.summarize()
            services = self.services[::-1]
            notify(services, "stopped")
            await self._end_services("leaving", budget)
            await self.bus.aclose(budget.rest)
            self._timers.release()
            self._pool.close()
            notify(services, "closed")
            self._ended = True
            embedding.leave(self, self.loop)
            if self._remove_probe is not None:
                self._remove_probe()

    async def _end_services(self, hook: TimedHook, budget: StopBudget) -> None:
        """Give each service that asks for it its time, in reverse order."""
        for service in reversed(self.services):
            if getattr(type(service), hook) is not getattr(KernelService, hook):
                await self.registry.through(_end_service(service, hook, budget))

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.aclose()

    def request_stop(self, status: int = 0) -> bool:
        """Request an orderly end, from any thread: `wait_stop_requested` returns. Says whether any code awaited it."""
        self.exit_status = status or int(self._has_faulted)
        self.call_on_loop(self._await_stop)
        return self._stop_requested.awaited

    async def wait_stop_requested(self) -> int:
        """Wait until the end is requested; returns the exit status that was given."""
        self.check_thread("wait_stop_requested")
        await self._stop_requested.wait()
        return self.exit_status

    # -- what there is ---------------------------------------------------------------------------------------------

    @property
    def clock(self) -> Clock:
        """The clock that all periods, time-outs and stamps of this kernel go by."""
        return self._clock if self._clock is not None else SystemClock()

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The loop this kernel was opened on; ClosedError before it is open."""
        if self._loop is None:
            raise ClosedError(f"{self.name}: is not open; use `async with` or await open()")
        return self._loop

    @property
    def components(self) -> Mapping[str, Component]:
        """The components, by name, in order of creation."""
        return MappingProxyType(self.registry.components)

    @property
    def contexts(self) -> Mapping[str, Context]:
        """The contexts that run, by name, in order of start."""
        return MappingProxyType(self._contexts)

    @property
    def connectors(self) -> Mapping[str, Connector]:
        """The connectors, by name, in order of connection."""
        return MappingProxyType(self.connections.connectors)

    @property
    def service_connectors(self) -> Mapping[str, Any]:
        """The connectors of service ports, by name, in order of connection."""
        return MappingProxyType(self.connections.service_connectors)

    def find(self, path: str) -> Component | Port[Any]:
        """The component or port of a path such as "pid0", "pid0.command" or, of this kernel, "kernel/pid0.command".

        Raises:
            InvalidNameError: not a path.
            WiringError: there is no such component or port, and says what there is; or
                the path is of another kernel or host.
        """
        return self.registry.find(path)

    @property
    def state(self) -> str:
        """ "not open", "open", "closing" or "closed"."""
        if self.closed:
            return "closed" if self._ended else "closing"
        return "open" if self._loop is not None else "not open"

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} {self.name} {self.state} {len(self.components)} components "
            f"{len(self._contexts)} contexts {len(self.connectors)} connectors>"
        )

    # -- components ------------------------------------------------------------------------------------------------

    @overload
    async def create(self, kind: type[C], name: str = "", **params: object) -> C: ...

    @overload
    async def create(self, kind: str, name: str = "", **params: object) -> Component: ...

    async def create(self, kind: type[Component] | str, name: str = "", **params: object) -> Component:
        """Make a component of a class, or of a type as text, and add it.

        Args:
            kind: the class, which keeps its type; or "FILE.py:Class" (counted from the current folder),
                "package.module:Class" or a name that a plugin offers.
            name: the instance's; made from the type's by default.
            params: values of parameters.

        Raises:
            PluginError: no such type.
            ConfigurationError: a parameter is bad.
            ComponentError: its constructor raised.
                What `on_initialize` raises.
        """
        self.check_open("create")
        return await self.registry.create(kind, name, params)

    async def add(self, component: C, **params: object) -> C:
        """Take a component in and run its `on_initialize`; returns it.

        Raises:
            InvalidNameError: the name is taken.
            ConfigurationError: a parameter is bad. What `on_initialize` raises:
                then it is not added.
        """
        self.check_open("add")
        return await self.registry.add(component, params)

    async def stand_in(self, path: str, holder: str = "") -> Component:
        """Add what stands here for a component of another kernel; see `Kernel.stand_in`."""
        raise StateError(f"{path}: this kernel reaches no other one")

    async def remove(self, component: Component) -> None:
        """Take a component out: out of its contexts, its ports disconnected, `on_finalize` run.

        Once begun it goes on though the caller is cancelled. Awaited from a hook of the component, or of one that
        shares a context with it, it is queued and returns at once.

        Raises:
            StateError: it is not of this kernel.
            TransitionTimeout: a context did not let go of it; it stays.
        """
        self.check_mine(component, "remove")
        await self.registry.remove(component)

    @property
    def naming(self) -> NamePolicy:
        """How instances without a name are named from now on; "{type}{number}" by default. May be set at any time.

        Raises:
            DeclarationError: it is set to something that is no NamePolicy.
        """
        return self._naming

    @naming.setter
    def naming(self, policy: NamePolicy) -> None:
        if not isinstance(policy, NamePolicy):
            raise DeclarationError(f"naming = {policy!r}: expected NamePolicy(...)")
        self._naming = policy

    def _free_name(self, stem: str) -> str:
        return self._numbering.lowest(stem.lower())

    def _instance_name(self, kind: type) -> str:
        if self._naming.plain:
            return self._free_name(kind.__name__)
        return naming.instance_name(self, kind, self._naming)

    # -- services --------------------------------------------------------------------------------------------------

    @property
    def services(self) -> tuple[KernelService, ...]:
        """The services attached so far, in the order in which they were made."""
        return tuple(self._services.values())

    def service(self, kind: type[S]) -> S:
        """The service of this kind; made and attached at the first call.

        Raises:
            ClosedError: there is none yet, and the kernel is not open.
            ThreadError: not on the kernel's loop.
        """
        found = self._services.get(kind)
        if found is None:
            self.check_open(f"attach {kind.__name__}")
            found = self._services[kind] = kind(self)
        return cast("S", found)

    def attached(self, kind: type[S]) -> S | None:
        """The service of this kind; None where it has not been made yet."""
        return cast("S | None", self._services.get(kind))

    def html_of(self, thing: Component | Port[Any]) -> str | None:
        """How a notebook shows a component or a port; None: by its repr."""
        return None

    def monitor_deadlines(self, context: Context) -> DeadlineTimer | None:
        """Finds out why a context is late, called in the thread that runs it; None where nothing does."""
        return None

    # -- connecting ------------------------------------------------------------------------------------------------

    @overload
    async def connect(
        self, one: End[Made] | str, two: End[Made] | str, /, **options: Unpack[ConnectOptions]
    ) -> Made: ...

    @overload
    async def connect(
        self,
        one: End[Made] | str,
        two: End[Made] | str,
        three: End[Made] | str,
        /,
        *more: End[Made] | str,
        **options: Unpack[ConnectOptions],
    ) -> Connection[Made]: ...

    async def connect(
        self, one: End[Made] | str, two: End[Made] | str, /, *more: End[Made] | str, **options: Unpack[ConnectOptions]
    ) -> Made | Connection[Made]:
        """Connect ports: every out-port with every in-port, or required interfaces with provided ones, all or none.

        A port is given itself or by its path ("pid0.command", or "station/monitor.inp" in another process). A type
        checker takes two paths for those of data ports.

        Returns the connector, or the `Connection` of them when more than two ports were given; with the option `adapt`
        that to the reader.

        Args:
            options: those of `aiorts.ConnectOptions`, where each is described with its values; system files have the
                same. OpenRTM's keys are aliases; `openrtm={"dataport.push_policy": "new"}` takes those with dots.

        Raises:
            InvalidNameError: a text is no path.
            WiringError: says which ports or options do not go together and why; nothing was connected. With `adapt`
                also: there are several ways (it names them), or the reader is in no context.
            PluginError: `convert` is a text that finds no converter, or no plugin offers one for `adapt`.
        """
        made: Made | Connection[Made] = await self._connect((one, two, *more), options)
        return made

    async def _connect(self, ports: Sequence[End[Any] | str], options: Mapping[str, Any]) -> Any:
        self.check_open("connect")
        if isinstance(text := options.get("convert"), str):
            from aiorts.kernel.extensions.converters import load_converter  # late: few connectors have one

            options = {**options, "convert": await load_converter(text, self.plugins, self.clock)}
            self.check_open("connect")  # it may have closed meanwhile
        made = self.connections.make(ports, options)
        return joined(made, self.connections) if len(ports) > 2 else made[0]

    async def disconnect(self, connector: Any) -> None:
        """End a connector, or all of a `Connection`. Idempotent.

        What is queued is dropped as disconnected, who waits goes on, calls end.

        Raises:
            WiringError: it is of another kernel; nothing was ended.
        """
        self.check_open("disconnect")
        if isinstance(connector, Connection):
            self.connections.end_whole(connector)
        else:
            self.connections.check_mine(connector)
            self.connections.end(connector)

    # -- contexts --------------------------------------------------------------------------------------------------

    async def start(self, context: X, *components: Component, activate: bool = False, timeout: float | None = 5.0) -> X:
        """Start an execution context with these members, in this order of execution; returns it.

        Args:
            activate: have the members active before the first cycle.
            timeout: seconds of the kernel's clock for `on_startup` and `on_activated` of all of them; None is forever.

        Called by a hook of one of the components it does not wait for what that hook is in the way of. A caller that
        is cancelled leaves no context behind.

        Raises:
            ConfigurationError: `timeout` is no time above 0; nothing was changed.
            StateError: the context runs already, or a component cannot run in it.
            ComponentError: with `activate`, `on_activated` raised; the context runs all the same.
            TransitionTimeout: a hook did not return within `timeout` seconds; the context runs all the same, and in it
                the hook, until it returns or the context is stopped. Activations that had not begun are withdrawn.
        """
        self.check_open("start")
        _checked("start: timeout", timeout)
        start_context.check_start(self, context, components)
        self._contexts[context.name] = context
        await start_context.start(self, context, components, activate=activate, timeout=timeout)
        return context

    async def stop(self, context: Context) -> None:
        """Stop one context: see `Context.stop`. StateError: another kernel runs it."""
        self.check_open("stop")
        context.runner.check_kernel(self)
        await context.stop()

    async def activate(
        self, component: Component | str, *, context: Context | str | None = None, timeout: float | None = 5.0
    ) -> None:
        """Activate a component, given itself or by its path, in the context in which it is: see `Context.activate`.

        Args:
            context: where the component is in several contexts, the one that is meant, itself or by its name.
            timeout: seconds of the kernel's clock; None waits forever.

        Raises:
            WiringError: there is no component of that path, and says what there is.
            StateError: the component is in no context, or in several and none is named, or not inactive.
                What `Context.activate` raises.
        """
        await start_context.request(self, "activate", component, context, timeout)

    async def deactivate(
        self, component: Component | str, *, context: Context | str | None = None, timeout: float | None = 5.0
    ) -> None:
        """Deactivate a component, given as for `activate`: see `Context.deactivate`."""
        await start_context.request(self, "deactivate", component, context, timeout)

    async def reset(
        self, component: Component | str, *, context: Context | str | None = None, timeout: float | None = 5.0
    ) -> None:
        """Take a component, given as for `activate`, out of error into inactive: see `Context.reset`."""
        await start_context.request(self, "reset", component, context, timeout)

    async def sleep(self, seconds: float) -> None:
        """Wait on the kernel's clock; a negative time is 0. ValueError for NaN and infinities."""
        self.check_thread("sleep")  # also while it closes: hooks may still wait
        await sleep(self.clock, seconds)

    # -- threads ---------------------------------------------------------------------------------------------------

    def on_loop_thread(self) -> bool:
        """Whether this is the thread of the kernel's loop."""
        return self.thread_id is None or threading.get_ident() == self.thread_id

    def check_thread(self, what: str) -> None:
        """Raise ThreadError unless this is the thread of the kernel's loop."""
        if not self.on_loop_thread():
            raise ThreadError(
                f"{self.name}: {what} called from thread {threading.current_thread().name!r}; "
                "call it on the kernel's loop (asyncio.run_coroutine_threadsafe)"
            )

    def call_on_loop(self, callback: Callable[[], object]) -> None:
        """Call back on the loop: now in its thread, soon from another; not at all once the loop is closed."""
        if self.on_loop_thread():
            callback()
        elif self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(callback)

    @overload
    def call_from_thread(
        self, function: Callable[[*Ts], Awaitable[T]], *args: *Ts, timeout: float | None = None
    ) -> T: ...

    @overload
    def call_from_thread(self, function: Callable[[*Ts], T], *args: *Ts, timeout: float | None = None) -> T: ...

    def call_from_thread(self, function: Callable[[*Ts], Any], *args: *Ts, timeout: float | None = None) -> Any:
        """Call a function on the loop, from another thread, which blocks; returns or raises what the function does.

        What the function returns is awaited if it can be.

        Args:
            timeout: seconds of real time, from now on; None waits forever.

        Raises:
            CallTimeout: the function was not done in time. It is not called if it had not begun, else cancelled.
            ThreadError: called on the loop's own thread, which would wait for itself.
            ClosedError: the kernel is not open, or closes; a function that has begun is cancelled then.
            ConfigurationError: `timeout` is no time above 0.
        """
        _checked("call_from_thread: timeout", timeout)
        if self._loop is not None and self.on_loop_thread():
            raise ThreadError(f"{self.name}: call_from_thread() would block the event loop; call the function itself")
        return calls.call_from_thread(self, function, args, timeout)

    def _await_stop(self) -> None:
        """Whether the end was requested, or has begun."""
        self._stop_due = True
        self._stop_requested.set()

    def check_open(self, what: str) -> None:
        """Raise ClosedError unless it is open; `what` names the caller's request. ThreadError in another thread."""
        self.check_thread(what)
        if self._loop is None or self.closed:
            why = "is closed" if self.closed else "is not open; use `async with` or await open()"
            raise ClosedError(f"{self.name}: cannot {what}: {why}")

    def check_reachable(self, what: str) -> None:
        """As `check_open`; but it may be closing: what still runs then can be asked."""
        if self.state == "closing":
            self.check_thread(what)
        else:
            self.check_open(what)

    def check_mine(self, component: Component, what: str) -> None:
        """Raise StateError unless this is a component of this kernel, which is open."""
        self.check_open(what)
        name = getattr(component, "name", None) or shown(component)
        if self.components.get(name, name) is not component:
            raise StateError(self.registry.stranger(component, name, self.name))

    # -- called by components, contexts and ports ------------------------------------------------------------------

    def time_ns(self) -> int:
        """The kernel clock's time, nanoseconds since the epoch."""
        return self.clock.time_ns()

    def call_later(self, seconds: float, callback: Callable[[], None]) -> Cancellable:
        """Call back after `seconds` of the kernel's clock."""
        self.check_thread("call_later")
        return cast("Cancellable", self._timers.call_at(self.clock.monotonic_ns() + to_ns(seconds), callback))

    def _context_ended(self, context: Context) -> None:
        if self._contexts.get(context.name) is context:
            del self._contexts[context.name]
            self._numbering.free(context.name)

    def _hooks_wanted_changed(self) -> None:
        notify(self.services, "observers_changed")
        for context in tuple(self._contexts.values()):
            context.runner.observers_changed()

    def _faulted(self) -> None:
        """The kernel's own code has failed, and the run with it, however well the rest goes on. From any thread."""
        self._has_faulted = True
        self.exit_status = self.exit_status or 1

    def pass_on_interrupt(self, error: BaseException) -> None:
        """A hook raised KeyboardInterrupt: raise it in the loop, once, unless the kernel contains interrupts.

        From any thread.
        """
        if not self._contain_interrupts and self._interrupt is not error:
            self._interrupt = error
            self.loop.call_soon_threadsafe(throw, error)

    def _summarize_soon(self) -> None:
        """Log lines of this second were dropped: say so when it is over. In the loop's thread."""
        if not self.closed:
            self._summary = self.call_later(1.0, self._log_budget.summarize)


async def _end_service(service: KernelService, hook: TimedHook, budget: StopBudget) -> None:
    """Run this hook; what it raises is logged, and one that takes longer than the kernel has is abandoned."""
    task = kernel_task(service.kernel.loop, getattr(service, hook)(budget), f"aiorts {hook} {type(service).__name__}")
    if not (await asyncio.wait({task}, timeout=budget.left))[0]:
        task.cancel()
        await asyncio.wait({task}, timeout=budget.grace)
        report_fault(service, hook, TimeoutError("it was still running when the kernel's time was over"))
    elif not task.cancelled() and (error := task.exception()) is not None:
        report_fault(service, hook, error)


def _checked(what: str, seconds: float | None) -> float | None:
    """Raise ConfigurationError unless it is a time above 0, or None, which is forever."""
    number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    if seconds is not None and not (number and 0 < seconds < math.inf):
        raise ConfigurationError(f"{what} = {seconds!r}: expected seconds above 0, or None")
    return seconds
