"""Keeps out messages of peers that are cut off. Called in the engine's threads, before the loop has any work."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection
from typing import Final

from aiorts_zenoh.keys import sender_of, whose
from aiorts_zenoh.limits import MOST, SLOW_NS, SLOW_NS_PER_BYTE, Limits, Names

_NAMED: Final = 16
"""Bytes before the caller's name in the attachment of a question."""


class Gate:
    """Lets in the messages of peers within their limits.

    Args:
        is_known: whether a kernel of this host and name is there; absent ones of one name count as one peer.
        say: takes a text for the log.
    """

    def __init__(self, is_known: Callable[[str], bool], say: Callable[[str], None]) -> None:
        self._is_known, self._say = is_known, say
        self._limits, self._names = Limits(), Names()
        self._lock = threading.Lock()

    @property
    def cut_off(self) -> Collection[str]:
        """The peers that are cut off."""
        with self._lock:
            return tuple(self._limits.cut_off)

    def message(self, key: str) -> bool:
        """Whether a message is taken."""
        if not self._limits.cut_off:
            return True
        with self._lock:
            return self._limits.admits(self._who(sender_of(key)), time.monotonic())

    def question(self, key: str, beside: bytes) -> bool:
        """Whether a question is taken."""
        said = beside[_NAMED:].decode(errors="replace")
        caller = sender_of(key)
        who = self._who(said if said.rpartition("/")[2] == caller else caller)
        now = time.monotonic()
        with self._lock:
            if not self._limits.admits(who, now):
                return False
            return self._counted(who, "question", now)

    def token(self, key: str, *, up: bool) -> bool:
        """Whether a token that has come or gone is looked at."""
        if (found := whose(key)) is None:
            return True
        with self._lock:
            taken = self._names.admits(*found, key, up=up)
            beyond = self._names.beyond(*found) if up and not taken else None
            first = beyond is not None and self._names.is_first(beyond)
        if beyond is not None and first:
            self._say(f"zenoh: the {' '.join(beyond)} has {MOST[beyond[0]]} tokens and more; the rest is not seen")
        return taken

    def was_bad(self, key: str) -> None:
        """Count bytes that came at this key and were no message."""
        with self._lock:
            self._counted(self._who(sender_of(key)), "bad", time.monotonic())

    def took(self, key: str, size: int, ns: int) -> None:
        """Count a message if the processor spent too long on it for a frame of this size."""
        if ns > SLOW_NS + size * SLOW_NS_PER_BYTE:
            with self._lock:
                self._counted(self._who(sender_of(key)), "slow", time.monotonic())

    def _counted(self, who: str, what: str, now: float) -> bool:
        if text := self._limits.count(who, what, now):
            self._say(f"zenoh: {text}")
        return self._limits.admits(who, now)

    def _who(self, sender: str) -> str:
        """The name of a peer: host and kernel if that kernel is there, else the kernel's name alone."""
        return sender if self._is_known(sender) else sender.rpartition("/")[2]
