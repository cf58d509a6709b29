"""Finds the names that another process denies in a folder of certificates while this process runs."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Final

from aiorts.errors import ConfigurationError
from aiorts_zenoh.security.folder import Folder

EVERY: Final = 1.0
"""Seconds between two looks."""


class Revoking:
    """Looks into the index of a folder; a name that was denied once stays so. It blocks, and is called in a thread.

    Args:
        denied: the names that are known to be denied.
        say: takes a text for the log, where the index cannot be read any more.
    """

    def __init__(self, folder: Folder, denied: frozenset[str], say: Callable[[str], None]) -> None:
        self._folder, self._say = folder, say
        self.denied = denied
        self._read: tuple[int, ...] = ()

    def look(self) -> frozenset[str]:
        """The names that were denied since the last look."""
        try:
            found = os.stat(self._folder.index)
        except OSError as error:
            return self._unreadable(f"{self._folder.index}: {error.strerror}")
        mark = found.st_mtime_ns, found.st_ino, found.st_size
        if mark == self._read:
            return frozenset()
        try:
            now = self._folder.access.denied
        except ConfigurationError as error:
            return self._unreadable(str(error))
        self._read = mark
        new, self.denied = now - self.denied, self.denied | now
        return new

    def _unreadable(self, why: str) -> frozenset[str]:
        self._say(f"who was revoked since is not known: {why}")
        return frozenset()
