"""Measures garbage collections, during which nothing else of the interpreter runs.

`gc.callbacks` has an entry for each kernel with a monitored context, until the last of these contexts has closed.
"""

from __future__ import annotations

import gc
import time
from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

from aiorts.diagnostics.blame import Pause
from aiorts.model.blame import GcPauses

_KEEP_FROM_NS: Final = 50_000
_KEPT: Final = 32


class Pauses:
    """Records collections while it listens. Called with the interpreter lock held, in any thread."""

    def __init__(self) -> None:
        self.recent: deque[Pause] = deque(maxlen=_KEPT)
        """The last collections that were long enough to make a context late."""
        self._began_ns = 0
        self._sums: dict[int, GcPauses] = {}
        # Bound once: `remove` must find the same object, and the module may be gone when the last collection runs.
        self._hook = self._note
        self._now: Callable[[], int] = time.monotonic_ns

    @property
    def statistics(self) -> Mapping[int, GcPauses]:
        """Collections by generation."""
        return MappingProxyType(self._sums.copy())

    def listen(self) -> None:
        """Record from now on."""
        if self._hook not in gc.callbacks:
            gc.callbacks.append(self._hook)

    def stop(self) -> None:
        """Stop recording; the counts stay."""
        if self._hook in gc.callbacks:
            gc.callbacks.remove(self._hook)
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
