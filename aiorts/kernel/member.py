"""A member: one component in one execution context, with its life-cycle state and everything that hangs on the pair."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from aiorts.kernel.hooks import HookKind
from aiorts.kernel.ports import InPort
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.context import Context

__all__ = ("HookTimes", "Member", "is_open")

# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_ACTIVE = LifeCycleState.ACTIVE


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
        "abandoned",
        "awaits",
        "component",
        "context",
        "execute",
        "execute_times",
        "failure",
        "finishing",
        "gate",
        "hook",
        "hooks",
        "in_ports",
        "left",
        "order",
        "ready",
        "rung",
        "runs",
        "started",
        "state",
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
        self.state = LifeCycleState.INACTIVE
        self.hooks: dict[str, tuple[int, Callable[..., Any]]] = {
            hook: (kind, getattr(component, hook)) for hook, kind in component._rt_hook_kinds.items()
        }
        kind, self.execute = self.hooks["on_execute"]
        """What every cycle runs, its kind and its times (from the first run on), laid out for the cycle."""
        self.runs = kind != HookKind.ABSENT
        self.awaits = kind == HookKind.ASYNC
        self.execute_times: HookTimes | None = None
        self.updates = self.hooks["on_state_update"][0] != HookKind.ABSENT
        self.hook = "on_execute"
        """The hook that runs now, while one runs."""
        self.failure: BaseException | None = None
        """What it is in error for, or about to be."""
        self.abandoned = False
        self.finishing = False
        self.left = False
        self.started = False
        self.ready = False
        self.in_ports: list[InPort[Any]] = []
        self.rung: list[InPort[Any]] = []
        self.triggered = False
        self.times: dict[str, HookTimes] = {}

    @property
    def active(self) -> bool:
        """Whether it is executed: active and not about to go to error."""
        return self.state is _ACTIVE and self.failure is None and not self.abandoned

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
    return any(member.state is _ACTIVE for member in members)
