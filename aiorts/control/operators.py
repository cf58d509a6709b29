"""The operators of the components of a kernel, and the reaction of components to the loss of their operator.

The operator of a component is the session that has changed it last, as long as the session is open. When a client ends
its session in order, nothing changes. When a session is lost (a client was killed, a network was cut), each of its
components reacts by `on_link_lost` of the system file, or else of its class.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, Final

from aiorts.errors import ControlError, StateError, format_error
from aiorts.kernel.execution.cell import as_group, cell
from aiorts.kernel.loop.bus import ComponentRemoved
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.model.lifecycle import LifecycleState

if TYPE_CHECKING:
    import asyncio

    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel

_LOG: Final = KernelLog("aiorts.control")


class Operators:
    """The operators of one kernel's components. All methods are called on the kernel's loop."""

    def __init__(self, kernel: Microkernel) -> None:
        self._kernel = kernel
        self._sessions: dict[str, object] = {}
        """The operating session by the component's name."""
        kernel.bus.subscribe(ComponentRemoved, lambda event: self._sessions.pop(event.component, None))

    def changed(self, session: object, components: Iterable[str]) -> None:
        """Make a session the operator of components that it changed, and of the members of composites among them."""
        for name in self._with_leaves(components):
            self._sessions[name] = session

    def ended(self, session: object, who: str, changing: Iterable[str] = (), *, lost: bool) -> None:
        """Note that a session has ended: its components have no operator any more; if the session is lost, they react.

        Args:
            changing: the components that running calls of the session change; a change that has begun goes on.
        """
        asked = self._with_leaves(changing) if lost else ()
        self._sessions.update(dict.fromkeys(asked, session))
        for name in [name for name, operator in self._sessions.items() if operator is session]:
            del self._sessions[name]
            component = self._kernel.components.get(name)
            if lost and component is not None and (what := self._does(component)) != "continue":
                if _is_active(component):
                    self._lose(component, who, what)
                elif name in asked:  # its activation may still be to come
                    self._deactivate(component)

    def _with_leaves(self, names: Iterable[str]) -> tuple[str, ...]:
        named = tuple(names)
        found = (self._kernel.components.get(name) for name in named)
        composites = [one for one in found if one is not None and as_group(one) is not None]
        if not composites:
            return named
        from aiorts.composites import leaves_of  # late: most systems have none

        return (*named, *(leaf.name for leaf in leaves_of(composites)))

    def _does(self, component: Component) -> str:
        return self._kernel.registry.on_link_lost.get(component.name) or type(component).on_link_lost

    def _lose(self, component: Component, who: str, what: str) -> None:
        if what == "error":
            _LOG.warning("%s: the link to its operator is lost: %s; it goes to error", component.name, who)
            lost = ControlError(f"the link to its operator is lost: {who}")
            self._kernel.registry.task_failed(component, "the link to its operator", lost)
            return
        _LOG.warning("%s: the link to its operator is lost: %s; it is deactivated", component.name, who)
        self._deactivate(component)

    def _deactivate(self, component: Component) -> None:
        """Deactivate a component in all its contexts, after the requests that are under way there."""
        for context, state in component.states.items():
            if state is not LifecycleState.ERROR:
                leaving = self._kernel.deactivate(component, context=context, timeout=None)
                task = kernel_task(self._kernel.loop, leaving, f"aiorts control {component.name}")
                task.add_done_callback(partial(_report, component.name))


def _is_active(component: Component) -> bool:
    """Whether a component is active in a context, or is being activated."""
    members = cell(component).members
    return LifecycleState.ACTIVE in component.states.values() or any(
        member.runs and member.hook == "on_activated" for member in members
    )


def _report(name: str, task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None and not isinstance(error, StateError):
        _LOG.error("%s: is not deactivated: %s", name, format_error(error))
