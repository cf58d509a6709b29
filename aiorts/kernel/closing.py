"""How a kernel gives everything up, in reverse order, within one budget of time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.kernel import embedding
from aiorts.kernel.deadlines import StopBudget

if TYPE_CHECKING:
    from aiorts.kernel.kernel import Kernel

__all__ = ("close",)


async def close(kernel: Kernel) -> None:
    """Stop contexts, disconnect, finalise components."""
    budget = StopBudget(kernel.loop)
    kernel._stop_requested.set()
    kernel._closing_begun.set_result(budget)
    for component in kernel.components.values():
        kernel._roster.vacate(component)
    contexts = tuple(kernel._contexts.values())
    for context in contexts:
        if context._driver is not None:
            context._driver.hurry(budget)
    try:
        await kernel._end_supervision()
        for context in reversed(contexts):
            await context._stop(budget)
        kernel._connections.end_all()
        await kernel._roster.close(budget)
    finally:
        if kernel._summary is not None:
            kernel._summary.cancel()
        kernel._log_budget.summarize()
        for heartbeat in tuple(kernel._heartbeats):
            heartbeat.stop()
        if "listening" in vars(kernel):  # made when somebody first listened
            kernel.listening.tell()
        await kernel.bus.aclose(budget.rest)
        for watch in tuple(kernel._watches):
            watch.end()
        kernel._timers.release()
        kernel._pool.close()
        kernel._end_watching()
        kernel._ended = True
        embedding.leave(kernel, kernel.loop)
        if kernel._remove_probe is not None:
            kernel._remove_probe()
