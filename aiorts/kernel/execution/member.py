"""A member: one component in one execution context, with its lifecycle state and everything that hangs on the pair.

A `Visit` is its counterpart for code of a component that is no hook, such as the answer to a call.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import StateError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.hooks import HookKind
from aiorts.kernel.ports import InPort
from aiorts.model.lifecycle import LifecycleState, joint

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import ComponentSide
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.ports import Port
    from aiorts.model.lifecycle import OverdueHook

_ABSENT: Final[tuple[int, Callable[..., Any]]] = (HookKind.ABSENT, lambda *_error: None)
"""The kind and method of a hook that the class does not define."""

# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_ACTIVE, _ERROR = LifecycleState.ACTIVE, LifecycleState.ERROR


class HookTimes:
    """How often a hook ran and how long it took, in nanoseconds."""

    __slots__ = ("count", "last_ns", "max_ns", "total_ns")

    def __init__(self) -> None:
        self.count = 0
        self.total_ns = 0
        self.max_ns = 0
        self.last_ns = 0

    def add(self, elapsed_ns: int) -> None:
        """Count a run that took `elapsed_ns`."""
        self.count += 1
        self.total_ns += elapsed_ns
        self.last_ns = elapsed_ns
        if elapsed_ns > self.max_ns:
            self.max_ns = elapsed_ns


class Member:
    """One component in one context."""

    __slots__ = (
        "_abandoned",
        "_failure",
        "_left",
        "_state",
        "answers",
        "awaits",
        "cell",
        "component",
        "context",
        "entry_lock",
        "execute",
        "execute_times",
        "finishing",
        "hook",
        "hooks",
        "in_ports",
        "order",
        "started",
        "stopped_for",
        "times",
        "updates",
    )

    def __init__(self, component: ComponentSide, context: Context, order: int) -> None:
        self.component = component
        self.context = context
        self.cell = cell(component)
        """The cell of the component; a reload gives it to the new instance."""
        self.entry_lock = self.cell.entry_lock
        self.order = order
        """Position in the order of addition."""
        self._state = LifecycleState.INACTIVE
        self._failure: BaseException | None = None
        self._abandoned = self._left = False
        self.hooks: dict[str, tuple[int, Callable[..., Any]]] = {}
        """The hooks that `hook_of` has found already."""
        self.awaits = self.cell.hook_kinds["on_execute"] == HookKind.ASYNC
        self.execute: Callable[..., Any] | None = None
        """`on_execute` where nothing is unusual: it exists, the member is active, the component in no other context."""
        self.execute_times: HookTimes | None = None
        """The times of `execute`."""
        self.updates = False
        """Whether the member takes part in the second pass of a cycle; see `settle_updates`."""
        self.hook = "on_execute"
        """The hook that runs now, while one runs."""
        self.finishing = False
        self.started = False
        self.answers = False
        """Whether the member answers calls though it is not active: it was active until its kernel began to close."""
        self.stopped_for: frozenset[str] = frozenset()
        """The components for whose error its composite deactivated it."""
        self.in_ports: list[InPort[Any]] = []
        self.times: dict[str, HookTimes] = {}

    # -- what decides whether it is executed: setting one of these updates the fields that a cycle reads -----------

    @property
    def state(self) -> LifecycleState:
        """The lifecycle state in this context."""
        return self._state

    @state.setter
    def state(self, state: LifecycleState) -> None:
        self._state = state
        if state is _ACTIVE:
            self.cell.was_active = True
        self.settle()

    @property
    def failure(self) -> BaseException | None:
        """The error for which the member is in error, or is going there."""
        return self._failure

    @failure.setter
    def failure(self, failure: BaseException | None) -> None:
        self._failure = failure
        self.settle()

    @property
    def abandoned(self) -> bool:
        """Whether one of the component's hooks was abandoned: none runs again."""
        return self._abandoned

    @abandoned.setter
    def abandoned(self, abandoned: bool) -> None:
        self._abandoned = abandoned
        self.settle()

    @property
    def left(self) -> bool:
        """Whether the member has left the context."""
        return self._left

    @left.setter
    def left(self, left: bool) -> None:
        self._left = left
        self.settle()

    def settle(self) -> None:
        """Update the fields that a cycle reads."""
        self.execute = None
        if self.active and not self._left and not self.entry_lock.shared and self.cell.deadlines is None:
            kind, function = self.hook_of("on_execute")
            if kind != HookKind.ABSENT:
                self.execute = function

    def settle_updates(self) -> None:
        """Update `updates`: true for a member with an `on_state_update`, or while hooks have observers."""
        wrote = self.cell.hook_kinds["on_state_update"] != HookKind.ABSENT
        updates = wrote or self.context.runner.kernel.bus.hooks_wanted
        self.context._updating += updates - self.updates
        self.updates = updates

    @property
    def where(self) -> str:
        """The context and hook, for messages."""
        return f"{self.context.name}, in {self.hook}"

    @property
    def tick(self) -> int:
        """The number of its context's present cycle."""
        return self.context.ticks

    @property
    def active(self) -> bool:
        """Whether the member is executed: active, and not about to go to error."""
        return self._state is _ACTIVE and self._failure is None and not self._abandoned

    @property
    def may_run_at_once(self) -> bool:
        """Whether only its entry lock keeps `on_execute` from the quick way: it has no deadline of its own."""
        return self.entry_lock.shared and self.cell.deadlines is None

    # -- causes to run, and what is known of its runs --------------------------------------------------------------

    def hook_of(self, hook: str) -> tuple[int, Callable[..., Any]]:
        """Kind and method of a hook, bound when it first runs: most components have two or three of the twelve."""
        if hook in self.hooks:
            return self.hooks[hook]
        kind = self.cell.hook_kinds[hook]
        if kind == HookKind.ABSENT:
            return _ABSENT
        try:
            bound = self.hooks[hook] = kind, getattr(self.component, hook)
        except BaseException as error:  # noqa: BLE001 - the component's own `__getattribute__`: as if the hook raised it
            return kind, partial(_raise, error)
        return bound

    @property
    def runs(self) -> bool:
        """Whether a hook of the member runs now."""
        return self.context.runner.current is self

    def update_for_sharing(self) -> None:
        """Make the member's running hook let others enter when it ends."""
        if self.context.runner.driver is not None:
            self.context.runner.driver.update_for_sharing()

    def limit_anew(self) -> None:
        """Apply changed deadlines of the component, also to its running hook."""
        self.settle()
        if self.context.runner.driver is not None:
            self.context.runner.driver.limit_anew(self)

    def port_added(self, port: Port[Any]) -> None:
        """Note a new port of the component; an in-port opens if the component takes samples."""
        self.context._port_added(self, port)

    def port_removed(self, port: Port[Any]) -> None:
        """Note that the component lost a port."""
        self.context._port_removed(self, port)

    def open_ports(self) -> None:
        """Open the in-ports while the component is active in a context, or is in none; close them otherwise."""
        self.context._set_ports_open(self)

    def finish(self) -> None:
        """Deactivate after this cycle."""
        if not self.finishing:
            self.finishing = True
            self.context.runner.finished(self)

    def timed(self, hook: str) -> HookTimes:
        """The times of a hook, made at its first run."""
        times = self.times.get(hook)
        if times is None:
            times = self.times[hook] = HookTimes()
            if hook == "on_execute":
                self.execute_times = times
        return times


class Visit:
    """A call that a component serves, or what a reload asks of it; in messages it stands where a hook would."""

    __slots__ = ("component", "hook")

    def __init__(self, component: Any, hook: str) -> None:
        self.component = component
        self.hook = hook
        """Port and method, such as "brake.stop": what stands in logs where a hook would."""

    @property
    def where(self) -> str:
        """For messages."""
        return f"a call of {self.hook}"

    @property
    def tick(self) -> int:
        """0: a call belongs to no cycle."""
        return 0

    @property
    def context(self) -> Context:
        """The component's context; StateError where it has none or several."""
        contexts: tuple[Context, ...] = self.component.contexts
        if len(contexts) == 1:
            return contexts[0]
        raise StateError(f"{self.component.name}: is in {len(contexts)} contexts and serves {self.hook}; say which")

    @property
    def state(self) -> LifecycleState | None:
        """The component's state: active where it is active in any context."""
        states = self.component.states.values()
        return LifecycleState.ACTIVE if LifecycleState.ACTIVE in states else joint(states)

    def finish(self) -> None:
        """The component said, in a method that others call, that it has nothing more."""
        for context in self.component.contexts:
            context.runner.member(self.component).finish()


def overdue_hooks(component: ComponentSide) -> Mapping[str, OverdueHook]:
    """The hooks of a component that run longer than their deadlines at this moment, by the context's name."""
    found = {member.context.name: member.context._overdue(member) for member in cell(component).members}
    return MappingProxyType({context: one for context, one in found.items() if one is not None})


def _raise(error: BaseException, *_args: Any) -> None:
    raise error


def is_open(component: ComponentSide) -> bool:
    """Whether a component's in-ports take samples: it is active somewhere, or in no context at all.

    Once the kernel closes, ports of a component in no context are closed: else writers with full = block would wait.
    """
    here = cell(component)
    if here.held_open:
        return True
    if not here.members:
        return here.kernel is None or not here.kernel.closed
    return any(m.state is _ACTIVE or (m.state is _ERROR and m in here.trial) for m in here.members)
