"""The kernel: it owns components, contexts and connectors, and gives them up in reverse order.

It knows no concrete context, transport, format or command. There are as many kernels as you like in a process and on a
loop; each belongs to the thread and loop it was opened in, where everything that changes the system is called.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Mapping
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar, cast, overload

from aiorts.clock import Clock, SystemClock, current_clock
from aiorts.errors import ClosedError, StateError, ThreadError
from aiorts.kernel import embedding, joint
from aiorts.kernel.bus import Bus
from aiorts.kernel.catalogue import Catalogue
from aiorts.kernel.closing import close
from aiorts.kernel.component import Component
from aiorts.kernel.configuration_files import ConfigurationFiles
from aiorts.kernel.connections import Connections
from aiorts.kernel.context import Context
from aiorts.kernel.deadlines import StopBudget
from aiorts.kernel.deadman import Deadman
from aiorts.kernel.introspection import Introspection
from aiorts.kernel.log import SharedBudget
from aiorts.kernel.pool import PoolWatch
from aiorts.kernel.ports import Port, Service
from aiorts.kernel.roster import Roster
from aiorts.kernel.supervising import Supervising
from aiorts.kernel.tasks import current_task, kernel_task, owner_of, see_through, throw
from aiorts.kernel.timers import sleep, timers_for
from aiorts.model.blame import GcPauses
from aiorts.model.names import check_name
from aiorts.model.numbering import Numbering

if TYPE_CHECKING:
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.host import Cancellable
    from aiorts.kernel.service_port import Made, ServiceConnector

__all__ = ("Kernel",)

C = TypeVar("C", bound=Component)
X = TypeVar("X", bound=Context)


class Kernel(ConfigurationFiles, Introspection, Supervising):
    """Owner of a system: `async with Kernel() as kernel:`, or `await Kernel().open()` and `await kernel.aclose()`.

    Args:
        name: for logs and paths.
        clock: SystemClock by default; on a simulated loop that loop's clock.
        debug: check the thread of every port call, copy every sample: slow; finds writers that change what they wrote.
        contain_interrupts: a KeyboardInterrupt raised in a hook is that component's error and goes no further (`aiorts
            run` takes SIGINT itself). By default it is passed on after the component went to error.
        plugins: where types asked for by name come from; installed packages by default.
    """

    def __init__(
        self,
        name: str = "kernel",
        *,
        clock: Clock | None = None,
        debug: bool = False,
        contain_interrupts: bool = False,
        plugins: Catalogue | None = None,
    ) -> None:
        self.name = check_name(name, "kernel")
        self.debug = debug
        self.bus = Bus(self._hooks_wanted_changed, self.check_thread)
        self.exit_status = 0
        """What `request_stop` said."""
        self.plugins = Catalogue.default() if plugins is None else plugins
        self._clock = clock
        self._contain_interrupts = contain_interrupts
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread_id: int | None = None
        self._roster = Roster(self)
        self._connections = Connections(self)
        self._contexts: dict[str, Context] = {}
        self._numbering = Numbering(lambda name: name in self._roster.components or name in self._contexts)
        self._log_budget = SharedBudget(self.name, lambda: self._on_loop(self._summarize_soon))
        self._summary: Cancellable | None = None
        self._timers: Any = None
        self._deadman = Deadman(self)
        self._pool = PoolWatch(self)
        self._clock_ns: Callable[[], int]
        self._call_at: Callable[[int, Callable[[], None]], Cancellable]
        self._call_later: Callable[[float, Callable[[], None]], Cancellable]
        self._closed = False
        self._closing: asyncio.Task[None] | None = None
        self._closing_begun: asyncio.Future[StopBudget]
        self._stop_requested = asyncio.Event()
        self._interrupt: KeyboardInterrupt | None = None
        self._remove_probe: Callable[[], None] | None = None

    # -- opening and closing ---------------------------------------------------------------------------------------

    async def open(self) -> Self:
        """Take the running loop; returns the kernel itself. StateError when it is or was open: make another."""
        if self._loop is not None:
            raise StateError(f"{self.name}: is open already, or was; make another Kernel")
        loop = asyncio.get_running_loop()
        clock = self._clock or current_clock() or SystemClock()
        self._timers = timers_for(clock)
        self._loop, self._clock, self._thread_id = loop, clock, threading.get_ident()
        # Made once: each look-up of a method makes another, and every connector and context keeps them.
        self._clock_ns, self._call_at, self._call_later = clock.time_ns, self._timers.call_at, self.call_later
        self._closing_begun = loop.create_future()
        self._opened_ns = clock.monotonic_ns()
        self._timers.acquire()
        add_probe = getattr(clock, "add_probe", None)
        if add_probe is not None:
            self._remove_probe = add_probe(lambda: sum(context._activity() for context in self._contexts.values()))
        embedding.enter(self, loop)
        return self

    async def aclose(self) -> None:
        """Stop contexts, disconnect, finalise components, each in reverse order, within 5 s; idempotent.

        A hook gets 2 s, then it is cancelled four times at 0.5 s, then left behind and reported. A caller that is
        cancelled is cancelled when all is closed. Called by a component of this kernel it is queued and returns at
        once.
        """
        if self._loop is None:
            return
        self.check_thread("aclose")
        if asyncio.get_running_loop() is not self._loop:
            raise ThreadError(f"{self.name}: aclose() on another loop than the one it was opened on")
        if self._closing is None:
            self._closed = True
            self._closing = kernel_task(self._loop, close(self), f"aiorts close {self.name}")
        caller = owner_of(current_task())
        if caller is None or caller._rt_kernel is not self:
            await see_through(self._closing)

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
        """The loop this kernel was opened on."""
        if self._loop is None:
            raise ClosedError(f"{self.name}: is not open; use `async with` or await open()")
        return self._loop

    @property
    def components(self) -> Mapping[str, Component]:
        """The components, by name, in order of creation."""
        return MappingProxyType(self._roster.components)

    @property
    def contexts(self) -> Mapping[str, Context]:
        """The contexts that run, by name, in order of start."""
        return MappingProxyType(self._contexts)

    @property
    def connectors(self) -> Mapping[str, Connector]:
        """The connectors, by name, in order of connection."""
        return MappingProxyType(self._connections.connectors)

    @property
    def service_connectors(self) -> Mapping[str, ServiceConnector]:
        """The connectors of service ports, by name, in order of connection."""
        return MappingProxyType(self._connections.service_connectors)

    @property
    def gc_pauses(self) -> Mapping[int, GcPauses]:
        """Garbage collections by generation, while a context with a rate ran: nothing else runs meanwhile."""
        return self._deadman.gc_pauses

    def find(self, path: str) -> Component | Port[Any]:
        """The component or port of a path such as "pid0" or "pid0.command".

        Raises:
            InvalidNameError: not a path. WiringError: there is no such component or port; says what there is.
        """
        return self._roster.find(path)

    def __repr__(self) -> str:
        state = "closed" if self._closed else "open" if self._loop is not None else "not open"
        return (
            f"<Kernel {self.name} {state} {len(self.components)} components {len(self._contexts)} contexts "
            f"{len(self.connectors)} connectors>"
        )

    # -- components ------------------------------------------------------------------------------------------------

    @overload
    async def create(self, kind: type[C], name: str = "", **params: object) -> C: ...

    @overload
    async def create(self, kind: str, name: str = "", **params: object) -> Component: ...

    async def create(self, kind: type[Component] | str, name: str = "", **params: object) -> Component:
        """Make a component of a class, or of a type that an installed package offers by name, and add it.

        Args:
            kind: the class, which keeps its type, or the name. name: the instance's; made from the type's by default.
            params: values of parameters.

        Raises:
            PluginError: no such type. ConfigurationError: a parameter is bad. What `on_initialize` raises.
        """
        self._require_open("create")
        return await self._roster.create(kind, name, params)

    async def add(self, component: C, **params: object) -> C:
        """Take a component in and run its `on_initialize`; returns it.

        Raises:
            InvalidNameError: the name is taken. ConfigurationError: a parameter is bad. What `on_initialize` raises:
                then it is not added.
        """
        self._require_open("add")
        return await self._roster.add(component, params)

    async def remove(self, component: Component) -> None:
        """Take a component out: out of its contexts, its ports disconnected, `on_finalize` run.

        Once begun it goes on though the caller is cancelled. Awaited from a hook of the component, or of one that
        shares a context with it, it is queued and returns at once.

        Raises:
            StateError: it is not of this kernel. TransitionTimeout: a context did not let go of it; it stays.
        """
        self._check_mine(component, "remove")
        await self._roster.remove(component)

    def _free_name(self, stem: str) -> str:
        return self._numbering.lowest(stem.lower())

    # -- connecting ------------------------------------------------------------------------------------------------

    @overload
    async def connect(self, one: Service, two: Service, /, **options: Any) -> ServiceConnector: ...

    @overload
    async def connect(self, one: Service, two: Service, three: Service, /, *more: Service, **options: Any) -> Made: ...

    @overload
    async def connect(self, one: Port[Any], two: Port[Any], /, **options: Any) -> Connector: ...

    @overload
    async def connect(
        self, one: Port[Any], two: Port[Any], three: Port[Any], /, *more: Port[Any], **options: Any
    ) -> tuple[Connector, ...]: ...

    async def connect(
        self, one: Port[Any] | Service, two: Port[Any] | Service, /, *more: Port[Any] | Service, **options: Any
    ) -> Any:
        """Connect ports: every out-port with every in-port, or required interfaces with provided ones, all or none.

        Returns the connector, or a tuple of them when more than two ports were given. Options (the same keys in system
        files and profiles; OpenRTM's keys are aliases):
            dataflow: "push", or "pull": the reader asks, the writer's latest unread sample is taken.
            subscription: "flush", "new", "periodic". push: "all", "fifo", "skip", "new".
            push_rate: Hz, for periodic. skip: n, send every (n + 1)-th.
            length: samples the reader's buffer holds, 1 to 1,000,000. out_length: the backlog of a periodic connector.
            full: "overwrite", "reject", "block". timeout: seconds an awaited write waits with block; None for ever.
            stamp: "send", "received", "read": when `tm` is set to the kernel's clock.
            measure: n, time the last n sends (`Connector.timing`); 0 times nothing.
            name: the connector's. allow_duplicate: a second connector between the same two ports.
        Of service ports: mapping: which provided interface answers a required one, by path or name, where its type
            does not tell. strict: False leaves unbound what nobody answers. name.

        Raises:
            WiringError: says which ports or options do not go together and why; nothing was connected.
        """
        self._require_open("connect")
        made = self._connections.make((one, two, *more), options)
        return tuple(made) if more else made[0]

    async def disconnect(self, connector: Connector | ServiceConnector) -> None:
        """End a connector: what is queued is dropped as disconnected, who waits goes on, calls end. Idempotent."""
        self._require_open("disconnect")
        self._connections.check_mine(connector)
        self._connections.end(connector)

    # -- contexts --------------------------------------------------------------------------------------------------

    async def start(self, context: X, *components: Component, activate: bool = False) -> X:
        """Start an execution context with these members, in this order of execution; returns it.

        Args:
            activate: have the members active before the first cycle.

        Called by a hook of one of the components it does not wait for what that hook is in the way of. A caller that
        is cancelled leaves no context behind.

        Raises:
            StateError: the context runs already, or a component cannot run in it.
            ComponentError: with `activate`, `on_activated` raised; the context runs all the same.
        """
        self._require_open("start")
        joint.check_start(self, context, components)
        self._contexts[context.name] = context
        await joint.start(self, context, components, activate=activate)
        return context

    async def stop(self, context: Context) -> None:
        """Stop one context: see `Context.stop`. StateError: another kernel runs it."""
        self._require_open("stop")
        await context._of(self).stop()

    async def sleep(self, seconds: float) -> None:
        """Wait on the kernel's clock; a negative time is 0. ValueError for NaN and infinities."""
        self.check_thread("sleep")  # also while it closes: hooks may still wait
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
        if self._loop is None or self._closed:
            why = "is closed" if self._closed else "is not open; use `async with` or await open()"
            raise ClosedError(f"{self.name}: cannot {what}: {why}")

    def _check_mine(self, component: Component, what: str) -> None:
        self._require_open(what)
        if self.components.get(name := getattr(component, "name", repr(component)), name) is not component:
            raise StateError(self._roster.stranger(component, name, self.name))

    # -- called by components, contexts and ports ------------------------------------------------------------------

    def time_ns(self) -> int:
        """The kernel clock's time, nanoseconds since the epoch."""
        return self.clock.time_ns()

    def call_later(self, seconds: float, callback: Callable[[], None]) -> Cancellable:
        """Call back after `seconds` of the kernel's clock."""
        self.check_thread("call_later")
        return cast("Cancellable", self._timers.call_at(self.clock.monotonic_ns() + round(seconds * 1e9), callback))

    def _context_ended(self, context: Context) -> None:
        if self._contexts.get(context.name) is context:
            del self._contexts[context.name]
            self._numbering.free(context.name)

    def _hooks_wanted_changed(self) -> None:
        if self.bus.samples_wanted or "listening" in vars(self):
            self.listening.all_wanted(self.bus.samples_wanted)
        for context in tuple(self._contexts.values()):
            if context._driver is not None:
                context._driver.beware()

    def _interrupted(self, error: KeyboardInterrupt) -> None:
        """From any thread; once for each interrupt."""
        if not self._contain_interrupts and self._interrupt is not error:
            self._interrupt = error
            self.loop.call_soon_threadsafe(throw, error)

    def _summarize_soon(self) -> None:
        """Log lines of this second were dropped: say so when it is over. In the loop's thread."""
        if not self._closed:
            self._summary = self.call_later(1.0, self._log_budget.summarize)
