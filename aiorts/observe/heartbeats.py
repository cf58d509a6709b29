"""`kernel.heartbeat()`: a heart-beat of each context and component at an interval, with whether it progressed. The loop
sends the beats, so no component can send the beat of another. A beat says what was observed since the last beat:
whether the context has run a cycle, or was idle as it should be. While the loop is held, the beats stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from aiorts.kernel.loop.bus import Event
from aiorts.late import dataclass

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.microkernel import Microkernel


@dataclass(frozen=True, slots=True)
class ContextBeat(Event):
    """A heart-beat of a context. Only sent to subscribers to this very class, while heart-beats are on."""

    quiet: ClassVar[bool] = True
    context: str
    cycles: int
    """Cycles run so far."""
    progressed: bool
    """Whether the context did its work since the last beat; False while a hook has not returned."""


@dataclass(frozen=True, slots=True)
class ComponentBeat(Event):
    """A heart-beat of a component. Only sent to subscribers to this very class, while heart-beats are on."""

    quiet: ClassVar[bool] = True
    component: str
    states: Mapping[str, str]
    """Lifecycle state by context."""
    progressed: bool
    """Whether all of its contexts progressed; True for a component in no context."""


class Heartbeat:
    """Beats at an interval on the kernel's clock until `stop()` or the end of the kernel."""

    def __init__(self, kernel: Microkernel, interval: float) -> None:
        self._kernel = kernel
        self._interval = interval
        self._seen: dict[str, int] = {}
        self._timer: Cancellable | None = None
        self._arm()

    def stop(self) -> None:
        """Send no more beats; idempotent."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _arm(self) -> None:
        self._timer = self._kernel.call_later(self._interval, self._beat)

    def _beat(self) -> None:
        kernel = self._kernel
        if kernel.closed:
            return
        self._arm()
        alive: dict[str, bool] = {}
        seen: dict[str, int] = {}
        for name, context in tuple(kernel.contexts.items()):
            seen[name] = activity = context.runner.activity()
            inside = context.runner.current is not None
            alive[name] = not inside or self._seen.get(name) != activity
            kernel.bus.publish(ContextBeat(name, context.statistics.cycles, alive[name]))
        self._seen = seen
        for name, component in tuple(kernel.components.items()):
            states = {context: state.value for context, state in component.states.items()}
            progressed = all(alive.get(context, True) for context in states)
            kernel.bus.publish(ComponentBeat(name, states, progressed))
