"""What `aiorts run` has watched from outside: its event loop, and the whole by systemd where the environment asks."""

from __future__ import annotations

from dataclasses import dataclass

from aiorts import Kernel
from aiorts.events import ContextStarted
from aiorts.system import WatchEntry

__all__ = ("Watched",)


@dataclass(frozen=True, slots=True)
class Watched:
    """How a run is watched; nothing of it in simulated time."""

    loop: WatchEntry
    ready: tuple[str, ...]
    """Who is active once the system is ready."""

    def begin(self, kernel: Kernel) -> None:
        """Before the system is made: systemd hears of it from now on, and that it is ready once it is."""
        if self.ready:  # of nobody it could not be said when they are
            kernel.notify_systemd(*self.ready)

        def watch(_event: ContextStarted) -> None:
            unsubscribe()
            kernel.watch_loop(self.loop.limit, self.loop.policy)

        # Not before a context runs: while a system is made it may well keep its loop.
        unsubscribe = kernel.bus.subscribe(ContextStarted, watch)

    def made(self, kernel: Kernel) -> None:
        """The system is made."""
        if not self.ready:
            kernel.notify_systemd()
