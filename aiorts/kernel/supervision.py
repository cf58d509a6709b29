"""Helps components out of error as their policy says: `model/supervision.py` decides when, this carries it out.

For each supervised component there is at most one task, only while it is in error. A reset runs `on_reset` and
activates again. A restart puts a new instance of the same name in the old one's place: configuration, contexts, place
in their order and in a composite, and connectors are as they were; what was queued in these is dropped as disconnected,
and calls in progress end with ServiceUnavailable. The connectors are new objects that count from 0; the old ones keep
their counts. Those whom a composite deactivated for its error are then activated again; who was deactivated on purpose
stays off.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from aiorts.errors import ClosedError, DeclarationError, said
from aiorts.kernel.bus import ComponentRemoved, Event, StateChanged
from aiorts.kernel.comeback import bring_back, stopped_with
from aiorts.kernel.service_port import ServiceConnector
from aiorts.kernel.standing import Standing, instance_of, reset_whole, standing_of
from aiorts.kernel.tasks import current_task, kernel_task
from aiorts.kernel.unfold import is_composite
from aiorts.model.lifecycle import LifeCycleState
from aiorts.model.supervision import Attempts, Supervision

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.life import Done, Steps
    from aiorts.model.profile import ConnectorProfile
    from aiorts.model.service_profile import ServiceConnectorProfile

__all__ = ("Helped", "HelpExhausted", "Supervised", "Supervisor")

_LOG = logging.getLogger("aiorts.kernel")
_ERROR: Final = LifeCycleState.ERROR
_INACTIVE: Final = LifeCycleState.INACTIVE
_HELPED: Final = {"reset": "was reset", "restart": "was restarted"}


@dataclass(frozen=True, slots=True)
class Helped(Event):
    """A supervised component was in error and is active again."""

    component: str
    action: str
    """"reset" or "restart"."""
    attempt: int
    """How often it was helped so far."""


@dataclass(frozen=True, slots=True)
class HelpExhausted(Event):
    """A supervised component failed more often than its budget allows: it is left as it is."""

    component: str
    attempts: int
    window: float
    """Seconds."""
    error: BaseException | None = None


@dataclass(slots=True)
class _Place:
    """Where a component was: enough to put another one there."""

    contexts: list[tuple[Context, int, bool]]
    """With the place in the order, and whether it is to be active there."""
    connectors: list[ConnectorProfile | ServiceConnectorProfile]
    """The first port of one of data is the writer's."""
    standing: Standing
    """Its configuration, and its place in a composite."""


class Supervised:
    """What is known of one supervised component; for reading."""

    def __init__(self, component: Component, policy: Supervision, factory: Callable[[str], Component]) -> None:
        self.policy = policy
        self.component = component
        """The instance there is now; after a restart another one."""
        self.last_error: BaseException | None = None
        """What it was last helped for, or not helped any more."""
        self._attempts = Attempts(policy)
        self._factory = factory
        self._task: asyncio.Task[None] | None = None
        self._place: _Place | None = None
        self._removing = False

    @property
    def name(self) -> str:
        """The component's name."""
        return self.component.name

    @property
    def attempts(self) -> int:
        """How often it was reset or restarted, whether that helped or not."""
        return self._attempts.total

    @property
    def exhausted(self) -> bool:
        """Whether its budget was used up: it is not helped any more, until `supervise` is called anew."""
        return self._attempts.exhausted

    def __repr__(self) -> str:
        how = "exhausted" if self.exhausted else self.policy.restart
        return f"<Supervised {self.name} {how} {self.attempts} attempts>"


class Supervisor:
    """The supervised components of one kernel."""

    def __init__(self, kernel: Kernel) -> None:
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
        """From now on; what was said of this component before does not count."""
        if not isinstance(policy, Supervision):
            raise DeclarationError(f"{component.name}: expected Supervision(...), got {policy!r}")
        if factory is not None and not callable(factory):
            raise DeclarationError(f"{component.name}: factory = {factory!r:.80}: expected a function of a name")
        if is_composite(component) and (policy.restart == "restart" or policy.limits is not None):
            what = "cannot be made anew" if policy.restart == "restart" else "runs no hooks of its own"
            raise DeclarationError(f'{component.name}: a composite {what}; supervise its members, or restart="reset"')
        self._drop(component.name)
        one = self.supervised[component.name] = Supervised(component, policy, factory or type(component))
        _limit(component, policy)
        self._look_at(one)
        return one

    async def close(self) -> None:
        """The kernel closes: nobody is helped any more."""
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        # One that a component's own hook closes the kernel from is not waited for.
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
            task = one._task = kernel_task(self._kernel.loop, self._help(one), f"aiorts help {one.name}")
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _help(self, one: Supervised) -> None:
        """Until it is out of error, or its budget is used up."""
        kernel, action = self._kernel, one.policy.restart
        try:
            error = one.component.last_error
            while not kernel._closed:
                one.last_error = error
                delay = one._attempts.failed(kernel.clock.monotonic_ns())
                if delay is None:
                    self._give_up(one)
                    return
                _LOG.debug("%s: %s in %.3g s after %s", one.name, action, delay, _said(error))
                await kernel.sleep(delay)
                try:
                    await (self._restart(one) if action == "restart" else self._reset(one))
                except ClosedError:
                    if kernel._closed:
                        return
                    raise
                except Exception as raised:  # noqa: BLE001 - the component's own, of a hook or its construction
                    error = raised
                    continue
                if not _in_error(one.component):
                    back = await bring_back(one.component)
                    if back:
                        _LOG.info("%s: %s; active again with it: %s", one.name, _HELPED[action], ", ".join(back))
                if not _in_error(one.component):
                    kernel.bus.publish(Helped(one.name, action, one.attempts))
                    return
                error = one.component.last_error
        finally:
            one._task = None

    def _give_up(self, one: Supervised) -> None:
        policy, error = one.policy, one.last_error
        gone = self._kernel.components.get(one.name) is not one.component
        what = f"{policy.restart} {policy.budget} times within {policy.window:g} s did not help"
        if policy.restart == "reset" and one.component._rt_abandoned is not None:
            what = "a reset cannot help"
        state = "is gone" if gone else "stays in error"
        composite = one.component._rt_composite if one._place is None else one._place.standing.composite
        stopped = stopped_with(one.component, composite)
        if stopped:
            state += f", its composite {stopped} stays stopped,"
        _LOG.error("%s: %s; it %s and is left alone: %s", one.name, what, state, _said(error))
        self._kernel.bus.publish(HelpExhausted(one.name, one.attempts, policy.window, error))
        if gone:
            one._place = None
            self.supervised.pop(one.name, None)

    # -- what is done ----------------------------------------------------------------------------------------------

    async def _reset(self, one: Supervised) -> None:
        component = one.component
        if is_composite(component):
            await reset_whole(component)
            return
        if component._rt_abandoned is not None:
            # Nothing of it runs again: another attempt would end no better.
            one._attempts.exhausted = True
            raise component._rt_abandoned
        for context in component.contexts:
            if context.running and context.state(component) is _ERROR:
                await context.reset(component)
                await context.activate(component)

    async def _restart(self, one: Supervised) -> None:
        kernel, old = self._kernel, one.component
        place = one._place
        if place is None:
            if not _in_error(old):
                return  # somebody else has helped it
            place = one._place = _place_of(old)
        if kernel.components.get(one.name) is old:
            one._removing = True
            try:
                await kernel.remove(old)
            finally:
                one._removing = False
        new = instance_of(kernel, one.name, one._factory)
        place.standing.configure(new)
        await kernel.add(new)
        one.component = new
        _limit(new, one.policy)
        kept = place.standing.kept
        self._connect([profile for profile in place.connectors if profile.name in kept])
        await place.standing.join(kernel, new)
        self._connect([profile for profile in place.connectors if profile.name not in kept])
        for context, order, active in place.contexts:
            if context.running and kernel.contexts.get(context.name) is context:
                if context not in new.contexts:
                    await context.add(new)
                await context._ask([(f"put {new.name} in its place", _putting(context, new, order))], 5.0)
                if active and context.state(new) is _INACTIVE:
                    await context.activate(new)
        one._place = None

    def _connect(self, profiles: Sequence[ConnectorProfile | ServiceConnectorProfile]) -> None:
        """Connect anew what there still is; a port that was added at run time may be missing."""
        for profile in profiles:
            kernel = self._kernel
            there = kernel.connectors.get(profile.name) or kernel.service_connectors.get(profile.name)
            if there is not None and set(there.profile.ports) == set(profile.ports):
                continue  # the other end was made anew, too, and has done it
            other = self._made_anew(profile)
            if other is not None and other._place is not None:
                other._place.connectors.append(profile)
                continue
            try:
                self._kernel._connections.renew(profile)
            except ValueError as error:
                _LOG.warning("%s: not connected again after the restart: %s", profile.name, error)

    def _made_anew(self, profile: ConnectorProfile | ServiceConnectorProfile) -> Supervised | None:
        """One of the ends that goes or is not there yet: it connects when it has come."""
        for path in profile.ports:
            other = self.supervised.get(path.partition(".")[0])
            if other is None or other._place is None:
                continue
            if other._removing or self._kernel.components.get(other.name) is not other.component:
                return other
        return None


def _said(error: BaseException | None) -> str:
    return "an unknown error" if error is None else said(error)


def _in_error(component: Component) -> bool:
    return any(state is _ERROR for state in component.states.values())


def _limit(component: Component, policy: Supervision) -> None:
    """Put the deadlines of its hooks in force, from the next run of each on."""
    component._rt_deadlines = policy.limits
    for member in component._rt_members:
        member.settle()


def _place_of(component: Component) -> _Place:
    contexts = [(m.context, m.order, m.state is not _INACTIVE) for m in component._rt_members]
    # One from the component to itself hangs on two of its ports.
    found = {connector.name: connector for port in component.ports.values() for connector in port.connectors}
    return _Place(contexts, [_profile_of(connector) for connector in found.values()], standing_of(component))


def _profile_of(connector: Connector | ServiceConnector) -> ConnectorProfile | ServiceConnectorProfile:
    if isinstance(connector, ServiceConnector):
        return connector.profile
    return _with_ends(connector.profile, connector.out.path, connector.in_.path)


def _with_ends(profile: ConnectorProfile, out: str, in_: str) -> ConnectorProfile:
    return replace(profile, ports=(out, in_, *(path for path in profile.ports if path not in (out, in_))))


def _putting(context: Context, component: Component, order: int) -> Callable[[Done], Steps]:
    """Steps that give it the place in the order that it had."""

    def steps(done: Done) -> Steps:
        context._member(component).order = order
        context._members.sort(key=lambda member: member.order)
        done(None)
        yield from ()

    return steps
