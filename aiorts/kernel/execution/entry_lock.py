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
    """A member that others may keep out from now on."""

    @property
    def runs(self) -> bool:
        """Whether a hook of it runs now."""
        ...

    def settle(self) -> None:
        """Update the fields that a cycle reads."""

    def update_for_sharing(self) -> None:
        """Its hook, which runs now, is to let others in when it ends."""


class EntryLock:
    """The way into one component. On the kernel's loop only."""

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
        """More than one may want to come in from now on; one of these members may have a hook running."""
        if self.shared:
            return
        self.shared = True
        for member in members:
            member.settle()
            if self.inside is None and member.runs:
                self.inside = member
                member.update_for_sharing()

    async def wait(self, turn: asyncio.Future[bool]) -> bool:
        """Wait for a turn and enter at once; False when `turn` was resolved so, as a deadline does."""
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
        """Let the first that waits enter, when no context is inside."""
        if self.inside is not None:
            return
        for turn in self.waiting or ():
            if turn.done():
                # It was let in (or has given up and passes it on itself) and did not run yet.
                return
            turn.set_result(True)
            return
