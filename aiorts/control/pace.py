"""A share of each second that may be used: saved while unused, and owed once overdrawn, up to a limit."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel

_LOOKS: Final = (0.2, 0.1)
"""The share of the loop for streams that look at an interval, and the most seconds of it that are saved up."""


class Pace:
    """A share of the time that passes.

    Args:
        share: the part of each second that may be used.
        most: the most seconds that can be saved up, and that can be owed. Time in which the process was stopped counts
            as used although it was not; the limit of the debt keeps clients from waiting long for it.
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
        """Seconds until time may be used again; 0.0: now."""
        self._fill()
        return max(0.0, -self._left / self._share)

    def _fill(self) -> None:
        now = time.monotonic()
        self._left = min(self._most, self._left + (now - self._at) * self._share)
        self._at = now


_PACES: Final[WeakKeyDictionary[Microkernel, Pace]] = WeakKeyDictionary()


def looks_of(kernel: Microkernel) -> Pace:
    """The share of a kernel's loop for all streams together that look at an interval."""
    return _PACES.setdefault(kernel, Pace(*_LOOKS))
