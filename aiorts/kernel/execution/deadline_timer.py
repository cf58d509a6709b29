"""The interface between a context with a rate and the monitor that finds out why it is late."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from aiorts.model.blame import Blame


class DeadlineTimer(Protocol):
    """The timer of one context. Times are nanoseconds on the kernel's clock."""

    def period(self, period_ns: int) -> None:
        """The period from now on."""

    def arm(self, due_ns: int) -> None:
        """A cycle begins in time; the next is due at `due_ns`."""

    def disarm(self) -> None:
        """Nothing is due."""

    def blame(self, now_ns: int, due_ns: int | None = None) -> Blame | None:
        """The code that kept a due cycle from beginning by `now_ns`; None when the cycle is not late."""

    def close(self) -> None:
        """The context has stopped. In any thread."""
