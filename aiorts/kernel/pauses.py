"""Takes the time of garbage collections, in which nothing else of the interpreter runs.

`gc.callbacks` has an entry for each kernel that watches a context, and none when the last of them has closed.
"""

from __future__ import annotations

import gc
import time
from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

from aiorts.kernel.blame import Pause
from aiorts.model.blame import GcPauses

__all__ = ("Pauses",)

_KEEP_FROM_NS: Final = 50_000
_KEPT: Final = 32


class Pauses:
    """The collections while it listens. Called with the interpreter lock held, in any thread."""

    def __init__(self) -> None:
        self.recent: deque[Pause] = deque(maxlen=_KEPT)
        """The last ones that were long enough to make anybody late."""
        self._began_ns = 0
        self._sums: dict[int, GcPauses] = {}
        # Bound once: `remove` must find the same object, and the module may be gone when the last collection runs.
        self._callback = self._note
        self._now: Callable[[], int] = time.monotonic_ns

    @property
    def statistics(self) -> Mapping[int, GcPauses]:
        """By generation."""
        return MappingProxyType(self._sums.copy())

    def listen(self) -> None:
        """From now on."""
        if self._callback not in gc.callbacks:
            gc.callbacks.append(self._callback)

    def stop(self) -> None:
        """No longer; what was counted stays."""
        if self._callback in gc.callbacks:
            gc.callbacks.remove(self._callback)
        self._began_ns = 0

    def _note(self, phase: str, info: Mapping[str, Any]) -> None:
        now = self._now()
        if phase == "start":
            self._began_ns = now
            return
        began, self._began_ns = self._began_ns, 0
        if not began:
            return  # one that was under way when the listening began
        pause, generation = now - began, int(info["generation"])
        old = self._sums.get(generation) or GcPauses()
        self._sums[generation] = GcPauses(old.count + 1, old.total_ns + pause, max(old.max_ns, pause), pause)
        if pause >= _KEEP_FROM_NS:
            self.recent.append(Pause(began, now, generation))
