"""A component in several contexts is entered by one at a time, in the order they came.

So is one that serves calls: its hooks and the calls wait for each other.

A component that was never in two contexts waits for no other: its hooks pass by the lock and leave no trace at it.
Code that puts it into a second context, or lets others call it, calls `share`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any, Protocol


class Entrant(Protocol):
    """An entrant: a member whose hook runs (`member.py`), or other code of the component (`Visit`)."""

    component: Any
    hook: str

    @property
    def where(self) -> str:
        """For messages."""
        ...


class Sharer(Entrant, Protocol):
    """A member that has to wait while other code of its component runs."""

    @property
    def runs(self) -> bool:
        """Whether a hook of the member runs now."""
        ...

    def settle(self) -> None:
        """Update the fields that a cycle reads."""

    def update_for_sharing(self) -> None:
        """Make the member's running hook let others enter when it ends."""


class EntryLock:
    """The lock that lets one entrant at a time into a component. On the kernel's loop only."""

    __slots__ = ("inside", "shared", "waiting")

    def __init__(self) -> None:
        self.inside: Entrant | None = None
        """The member whose hook runs now, or the call that is served; always, once the lock is shared."""
        self.shared = False
        """Whether the component is, or ever was, in several contexts, or has methods that others call."""
        self.waiting: dict[asyncio.Future[bool], None] | None = None
        """The contexts that wait to enter, in the order they came; None before the first."""

    @property
    def open(self) -> bool:
        """Whether no context is inside or waits."""
        return self.inside is None and not self.waiting

    def share(self, members: Sequence[Sharer]) -> None:
        """Let entrants take the lock from now on; if one of these members has a running hook, it is inside already."""
        if self.shared:
            return
        self.shared = True
        for member in members:
            member.settle()
            if self.inside is None and member.runs:
                self.inside = member
                member.update_for_sharing()

    async def wait(self, turn: asyncio.Future[bool]) -> bool:
        """Wait for a turn and enter at once; False: `turn` was resolved with False, as a deadline does."""
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
        """Let the first waiting entrant enter, if none is inside."""
        if self.inside is not None:
            return
        for turn in self.waiting or ():
            if turn.done():
                # This entrant has its turn, or has given up and will pass the turn on, but did not run yet.
                return
            turn.set_result(True)
            return
