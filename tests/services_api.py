"""An interface in a module of its own, as the tests of reloading need it: no file that is read anew defines it."""

from __future__ import annotations

from typing import Protocol


class Scale(Protocol):
    """Makes numbers larger."""

    async def scale(self, value: float) -> float: ...
