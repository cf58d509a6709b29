"""What has come and is not taken yet: bounded, and taken off the socket in a thread where its user may be held back.

A client whose standard output is blocked takes on: the kernel sees none that stalls, and its last words come in time.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from threading import Condition, Thread
from typing import Any, Final

ITEMS: Final = 4_096
"""Items of a stream that are kept for who does not take them."""
BYTES: Final = 32 << 20
"""Bytes of them, as they came; one alone may be larger."""
_JOIN: Final = 1.0


class Waiting:
    """What has come for one call, in order. One thread puts and one takes."""

    __slots__ = ("_came", "_kept", "_missed", "_taken")

    def __init__(self) -> None:
        self._kept: deque[tuple[dict[Any, Any], int]] = deque()
        self._came = self._taken = 0
        """Bytes."""
        self._missed = 0
        """Items that are missing before what comes next."""

    def __len__(self) -> int:
        return len(self._kept)

    def put(self, answer: dict[Any, Any], size: int, *, bounded: bool) -> None:
        """Keep an answer; if `bounded`, an item that finds no room is missing, and the next answer says so."""
        missed = answer.get("missed", 0)
        missed = self._missed + (missed if type(missed) is int else 0)
        if bounded and "item" in answer and self._is_full(size):
            self._missed = missed + 1
            return
        answer["missed"], self._missed = missed, 0
        self._came += size
        self._kept.append((answer, size))

    def _is_full(self, size: int) -> bool:
        kept = len(self._kept)
        return kept >= ITEMS or (kept > 0 and self._came - self._taken + size > BYTES)

    def take(self) -> dict[Any, Any]:
        """The next; IndexError where there is none."""
        answer, size = self._kept.popleft()
        self._taken += size
        return answer

    def missed_last(self) -> int:
        """Items that are missing after the last answer; they are told once."""
        missed, self._missed = self._missed, 0
        return missed


class Ahead:
    """A thread that goes on reading, whatever its user does.

    Args:
        read: waits for bytes and takes them; what it raises ends the thread.
        sort: puts what has come where it belongs.
    """

    def __init__(self, read: Callable[[], None], sort: Callable[[], None]) -> None:
        self._read = read
        self._sort = sort
        self._came = Condition()
        self._failure: Exception | None = None
        self._thread = Thread(target=self._run, name="aiorts client", daemon=True)
        self._thread.start()

    def wait(self, has: Callable[[], bool], until: float | None) -> bool:
        """Whether there is what `has` looks for by the time `until`. Raises what ended the thread when there is not."""
        with self._came:
            timeout = None if until is None else max(0.0, until - time.monotonic())
            self._came.wait_for(lambda: has() or self._failure is not None, timeout)
            if has():
                return True
            if self._failure is not None:
                raise self._failure
            return False

    def join(self) -> None:
        """Wait until the thread, whose socket was shut down, has ended."""
        self._thread.join(_JOIN)

    def _run(self) -> None:
        try:
            while True:
                self._read()
                with self._came:
                    self._sort()
                    self._came.notify_all()
        except Exception as error:  # noqa: BLE001 - who waits is told
            with self._came:
                self._failure = error
                self._came.notify_all()
