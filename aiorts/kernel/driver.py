"""What carries out the steps of a context's life looks like this from outside; it decides nothing."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from aiorts.kernel.deadlines import StopBudget
    from aiorts.kernel.member import Member

__all__ = ("Driver",)


class Driver(Protocol):
    """A task on the loop (`bulkhead.py`) or a thread."""

    hooks_run: int
    """Together with the context's ticks and the current member it changes with each hook."""

    @property
    def ended(self) -> asyncio.Future[None]:
        """Done when the last step was carried out, or the driver gave up."""
        ...

    @property
    def current(self) -> Member | None:
        """The member whose hook runs now."""
        ...

    def beware(self) -> None:
        """Observers of hooks came or went."""
        ...

    def beware_of_sharing(self) -> None:
        """The component whose hook runs now is in a second context from now on."""
        ...

    def kick(self) -> None:
        """Somebody wants something: do not wait on."""
        ...

    def hurry(self, budget: StopBudget) -> None:
        """A stop began: hooks are limited from now on, the one that runs included."""
        ...
