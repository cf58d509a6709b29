"""How long hooks may take while something stops; numbers only, nothing here waits or cancels."""

from __future__ import annotations

import asyncio
from typing import Final, Literal

GRACE: Final = 0.5
"""Seconds between two cancellations of a hook that is over its deadline."""
CANCELLATIONS: Final = 4
STOP_DEADLINE: Final = 2.0
"""Seconds that a hook may still take once its context or kernel stops."""
_RESERVE: Final = 0.6
"""Seconds for all that is left once the first stuck hook has used up its time."""
_LAST: Final = 0.2
"""Seconds for observers where nothing is left: all of it ends within 5 s."""
_SHARE: Final = 0.2
_GRACE_SHARE: Final = 0.02
"""Parts of what is left of the reserve: many stuck hooks come ever closer to its end and never pass it."""


class StopBudget:
    """How long hooks may still take while something stops: shared by all contexts that stop together."""

    def __init__(self, loop: asyncio.AbstractEventLoop, deadline: float = STOP_DEADLINE) -> None:
        self._loop = loop
        self._soft = loop.time() + deadline
        self._hard = self._soft + CANCELLATIONS * GRACE
        self._end = self._hard + _RESERVE

    @property
    def limit(self) -> float:
        """Seconds until a hook that runs now is cancelled for the first time."""
        now = self._loop.time()
        return max(0.0, self._soft - now, min(_RESERVE, self._end - now) * _SHARE)

    @property
    def rest(self) -> float:
        """Seconds that observers may still take for what waits, once everything else has stopped."""
        return min(1.0, max(0.0, self._end - self._loop.time()) + _LAST)

    @property
    def left(self) -> float:
        """Seconds until everything but observers must have stopped."""
        return max(0.0, self._end - self._loop.time())

    @property
    def grace(self) -> float:
        """Seconds between cancellations."""
        now = self._loop.time()
        return GRACE if now < self._hard else max(0.0, (self._end - now) * _GRACE_SHARE)


class StopRequest(asyncio.Event):
    """Set once the end of a kernel was requested."""

    awaited = False
    """Whether any code has waited for it."""

    async def wait(self) -> Literal[True]:
        self.awaited = True
        return await super().wait()
