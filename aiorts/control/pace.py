"""How much of a second may be used up: saved while it is not, and owed once it is, up to a limit."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel

_LOOKS: Final = (0.2, 0.1)
"""The share of the loop that streams may take which look again and again, and the seconds that are saved up."""


class Pace:
    """A share of the time that goes by.

    Args:
        share: of each second, what may be used.
        most: seconds that can be saved up, and that can be owed. The bound of the debt keeps clients from waiting long
            after the process was stopped for a time: it has used nothing of that time.
    """

    def __init__(self, share: float, most: float) -> None:
        self._share = share
        self._most = most
        self._left = most
        self._at = time.monotonic()

    def spend(self, seconds: float) -> None:
        """Count these seconds as used."""
        self._fill()
        self._left = max(-self._most, self._left - seconds)

    def due(self) -> float:
        """Seconds until something may be used again; 0.0: now."""
        self._fill()
        return max(0.0, -self._left / self._share)

    def _fill(self) -> None:
        now = time.monotonic()
        self._left = min(self._most, self._left + (now - self._at) * self._share)
        self._at = now


_PACES: Final[WeakKeyDictionary[Microkernel, Pace]] = WeakKeyDictionary()


def looks_of(kernel: Microkernel) -> Pace:
    """The share of a kernel's loop that all streams which look into it again and again have together."""
    return _PACES.setdefault(kernel, Pace(*_LOOKS))
