"""Which components of a run failed for good: the exit status is by that, also when it happens while all is stopped."""

from __future__ import annotations

from aiorts import Kernel, LifecycleState
from aiorts.events import ComponentRemoved, HookFailed, StateChanged
from aiorts.system import ended_in_error

_LAST = ("on_deactivated", "on_shutdown", "on_finalize")
"""Hooks that leave a component in no other state when they fail: what they were to do in the end was not done."""


class Failures:
    """Hears of a kernel's failures from now on, and forgets what was made good before the end."""

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
        """Who ended in error, by name, and for what."""
        return dict(self._in_error)

    @property
    def unfinished(self) -> bool:
        """Whether a component failed on its way out, without an error that says so."""
        return any(name not in self._in_error or hook != "on_deactivated" for name, hook in self._unfinished)

    def end(self) -> None:
        """Nobody is helped from now on: the kernel is about to close."""
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
            # A task, say, of a component that is in no context any more and has no state that could be error.
            self._in_error.setdefault(event.component, event.error)

    def _removed(self, event: ComponentRemoved) -> None:
        if not self._ending:
            self._in_error.pop(event.component, None)
