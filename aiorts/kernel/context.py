"""What every execution context is: members in order, the cycle, statistics, a start and an end.

A context is a logical thread. It decides when a cycle runs and for whom (`_next_cause`, `_begin_cycle`,
`_end_cycle`); what happens in a cycle is the same for all (`life.py`), and so are what contains a hook
(`bulkhead.py`) and how it is asked for something (`requests.py`).
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar, Final

from aiorts.errors import ClosedError, ConfigurationError, StateError, said
from aiorts.kernel.bulkhead import TaskDriver
from aiorts.kernel.bus import ContextStarted, ContextStopped, Event
from aiorts.kernel.deadlines import StopBudget
from aiorts.kernel.life import Action, Life, Wait
from aiorts.kernel.member import Member
from aiorts.kernel.members import Members
from aiorts.kernel.requests import Requests, Wish
from aiorts.kernel.unfold import check_free, composed, members_in
from aiorts.model.lifecycle import Event as Transition
from aiorts.model.lifecycle import LifeCycleState
from aiorts.model.names import check_name
from aiorts.model.profile import ContextProfile, ContextStatistics, HookStatistics

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.driver import Driver
    from aiorts.kernel.kernel import Kernel

__all__ = ("Context",)

_LOG = logging.getLogger("aiorts.kernel")
_NO_HOOKS: Final[Mapping[str, HookStatistics]] = MappingProxyType({})


class Context(Members):
    """Base of all execution contexts. Given to `Kernel.start`; ends with `stop` or with its kernel.

    Args:
        name: unique in its kernel; the kernel gives one ("periodic0") where there is none.
        deadline: seconds that a hook may take; None is unlimited. A hook over it is cancelled and its component goes
            to error.
        timing: take the execution time of every hook for `statistics`.
    """

    kind: ClassVar[str] = ""
    exclusive: ClassVar[bool] = False
    """Whether a member can be in no other context."""
    suspends: ClassVar[bool] = True
    """Whether hooks may wait for something: not in a thread, which has no event loop."""

    def __init__(self, *, name: str = "", deadline: float | None = None, timing: bool = False) -> None:
        super().__init__(check_name(name, "context") if name else "")
        self._named = bool(name)
        if deadline is not None and (not isinstance(deadline, int | float) or not 0 < deadline < math.inf):
            raise ConfigurationError(f"{name or self.kind}: deadline = {deadline!r}: expected seconds above 0, or None")
        self.deadline = deadline
        self.timing = timing
        self.ticks = 0
        self._kernel: Kernel | None = None
        self._driver: Driver | None = None
        self._actions: deque[Action] | None = None
        """What is to be done between cycles; None when there is nothing. Taken by `_next_action`."""
        self._life = Life(self)
        self._requests = Requests(self)
        self._last_hooks = _NO_HOOKS
        self._stopping = False
        self._order = 0
        self._sections: tuple[tuple[tuple[Component, ...], ...], ...] = ()
        """Groups of members that run side by side: `kernel/lanes.py`."""
        self._began: asyncio.Future[None] | None = None
        self._now_ns: Callable[[], int] = self._no_time
        """The time on the kernel's clock: its own function, since every hook asks it."""

    # -- what tools see --------------------------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """Whether the context runs: started and not stopped."""
        return self._driver is not None

    @property
    def rate(self) -> float | None:
        """Hz, for contexts that have a rate."""
        return None

    @property
    def statistics(self) -> ContextStatistics:
        """What this context has done so far."""
        return ContextStatistics(cycles=self.ticks, hooks=self._hook_statistics())

    def _hook_statistics(self) -> Mapping[str, HookStatistics]:
        """Of the members there are; once the context has stopped, of those it had then."""
        if self._driver is None:
            return self._last_hooks
        # Copied before they are walked: a thread may run a hook for the first time meanwhile.
        return MappingProxyType(
            {
                f"{member.component.name}.{hook}": HookStatistics(times.count, times.total_ns, times.max_ns)
                for member in tuple(self._members)
                for hook, times in tuple(member.times.items())
            }
        )

    @property
    def profile(self) -> ContextProfile:
        """What this context is, frozen."""
        members = tuple(member.component.name for member in self._members)
        return ContextProfile(self.name, self.kind, self.rate, self.running, members)

    def __repr__(self) -> str:
        members = ", ".join(f"{m.component.name}: {m.state}" for m in self._members)
        rate = "" if self.rate is None else f" {self.rate} Hz"
        how = "running" if self.running else "stopped"
        return f"<{type(self).__name__} {self.name or '?'}{rate} {how} [{members}]>"

    # -- requests --------------------------------------------------------------------------------------------------

    async def activate(self, *components: Component, timeout: float | None = 5.0) -> None:
        """Activate these members, or every inactive one. Takes effect between two cycles, at once when none is running.

        Awaited from a hook of this context it is queued and returns at once.

        Raises:
            StateError: a component named is not inactive, or not a member.
            ComponentError: `on_activated` raised; the cause is chained.
            TransitionTimeout: it did not begin within `timeout` seconds and was withdrawn, or did not end.
        """
        await self._request(Transition.ACTIVATE, LifeCycleState.INACTIVE, components, timeout)

    async def deactivate(self, *components: Component, timeout: float | None = 5.0) -> None:
        """Deactivate these members, or every active one, as `activate`."""
        await self._request(Transition.DEACTIVATE, LifeCycleState.ACTIVE, components, timeout)

    async def reset(self, *components: Component, timeout: float | None = 5.0) -> None:
        """Take these members, or all that are, out of error into inactive, as `activate`."""
        await self._request(Transition.RESET, LifeCycleState.ERROR, components, timeout)

    async def add(self, *components: Component, timeout: float | None = 5.0) -> None:
        """Add components at the end of the order, between two cycles.

        Raises:
            StateError: one is a member already, or cannot run here.
        """
        self._check("add")
        if composed(components):
            from aiorts.kernel import membership

            await membership.enter(self, components, timeout)
            return
        for component in components:
            self._check_may_join(component)
        members = [self._new_member(component) for component in components]
        await self._ask([self._requests.joining(member) for member in members], timeout)

    async def remove(self, *components: Component, timeout: float | None = 5.0) -> None:
        """Remove components between two cycles: they are deactivated and shut down first.

        Raises:
            StateError: one is not a member.
        """
        self._check("remove")
        check_free(components, "leave")
        if composed(components):
            from aiorts.kernel import membership

            await membership.leave(self, components, timeout)
        else:
            await self._remove(components, timeout)

    async def _remove(self, components: Sequence[Component], timeout: float | None = 5.0) -> None:
        members = [self._member(component) for component in components]
        await self._ask([self._requests.leaving(member) for member in members], timeout)

    async def stop(self) -> None:
        """End this context: members are deactivated and shut down in reverse order, hooks get 2 s and then grace steps.

        Awaited from a hook of this context it is queued and returns at once.
        """
        if self._driver is None:
            return
        kernel = self._check("stop")
        await self._stop(StopBudget(kernel.loop))

    def _of(self, kernel: Kernel) -> Context:
        """This context; StateError when another kernel runs it."""
        if self._kernel not in (None, kernel):
            raise StateError(f"{self.name}: runs in another kernel than {kernel.name}; stop it there")
        return self

    # -- for the kinds of context ----------------------------------------------------------------------------------

    def _next_cause(self) -> Wait | None:
        """None when a cycle is due, else what to wait for."""
        raise NotImplementedError

    def _alone(self) -> Member | None:
        """Woken: the one member whose `on_execute` is all there is to do, its cycle begun; as `Life` would, sooner."""
        return None

    def _begin_cycle(self) -> Sequence[Member]:
        """A cycle begins now: who takes part in it."""
        return tuple(self._members)

    def _end_cycle(self, members: Sequence[Member]) -> None:
        """The cycle is over."""

    def _life_began(self) -> None:
        """Every `on_startup` has run."""
        kernel = self._require_kernel()
        self._publish(ContextStarted(self.name))
        kernel._on_loop(self._tell_began)

    def _tell_began(self) -> None:
        if self._began is not None and not self._began.done():
            self._began.set_result(None)

    def _member_ready(self, member: Member) -> None:
        """A member has a cause to run; only event contexts care."""

    def _member_aborted(self, member: Member) -> None:
        """A member is in error now."""

    def _set_rate_now(self, rate: float) -> None:
        raise StateError(f"{self.name}: a context of kind {self.kind} has no rate")

    def _check_can_add(self, component: Component) -> None:
        """Raise StateError when the component cannot run here."""
        if any(member.context is self for member in component._rt_members):
            raise StateError(f"{component.name}: is in {self.name} already")
        if component._rt_composite is not None:
            component._rt_composite._rt_check_context(component, self)
        if component._rt_abandoned is not None:
            raise StateError(f"{component.name}: one of its hooks was left behind and it never runs again; remove it")
        if component._rt_kernel is not None:
            component._rt_kernel._roster.check_settled(component)
        for other in component.contexts:
            if other.exclusive or self.exclusive:
                raise StateError(f"{component.name}: is in {other.name}; a member of a thread context is in no other")

    def _make_driver(self, kernel: Kernel) -> Driver:
        return TaskDriver(self, self._life.steps(), kernel.loop, kernel._call_at, kernel._call_later, kernel.bus)

    def _new_member(self, component: Component) -> Member:
        self._order += 1
        return Member(component, self, self._order)

    def _member_finished(self, member: Member) -> None:
        self._submit(Action(lambda: self._life.finish(member)))

    # -- asking ----------------------------------------------------------------------------------------------------

    async def _request(
        self, event: Transition, state: LifeCycleState, components: tuple[Component, ...], timeout: float | None
    ) -> None:
        self._check(event.value)
        if components:
            members = members_in(self, components, state)
        else:
            members = [member for member in self._members if member.state is state]
        await self._ask([self._requests.transition(member, event) for member in members], timeout)

    def _check_may_join(self, component: Component) -> None:
        if component._rt_kernel is not self._kernel or not component._rt_host.alive:
            where, roster = f"the kernel of {self.name}", self._require_kernel()._roster
            raise StateError(roster.stranger(component, component.name, where))
        self._check_can_add(component)

    async def _ask(self, wishes: Sequence[Wish], timeout: float | None) -> None:
        await self._requests.ask(self._check("request"), wishes, timeout)

    def _inside(self) -> bool:
        """Whether a hook calls that this context would wait for."""
        return self._requests.inside()

    def _submit(self, action: Action) -> None:
        if self._actions is None:
            self._actions = deque()
        self._actions.append(action)
        if self._driver is not None:
            self._driver.kick()

    def _next_action(self) -> Action:
        """The oldest of what is to be done between cycles, taken out; the caller has looked whether there is one."""
        actions = self._actions
        assert actions is not None  # noqa: S101 - the caller has looked
        action = actions.popleft()
        if not actions:
            self._actions = None
        return action

    # -- starting and stopping -------------------------------------------------------------------------------------

    async def _start(self, kernel: Kernel, components: Sequence[Component], *, activate: bool) -> None:
        """Start with these members; `activate` has them active before the first cycle."""
        self._kernel = kernel
        self._now_ns = kernel.clock.monotonic_ns
        self._stopping = False
        while self._actions:
            self._next_action()  # what was wished of it before does not count
        for component in components:
            self._check_can_add(component)
            self._attach(self._new_member(component))
        first = self._members if activate else ()
        asked = self._requests.submit(kernel, [self._requests.transition(m, Transition.ACTIVATE) for m in first])
        if self._sections:
            from aiorts.kernel.lanes import cycles

            self._submit(Action(partial(cycles, self)))
        self._began = kernel.loop.create_future()
        self._driver = self._make_driver(kernel)
        await self._began
        self._began = None
        if asked:
            await asyncio.wait([one.future for one in asked])
            self._requests.forget(asked)
        for one in asked:
            one.result(self.name, None)

    async def _stop(self, budget: StopBudget) -> None:
        driver = self._driver
        if driver is None:
            return
        self._stopping = True
        driver.hurry(budget)
        driver.kick()
        if not self._inside():
            await asyncio.shield(driver.ended)

    def _life_ended(self, error: BaseException | None) -> None:
        """The last step was carried out, or the kernel's own code failed."""
        kernel = self._require_kernel()
        self._last_hooks = self._hook_statistics()
        self._driver = None
        for member in tuple(reversed(self._members)):
            self._detach(member)
        while self._actions:
            action = self._next_action()
            if action.done is not None:
                action.done(ClosedError(f"{self.name}: the context has stopped"))
        self._requests.close()
        self._tell_began()
        kernel._context_ended(self)
        self._publish(ContextStopped(self.name, None if error is None else said(error)))
        if error is not None and not isinstance(error, asyncio.CancelledError | GeneratorExit):
            _LOG.error("context %s ended by a fault of aiorts itself; please report it", self.name, exc_info=error)

    def _activity(self) -> int:
        """A number that changes while something happens here."""
        driver = self._driver
        if driver is None:
            return self.ticks
        member = driver.current
        return hash((self.ticks, driver.hooks_run, 0 if member is None else member.order))

    # -- for the drivers -------------------------------------------------------------------------------------------

    def _no_time(self) -> int:
        return self._require_kernel().clock.monotonic_ns()

    def _hooks_wanted(self) -> bool:
        return self._require_kernel().bus.hooks_wanted

    def _publish(self, event: Event) -> None:
        kernel = self._require_kernel()
        kernel._on_loop(lambda: kernel.bus.publish(event))

    def _interrupted(self, error: KeyboardInterrupt) -> None:
        self._require_kernel()._interrupted(error)

    def _check(self, what: str) -> Kernel:
        kernel = self._kernel
        if kernel is None or self._driver is None:
            where = self.name or type(self).__name__
            raise StateError(f"{where}: cannot {what}: the context does not run; kernel.start it")
        kernel.check_thread(f"{self.name}.{what}")
        return kernel

    def _require_kernel(self) -> Kernel:
        if self._kernel is None:
            raise StateError(f"{self.name or type(self).__name__}: was never started")
        return self._kernel
