"""One timer on the kernel's clock for what has to be done later."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.microkernel import Microkernel


class Wakening:
    """Calls back at the time asked for last, or a little before it: `callback` asks again for what is due later."""

    __slots__ = ("_due_ns", "_kernel", "_timer", "_wakened")

    def __init__(self, kernel: Microkernel, callback: Callable[[], None]) -> None:
        self._kernel, self._wakened = kernel, callback
        self._timer: Cancellable | None = None
        self._due_ns = 0

    def at(self, when_ns: int | None) -> None:
        """Call back at this time of the kernel's clock, None for not at all."""
        # A timer that is due earlier stays: to set one anew at each sample costs more than a call for nothing.
        if when_ns is None or (self._timer is not None and self._due_ns <= when_ns):
            return
        self.cancel()
        self._due_ns = when_ns
        self._timer = self._kernel.call_at(when_ns, self._wake)

    def cancel(self) -> None:
        """Call back no more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _wake(self) -> None:
        self._timer = None
        self._wakened()
