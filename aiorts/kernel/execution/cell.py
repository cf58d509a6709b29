"""The cell: the object with all that the kernel keeps on a component, held in its one private attribute.

`cell(component)` gives it. In a reload the new instance gets the old one's cell
(`exchange_cells`), since ports, connectors and members know that very object. A component may stand for others: then
there is a `Group` in its cell, and who runs in its place is known by that alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from threading import get_ident
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

from aiorts.errors import StateError
from aiorts.kernel.execution.entry_lock import EntryLock
from aiorts.kernel.loop.log import LogFields
from aiorts.kernel.loop.tasks import current_task, owner_of
from aiorts.kernel.ports import Port, Turns
from aiorts.kernel.ports.host import KernelSide as PortKernelSide
from aiorts.kernel.ports.host import PortHost

if TYPE_CHECKING:
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.deadline_timer import DeadlineTimer
    from aiorts.kernel.execution.member import Member, Visit
    from aiorts.kernel.loop.bus import Bus
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.loop.log import ComponentLog
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.model.configuration.sets import ConfigurationState
    from aiorts.model.lifecycle import LifecycleState

ATTRIBUTE: Final = "_rt"
"""The name of the component's attribute that holds its cell."""
_NOTHING: Final[Mapping[Any, Any]] = MappingProxyType({})


class ComponentSide(Protocol):
    """A component, as a context sees it."""

    _rt: Cell

    @property
    def name(self) -> str: ...

    """The instance's name."""

    @property
    def log(self) -> ComponentLog: ...

    """Its logger."""

    @property
    def ports(self) -> Mapping[str, Port[Any]]: ...

    """Its ports, by name."""

    @property
    def contexts(self) -> tuple[Context, ...]: ...

    """The contexts it is in."""

    @property
    def states(self) -> Mapping[str, LifecycleState]: ...

    """Its lifecycle state in each of them."""

    @property
    def last_error(self) -> BaseException | None: ...

    """The error by which the component failed last."""


class Configured(ComponentSide, Protocol):
    """A component, as a change of its configuration sees it."""

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], object] | None:
        """See `Component.check_configuration`."""

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """See `Component.ports_for`."""
        ...


class KernelSide(PortKernelSide, Protocol):
    """A kernel, as a context sees it: more than the host of a port does."""

    bus: Bus
    _contain_interrupts: bool
    _stop_due: bool
    call_at: Callable[[int, Callable[[], None]], Cancellable]
    _call_later: Callable[[float, Callable[[], None]], Cancellable]
    registry: Any
    closing: asyncio.Future[StopBudget]
    """Resolved, with the time that is left, once it begins to close."""

    @property
    def components(self) -> Mapping[str, ComponentSide]: ...

    """The components of the kernel, by name."""

    @property
    def contexts(self) -> Mapping[str, Context]: ...

    """The contexts that run, by name."""

    @property
    def services(self) -> Sequence[Any]: ...

    """The services of the kernel, in the order in which they were attached."""

    def check_thread(self, what: str) -> None:
        """Raise ThreadError unless this is the thread of the kernel's loop."""

    def check_mine(self, component: Any, what: str) -> None:
        """Raise StateError unless `component` belongs to this kernel."""

    def monitor_deadlines(self, context: Context) -> DeadlineTimer | None: ...

    """The monitor that finds out why a context is late."""

    def call_on_loop(self, callback: Callable[[], object]) -> None:
        """Call `callback` on the loop: now if this is the loop's thread, soon otherwise."""

    def call_from_thread(self, function: Any, /, *args: Any, timeout: float | None = None) -> Any:
        """Call on the loop and block this thread until it is done."""

    def pass_on_interrupt(self, error: BaseException) -> None:
        """A hook raised a KeyboardInterrupt. From any thread."""

    def _faulted(self) -> None:
        """The kernel's own code has failed. From any thread."""

    def _context_ended(self, context: Context) -> None:
        """A context has stopped."""


class MadeByClass:
    """An attribute that the class makes for each instance: it goes into no other process with the component."""

    __slots__ = ()


class Cell(PortHost):
    """The values that the kernel keeps on one component. A rare value is a class attribute until it is set."""

    __slots__ = ("configuration", "entry_lock", "hook_kinds", "judged", "members", "named")

    if TYPE_CHECKING:
        kernel: KernelSide | None  # pyright: ignore[reportIncompatibleVariableOverride] # the whole of it

    last_error: BaseException | None = None
    mended: BaseException | None = None
    """The last error, once the component was reset or activated after that error."""
    abandoned: BaseException | None = None
    """The error because of which the component never runs again: a hook ignored every cancellation and still runs."""
    failed_in: tuple[Member, str] | None = None
    """The member and the hook whose failure is being logged."""
    log: ComponentLog | None = None
    deadlines: Mapping[str, float] | None = None
    """Seconds that single hooks may take."""
    group: Group | None = None
    """The group that the component is a member of."""
    stands_for: Group | None = None
    """The group that the component stands for, if it does."""
    held_for: str = ""
    """The composite of another kernel that the component is a member of."""
    previous_placements: tuple[Any, ...] = ()
    """The contexts in which the component ran before it joined its group, as the group keeps them."""
    own: Mapping[Any, Any] = _NOTHING
    """The values that kinds of components keep, each under the class of the kind."""
    port_group: Mapping[str, Port[Any]] = _NOTHING
    """The ports that its `ports_for` returned."""
    port_maker: Any = None
    """The maker of the component's ports, while the component is made to replace another; else None."""
    successor: Any = None
    """The instance that replaces this one for the time being: requests to this instance go to the successor."""
    held_open: bool = False
    """Whether the in-ports take samples in every state: the component is being moved, and no sample may be dropped."""
    removals: int = 0
    """How often the removal of the component was requested."""
    changes_queued: int = 0
    """The number of changes of parameters that wait for the end of a cycle."""

    def __init__(self, name: str, named: bool, hook_kinds: dict[str, int], configuration: ConfigurationState) -> None:
        super().__init__(name, Turns())
        self.named = named
        """Whether the user, not the kernel, named the component."""
        self.hook_kinds = hook_kinds
        """How each hook is to be run: a `HookKind` by the hook's name."""
        self.configuration = configuration
        """Parameters, sets and the values in force."""
        self.judged = False
        """Whether the component's own checks have seen the values in force."""
        self.members: list[Member] = []
        """The component in each of its contexts."""
        self.entry_lock = EntryLock()

    @property
    def running(self) -> Member | Visit | None:
        """The member whose hook runs now, or the call that is served."""
        lock = self.entry_lock
        if lock.inside is None and not lock.shared and self.members:
            # The hooks of a component in one context may run without taking the lock.
            return self.members[0] if self.members[0].runs else None
        return cast("Member | Visit | None", lock.inside)

    def rename(self, name: str) -> None:
        """Give the component another name; only before it belongs to a kernel."""
        self.name = name
        self.named = True

    @property
    def standing(self) -> tuple[Any, ...]:
        """The values that outlive an instance: its errors, deadlines, group and previous placements."""
        return self.last_error, self.mended, self.deadlines, self.group, self.previous_placements

    @standing.setter
    def standing(self, standing: tuple[Any, ...]) -> None:
        self.last_error, self.mended, self.deadlines, self.group, self.previous_placements = standing


_OF_THE_CODE: Final = ("abandoned", "configuration", "failed_in", "hook_kinds", "judged", "log", "own", "port_group")
"""The attributes that go with an instance to another cell; the others belong to the place: contexts, ports, kernel."""


def cell(component: ComponentSide) -> Cell:
    """The cell of a component; AttributeError before `Component.__init__` has run."""
    return component._rt


def standing_error(component: ComponentSide) -> BaseException | None:
    """The error by which the component failed last; None once it was reset, or activated, after that."""
    error = component.last_error
    return None if error is cell(component).mended else error


def exchange_cells(one: ComponentSide, other: ComponentSide) -> None:
    """Put each of two instances in the other's place: it gets the other's cell, with what belongs to its own code."""
    first, second = cell(one), cell(other)
    for name in _OF_THE_CODE:
        mine, others = getattr(first, name), getattr(second, name)
        setattr(first, name, others)
        setattr(second, name, mine)
    one._rt, other._rt = second, first


def is_inside(component: ComponentSide) -> bool:
    """Whether this is code of the component itself: its hook, a call that it serves, or a task that it started."""
    here = cell(component)
    if here.thread_id == get_ident():
        return here.running is not None
    return owner_of(current_task()) is component


def has_cell(component: object) -> bool:
    """Whether this is a component, and `Component.__init__` has run."""
    return isinstance(getattr(component, ATTRIBUTE, None), Cell)


def log_fields(component: ComponentSide) -> LogFields:
    """The kernel, hook and tick for a log record that the component makes now."""
    here = cell(component)
    kernel = "" if here.kernel is None else here.kernel.name
    if here.failed_in is not None:
        member, hook = here.failed_in
        return LogFields(kernel, here.name, hook, member.tick)
    running = here.running
    if running is not None:
        return LogFields(kernel, here.name, running.hook, running.tick)
    return LogFields(kernel, here.name)


# -- components that stand for others ------------------------------------------------------------------------------


class Group(Protocol):
    """A component that stands for others (a composite), as the kernel sees it."""

    @property
    def name(self) -> str: ...

    """The component's name."""

    @property
    def root(self) -> Group: ...

    """The outermost group that this group runs with."""

    @property
    def holds(self) -> bool: ...

    """Whether the members run with the group, or are about to; else each may run in any context."""

    @staticmethod
    async def start(
        kernel: Any, context: Context, components: Sequence[Any], *, activate: bool, timeout: float | None
    ) -> None:
        """Start a context with groups among its components."""

    @staticmethod
    async def join(context: Context, components: Sequence[Any], timeout: float | None) -> None:
        """Components, groups among them, join a running context."""

    @staticmethod
    async def leave(context: Context, components: Sequence[Any], timeout: float | None) -> None:
        """Components, groups among them, leave a running context."""

    @property
    def parts(self) -> tuple[ComponentSide, ...]: ...

    """The members that run in place of the group, in order of execution."""

    def check_startable(self) -> None:
        """Raise StateError when the group runs already."""

    def runs_apart(self, member: Any) -> bool: ...

    """Whether this member is a group with a schedule of its own."""

    @property
    def is_spread(self) -> bool: ...

    """Whether each member has a schedule of its own, so that the group itself is in no context."""

    async def request(self, what: str, timeout: float | None) -> None:
        """Activate, deactivate or reset all members."""

    async def added(self) -> None:
        """Note that the group is being added to the kernel."""

    async def dissolve(self) -> None:
        """Put the members back where they ran before: the group is about to leave the kernel."""

    def removed(self) -> None:
        """Note that the group has left the kernel."""

    def member_removed(self, member: Any) -> None:
        """Note that a member has left the kernel."""

    def check_context(self, component: Any, context: Context) -> None:
        """Raise StateError when `component`, a member, cannot run in this context."""

    def member_entered(self, member: Member) -> None:
        """Note that a member has entered another state; called in the thread of its context."""

    def member_replaced(self, old: Any, new: Any) -> None:
        """Note that the instance `new` has replaced the member `old`."""

    def check_ports(self) -> None:
        """Raise WiringError when the group cannot show the ports that its members have now."""

    def check_new_port(self, member: Any, port: Port[object]) -> None:
        """Raise WiringError when the group cannot show a port that a member has got."""

    def ports_changed(self) -> None:
        """Note that a member has other ports."""


def as_group(component: ComponentSide) -> Group | None:
    """The group that the component stands for; None: the component stands only for itself."""
    return cell(component).stands_for


def group_among(components: Sequence[ComponentSide]) -> Group | None:
    """The first of these that stands for others."""
    return next(filter(None, map(as_group, components)), None)


def flattened(components: Sequence[ComponentSide]) -> tuple[ComponentSide, ...]:
    """The components that run: the parts of each group in its place."""
    found: list[ComponentSide] = []
    for component in components:
        group = as_group(component)
        found += (component,) if group is None else group.parts
    return tuple(found)


def check_free(components: Sequence[ComponentSide], what: str) -> None:
    """Raise StateError when a component is a member of a composite: only the composite decides where members run."""
    for component in components:
        outer = cell(component).group
        if outer is not None and outer.holds and not outer.runs_apart(component):
            raise StateError(
                f"{component.name}: cannot {what}: it is a member of {outer.name}; "
                f"await {outer.name}.remove_members({component.name!r}) first"
            )
