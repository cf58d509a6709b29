"""Prints the output of isolated components on standard output of this program, line by line; no component waits for it.

Lines go out in the order in which they came, from one task. Lines that a slow terminal or pipe does not take are left
out.
"""

from __future__ import annotations

import asyncio
import sys
from collections import Counter, deque
from typing import TYPE_CHECKING, Final

from aiorts.kernel.loop.line_stream import LineStream
from aiorts.kernel.loop.tasks import kernel_task

if TYPE_CHECKING:
    from aiorts.isolation.stand_in import RemoteComponent

_LINES: Final = 1_000
"""Lines that wait: 5 s of one process that prints all that is passed on."""
_AT_ONCE: Final = 50
_FLUSHED: Final = 0.2
"""Seconds that the end of a component waits for a slow standard output."""


class Printing:
    """Standard output of a program, for the components that run in other processes."""

    def __init__(self) -> None:
        self._stream = LineStream()
        self._lines: deque[tuple[RemoteComponent, str]] = deque()
        self._writing: asyncio.Task[None] | None = None
        self.left_out: Counter[str] = Counter()
        """Lines that standard output did not take, by component."""

    def put(self, component: RemoteComponent, line: str) -> None:
        """Queue a line; it is left out where too many wait already, which is logged once for a component."""
        if sys.stdout is None:  # as for `print`
            return
        if len(self._lines) >= _LINES:
            if not self.left_out[component.name]:
                component.log.warning("standard output is too slow for what it prints: lines are left out")
            self.left_out[component.name] += 1
            return
        self._lines.append((component, line))
        if self._writing is None or self._writing.done():
            self._writing = kernel_task(component.kernel.loop, self._write(), "aiorts isolation output")

    async def flush(self, component: RemoteComponent) -> None:
        """Wait until a component's lines are written, or a moment has passed; log how many lines were left out."""
        if self._writing is not None:
            await asyncio.wait((self._writing,), timeout=_FLUSHED)
        kept = [one for one in self._lines if one[0] is not component]
        count = self.left_out.pop(component.name, 0) + len(self._lines) - len(kept)
        self._lines = deque(kept)
        if count:
            component.log.warning("standard output was too slow for what it printed: %d lines were left out", count)

    def end(self) -> None:
        """Write no more."""
        if self._writing is not None:
            self._writing.cancel()

    async def _write(self) -> None:
        while self._lines:
            some = [self._lines.popleft() for _ in range(min(_AT_ONCE, len(self._lines)))]
            try:
                await self._stream.write(line for _, line in some)
            except Exception as error:  # noqa: BLE001 - sys.stdout may be an application's own
                failed = dict.fromkeys(component for component, _ in (*some, *self._lines))
                self._lines.clear()
                for component in failed:
                    component.unprinted(error)
