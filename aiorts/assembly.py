"""Makes `Kernel`: the microkernel with the services of aiorts, each of which is made at its first use.

Each method here documents an action, and calls the package that carries the action out.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, overload

from aiorts.errors import DeclarationError
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import kinds_of
from aiorts.kernel.execution.cell import flattened
from aiorts.kernel.execution.context import Context
from aiorts.kernel.microkernel import Microkernel

if TYPE_CHECKING:
    from aiorts.configuration import ConfigurationFiles
    from aiorts.diagnostics import ContextTimer, DeadlineMonitor, LoopStalls
    from aiorts.isolation import Limits
    from aiorts.kernel.ports import OutPort, Port
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.port import End
    from aiorts.model.blame import GcPauses
    from aiorts.model.configuration.sets import Difference
    from aiorts.model.wanted.applied import Applied
    from aiorts.model.wanted.entries import Wanted
    from aiorts.observe import Changes, ConnectorEvent, Introspection, Listening, Monitor, Samples, SystemProfile
    from aiorts.reload import Reloaded
    from aiorts.supervision import StartRule, Supervised, Supervising, Supervision

T = TypeVar("T")
X = TypeVar("X", bound=Context)


class Kernel(Microkernel):
    """Owner of a system: `async with Kernel() as kernel:`, or `await Kernel().open()` and `await kernel.aclose()`.

    Args:
        name: for logs and paths.
        clock: a SystemClock by default; on a loop that keeps time itself, such as a simulated one, the loop's clock.
        debug: check the thread of every port call and copy every sample: slow, but finds writers that change a written
            one.
        contain_interrupts: a KeyboardInterrupt raised in a hook is that component's error and goes no further (`aiorts
            run` takes SIGINT itself). By default it is passed on after the component went to error.
        initialize_timeout: seconds of the kernel's clock that an `on_initialize` may take; None waits forever (`aiorts
            run`: 30). A longer one is cancelled (one that blocks is refused when it returns), and its component is not
            added.
        plugins: the source of types that are requested by name; installed packages by default.
        services: the services to attach when the kernel opens: by the name that a plugin offers, the settings.

    Raises:
        PluginError: no plugin offers a service of that name.
        ConfigurationError: names each setting that is wrong.
    """

    _deadlines: DeadlineMonitor | None = None
    _supervision: Supervising | None = None

    async def start(self, context: X, *components: Component, activate: bool = False, timeout: float | None = 5.0) -> X:
        if self._deadlines is None:
            from aiorts.diagnostics import DeadlineMonitor

            self._deadlines = self.service(DeadlineMonitor)
        run = flattened([one for one in components if isinstance(one, Component)])
        for component in run:
            for kind in kinds_of(component):
                context = kind.placed(component, context, run)
        return await super().start(context, *components, activate=activate, timeout=timeout)

    start.__doc__ = Microkernel.start.__doc__

    async def _connect(self, ports: Sequence[End[Any] | str], options: Mapping[str, Any]) -> Any:
        if options.get("adapt"):
            self.check_open("connect")
            from aiorts.adapting import connect_adapted  # late: few connectors have a filter between

            return await connect_adapted(self, ports, options)
        if self.connections.far is not None or any(
            isinstance(port, str) and self.registry.is_elsewhere(port) for port in ports
        ):
            self.check_open("connect")
            from aiorts.links import Links  # late: few systems have links

            return await self.service(Links).connect(super()._connect, ports, options)
        return await super()._connect(ports, options)

    async def create_isolated(
        self, kind: type[Component] | str, name: str = "", *, limits: Limits | None = None, **params: object
    ) -> Component:
        """Make a component that runs in a process of its own, and add its stand-in here.

        The stand-in has the component's ports, parameters and lifecycle, and is started in a context of its own kind as
        any other component; its connectors are links. When the process ends, the stand-in goes to error; a reset starts
        another process. On a simulated clock the component runs in this process, which is logged once.

        Args:
            kind, name, params: as `create`; the process has to be able to import the class.
            limits: what the process may use, `aiorts.isolation.Limits(memory=, cpu=, processes=)`.

        Raises:
            DeclarationError: the class is of `__main__`, or was made in a function.
            ProcessError: the process cannot be started, or has not come up within 10 s. Also the errors of `create`.
        """
        self.check_open("create_isolated")
        from aiorts.isolation import Isolation  # late: few kernels have processes

        return await self.service(Isolation).create(kind, name, _plain(limits), params)

    async def stand_in(self, path: str, holder: str = "") -> Component:
        """Add a stand-in for a component of another kernel, under the component's name.

        The stand-in has the component's data ports and parameters, and is started in a context here, such as with a
        composite. Changes of lifecycle and configuration are requested of that kernel, and show here. When that kernel
        is lost, the stand-in is in error, until a reset that finds the kernel again. When the stand-in leaves its
        context, the component is active in its own kernel only if it was before; it is never removed there.

        Args:
            path: "kernel/component", or "host/kernel/component".
            holder: the composite that the stand-in becomes a member of.

        Raises:
            LinkError: there is no such kernel within 3 s.
            StateError: that kernel has no such component, or it is a member of a composite already, or there is a
                component of that name here.
            DeniedError: that kernel allows this one to look, and no more.
        """
        self.check_open("stand_in")
        from aiorts.remote import stand_in  # late: few kernels have members elsewhere

        return await stand_in(self, path, holder)

    async def move(
        self, component: Component, to: Context | Literal["process"], *, limits: Limits | None = None
    ) -> Component:
        """Move a component to another context, or into a process of its own and back, while the system runs.

        The component is deactivated in the old place and activated in the new one: `on_deactivated` and `on_shutdown`
        run in the old, `on_startup` and `on_activated` in the new. Its in-ports take samples all the time. Between
        contexts of this kernel it stays the same instance.

        A move to or from a process makes a new instance: its `on_initialize` runs first, while the old instance still
        runs; the old one's `on_finalize` runs at the end. Parameters, sets and attributes go to the new instance;
        attributes have to be plain data, arrays and records, unless `on_reload` takes over what it needs of them. Its
        connectors are made again under their names, with their unread samples, in order. Calls in progress end with
        ServiceUnavailable.

        Args:
            to: a context of this kernel, which is started where it does not run yet; or "process".
            limits: what its process may use, as in `create_isolated`.

        Returns:
            The handle from now on. If it is a new one, the old one raises StateError at each use.

        Raises:
            StateError: the component cannot be moved; the text says why, and nothing was changed.
            WiringError: one of its connectors cannot reach into another process; nothing was changed.
            TransitionTimeout: its written samples did not arrive in time; it goes on in the old place. Also errors of
                making or starting the new instance: the component goes on in the old place.
        """
        self.check_open("move")
        from aiorts.isolation import move  # late: few systems do

        return await move(self, component, to, _plain(limits))

    def monitor_deadlines(self, context: Context) -> ContextTimer | None:
        return None if self._deadlines is None else self._deadlines.monitor(context)

    def _hooks_wanted_changed(self) -> None:
        if self.bus.samples_wanted:
            _ = self._introspection  # introspection sees to listeners of samples
        super()._hooks_wanted_changed()

    # -- the services, made on first use ---------------------------------------------------------------------------

    @property
    def _introspection(self) -> Introspection:
        from aiorts.observe import Introspection

        return self.service(Introspection)

    @property
    def _supervising(self) -> Supervising:
        if self._supervision is None:
            from aiorts.supervision import Supervising

            self._supervision = self.service(Supervising)
        return self._supervision

    @property
    def _configuration(self) -> ConfigurationFiles:
        from aiorts.configuration import ConfigurationFiles

        return self.service(ConfigurationFiles)

    # -- what it is, and how it changes -----------------------------------------------------------------------------

    def profile(self) -> SystemProfile:
        """The whole system at this moment, as frozen values; `to_json()` makes one document of it.

        Raises:
            ClosedError: the kernel was never opened.
            ThreadError: called in another thread than the kernel's.
        """
        from aiorts.observe import system_profile

        self.check_thread("profile")
        self.loop  # noqa: B018 - raises ClosedError
        return system_profile(self)

    async def profile_in_turns(self, hold: float = 0.001) -> SystemProfile:
        """The profile, without holding the loop for longer than `hold` seconds (and one component) at a time.

        Values that events report are those at the return; counters are read between the call and the return.
        """
        from aiorts.observe import system_profile_in_turns

        self.check_open("profile_in_turns")
        return await system_profile_in_turns(self, hold)

    def changes(self, *, length: int = 1024) -> Changes:
        """The system, and then each change of it: an async iterator of `ProfileSnapshot` and `Change`.

        The first is a `ProfileSnapshot`. Applied one after the other (`profile = change.apply(profile)`) the changes
        give the profile of each moment, except for values that change without an event (`SystemProfile.structure`).

        Args:
            length: the most changes that wait for a slow reader; when there are more, a new snapshot replaces them.

        Raises:
            ClosedError: the kernel is not open.
            ConfigurationError: the length is out of range.
        """
        self.check_open("changes")
        return self._introspection.changes(length)

    def monitor(self, paths: Sequence[str], rate: float = 10.0) -> Monitor:
        """Values such as "pid0.command.data", "pid0.gain", "loop.lateness" at a rate: an async iterator of `Reading`.

        Nothing is disturbed: no sample is taken, missed readings are counted. `monitor.py` lists what can be named.

        Args:
            rate: Hz on the kernel's clock, up to 10,000.

        Raises:
            WiringError: there is no such value now.
            ConfigurationError: the rate is out of range.
            ClosedError: not open.
        """
        self.check_open("monitor")
        return self._introspection.monitor(paths, rate)

    @overload
    def samples(self, port: OutPort[T], *, keep_last: bool = False, length: int = 64) -> Samples[T]: ...

    @overload
    def samples(self, port: str, *, keep_last: bool = False, length: int = 64) -> Samples[Any]: ...

    def samples(self, port: OutPort[Any] | str, *, keep_last: bool = False, length: int = 64) -> Samples[Any]:
        """The samples that an out-port writes from now on: `async for sample in kernel.samples("tank.level")`.

        Nothing in the system changes: no connector is made, no writer waits. Ports of stand-ins and of components in
        other processes work, too. The iterator ends with the kernel, with the port, and when the `async for` is left.

        Args:
            port: an out-port, or its path.
            keep_last: begin with the last sample that the port wrote before the call.
            length: the most samples that wait for a slow reader; beyond that the oldest are dropped and counted in
                `dropped`.

        Raises:
            WiringError: `port` is no out-port of this kernel.
            ConfigurationError: the length is out of range.
            ClosedError: the kernel is not open.
        """
        self.check_open("samples")
        return self._introspection.samples(port, {"length": length, "keep_last": keep_last})

    def heartbeat(self, interval: float = 1.0) -> Callable[[], None]:
        """Send a ContextBeat of each context and a ComponentBeat of each component at this interval, in seconds of
        the kernel's clock, until the returned function is called or the kernel closes.

        Raises:
            ConfigurationError: the interval is not from 0.001 to 86,400.
            ClosedError: the kernel is not open.
        """
        self.check_open("heartbeat")
        return self._introspection.heartbeat(interval)

    def listen(
        self, connector: Connector, listener: Callable[[ConnectorEvent], object], *kinds: str
    ) -> Callable[[], None]:
        """Call `listener` for each event of a connector's samples, until the returned function is called.

        The calls come on the loop, soon after the event, in order. An exception of a listener is counted and affects
        nothing else. A connector with a listener is slower; all others are not. For all
        connectors: `bus.subscribe(ConnectorEvent, listener)`.

        Args:
            kinds: of `ConnectorEventKind`; all by default.

        Raises:
            StateError: the connector is not of this kernel, or a real-time thread uses it.
        """
        self.check_thread("listen")
        return self._introspection.listening.add(connector, listener, kinds)

    @property
    def listening(self) -> Listening:
        """The listeners of connectors."""
        return self._introspection.listening

    # -- components that fail, and new code -------------------------------------------------------------------------

    def supervise(
        self, component: Component, policy: Supervision, *, factory: Callable[[str], Component] | None = None
    ) -> Supervised:
        """Set what is done when this component fails, and how long its hooks may take; replaces an earlier policy.

        Args:
            policy: see `Supervision`. A new deadline counts from now on for a hook that runs already, too.
            factory: makes a new instance of the given name, for "restart"; the component's class by default.

        Raises:
            StateError: it is not of this kernel.
            DeclarationError: `policy` is no Supervision, `factory` is no function, or `policy` restarts a composite or
                gives it deadlines: that is for its members; a composite can be reset.
        """
        self.check_mine(component, "supervise")
        return self._supervising.supervise(component, policy, factory)

    @property
    def supervised(self) -> Mapping[str, Supervised]:
        """The supervised components, by name; a component that could not be restarted stays here, exhausted."""
        return MappingProxyType({}) if self._supervision is None else self._supervision.supervised

    async def reload(
        self,
        kind: type[Component] | str,
        *,
        cycles: int = 10,
        seconds: float = 1.0,
        timeout: float | None = 5.0,
        import_timeout: float = 30.0,
        window: float = 0.0,
    ) -> Reloaded:
        """Replace a component type's code while the system runs: its file is read again, its instances go on with it.

        A new instance replaces each old one between two cycles, all of a context at once. It has the same name, place
        in the order, lifecycle state, parameters in force and sets, and the connectors and unread samples of the ports
        that the new code still has. Its `on_initialize` runs first, while the old instance still runs; then its
        `on_reload`, which gets the old instance; no other transition hook runs. Tasks of the old instance are cancelled
        (they would compete with the new one's for samples), and its `on_finalize` runs at the end: `on_reload` removes
        from the old instance what the new one keeps for good. The call returns when the new code has done its first
        cycles without a failure. A failure before that takes everything back, attributes of the old instance included;
        if a hook of the new code still runs after 10 s, the old code comes back when that hook returns. If tasks of the
        old instance were cancelled, its `on_deactivated` and `on_activated` run to start them again, while it stays
        active. Cancelling the caller does not end the reload.

        Only the file itself is read again, not what it imports. Other types in it keep their code; instances created
        afterwards have the new code, by a supervised restart, too, if its factory is the class or a `partial` of it.

        Args:
            kind: a type that has instances: a class, its name, "pid.py:Pid", "package.module:Pid", or a name that a
                plugin offers.
            cycles: the new code has proved itself after so many cycles of each context, 0 at once,
            seconds: or after so many seconds of the kernel's clock.
            timeout: seconds of the kernel's clock in which `on_initialize` of each new instance has to return, every
                context to come to the end of a cycle, and `on_reload` to return; None is forever.
            import_timeout: seconds of real time that running the file may take.
            window: seconds of the kernel's clock; above 0 the system is measured for that time with the old code and
                again with the new, which must not do worse: no further component is in error; the share of each
                context's ticks that overrun, and of each connector's samples that are dropped, is at most twice the old
                share plus 1 %; each connector keeps 0.8 of its rate. Fewer than 50 ticks or samples decide nothing, nor
                do faults of the machine.

        Raises:
            PluginError: no such type, or its file cannot be loaded, or an instance not be made; names file and line.
            ComponentError: `on_reload`, or a hook in the first cycles, failed; or the system does worse: the text has
                the figure and its subject.
            StateError: an instance cannot be replaced, such as one in a real-time context.
            TransitionTimeout: a context did not come to the end of a cycle in time.
            ClosedError: the kernel closes.
        """
        self.check_open("reload")
        from aiorts.reload import reload  # late: most systems never do

        return await reload(
            self, kind, cycles=cycles, seconds=seconds, timeout=timeout, import_timeout=import_timeout, window=window
        )

    # -- who is ready, and in which order ---------------------------------------------------------------------------

    async def wait_ready(self, *components: Component | str, timeout: float | None = 10.0) -> None:
        """Wait until these components are active in every context they are in; by default all that are in a context.

        A source that has finished counts as ready. A name may be given before its component exists.

        Args:
            timeout: seconds of the kernel's clock; None waits forever.

        Raises:
            TransitionTimeout: names the components that are not active, with the reason where it is known.
            ClosedError: the kernel closes.
        """
        self.check_open("wait_ready")
        from aiorts.supervision import wait_ready

        await wait_ready(self, components, timeout)

    async def start_in_order(self, rules: Sequence[StartRule]) -> None:
        """Activate components one after the other, each once its conditions hold and its `wait` is over.

        `stop_in_order`, or else the closing kernel, deactivates them in the reverse order. When a component fails,
        those before it stay active.

        Raises:
            ConfigurationError: the rules wait for each other (names them); nothing was started.
            TransitionTimeout: a condition did not come true; names it.
            StateError: there is no such component.
            ComponentError: its `on_activated` raised.
        """
        self.check_open("start in order")
        await self._supervising.start_in_order(rules)

    async def stop_in_order(self, *, timeout: float | None = 5.0) -> None:
        """Deactivate the components that `start_in_order` has activated, the last first, each before the next.

        Raises:
            TransitionTimeout: one was not deactivated within `timeout` seconds; the others were.
        """
        self.check_open("stop in order")
        await self._supervising.stop_in_order(timeout)

    def notify_systemd(self, *components: Component | str, environ: Mapping[str, str] | None = None) -> bool:
        """Notify systemd of this kernel's state, if the environment asks for that; returns whether it does.

        READY=1 once these components (by default all that are in a context) are active; STOPPING=1 when the kernel
        closes; STATUS= at each change; WATCHDOG=1 four times in WATCHDOG_USEC, while all contexts make progress: it
        stops once a hook has run for half of that time.

        Args:
            environ: the variables NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID; by default those of the process.

        Raises:
            ConfigurationError: systemd is notified of this kernel already.
        """
        self.check_open("notify systemd")
        return self._supervising.notify_systemd(components, os.environ if environ is None else environ)

    # -- what holds it up -------------------------------------------------------------------------------------------

    def watch_loop(self, limit: float = 5.0, policy: Literal["warn", "exit"] = "warn") -> bool:
        """Watch the loop: code that holds it for 0.2 s is logged in one line, with its stack, while it does so.

        Nothing is logged while a debugger holds the process. A further call changes limit and policy.

        Args:
            limit: seconds after which `policy` comes into force.
            policy: "warn" logs it again; "exit" ends the process at once with status 70, to be restarted.

        Returns:
            Whether the loop is watched: not in simulated time, and not on a system without timerfd.

        Raises:
            ConfigurationError: limit or policy out of range.
        """
        self.check_open("monitor the loop")
        from aiorts.diagnostics import LoopLimit, LoopMonitor

        return self.service(LoopMonitor).monitor(LoopLimit(limit, policy))

    @property
    def loop_stalls(self) -> LoopStalls:
        """How often and how long the loop did not turn, since `watch_loop`."""
        from aiorts.diagnostics import LoopMonitor, LoopStalls

        monitor = self.attached(LoopMonitor)
        return LoopStalls() if monitor is None else monitor.stalls

    @property
    def gc_pauses(self) -> Mapping[int, GcPauses]:
        """Garbage collections by generation, while a context with a rate ran; a collection stops all other code."""
        return MappingProxyType({}) if self._deadlines is None else self._deadlines.gc_pauses

    # -- the system as a file ----------------------------------------------------------------------------------------

    async def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> tuple[str, ...]:
        """Save the system as it is now in a system file, from which `aiorts run` makes it again.

        The file states what was chosen: values as declared, or by default, are left out. Types are names that plugins
        offer, "package.module:Class", or "FILE.py:Class" counted from the file's folder. Samples, attributes of
        components and lifecycle states of single components are not in it, nor choices of a command line for one run.

        Args:
            overwrite: replace a file that is there already; a failure leaves the old one or the new one whole.

        Returns:
            The parts of the system that no system file can state, and that are left out.

        Raises:
            SystemFileError: names each component, converter and context that no system file can state: its class or
                function is in no file, or in a file outside the folder of `path`.
            ConfigurationError: the file is there already, or cannot be written.
        """
        self.check_open("save")
        from aiorts.planning import Planning

        return await self.service(Planning).save(path, overwrite=overwrite)

    async def apply(self, wanted: Wanted, *, dry_run: bool = False, window: float = 0.0) -> Applied:
        """Change the running system into the wanted one: all of it, or nothing.

        New parts are made and connected first, then all changes are made between two cycles, then unwanted parts are
        removed. Equal parts are not touched. Options of a connector change in place; its waiting samples stay, in
        order. When a step fails, it is undone with all steps before it. Cancelling the caller while the old system is
        measured gives the plan up; later the plan is still carried out, or undone.

        Args:
            wanted: as `aiorts.system.wanted` reads it from a system file.
            dry_run: return the plan, and change nothing.
            window: seconds of the kernel's clock for which the system is measured before the change and after it; 0
                compares nothing. If the new system does worse, all is undone.

        Returns:
            The steps, whether they are in force, and the figure for which all was undone.

        Raises:
            BusyError: another plan is being applied, or its window has not ended.
            StateError: a difference cannot be changed while the system runs, or a component's hook calls this.
            PluginError, ConfigurationError: a component or context that is wanted cannot be made; nothing was changed.
            ApplyError: a step failed; `not_undone` names the steps that could not be undone.
        """
        self.check_open("apply")
        from aiorts.planning import Planning

        return await self.service(Planning).apply(wanted, dry_run=dry_run, window=window)

    # -- configuration files ----------------------------------------------------------------------------------------

    async def save_configuration(self, path: str | os.PathLike[str], *components: Component) -> None:
        """Save the configuration sets of these components, or of all that have parameters.

        The configuration is that of one moment. A failure leaves the old file or the new one whole.

        Raises:
            ConfigurationError: a value or the file cannot be written; nothing was changed.
        """
        self.check_open("save_configuration")
        await self._configuration.save(path, components)

    async def load_configuration(self, path: str | os.PathLike[str]) -> None:
        """Put the values of a file in force: of every component in it, or of none when anything is wrong.

        Each component then has the sets of the file, and no others. The components change one after the other, each
        between its own cycles. In a hook that the change would wait for, the call is queued and returns at once.

        Raises:
            ConfigurationError: names all that is wrong, with lines.
            TransitionTimeout: a component had no moment between cycles in time. All changes are undone.
        """
        self.check_open("load_configuration")
        await self._configuration.load(path)

    async def diff_configuration(self, path: str | os.PathLike[str]) -> tuple[Difference, ...]:
        """Differences of a file (old) and the components as they are (new); empty when loading changes nothing.

        Raises:
            ConfigurationError: the file cannot be read.
        """
        self.check_open("diff_configuration")
        return await self._configuration.diff(path)

    def html_of(self, thing: Component | Port[Any]) -> str | None:
        from aiorts.observe import html_of

        return html_of(thing)

    def _repr_html_(self) -> str:
        from aiorts.observe import kernel_html

        return kernel_html(self)


def _plain(limits: object) -> dict[str, Any]:
    """The limits of a process as plain values. DeclarationError: `limits` is no `Limits`."""
    from aiorts.isolation import Limits  # late: few kernels have processes

    if limits is not None and not isinstance(limits, Limits):
        raise DeclarationError(f"limits: expected Limits(memory=..., cpu=...), got {type(limits).__name__}")
    return asdict(limits) if limits is not None else {}
