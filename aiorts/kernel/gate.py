"""A component in several contexts is entered by one at a time, in the order they came.

So is one whose methods others call, by its hooks and by the calls.

A component in one context, and never yet in two, has nobody to wait for: its hooks pass by the gate and may leave no
trace at it. Whoever brings it into a second context, or has others call it, says so (`share`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from aiorts.kernel.member import Member
    from aiorts.kernel.service_visit import Visit

__all__ = ("Gate",)


class Gate:
    """The way into one component. On the kernel's loop only."""

    __slots__ = ("inside", "shared", "waiting")

    def __init__(self) -> None:
        self.inside: Member | Visit | None = None
        """The member whose hook runs now, or the call that is served; always, once the gate is shared."""
        self.shared = False
        """Whether the component is, or ever was, in several contexts, or has methods that others call."""
        self.waiting: dict[asyncio.Future[bool], None] | None = None
        """Who wants to come in, in the order they came; None as long as nobody ever did."""

    @property
    def open(self) -> bool:
        """Whether nobody is inside and nobody came first."""
        return self.inside is None and not self.waiting

    def share(self, members: Sequence[Member]) -> None:
        """More than one may want to come in from now on; one of these members may have a hook running."""
        if self.shared:
            return
        self.shared = True
        for member in members:
            member.settle()
            driver = member.context._driver
            if driver is not None and driver.current is member and self.inside is None:
                self.inside = member
                driver.beware_of_sharing()

    async def wait(self, turn: asyncio.Future[bool]) -> bool:
        """Wait for one's turn and enter at once; False when somebody resolved `turn` so, as a deadline does."""
        if self.waiting is None:
            self.waiting = {}
        waiting = self.waiting
        waiting[turn] = None
        granted = False
        try:
            granted = await turn
        finally:
            del waiting[turn]
            if not granted:
                self.pass_on()
        return granted

    def pass_on(self) -> None:
        """Let the first who waits come in, when nobody is inside."""
        if self.inside is not None:
            return
        for turn in self.waiting or ():
            if turn.done():
                # It was let in (or has given up and passes it on itself) and did not run yet.
                return
            turn.set_result(True)
            return
