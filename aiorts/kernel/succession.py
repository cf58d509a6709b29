"""Puts a new instance in the place of the old one in one moment, and takes that back whole.

`switch` and `undo` are done on the kernel's loop while no hook of the component runs. Until `settle` the ports that
the new code has no more keep their connectors, so that nothing is lost when the old code comes back.
"""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import StateError
from aiorts.kernel.bus import HookFailed, PortAdded, PortRemoved
from aiorts.kernel.commit import commit
from aiorts.kernel.deadlines import StopBudget
from aiorts.kernel.fresh_code import readings_of
from aiorts.kernel.heir import Heir
from aiorts.kernel.hooks import HookKind
from aiorts.kernel.host import PortHost
from aiorts.kernel.leftovers import leftovers
from aiorts.kernel.life import Action
from aiorts.kernel.ports import InPort, OutPort, Port, ServiceEnd, Turns
from aiorts.kernel.references import pass_on_references
from aiorts.kernel.reload_events import ComponentReloaded, Dropped
from aiorts.kernel.solo import run_alone
from aiorts.model.handover import handed_over
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aiorts.kernel.component import Component
    from aiorts.kernel.context import Context
    from aiorts.kernel.fresh_code import FreshCode
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.life import Steps
    from aiorts.kernel.member import Member
    from aiorts.model.sets import ConfigurationState

__all__ = ("Succession", "retire")

_ERROR: Final = LifeCycleState.ERROR
_LOG = logging.getLogger("aiorts.kernel")
_INACTIVE: Final = LifeCycleState.INACTIVE
_MISSING: Final[Any] = object()
_INHERITED: Final = ("_rt_last_error", "_rt_deadlines", "_rt_composite", "_rt_homes")
_PLACE: Final = ("_rt_host", "_rt_gate", "_rt_members", "_rt_heir", *_INHERITED)


class Succession(Heir):
    """The new instance, the old one, and each in the other's place."""

    def __init__(self, kernel: Kernel, old: Component, code: FreshCode) -> None:
        super().__init__(kernel, old, code)
        self.switched = False
        self.homeless = False
        """Whether it was removed in between: there is no place to go back to."""
        self.late = False
        """Whether it is taken back only when a hook of the new one returns."""
        self.began: dict[Context, int] = {}
        """Ticks of its contexts when it was put in place."""
        self.began_ns = 0
        self.tasks: tuple[str, ...] = ()
        """Tasks of the old one that were ended."""
        self._ended: set[asyncio.Task[Any]] = set()
        self._limits: Any = _MISSING
        """What limits the old one's hooks, while something else does."""
        self._gone: list[Port[Any]] = []
        self._fresh: list[Port[Any]] = []
        self._ports: dict[str, Port[Any]] = {}
        self._said: dict[Port[Any], dict[str, Any]] = {}
        self._old_vars: dict[str, Any] = {}
        self._new_vars: dict[str, Any] = {}
        self._put_in_force: ConfigurationState | None = None
        self._handed: frozenset[str] | None = None
        """Attributes that `on_reload` took over or set; None until it has returned."""
        self._states: dict[Member, tuple[LifeCycleState, BaseException | None]] = {}

    # -- one moment ------------------------------------------------------------------------------------------------

    def switch(self) -> None:
        """The new one is in the old one's place.

        Raises:
            StateError: the old one has gone. ConfigurationError: the new one refuses what was configured meanwhile.
        WiringError: a composite cannot show its ports. Then `undo` has to follow.
        """
        old, new, kernel = self.old, self.new, self.kernel
        self.unlimit()
        if kernel.components.get(old.name) is not old or old in kernel._roster._leaving:
            raise StateError(f"{old.name}: was removed while its new code was made ready")
        if old._rt_params._state is not self._seen:
            self._hand_over_parameters()
        self._old_vars, self._new_vars = dict(vars(old)), dict(vars(new))
        self._states = {member: (member.state, member.failure) for member in old._rt_members}
        host = old._rt_host
        self._ports = dict(host.ports)
        ports = self._ports_wanted()
        self._gone = [port for name, port in self._ports.items() if ports.get(name) is not port]
        self._fresh = [port for name, port in ports.items() if self._ports.get(name) is not port]
        for port in self._fresh:
            port._host, port._turns = host, host.turns
            port._refresh()
        vars(new).pop("_rt_heir", None)
        new._rt_host, new._rt_gate = host, old._rt_gate
        new._rt_members, old._rt_members = old._rt_members, []
        for name in _INHERITED:
            if name in vars(old):
                setattr(new, name, getattr(old, name))
        self._said = {port: {word: getattr(port, word) for word in words} for port, words in self._words.items()}
        old._rt_successor = new
        host.trial = tuple(member for member in new._rt_members if member.state is LifeCycleState.ACTIVE)
        self.switched = True
        self._put(new, old, ports, self._words)
        _change_ports(new, self._gone, self._fresh)
        self._put_in_force = new._rt_params._state
        self.began = {member.context: member.context.ticks for member in new._rt_members}
        self.began_ns = kernel.clock.monotonic_ns()
        if new._rt_composite is not None and (self._gone or self._fresh):
            new._rt_composite._rt_check_ports()

    def undo(self) -> None:
        """The old one is in its place again, as it was; what the new one failed for is forgotten."""
        if not self.switched:
            return
        self.switched = False
        old, new, members = self.old, self.new, self.new._rt_members
        new._rt_host.trial = ()
        leaving = self.kernel._roster._leaving
        if self._is_gone() or (new in leaving and not members):
            self.homeless = True  # it is ended where it is, and the old one after it
            self._end_gone()
            return
        configured = new._rt_params._state
        self._give_back()
        vars(old).clear()
        vars(old).update(self._old_vars)
        old._rt_members, new._rt_members = members, []
        for port in self._fresh:
            port._host, port._turns = new._rt_host, new._rt_host.turns
        new._rt_successor = old
        if new in leaving:
            task = leaving[old] = leaving[new]
            task.add_done_callback(lambda _: leaving.pop(old, None))
        self._put(old, new, self._ports, self._said)
        for member in members:
            self._restore(member)
        _change_ports(old, self._fresh, self._gone)
        for member in members:
            member.context._set_ports_open(member)
        for port in self._gone:
            if isinstance(port, InPort) and port.is_new:
                port._notify()
        if configured is not self._put_in_force:
            self._configure_back(configured)

    def _configure_back(self, configured: ConfigurationState) -> None:
        """What was configured while the new one was in place, as far as the old code has it, too."""
        refused = commit(self.old, lambda state: handed_over(configured, state, configured.specs, bool, "")[0])
        if refused is not None:
            _LOG.warning("%s: what was configured meanwhile is not in force: %s", self.old.name, refused)

    def limit(self, seconds: float) -> None:
        """How long `on_reload`, which is called in the place of a hook of the old one, may take."""
        old = self.old
        self._limits = vars(old).pop("_rt_deadlines", None)
        old._rt_deadlines = MappingProxyType({**(self._limits or {}), "on_reload": seconds})

    def unlimit(self) -> None:
        """As it was."""
        limits, self._limits = self._limits, _MISSING
        if limits is not _MISSING:
            vars(self.old).pop("_rt_deadlines", None)
            if limits is not None:
                self.old._rt_deadlines = limits

    def note_handed(self) -> None:
        """`on_reload` has returned."""
        self._handed = frozenset(self._changed())

    def end_tasks(self) -> None:
        """What the old one started ends with its code: it would go on reading and writing at the same ports."""
        tasks = [task for task in self.kernel._roster.tasks.get(self.old, ()) if not task.done()]
        self.tasks += tuple(task.get_name() for task in tasks if task not in self._ended)
        for task in tasks:
            if task not in self._ended:
                _LOG.warning("%s: its task %s is ended with its old code", self.old.name, task.get_name())
                self._ended.add(task)
                task.cancel()
        for port in self.new.ports.values():
            # It waits no more, though it will only find that out when it runs next: the new one's may wait there now.
            if isinstance(port, InPort) and port._waiter is not None and port._waiter.done():
                port._waiter = None
                port._arm()

    def _ports_wanted(self) -> dict[str, Port[Any]]:
        """What the new code declares or adds, and what was added to the old one at run time."""
        old, ports = self.old, dict(self.new._rt_host.ports)
        declared = {port.name or name for name, port in type(old)._rt_port_declarations.items()}
        for name, port in self._ports.items():
            if name not in ports and name not in declared and old._rt_group.get(name) is not port:
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
        # In place: others look at this very dictionary.
        live = one._rt_host.ports
        live.clear()
        live.update(ports)
        for port, said in words.items():
            if any(getattr(port, word) != text for word, text in said.items()):
                for word, text in said.items():
                    setattr(port, word, text)
                for writer in [port, *(connector.out for connector in port.connectors)]:
                    if isinstance(writer, OutPort):
                        writer._refresh()
        self.services.put(one)
        for member in one._rt_members:
            _rebind(member, one)
        pass_on_references(self.kernel, other, one)

    def _changed(self) -> list[str]:
        before, now = self._new_vars, vars(self.new)
        return [
            name
            for name in now.keys() | before.keys()
            if not name.startswith("_rt_") and now.get(name, _MISSING) is not before.get(name, _MISSING)
        ]

    def _give_back(self) -> None:
        """What `on_reload` took over, and the place; what the new one's own cycles made stays with it, to be ended."""
        new = self.new
        handed = self._changed() if self._handed is None else self._handed
        for name in (*handed, *_PLACE):
            value = self._new_vars.get(name, _MISSING)
            if value is _MISSING:
                vars(new).pop(name, None)
            else:
                vars(new)[name] = value

    def _restore(self, member: Member) -> None:
        state, failure = self._states.get(member, (_INACTIVE, None))
        member.abandoned = False
        if member.failure is not failure or (member.state is _ERROR and state is not _ERROR):
            member.failure = failure
            member.context._life._enter(member, state)

    # -- for good --------------------------------------------------------------------------------------------------

    def settle(self) -> ComponentReloaded | None:
        """The new one stays: the ports that have gone lose their connectors, and everybody hears of it.

        None: it was removed meanwhile.
        """
        old, new, kernel = self.old, self.new, self.kernel
        self._end_trial()
        if self._is_gone():
            self._end_gone()
            return None
        dropped = [self._end_port(port) for port in self._gone]
        dropped += [self._end_interface(end) for end in self.services.gone()]
        dropped += [Dropped("parameter", name, why) for name, why in self.lost.items()]
        dropped += [Dropped("task", name, "the old code had started it") for name in self.tasks]
        for port in self._fresh:
            kernel.bus.publish(PortAdded(new.name, port.profile))
        if new._rt_composite is not None and (self._gone or self._fresh):
            new._rt_composite._rt_ports_changed()
        before, now = old._rt_params._state.specs, new._rt_params._state.specs
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
        """Who goes to error takes no more samples; a thread that is just about it looks again after that."""
        host = self.new._rt_host
        members, host.trial = host.trial, ()
        for member in self.new._rt_members:
            if member in members:
                member.context._submit(Action(partial(_look_at_ports, member)))

    def _is_gone(self) -> bool:
        return self.kernel.components.get(self.old.name) is not self.new

    def _end_gone(self) -> None:
        """It was removed meanwhile: what its code had no name for goes, too."""
        for port in self._gone:
            self._end_port(port)
        for end in self.services.gone():
            self._end_interface(end)

    def _end_interface(self, end: ServiceEnd[Any]) -> Dropped:
        connectors = end.connectors
        for connector in connectors:
            self.kernel._connections.end(connector)
        path = end.path.partition(".")[2]
        return Dropped("interface", path, "the new code has none like it", tuple(one.name for one in connectors))

    def _end_port(self, port: Port[Any]) -> Dropped:
        connectors = port.connectors
        unread = sum(connector.unread for connector in connectors) if isinstance(port, InPort) else 0
        for connector in connectors:
            self.kernel._connections.end(connector)
        if isinstance(port, InPort):
            port._wake_waiter()
        self.kernel.bus.publish(PortRemoved(self.old.name, port.profile))
        there = self.new.ports.get(port.name)
        why = "the new code has no such port" if there is None else f"the new code has {there!r} in its place"
        return Dropped("port", port.name, why, tuple(connector.name for connector in connectors), unread)


def _look_at_ports(member: Member) -> Steps:
    member.context._set_ports_open(member)
    yield from ()


def _rebind(member: Member, component: Component) -> None:
    """It is this instance that runs here from now on."""
    kinds = component._rt_hook_kinds
    updates = kinds["on_state_update"] != HookKind.ABSENT
    member.component = component
    member.hooks.clear()
    member.context._updating += updates - member.updates
    member.updates = updates
    member.awaits = kinds["on_execute"] == HookKind.ASYNC
    member.settle()


def _change_ports(component: Component, gone: list[Port[Any]], come: list[Port[Any]]) -> None:
    for member in component._rt_members:
        for port in gone:
            member.context._port_removed(member, port)
        for port in come:
            member.context._port_added(member, port)


def _nowhere(component: Component) -> PortHost:
    """The host of an instance that has no place any more."""
    host = PortHost(component.name, Turns())
    host.kernel = component._rt_host.kernel
    host.alive = False
    return host


async def retire(kernel: Kernel, component: Component, heir: Component | None = None, *, finalize: bool = True) -> None:
    """The end of an instance that is in no place: `on_finalize`, and what it started is ended; no port is touched."""
    roster, budget = kernel._roster, StopBudget(kernel.loop)
    if heir is not None:
        component._rt_host, component._rt_successor = _nowhere(component), None
    error = None
    if finalize and component._rt_abandoned is None:
        error = await run_alone(kernel, component, "on_finalize", budget)
    if error is not None:
        kernel.bus.publish(HookFailed(component.name, "", "on_finalize", error))
        component.log.error("on_finalize failed: %s: %s", type(error).__name__, error, exc_info=error)
        if isinstance(error, KeyboardInterrupt):
            kernel._interrupted(error)
    await roster._end_tasks(roster.tasks.get(component, ()), budget)
    component._rt_host.alive = False
    if left := leftovers(component, () if heir is None else vars(heir).values()):
        _LOG.warning("%s: left after on_finalize: %s", component.name, ", ".join(left))
    if component._rt_log is not None:
        component._rt_log.flush()
