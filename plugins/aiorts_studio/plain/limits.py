"""Limits for the requests of one client, and of all clients together. Pure: the clock is passed in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from aiorts_studio.plain.problems import HttpError

OF_CLIENT: Final = 32
"""Calls and streams of one client that may be under way."""
OF_KERNEL: Final = 128
"""Calls and streams of all clients that one kernel may have: a kernel takes twice as many of a viewing program."""
OPEN: Final = 2 * OF_CLIENT
"""Requests of one client that may be open, from their heads to the end of their answers."""
BODIES_OF_CLIENT: Final = 2 << 20
"""Bytes of the bodies of one client's open requests."""
BODIES: Final = 8 << 20
"""Bytes of the bodies of all open requests of clients with a token."""
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
            raise _busy(f"more than {RATE:.0f} requests a second")
        self._level += 1.0


class UnderWay:
    """The calls and streams under way, by client and by kernel."""

    def __init__(self) -> None:
        self._counts: Counter[int | str] = Counter()

    @contextmanager
    def one(self, client: int, kernel: str) -> Iterator[None]:
        """Count a call while the block runs; HttpError: there are too many."""
        for key, most, who in ((client, OF_CLIENT, "this client"), (kernel, OF_KERNEL, f"the clients of {kernel}")):
            if self._counts[key] >= most:
                raise _busy(f"{who}: {most} calls are under way already")
        self._counts.update((client, kernel))
        try:
            yield
        finally:
            self._counts.subtract((client, kernel))
            self._counts = +self._counts  # keys without calls are forgotten


class Open:
    """The requests that are open, and how much of their bodies has come, by client."""

    def __init__(self) -> None:
        self._requests: Counter[int] = Counter()
        self._bytes: Counter[int] = Counter()

    @contextmanager
    def one(self, client: int) -> Iterator[Callable[[int], None]]:
        """Count a request while the block runs; HttpError: there are too many.

        The block gets a function that counts bytes of the body. HttpError: too many bytes, which do not count.
        """
        if self._requests[client] >= OPEN:
            raise _busy(f"this client: {OPEN} requests are open already")
        self._requests[client] += 1
        size = 0

        def take(more: int) -> None:
            nonlocal size
            for held, most, who in (
                (self._bytes[client], BODIES_OF_CLIENT, "this client"),
                (self._bytes.total(), BODIES, "all clients"),
            ):
                if held + more > most:
                    raise _busy(f"{who}: the open requests are longer than {most >> 20} MiB together")
            size += more
            self._bytes[client] += more

        try:
            yield take
        finally:
            self._requests[client] -= 1
            self._bytes[client] -= size
            self._requests, self._bytes = +self._requests, +self._bytes  # clients without open requests are forgotten


def _busy(text: str) -> HttpError:
    return HttpError(429, "E-BUSY", text, {"retry-after": "1"})
