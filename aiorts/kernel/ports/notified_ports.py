"""The in-ports of a member of an event context: those that notified the member, and whether it read their samples."""

from __future__ import annotations

from collections import deque
from typing import Any, Final

from aiorts.kernel.ports.in_port import InPort
from aiorts.kernel.ports.port import NOTHING, OFF

_UNKNOWN: Final[deque[Any]] = deque((None,))
"""The stand-in for a queue that cannot be checked directly: it is never empty, so `left_unread` asks the receiver."""


class NotifiedPorts(list[InPort[Any]]):
    """The in-ports of a member, in the order in which they were added."""

    __slots__ = ("notified", "queue")

    def __init__(self) -> None:
        self.notified: list[InPort[Any]] = []
        """The ports that have notified the member of a sample, and are not enabled to notify again yet."""
        self.queue: deque[Any] = OFF
        """A queue; if it is empty after this cycle, no sample is unread and `left_unread` need not be called."""

    def begin_alone(self) -> bool:
        """Begin the cycle if one port has notified and its only connector has data; False: call `begin` instead."""
        # Written out: every sample waits for this before its hook runs.
        notified = self.notified
        if len(notified) != 1:
            return False
        receiver = notified[0]._receiver
        queue = receiver.direct
        if not queue:
            return False
        receiver.notify_enabled = True
        notified.clear()
        for port in self:
            if port._last is not NOTHING:
                port._before, port._last = port._last, NOTHING
        self.queue = queue if len(self) == 1 else _UNKNOWN
        return True

    def begin(self) -> None:
        """Begin a cycle that was triggered, or for which `begin_alone` returned False."""
        if self.notified:
            self.enable_notify()
        for port in self:
            if port._last is not NOTHING:
                port._before, port._last = port._last, NOTHING
        self.queue = _UNKNOWN

    def left_unread(self) -> bool:
        """Whether a sample was read in this cycle and others are unread."""
        for port in self:  # no generator: that is a call for each port, in each cycle that leaves something unread
            if port._last is not NOTHING:
                break
        else:
            return False
        for port in self:
            receiver = port._receiver
            if receiver.direct or (receiver.direct is OFF and receiver.unread()):
                return True
        return False

    def enable_notify(self) -> None:
        """Enable each port that has notified to do so again at its next sample."""
        for port in self.notified:
            port._receiver.enable_notify()
        self.notified.clear()

    def find_data(self) -> bool:
        """Enable all ports that have notified; return whether one still has data, which then stays in `notified`."""
        # Ports are enabled before they are checked: a sample written by a thread in between notifies again.
        notified, self.notified = self.notified, []
        for port in notified:
            port._receiver.enable_notify()
        for port in notified:
            if port.is_new:
                self.notified.append(port)  # asked again before the cycle begins, the answer is the same
                return True
        return False
