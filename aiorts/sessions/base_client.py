"""The base of the blocking client and of the client on a loop: a kernel's entry, and the session with it."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final

from aiorts.errors import AbsentError, ClosedError, ControlError
from aiorts.sessions.folder import Entry
from aiorts.sessions.protocol import ANSWERS, STALL_SECONDS, RightName
from aiorts.sessions.session import Call, ClientSession, Heard

TIMEOUT: Final = 5.0
"""Seconds that a call waits for its answer."""
END: Final = object()
"""The value that a stream gives when it is over."""


class CutOff(ClosedError):
    """The kernel has ended the session, whose client read nothing for too long, and still runs."""


class BaseClient:
    """A session with one kernel, driven by blocking calls or by a loop.

    Attributes:
        entry: the kernel's entry; its epoch is that of the session.
    """

    def __init__(self, entry: Entry, who: str = "", right: RightName = "", *, longest: int = ANSWERS) -> None:
        self.entry = entry
        self._wanted: RightName = right
        self._session = ClientSession(entry.address, entry.epoch, longest=longest)
        self._who = who or _command()

    @property
    def hello(self) -> Mapping[str, Any]:
        """The kernel's hello, with its name, address and pid; empty before it comes."""
        return self._session.hello

    @property
    def right(self) -> str:
        """The right that the kernel gives this session: "view", "operate" or "code"."""
        return str(self.hello.get("right", ""))

    @property
    def silence(self) -> str:
        """The text for a kernel that does not answer."""
        busy = self._session.busy
        return f"no answer: its event loop has been busy for at least {busy:.1f} s" if busy else "no answer"

    def _greeting(self) -> bytes:
        return self._session.greeting(self._who, self._wanted, carried=self.entry.carried)

    def _hear(self, heard: Heard) -> list[Call]:
        """Take frames; returns the calls with new answers. The kernel's hello completes `entry`."""
        greets = self._session.state == "greeting"
        came = self._session.hear(heard)
        if greets and self.hello:
            process, entry = self.hello.get("pid"), self.entry
            process = process if type(process) is int else entry.pid
            self.entry = Entry(entry.address, process, self._session.epoch, entry.path, entry.carried)
        return came

    def _ended(self, *, served: bool) -> ClosedError:
        """The error for a session that the other end has closed.

        Args:
            served: whether the kernel still listens.
        """
        if served:
            return CutOff(
                f"{self.entry.address}: runs on, and has cut off this process, which took nothing for "
                f"{STALL_SECONDS:.0f} s; what it missed at the end is not counted"
            )
        return ClosedError(f"{self.entry.address}: has ended")


def refusal(entry: Entry, error: OSError) -> ControlError:
    """The error for a kernel whose socket cannot be connected."""
    if isinstance(error, ConnectionRefusedError | FileNotFoundError):
        return AbsentError(f"{entry.address}: is gone; `aiorts ls` shows what runs")
    return ControlError(f"{entry.address}: {entry.path}: {error.strerror}")


def _command() -> str:
    words: Sequence[str] = sys.argv[:2]
    return " ".join(os.path.basename(word) for word in words)[:60]
