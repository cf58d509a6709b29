"""A member: one component in one execution context, with its life-cycle state and everything that hangs on the pair."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.hooks import HookKind
from aiorts.kernel.ports import InPort
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.context import Context

__all__ = ("HookTimes", "Member", "is_open")

_ABSENT: Final[tuple[int, Callable[..., Any]]] = (HookKind.ABSENT, lambda *_error: None)
"""For every hook that nobody wrote."""

# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_ACTIVE, _ERROR = LifeCycleState.ACTIVE, LifeCycleState.ERROR


class HookTimes:
    """How often a hook ran and how long it took, in nanoseconds."""

    __slots__ = ("count", "last_ns", "max_ns", "total_ns")

    def __init__(self) -> None:
        self.count = 0
        self.total_ns = 0
        self.max_ns = 0
        self.last_ns = 0

    def add(self, elapsed_ns: int) -> None:
        """One more run."""
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
        "awaits",
        "component",
        "context",
        "execute",
        "execute_times",
        "finishing",
        "gate",
        "hook",
        "hooks",
        "in_ports",
        "order",
        "ready",
        "rung",
        "started",
        "stopped_for",
        "times",
        "triggered",
        "updates",
    )

    def __init__(self, component: Component, context: Context, order: int) -> None:
        self.component = component
        self.context = context
        self.gate = component._rt_gate
        self.order = order
        """Position in the order of addition."""
        self._state = LifeCycleState.INACTIVE
        self._failure: BaseException | None = None
        self._abandoned = self._left = False
        self.hooks: dict[str, tuple[int, Callable[..., Any]]] = {}
        """What `hook_of` has found already."""
        self.awaits = component._rt_hook_kinds["on_execute"] == HookKind.ASYNC
        self.execute: Callable[..., Any] | None = None
        """`on_execute` where nothing is unusual: it is there, the member active and the component in no other context.

        And its times.
        """
        self.execute_times: HookTimes | None = None
        self.updates = component._rt_hook_kinds["on_state_update"] != HookKind.ABSENT
        self.hook = "on_execute"
        """The hook that runs now, while one runs."""
        self.finishing = False
        self.started = False
        self.stopped_for: frozenset[str] = frozenset()
        """The components for whose error its composite deactivated it."""
        self.ready = False
        self.in_ports: list[InPort[Any]] = []
        self.rung: list[InPort[Any]] = []
        self.triggered = False
        self.times: dict[str, HookTimes] = {}

    # -- what decides whether it is executed: set, each of these lays out anew what a cycle looks at ---------------

    @property
    def state(self) -> LifeCycleState:
        """The life-cycle state in this context."""
        return self._state

    @state.setter
    def state(self, state: LifeCycleState) -> None:
        self._state = state
        self.settle()

    @property
    def failure(self) -> BaseException | None:
        """What it is in error for, or about to be."""
        return self._failure

    @failure.setter
    def failure(self, failure: BaseException | None) -> None:
        self._failure = failure
        self.settle()

    @property
    def abandoned(self) -> bool:
        """Whether one of the component's hooks was left behind: none runs again."""
        return self._abandoned

    @abandoned.setter
    def abandoned(self, abandoned: bool) -> None:
        self._abandoned = abandoned
        self.settle()

    @property
    def left(self) -> bool:
        """Whether it is no longer in the context."""
        return self._left

    @left.setter
    def left(self, left: bool) -> None:
        self._left = left
        self.settle()

    def settle(self) -> None:
        """Lay out anew what a cycle looks at."""
        self.execute = None
        if self.active and not self._left and not self.gate.shared and self.component._rt_deadlines is None:
            kind, function = self.hook_of("on_execute")
            if kind != HookKind.ABSENT:
                self.execute = function

    @property
    def where(self) -> str:
        """In which context and hook, for messages."""
        return f"{self.context.name}, in {self.hook}"

    @property
    def tick(self) -> int:
        """The cycle of its context."""
        return self.context.ticks

    @property
    def active(self) -> bool:
        """Whether it is executed: active and not about to go to error."""
        return self._state is _ACTIVE and self._failure is None and not self._abandoned

    @property
    def may_run_at_once(self) -> bool:
        """Whether only its gate keeps `on_execute` from the quick way: it has no deadline of its own."""
        return self.gate.shared and self.component._rt_deadlines is None

    # -- causes to run, and what is known of its runs --------------------------------------------------------------

    def hook_of(self, hook: str) -> tuple[int, Callable[..., Any]]:
        """Kind and method of a hook, bound when it first runs: most components have two or three of the twelve."""
        if hook in self.hooks:
            return self.hooks[hook]
        kind = self.component._rt_hook_kinds[hook]
        if kind == HookKind.ABSENT:
            return _ABSENT
        bound = self.hooks[hook] = kind, getattr(self.component, hook)
        return bound

    def ring(self, port: InPort[Any]) -> None:
        """A sample came in: this member has a cause to run."""
        self.rung.append(port)
        if not self.ready:
            self.ready = True
            self.context._member_ready(self)

    def rearm(self) -> None:
        """Let the next sample ring again."""
        for port in self.rung:
            port._arm()
        self.rung.clear()

    def finish(self) -> None:
        """Deactivate after this cycle."""
        if not self.finishing:
            self.finishing = True
            self.context._member_finished(self)

    def timed(self, hook: str) -> HookTimes:
        """The times of a hook, from the first run on."""
        times = self.times.get(hook)
        if times is None:
            times = self.times[hook] = HookTimes()
            if hook == "on_execute":
                self.execute_times = times
        return times


def is_open(component: Component) -> bool:
    """Whether a component's in-ports take samples: it is active somewhere, or in no context at all.

    Once its kernel closes the second does not count: nobody would read, and writers with full = block would wait.
    """
    members = component._rt_members
    if not members:
        return component._rt_kernel is None or not component._rt_kernel._closed
    trial = component._rt_host.trial
    return any(member.state is _ACTIVE or (member.state is _ERROR and member in trial) for member in members)
