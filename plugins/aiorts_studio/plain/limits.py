"""Limits of what one client, and all clients together, may ask. They decide; the clock is passed in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from aiorts_studio.plain.problems import HttpError

OF_CLIENT: Final = 32
"""Calls and streams of one client that may be under way."""
OF_KERNEL: Final = 128
"""Calls and streams of all clients that one kernel may have: it takes twice as many of a program that only looks."""
RATE: Final = 100.0
"""Requests a second of one client, over a longer time: a kernel hears twice as many of a peer on the network."""
AT_ONCE: Final = 1_000
"""Requests of one client at once."""


class Bucket:
    """Fills with each request, and leaks: a client that is over its rate is refused until there is room again."""

    def __init__(self) -> None:
        self._level = self._at = 0.0

    def fill(self, now: float) -> None:
        """Count a request; HttpError: there is no room for it."""
        self._level = max(0.0, self._level - max(0.0, now - self._at) * RATE)
        self._at = max(self._at, now)
        if self._level >= AT_ONCE:
            text = f"more than {RATE:.0f} requests a second"
            raise HttpError(429, "E-BUSY", text, {"retry-after": "1"})
        self._level += 1.0


class UnderWay:
    """The calls and streams under way, by client and by kernel."""

    def __init__(self) -> None:
        self._counts: Counter[int | str] = Counter()

    @contextmanager
    def one(self, client: int, kernel: str) -> Iterator[None]:
        """Count one more while the block runs; HttpError: there are too many."""
        for key, most, who in ((client, OF_CLIENT, "this client"), (kernel, OF_KERNEL, f"the clients of {kernel}")):
            if self._counts[key] >= most:
                raise HttpError(429, "E-BUSY", f"{who}: {most} calls are under way already", {"retry-after": "1"})
        self._counts.update((client, kernel))
        try:
            yield
        finally:
            self._counts.subtract((client, kernel))
            self._counts = +self._counts  # what is not under way is forgotten
