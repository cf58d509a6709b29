"""A new instance in the place of an old one: made while the old one works, put in place at once, or taken back whole.

The ports that its code declares are the live ports of the old one where they fit, so that connectors, unread samples
and who waits there need not be moved. `switch` and `undo` are done on the kernel's loop while no hook of the component
runs. Until `settle` the ports that the new code has no more keep their connectors, so that nothing is lost when the old
code comes back.
"""

from __future__ import annotations

import asyncio
import inspect
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts.errors import AiortsError, DeclarationError, PluginError, StateError, WiringError
from aiorts.kernel.commit import commit
from aiorts.kernel.component import construct
from aiorts.kernel.declarations import declarations
from aiorts.kernel.detached_hook import run_alone
from aiorts.kernel.execution.cell import ATTRIBUTE, cell, exchange_cells
from aiorts.kernel.execution.cycle import Action
from aiorts.kernel.execution.hooks import HookKind, coroutine_hooks
from aiorts.kernel.extensions.loading import cause_of
from aiorts.kernel.leaks import report_leaks
from aiorts.kernel.loop.bus import HookFailed, PortAdded, PortRemoved
from aiorts.kernel.loop.deadlines import StopBudget
from aiorts.kernel.loop.guarded import KernelLog, guarded
from aiorts.kernel.loop.origins import located, origin_of
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.kernel.ports.connector import unread_at
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.port import move_to, refresh, unanswerable, wake_waiter
from aiorts.kernel.ports.wiring import pair_faults
from aiorts.model.configuration.handover import handed_over
from aiorts.model.lifecycle import LifecycleState
from aiorts.reload.fresh_code import readings_of
from aiorts.reload.references import pass_on_references
from aiorts.reload.reload_events import ComponentReloaded, Dropped
from aiorts.services import ServiceEnd, ServiceHeritage
from aiorts.supervision import ContextPlace

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Steps
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.configuration.sets import ConfigurationState
    from aiorts.reload.fresh_code import Code

Edit: TypeAlias = "Callable[[ConfigurationState], ConfigurationState]"
_ON_LOOP: Final = ("on_initialize", "on_finalize")
_WORDS: Final = ("unit", "shape", "doc", "max_connectors", "stamp")
"""The parts of a declaration that can be changed on a live port."""
_ERROR: Final = LifecycleState.ERROR
_LOG = KernelLog()
_INACTIVE: Final = LifecycleState.INACTIVE
_MISSING: Final[Any] = object()


class Replacement:
    """Puts a new instance in the place of an old one, and the old one back."""

    def __init__(self, kernel: Microkernel, old: Component, code: Code, edit: Edit | None = None) -> None:
        self.kernel = kernel
        self.old = old
        self.code = code
        self._edit = edit
        """Makes the new configuration from the declared one; None: the old instance's configuration is taken over."""
        self.made: Component | None = None
        """The new instance, as far as it was made."""
        self.lost: dict[str, str] = {}
        """Parameters that have lost a value, and why."""
        self.initialized = False
        self.services = ServiceHeritage(old)
        self._words: dict[Port[Any], dict[str, Any]] = {}
        """The declarations of the new code for the ports that stay."""
        self._seen: ConfigurationState | None = None
        """The configuration of the old instance, as it was handed over."""
        self.switched = False
        self.homeless = False
        """Whether the component was removed meanwhile: there is no place to go back to."""
        self.late = False
        """Whether the replacement is taken back only when a hook of the new instance returns."""
        self.began: dict[Context, int] = {}
        """Ticks of the contexts when the new instance was put in place."""
        self.began_ns = 0
        self.tasks: tuple[str, ...] = ()
        """Tasks of the old instance that were ended."""
        self._ended: set[asyncio.Task[Any]] = set()
        self._made_ports: dict[str, Port[Any]] = {}
        """The ports that the new one was made with, as it holds them."""
        self._standing: tuple[tuple[Any, ...], tuple[Any, ...]] = (), ()
        """The standing of the old and of the new instance before the new one was put in place."""
        self._limits: Any = _MISSING
        """The limits of the old instance's hooks, while others are in force."""
        self.gone: list[Port[Any]] = []
        """Ports that the new instance does not have."""
        self._fresh: list[Port[Any]] = []
        self._ports: dict[str, Port[Any]] = {}
        self._said: dict[Port[Any], dict[str, Any]] = {}
        self._old_vars: dict[str, Any] = {}
        self._new_vars: dict[str, Any] = {}
        self._put_in_force: ConfigurationState | None = None
        self._handed: frozenset[str] | None = None
        """Attributes that `on_reload` took over or set; None until it has returned."""
        self._places: dict[Member, ContextPlace] = {}

    @property
    def new(self) -> Component:
        """The new instance, once it was made."""
        assert self.made is not None  # noqa: S101 - asked for after `prepare`
        return self.made

    # -- making it -------------------------------------------------------------------------------------------------

    async def prepare(self, timeout: float | None = None) -> None:
        """Construct the new instance and run its `on_initialize`, at most for `timeout` seconds; the old one goes on.

        Raises:
            PluginError: the new instance cannot be made; says why, with file and line.
        """
        old, cls, kernel = self.old, self.code.cls, self.kernel
        where = f"{self.code.origin}: {old.name}"
        declarations(cls).port_maker = self
        try:
            new = construct(cls, old.name)
        except AiortsError as refused:
            cause = refused.__cause__ or refused
            raise PluginError(f"{where}: the new code cannot be constructed: {cause_of(cause)}") from refused
        finally:
            declarations(cls).port_maker = None
        self.made = new
        cell(new).port_maker = self
        cell(new).rename(old.name)
        try:
            self._hand_over_parameters()
        except AiortsError as refused:
            raise PluginError(f"{where}: the new code refuses the values in force: {refused}") from refused
        self._adopt_group()
        self._check_thread(where)
        cell(new).kernel = kernel
        error = await run_alone(kernel, new, "on_initialize", None, limit=timeout)
        if error is not None:
            raise PluginError(f"{where}: on_initialize of the new code raised {cause_of(error)}") from error
        self.initialized = True

    def _hand_over_parameters(self) -> None:
        old, new = self.old, self.new
        self._seen = seen = cell(old).configuration

        def edit(state: ConfigurationState) -> ConfigurationState:
            if self._edit is not None:
                return self._edit(state)
            declared = declarations(type(old)).parameters
            handed, self.lost = handed_over(seen, state, declared, self._is_free, old.name)
            return handed

        refused = commit(new, edit, old=seen)
        if refused is not None:
            raise refused

    def _check_thread(self, where: str) -> None:
        """If the component runs in a thread, which cannot await, refuse new `async def` hooks."""
        if all(context.suspends for context in self.old.contexts):
            return
        awaiting = [hook for hook in coroutine_hooks(cell(self.new).hook_kinds) if hook not in _ON_LOOP]
        awaiting += unanswerable(self.new.ports.values())
        if awaiting:
            raise PluginError(
                f"{where}: {', '.join(awaiting)} is `async def` now, and it runs in a thread, where all is plain `def`"
            )

    def _is_free(self, name: str) -> bool:
        return name not in vars(self.new) and inspect.getattr_static(type(self.new), name, None) is None

    def _adopt_group(self) -> None:
        """The ports that the parameters ask for."""
        new, ports = self.new, cell(self.new).ports
        group = {name: self._live(name, port) or port for name, port in cell(new).port_group.items()}
        if group:
            cell(new).port_group = group
            for name in group:
                ports[name] = group[name]

    def bind(self, component: Component, name: str, declared: object) -> Port[Any] | ServiceEnd[Any]:
        """Called instead of `Component.add_port` while the component is made: the old one's live port if it fits.

        Raises:
            WiringError, DeclarationError: as `add_port`.
            PluginError: its record type is of the reloaded file.
        """
        host = cell(component)
        if self.made is None and type(component) is self.code.cls:
            self.made = component
        mine = self.made is component  # its constructor may make others
        if isinstance(declared, ServiceEnd):
            return self.services.bind(component, name, declared, mine=mine)
        if name in host.ports:
            raise WiringError(f"{component.name}.{name}: there is a port of that name already")
        if not isinstance(declared, InPort | OutPort):
            raise DeclarationError(f"{component.name}.{name}: expected InPort or OutPort, got {declared!r}")
        fresh: Port[Any] = declared.bind(host, name)
        live = self._live(name, fresh) if mine else None
        host.ports[name] = bound = live or fresh
        return bound

    def unbind(self, component: Component, name: str) -> None:
        """Called instead of `Component.remove_port`: a port of the old instance stays until that has gone."""
        del cell(component).ports[name]

    def _live(self, name: str, fresh: Port[Any]) -> Port[Any] | None:
        """The old one's port of this name, if its samples are of the same type and all its connectors still fit."""
        live = cell(self.old).ports.get(name)
        if live is None or live.direction != fresh.direction:
            return None
        if live.type is not fresh.type:
            same_name = live.type.__qualname__ == fresh.type.__qualname__
            if same_name and live.connectors and live.type.__module__ == self.code.origin.module:
                raise PluginError(
                    f"{self.code.origin}: {live.path}: {live.type.__qualname__} is a record type of the reloaded file "
                    "itself, and read anew it is another type; move it into a module of its own"
                )
            return None
        for connector in live.connectors:
            ends = (fresh, connector.in_) if isinstance(fresh, OutPort) else (connector.out, fresh)
            if any(pair_faults(*ends, converted=connector.profile.convert is not None)):  # type: ignore[arg-type] # one is the out-port, the other the in-port
                return None
        self._words[live] = {word: getattr(fresh, word) for word in _WORDS if hasattr(fresh, word)}
        return live

    # -- one moment ------------------------------------------------------------------------------------------------

    def switch(self) -> None:
        """Put the new instance in the old one's place.

        Raises:
            StateError: the old one has gone.
            ConfigurationError: the new one refuses what was configured meanwhile.
            WiringError: a composite cannot show its ports. Then `undo` has to follow.
        """
        old, new, kernel = self.old, self.new, self.kernel
        self.unlimit()
        if kernel.components.get(old.name) is not old or kernel.registry.is_leaving(old):
            raise StateError(f"{old.name}: was removed while its new code was made ready")
        place, other = cell(old), cell(new)
        if place.configuration is not self._seen:
            self._hand_over_parameters()
        self._old_vars, self._new_vars = dict(vars(old)), dict(vars(new))
        self._places = {member: ContextPlace.of(member) for member in place.members}
        self._ports = dict(place.ports)
        ports = self._ports_wanted()
        self.gone = [port for name, port in self._ports.items() if ports.get(name) is not port]
        self._fresh = [port for name, port in ports.items() if self._ports.get(name) is not port]
        for port in self._fresh:
            move_to(port, place)
        self._standing, self._made_ports = (place.standing, other.standing), other.ports
        exchange_cells(old, new)
        other.port_maker = None
        other.standing, other.ports, other.successor = place.standing, place.ports, new
        self._said = {port: {word: getattr(port, word) for word in words} for port, words in self._words.items()}
        place.trial = tuple(member for member in place.members if member.state is LifecycleState.ACTIVE)
        self.switched = True
        self._put(new, old, ports, self._words)
        _change_ports(new, self.gone, self._fresh)
        self._put_in_force = place.configuration
        self.began = {member.context: member.context.ticks for member in place.members}
        self.began_ns = kernel.clock.monotonic_ns()
        outer = place.group
        if outer is not None and (self.gone or self._fresh):
            outer.check_ports()

    def undo(self) -> None:
        """Put the old instance back in its place, as it was; the failure of the new one is forgotten."""
        if not self.switched:
            return
        self.switched = False
        old, new = self.old, self.new
        place, other, members = cell(new), cell(old), cell(new).members
        place.trial = ()
        if self._is_gone() or (self.kernel.registry.is_leaving(new) and not members):
            self.homeless = True  # it is ended where it is, and the old one after it
            self._end_gone()
            return
        configured = place.configuration
        self._give_back()
        exchange_cells(old, new)
        # What it failed for is forgotten; of the composite it may have become a member meanwhile, or of another one.
        (*known, _, _), other.standing = self._standing
        place.standing = *known, place.group, place.previous_placements
        vars(old).clear()
        vars(old).update(self._old_vars)
        for port in self._fresh:
            move_to(port, other)
        other.ports, other.successor = self._made_ports, old
        self.kernel.registry.leave_instead(old, new)
        self._put(old, new, self._ports, self._said)
        for member in members:
            self._restore(member)
        _change_ports(old, self._fresh, self.gone)
        for member in members:
            member.open_ports()
        for port in self._ports.values():
            # These are samples that the new code has not read: no other may come before the old code runs.
            if isinstance(port, InPort) and port.is_new:
                receiver_of(port).notify()
        if configured is not self._put_in_force:
            self._configure_back(configured)

    def _configure_back(self, configured: ConfigurationState) -> None:
        """Configure the old instance as the new one was meanwhile, as far as the old code has the parameters."""
        refused = commit(self.old, lambda state: handed_over(configured, state, configured.specs, bool, "")[0])
        if refused is not None:
            _LOG.warning("%s: what was configured meanwhile is not in force: %s", self.old.name, refused)

    def limit(self, seconds: float) -> None:
        """Limit the time of `on_reload`, which is called in the place of a hook of the old instance."""
        here = cell(self.old)
        self._limits = here.deadlines
        here.deadlines = MappingProxyType({**(self._limits or {}), "on_reload": seconds})

    def unlimit(self) -> None:
        """End `limit`: the limits of the old instance's hooks are in force again."""
        limits, self._limits = self._limits, _MISSING
        if limits is not _MISSING:
            cell(self.old).deadlines = limits

    def note_handed(self) -> None:
        """Note which attributes `on_reload`, which has returned, took over or set."""
        self._handed = frozenset(self._changed())

    def end_tasks(self) -> None:
        """End the tasks of the old instance: they would go on reading and writing at the same ports."""
        tasks = [task for task in self.kernel.registry.tasks.get(self.old, ()) if not task.done()]
        self.tasks += tuple(task.get_name() for task in tasks if task not in self._ended)
        for task in tasks:
            if task not in self._ended:
                _LOG.warning("%s: its task %s is ended with its old code", self.old.name, task.get_name())
                self._ended.add(task)
                task.cancel()
        for port in self.new.ports.values():
            # It waits no more, though it will only find that out when it runs next: the new one's may wait there now.
            if isinstance(port, InPort):
                receiver_of(port).end_waiting()

    def _ports_wanted(self) -> dict[str, Port[Any]]:
        """The ports that the new code declares or adds, and those that were added to the old instance at run time."""
        old, ports = self.old, dict(cell(self.new).ports)
        declared = {port.name or name for name, port in declarations(type(old)).ports.items()}
        for name, port in self._ports.items():
            if name not in ports and name not in declared and cell(old).port_group.get(name) is not port:
                ports[name] = port
        self.services.wanted(ports, self._ports)
        return ports

    def _put(
        self,
        one: Component,
        other: Component,
        ports: Mapping[str, Port[Any]],
        words: Mapping[Port[Any], Mapping[str, Any]],
    ) -> None:
        # The dictionary is changed in place: others hold the same object.
        live = cell(one).ports
        live.clear()
        live.update(ports)
        for port, texts in words.items():
            if any(getattr(port, word) != text for word, text in texts.items()):
                for word, text in texts.items():
                    setattr(port, word, text)
                for writer in [port, *(connector.out for connector in port.connectors)]:
                    if isinstance(writer, OutPort):
                        refresh(writer)
        self.services.put(one)
        for member in cell(one).members:
            _rebind(member, one)
        pass_on_references(self.kernel, other, one)

    def _changed(self) -> list[str]:
        before, now = self._new_vars, vars(self.new)
        return [
            name
            for name in now.keys() | before.keys()
            if name != ATTRIBUTE and now.get(name, _MISSING) is not before.get(name, _MISSING)
        ]

    def _give_back(self) -> None:
        """Give back the attributes that `on_reload` took over; the new instance keeps its own, to be ended."""
        new = self.new
        handed = self._changed() if self._handed is None else self._handed
        for name in handed:
            value = self._new_vars.get(name, _MISSING)
            if value is _MISSING:
                vars(new).pop(name, None)
            else:
                vars(new)[name] = value

    def _restore(self, member: Member) -> None:
        place = self._places.get(member)
        state, failure = (_INACTIVE, None) if place is None else (place.state, place.failure)
        member.abandoned = False
        if member.failure is not failure or (member.state is _ERROR and state is not _ERROR):
            member.failure = failure
            member.context.runner.life.enter(member, state)

    # -- for good --------------------------------------------------------------------------------------------------

    def settle(self) -> ComponentReloaded | None:
        """Keep the new instance: the ports that have gone lose their connectors, and all observers are notified.

        None: the component was removed meanwhile.
        """
        old, new, kernel = self.old, self.new, self.kernel
        self._end_trial()
        if self._is_gone():
            self._end_gone()
            return None
        dropped = [self._end_port(port) for port in self.gone]
        dropped += [self._end_interface(end) for end in self.services.gone()]
        dropped += [Dropped("parameter", name, why) for name, why in self.lost.items()]
        dropped += [Dropped("task", name, "the old code had started it") for name in self.tasks]
        for port in self._fresh:
            kernel.bus.publish(PortAdded(new.name, port.profile))
        outer = cell(new).group
        if outer is not None and (self.gone or self._fresh):
            outer.ports_changed()
        before, now = cell(old).configuration.specs, cell(new).configuration.specs
        kept = [name for name, port in new.ports.items() if self._ports.get(name) is port]
        kept += [name for name in before if name in now and name not in self.lost]
        event = ComponentReloaded(
            new.name,
            str(self.code.origin),
            readings_of(type(old)),
            self.code.readings,
            tuple(kept),
            tuple(dropped),
            tuple(port.name for port in self._fresh),
        )
        kernel.bus.publish(event)
        return event

    def _end_trial(self) -> None:
        """End the trial: a component in error takes no more samples; a thread on the way there looks again."""
        place = cell(self.new)
        members, place.trial = place.trial, ()
        for member in place.members:
            if member in members:
                member.context.runner.submit(Action(partial(_look_at_ports, member)))

    def _is_gone(self) -> bool:
        return self.kernel.components.get(self.old.name) is not self.new

    def _end_gone(self) -> None:
        """After a removal of the component, end also the ports that the new code does not have."""
        for port in self.gone:
            self._end_port(port)
        for end in self.services.gone():
            self._end_interface(end)

    def _end_interface(self, end: ServiceEnd[Any]) -> Dropped:
        connectors = end.connectors
        for connector in connectors:
            self.kernel.connections.end(connector)
        path = end.path.partition(".")[2]
        return Dropped("interface", path, "the new code has none like it", tuple(one.name for one in connectors))

    def _end_port(self, port: Port[Any]) -> Dropped:
        connectors = port.connectors
        unread = unread_at(port) if isinstance(port, InPort) else 0
        for connector in connectors:
            self.kernel.connections.end(connector)
        if isinstance(port, InPort):
            wake_waiter(port)
        self.kernel.bus.publish(PortRemoved(self.old.name, port.profile))
        there = self.new.ports.get(port.name)
        why = "the new code has no such port" if there is None else f"the new code has {there!r} in its place"
        return Dropped("port", port.name, why, tuple(connector.name for connector in connectors), unread)


def _look_at_ports(member: Member) -> Steps:
    member.open_ports()
    yield from ()


def _rebind(member: Member, component: Component) -> None:
    """Let the member run this instance from now on."""
    member.component = component
    member.hooks.clear()
    member.settle_updates()
    member.awaits = member.cell.hook_kinds["on_execute"] == HookKind.ASYNC
    member.settle()


def _change_ports(component: Component, gone: list[Port[Any]], come: list[Port[Any]]) -> None:
    for member in cell(component).members:
        for port in gone:
            member.port_removed(port)
        for port in come:
            member.port_added(port)


async def retire(
    kernel: Microkernel, component: Component, successor: Component | None = None, *, finalize: bool = True
) -> None:
    """End an instance that is in no place: run `on_finalize` and end what it started; no port is touched."""
    registry, budget, here = kernel.registry, StopBudget(kernel.loop), cell(component)
    if successor is not None:
        here.ports, here.successor, here.alive = {}, None, False
    error = None
    if finalize and here.abandoned is None:
        error = await run_alone(kernel, component, "on_finalize", budget)
    if error is not None:
        kernel.bus.publish(HookFailed(component.name, "", "on_finalize", error, origin_of(error, installed=True)))
        component.log.error("on_finalize failed: %s", located(error), exc_info=error)
        if issubclass(type(error), KeyboardInterrupt):
            kernel.pass_on_interrupt(error)
    await registry.end_tasks(registry.tasks.get(component, ()), budget)
    here.alive = False
    passed_on = () if successor is None else vars(successor).values()
    guarded(f"{component.name}: could not look for what is left of it", report_leaks, component, passed_on)
    if here.log is not None:
        here.log.flush()
