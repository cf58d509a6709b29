"""The base of all execution contexts: members in order, the cycle, statistics, a start and an end.

A context is a logical thread. It decides when a cycle runs and for whom (`_next_cause`, `_begin_cycle`,
`_end_cycle`); what happens in a cycle is the same for all (`cycle.py`), and so are what contains a hook
(`task_driver.py`) and what runs it and takes what is asked of it (`runner.py`).
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, ClassVar, Final

from aiorts.clock import to_ns
from aiorts.errors import StateError
from aiorts.kernel.execution.apart import check_apart
from aiorts.kernel.execution.cell import as_group, cell, check_free, flattened, group_among
from aiorts.kernel.execution.cycle import Action, Wait
from aiorts.kernel.execution.member import Member, is_open
from aiorts.kernel.execution.runner import Runner
from aiorts.kernel.execution.task_driver import TaskDriver
from aiorts.kernel.loop.deadlines import StopBudget
from aiorts.kernel.ports import InPort
from aiorts.kernel.ports.in_port import set_open
from aiorts.kernel.ports.wiring import realtime_fault
from aiorts.model.declared import Option, check_values
from aiorts.model.lifecycle import Event as Transition
from aiorts.model.lifecycle import LifecycleState, OverdueHook
from aiorts.model.names import check_name
from aiorts.model.profile import ContextProfile, ContextStatistics, HookStatistics

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import ComponentSide, KernelSide
    from aiorts.kernel.execution.cycle import Driver, PassSteps
    from aiorts.kernel.ports import Port

_NO_HOOKS: Final[Mapping[str, HookStatistics]] = MappingProxyType({})

Deadline = Annotated[
    float | None,
    Option(
        "The longest that a hook may take by the kernel's clock; by default it is unlimited. A hook over it is "
        "cancelled and its component goes to error; one that blocks the loop goes there when it returns. The time "
        "counts even where other code blocks the loop meanwhile. On a simulated clock code that blocks takes no time.",
        unit="s",
        above=0,
    ),
]
Timing = Annotated[bool, Option("Whether the execution time of every hook is taken, for statistics.")]


class Context:
    """Base of all execution contexts. Given to `Kernel.start`; ends with `stop` or with its kernel.

    Args:
        name: unique in its kernel; the kernel gives one ("periodic0") where there is none.

    Raises:
        ConfigurationError: an option is out of range.
    """

    kind: ClassVar[str] = ""
    exclusive: ClassVar[bool] = False
    """Whether a member can be in no other context."""
    suspends: ClassVar[bool] = True
    """Whether hooks may wait for something: not in a thread, which has no event loop."""
    features: ClassVar[bool] = True
    """Whether connectors at the ports of members may have features, such as a lifespan."""
    _member_class: ClassVar[type[Member]] = Member
    # What few contexts ever have stands in the class until then: an instance without it is smaller.
    _divided: PassSteps | None = None
    """How a pass goes over the members where some run side by side."""
    _faults = 0
    """The number of faults in the kernel's own code, about no member, after which the context went on."""
    _ended_by: BaseException | None = None
    """The error that ends the context."""

    def __init__(self, *, name: str = "", deadline: Deadline = None, timing: Timing = False) -> None:
        self.name = check_name(name, "context") if name else ""
        if deadline is not None:
            self._check_options(Context, deadline=deadline)
        self.deadline = deadline
        self.timing = timing
        self.ticks = 0
        self._kernel: KernelSide | None = None
        self._members: list[Member] = []
        self._updating = 0
        """The number of members that take part in the second pass of a cycle."""
        self._actions: deque[Action] | None = None
        """The actions to carry out between cycles; None when there are none. `Life.next_action` takes them."""
        self.runner = Runner(self, named=bool(name))
        """The runner of the context, for services and for kinds of contexts; applications use the context itself."""
        self._last_hooks: Mapping[str, HookStatistics] = _NO_HOOKS
        self._stopping = False
        self._order = 0
        self._began: asyncio.Future[None] | None = None
        self._now_ns: Callable[[], int] = self._no_time
        """The time on the kernel's clock: its own function, since every hook asks it."""

    def _check_options(self, declaring: type[Context], /, **given: object) -> None:
        """Refuse numbers and words that the signature of a class does not take, by its declarations (`Option`).

        Those of files and command lines are checked in any case.

        Raises:
            ConfigurationError: names the first such option.
        """
        check_values(declaring, given, f"{self.name or self.kind}: ")

    # -- what tools see --------------------------------------------------------------------------------------------

    @property
    def members(self) -> tuple[ComponentSide, ...]:
        """The components in this context, in order of execution."""
        return tuple(member.component for member in self._members)

    def state(self, component: ComponentSide) -> LifecycleState:
        """The lifecycle state of a member; StateError when the component is not one."""
        return self.runner.member(component).state

    @property
    def running(self) -> bool:
        """Whether the context runs: started and not stopped."""
        return self.runner.driver is not None

    @property
    def rate(self) -> float | None:
        """Hz, for contexts that have a rate."""
        return None

    @property
    def statistics(self) -> ContextStatistics:
        """The cycles, overruns and times of this context so far."""
        return replace(self.counts, hooks=self._hook_statistics())

    @property
    def counts(self) -> ContextStatistics:
        """`statistics` without `hooks`: as cheap however many members there are."""
        return ContextStatistics(self.ticks, at_ns=0 if self._kernel is None else self._now_ns())

    def _hook_statistics(self) -> Mapping[str, HookStatistics]:
        """The statistics of the present members; after the end of the context, of its last ones."""
        if self.runner.driver is None:
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
        """A frozen description of the context at this moment."""
        members = tuple(member.component.name for member in self._members)
        return ContextProfile(self.name, self.kind, self.rate, self.running, members)

    def __repr__(self) -> str:
        members = ", ".join(f"{m.component.name}: {m.state}" for m in self._members)
        rate = "" if self.rate is None else f" {self.rate} Hz"
        how = "running" if self.running else "stopped"
        return f"<{type(self).__name__} {self.name or '?'}{rate} {how} [{members}]>"

    # -- requests --------------------------------------------------------------------------------------------------

    async def activate(self, *components: ComponentSide, timeout: float | None = 5.0) -> None:
        """Activate these members, or every inactive one. Takes effect between two cycles, at once when none is running.

        Awaited from a hook of this context it is queued and returns at once.

        Raises:
            StateError: a component named is not inactive, or not a member.
            ComponentError: `on_activated` raised; the cause is chained.
            TransitionTimeout: it did not begin within `timeout` seconds and was withdrawn, or did not end.
        """
        await self._request(Transition.ACTIVATE, LifecycleState.INACTIVE, components, timeout)

    async def deactivate(self, *components: ComponentSide, timeout: float | None = 5.0) -> None:
        """Deactivate these members, or every active one, as `activate`."""
        await self._request(Transition.DEACTIVATE, LifecycleState.ACTIVE, components, timeout)

    async def reset(self, *components: ComponentSide, timeout: float | None = 5.0) -> None:
        """Take these members, or all that are, out of error into inactive, as `activate`."""
        await self._request(Transition.RESET, LifecycleState.ERROR, components, timeout)

    async def add(self, *components: ComponentSide, timeout: float | None = 5.0) -> None:
        """Add components at the end of the order, between two cycles.

        Raises:
            StateError: one is a member already, or cannot run here.
        """
        runner = self.runner
        runner.check("add")
        check_apart(flattened(components), (member.component for member in self._members), self.name)
        if (group := group_among(components)) is not None:
            await group.join(self, components, timeout)
            return
        for component in components:
            runner.check_may_join(component)
        members = [self._new_member(component) for component in components]
        await runner.ask([runner.joining(member) for member in members], timeout)

    async def remove(self, *components: ComponentSide, timeout: float | None = 5.0) -> None:
        """Remove components between two cycles: they are deactivated and shut down first.

        Raises:
            StateError: one is not a member.
        """
        self.runner.check("remove")
        check_free(components, "leave")
        if (group := group_among(components)) is not None:
            await group.leave(self, components, timeout)
        else:
            await self.runner.release(components, timeout)

    async def stop(self) -> None:
        """End this context: members are deactivated and shut down in reverse order, hooks get 2 s and then grace steps.

        Awaited from a hook of this context it is queued and returns at once.
        """
        if self.runner.driver is None:
            return
        kernel = self.runner.check("stop")
        await self.runner.end(StopBudget(kernel.loop))

    async def _request(
        self, event: Transition, state: LifecycleState, components: tuple[ComponentSide, ...], timeout: float | None
    ) -> None:
        runner = self.runner
        runner.check(event.value)
        members = [] if components else [member for member in self._members if member.state is state]
        for component in components:
            if (group := as_group(component)) is None:
                members.append(runner.member(component))
            else:  # of those that it stands for, who can take part
                members += [member for member in map(runner.member, group.parts) if member.state is state]
        await runner.ask([runner.transition(member, event) for member in members], timeout)

    # -- for the kinds of context ----------------------------------------------------------------------------------

    def _next_cause(self) -> Wait | None:
        """The wait until the next cycle; None: a cycle is due now."""
        raise NotImplementedError

    def _alone(self) -> Member | None:
        """Begin the cycle and return its member, if one `on_execute` is all there is to run; None: `Life` begins it."""
        return None

    def _begin_cycle(self) -> Sequence[Member]:
        """Begin a cycle and return the members that take part."""
        return tuple(self._members)

    def _unread_by(self, member: Member) -> int:
        """The number of unread samples that a member still has to read before it ends."""
        return 0

    def _begin_last_cycle(self, member: Member) -> bool:
        """Begin another cycle of a member that is about to end and has unread samples; False: it has none."""
        return False

    def _end_cycle(self, members: Sequence[Member]) -> None:
        """Note that the cycle of these members is over."""

    def _life_began(self) -> None:
        """Note that every `on_startup` has run."""
        self.runner.began()

    def _life_ended(self, error: BaseException | None) -> None:
        """Note that the last step was carried out, or that the kernel's own code failed with `error`."""
        self.runner.ended(error)

    def _request_came(self) -> None:
        """Wake the context for an action between two cycles. From any thread."""

    def _member_aborted(self, member: Member) -> None:
        """Note that a member is in error now."""

    def _set_rate_now(self, rate: float) -> None:
        raise StateError(f"{self.name}: a context of kind {self.kind} has no rate")

    def _check_can_add(self, component: ComponentSide) -> None:
        """Raise StateError when the component cannot run here."""
        here = cell(component)
        if any(member.context is self for member in here.members):
            raise StateError(f"{component.name}: is in {self.name} already")
        if here.group is not None:
            here.group.check_context(component, self)
        if here.abandoned is not None:
            raise StateError(f"{component.name}: one of its hooks was abandoned and it never runs again; remove it")
        if here.kernel is not None:
            here.kernel.registry.check_settled(component)
        check_apart((component,), (member.component for member in self._members), self.name or self.kind)
        for other in component.contexts:
            if other.exclusive or self.exclusive:
                raise StateError(f"{component.name}: is in {other.name}; a member of a thread context is in no other")
        for port in () if self.features else component.ports.values():
            if fault := realtime_fault(port):
                raise StateError(
                    f"{component.name}: {fault}, and no real-time thread has such a connector at its ports; "
                    "connect without that option, or take another kind of context"
                )

    def _make_driver(self, kernel: KernelSide) -> Driver:
        return TaskDriver(self, self.runner.life.steps(), kernel.loop, kernel.call_at, kernel._call_later, kernel.bus)

    def _overdue(self, member: Member) -> OverdueHook | None:
        """The member's running hook, if it has exceeded its deadline; else None."""
        held = None if self.runner.driver is None else self.runner.driver.held_by(member)
        if held is None:
            return None
        hook, running_ns, deadline_ns = member.hook, self.runner.kernel.clock.monotonic_ns() - held[0], to_ns(held[1])
        return OverdueHook(hook, running_ns, deadline_ns) if running_ns > deadline_ns else None

    def _new_member(self, component: ComponentSide) -> Member:
        self._order += 1
        member = self._member_class(component, self, self._order)
        if self.runner.driver is not None:
            self.runner.driver.limit_anew(member)
        return member

    def _port_added(self, member: Member, port: Port[object]) -> None:
        """Note a new port of a member; an in-port opens if the component takes samples (`is_open`)."""
        if isinstance(port, InPort):
            member.in_ports.append(port)
            takes = is_open(member.component)
            set_open(port, takes)

    def _port_removed(self, member: Member, port: Port[object]) -> None:
        """Remove a port from the in-ports of a member."""
        if isinstance(port, InPort) and port in member.in_ports:
            member.in_ports.remove(port)

    def _set_ports_open(self, member: Member) -> None:
        """Open the in-ports if the component is active in a context, or is in no context; else close them."""
        takes = is_open(member.component)
        for port in member.component.ports.values():
            if isinstance(port, InPort):
                set_open(port, takes)

    # -- for the drivers -------------------------------------------------------------------------------------------

    def _no_time(self) -> int:
        return self.runner.kernel.clock.monotonic_ns()
