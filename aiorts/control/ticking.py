"""A timer for streams that look at a kernel at a rate."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from aiorts.clock import SimulatedClock

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel


class Ticking:
    """A timer that calls `look` on the kernel's loop, at once and then `rate` times a second by its clock.

    Ticks that are late are skipped. In simulated time the timer goes by the real clock and looks between two instants,
    as a client's call does: a timer of the simulated clock would change the simulation.
    """

    def __init__(self, kernel: Microkernel, rate: float, look: Callable[[], object]) -> None:
        self._kernel, self._look = kernel, look
        self._period_ns = round(1e9 / rate)
        self._due_ns = kernel.clock.monotonic_ns()
        self._over = threading.Event()
        self._timer: Any = None
        if isinstance(kernel.clock, SimulatedClock):
            threading.Thread(target=self._tick_outside, name="aiorts control ticks", daemon=True).start()
        else:
            self._timer = kernel.call_later(0.0, self._tick)

    def close(self) -> None:
        """Stop the timer; idempotent."""
        self._over.set()
        if self._timer is not None:
            self._timer.cancel()

    def _tick(self) -> None:
        if self._over.is_set() or self._kernel.closed:
            return
        now_ns = self._kernel.clock.monotonic_ns()
        self._due_ns += max(1, (now_ns - self._due_ns) // self._period_ns + 1) * self._period_ns
        self._timer = self._kernel.call_later((self._due_ns - now_ns) / 1e9, self._tick)
        self._look()

    def _tick_outside(self) -> None:
        loop: Any = self._kernel.loop
        hand_over = getattr(loop, "call_between_instants", loop.call_soon_threadsafe)
        done = threading.Event()

        def look() -> None:
            done.set()
            if not self._over.is_set() and not self._kernel.closed:
                self._look()

        with suppress(RuntimeError):  # the loop is closed
            while not self._over.is_set():
                done.clear()
                hand_over(look)
                self._over.wait(self._period_ns / 1e9)
                while not (done.wait(0.1) or self._over.is_set()):
                    pass  # the loop stands still
