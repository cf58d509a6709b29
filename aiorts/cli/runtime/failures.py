"""The components of a run that failed for good, also during its end: they decide the exit status."""

from __future__ import annotations

from aiorts import Kernel, LifecycleState
from aiorts.events import ComponentRemoved, HookFailed, StateChanged
from aiorts.system import ended_in_error

_LAST = ("on_deactivated", "on_shutdown", "on_finalize")
"""Hooks whose failure does not put a component into error, although its end was not completed."""


class Failures:
    """A record of a kernel's failures, without the failures that are repaired before the end."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._ending = False
        self._in_error: dict[str, BaseException | None] = {}
        self._unfinished: set[tuple[str, str]] = set()
        kernel.bus.subscribe(StateChanged, self._changed)
        kernel.bus.subscribe(HookFailed, self._failed)
        kernel.bus.subscribe(ComponentRemoved, self._removed)

    @property
    def in_error(self) -> dict[str, BaseException | None]:
        """The components that ended in error, each with its error."""
        return dict(self._in_error)

    @property
    def unfinished(self) -> bool:
        """Whether a component failed in one of its last hooks, and `in_error` does not cover that failure."""
        return any(name not in self._in_error or hook != "on_deactivated" for name, hook in self._unfinished)

    def end(self) -> None:
        """Note that the kernel is about to close: later failures cannot be repaired."""
        self._ending = True
        self._in_error |= ended_in_error(self._kernel)

    def _changed(self, event: StateChanged) -> None:
        name, new = event.component, event.new
        if new is LifecycleState.ERROR:
            component = self._kernel.components.get(name)
            self._in_error[name] = None if component is None else component.last_error
        elif not self._ending:
            self._in_error.pop(name, None)
            if new is LifecycleState.ACTIVE:
                self._unfinished.discard((name, "on_deactivated"))
                self._unfinished.discard((name, "on_shutdown"))

    def _failed(self, event: HookFailed) -> None:
        if event.hook in _LAST:
            self._unfinished.add((event.component, event.hook))
        elif self._ending and event.hook != "on_initialize":
            # For example a task of a component that is in no context any more, and so cannot be in error.
            self._in_error.setdefault(event.component, event.error)

    def _removed(self, event: ComponentRemoved) -> None:
        if not self._ending:
            self._in_error.pop(event.component, None)
