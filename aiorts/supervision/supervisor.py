"""Recovers components from error as their policy requires; `model/wanted/restart_policy.py` decides when.

For each supervised component there is at most one task, only while it is in error. A reset runs `on_reset` and
activates again. A restart puts a new instance of the same name in the old one's place: configuration, contexts, place
in their order and in a composite, and connectors are as they were; samples queued in these are dropped as disconnected,
and calls in progress end with ServiceUnavailable. The connectors are new objects that count from 0; the old ones keep
their counts. Components that a composite deactivated for the error are then activated again; those deactivated on
purpose stay inactive.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.composites import bring_back, group_of, outer_of, stopped_with
from aiorts.errors import ClosedError, DeclarationError, format_error
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.file_access import own_context
from aiorts.kernel.loop.bus import ComponentRemoved, Event, StateChanged
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import current_task, kernel_task
from aiorts.late import dataclass
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.wanted.restart_policy import Attempts, Supervision
from aiorts.supervision.component_place import instance_of, place_of, reset_whole

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.profile import ConnectorProfile
    from aiorts.model.service_profile import ServiceConnectorProfile
    from aiorts.supervision.component_place import ComponentPlace, KeptConnector

_LOG = KernelLog()
_ERROR: Final = LifecycleState.ERROR
_INACTIVE: Final = LifecycleState.INACTIVE
_HELPED: Final = {"reset": "was reset", "restart": "was restarted"}


@dataclass(frozen=True, slots=True)
class ComponentRecovered(Event):
    """A supervised component was in error and is active again."""

    component: str
    action: str
    """"reset" or "restart"."""
    attempt: int
    """Number of its recoveries so far."""


@dataclass(frozen=True, slots=True)
class RestartLimitReached(Event):
    """A supervised component failed more often than its budget allows: the component is left as it is."""

    component: str
    attempts: int
    window: float
    """Seconds."""
    error: BaseException | None = None


class Supervised:
    """The state of supervision of one component; read-only."""

    def __init__(self, component: Component, policy: Supervision, factory: Callable[[str], Component]) -> None:
        self.policy = policy
        self.component = component
        """The present instance; a restart changes it."""
        self.last_error: BaseException | None = None
        """The error of the last recovery, or the error at which recovery was given up."""
        self._attempts = Attempts(policy)
        self._factory = factory
        self._task: asyncio.Task[None] | None = None
        self._place: ComponentPlace | None = None
        self._removing = False

    @property
    def name(self) -> str:
        """The component's name."""
        return self.component.name

    @property
    def attempts(self) -> int:
        """How often the component was reset or restarted, with or without success."""
        return self._attempts.total

    @property
    def exhausted(self) -> bool:
        """Whether the budget is used up: the component is not recovered any more, until `supervise` is called again."""
        return self._attempts.exhausted

    @property
    def helping(self) -> bool:
        """Whether the component is in error, or between two instances, and will be recovered."""
        going = self.policy.restart != "never" and not self.exhausted
        return self._task is not None or (going and _in_error(self.component))

    @property
    def is_between(self) -> bool:
        """Whether the component is being restarted: the old instance goes, or the new one lacks part of its place."""
        return self._place is not None and not self.is_to_be_gone

    @property
    def is_to_be_gone(self) -> bool:
        """Whether not only the restart has asked for the removal of the instance."""
        return cell(self.component).removals > 1

    def __repr__(self) -> str:
        how = "exhausted" if self.exhausted else self.policy.restart
        return f"<Supervised {self.name} {how} {self.attempts} attempts>"


class Supervisor:
    """The supervised components of one kernel."""

    def __init__(self, kernel: Microkernel) -> None:
        self._kernel = kernel
        self.supervised: dict[str, Supervised] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._unsubscribe = (
            kernel.bus.subscribe(StateChanged, self._changed),
            kernel.bus.subscribe(ComponentRemoved, self._removed),
        )

    def supervise(
        self, component: Component, policy: Supervision, factory: Callable[[str], Component] | None
    ) -> Supervised:
        """Supervise a component from now on; a former policy of this component ends."""
        if not isinstance(policy, Supervision):
            raise DeclarationError(f"{component.name}: expected Supervision(...), got {policy!r}")
        if factory is not None and not callable(factory):
            raise DeclarationError(f"{component.name}: factory = {factory!r:.80}: expected a function of a name")
        if group_of(component) is not None and (policy.restart == "restart" or policy.limits is not None):
            what = "cannot be made anew" if policy.restart == "restart" else "runs no hooks of its own"
            raise DeclarationError(f'{component.name}: a composite {what}; supervise its members, or restart="reset"')
        factory = factory or type(component)
        one = self.supervised.get(component.name)
        if one is not None and one._place is not None:
            # A restart that has begun goes on: if it were ended here, there would be no component.
            one.policy, one._factory, one._attempts = policy, factory, Attempts(policy)
        else:
            self._drop(component.name)
            one = self.supervised[component.name] = Supervised(component, policy, factory)
        _limit(component, policy)
        self._look_at(one)
        return one

    def replaced(self, pairs: Mapping[Component, Component]) -> None:
        """Note that new instances have replaced old ones: factories make instances of the new code from now on."""
        for old, new in pairs.items():
            one = self.supervised.get(new.name)
            if one is not None and one.component is old:
                one.component = new
                one._factory = _makes(one._factory, type(old), type(new))

    async def close(self) -> None:
        """End supervision: the kernel closes."""
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        # A recovery from which a component's own hook closes the kernel is not waited for.
        tasks = [task for task in self._tasks if task is not current_task()]
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)

    def _drop(self, name: str) -> None:
        one = self.supervised.pop(name, None)
        if one is not None and one._task is not None:
            one._task.cancel()

    # -- what happens ----------------------------------------------------------------------------------------------

    def _changed(self, event: StateChanged) -> None:
        if event.new is _ERROR:
            one = self.supervised.get(event.component)
            if one is not None:
                self._look_at(one)

    def _removed(self, event: ComponentRemoved) -> None:
        one = self.supervised.get(event.component)
        if one is not None and not one._removing:
            self._drop(event.component)

    def _look_at(self, one: Supervised) -> None:
        if one._task is None and one.policy.restart != "never" and not one.exhausted and _in_error(one.component):
            task = one._task = kernel_task(self._kernel.loop, self._help(one), f"aiorts help {one.name}", own_context())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _help(self, one: Supervised) -> None:
        """Recover a component until it is out of error, or its budget is used up."""
        try:
            outcome = await self._helped(one)
        finally:
            one._task = None
        if outcome is not None:
            self._kernel.bus.publish(outcome)

    async def _helped(self, one: Supervised) -> Event | None:
        """The result of a recovery; None when the kernel closes."""
        kernel = self._kernel
        error = one.component.last_error
        while not kernel.closed:
            # A recovery that has begun is completed, even if the policy has changed.
            action = "restart" if one._place is not None else one.policy.restart
            if action == "never":
                return None
            one.last_error = error
            delay = one._attempts.failed(kernel.clock.monotonic_ns())
            if delay is None:
                return self._give_up(one)
            _LOG.debug("%s: %s in %.3g s after %s", one.name, action, delay, _text(error))
            await kernel.sleep(delay)
            try:
                await (self._restart(one) if action == "restart" else self._reset(one))
            except Exception as raised:  # noqa: BLE001 - the component's own, of a hook or its construction
                if kernel.closed and isinstance(raised, ClosedError):
                    return None
                error = raised
                continue
            if self.supervised.get(one.name) is not one:
                return None
            if not _in_error(one.component):
                back = await bring_back(one.component)
                if back:
                    _LOG.info("%s: %s; active again with it: %s", one.name, _HELPED[action], ", ".join(back))
            if not _in_error(one.component):
                return ComponentRecovered(one.name, action, one.attempts)
            error = one.component.last_error
        return None

    def _give_up(self, one: Supervised) -> RestartLimitReached:
        policy, error = one.policy, one.last_error
        gone = self._kernel.components.get(one.name) is not one.component
        what = f"{policy.restart} {policy.budget} times within {policy.window:g} s did not help"
        if policy.restart == "reset" and cell(one.component).abandoned is not None:
            what = "a reset cannot help"
        state = "is gone" if gone else "stays in error"
        composite = outer_of(one.component) if one._place is None else one._place.composite
        stopped = stopped_with(one.component, composite)
        if stopped:
            state += f", its composite {stopped} stays stopped,"
        _LOG.error("%s: %s; it %s and is left alone: %s", one.name, what, state, _text(error))
        if gone:
            one._place = None
        return RestartLimitReached(one.name, one.attempts, policy.window, error)

    # -- what is done ----------------------------------------------------------------------------------------------

    async def _reset(self, one: Supervised) -> None:
        component = one.component
        if (composite := group_of(component)) is not None:
            await reset_whole(composite)
            return
        if (abandoned := cell(component).abandoned) is not None:
            # Nothing of the component runs again: another attempt would end no better.
            one._attempts.exhausted = True
            raise abandoned
        for context in component.contexts:
            if context.running and context.state(component) is _ERROR:
                await context.reset(component)
                await context.activate(component)

    async def _restart(self, one: Supervised) -> None:
        kernel, old = self._kernel, one.component
        place = one._place
        if place is None:
            if not _in_error(old):
                return  # it was recovered by another request
            place = one._place = place_of(old)
        if kernel.components.get(one.name) is old:
            one._removing = True
            try:
                await kernel.remove(old)
            finally:
                one._removing = False
            if one.is_to_be_gone:
                one._place = None
                self.supervised.pop(one.name, None)
                return
        new = instance_of(kernel, one.name, one._factory)
        place.configure(new)
        await kernel.add(new)
        one.component = new
        _limit(new, one.policy)
        await place.put_back(new, self._connect)
        one._place = None

    def _connect(self, connectors: Sequence[KeptConnector]) -> None:
        """Connect the ports that still exist; a port that was added at run time may be missing."""
        for profile, reports_losses in connectors:
            kernel = self._kernel
            there = kernel.connectors.get(profile.name) or kernel.service_connectors.get(profile.name)
            if there is not None and set(there.profile.ports) == set(profile.ports):
                continue  # the other end was replaced, too, and has connected
            other = self._made_anew(profile)
            if other is not None and other._place is not None:
                other._place.connectors.append((profile, reports_losses))
                continue
            try:
                self._kernel.connections.renew(profile, reports_losses=reports_losses)
            except ValueError as error:
                _LOG.warning("%s: not connected again after the restart: %s", profile.name, error)

    def _made_anew(self, profile: ConnectorProfile | ServiceConnectorProfile) -> Supervised | None:
        """The end of a connector that is being restarted: it makes the connector when its new instance is there."""
        for path in profile.ports:
            other = self.supervised.get(path.partition(".")[0])
            if other is None or other._place is None:
                continue
            if other._removing or self._kernel.components.get(other.name) is not other.component:
                return other
        return None


def _text(error: BaseException | None) -> str:
    return "an unknown error" if error is None else format_error(error)


def _in_error(component: Component) -> bool:
    return any(state is _ERROR for state in component.states.values())


def _limit(component: Component, policy: Supervision) -> None:
    """Apply the policy's deadlines to the hooks; for a hook that already runs the time counts from now on."""
    cell(component).deadlines = policy.limits
    for member in cell(component).members:
        member.limit_anew()


def _makes(factory: Any, old: type[Component], new: type[Component]) -> Any:
    """The factory with the new class in the place of the old one: that class itself, or a `partial` over it."""
    if isinstance(factory, type):
        return new if (factory.__module__, factory.__qualname__) == (old.__module__, old.__qualname__) else factory
    if type(factory) is not partial:
        return factory
    words = {name: _makes(word, old, new) for name, word in factory.keywords.items()}
    return partial(_makes(factory.func, old, new), *(_makes(word, old, new) for word in factory.args), **words)
