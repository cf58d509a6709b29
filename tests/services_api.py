"""An interface in a module of its own, as the tests of reloading need it: no file that is read anew defines it."""

from __future__ import annotations

from typing import Protocol

from aiorts import Kernel
from aiorts.services.activities import CallGraph


class Scale(Protocol):
    """Makes numbers larger."""

    async def scale(self, value: float) -> float: ...


def waits(kernel: Kernel) -> bool:
    """Whether a call of this kernel is waited for."""
    graph = kernel.attached(CallGraph)
    return graph is not None and bool(graph._by_caller)
